"""What may be missing: every effect of the catalogue, with its fixed options, its priors and members to try.

The candidates follow from the class bodies of the effects: their parameters, neutral values and priors, and the names
of their options. A new effect is a candidate as soon as it is in the catalogue.
"""

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchplate.diagnosis.candidates.channels import Channels, Rearrangements
from torchplate.diagnosis.candidates.held_edges import standing_for
from torchplate.effects import CATALOGUE, Effect, Parameter, options
from torchplate.model import PlateModel, Searched
from torchplate.plate import Plan
from torchplate.plate.mesh import EDGES

# Parts of the way from the neutral value to the end of the prior at which a candidate is tried.
PARTS = (0.04, 0.15, 0.5, 1.0)
# The same for what sits at a place; and where a tangent is wanted, with how far of the prior it is believed.
AT_PLACE, TINY, REACH = 0.2, 1e-5, 0.3
# Parts of a prior without a neutral value inside it.
SPREAD = (0.1, 0.3, 0.5, 0.7, 0.9)
# Multiples of a step, of either sign, for which a linear change is believed.
BELIEVED = (-1.0, 2.5)
# What the springs of a held edge are tried at, over the rigid ones.
YIELDS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5)
SOFTER = 0.1
# How much stiffer than its prior a support may be relative to one that is slack.
SLACK = 2.0
# Places along each side, and sizes of patches, at which a candidate with a place is tried.
PLACES = (0.03, 0.19, 0.35, 0.5, 0.65, 0.81, 0.97)
PATCHES = (0.1, 0.3, 0.5, 0.7, 0.9)
SIZES = (0.15, 0.35)
# Members tried of a candidate with several parameters: of all values together, of those half way to the ends.
MOST_MEMBERS, MOST_CORNERS = 60, 81
# A place given is a node's if it is this near, relative to the plate.
ON_NODE = 1e-4
# Effects that are no candidates: the plate itself, and what is settled before anything is named.
NEVER = frozenset({"plate", "support_spring", "mesh_discretisation"})


def nameable() -> list[str]:
    """Effects of the catalogue that may be named as missing."""
    return [name for name in CATALOGUE if name not in NEVER]


class Trial(NamedTuple):
    """A member of a candidate, and the multiples of its step from the neutral values that it is believed for."""

    values: Mapping[str, float]
    lowest: float
    highest: float


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
    """

    effect: Effect
    options: Mapping[str, Any]
    searched: Mapping[str, Searched]
    neutral: Mapping[str, float]
    far: tuple[Trial, ...] = ()
    near: tuple[Trial, ...] = ()
    replaces: str = ""

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
    channels: Channels,
    rearranged: Rearrangements | None = None,
    told: Collection[str] = (),
) -> list[Candidate]:
    """Every effect that this model may lack, once for each choice of its options.

    Args:
        model: as it is.
        theta: its searched parameters.
        channels: labels of the responses and references that were measured.
        rearranged: exchanges and turns of them that promise something; None where there are none.
        told: searched numbers of the model that somebody has said how well he knows: he may have been wrong.
    """
    plan = model.plan(theta)
    found = []
    for name, kind in CATALOGUE.items():
        if name in NEVER:
            continue
        for chosen in _choices(kind, model, channels, rearranged):
            effect = kind(**chosen)
            free = {
                key: parameter
                for key, parameter in effect.parameters.items()
                if parameter.prior is not None and not _already_searched(model, effect, key, told)
            }
            relative = name == "support_asymmetry" and f"{support_of(model, chosen)}.stiffness" in model.names
            if relative:
                # All factors and the common stiffness would be one too many.
                free.pop("factor_1", None)
            if effect.parameters and not free:
                continue
            rigid = standing_for(model, getattr(effect, "edge", ""))
            searched: dict[str, Searched] = {}
            neutral: dict[str, float] = {}
            for key, parameter in free.items():
                interval = parameter.prior_interval(plan.section, plan.geometry)
                assert parameter.prior is not None
                # Over the first support, which may be the slack one.
                high = SLACK * interval.high if relative else interval.high
                searched[key] = Searched(interval.low, high, parameter.prior.logarithmic)
                value = _neutral(name, parameter, plan)
                if value is not None:
                    neutral[key] = value
                if rigid is not None and (held := rigid.values[key]) > 0:
                    searched[key], neutral[key] = Searched(interval.low, held, True), held
            far, near = _trials(searched, neutral) if rigid is None else _yielding(searched, neutral)
            replaces = "" if rigid is None else rigid.label
            found.append(Candidate(effect, chosen, searched, neutral, tuple(far), tuple(near), replaces))
    return found


def channels_of(model: PlateModel) -> Channels:
    """The model's responses and references, by node label where they sit on a node."""
    grid = model.mesh.places(list(range(1, (model.mesh.n_x + 1) * (model.mesh.n_y + 1) + 1)))

    def labels(points: Sequence[Any] | None) -> tuple[Any, ...]:
        found: list[Any] = []
        for point in points or ():
            place = model.mesh.places([point])
            away = (grid - place).norm(dim=-1)
            found.append(int(away.argmin()) + 1 if float(away.min()) < ON_NODE else tuple(place[0].tolist()))
        return tuple(found)

    return Channels(labels(model.response), labels(model.reference))


