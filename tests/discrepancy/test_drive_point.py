"""A drive point whose hit is beside its sensor, against the series of a plate under a point force."""

import math

import pytest
import torch

from torchplate.discrepancy.nuisance import nuisances
from torchplate.discrepancy.wandering import UNIFORM
from torchplate.effects import CATALOGUE
from torchplate.measurement import PERFECT, Imperfections
from torchplate.model import PlateModel
from torchplate.plate import Mesh

SIDES, YOUNG, NU, THICKNESS = (0.5, 0.4), 7.2e10, 0.33, 3e-3
LINES = torch.linspace(20.0, 300.0, 30, dtype=torch.float64)
NOBODY = torch.zeros(0, dtype=torch.float64)


def columns(off: float, kind: str = "receptance"):
    """Of a test of two sensors and three hits, the second sensor at the place of the third hit."""
    plate = {"youngs_modulus": YOUNG, "poisson_ratio": NU, "density": 2700.0, "thickness": THICKNESS}
    known = {f"plate.{name}": value for name, value in plate.items()} | {"loss.stiffness_loss_factor": 1e-3}
    effects = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"]()}
    model = PlateModel(Mesh(*SIDES, 8, 8), effects, known, {}, [12, 41], [3, 70, 41], kind)
    told = Imperfections(off, 0.0, 0.0, 0.0)
    found = nuisances(model, NOBODY, LINES, told, UNIFORM, torch.zeros_like(LINES))
    own = [index for index, name in enumerate(found.group[0]) if name == "drive_point"]
    return torch.complex(*found.common[..., own].unbind(-2))


def falls(distance: float) -> float:
    """w(0) − w(r) of a simply supported plate under a unit force at its middle: Navier's series [m/N]."""
    a, b = SIDES
    rigidity = YOUNG * THICKNESS**3 / (12 * (1 - NU**2))
    m, n = torch.meshgrid(*[torch.arange(1.0, 1200.0, 2.0, dtype=torch.float64)] * 2, indexing="ij")
    modal = 4 / (a * b * rigidity * math.pi**4) / ((m / a) ** 2 + (n / b) ** 2) ** 2
    return float((modal * (1 - torch.cos(m * math.pi * distance / a))).sum())


@pytest.mark.parametrize("off", [1e-3, 2e-3, 4e-3])
def test_it_is_what_a_point_force_leaves_as_far_off_as_both_ends_are(off):
    own = columns(off)
    near = math.sqrt(4 * off**2 + THICKNESS**2)
    # A rectangle on supports is a little stiffer about its middle than a disc as wide as its shorter side.
    assert falls(near) < float(own[0, 1, 2, 0].real) < 1.07 * falls(near)


def test_only_the_drive_point_has_it_and_the_same_at_all_lines():
    own = columns(2e-3)
    assert own.shape[-1] == 1
    there = own[:, 1, 2, 0]
    assert float((there - there[0]).abs().max()) == 0 < float(there[0].real)
    assert int((own != 0).sum()) == len(LINES)
    # As an accelerance it is −ω² of that.
    omega = 2 * math.pi * LINES
    assert torch.allclose(columns(2e-3, "accelerance")[:, 1, 2, 0], -omega.square() * there)


def test_a_test_whose_places_are_exact_has_a_point_force():
    assert columns(0.0).shape[-1] == 0
    assert PERFECT.std("position_std") == 0
