"""Motions of a mesh on the mesh twice as fine."""

import dataclasses

import pytest
import torch

from torchplate.plate import Mesh, prolongation

HOLE = ((0.25, 0.25, 0.5, 0.75),)


def of_nodes(mesh: Mesh, convention: torch.Tensor) -> torch.Tensor:
    """Free dofs of w = x³ + x²y − 2 xy² + y³ + x − y + 1, relative places taken."""
    x, y = mesh.node_place.unbind(-1)
    w = x**3 + x**2 * y - 2 * x * y**2 + y**3 + x - y + 1
    along_x, along_y = 3 * x**2 + 2 * x * y - 2 * y**2 + 1, x**2 - 4 * x * y + 3 * y**2 - 1
    told = torch.stack([w, along_x, along_y], dim=-1)
    return torch.linalg.solve(convention, told[..., None]).flatten()[mesh.free_dof]


@pytest.mark.parametrize("cut", [(), HOLE])
def test_a_cubic_stays_what_it_is(cut):
    """The 12-dof rectangle holds every cubic: its values and slopes at the finer nodes are the cubic's."""
    mesh = Mesh(0.5, 0.3, 8, 4, cut=cut)
    finer = dataclasses.replace(mesh, refine=2)
    orders = ((0, 0), (1, 0), (0, 1))
    convention = torch.stack([mesh.deflection_at(torch.zeros(1, 2).double(), *one)[0, :3] for one in orders])
    assert convention.count_nonzero() == 3
    moved = torch.from_numpy(prolongation(mesh, finer) @ of_nodes(mesh, convention).numpy())
    assert torch.allclose(moved, of_nodes(finer, convention), rtol=0, atol=1e-12)


def test_what_an_edge_holds_stays_held():
    mesh = Mesh(0.5, 0.3, 4, 3, edges={"x0": "clamped", "y1": "simply_supported"})
    found = prolongation(mesh, dataclasses.replace(mesh, refine=2))
    assert found.shape == (len(dataclasses.replace(mesh, refine=2).free_dof), len(mesh.free_dof))
    assert (abs(found).sum(axis=1) > 0).all()
