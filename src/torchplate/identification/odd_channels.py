"""Channels that the model found has right but for a factor: turned upside down, or with a gain of their own.

A search sets the plate by what most FRFs say. One channel whose factor is wrong then stays off by that factor, and a
gap over all of them says only that something is.
"""

import math
from statistics import median
from typing import NamedTuple

import torch
from torch import Tensor

from torchplate.discrepancy import Objective
from torchplate.identification.caveats import of_sign
from torchplate.identification.fit_quality import NOTHING, POOR
from torchplate.measurement import Channel, Measurement
from torchplate.model import Point
from torchplate.notation import percent

OWN = 1.1
"""Of a channel's gain over that of the others [-]: ten times what calibration leaves of a careful test."""
MOST_OF_IT = 0.5
"""Part of what is left of a channel's energy that a factor has to leave at most, to be worth a word [-]."""


class Own(NamedTuple):
    """One channel with a factor of its own.

    Attributes:
        side: "response" or "reference".
        number: of the channel, from 0.
        factor: reading over model, real.
        gap: of its FRFs, mean.
        turned: the same with the other sign.
        rest: the same with that factor.
    """

    side: str
    number: int
    factor: float
    gap: float
    turned: float
    rest: float


def misread_in(objective: Objective, theta: Tensor) -> list[str]:
    """What looks wrong with the FRFs as they were read, a sentence each: single channels, else the sign of all.

    Args:
        objective: of a model with the measurement's channels.
        theta: what was found, in SI units.
    """
    return of_channels(objective, theta) or of_sign(objective, theta)


@torch.no_grad()
def of_channels(objective: Objective, theta: Tensor) -> list[str]:
    """What is to be known of single channels, a sentence each.

    Args:
        objective: of a model with the measurement's channels.
        theta: what was found, in SI units.
    """
    frfs = objective.evidence.measurement
    if frfs is None:
        return []
    said = []
    for side in ("response", "reference"):
        every = _factors(side, frfs, objective.frf(theta))
        if len(every) < 2:
            continue
        if all(_looks_turned(one) for one in every):
            # That is of all FRFs.
            return []
        # Of two nobody knows which one is right, but for the level that the model has.
        level = median(one.factor for one in every) if len(every) > 2 else 1.0
        for one in every:
            if _looks_turned(one):
                said.append(_turned(one, frfs, objective))
            elif _has_gain(one, level):
                said.append(_with_gain(one, level, frfs))
    return said


def _looks_turned(one: Own) -> bool:
    return one.gap >= NOTHING and one.turned < POOR


def _has_gain(one: Own, level: float) -> bool:
    return (
        min(one.factor, level) > 0
        and abs(math.log(one.factor / level)) > math.log(OWN)
        and one.rest < POOR
        and one.rest**2 < MOST_OF_IT * one.gap**2
    )


def _factors(side: str, frfs: Measurement, model: Tensor) -> list[Own]:
    """The factor of each channel of a side that was measured, by least squares over its FRFs, each over its norm."""
    pairs, measured = frfs.measured.to(model.device), frfs.frf.to(model)
    norm = torch.where(pairs, measured.abs().square().sum(0), 1.0).clamp(min=1e-300)
    cross = torch.where(pairs, (model.conj() * measured).real.sum(0) / norm, 0.0)
    power = torch.where(pairs, model.abs().square().sum(0) / norm, 0.0)
    over = 1 if side == "response" else 0

    def gap(factor: Tensor | float) -> Tensor:
        """‖X − f H‖ / ‖X‖, mean over the FRFs of each channel."""
        square = torch.where(pairs, 1 - 2 * factor * cross + factor**2 * power, 0.0)
        return square.clamp(min=0.0).sqrt().sum(over) / pairs.sum(over)

    factor = cross.sum(over) / power.sum(over).clamp(min=1e-300)
    rest = gap(factor.unsqueeze(over))
    told = zip(factor.tolist(), gap(1.0).tolist(), gap(-1.0).tolist(), rest.tolist(), strict=True)
    some = pairs.any(over).tolist()
    return [Own(side, index, *numbers) for index, numbers in enumerate(told) if some[index]]


def _turned(one: Own, frfs: Measurement, objective: Objective) -> str:
    channel, place = _channel(one, frfs), getattr(objective.model, one.side)[one.number]
    here = _as_written(channel, place)
    named = f"[{here}, null]" if one.side == "response" else f"[null, {here}]"
    why = "is mounted upside down, or its" if one.side == "response" else "hits from the other side, or its"
    what = "the sensor" if one.side == "response" else "the hammer"
    return (
        f"{one.side.capitalize()} {channel.label} looks turned: with the other sign its gap is {percent(one.turned)} "
        f"instead of {percent(one.gap)}. Either {what} {why} direction is -Z where the file says +Z. Add the effect "
        f"channel_polarity with channels: [{named}], or turn its sign in the export."
    )


def _with_gain(one: Own, level: float, frfs: Measurement) -> str:
    return (
        f"{one.side.capitalize()} {_channel(one, frfs).label} looks as if it had a gain of its own: it reads "
        f"{one.factor / level:.3g} times as much beside the model as the others. With that factor its gap is "
        f"{percent(one.rest)} instead of {percent(one.gap)}. Look at its sensitivity and its unit in the export."
    )


def _channel(one: Own, frfs: Measurement) -> Channel:
    found: Channel = getattr(frfs, one.side)[one.number]
    return found


def _as_written(channel: Channel, place: Point) -> str:
    """As an effect takes it: a node label, or a place relative to the plate."""
    if channel.node:
        return str(channel.node)
    return str(place) if isinstance(place, int) else f"[{place[0]:.4g}, {place[1]:.4g}]"
