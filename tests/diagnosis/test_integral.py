"""The likelihood of a hypothesis over all its values, held against integrals that are known."""

import math

import pytest
import torch

from torchplate.diagnosis.integral import Drawing, Peak, integrate

SETTINGS = Drawing()
# Standard error of ln Z, twice for −2 ln Z, and three of them.
NEAR = 3 * 2 / math.sqrt(SETTINGS.n_effective)


def peak(place: list[float], std: list[float]) -> Peak:
    return Peak(torch.tensor(place, dtype=torch.float64), torch.tensor(std, dtype=torch.float64).square().diag())


def integral(cost, *peaks: Peak, seed: int = 0) -> float:
    found = integrate(cost, peaks, torch.Generator().manual_seed(seed), SETTINGS)
    assert found.n_effective >= SETTINGS.n_effective
    return found.evidence


@pytest.mark.parametrize("seed", [0, 1])
def test_a_gaussian_within_the_box_has_its_own_volume(seed):
    place, std = torch.tensor([0.37, 0.61]).double(), torch.tensor([0.03, 0.05]).double()
    found = integral(
        lambda u: 17.0 + ((u - place) / std).square().sum(-1), peak(place.tolist(), [0.03, 0.05]), seed=seed
    )
    assert found == pytest.approx(17.0 - 2 * math.log(2 * math.pi * 0.03 * 0.05), abs=NEAR)


def test_one_whose_minimum_lies_on_a_bound_counts_for_what_lies_within():
    """A half of the Gaussian, where it is flat there; exp(−g u) where it falls towards the bound."""
    found = integral(lambda u: (u[:, 0] / 0.04).square(), peak([0.0], [0.04]))
    assert found == pytest.approx(-2 * math.log(0.5 * math.sqrt(2 * math.pi) * 0.04), abs=NEAR)
    found = integral(lambda u: 2 * 80.0 * (1 - u[:, 0]), peak([1.0], [0.3]))
    assert found == pytest.approx(2 * math.log(80.0), abs=NEAR)


def test_a_valley_that_is_bent_is_followed_beyond_its_minimum():
    """∫∫ exp(−½ ((v − u²) / s)²) dv du = √2π s over the box, but for its ends: no Gaussian is like it."""
    s = 0.01
    found = integral(lambda u: ((u[:, 1] - u[:, 0].square()) / s).square(), peak([0.3, 0.09], [0.02, 0.02]))
    assert found == pytest.approx(-2 * math.log(math.sqrt(2 * math.pi) * s), abs=NEAR)


def test_minima_far_from_each_other_add_up():
    def cost(u: torch.Tensor) -> torch.Tensor:
        two = torch.stack([((u[:, 0] - 0.2) / 0.02).square(), 1.0 + ((u[:, 0] - 0.8) / 0.01).square()])
        return -2 * (-0.5 * two).logsumexp(0)

    found = integral(cost, peak([0.2], [0.02]), peak([0.8], [0.01]))
    volume = math.sqrt(2 * math.pi) * (0.02 + math.exp(-0.5) * 0.01)
    assert found == pytest.approx(-2 * math.log(volume), abs=NEAR)
    # A minimum that nobody found is drawn from the box.
    assert integral(cost, peak([0.2], [0.02])) == pytest.approx(-2 * math.log(volume), abs=2 * NEAR)


def test_where_nothing_is_said_it_costs_nothing():
    assert integral(lambda u: torch.full_like(u[:, 0], 3.0), peak([0.5, 0.5], [0.29, 0.29])) == pytest.approx(
        3.0, abs=NEAR
    )


def test_draws_of_a_poor_first_proposal_do_not_stay_heavy():
    """A disc, thin in one of six directions, of which the proposal knows nothing but the middle."""
    thin, wide = 0.001, 0.12

    def cost(u: torch.Tensor) -> torch.Tensor:
        off = u - 0.5
        along = off.sum(-1) / math.sqrt(6)
        return (along / thin).square() + (off.square().sum(-1) - along.square()) / wide**2

    found = integral(cost, peak([0.5] * 6, [0.12] * 6))
    assert found == pytest.approx(-2 * math.log((2 * math.pi) ** 3 * thin * wide**5), abs=NEAR)
