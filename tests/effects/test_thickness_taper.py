"""A plate that is thicker at one side."""

import pytest
import torch

from torchplate.effects import HystereticDamping, Plate, ThicknessTaper
from torchplate.model import PlateModel
from torchplate.plate import Mesh

KNOWN = {
    "plate.youngs_modulus": 205e9,
    "plate.poisson_ratio": 0.29,
    "plate.density": 7850.0,
    "plate.thickness": 0.002,
    "loss.stiffness_loss_factor": 0.01,
}
NONE = torch.zeros(0, dtype=torch.float64)
MESHES = {"rectangle": Mesh(0.5, 0.3, 6, 4), "square": Mesh(0.4, 0.4, 5, 5)}


def _model(mesh: Mesh, slope_x: float, slope_y: float) -> PlateModel:
    effects = {"plate": Plate(), "loss": HystereticDamping(), "taper": ThicknessTaper()}
    return PlateModel(mesh, effects, KNOWN | {"taper.slope_x": slope_x, "taper.slope_y": slope_y})


@pytest.mark.parametrize("shape", MESHES)
def test_it_moves_the_centre_of_mass_and_keeps_the_mass(shape):
    mesh, slopes = MESHES[shape], (0.3, -0.42)
    matrix = _model(mesh, *slopes).system(NONE).mass
    one = mesh.rigid_translation
    # Rigid rotations as dofs: w = x − ½ has −∂w/∂x = −1, w = y − ½ has ∂w/∂y = 1.
    x, y = (mesh.node_place - 0.5).unbind(-1)
    about = [torch.stack([x, 0 * x, 0 * x - 1], -1).flatten(), torch.stack([y, 0 * y + 1, 0 * y], -1).flatten()]
    mass = 7850.0 * 0.002 * mesh.length_x * mesh.length_y
    assert float(one @ matrix @ one) == pytest.approx(mass, rel=1e-12)
    for rotation, slope, n in zip(about, slopes, mesh.cells, strict=True):
        # ∫ s (x − ½)² = s/12, less the part within an element, where h is constant.
        assert float(one @ matrix @ rotation) == pytest.approx(mass * slope * (1 - 1 / n**2) / 12, rel=1e-9)


@pytest.mark.parametrize("shape", MESHES)
def test_the_opposite_slope_is_the_plate_seen_from_the_other_side(shape):
    mesh, lines = MESHES[shape], torch.tensor([30.0, 71.0, 240.0], dtype=torch.float64)
    there = _model(mesh, 0.35, 0.2).frf(NONE, lines, [(0.1, 0.3)], [(0.8, 0.9)])
    mirrored = _model(mesh, -0.35, 0.2).frf(NONE, lines, [(0.9, 0.3)], [(0.2, 0.9)])
    assert torch.allclose(there, mirrored, rtol=1e-8)  # rounding of two eigenproblems
    assert not torch.allclose(there, _model(mesh, -0.35, 0.2).frf(NONE, lines, [(0.1, 0.3)], [(0.8, 0.9)]), rtol=1e-2)


def test_a_plate_thinner_than_nothing_is_refused():
    with pytest.raises(ValueError, match=r"Expected 'taper.slope_x' from -1 to 1"):
        _model(MESHES["rectangle"], 1.2, 0.0)
