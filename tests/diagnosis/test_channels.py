"""Exchanged and turned channels are found among all there are, from one product."""

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from torchplate.diagnosis.candidates.channels import Channels, rearrangements


def drawn(seed: int, *shape: int) -> torch.Tensor:
    """Complex numbers in every direction."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.complex128)


class Read:
    """FRFs as a model has them, and as they were read: with noise, and a model that is off by a tenth."""

    def __init__(self, n_response: int, n_reference: int, n_line: int = 40):
        self.labels = Channels(tuple(range(500, 500 + n_response)), tuple(range(n_reference)))
        # Neighbours look alike, as on a plate.
        shape = drawn(1, n_response, n_reference, 6).real.cumsum(1)
        self.predicted = torch.einsum("fm,jkm->fjk", drawn(2, n_line, 6), shape.to(torch.complex128))
        self.measured = 1.1 * self.predicted + 0.05 * drawn(3, *self.predicted.shape)
        self.weight = torch.ones(self.predicted.shape, dtype=torch.float64)

    def found(self):
        return rearrangements(self.labels, self.measured, self.predicted, self.weight)


def fall(read: Read, rearranged: torch.Tensor) -> float:
    """What the sum of squares loses where the model reads its channels like this."""
    before, after = ((read.measured - one).abs().square() * read.weight for one in (read.predicted, rearranged))
    return float((before - after).sum())


class Operations(TorchDispatchMode):
    """Counts what torch is asked to do, which no machine's speed changes."""

    count = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        self.count += 1
        return function(*args, **(kwargs or {}))


def test_two_exchanged_among_121_references_are_the_first_of_all_pairs_at_once():
    read = Read(2, 121, 800)
    read.measured[..., [33, 87]] = read.measured[..., [87, 33]]
    with Operations() as operations:
        found = read.found()
    assert found.n_swap == 7260 + 1
    assert found.swap[0] == {"channels": ((None, 33), (None, 87))}
    # A product for each side and what is read of it; each of the 366 turns reads one number, by three operations.
    assert operations.count < 2000


def test_two_exchanged_responses_are_found():
    read = Read(5, 3)
    read.measured[:, [1, 4]] = read.measured[:, [4, 1]]
    found = read.found()
    assert found.swap[0] == {"channels": ((501, None), (504, None))}
    assert found.n_swap == 10 + 3


@pytest.mark.parametrize(
    ("rows", "columns", "said"),
    [
        ([2], slice(None), ((502, None),)),
        (slice(None), [4], ((None, 4),)),
        ([1], [3], ((501, 3),)),
        # A sensor upside down that reads all of them.
        (slice(None), slice(None), ((500, None), (501, None), (502, None))),
    ],
    ids=["response", "reference", "one FRF", "all"],
)
def test_every_polarity_is_found(rows, columns, said):
    read = Read(3, 6)
    read.measured[:, rows, columns] *= -1
    found = read.found()
    assert found.polarity[0] == {"channels": said}
    assert found.n_polarity == 1 + 3 + 6 + 18


@pytest.mark.parametrize("n_reference", [1, 6])
def test_all_channels_of_a_single_response_may_be_turned_at_once(n_reference):
    read = Read(1, n_reference)
    read.measured *= -1
    found = read.found()
    assert found.polarity[0] == {"channels": ((500, None),)}
    # Where there is one FRF alone, there is one way to turn it and nothing to exchange.
    assert found.n_polarity == (1 if n_reference == 1 else 7)
    assert found.n_swap == n_reference * (n_reference - 1) // 2


def test_where_the_base_moves_there_are_responses_alone():
    read = Read(3, 1)
    read.labels = Channels(read.labels.response, ())
    read.measured[:, 1] *= -1
    found = read.found()
    assert found.polarity[0] == {"channels": ((501, None),)}
    assert found.n_swap == 3
    assert all(None in pair for one in found.swap for pair in one["channels"])


def test_what_comes_first_takes_most_from_the_sum_of_squares():
    read = Read(2, 5)
    read.measured = read.measured + 0.7 * read.predicted.flip(-1)
    read.weight = drawn(7, *read.weight.shape).abs()
    found = read.found()
    falls = []
    for one in found.swap:
        (first, second), moved = one["channels"], read.predicted.clone()
        if first[0] is None:
            moved[..., [first[1], second[1]]] = read.predicted[..., [second[1], first[1]]]
        else:
            moved = read.predicted.flip(1)
        falls.append(fall(read, moved))
    assert falls == sorted(falls, reverse=True)
    turned = []
    for one in found.polarity:
        sign = torch.ones(2, 5, dtype=torch.float64)
        for response, reference in one["channels"]:
            rows = slice(None) if response is None else [response - 500]
            sign[rows, slice(None) if reference is None else [reference]] *= -1
        turned.append(fall(read, sign * read.predicted))
    assert turned == sorted(turned, reverse=True)


def test_an_frf_that_was_not_measured_says_nothing_of_its_channels():
    read = Read(2, 4)
    read.measured[..., [0, 3]] = read.measured[..., [3, 0]]
    read.weight[:, 1, 0] = 0
    before = read.found()
    read.measured[:, 1, 0] = 1e6
    assert read.found().swap == before.swap
    assert read.found().polarity == before.polarity
