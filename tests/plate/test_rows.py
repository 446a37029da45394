"""Rows over the dofs, times matrices."""

import pytest
import torch

from torchplate.effects import CATALOGUE
from torchplate.plate import Mesh
from torchplate.plate.rows import MANY, times


@pytest.fixture
def along():
    """Ribs of three members on a mesh of 12 × 8 elements: rows that see few dofs, others for each member."""
    ends = {"x0": [0.1, 0.2, 0.9], "y0": [0.5, 0.05, 0.9], "x1": [0.8, 0.2, 0.15], "y1": [0.5, 0.95, 0.3]}
    value = {name: torch.tensor(some, dtype=torch.float64) for name, some in ends.items()}
    strength = torch.ones(3, dtype=torch.float64)
    value |= {"bending": 10 * strength, "torsion": 5 * strength, "mass_per_length": 0.1 * strength}
    return CATALOGUE["rib"]().local(Mesh(0.6, 0.4, 12, 8), value).vector


def test_dofs_that_no_row_sees_are_left_out(along):
    matrix = torch.randn(along.shape[-1], 40, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert along.shape[-2] >= MANY
    found = times(along, matrix)
    torch.testing.assert_close(found, along @ matrix, rtol=1e-12, atol=1e-12 * float(found.abs().max()))
    # To the last digit, whoever is beside it.
    assert all(torch.equal(times(along[index], matrix), one) for index, one in enumerate(found))
    assert torch.equal(times(along[1:], matrix), found[1:])


def test_gradients_are_those_of_what_is_not_seen_yet_too(along):
    matrix = torch.randn(along.shape[-1], 7, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    slopes = []
    for product in (times, torch.matmul):
        rows = along.clone().requires_grad_()
        product(rows, matrix).square().sum().backward()
        slopes.append(rows.grad)
    torch.testing.assert_close(*slopes, rtol=1e-11, atol=1e-11 * float(slopes[1].abs().max()))
