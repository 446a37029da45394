"""Values in place and the adjoint's gradient, against the plain operations that say what they are."""

import threading

import pytest
import torch

from torchplate.model.receptance import attached_sum as attached_sum_module
from torchplate.model.receptance.attach import attach
from torchplate.model.receptance.attached_sum import Rows, attached_sum
from torchplate.model.receptance.modal_sum import CLOSE, Disc, Stretch, modal_sum

N_MODE, N_LINE, AT_ONCE = 60, 50, 20
ONE = torch.ones(1, dtype=torch.complex128)


def random(*shape: int, seed: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 0.5


def system(n_term: int, n_response: int, n_reference: int, batch: tuple[int, ...] = ()):
    """Modes with two at zero and two equal ones, lines among them, and the stretches of three blocks of lines."""
    eigenvalue = 6e1 * torch.arange(N_MODE, dtype=torch.float64) ** 2
    eigenvalue[1], eigenvalue[5] = 0.0, eigenvalue[4]
    tied = random(n_term, N_MODE, seed=1)
    left = torch.cat([tied, random(n_response, N_MODE, seed=2)])
    right = torch.cat([tied, random(n_reference, N_MODE, seed=3)])
    x = 1e2 + 2e4 * torch.linspace(0, 1, N_LINE, dtype=torch.float64) * (1 + 0.2 * random(*batch, 1, seed=4))
    z = torch.complex(x, -1e-2 * x - 1.0)
    force = torch.complex(*(3e3 * random(n_term, *batch, N_LINE, seed=seed) for seed in (5, 6)))
    stretches = [Stretch.around(Disc.around(own, eigenvalue), eigenvalue, CLOSE) for own in z.split(AT_ONCE, dim=-1)]
    return Rows(eigenvalue, left, right), z, force, stretches


def plain(rows: Rows, z, force, stretches) -> torch.Tensor:
    blocks = zip(z.split(AT_ONCE, dim=-1), force.split(AT_ONCE, dim=-1), stretches, strict=True)
    return torch.cat([attach(modal_sum(*rows, own, stretch), tied) for own, tied, stretch in blocks], dim=-1)


SIZES = pytest.mark.parametrize(("n_term", "n_response", "n_reference"), [(0, 2, 1), (1, 1, 3), (4, 1, 6), (3, 3, 2)])
BATCHES = pytest.mark.parametrize("batch", [(), (3,), (2, 3)], ids=str)


@SIZES
@BATCHES
def test_values_are_those_of_the_plain_operations(n_term: int, n_response: int, n_reference: int, batch) -> None:
    given = system(n_term, n_response, n_reference, batch)
    scale = torch.complex(*(random(*batch, N_LINE, seed=seed) for seed in (21, 22)))
    expected = plain(*given)
    for one in (scale, scale[..., :1]):
        for enabled in (True, False):
            with torch.set_grad_enabled(enabled):
                scaled = attached_sum(*given, AT_ONCE, one)
            assert float((scaled - expected * one).abs().max() / (expected * one).abs().max()) < 1e-13
    found = attached_sum(*given, AT_ONCE, ONE)
    assert any(stretch.series is not None for stretch in given[3])
    assert found.shape == (n_response, n_reference, *batch, N_LINE)
    assert float((found - expected).abs().max() / expected.abs().max()) < 1e-13


@SIZES
@pytest.mark.parametrize("moved", ["left", "right", "both"])
def test_values_of_members_with_rows_of_their_own_are_those_of_the_plain_operations(
    n_term: int, n_response: int, n_reference: int, moved: str, monkeypatch
) -> None:
    """More members than go together, and no multiple of that; once written over, arrays hold nothing of before."""
    monkeypatch.setattr("torchplate.model.receptance.attached_sum.MEMBERS_AT_ONCE", 4)
    rows, z, force, stretches = system(n_term, n_response, n_reference, (2, 5))
    for side in ("left", "right") if moved == "both" else (moved,):
        one = getattr(rows, side)
        rows = rows._replace(**{side: one + 0.3 * random(2, 5, *one.shape, seed=31)})
    scale = torch.complex(*(random(2, 5, N_LINE, seed=seed) for seed in (21, 22)))
    expected = plain(rows, z, force, stretches)
    for one in (scale, scale[:, :1, :1], ONE):
        with torch.no_grad():
            found = attached_sum(rows, z, force, stretches, AT_ONCE, one)
        assert found.shape == (n_response, n_reference, 2, 5, N_LINE)
        assert float((found - expected * one).abs().max() / (expected * one).abs().max()) < 1e-13


@pytest.mark.parametrize(("n_term", "n_own"), [(4, 1), (5, 2), (3, 3), (2, 0)])
@pytest.mark.parametrize("differs", ["in place", "in strength"])
def test_values_of_members_that_differ_in_their_last_terms_are_those_of_the_plain_operations(
    n_term: int, n_own: int, differs: str, monkeypatch
) -> None:
    monkeypatch.setattr("torchplate.model.receptance.attached_sum.MEMBERS_AT_ONCE", 4)
    made = []
    way = attached_sum_module._attached_after
    monkeypatch.setattr(attached_sum_module, "_attached_after", lambda *own: made.append(1) or way(*own))
    rows, z, force, _ = system(n_term, 3, 2, (7,))
    z, force = z[:1].expand(7, -1), force[:, :1].repeat(1, 7, 1)
    stretches = [
        Stretch.around(Disc.around(own, rows.eigenvalue), rows.eigenvalue, CLOSE) for own in z.split(AT_ONCE, dim=-1)
    ]
    sides = [side.repeat(7, 1, 1) for side in rows[1:]]
    for side in sides:
        if differs == "in place":
            side[:, n_term - n_own : n_term] += 0.3 * random(7, n_own, N_MODE, seed=41)
    if differs == "in strength":
        force[n_term - n_own :] *= 1 + random(n_own, 7, 1, seed=51)
    rows = rows._replace(left=sides[0], right=sides[1])
    scale = torch.complex(*(random(7, N_LINE, seed=seed) for seed in (21, 22)))
    expected = plain(rows, z, force, stretches) * scale
    with torch.no_grad():
        found = attached_sum(rows, z, force, stretches, AT_ONCE, scale)
    # Where all terms are the members' own, or they are alike but for one place, others are the way.
    assert bool(made) == (0 < n_own < n_term)
    assert float((found - expected).abs().max() / expected.abs().max()) < 1e-12
    # One that is read elsewhere is one of its own.
    made.clear()
    sides[0][2, -1] += 0.1
    with torch.no_grad():
        found = attached_sum(rows._replace(left=sides[0]), z, force, stretches, AT_ONCE, scale)
    assert not made
    assert float((found - expected)[:-1].abs().max() / expected.abs().max()) < 1e-12
    assert float((found - expected)[-1, :, 2].abs().max() / expected.abs().max()) > 1e-6


@SIZES
@BATCHES
def test_the_gradient_is_that_of_the_plain_operations(n_term: int, n_response: int, n_reference: int, batch) -> None:
    rows, z, force, stretches = system(n_term, n_response, n_reference, batch)
    weight = torch.complex(*(random(n_response, n_reference, *batch, N_LINE, seed=seed) for seed in (7, 8)))

    def gradients(way) -> list[torch.Tensor]:
        inputs = [z.clone().requires_grad_(), force.clone().requires_grad_()]
        # With no term there is nothing to differentiate by.
        return list(torch.autograd.grad(way(*inputs), inputs[: 1 + bool(n_term)], weight))

    expected = gradients(lambda z, force: plain(rows, z, force, stretches))
    found = gradients(lambda z, force: attached_sum(rows, z, force, stretches, AT_ONCE, ONE))
    for own, other in zip(found, expected, strict=True):
        assert own.shape == other.shape
        assert float((own - other).abs().max()) < 1e-12 * float(other.abs().max())


@pytest.mark.parametrize("which", ["left", "right", "eigenvalue"])
def test_rows_and_modes_that_move_have_their_gradient(which: str) -> None:
    rows, z, force, stretches = system(2, 1, 2)
    # All modes one by one: the series is of constants.
    near = [Stretch(None, 0, N_MODE, None) for _ in stretches]
    moving = getattr(rows, which).clone().requires_grad_()
    given = rows._replace(**{which: moving}), z, force, near
    (found,) = torch.autograd.grad(attached_sum(*given, AT_ONCE, ONE).abs().square().sum(), moving)
    (expected,) = torch.autograd.grad(plain(*given).abs().square().sum(), moving)
    assert bool(expected.any())
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=0)


