"""Sensors and hits that are not where the test sheet has them, and what moves with a sensor."""

from collections.abc import Mapping
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from torchplate.effects import Effect, PointMass

# A mass this near to a sensor's mark, relative to the sides, is the sensor's own: as near as a sheet's digits say.
AT_A_MARK = 2e-3


class OffMarks(NamedTuple):
    """How far a model's own sensors and hits are off their marks, relative to the sides [-].

    Attributes:
        response: of each sensor.
        reference: of each hit; None where the plate is shaken by its edges.
        carried: labels of the point masses that are a sensor's own, and which sensor's.
    """

    response: Float[Tensor, "n_response 2"]
    reference: Float[Tensor, "n_reference 2"] | None
    carried: Mapping[str, int]

    def moved(self, value: dict[str, dict[str, Tensor]]) -> dict[str, dict[str, Tensor]]:
        """Parameters of all effects, the masses of sensors where these are."""
        moved = dict(value)
        for label, index in self.carried.items():
            x, y = self.response[index]
            moved[label] = value[label] | {"x": value[label]["x"] + x, "y": value[label]["y"] + y}
        return moved


def carried_masses(
    effects: Mapping[str, Effect], known: Mapping[str, float], response: Float[Tensor, "n_response 2"]
) -> dict[str, int]:
    """Labels of the point masses that sit where a sensor does, and which one: what a sensor weighs moves with it.

    Args:
        effects: label → effect.
        known: "label.parameter" → value of what is not searched.
        response: marks of the sensors, relative to the sides [-].
    """
    found = {}
    for label, effect in effects.items():
        place = [known.get(f"{label}.{axis}") for axis in ("x", "y")]
        if isinstance(effect, PointMass) and None not in place:
            away = (response - response.new_tensor(place)).abs().amax(-1)
            if float(away.min()) <= AT_A_MARK:
                found[label] = int(away.argmin())
    return found
