"""An orthotropic plate that was not cut along its grain: wood, a rolled sheet, a laminate laid askew."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class GrainAngle(Effect):
    """D becomes TᵀDT: the axes of E_x and E_y are turned by an angle from the sides, positive from x towards y.

    A plate with E_x = E_y and an isotropic G has no grain, and its angle changes nothing.
    """

    parameters = {
        "angle": Parameter("rad", "from the side x to the axis of E_x", neutral=0.0, prior=Prior(-0.8, 0.8)),
    }
    check = Check(2, "look at the grain, or the rolling marks, with a protractor")
    acts_on = frozenset({"section"})
    shows = (
        "Bending and torsion mix: nodal lines turn, and the plate answers differently at its two diagonals, which are "
        "alike where the grain is straight."
    )
    source = "Lekhnitskii, Anisotropic Plates (1968), on the change of axes"

    @classmethod
    def may_be_missing(cls, section: Section) -> bool:
        """On a plate with a grain only."""
        return bool((section.young_ratio != 1).any() | (section.shear_factor != 1).any())

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The angle, beside one that is there already."""
        angle = value["angle"][..., None]
        return section._replace(grain_angle=angle if section.grain_angle is None else section.grain_angle + angle)
