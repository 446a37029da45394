"""Priors of which half is narrow: a plate is a sheet of metal, whose directions hardly differ, or it is not."""

import math
from types import SimpleNamespace

import pytest
import torch

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import with_candidate
from torchplate.diagnosis.selection.criterion import Hypothesis, Weight
from torchplate.diagnosis.usual import Usual
from torchplate.discrepancy.judged import Judged
from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

MEAN, STD = (0.4, 0.6), (0.05, 0.08)
ORTHOTROPY = CATALOGUE["orthotropy"]()
INTERVALS = {"young_ratio": Searched(0.03, 30.0, True), "shear_factor": Searched(0.2, 5.0, True)}
CANDIDATE = Candidate(ORTHOTROPY, {}, INTERVALS, {"young_ratio": 1.0, "shear_factor": 1.0})


def two() -> Usual:
    return Usual((([2, 0], torch.tensor(MEAN).double(), torch.tensor(STD).double()),))


def grid(n: int) -> tuple[torch.Tensor, int]:
    axis = (torch.arange(n, dtype=torch.float64) + 0.5) / n
    every = torch.cartesian_prod(axis, axis)
    return torch.stack([every[:, 0], torch.full_like(every[:, 0], 0.3), every[:, 1]], dim=-1), n


def test_the_prior_is_a_density_on_the_unit_cube():
    places, _ = grid(400)
    # Not the whole of the normal half lies in the cube, 1e-6 of it does not.
    assert float((-0.5 * two().at(places)).exp().mean()) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("std", [0.01, 0.07])
@pytest.mark.parametrize("at", [(0.65, 0.45), (0.62, 0.3)])
def test_a_posterior_becomes_more_probable_by_the_mean_of_the_prior_over_it(at, std):
    position = torch.tensor([at[0], 0.3, at[1]], dtype=torch.float64)
    covariance = std**2 * torch.tensor([[1.0, 0.0, 0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 1.0]], dtype=torch.float64)
    places, _ = grid(800)
    off = (places - position)[:, [0, 2]]
    weight = (-0.5 * ((off @ torch.linalg.inv(covariance[[0, 2]][:, [0, 2]])) * off).sum(-1)).softmax(0)
    mean = float((weight * (-0.5 * two().at(places)).exp()).sum())
    assert two().of_posterior(position, covariance) == pytest.approx(-2 * math.log(mean), abs=0.02)


def fitted(young: float, shear: float) -> Fit:
    """A posterior of an orthotropy that is known to half a per cent."""
    known = {"plate.youngs_modulus": 2e11, "plate.poisson_ratio": 0.3, "plate.density": 7800.0, "plate.thickness": 3e-3}
    plain = PlateModel(Mesh(0.4, 0.3, 2, 2), {"plate": CATALOGUE["plate"]()}, known, {})
    model = with_candidate(plain, "grain", CANDIDATE)
    wide = [math.log(one.high / one.low) for one in INTERVALS.values()]
    nothing = torch.zeros(0, dtype=torch.float64)
    return Fit(
        model=model,
        reduced=model,
        theta=torch.tensor([young, shear], dtype=torch.float64),
        covariance=torch.zeros(2, 2, dtype=torch.float64),
        prediction=nothing,
        expected=nothing,
        judged=Judged(0.0, 1.0, {}, 1.0, 100.0, nothing),
        prior=0.0,
        gap=0.1,
        left=0.1,
        beside=SimpleNamespace(about=None),  # type: ignore[arg-type]
        information=torch.diag((torch.tensor(wide, dtype=torch.float64) / 0.005).square()),
        told=torch.zeros(2, dtype=torch.float64),
    )


def test_a_sheet_is_rather_like_a_sheet_than_like_wood():
    """Of rolled metal and of wood, one is as probable as the other, and each is rarely like the other."""

    def rarity(young: float, shear: float) -> float:
        return Hypothesis(CANDIDATE, "grain", fitted(young, shear)).rarity(Weight())

    # Within the normal half, (1/2) N over the uniform density; far from it, one half is left.
    peak = 0.5 + 0.5 * math.log(1000) * math.log(25) / (2 * math.pi * (0.1**2 + 0.005**2))
    assert rarity(1.0, 1.0) == pytest.approx(-2 * math.log(peak), abs=0.02)
    assert rarity(0.9, 1.05) < rarity(0.8, 1.1) < 0
    for far in (0.1, 10.0):
        assert rarity(far, 0.6) == pytest.approx(2 * math.log(2), abs=1e-6)


def test_what_has_no_usual_size_is_as_probable_anywhere():
    mass = Candidate(CATALOGUE["point_mass"](), {}, {"mass": Searched(0.0, 1.0)}, {})
    assert mass.usual == {}
    assert Hypothesis(mass, "mass_1", fitted(1.0, 1.0)).rarity(Weight()) == 0.0
