"""A mass anywhere on the plate."""

import pytest
import torch

from torchplate.effects import Plate, PointMass
from torchplate.model import PlateModel
from torchplate.plate import Mesh

STEEL = {"plate.youngs_modulus": 205e9, "plate.poisson_ratio": 0.29, "plate.density": 7850.0, "plate.thickness": 0.002}
MESH = Mesh(0.5, 0.3, 6, 4)
NONE = torch.zeros(0, dtype=torch.float64)


def _model(x: float, y: float, mass: float) -> PlateModel:
    return PlateModel(
        MESH, {"plate": Plate(), "added": PointMass()}, STEEL | {"added.x": x, "added.y": y, "added.mass": mass}
    )


def test_a_small_mass_lowers_a_mode_by_its_squared_deflection_there():
    place, mass = (0.37, 0.81), 1e-6
    bare, loaded = _model(*place, 0.0), _model(*place, mass)
    modes = bare.modes(NONE)
    deflection = bare.assembly.rows(MESH.deflection_at(MESH.places([place]))) @ modes.shape
    # First-order perturbation: dω²/ω² = −m φ²; the next order is (m φ²)², about 1e-11 here.
    expected = -mass * deflection[0, 3:15] ** 2
    found = loaded.modes(NONE).eigenvalue[3:15] / modes.eigenvalue[3:15] - 1
    assert torch.allclose(found, expected, rtol=1e-3, atol=1e-11)


def test_the_whole_mass_of_the_model_grows_by_the_mass_added():
    rigid = MESH.rigid_translation
    gain = [rigid @ _model(0.23, 0.44, mass).system(NONE).mass @ rigid for mass in (0.0, 0.35)]
    assert float(gain[1] - gain[0]) == pytest.approx(0.35, rel=1e-9)


def test_a_heavy_mass_pins_the_plate_there():
    # An accelerance of the free plate cannot exceed 1/m at the mass.
    accelerance = _model(0.5, 0.5, 1e4).frf(
        NONE, torch.tensor([300.0], dtype=torch.float64), [(0.5, 0.5)], [(0.5, 0.5)]
    )
    assert float(accelerance.abs().max()) * (2 * torch.pi * 300.0) ** 2 == pytest.approx(1e-4, rel=1e-3)
