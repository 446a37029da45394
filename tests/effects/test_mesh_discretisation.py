"""A mesh too coarse for the band, and the finer one that mends it."""

import math

import pytest
import torch

from torchplate.effects import MeshDiscretisation, Plate, SupportSpring
from torchplate.model import PlateModel
from torchplate.plate import Mesh

KNOWN = {
    "plate.youngs_modulus": 70e9,
    "plate.poisson_ratio": 0.33,
    "plate.density": 2700.0,
    "plate.thickness": 0.003,
    "wires.stiffness": 500.0,
}
NONE = torch.zeros(0, dtype=torch.float64)
SIDES = {"rectangle": (0.5, 0.3), "square": (0.4, 0.4)}


def _model(mesh: Mesh, **effects) -> PlateModel:
    return PlateModel(mesh, {"plate": Plate(), "wires": SupportSpring(nodes=(2, 9, 14)), **effects}, KNOWN)


@pytest.mark.parametrize("shape", SIDES)
def test_it_is_the_finer_mesh_with_the_same_labels(shape):
    lines = torch.tensor([13.0, 63.0, 154.0], dtype=torch.float64)
    found = _model(Mesh(*SIDES[shape], 4, 3, refine=2), finer=MeshDiscretisation(2))
    expected = _model(Mesh(*SIDES[shape], 4, 3, refine=4))
    assert found.mesh == expected.mesh
    assert torch.equal(found.frf(NONE, lines, [3], [12]), expected.frf(NONE, lines, [3], [12]))


@pytest.mark.parametrize("shape", SIDES)
def test_it_quarters_the_error_of_a_frequency(shape):
    edges = dict.fromkeys(("x0", "x1", "y0", "y1"), "simply_supported")
    sides, found = SIDES[shape], []
    for effects in ({}, {"finer": MeshDiscretisation()}):
        model = PlateModel(Mesh(*sides, 5, 4, edges=edges), {"plate": Plate(), **effects}, _plate())
        found.append(float(model.natural_frequencies(NONE, 1)))
    flexural = 70e9 * 0.003**3 / (12 * (1 - 0.33**2))
    exact = math.pi / 2 * math.sqrt(flexural / (2700.0 * 0.003)) * sum(1 / side**2 for side in sides)
    # The error falls as h²: to a quarter, less what is of order h⁴ in the coarse one.
    assert (found[1] - exact) / (found[0] - exact) == pytest.approx(0.25, abs=0.03)


def _plate() -> dict[str, float]:
    return {key: value for key, value in KNOWN.items() if key.startswith("plate")}


def test_a_mesh_that_is_not_finer_is_refused():
    with pytest.raises(ValueError, match="at least 2, got 1"):
        MeshDiscretisation(1)
