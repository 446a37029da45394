"""Elements that the edges of a patch cut."""

import torch
from jaxtyping import Inexact
from torch import Tensor


def laminate(
    factor: Inexact[Tensor, "*#batch 1"],
    along_x: Inexact[Tensor, "*#batch n_element"],
    along_y: Inexact[Tensor, "*#batch n_element"],
    poisson_ratio: Inexact[Tensor, "*#batch #n_element"],
) -> Inexact[Tensor, "*batch n_element 4"]:
    """D₁₁, D₂₂, D₁₂ and D₃₃ of each element over the sound ones, where a patch covers parts of its sides [-].

    Across a cut the moment is the same on both sides, along it the curvature: so compliances add across it and
    stiffnesses along it. A mean of the stiffnesses would be stiffer than both, one after the other.

    Args:
        factor: bending stiffness under the patch over the sound one [-]; complex where it dissipates.
        along_x: part of each element's side along x that lies under the patch, 0 to 1; see `Mesh.coverage`.
        along_y: along y.
        poisson_ratio: √(ν_x ν_y).

    Source: the laminate theory of layers in series, Milton, The Theory of Composites (2002), chapter 9, for bending.
    """
    # Where an edge of the patch crosses a corner of an element the order matters a little.
    first = _cut_twice(factor, along_x, along_y, poisson_ratio)
    second = _cut_twice(factor, along_y, along_x, poisson_ratio)[..., [1, 0, 2, 3]]
    return 0.5 * (first + second)


def _cut_twice(factor: Tensor, inner: Tensor, outer: Tensor, poisson_ratio: Tensor) -> Tensor:
    """Laminated along the inner side, then the result and the sound rest along the outer one."""
    nu = poisson_ratio.square()
    mean, across = 1 + inner * (factor - 1), (1 + inner * (factor.reciprocal() - 1)).reciprocal()
    beside = (1 - nu) * mean + nu * across
    second = (1 + outer * (beside.reciprocal() - 1)).reciprocal()
    coupled = 1 + outer * (across / beside - 1)
    first = outer * (across - nu * across.square() / beside) + (1 - outer) * (1 - nu) + nu * coupled.square() * second
    parts = torch.broadcast_tensors(first, second, coupled * second, 1 + outer * (mean - 1))
    return torch.stack(parts, dim=-1)
