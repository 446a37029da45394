"""What an uneven plate has beside a uniform one: in proportion for other plates, not at all for one with a hole."""

import pytest
import torch

from torchplate.plate import Assembly, Geometry, Mesh
from torchplate.plate.correction import Correction, Unevenness

MESH = Mesh(0.4, 0.3, 2, 2)
GEOMETRY = Geometry(torch.tensor(0.4).double(), torch.tensor(0.3).double())
RIGIDITY = 12.0 * torch.tensor([[1.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 0.35]], dtype=torch.float64).expand(
    4, 3, 3
)
AREAL_MASS = torch.full((4,), 8.0, dtype=torch.float64)


def matrices(assembly, left):
    """Stiffness and mass where of the first element so much is left."""
    part = torch.tensor([left, 1.0, 1.0, 1.0], dtype=torch.float64)
    return assembly.stiffness(RIGIDITY * part[:, None, None], GEOMETRY), assembly.mass(AREAL_MASS * part, GEOMETRY)


@pytest.mark.parametrize(("left", "part"), [(1.0, 1.0), (0.2, 0.8), (1e-6, 0.0)])
def test_other_plates_have_it_in_proportion_and_one_with_a_hole_not(left, part):
    even = Assembly(MESH)
    more = torch.eye(len(even.free), dtype=torch.float64)
    measured = Correction.measure(RIGIDITY, GEOMETRY), Unevenness.measure(AREAL_MASS, GEOMETRY)
    uneven = even.uneven(Unevenness(3.0 * more, 0.5 * more, *measured))
    for own, plain, size in zip(matrices(uneven, left), matrices(even, left), (3.0, 0.5), strict=True):
        assert torch.allclose(own - plain, part * size * more, atol=1e-9)
