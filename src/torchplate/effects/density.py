"""A density that was taken from a table, and is another one."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, positive
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class Density(Effect):
    """ρ = value, whatever the plate's own number: ω ∝ ρ^(−1/2), and every FRF of the free plate ∝ 1/ρ.

    The plate keeps the number that was taken as known, so that a config says both.
    """

    parameters = {
        "value": Parameter(
            "kg/m³",
            "mass per volume ρ, in place of the plate's",
            positive,
            # The material of another line of the table, too.
            prior=Prior(0.5, 2.0, logarithmic=True, relative_to="density"),
        )
    }
    check = Check(1, "weigh the plate: a scale good to 0.5 % settles the density")
    acts_on = frozenset({"section"})
    shows = (
        "All bending frequencies move by one ratio, and the level moves with it; weighing the plate tells it from E."
    )
    source = "Leissa, Vibration of Plates, NASA SP-160 (1969), chapter 1"
    stage = 1

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The plate's section with another ρ."""
        return section._replace(density=value["value"][..., None])
