"""The mass of a sensor that moves from point to point: each record is that of another plate."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, SensorChain, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.plate import Geometry, Mesh


@dataclass(frozen=True)
class RovingMass(Effect):
    """A mass m at each record's own response: H'_rj = H_rj / (1 + s² m H_rr), exact by Sherman and Morrison.

    A sensor that stays where it is while the hammer moves loads all records alike: for a single response this is a
    `point_mass` at the response. With several responses the poles differ from record to record, which those of one
    plate never do: peaks of one mode that stand at other frequencies in other records show it before any model does.
    The plate's own natural frequencies stay as they are.
    """

    parameters = {
        "mass": Parameter(
            "kg",
            "mass of the sensor, which moves with the plate at each record's own response",
            nonnegative,
            neutral=0.0,
            prior=Prior(0.0, 0.1, relative_to="plate"),
        )
    }
    check = Check(1, "weigh the sensor with the part of its cable that moves; a second one beside it doubles the shift")
    acts_on = frozenset({"mass", "sensor chain"})
    shows = (
        "Lowers the peaks of each record by the squared deflection at its own response: one mode stands at several "
        "frequencies, and stays where the sensor sits on its nodal line."
    )
    source = "Ewins, Modal Testing (2000), transducer mass loading; Ashory, Proc. IMAC 16 (1998) 815"

    @classmethod
    def moves_natural_frequencies(cls) -> bool:
        """No: those are of the plate without the sensor."""
        return False

    def observe(self, mesh: Mesh, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """The mass at every response, beside what sits there already."""
        mass = value["mass"][..., None].expand(*value["mass"].shape, chain.response.shape[-2])
        return chain._replace(mass=mass if chain.mass is None else chain.mass + mass)
