"""Where the misfit sits, in words."""

from collections.abc import Sequence
from typing import Final

from torchplate.diagnosis.localisation.factor import Factor
from torchplate.diagnosis.localisation.force import Force
from torchplate.diagnosis.localisation.reach import KINDS, UNIT
from torchplate.diagnosis.result import Band, ChannelGap
from torchplate.diagnosis.settings import SETTINGS
from torchplate.notation import percent

WORDS: Final = {
    "stiffness": "does not depend on frequency (spring-like",
    "damping": "grows with frequency, against the velocity (dashpot-like",
    "mass": "grows with the square of frequency (mass-like",
}


def of_bands(bands: Sequence[Band]) -> str:
    """In which bands."""
    total = sum(band.share for band in bands)
    ranges = [
        f"{band.low:.4g} Hz" if band.low == band.high else f"{band.low:.4g}-{band.high:.4g} Hz"
        for band in sorted(bands, key=lambda band: band.low)
    ]
    return f"{percent(total, 2)} of the misfit lies at {_joined(ranges)}."


def _joined(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def of_channels(channels: Sequence[ChannelGap]) -> str:
    """In which FRF, if one stands out."""
    worst, middle = channels[0], channels[len(channels) // 2]
    if len(channels) < 3 or worst.before < 2 * middle.before:
        return ""
    name = f"{worst.response}/{worst.reference}"
    here, usual = percent(worst.before, 2), percent(middle.before, 2)
    return f"The worst FRF is {name}, {here} off where the usual one is {usual} off."


def of_kind(force: Force | None, chain: Factor, one: Factor) -> list[str]:
    """What explains most, in words: a place and kind, the sensor chain, or a channel."""
    at_place = 0.0 if force is None else force.parts["place"]
    # A factor that is the reason explains next to all; half can be had by turning down what sits at wrong frequencies.
    factor, own = (found.part if found.part >= SETTINGS.localising.named_factor else 0.0 for found in (chain, one))
    best = max(at_place, factor, own)
    said = []
    if best < SETTINGS.localising.named:
        return ["No spring, dashpot or mass at one place, no gain, no delay and no single channel explains the misfit."]
    if force is not None and at_place >= best - SETTINGS.localising.near:
        rest = " That leaves too much for one place: something spread over the plate is as likely."
        said.append(_of_force(force) + (rest if at_place < SETTINGS.localising.nearly_all else ""))
    if factor >= best - SETTINGS.localising.near:
        said.append(_of_chain(chain))
    if own >= best - SETTINGS.localising.near > factor:
        sign = ": it carries the wrong sign" if abs(one.gain + 1) < 0.1 else ""
        said.append(f"A factor of {one.gain:.3g} on {one.channel} alone would explain {percent(one.part, 2)}{sign}.")
    if len(said) > 1:
        said.append("These data do not tell these apart by the misfit alone.")
    return said


def _of_force(force: Force) -> str:
    where = [f"({x:.2f}, {y:.2f})" for x, y in (force.place, *force.others)]
    place = " or ".join(where[:3])
    kind = max(KINDS, key=lambda name: force.parts[name])
    if force.parts[kind] >= force.parts["place"] - SETTINGS.localising.near:
        size = f"{force.size[kind]:.3g} {UNIT[kind]}"
        return (
            f"A force at {place} that {WORDS[kind]}, about {size}) would explain {percent(force.parts[kind], 2)} of it."
        )
    mixed = ", ".join(f"{name} {percent(force.parts[name], 2)}" for name in KINDS)
    return (
        f"A force at {place} would explain {percent(force.parts['place'], 2)} of it, but no single kind does: {mixed}."
    )


def _of_chain(chain: Factor) -> str:
    if chain.delay == 0.0:
        sign = ": all channels carry the wrong sign" if abs(chain.gain + 1) < 0.1 else ""
        return (
            f"The disagreement is common to all channels: a gain of {chain.gain:.4g} would explain "
            f"{percent(chain.part, 2)}: sensor chain{sign}."
        )
    gain = "" if chain.alone[1] >= chain.part - SETTINGS.localising.near else f" and a gain of {chain.gain:.4g}"
    return (
        f"The disagreement is common to all channels and grows with frequency as a phase: a delay of "
        f"{1e3 * chain.delay:.3g} ms{gain} would explain {percent(chain.part, 2)}: sensor chain."
    )
