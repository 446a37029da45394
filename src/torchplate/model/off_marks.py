"""Sensors, hits and supports that are not where the test sheet has them, and what moves with a sensor."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.effects import Effect, PointMass, SupportSpring, SupportTerms
from torchplate.plate import Local, Mesh

# A mass this near to a sensor's mark, relative to the sides, is the sensor's own: as near as a sheet's digits say.
AT_A_MARK = 2e-3


class OffMarks(NamedTuple):
    """How far a model's own sensors, hits and supports are off their marks, relative to the sides [-].

    Attributes:
        response: of each sensor.
        reference: of each hit; None where the plate is shaken by its edges.
        carried: labels of the point masses that are a sensor's own, and which sensor's.
        support: of each place of the `support_spring`s, in the order of `support_marks`; further ones are on their
            marks; None where all are.
    """

    response: Float[Tensor, "n_response 2"]
    reference: Float[Tensor, "n_reference 2"] | None
    carried: Mapping[str, int]
    support: Float[Tensor, "n_support 2"] | None = None

    def moved(self, value: dict[str, dict[str, Tensor]]) -> dict[str, dict[str, Tensor]]:
        """Parameters of all effects, the masses of sensors where these are."""
        moved = dict(value)
        for label, index in self.carried.items():
            x, y = self.response[index]
            moved[label] = value[label] | {"x": value[label]["x"] + x, "y": value[label]["y"] + y}
        return moved

    def supported(self, mesh: Mesh, effects: Mapping[str, Effect], terms: Sequence[Local]) -> Sequence[Local]:
        """Terms of all effects, those of supports where these are."""
        if self.support is None:
            return terms
        marks = support_marks(mesh, effects).to(self.support)
        marks[: len(self.support)] += self.support[: len(marks)]
        rows, found = mesh.deflection_at(marks), []
        for term in terms:
            if isinstance(term, SupportTerms):
                n = term.vector.shape[-2]
                term, rows = term._replace(vector=rows[:n].to(term.vector)), rows[n:]
            found.append(term)
        return found


def support_marks(mesh: Mesh, effects: Mapping[str, Effect]) -> Float[Tensor, "n_support 2"]:
    """Where supports are meant to be, relative to the sides [-], in the order of the effects and of their places.

    Args:
        mesh: whose nodes are named.
        effects: label → effect.
    """
    points = [one for effect in effects.values() if isinstance(effect, SupportSpring) for one in effect.points]
    return mesh.places(points) if points else torch.zeros(0, 2, dtype=torch.float64)


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