def test_a_term_without_force_has_a_gradient_too() -> None:
    rows, z, force, stretches = system(3, 1, 2)
    force = force.clone()
    force[1] = 0.0
    force.requires_grad_()
    (found,) = torch.autograd.grad(attached_sum(rows, z, force, stretches, AT_ONCE, ONE).abs().square().sum(), force)
    (expected,) = torch.autograd.grad(plain(rows, z, force, stretches).abs().square().sum(), force)
    assert float(expected[1].abs().min()) > 0
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=0)


def test_a_gradient_can_be_differentiated_again() -> None:
    rows, z, force, stretches = system(2, 1, 2)

    def twice(way) -> tuple[torch.Tensor, ...]:
        inputs = [z.clone().requires_grad_(), force.clone().requires_grad_()]
        once = torch.autograd.grad(way(*inputs).abs().square().sum(), inputs, create_graph=True)
        return torch.autograd.grad(sum(part.abs().square().sum() for part in once), inputs)

    found = twice(lambda z, force: attached_sum(rows, z, force, stretches, AT_ONCE, ONE))
    for own, other in zip(found, twice(lambda z, force: plain(rows, z, force, stretches)), strict=True):
        torch.testing.assert_close(own, other, rtol=1e-9, atol=1e-12 * float(other.abs().max()))


