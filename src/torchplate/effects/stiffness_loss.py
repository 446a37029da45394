"""A patch that has lost bending stiffness (or gained some): a crack, a delamination, a doubler without mass."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, patch_aspect, positive, unit_interval
from torchplate.plate import Mesh, Section, patched


@dataclass(frozen=True)
class StiffnessLoss(Effect):
    """D times a factor under a rectangular patch; what its edges cut of elements is integrated: see `patched`.

    The patch is a square of side size · √(Lx Ly) in metres, on a rectangle too, its sides along those of the plate,
    unless an aspect other than 1 makes it longer along one of them; what reaches over an edge is cut off. Across a cut
    moments are the same and compliances add, along it curvatures are and stiffnesses do. All that depends on the
    patch's place and sides has a gradient.
    """

    parameters = {
        "x": Parameter("-", "centre along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y": Parameter("-", "centre along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "size": Parameter("-", "root of its area over √(Lx·Ly)", unit_interval, prior=Prior(0.05, 0.5)),
        "factor": Parameter(
            "-", "bending stiffness there over the sound one", positive, neutral=1.0, prior=Prior(0.1, 1.5)
        ),
        "aspect": patch_aspect,
    }
    check = Check(3, "look at the place found (dye, tap test), and add a sensor off the symmetry line near it")
    acts_on = frozenset({"section"})
    shows = "Lowers each mode in proportion to its strain energy in the patch; modes that do not bend there stay."
    source = "Cawley and Adams, The location of defects in structures, J. Strain Analysis 14 (1979) 49"

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """What is left of the rigidity of each element."""
        return patched(section, mesh, value["factor"], value["x"], value["y"], value["size"], value["aspect"])
