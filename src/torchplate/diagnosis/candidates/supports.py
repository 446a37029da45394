"""What is grounded at a place may be a support: a further one, or one that is there and tighter than the others."""

import math
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate, Trial
from torchplate.diagnosis.settings import SETTINGS
from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel, Searched

# By what a support ties the plate to the ground: an effect that does the same by one of them may be a support.
STRENGTHS = ("stiffness", "viscous_damping")


class Tighter(NamedTuple):
    """A support that is where a spring was found, or may be.

    Attributes:
        candidate: that support, tighter by the spring: the same physics.
        coincidence: twice the negative logarithm of how likely a spring of which nothing is known ends at a support;
            0 where it only may be at one.
        there: whether the spring is where the support is; else the support is no farther off than the spring's place
            is known, or than a node that may be meant.
    """

    candidate: Candidate
    coincidence: float
    there: bool = True


def supports_at(
    model: PlateModel, theta: Tensor, x: float, y: float, stiffness: float, viscous: float
) -> list[Candidate]:
    """A further support at a place where a spring or dashpot was found, or at the labelled node that is near.

    Args:
        model: as it is.
        theta: its searched parameters.
        x: place, relative.
        y: likewise.
        stiffness: to begin with [N/m].
        viscous: likewise [N s/m].
    """
    settings = SETTINGS.trials
    n_x, n_y = model.mesh.n_x, model.mesh.n_y
    column, row = round(x * n_x), round(y * n_y)
    away = math.hypot(x - column / n_x, y - row / n_y)
    chosen: list[dict[str, Any]] = [{"nodes": (row * (n_x + 1) + column + 1,)}] if away < settings.perhaps_node else []
    chosen += [{"at": ((x, y),)}] if away >= settings.near_node else []
    kind = CATALOGUE["support_spring"]
    plan = model.plan(theta)
    wanted, start, middle = {}, {}, {}
    for name, value in zip(STRENGTHS, (stiffness, viscous), strict=True):
        interval = kind.parameters[name].prior_interval(plan.section, plan.geometry)
        wanted[name] = interval
        start[name] = min(max(value, 1.01 * interval.low), 0.99 * interval.high)
        # What was not there may be anything: next to nothing, and the middle.
        middle[name] = start[name] if value > interval.low else math.sqrt(interval.low * interval.high)
    trials = tuple(Trial(values, *settings.believed) for values in (start, middle))
    return [Candidate(kind(**options), options, wanted, {}, trials) for options in chosen]


def tighter_at(
    model: PlateModel,
    theta: Tensor,
    x: float,
    y: float,
    stiffness: float,
    spread: Float[Tensor, "2 2"] | None = None,
) -> Tighter | None:
    """The one of the supports that is where a spring was found; None where none is, or its spring is named already.

    Args:
        model: without the spring.
        theta: its searched parameters, beside the spring.
        x: place of the spring, relative.
        y: likewise.
        stiffness: of the spring [N/m].
        spread: covariance of its place; None where it is not known.
    """
    settings = SETTINGS.trials
    own = [(label, key, point) for label, key, points in _supports(model, "support_spring") for point in points]
    named = [point for _, _, points in _supports(model, "support_asymmetry") for point in points]
    if not own or stiffness <= 0:
        return None
    away = [_away(model, point, x, y) for _, _, point in own]
    at = min(range(len(own)), key=lambda index: away[index])
    label, key, point = own[at]
    present = float(model.values(theta)[label]["stiffness"])
    near = settings.near_node
    there = away[at] <= near
    if not (there or away[at] <= settings.perhaps_node or _within(_off(model, point, x, y), spread)):
        return None
    if present <= 0 or any(_away(model, one, *model.mesh.places([point])[0].tolist()) <= near for one in named):
        return None
    options = {key: (point,)}
    effect = CATALOGUE["support_asymmetry"](**options)
    prior = effect.parameters["factor_1"].prior
    assert prior is not None
    interval = Searched(prior.low, settings.slackest * prior.high)
    start = {"factor_1": min(1 + stiffness / present, interval.high)}
    trial = Trial(start, *settings.believed)
    candidate = Candidate(effect, options, {"factor_1": interval}, {"factor_1": 1.0}, (trial,))
    by_chance = -2 * math.log(min(1.0, len(own) * math.pi * near**2)) if there else 0.0
    return Tighter(candidate, by_chance, there)


def _supports(model: PlateModel, name: str) -> list[tuple[str, str, tuple[Any, ...]]]:
    """Label, option and places of the effects of this name, which know supports by their places."""
    return [
        (label, key, tuple(getattr(effect, key)))
        for label, effect in model.effects.items()
        if effect.name == name
        for key in ("nodes", "at")
        if getattr(effect, key)
    ]


def _off(model: PlateModel, point: Any, x: float, y: float) -> Float[Tensor, "2"]:
    """Where a support is, seen from a place, relative to the plate."""
    return model.mesh.places([point])[0].cpu() - torch.tensor([x, y], dtype=torch.float64)


def _away(model: PlateModel, point: Any, x: float, y: float) -> float:
    """How far a support is from a place, relative to the plate."""
    return float(_off(model, point, x, y).norm())


def _within(off: Float[Tensor, "2"], spread: Float[Tensor, "2 2"] | None) -> bool:
    """Whether a place is within the ellipse that holds nearly all of another's posterior: χ² of two degrees."""
    if spread is None or not bool(spread.isfinite().all()):
        return False
    return float(off @ torch.linalg.pinv(spread.cpu(), hermitian=True) @ off) <= -2 * math.log(SETTINGS.trials.left_out)
