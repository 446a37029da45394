"""A plate that is thicker at one side than at the other."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Interval, Parameter, Prior
from torchplate.plate import Mesh, Section

# Thinner than nothing at a corner is no plate; at the centres of the elements h is then above zero.
SLOPE = Interval(-1.0, 1.0)


@dataclass(frozen=True)
class ThicknessTaper(Effect):
    """h(x, y) = h (1 + slope_x (x − ½) + slope_y (y − ½)), x and y relative, constant over each element."""

    parameters = {
        "slope_x": Parameter(
            "-", "change of h from x = 0 to x = 1, over h", SLOPE, neutral=0.0, prior=Prior(-0.3, 0.3)
        ),
        "slope_y": Parameter(
            "-", "change of h from y = 0 to y = 1, over h", SLOPE, neutral=0.0, prior=Prior(-0.3, 0.3)
        ),
    }
    check = Check(2, "measure the thickness with a calliper near all four corners")
    acts_on = frozenset({"section"})
    shows = (
        "Mode shapes lean to the thin side, so FRFs at opposite ends differ; frequencies move by the slope's square."
    )
    source = "Leissa, Vibration of Plates, NASA SP-160 (1969), plates of variable thickness"

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The thickness of each element, at its centre."""
        x, y = (mesh.element_place.to(value["slope_x"]) - 0.5).unbind(-1)
        relative = 1 + value["slope_x"][..., None] * x + value["slope_y"][..., None] * y
        return section._replace(thickness=section.thickness * relative)