def _choices(
    kind: type[Effect], model: PlateModel, channels: Channels, rearranged: Rearrangements | None
) -> Iterator[dict[str, Any]]:
    """The options with which an effect may be missing."""
    keys = options(kind)
    if "edge" in keys:
        held = {edge for edge, condition in model.mesh.edges.items() if condition != "free"}
        yield from ({"edge": edge} for edge in EDGES if edge not in held)
    elif kind.name == "channel_polarity":
        yield from () if rearranged is None else rearranged.polarity
    elif kind.name == "channel_swap":
        yield from () if rearranged is None else rearranged.swap
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


def _already_searched(model: PlateModel, effect: Effect, key: str, told: Collection[str]) -> bool:
    """Whether the model searches the same parameter of the same effect; two of them could not be told apart."""
    if "x" in effect.parameters:
        return False
    plate = next(label for label, own in model.effects.items() if own.name == "plate")
    own_number = f"{plate}.{effect.name}"
    if own_number in model.names and own_number not in told:
        return True
    return any(
        type(own) is type(effect) and own == effect and f"{label}.{key}" in model.names
        for label, own in model.effects.items()
    )


def support_of(model: PlateModel, chosen: Mapping[str, Any]) -> str:
    """Label of the support_spring at the places of a support_asymmetry."""
    ((key, points),) = chosen.items()
    supports = {label: own for label, own in model.effects.items() if own.name == "support_spring"}
    return next(label for label, own in supports.items() if getattr(own, key) == points)


def _neutral(name: str, parameter: Parameter, plan: Plan) -> float | None:
    if parameter.neutral is not None:
        return parameter.neutral
    if parameter.prior is not None and parameter.prior.relative_to not in (None, "plate"):
        # The number that the plate has now.
        return float(getattr(plan.section, str(parameter.prior.relative_to)).mean())
    present = getattr(plan.section, name, None)
    return None if present is None else float(present.mean())


def _trials(searched: Mapping[str, Searched], neutral: Mapping[str, float]) -> tuple[list[Trial], list[Trial]]:
    """Trials where peaks do not overlap, and trials where they do."""
    tangents = _combined(searched, neutral, tangent=True)
    steps = _combined(searched, neutral, tangent=False)
    if not searched:
        return steps, steps
    # A change that the fitted parameters nearly undo, such as that of a thickness, shows in its tangent alone; and one
    # that widens or moves a peak by its width, such as that of a dashpot, in a step.
    return (steps, [*tangents, *steps]) if "x" in searched else ([*tangents, *steps], tangents)


def _yielding(searched: Mapping[str, Searched], neutral: Mapping[str, float]) -> tuple[list[Trial], list[Trial]]:
    """Springs of a held edge from rigid to soft, together; and a little softer, for what goes with their compliance.

    What the edge leaves free, as a simple support its slope, has no rigid spring: a soft and a stiff one are tried.
    """
    held = {key: value for key, value in neutral.items() if value > 0}
    axes = {
        key: [held[key] * part for part in (1.0, *YIELDS)]
        if key in held
        else [interval.low, math.sqrt(interval.low * interval.high)]
        for key, interval in searched.items()
    }
    every = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    rigid = every[0]
    near = [Trial(rigid | {key: SOFTER * held[key]}, 0.0, SOFTER / YIELDS[-1]) for key in held]
    return [Trial(values, 1.0, 1.0) for values in every[1:]], near


