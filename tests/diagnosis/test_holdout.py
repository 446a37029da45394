"""Held-out FRFs leave every channel something to be fitted by."""

import pytest
import torch

from torchplate.diagnosis.holdout import exchanged, held_out

SHAPES = [(1, 5), (2, 2), (2, 3), (7, 1), (4, 6), (3, 31)]


def whole(shape):
    return torch.ones(shape, dtype=torch.bool)


def left_alone(heldout, measured):
    """Responses and references of several FRFs of which no fit sees one."""
    return [
        (axis, index)
        for axis in (0, 1)
        for index in range(measured.shape[axis])
        if int(measured.select(axis, index).sum()) > 1 and not bool((measured & ~heldout).select(axis, index).any())
    ]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", [0, 1, 17])
def test_a_fifth_is_held_out_and_every_channel_keeps_a_fitted_one(shape, seed):
    measured = whole(shape)
    if shape == (4, 6):
        measured[1, 2:] = False
        measured[3, 4] = False
    heldout = held_out(measured, seed)
    n = int(measured.sum())
    assert bool((~heldout | measured).all())
    assert int(heldout.sum()) == max(1, n // 5)
    assert left_alone(heldout, measured) == []


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1)])
def test_one_or_two_cannot_spare_one(shape):
    assert not bool(held_out(whole(shape), 3).any())
    sparse = torch.zeros(4, 5, dtype=torch.bool)
    sparse[0, 2] = sparse[3, 2] = True
    assert not bool(held_out(sparse, 3).any())


def test_the_seed_alone_decides():
    measured = whole((4, 6))
    state = torch.get_rng_state()
    every = [held_out(measured, seed) for seed in range(6)]
    assert all(torch.equal(held_out(measured, seed), one) for seed, one in enumerate(every))
    assert len({tuple(one.flatten().tolist()) for one in every}) > 3
    # No global random number was drawn.
    assert torch.equal(torch.get_rng_state(), state)


def ordinary(shape):
    generator = torch.Generator().manual_seed(5)
    return 1 + 0.3 * torch.rand(shape, generator=generator, dtype=torch.float64)


def test_an_outlier_is_given_back_to_the_fit():
    measured, misfit = whole((3, 5)), ordinary((3, 5))
    heldout = held_out(measured, 2)
    j, k = heldout.nonzero()[0].tolist()
    misfit[j, k] = 60.0
    changed = exchanged(heldout, measured, misfit)
    assert not bool(changed[j, k])
    assert int(changed.sum()) == int(heldout.sum())
    # The others stay, and what takes its place is no outlier.
    assert int((changed & heldout).sum()) == int(heldout.sum()) - 1
    assert bool((misfit[changed] < 2).all())


def test_ordinary_ones_are_not_exchanged():
    measured, misfit = whole((3, 5)), ordinary((3, 5))
    heldout = held_out(measured, 2)
    assert torch.equal(exchanged(heldout, measured, misfit), heldout)
    # An outlier among the fitted ones is where it belongs.
    j, k = (~heldout).nonzero()[3].tolist()
    misfit[j, k] = 60.0
    assert torch.equal(exchanged(heldout, measured, misfit), heldout)
    # One level for all is no outlier.
    assert torch.equal(exchanged(heldout, measured, 1000 * ordinary((3, 5))), heldout)


def test_every_channel_keeps_a_fitted_one_after_an_exchange():
    for seed in range(40):
        generator = torch.Generator().manual_seed(seed)
        shape = [(2, 5), (3, 5), (4, 5)][seed % 3]
        measured = whole(shape)
        heldout = held_out(measured, seed)
        misfit = 1 + 0.3 * torch.rand(shape, generator=generator, dtype=torch.float64)
        j, k = heldout.nonzero()[-1].tolist()
        misfit[j, k] = 60.0
        changed = exchanged(heldout, measured, misfit)
        assert left_alone(changed, measured) == [], seed
