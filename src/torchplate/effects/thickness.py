"""A thickness that was taken from a drawing, and is another one."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, positive
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class Thickness(Effect):
    """h = value, whatever the plate's own number: D ∝ h³, mass ∝ h, so ω ∝ h.

    The plate keeps the number that was taken as known, so that a config says both.
    """

    parameters = {
        "value": Parameter(
            "m",
            "thickness h, in place of the plate's",
            positive,
            # A slip of the pen, 2 mm for 3 mm, too.
            prior=Prior(0.5, 2.0, logarithmic=True, relative_to="thickness"),
        )
    }
    check = Check(2, "measure the thickness with a calliper at several points, to 0.01 mm")
    acts_on = frozenset({"section"})
    shows = (
        "All bending frequencies move by one ratio, that of h, and the level with the mass; E and ρ do nearly the same."
    )
    source = "Leissa, Vibration of Plates, NASA SP-160 (1969), chapter 1"
    stage = 1

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The plate's section with another h."""
        return section._replace(thickness=value["value"][..., None])
