"""What chance lets the best of all effects take where nothing is missing."""

import pytest
import torch

from torchplate.diagnosis.selection.null import drawn, falls, once_in_a_hundred
from torchplate.diagnosis.selection.screen import screen


def random(*shape: int, seed: int = 3) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_parameters_of_one_effect_take_what_their_number_says(n):
    draws = random(4000, 60)
    change = random(n, 60, seed=n) * torch.logspace(-2, 2, n, dtype=torch.float64)[:, None]
    found = falls(change, draws, together=True)
    # Chi squared with as many degrees of freedom as there are parameters.
    assert float(found.mean()) == pytest.approx(n, rel=0.06)
    assert float(found.var()) == pytest.approx(2 * n, rel=0.15)
    # One that says the same again adds nothing.
    assert torch.allclose(falls(torch.cat([change, 2 * change]), draws, together=True), found)


def test_the_best_of_many_places_takes_more_than_one_of_them():
    draws, places = random(2000, 80), random(49, 80, seed=5)
    one, best = (falls(places[:n], draws, together=False) for n in (1, 49))
    assert float(one.mean()) == pytest.approx(1.0, rel=0.1)
    # The largest of 49 squares of normal numbers: 1 − (1 − 1/98)-quantile squared.
    assert 5.5 < float(best.quantile(0.5)) < 6.5
    assert once_in_a_hundred(torch.stack([one, best])) > once_in_a_hundred(one[None])


def test_what_says_nothing_takes_nothing():
    assert not falls(torch.zeros(2, 9, dtype=torch.float64), random(7, 9), together=False).any()
    assert once_in_a_hundred(torch.zeros(0, 7, dtype=torch.float64)) == 0.0


@torch.no_grad()
def test_noise_alone_leaves_what_the_likelihood_says(lab):
    scene = lab.Scene()
    found = drawn(scene.builder.target, scene.fit.prediction, n_told=2)
    assert found.shape == (200, 2 * 6 * 100 + 2)
    assert float(found.square().mean()) == pytest.approx(1.0, abs=0.01)
    # Lines are independent of each other.
    assert abs(float((found[:, :-2] * found[:, 2:]).mean())) < 0.01


@torch.no_grad()
def test_a_mode_that_the_mesh_moves_looks_more_like_an_effect_than_noise_does(lab):
    scene = lab.Scene(hidden={"gain": 1.0})
    target, state = scene.builder.target, scene.state
    base = scene.builder.reduced(state.fit.model, state.fit.theta[None], by_element=True)
    every = [scene.candidate(name) for name in ("point_mass", "orthotropy", "sensor_gain")]
    limits = []
    for shift in (0.0, 1e-3):
        modes = base.natural_frequencies(state.fit.theta, 16)
        target.set_model_error(torch.full_like(target.frequency, shift), 0.0, modes[modes > 1.0])
        draws = drawn(target, state.fit.prediction)
        # Each line is off by no more than its variance says.
        assert float(draws.square().mean()) < 1.1
        scored = screen(scene.builder, base, state.fit.theta, every, {}, near=True, draws=draws)
        limits.append(once_in_a_hundred(torch.stack([one.by_chance for one in scored])))
    assert 9 < limits[0] < 25
    assert limits[1] > 2 * limits[0]
