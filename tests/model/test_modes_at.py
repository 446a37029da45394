"""Modes at places are those of the model, and have derivatives, where frequencies repeat, too."""

import pytest
import torch

from torchplate.effects import Plate, PointMass
from torchplate.model import PlateModel, Searched, modes_at
from torchplate.plate import Mesh

KNOWN = {"plate.poisson_ratio": 0.3, "plate.youngs_modulus": 2.0e11, "plate.density": 7860.0, "lump.x": 0.3}
BOX = {"plate.thickness": Searched(0.002, 0.004), "lump.mass": Searched(0.0, 0.2)}
PLACE = torch.tensor([[0.1, 0.2], [0.9, 0.3], [0.55, 0.7], [0.2, 0.95]], dtype=torch.float64)
SIX = slice(3, 9)  # beyond the rigid-body modes, which are any mixture of three


def plate(side: float) -> PlateModel:
    return PlateModel(Mesh(0.41, side, 5, 5), {"plate": Plate(), "lump": PointMass()}, KNOWN | {"lump.y": 0.4}, BOX)


def test_they_are_the_models_modes_at_these_places():
    model = plate(0.29)
    theta = torch.tensor([[0.003, 0.05], [0.0025, 0.1]], dtype=torch.float64)
    found, whole = modes_at(model, theta, PLACE, 9), model.modes(theta)
    torch.testing.assert_close(found.frequency[:, SIX], whole.frequency[:, SIX])
    shape = (model.assembly.rows(model.mesh.deflection_at(PLACE)) @ whole.shape[..., SIX]).mT
    torch.testing.assert_close(found.shape[:, SIX].abs(), shape.abs())
    assert modes_at(model, theta[0], PLACE, 10_000).frequency.shape == (model.assembly.size,)


# torch compiles rules of its own by a function that it has itself deprecated.
@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
@pytest.mark.parametrize("part", ["frequency", "shape"])
def test_their_derivatives_are_exact(part):
    model = plate(0.29)

    def of(position: torch.Tensor) -> torch.Tensor:
        return getattr(modes_at(model, model.space.to_si(position), PLACE, 9), part)[SIX]

    place, step = torch.tensor([0.4, 0.3], dtype=torch.float64), 1e-5
    found = torch.func.jacfwd(of)(place)
    shifts = step * torch.eye(2, dtype=torch.float64)
    differences = torch.stack([(of(place + one) - of(place - one)) / (2 * step) for one in shifts], dim=-1)
    # The shapes keep their signs over so small a step; central differences are right to about step².
    torch.testing.assert_close(found, differences, rtol=1e-4, atol=1e-4 * float(differences.abs().max()))
    torch.testing.assert_close(torch.func.jacrev(of)(place), found, rtol=1e-6, atol=1e-9 * float(found.abs().max()))


@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
def test_where_frequencies_repeat_derivatives_stay_finite():
    model = plate(0.41)
    bare = torch.tensor([0.5, 0.0], dtype=torch.float64)
    frequency = modes_at(model, model.space.to_si(bare), PLACE, 9).frequency
    assert float(frequency[7] / frequency[6] - 1) < 1e-6  # modes 7 and 8 of a square plate
    slope = torch.func.jacfwd(lambda u: modes_at(model, model.space.to_si(u), PLACE, 9).shape)(bare)
    assert bool(slope.isfinite().all())


@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
def test_shapes_of_a_pair_that_all_but_agrees_have_a_slope_that_is_blunted():
    """They turn into each other at once: one over what parts them is no derivative that a step could follow."""
    model = plate(0.41 * (1 + 1e-8))
    bare = torch.tensor([0.5, 0.0], dtype=torch.float64)
    frequency = modes_at(model, model.space.to_si(bare), PLACE, 9).frequency
    assert 1e-10 < float(frequency[7] / frequency[6] - 1) < 1e-7
    slope = torch.func.jacfwd(lambda u: modes_at(model, model.space.to_si(u), PLACE, 9).shape)(bare)
    # A mass m turns a pair by ½ m φ² / w, with m 0.2 kg, φ² of 16 / 4 kg at most and w = 1e-5; the place moves by 2 φ.
    assert 1.0 < float(slope[SIX].abs().max()) < 2 * 0.5 * 0.2 * 4 * 2 / 1e-5
