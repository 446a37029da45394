"""Springs and dashpots to the ground."""

import math

import pytest
import torch

from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.model import PlateModel
from torchplate.plate import Mesh

STEEL = {"plate.youngs_modulus": 210e9, "plate.poisson_ratio": 0.3, "plate.density": 7800.0, "plate.thickness": 0.02}


def test_a_stiff_plate_bounces_and_rocks_on_its_springs_as_a_rigid_body():
    stiffness, side_x, side_y = 900.0, 0.3, 0.2
    corners = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0))
    effects = {"plate": Plate(), "wires": SupportSpring(at=corners)}
    model = PlateModel(Mesh(side_x, side_y, 3, 2), effects, STEEL | {"wires.stiffness": stiffness})
    mass = 7800.0 * 0.02 * side_x * side_y
    # Bounce 4k/m; rocking about an axis: 4k (L/2)² over m L²/12, that is three times as much for either axis.
    expected = [math.sqrt(factor * stiffness / mass) / (2 * math.pi) for factor in (4, 12, 12)]
    found = model.natural_frequencies(torch.zeros(0, dtype=torch.float64), 3)
    # The first bending mode lies at 1 kHz, so flexibility lowers these by some (3/1000)².
    assert found.tolist() == pytest.approx(expected, rel=1e-4)


def test_nodes_and_relative_places_name_the_same_supports():
    theta = torch.zeros(0, dtype=torch.float64)
    lines = torch.tensor([3.0, 40.0, 410.0], dtype=torch.float64)
    known = STEEL | {"wires.stiffness": 3e4, "wires.viscous_damping": 2.0, "loss.stiffness_loss_factor": 0.01}
    found = []
    for wires in (SupportSpring(nodes=(2, 11)), SupportSpring(at=((0.25, 0.0), (0.0, 2 / 3)))):
        effects = {"plate": Plate(), "loss": HystereticDamping(), "wires": wires}
        found.append(PlateModel(Mesh(0.4, 0.3, 4, 3), effects, known).frf(theta, lines, [7], [13]))
    assert torch.allclose(found[0], found[1], rtol=1e-12)


@pytest.mark.parametrize("places", [{}, {"nodes": (1,), "at": ((0.5, 0.5),)}])
def test_both_or_neither_way_of_naming_the_places_is_refused(places):
    with pytest.raises(ValueError, match="either `nodes`"):
        SupportSpring(**places)