def _combined(searched: Mapping[str, Searched], neutral: Mapping[str, float], tangent: bool) -> list[Trial]:
    """All combinations of places and values, or one value at a time where there would be too many."""
    axes: dict[str, Sequence[float]] = {}
    for key, interval in searched.items():
        if key in ("x", "y"):
            axes[key] = PATCHES if "size" in searched else PLACES
        elif key == "size":
            axes[key] = SIZES
        elif tangent:
            axes[key] = [_tangent(interval, neutral.get(key))]
        else:
            axes[key] = _steps(interval, neutral.get(key), at_place="x" in searched)
    believed = (-REACH / TINY, REACH / TINY) if tangent else BELIEVED
    if "x" in axes or (not tangent and math.prod(len(values) for values in axes.values()) <= MOST_MEMBERS):
        every = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    else:
        rest = {key: neutral.get(key, values[0]) for key, values in axes.items()}
        every = [rest | {key: value} for key, values in axes.items() for value in values]
        if not tangent and 3 ** len(axes) <= MOST_CORNERS:
            corners = {key: [_between(searched[key], rest[key], end) for end in (0, None, 1)] for key in axes}
            every += [dict(zip(axes, values, strict=True)) for values in itertools.product(*corners.values())]
    return [Trial(values, _least(values, searched, neutral, believed[0]), believed[1]) for values in every]


def _least(
    values: Mapping[str, float], searched: Mapping[str, Searched], neutral: Mapping[str, float], believed: float
) -> float:
    """The least multiple of a step: none the other way, where nothing lies there, as no negative mass does."""
    moved = [key for key, value in values.items() if key in neutral and value != neutral[key]]
    one_sided = any(neutral[key] <= searched[key].low or neutral[key] >= searched[key].high for key in moved)
    return 0.0 if one_sided else believed


def _between(interval: Searched, neutral: float, end: int | None) -> float:
    """The neutral value, or one half way to an end of the interval."""
    if end is None:
        return neutral
    far = interval.high if end else interval.low
    return (neutral * far) ** 0.5 if interval.logarithmic and neutral > 0 else 0.5 * (neutral + far)


def _tangent(interval: Searched, neutral: float | None) -> float:
    """A value a tiny step away from the neutral one."""
    if neutral is None:
        neutral = interval.low
    if interval.logarithmic and interval.low <= neutral:
        return neutral * (interval.high / interval.low) ** TINY
    far = interval.high if abs(interval.high - neutral) >= abs(interval.low - neutral) else interval.low
    # A neutral zero below a logarithmic interval: what is small there is its middle.
    far = math.sqrt(interval.low * interval.high) if interval.logarithmic else far
    return neutral + TINY * (far - neutral)


def _steps(interval: Searched, neutral: float | None, at_place: bool) -> list[float]:
    """Values some way from the neutral one, on both sides; spread over the interval where that is not inside it."""

    def between(low: float, high: float, part: float) -> float:
        return low * (high / low) ** part if interval.logarithmic else low + part * (high - low)

    if neutral is None or not interval.low <= neutral <= interval.high:
        return [between(interval.low, interval.high, part) for part in SPREAD]
    ends = (interval.low, interval.high)
    if at_place:
        # One step will do: its multiple of either sign follows from the residual.
        return [between(neutral, max(ends, key=lambda end: abs(end - neutral)), AT_PLACE)]
    apart = 1e-9 * abs(interval.high - interval.low)
    return [between(neutral, end, part) for end in ends if abs(end - neutral) > apart for part in PARTS]


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
        [
            values.get(name.removeprefix(prefix), math.nan) if name.startswith(prefix) else math.nan
            for name in model.names
        ],
        dtype=torch.float64,
    )
