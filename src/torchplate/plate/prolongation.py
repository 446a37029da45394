"""Motions of a mesh as motions of the mesh twice as fine: what its shape functions say at the finer nodes."""

import torch
from scipy.sparse import coo_array, csr_array, diags_array

from torchplate.plate import element
from torchplate.plate.mesh import DOFS_PER_NODE, Mesh

# Deflection and its two slopes, by the orders of their derivatives.
OF_NODE = ((0, 0), (1, 0), (0, 1))


def prolongation(mesh: Mesh, finer: Mesh) -> csr_array:
    """Free dofs of the finer mesh from those of a mesh [n_free_finer, n_free].

    Slopes across the sides of elements, which the 12-dof rectangle leaves open, are the mean of both elements'.

    Args:
        mesh: any.
        finer: the same with twice as many elements along each side.
    """
    half = torch.arange(3, dtype=torch.float64) / 2
    inside = torch.cartesian_prod(half, half).flip(-1)
    sides = 1 / mesh.cells[0], 1 / mesh.cells[1]
    told = torch.stack([element.shape_functions(inside, *sides, *orders) for orders in OF_NODE], dim=1)
    # What a node's own dofs make of deflection and slopes there; the same on both meshes.
    convention = told[0, :, :DOFS_PER_NODE]
    rows = torch.linalg.solve(convention, told)
    column, row = mesh.element_dof, _finer_dof(mesh)
    n = len(row)
    entries = rows.reshape(-1, element.N_DOF).expand(n, -1, -1)
    place = row[..., None].expand(entries.shape), column[:, None].expand(entries.shape)
    whole = coo_array((entries.flatten(), tuple(one.flatten() for one in place)), (finer.n_dof, mesh.n_dof)).tocsr()
    shared = torch.bincount(row.flatten(), minlength=finer.n_dof).clamp(min=1)
    mean = diags_array(1 / shared.double().numpy()) @ whole
    return csr_array(mean[finer.free_dof.numpy()][:, mesh.free_dof.numpy()])


def _finer_dof(mesh: Mesh) -> torch.Tensor:
    """Dofs of the finer mesh at corners, middles of sides and the centre of each element [n_element, 27]."""
    n_x, n_y = mesh.cells
    corner = 2 * torch.arange(n_x) + 2 * (2 * n_x + 1) * torch.arange(n_y)[:, None]
    corner = corner.flatten() if mesh.kept is None else corner.flatten()[mesh.kept]
    step = torch.arange(3)
    node = corner[:, None] + (step + (2 * n_x + 1) * step[:, None]).flatten()
    return (DOFS_PER_NODE * node[..., None] + torch.arange(DOFS_PER_NODE)).flatten(1)
