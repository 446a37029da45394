"""A patch that has lost bending stiffness (or gained some): a crack, a delamination, a doubler without mass."""

from dataclasses import dataclass

from torchplate.effects.effect import Effect, Value
from torchplate.effects.parameter import Parameter, Prior, positive, unit_interval
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class StiffnessLoss(Effect):
    """D times 1 + (factor − 1) · coverage, coverage the part of each element that the patch covers.

    The patch is a square of side size · √(Lx Ly) in metres, on a rectangle too, its sides along those of the plate;
    what reaches over an edge is cut off. Coverage is piecewise linear in x, y and size, so all three have a gradient.
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
        """The stiffness factor of each element."""
        coverage = mesh.coverage(value["x"], value["y"], value["size"])
        return section._replace(
            stiffness_factor=section.stiffness_factor * (1 + (value["factor"] - 1)[..., None] * coverage)
        )
