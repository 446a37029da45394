"""How well fitted numbers are known, and which of them the data see together alone.

No direction is known less than a uniform distribution over the box leaves it: where some numbers undo one another, as a
loss factor of the whole plate and the same in all its directions, none of them is known by itself.
"""

import torch
from jaxtyping import Float
from torch import Tensor

# Precision of a uniform distribution on the unit cube, along each side, one over its variance: nobody chose it.
UNIFORM = 12.0
# A number of which the data say less than this part of what they say of another is not seen at all.
TINY = 1e-9


def covariance(
    information: Float[Tensor, "n n"], known: Float[Tensor, " n"], slope: Float[Tensor, " n"]
) -> Float[Tensor, "n n"]:
    """Of parameters in SI units; NaN where neither the data nor anything else says something.

    Args:
        information: of the data, on the unit cube.
        known: what is known of each beforehand, likewise.
        slope: SI units for a unit of the cube.
    """
    seen, norm, value, vector, box = _directions(information, known)
    whole = information.new_full(information.shape, torch.nan)
    side = slope[seen] / norm
    half = vector * side[:, None] / torch.maximum(value, box).sqrt()
    whole[seen[:, None] & seen] = (half @ half.mT).flatten()
    return whole


def seen_together(information: Float[Tensor, "n n"], known: Float[Tensor, " n"]) -> list[list[int]]:
    """For each direction along which the box alone limits them, the numbers that lie along it.

    Args:
        information: of the data, on the unit cube.
        known: what is known of each beforehand, likewise.
    """
    seen, _, value, vector, box = _directions(information, known)
    index = seen.nonzero().flatten()
    variance = vector.square() / torch.maximum(value, box)
    # A number lies along a direction that makes more than half of its variance.
    along = variance > 0.5 * variance.sum(-1, keepdim=True)
    return [index[column].tolist() for column in along[:, value < box].mT if int(column.sum()) > 1]


def _directions(information: Tensor, known: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Which numbers are seen, what is known of each, the directions in which, and what the box says along each."""
    precision = information + torch.diag(known)
    norm = precision.diagonal().clamp(min=0.0).sqrt()
    seen = norm > TINY * norm.max().clamp(min=1e-300) if len(norm) else norm > 0
    norm = norm[seen]
    value, vector = torch.linalg.eigh(precision[seen][:, seen] / norm / norm[:, None])
    return seen, norm, value, vector, UNIFORM * (vector / norm[:, None]).square().sum(0)