def test_a_force_that_z_moves_is_differentiated_once() -> None:
    rows, z, force, stretches = system(2, 1, 2)
    position = torch.ones(2, dtype=torch.float64, requires_grad=True)

    def size(way) -> torch.Tensor:
        moved = z * position[0]
        return way(moved, force * position[1] * moved / z).abs().log().sum()

    def twice(way) -> torch.Tensor:
        (once,) = torch.autograd.grad(size(way), position, create_graph=True)
        return torch.stack([torch.autograd.grad(part, position, retain_graph=True)[0] for part in once])

    found = twice(lambda z, force: attached_sum(rows, z, force, stretches, AT_ONCE, ONE))
    expected = twice(lambda z, force: plain(rows, z, force, stretches))
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9 * float(expected.abs().max()))


def test_many_gradients_can_be_asked_for_at_once() -> None:
    rows, z, force, stretches = system(2, 1, 2)
    inputs = [z.clone().requires_grad_(), force.clone().requires_grad_()]
    found = attached_sum(rows, *inputs, stretches, AT_ONCE, ONE)
    incoming = torch.complex(random(3, *found.shape, seed=9), random(3, *found.shape, seed=10))
    together = torch.autograd.grad(found, inputs, incoming, is_grads_batched=True, retain_graph=True)
    for index, one in enumerate(incoming):
        for many, own in zip(together, torch.autograd.grad(found, inputs, one, retain_graph=True), strict=True):
            torch.testing.assert_close(many[index], own, rtol=1e-9, atol=1e-12 * float(own.abs().max()))


def test_numbers_are_as_precise_as_those_given() -> None:
    rows, z, force, stretches = system(2, 1, 2)
    stretches = [own._replace(series=own.series if own.series is None else own.series.float()) for own in stretches]
    less = Rows(*(part.float() for part in rows))
    numbers = [part.to(torch.complex64) for part in (z, force, ONE)]
    for enabled in (True, False):
        with torch.set_grad_enabled(enabled):
            assert attached_sum(less, *numbers[:2], stretches, AT_ONCE, numbers[2]).dtype == torch.complex64


def test_only_what_is_wanted_is_differentiated_again() -> None:
    rows, z, force, stretches = system(2, 1, 2)
    z.requires_grad_()
    found = attached_sum(rows, z, force, stretches, AT_ONCE, ONE).abs().square().sum()
    (once,) = torch.autograd.grad(found, z, create_graph=True)
    (twice,) = torch.autograd.grad(once.abs().square().sum(), z)
    assert bool(twice.isfinite().all())


def test_single_precision_is_as_good_as_its_digits_beside_a_sharp_peak_too() -> None:
    rows, z, force, stretches = system(0, 2, 3, (5,))
    # A line a millionth of a mode's eigenvalue away from it, with no damping to speak of: in single precision the
    # difference of the two alone would have one digit.
    z[0, 7] = torch.complex(rows.eigenvalue[10] * (1 + 1e-6), rows.eigenvalue[10] * -1e-9)
    expected = plain(rows, z, force, stretches)
    with torch.no_grad():
        found = attached_sum(rows, z, force, stretches, AT_ONCE, ONE, in_single=True)
    assert found.dtype == torch.complex64
    error = (found - expected).norm(dim=-1) / expected.norm(dim=-1)
    assert 1e-9 < float(error.max()) < 1e-6


def test_attached_terms_cost_single_precision_some_digits_and_no_more() -> None:
    given = system(4, 2, 3, (5,))
    expected = plain(*given)
    with torch.no_grad():
        found = attached_sum(*given, AT_ONCE, ONE, in_single=True)
    error = (found - expected).norm(dim=-1) / expected.norm(dim=-1)
    assert 1e-9 < float(error.max()) < 1e-5


def test_a_result_is_not_written_over_by_the_next() -> None:
    first, other = system(4, 1, 6, (3,)), system(4, 1, 6, (2,))
    found = attached_sum(*first, AT_ONCE, ONE)
    kept = found.clone()
    attached_sum(*other, AT_ONCE, ONE)
    assert torch.equal(found, kept)


def test_threads_do_not_write_over_each_other() -> None:
    given = [system(4, 1, 6, (n,)) for n in (3, 4, 5, 6)]
    expected, found = [attached_sum(*own, AT_ONCE, ONE) for own in given], [[] for _ in given]

    def work(index: int) -> None:
        found[index] = [attached_sum(*given[index], AT_ONCE, ONE) for _ in range(20)]

    threads = [threading.Thread(target=work, args=(index,)) for index in range(len(given))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for own, one in zip(found, expected, strict=True):
        assert len(own) == 20
        assert all(torch.equal(value, one) for value in own)
