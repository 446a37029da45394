"""Rows, chunks and solves of batches, where torch alone would broadcast wrongly or solve wrongly."""

from collections.abc import Sequence

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.plate import common_shape

# Dofs up to which batches of complex matrices are seen to be right with any number of threads.
SOLVED_TOGETHER = 100


def solve_each(
    matrix: Complex[Tensor, "*batch n n"], right: Complex[Tensor, "*#batch n n_right"]
) -> Complex[Tensor, "*batch n n_right"]:
    """matrix⁻¹ right for a batch; large matrices one at a time.

    A batch of them comes out wrong, or never, where several threads of oneMKL share it (torch 2.13: ZLASWP is given
    pivots of another matrix).
    """
    # Under vmap torch broadcasts the batches of the two wrongly.
    right = right.expand(*matrix.shape[:-2], *right.shape[-2:])
    if matrix.shape[-1] <= SOLVED_TOGETHER or matrix.ndim == 2:
        return torch.linalg.solve(matrix, right)
    pairs = zip(matrix.flatten(0, -3), right.flatten(0, -3), strict=True)
    return torch.stack([torch.linalg.solve(*pair) for pair in pairs]).unflatten(0, matrix.shape[:-2])


def joined(parts: Sequence[Tensor], dim: int) -> Tensor:
    """Chunks put together; a single one is not copied."""
    return parts[0] if len(parts) == 1 else torch.cat(list(parts), dim=dim)


def stack_rows(
    first: Float[Tensor, "*#batch n_first n"], second: Float[Tensor, "*#batch n_second n"]
) -> Float[Tensor, "*batch n_both n"]:
    """Rows under rows, whatever batch each has."""
    batch = common_shape(first.shape[:-2], second.shape[:-2])
    return torch.cat([rows.expand(*batch, *rows.shape[-2:]) for rows in (first, second)], dim=-2)
