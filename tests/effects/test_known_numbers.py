"""A number of the plate that is not what was taken as known."""

import pytest
import torch

from torchplate.effects import CATALOGUE, Plate, ThicknessTaper
from torchplate.model import PlateModel
from torchplate.plate import Mesh

STEEL = {"plate.youngs_modulus": 205e9, "plate.poisson_ratio": 0.29, "plate.density": 7850.0, "plate.thickness": 0.002}
NONE = torch.zeros(0, dtype=torch.float64)
MESHES = {"rectangle": Mesh(0.5, 0.3, 5, 4), "square": Mesh(0.4, 0.4, 5, 5, edges={"y1": "clamped"})}


def bending(mesh, effects=None, known=None) -> torch.Tensor:
    """The lowest ten frequencies above the rigid-body modes, if there are any [Hz]."""
    model = PlateModel(mesh, {**(effects or {}), "plate": Plate()}, STEEL | (known or {}))
    return model.natural_frequencies(NONE, 13)[3:]


@pytest.mark.parametrize("shape", MESHES)
@pytest.mark.parametrize(("name", "times", "power"), [("thickness", 1.3, 1.0), ("density", 0.8, -0.5)])
def test_frequencies_go_with_a_power_of_it(name, times, power, shape):
    mesh = MESHES[shape]
    found = bending(mesh, {name: CATALOGUE[name]()}, {f"{name}.value": times * STEEL[f"plate.{name}"]})
    assert torch.allclose(found, times**power * bending(mesh), rtol=1e-9)  # rounding of two eigenproblems


@pytest.mark.parametrize("shape", MESHES)
@pytest.mark.parametrize("name", ["thickness", "density", "poisson_ratio"])
def test_it_stands_in_place_of_the_plates_own_number(name, shape):
    mesh, number = MESHES[shape], STEEL[f"plate.{name}"] * 1.2
    found = bending(mesh, {name: CATALOGUE[name]()}, {f"{name}.value": number})
    assert torch.equal(found, bending(mesh, known={f"plate.{name}": number}))


def test_a_taper_is_a_part_of_the_new_thickness_in_whatever_order_a_config_names_them():
    mesh, values = MESHES["rectangle"], {"thickness.value": 0.003, "taper.slope_x": 0.4, "taper.slope_y": -0.1}
    both = {"taper": ThicknessTaper(), "thickness": CATALOGUE["thickness"]()}
    found = [bending(mesh, dict(order), values) for order in (both.items(), reversed(both.items()))]
    of_plate = {key: value for key, value in values.items() if key.startswith("taper")} | {"plate.thickness": 0.003}
    assert torch.equal(*found)
    assert torch.equal(found[0], bending(mesh, {"taper": ThicknessTaper()}, of_plate))
