"""Complex modes of many members, those that nearly share them found from one another.

The members of a Jacobian by differences, and the tangents of a score test, differ by 1e-5 of a parameter and less. With
the vectors V of one of them, W = V⁻¹ A V of the next is nearly diagonal, and to first order its own are

    V (I + E),    E_ij = W_ij / (w_j − w_i),    w = diag W.

Each such step squares what is missing (Newton's method for all pairs at once; Ogita and Aishima, Japan J. Indust. Appl.
Math. 35 (2018) 1007, for symmetric matrices): two or three of them, all products of matrices, end at rounding, where
`eig` takes some ten times as long.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Complex
from torch import Tensor

from torchplate.model.receptance.batched import solve_each

# Greatest E at which members are near: what is missing goes by its square, so that four steps end at rounding.
NEAR = 0.03
# Greatest E after which its square is below rounding.
AT_REST = 1e-8
# Steps at most: 0.03, 9e-4, 8e-7, 7e-13.
MOST_STEPS = 5


class ComplexModes(NamedTuple):
    """A = V diag(value) V⁻¹ of each member."""

    value: Complex[Tensor, "*batch n"]
    shape: Complex[Tensor, "*batch n n"]
    inverse: Complex[Tensor, "*batch n n"]


def complex_modes(matrix: Complex[Tensor, "*batch n n"]) -> ComplexModes:
    """All eigenvalues and vectors of each member, one `eig` for all that are near one another.

    Args:
        matrix: A, its diagonal the largest part of it, as in coordinates of undamped modes.
    """
    flat = matrix.reshape(-1, *matrix.shape[-2:])
    value, (shape, inverse) = flat.new_empty(flat.shape[:-1]), (torch.empty_like(flat) for _ in range(2))
    left = torch.arange(len(flat))
    while len(left):
        first, others = left[0], left[1:]
        value[first], shape[first] = torch.linalg.eig(flat[first])
        inverse[first] = torch.linalg.inv(shape[first])
        near = others[_are_near(flat[first], flat, others)]
        if len(near):
            known = ComplexModes(*(part[first] for part in (value, shape, inverse)))
            found, sound = _from_one(known, flat[near])
            for whole, part in zip((value, shape, inverse), found, strict=True):
                whole[near] = part
            others = others[~torch.isin(others, near[sound])]
        left = others
    batch = matrix.shape[:-2]
    return ComplexModes(*(part.reshape(*batch, *part.shape[1:]) for part in (value, shape, inverse)))


def _are_near(one: Tensor, every: Tensor, others: Tensor) -> Bool[Tensor, " n_other"]:
    """Which of some members differ from one by little beside how far its diagonal entries are apart."""
    diagonal = one.diagonal()
    gap = (diagonal - diagonal[:, None]).abs()
    gap.fill_diagonal_(torch.inf)
    # What it takes to compare whole matrices is for those whose diagonals are alike.
    own = (every[others].diagonal(dim1=-2, dim2=-1) - diagonal).abs()
    near = (own <= NEAR * gap.amin(0)).all(-1)
    change = (every[others[near]] - one).abs()
    near[near.clone()] = (change <= NEAR * gap).flatten(1).all(-1)
    return near


def _from_one(known: ComplexModes, matrix: Complex[Tensor, "n_member n n"]) -> tuple[ComplexModes, Tensor]:
    """The modes of members that are near one whose modes are known, and which of them came to rest."""
    own = torch.eye(matrix.shape[-1]).to(matrix)
    shape, inverse = known.shape.expand_as(matrix), known.inverse.expand_as(matrix)
    value, worst = matrix.diagonal(dim1=-2, dim2=-1), matrix.real.new_full((len(matrix),), torch.inf)
    for _ in range(MOST_STEPS):
        turned = inverse @ (matrix @ shape)
        value = turned.diagonal(dim1=-2, dim2=-1)
        apart = value[:, None, :] - value[:, :, None] + own
        more = turned * (1 - own) / apart
        worst = more.abs().flatten(1).amax(-1)
        shape, inverse = shape + shape @ more, solve_each(own + more, inverse)
        if bool((worst <= AT_REST).all()) or bool((worst > 1).any()):
            break
    return ComplexModes(value, shape, inverse), worst <= AT_REST
