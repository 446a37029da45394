"""A spring or a dashpot to the ground that nobody drew."""

import math

import pytest
import torch

from torchplate.effects import CATALOGUE, GroundDashpot, GroundSpring, HystereticDamping, Plate
from torchplate.model import PlateModel
from torchplate.plate import Mesh

KNOWN = {
    "plate.youngs_modulus": 70e9,
    "plate.poisson_ratio": 0.33,
    "plate.density": 2700.0,
    "plate.thickness": 0.003,
    "loss.stiffness_loss_factor": 0.02,
}
NONE = torch.zeros(0, dtype=torch.float64)
PLACE = (0.37, 0.81)
LINES = torch.tensor([11.0, 63.0, 154.0, 310.0], dtype=torch.float64)
MESHES = {"rectangle": Mesh(0.5, 0.3, 6, 4), "square": Mesh(0.4, 0.4, 5, 5, edges={"x1": "simply_supported"})}


def _stiffness_there(mesh: Mesh, effects: dict, value: dict[str, float]) -> torch.Tensor:
    """1/α of the point where the effect acts [N/m]."""
    known = KNOWN | {"added.x": PLACE[0], "added.y": PLACE[1]} | value if effects else KNOWN
    model = PlateModel(mesh, {"plate": Plate(), "loss": HystereticDamping(), **effects}, known)
    return 1 / model.frf(NONE, LINES, [PLACE], [PLACE])[:, 0, 0]


@pytest.mark.parametrize("shape", MESHES)
def test_a_spring_adds_its_stiffness_at_its_point(shape):
    mesh, stiffness = MESHES[shape], 3.1e4
    bare = _stiffness_there(mesh, {}, {})
    gain = _stiffness_there(mesh, {"added": GroundSpring()}, {"added.stiffness": stiffness}) - bare
    # β is the whole model's: a spring in it has the same.
    expected = torch.full_like(gain, stiffness * (1 + 0.02j))
    assert torch.allclose(gain, expected, rtol=1e-8, atol=1e-9 * float(bare.abs().max()))  # rounding of 1/α


@pytest.mark.parametrize("shape", MESHES)
def test_a_dashpot_adds_its_impedance_at_its_point(shape):
    mesh, viscous = MESHES[shape], 23.0
    bare = _stiffness_there(mesh, {}, {})
    gain = _stiffness_there(mesh, {"added": GroundDashpot()}, {"added.viscous_damping": viscous}) - bare
    expected = 1j * 2 * math.pi * LINES * viscous
    assert torch.allclose(gain, expected, rtol=1e-8, atol=1e-9 * float(bare.abs().max()))


def test_what_ties_the_plate_to_the_ground_at_a_place_says_so_and_nothing_else_does():
    found = {name: kind.to_ground for name, kind in CATALOGUE.items() if kind.to_ground}
    assert found == {"ground_spring": "stiffness", "ground_dashpot": "viscous_damping"}
    for name, key in found.items():
        # A support there has a parameter of that name and unit.
        own, of_support = (CATALOGUE[kind].parameters[key] for kind in (name, "support_spring"))
        assert own.unit == of_support.unit
        assert {"x", "y"} <= CATALOGUE[name].parameters.keys()
