"""What chance lets the best of all effects take where nothing is missing."""

import pytest
import torch

from torchplate.diagnosis.selection.null import Draws, falls, limits, once_in_a_hundred
from torchplate.diagnosis.selection.products import Products, best_of_places
from torchplate.diagnosis.selection.screen import screen


def random(*shape: int, seed: int = 3) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_parameters_of_one_effect_take_what_their_number_says(n):
    draws = random(4000, 60)
    change = random(n, 60, seed=n) * torch.logspace(-2, 2, n, dtype=torch.float64)[:, None]
    found = falls(change, change @ draws.mT)
    # Chi squared with as many degrees of freedom as there are parameters.
    assert float(found.mean()) == pytest.approx(n, rel=0.06)
    assert float(found.var()) == pytest.approx(2 * n, rel=0.15)
    # One that says the same again adds nothing.
    twice = torch.cat([change, 2 * change])
    assert torch.allclose(falls(twice, twice @ draws.mT), found)
    # The square of what lies in the space of the changes.
    basis = torch.linalg.qr(change.mT)[0]
    assert torch.allclose((draws @ basis).square().sum(-1), found)


def test_the_best_of_many_places_takes_more_than_one_of_them():
    places, left = random(49, 80, seed=5), random(80)
    products = Products(None, left, left.new_zeros(80, 0), Draws(80, n_draw=2000), 80)
    one, best = (best_of_places(products.of(places[:n])) for n in (1, 49))
    assert float(one.mean()) == pytest.approx(1.0, rel=0.1)
    # The largest of 49 squares of normal numbers: 1 − (1 − 1/98)-quantile squared.
    assert 5.5 < float(best.quantile(0.5)) < 6.5
    assert once_in_a_hundred(torch.stack([one, best])) > once_in_a_hundred(one[None])


def test_each_effect_has_its_own_limit_and_one_draw_of_a_hundred_is_beyond_one():
    """Six effects of one number, two of three, one that may sit at 49 places, and one that takes nothing."""

    def drawn(n_draw: int, seed: int) -> torch.Tensor:
        square = random(n_draw, 6 + 2 * 3 + 49, seed=seed).square().mT
        several = square[6:12].unflatten(0, (2, 3)).sum(1)
        return torch.cat([square[:6], several, square[12:].amax(0)[None], torch.zeros(1, n_draw).to(square)])

    limit = limits(drawn(4000, 1))
    fresh = drawn(40000, 2)
    beyond = fresh[:-1] > limit[:-1, None]
    assert 0.006 < float(beyond.any(0).double().mean()) < 0.014
    # One p-value for all: an effect of one number is beyond its limit as often as one of three.
    once = beyond.double().mean(1)
    assert float(once[:6].mean()) == pytest.approx(float(once[6:8].mean()), rel=0.5)
    one, three, anywhere = float(limit[:6].mean()), float(limit[6:8].mean()), float(limit[8])
    assert one + 3 < three < anywhere
    assert one + 3 < once_in_a_hundred(drawn(4000, 1))
    assert not limits(torch.zeros(3, 0, dtype=torch.float64)).any()


def test_what_says_nothing_takes_nothing():
    assert not falls(torch.zeros(2, 9, dtype=torch.float64), random(2, 7)).any()
    assert once_in_a_hundred(torch.zeros(0, 7, dtype=torch.float64)) == 0.0


def test_what_chance_leaves_is_white():
    found = torch.cat(list(Draws(1200, n_told=2).split(16)))
    assert found.shape == (200, 1202)
    assert float(found.square().mean()) == pytest.approx(1.0, abs=0.01)
    # The same each time they are asked for, however many at a time.
    assert torch.equal(torch.cat(list(Draws(1200, n_told=2).split(40))), found)
    assert not torch.equal(torch.cat(list(Draws(1200, n_told=2, seed=1).split(40))), found)
    # Lines are independent of each other.
    assert abs(float((found[:, :-2] * found[:, 2:]).mean())) < 0.01


@torch.no_grad()
def test_what_chance_takes_of_the_catalogue_is_a_few_numbers_worth(lab):
    """Also where a mode is off by as much as the mesh leaves: that is among the nuisances, and whitened with them."""
    scene = lab.Scene(hidden={"gain": 1.0})
    state = scene.state
    base = scene.builder.reduced(state.fit.model, state.fit.theta[None], by_element=True)
    every = [scene.candidate(name) for name in ("point_mass", "orthotropy", "sensor_gain")]
    for shift in (0.0, 1e-3):
        target = scene.builder.target.with_mesh_error(torch.full_like(lab.SMALL_LINES, shift), 0.0, 10)
        builder = scene.builder.against(target)
        marginal = target.marginal(state.fit.reduced, state.fit.theta)
        draws = Draws(2 * target.measured.numel())
        scored = screen(builder, base, state.fit.theta, every, {}, near=marginal, draws=draws)
        # The best of three, one of them at many places: in a hundredth χ² of one exceeds 6.6, that of four 13.3.
        assert 9 < once_in_a_hundred(torch.stack([one.by_chance for one in scored])) < 25
