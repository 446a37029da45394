"""Rows over the dofs of a mesh, times matrices."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.plate.transforms import transformed

# Rows of a member from which on leaving out the dofs that none of them sees is sooner done.
MANY = 32


def times(
    rows: Float[Tensor, "*batch n_row n_dof"], matrix: Float[Tensor, "n_dof n"]
) -> Float[Tensor, "*batch n_row n"]:
    """Rows times a matrix; of many rows, as along a line of the plate, without the dofs that none of them sees.

    Each member by itself then, on a CPU, so that its digits do not hang on which others are beside it. Not where a
    derivative is asked for: what a row does not see it may begin to.
    """
    if rows.shape[-2] < MANY or rows.device.type != "cpu" or rows.requires_grad or transformed():
        return rows @ matrix
    found = []
    for one in rows.reshape(-1, *rows.shape[-2:]):
        seen = (one != 0).any(dim=0).nonzero()[:, 0]
        found.append(one[:, seen] @ matrix[seen])
    return torch.stack(found).reshape(*rows.shape[:-1], matrix.shape[-1]) if found else rows @ matrix
