"""Poisson's ratio that was taken from a table, and is another one."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior
from torchplate.effects.plate import Plate
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class PoissonRatio(Effect):
    """ν = value, whatever the plate's own number: D = E h³ / (12 (1 − ν²)), D₆₆ = E h³ / (24 (1 + ν)).

    The plate keeps the number that was taken as known, so that a config says both.
    """

    parameters = {
        "value": Parameter(
            "-",
            "Poisson's ratio ν, in place of the plate's",
            Plate.parameters["poisson_ratio"].allowed,
            prior=Prior(0.5, 1.5, relative_to="poisson_ratio"),
        )
    }
    check = Check(5, "measure a torsion mode and a bending mode of a strip of the same sheet")
    acts_on = frozenset({"section"})
    shows = "Modes that twist move against modes that bend; with free edges some pairs of modes part or meet."
    source = "Leissa, The free vibration of rectangular plates, J. Sound Vib. 31 (1973) 257"
    stage = 1

    @classmethod
    def may_be_missing(cls, section: Section) -> bool:
        """Only beside a ν to which a search can be relative."""
        return float(section.poisson_ratio.mean()) != 0

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The plate's section with another ν."""
        return section._replace(poisson_ratio=value["value"][..., None])
