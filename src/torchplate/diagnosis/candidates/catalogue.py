"""What may be missing: every effect of the catalogue, with its fixed options, its priors and members to try.

The candidates follow from the class bodies of the effects: their parameters, neutral values and priors, and the names
of their options. A new effect is a candidate as soon as it is in the catalogue.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from torch import Tensor

from torchplate.diagnosis.candidates.candidate import NEVER, Candidate
from torchplate.diagnosis.candidates.channels import Channels, Rearrangements
from torchplate.diagnosis.candidates.held_edges import standing_for
from torchplate.diagnosis.candidates.trials import trials, yielding
from torchplate.diagnosis.settings import SETTINGS
from torchplate.effects import CATALOGUE, Effect, Parameter, options
from torchplate.model import PlateModel, Searched
from torchplate.plate import EDGES, Plan

# Within rounding a place given is a node's, relative to the plate.
ON_NODE = 1e-4


def candidates(
    model: PlateModel,
    theta: Tensor,
    channels: Channels,
    rearranged: Rearrangements | None = None,
    told: Collection[str] = (),
    measured: Collection[str] | None = None,
) -> list[Candidate]:
    """Every effect that this model may lack, once for each choice of its options.

    Args:
        model: as it is.
        theta: its searched parameters.
        channels: labels of the responses and references that were measured.
        rearranged: exchanges and turns of them that promise something; None where there are none.
        told: searched numbers of the model that are held by what is known of them, which may be wrong.
        measured: those of them that somebody has measured himself; left out, all.
    """
    plan, certain = model.plan(theta), {*(told if measured is None else measured)}
    found = []
    for name, kind in CATALOGUE.items():
        if name in NEVER or not kind.may_be_missing(plan.section):
            continue
        for chosen in _choices(kind, model, channels, rearranged):
            effect = kind(**chosen)
            free = {
                key: parameter
                for key, parameter in effect.parameters.items()
                if parameter.prior is not None
                and not parameter.detail
                and not _already_searched(model, effect, key, told)
            }
            relative = name == "support_asymmetry" and f"{support_of(model, chosen)}.stiffness" in model.names
            if relative:
                # All factors and the common stiffness would be one too many.
                free.pop("factor_1", None)
            if effect.parameters and not free:
                continue
            rigid = standing_for(model, getattr(effect, "edge", ""))
            searched: dict[str, Searched] = {}
            tried: dict[str, Searched] = {}
            neutral: dict[str, float] = {}
            for key, parameter in free.items():
                interval = parameter.prior_interval(plan.section, plan.geometry)
                # Over the first support, which may be the slack one.
                slack, slackest = (SETTINGS.trials.slack, SETTINGS.trials.slackest) if relative else (1.0, 1.0)
                searched[key] = Searched(interval.low, slackest * interval.high, interval.logarithmic)
                tried[key] = Searched(interval.low, slack * interval.high, interval.logarithmic)
                value = _neutral(name, parameter, plan)
                if value is not None:
                    neutral[key] = value
                if rigid is not None and (held := rigid.values[key]) > 0:
                    searched[key], neutral[key] = Searched(interval.low, held, True), held
            unit = {key: parameter.unit for key, parameter in free.items()}
            far, near = trials(tried, neutral, unit) if rigid is None else yielding(searched, neutral)
            replaces = "" if rigid is None else rigid.label
            widened = _of_the_first(model, chosen) if relative else {}
            detail = {
                key: own.prior_interval(plan.section, plan.geometry)
                for key, own in effect.parameters.items()
                if own.detail
            }
            overrules = any(_own_numbers(model, effect, key) & certain for key in free)
            found.append(
                Candidate(
                    effect, chosen, searched, neutral, tuple(far), tuple(near), replaces, widened, detail, overrules
                )
            )
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
    return bool(_own_numbers(model, effect, key) - {*told})


def _own_numbers(model: PlateModel, effect: Effect, key: str) -> set[str]:
    """Searched numbers of the model that are what a parameter of this effect is."""
    if {"x", "x0"} & effect.parameters.keys():
        # At another place it is another.
        return set()
    plate = next(label for label, own in model.effects.items() if own.name == "plate")
    same = {f"{label}.{key}" for label, own in model.effects.items() if type(own) is type(effect) and own == effect}
    return {f"{plate}.{effect.name}", *same} & {*model.names}


def support_of(model: PlateModel, chosen: Mapping[str, Any]) -> str:
    """Label of the support_spring at the places of a support_asymmetry."""
    ((key, points),) = chosen.items()
    supports = {label: own for label, own in model.effects.items() if own.name == "support_spring"}
    return next(label for label, own in supports.items() if getattr(own, key) == points)


def _of_the_first(model: PlateModel, chosen: Mapping[str, Any]) -> dict[str, tuple[Searched, Searched]]:
    """The interval of a common stiffness where it is the first support's own: slacker or tighter than the others."""
    name, least = f"{support_of(model, chosen)}.stiffness", 1 / (2 * SETTINGS.trials.slackest)
    common = model.searched[name]
    own = Searched(least * common.low, SETTINGS.trials.slack * common.high, common.logarithmic)
    return {name: (common, own)}


def _neutral(name: str, parameter: Parameter, plan: Plan) -> float | None:
    if parameter.neutral is not None:
        return parameter.neutral
    if parameter.prior is not None and parameter.prior.relative_to not in (None, "plate"):
        # The number that the plate has now.
        return float(getattr(plan.section, str(parameter.prior.relative_to)).mean())
    present = getattr(plan.section, name, None)
    return None if present is None else float(present.mean())
