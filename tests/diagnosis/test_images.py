"""Mirror images of what sits at a place: which there are, and that a change is found from its image."""

import pytest
import torch

from torchplate.diagnosis.candidates.images import images
from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

NUMBERS = {"plate.youngs_modulus": 2e11, "plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003}


def model(name: str, sides: tuple[float, float], **searched: Searched) -> PlateModel:
    effects = {"plate": CATALOGUE["plate"](), "one": CATALOGUE[name]()}
    mesh = Mesh(*sides, 4, 4)
    return PlateModel(mesh, effects, NUMBERS, {f"one.{key}": own for key, own in searched.items()})


@pytest.mark.parametrize("sides", [(0.43, 0.3), (0.3, 0.3)])
def test_each_image_has_the_natural_frequencies_of_the_place_itself(sides):
    one = model("point_mass", sides, x=Searched(0.0, 1.0), y=Searched(0.0, 1.0), mass=Searched(0.0, 0.1))
    place = torch.tensor([0.21, 0.34, 0.6], dtype=torch.float64)
    found = images(one, place, "one")
    assert len(found) == (7 if sides[0] == sides[1] else 3)
    own = one.natural_frequencies(one.space.to_si(place), 10)[3:]
    others = one.natural_frequencies(one.space.to_si(found), 10)[:, 3:]
    assert float((others / own - 1).abs().max()) < 1e-8
    assert len({tuple(row) for row in found.tolist()} | {tuple(place.tolist())}) == len(found) + 1


def test_both_ends_of_a_rib_turn_over_together():
    keys = ("x0", "y0", "x1", "y1")
    one = model("rib", (0.43, 0.3), **{key: Searched(0.0, 1.0) for key in keys}, bending=Searched(0.0, 9.0))
    place = torch.tensor([0.1, 0.2, 0.7, 0.9, 0.5], dtype=torch.float64)
    assert [0.9, 0.2, 0.3, 0.9, 0.5] in [pytest.approx(row) for row in images(one, place, "one").tolist()]


def test_what_sits_nowhere_has_no_images():
    one = model("density", (0.43, 0.3), value=Searched(7000.0, 8000.0))
    assert images(one, torch.tensor([0.3], dtype=torch.float64), "one").shape == (0, 1)
