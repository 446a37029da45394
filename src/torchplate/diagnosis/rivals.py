"""What a diagnosis leaves open: the hypotheses that a further test would have to part, as they were fitted.

Numbers and names alone, so that whoever plans a test need not fit again: `hypotheses.json` holds them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Found
from torchplate.effects import Effect, find_effect, options
from torchplate.model import PlateModel, Searched

SCHEMA = "torchplate.hypotheses/1"


@dataclass(frozen=True, eq=False)
class Rival:
    """A model that may be the true one, and what is known of its parameters.

    Attributes:
        name: of the effect by which it differs from the others; empty where nothing is missing.
        label: of that effect in the model.
        probability: of it [-].
        effects: label → effect, all of the model.
        known: "label.parameter" → value of all that was not fitted, in SI units.
        searched: of all that was fitted, its interval.
        position: where the fit ended, on the unit cube of these intervals.
        precision: of the position, noise and nuisances as large as they were found, prior included.
        found: how far the specimen was found off a uniform plate; None where that was not asked.
    """

    name: str
    label: str
    probability: float
    effects: Mapping[str, Effect]
    known: Mapping[str, float]
    searched: Mapping[str, Searched]
    position: Float[Tensor, " n_parameter"]
    precision: Float[Tensor, "n_parameter n_parameter"]
    found: Found | None = None

    def model(self, given: PlateModel) -> PlateModel:
        """It, on the mesh of another model of the same plate."""
        return given.replaced(effects=self.effects, known=self.known, searched=self.searched)

    def to_dict(self) -> dict[str, Any]:
        """As `hypotheses.json` has it."""
        effects = {
            label: {"effect": effect.name} | {name: getattr(effect, name) for name in options(type(effect))}
            for label, effect in self.effects.items()
        }
        found = (
            None if self.found is None else {"shift": self.found.shift.tolist(), "spread": self.found.spread.tolist()}
        )
        return {
            "name": self.name,
            "label": self.label,
            "probability": self.probability,
            "effects": effects,
            "known": dict(self.known),
            "searched": {name: dict(vars(interval)) for name, interval in self.searched.items()},
            "position": self.position.tolist(),
            "precision": self.precision.tolist(),
            "found": found,
        }

    @classmethod
    def from_dict(cls, told: Mapping[str, Any]) -> "Rival":
        """Back from there.

        Raises:
            KeyError: if something is not there.
        """
        bodies = {label: dict(body) for label, body in told["effects"].items()}
        effects = {label: find_effect(body.pop("effect"))(**_frozen(body)) for label, body in bodies.items()}
        n, found = len(told["position"]), told["found"]
        return cls(
            told["name"],
            told["label"],
            told["probability"],
            effects,
            told["known"],
            {name: Searched(**ends) for name, ends in told["searched"].items()},
            _tensor(told["position"]),
            _tensor(told["precision"]).reshape(n, n),
            None if found is None else Found(_tensor(found["shift"]), _tensor(found["spread"])),
        )


@dataclass(frozen=True, eq=False)
class Doubt:
    """One effect that was named, with what may stand in its place; or the model as it is, where nothing was named.

    Attributes:
        label: of the effect in the last model; empty where nothing was named.
        rivals: the most probable first; their probabilities need not add up to 1.
        weight: of each number's likelihood, as hypotheses were compared [-].
        noise_scale: what the noise is over what it was estimated as, beside the best of them [-].
        by_noise: whether residuals were weighed by the noise, and not by what the model as such leaves.
        gap: that the best of them leaves [-].
    """

    label: str
    rivals: tuple[Rival, ...]
    weight: float
    noise_scale: float
    by_noise: bool
    gap: float

    @property
    def name(self) -> str:
        """Of the effect that was named; empty where there is none."""
        return next((one.name for one in self.rivals if one.label == self.label), "")

    @property
    def probability(self) -> dict[str, float]:
        """Of each name, those beside each other adding up to 1."""
        whole = sum(one.probability for one in self.rivals)
        found: dict[str, float] = {}
        for one in self.rivals:
            found[one.name] = found.get(one.name, 0.0) + one.probability / whole
        return found

    def to_dict(self) -> dict[str, Any]:
        """As `hypotheses.json` has it."""
        return dict(vars(self)) | {"rivals": [one.to_dict() for one in self.rivals]}

    @classmethod
    def from_dict(cls, told: Mapping[str, Any]) -> "Doubt":
        """Back from there.

        Raises:
            KeyError: if something is not there.
        """
        rest = {key: told[key] for key in ("label", "weight", "noise_scale", "by_noise", "gap")}
        return cls(rivals=tuple(Rival.from_dict(one) for one in told["rivals"]), **rest)


def _frozen(value: Any) -> Any:
    """Lists of a file as the tuples that options are."""
    if isinstance(value, Mapping):
        return {key: _frozen(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_frozen(inner) for inner in value)
    return value


def _tensor(value: Any) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)
