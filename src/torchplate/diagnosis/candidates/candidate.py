"""An effect that may be missing: with its options, what is looked for of it, and what to try."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchplate.effects import CATALOGUE, Effect
from torchplate.model import PlateModel, Searched

# Effects that are no candidates: the plate itself, and what is settled before anything is named.
NEVER = frozenset({"plate", "support_spring", "mesh_discretisation"})
# Of a rectangle two opposite ones, of a line its ends.
CORNERS = frozenset({"x0", "y0", "x1", "y1"})


def nameable() -> list[str]:
    """Effects of the catalogue that may be named as missing."""
    return [
        name
        for name, kind in CATALOGUE.items()
        if name not in NEVER and (not kind.parameters or any(own.prior is not None for own in kind.parameters.values()))
    ]


class Trial(NamedTuple):
    """A member of a candidate, and the multiples of its step from the neutral values that it is believed for.

    Attributes:
        values: of its parameters.
        lowest: multiple.
        highest: likewise.
        rest: the values that it is a step from, where its change is that of a tangent; None where a step's is meant.
    """

    values: Mapping[str, float]
    lowest: float
    highest: float
    rest: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing.

    Attributes:
        effect: with its options.
        options: the same options by name.
        searched: its parameters that are looked for, and where.
        neutral: the value of each that leaves the model as it is; absent where there is none.
        far: what to try where peaks do not overlap.
        near: what to try where they do.
        replaces: label of the effect that it stands for; empty where it comes beside all others.
        widened: the model's own parameters that mean something else beside it: their intervals without and with it.
        detail: its parameters that are looked for once it was found, and where; until then they are neutral.
        overrules: whether it stands for a number that was told with its standard deviation.
        idle: its parameters that did nothing where it was found, and where they had been looked for.
    """

    effect: Effect
    options: Mapping[str, Any]
    searched: Mapping[str, Searched]
    neutral: Mapping[str, float]
    far: tuple[Trial, ...] = ()
    near: tuple[Trial, ...] = ()
    replaces: str = ""
    widened: Mapping[str, tuple[Searched, Searched]] = field(default_factory=dict)
    detail: Mapping[str, Searched] = field(default_factory=dict)
    overrules: bool = False
    idle: Mapping[str, Searched] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.effect.name

    @property
    def cause(self) -> str:
        """What is as probable beforehand as any other: a clamp gives, whether or not springs hold a free edge, too."""
        return "held edge" if self.replaces else self.name

    def in_detail(self) -> "Candidate":
        """The same with its details looked for, too."""
        neutral = {key: self.effect.parameters[key].neutral for key in self.detail}
        known = {key: value for key, value in neutral.items() if value is not None}
        return replace(self, searched={**self.searched, **self.detail}, neutral={**self.neutral, **known}, detail={})

    def without(self, idle: Collection[str]) -> "Candidate":
        """The same without those of its numbers that do nothing."""
        kept = {key: interval for key, interval in self.searched.items() if key not in idle}
        left = {key: interval for key, interval in self.searched.items() if key in idle}
        return replace(self, searched=kept, idle={**self.idle, **left})

    def with_idle(self) -> "Candidate":
        """The same with those of its numbers that did nothing."""
        return replace(self, searched={**self.searched, **self.idle}, idle={})

    @property
    def is_patch(self) -> bool:
        """Whether the plate bends or loses otherwise at a place: what a mesh leaves of its modes is another error."""
        return self.is_placed and "section" in self.effect.acts_on

    @property
    def usual(self) -> dict[str, tuple[float, float]]:
        """Of its parameters that half of all cases have near a value, that value and their std, on the unit cube."""
        found = {}
        for key, interval in self.searched.items():
            parameter = self.effect.parameters[key]
            if parameter.prior is None or parameter.prior.usual is None or parameter.neutral is None:
                continue
            low, high, middle = interval.low, interval.high, parameter.neutral
            if interval.logarithmic:
                low, high, middle = math.log(low), math.log(high), math.log(middle)
            found[key] = (middle - low) / (high - low), parameter.prior.usual / (high - low)
        return found

    @property
    def has_place(self) -> bool:
        """Whether it sits somewhere on the plate."""
        return {"x", "y"} <= self.searched.keys()

    @property
    def is_line(self) -> bool:
        """Whether it runs along a line from one place to another, with strengths."""
        return self.searched.keys() > CORNERS

    @property
    def is_hole(self) -> bool:
        """Whether it is a rectangle without plate: its corners are all there is of it."""
        return self.searched.keys() == CORNERS

    @property
    def is_placed(self) -> bool:
        """Whether it sits somewhere on the plate, or is a hole there."""
        return self.has_place or self.is_hole

    @property
    def is_local(self) -> bool:
        """Whether each member is at a place, or along a line, of its own, and one of them is asked for."""
        return self.has_place or self.searched.keys() >= CORNERS


def n_options(everyone: Sequence[Candidate]) -> dict[str, int]:
    """Candidates of each cause."""
    return dict(Counter(one.cause for one in everyone))


def place_of(values: Mapping[str, float]) -> tuple[float, float] | None:
    """Where a member of a candidate sits, a hole by its middle; None where it sits nowhere."""
    if values.keys() == CORNERS:
        return 0.5 * (values["x0"] + values["x1"]), 0.5 * (values["y0"] + values["y1"])
    return (values["x"], values["y"]) if {"x", "y"} <= values.keys() else None


def distance(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Between the places of two members, relative to the plate; infinite where they have none."""
    a, b = place_of(one), place_of(other)
    return math.inf if a is None or b is None else math.dist(a, b)


def vector(model: PlateModel, values: Mapping[str, float], label: str) -> Tensor:
    """A candidate's values in the order of the model's searched parameters; NaN for those of others."""
    prefix = f"{label}."
    return torch.tensor(
        [
            values.get(name.removeprefix(prefix), math.nan) if name.startswith(prefix) else math.nan
            for name in model.names
        ],
        dtype=torch.float64,
    )
