"""What may be missing: every effect of the catalogue, with its fixed options, its priors and a grid of members to try.

The candidates follow from the class bodies of the effects: their parameters, neutral values and priors, and the names of
their options. A new effect is a candidate as soon as it is in the catalogue.
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from torchplate.effects import CATALOGUE, Effect, Parameter, options
from torchplate.model import PlateModel, Searched
from torchplate.plate import Plan
from torchplate.plate.mesh import EDGES

# Parts of the way from the neutral value to the end of the prior at which a candidate is tried.
PARTS = (0.04, 0.15, 0.5, 1.0)
# Parts of a prior without a neutral value inside it.
SPREAD = (0.15, 0.5, 0.85)
# Places along each side, and sizes of patches, at which a candidate with a place is tried.
PLACES = (0.03, 0.19, 0.35, 0.5, 0.65, 0.81, 0.97)
PATCHES = (0.1, 0.3, 0.5, 0.7, 0.9)
SIZES = (0.15, 0.35)
# Members tried of a candidate with several parameters that would give too many; and choices of channels.
MOST_MEMBERS, MOST_CHOICES = 60, 400
# Effects that are no candidates: the plate itself, and what is settled before anything is named.
NEVER = frozenset({"plate", "support_spring", "mesh_discretisation"})


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing.

    Attributes:
        effect: with its options.
        options: the same options by name.
        searched: its parameters that are looked for, and where.
        neutral: the value of each that leaves the model as it is; absent where there is none.
        prior: what a ruler or a scale says: parameter → mean and standard deviation.
        grid: values to try.
    """

    effect: Effect
    options: Mapping[str, Any]
    searched: Mapping[str, Searched]
    neutral: Mapping[str, float]
    prior: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    grid: tuple[Mapping[str, float], ...] = ()

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.effect.name

    @property
    def has_place(self) -> bool:
        """Whether it sits somewhere on the plate."""
        return {"x", "y"} <= self.searched.keys()


def candidates(
    model: PlateModel,
    theta: Tensor,
    tolerance: Mapping[str, float],
    channels: "Channels",
    without: frozenset[str] = frozenset(),
) -> list[Candidate]:
    """Every effect that this model may lack, once for each choice of its options.

    Args:
        model: as it is.
        theta: its searched parameters.
        tolerance: how well its numbers are known: "label.parameter", "mesh.length_x" or "mesh.length_y" → std.
        channels: labels of the responses and references that were measured.
        without: names of effects to leave out.
    """
    plan = model.plan(theta)
    found = []
    for name, kind in CATALOGUE.items():
        if name in NEVER or name in without:
            continue
        for chosen in _choices(kind, model, plan, channels):
            effect = kind(**chosen)
            free = {
                key: parameter
                for key, parameter in effect.parameters.items()
                if parameter.prior is not None and not _already_searched(model, effect, key)
            }
            if name == "support_asymmetry" and _searched_stiffness(model):
                # All factors and the common stiffness would be one too many.
                free.pop("factor_1", None)
            if effect.parameters and not free:
                continue
            searched, neutral = {}, {}
            for key, parameter in free.items():
                interval = parameter.prior_interval(plan.section, plan.geometry)
                assert parameter.prior is not None
                searched[key] = Searched(interval.low, interval.high, parameter.prior.logarithmic)
                value = _neutral(name, parameter, plan)
                if value is not None:
                    neutral[key] = value
            prior = _told(name, model, plan, tolerance)
            found.append(
                Candidate(effect, chosen, searched, neutral, prior, tuple(_grid(name, searched, neutral)))
            )
    return found


@dataclass(frozen=True)
class Channels:
    """Labels of what was measured, as effects name them.

    Attributes:
        response: node labels or relative places.
        reference: likewise; empty where the base moves.
    """

    response: tuple[Any, ...]
    reference: tuple[Any, ...]


def _choices(kind: type[Effect], model: PlateModel, plan: Plan, channels: Channels) -> Iterator[dict[str, Any]]:
    """The options with which an effect may be missing."""
    keys = options(kind)
    if "edge" in keys:
        held = {edge for edge, condition in model.mesh.edges.items() if condition != "free"}
        yield from ({"edge": edge} for edge in EDGES if edge not in held)
    elif kind.name == "channel_polarity":
        sides = [[[one, None] for one in channels.response], [[None, one] for one in channels.reference]]
        pairs = [[a, b] for a in channels.response for b in channels.reference]
        singles = pairs if min(len(channels.response), len(channels.reference)) > 1 else []
        every = [one for side in sides if len(side) > 1 for one in side] + singles
        yield from ({"channels": [one]} for one in every[:MOST_CHOICES])
    elif kind.name == "channel_swap":
        responses = [[[a, None], [b, None]] for a, b in itertools.combinations(channels.response, 2)]
        references = [[[None, a], [None, b]] for a, b in itertools.combinations(channels.reference, 2)]
        yield from ({"channels": pair} for pair in [*responses, *references][:MOST_CHOICES])
    elif kind.name == "sensor_position":
        several = len(channels.response) > 1
        yield from ({"response": one} for one in channels.response) if several else iter([{}])
    elif "nodes" in keys:
        # What changes supports knows them by their places.
        for effect in model.effects.values():
            if effect.name == "support_spring":
                yield {key: value for key in ("nodes", "at") if (value := getattr(effect, key))}
    else:
        yield {}


