"""A patch that has lost bending stiffness (or gained some): a crack, a delamination, a doubler without mass."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.effects.effect import Effect, Value
from torchplate.effects.parameter import Parameter, Prior, positive, unit_interval
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class StiffnessLoss(Effect):
    """D times a factor under a square patch; elements that its edges cut are laminates of both.

    The patch is a square of side size · √(Lx Ly) in metres, on a rectangle too, its sides along those of the plate;
    what reaches over an edge is cut off. In a cut element compliances add across the cut and stiffnesses along it: a
    mean of the stiffnesses would be stiffer than both, one after the other. The parts of its sides that an element has
    under the patch are piecewise linear in x, y and size, so all three have a gradient.
    """

    parameters = {
        "x": Parameter("-", "centre along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y": Parameter("-", "centre along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "size": Parameter("-", "side of the square over √(Lx·Ly)", unit_interval, prior=Prior(0.05, 0.5)),
        "factor": Parameter(
            "-", "bending stiffness there over the sound one", positive, neutral=1.0, prior=Prior(0.1, 1.5)
        ),
    }
    acts_on = frozenset({"section"})
    shows = "Lowers each mode in proportion to its strain energy in the patch; modes that do not bend there stay."
    source = "Cawley and Adams, The location of defects in structures, J. Strain Analysis 14 (1979) 49"

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """What is left of the rigidity of each element."""
        along_x, along_y = mesh.coverage(value["x"], value["y"], value["size"])
        factor = value["factor"][..., None]
        left = _laminate(factor, along_x, along_y, section.poisson_ratio)
        # Where an edge of the patch crosses a corner of an element the order would matter a little.
        turned = _laminate(factor, along_y, along_x, section.poisson_ratio)[..., [1, 0, 2, 3]]
        return section._replace(stiffness_factor=section.stiffness_factor * 0.5 * (left + turned))


def _laminate(
    factor: Float[Tensor, "*#batch 1"],
    inner: Float[Tensor, "*#batch n_element"],
    outer: Float[Tensor, "*#batch n_element"],
    poisson_ratio: Float[Tensor, "*#batch #n_element"],
) -> Float[Tensor, "*batch n_element 4"]:
    """D₁₁, D₂₂, D₁₂ and D₃₃ of an element over the sound ones, if the patch covers such parts of its sides.

    Across a cut the moment is the same on both sides, along it the curvature: first laminated along the inner side,
    then the result and the sound rest along the outer one.
    """
    nu = poisson_ratio.square()
    mean, across = 1 + inner * (factor - 1), 1 / (1 + inner * (1 / factor - 1))
    beside = (1 - nu) * mean + nu * across
    second = 1 / (1 + outer * (1 / beside - 1))
    coupled = 1 + outer * (across / beside - 1)
    first = outer * (across - nu * across.square() / beside) + (1 - outer) * (1 - nu) + nu * coupled.square() * second
    parts = torch.broadcast_tensors(first, second, coupled * second, 1 + outer * (mean - 1))
    return torch.stack(parts, dim=-1)