def _already_searched(model: PlateModel, effect: Effect, key: str) -> bool:
    """Whether the model searches the same parameter of the same effect; two of them could not be told apart."""
    if "x" in effect.parameters:
        return False
    return any(
        type(own) is type(effect) and own == effect and f"{label}.{key}" in model.names
        for label, own in model.effects.items()
    )


def _searched_stiffness(model: PlateModel) -> bool:
    return any(
        effect.name == "support_spring" and f"{label}.stiffness" in model.names
        for label, effect in model.effects.items()
    )


def _neutral(name: str, parameter: Parameter, plan: Plan) -> float | None:
    if parameter.neutral is not None:
        return parameter.neutral
    if parameter.prior is not None and parameter.prior.relative_to not in (None, "plate"):
        # The number that the plate has now.
        return float(getattr(plan.section, str(parameter.prior.relative_to)).mean())
    present = getattr(plan.section, name, None)
    return None if present is None else float(present.mean())


def _told(name: str, model: PlateModel, plan: Plan, tolerance: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """What the tolerances of the model's numbers say of an effect's parameters."""
    plate = next(label for label, effect in model.effects.items() if effect.name == "plate")
    if (std := tolerance.get(f"{plate}.{name}", 0.0)) > 0:
        return {"value": (float(getattr(plan.section, name).mean()), std)}
    x, y = tolerance.get("mesh.length_x", 0.0), tolerance.get("mesh.length_y", 0.0)
    if name == "aspect_ratio" and (x > 0 or y > 0):
        return {"ratio": (1.0, math.hypot(x / model.mesh.length_x, y / model.mesh.length_y))}
    return {}


def _grid(name: str, searched: Mapping[str, Searched], neutral: Mapping[str, float]) -> Iterator[dict[str, float]]:
    """Values to try: places, and parts of the way from the neutral value to the ends of the prior."""
    axes: dict[str, list[float]] = {}
    patch = "size" in searched
    for key, interval in searched.items():
        if key in ("x", "y"):
            axes[key] = list(PATCHES if patch else PLACES)
        elif key == "size":
            axes[key] = list(SIZES)
        else:
            axes[key] = _values(interval, neutral.get(key), few="x" in searched)
    if not axes:
        yield {}
        return
    count = math.prod(len(values) for values in axes.values())
    if count <= MOST_MEMBERS or "x" in axes:
        for values in itertools.product(*axes.values()):
            yield dict(zip(axes, values, strict=True))
        return
    # One at a time, the others neutral.
    for key, values in axes.items():
        for value in values:
            yield {other: neutral.get(other, axes[other][0]) for other in axes} | {key: value}


def _values(interval: Searched, neutral: float | None, few: bool) -> list[float]:
    def at(low: float, high: float, part: float) -> float:
        return low * (high / low) ** part if interval.logarithmic else low + part * (high - low)

    inside = neutral is not None and interval.low <= neutral <= interval.high
    if not inside or neutral is None:
        spread = SPREAD if not interval.logarithmic or few else (0.1, 0.3, 0.5, 0.7, 0.9)
        return [at(interval.low, interval.high, part) for part in spread]
    parts = (0.2,) if few else PARTS
    values = []
    ends = (interval.low, interval.high)
    # Of what sits at a place one step is tried; its multiple, of either sign, follows from the residual.
    for end in (max(ends, key=lambda end: abs(end - neutral)),) if few else ends:
        if abs(end - neutral) > 1e-9 * abs(interval.high - interval.low):
            values += [at(neutral, end, part) for part in parts]
    return [value for value in values if interval.low <= value <= interval.high]


def place_of(values: Mapping[str, float]) -> tuple[float, float] | None:
    """Where a member of a candidate sits; None where it sits nowhere."""
    return (values["x"], values["y"]) if {"x", "y"} <= values.keys() else None


def distance(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Between the places of two members, relative to the plate; infinite where they have none."""
    a, b = place_of(one), place_of(other)
    return math.inf if a is None or b is None else math.dist(a, b)


def vector(model: PlateModel, values: Mapping[str, float], label: str) -> Tensor:
    """A candidate's values in the order of the model's searched parameters; NaN for those of others."""
    prefix = f"{label}."
    return torch.tensor(
        [values.get(name.removeprefix(prefix), math.nan) if name.startswith(prefix) else math.nan for name in model.names],
        dtype=torch.float64,
    )
