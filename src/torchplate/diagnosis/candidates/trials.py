"""Members of a candidate that are tried: places, sizes and values, tangents where peaks overlap and steps where not."""

import itertools
import math
from collections.abc import Mapping, Sequence

import torch
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.candidates.candidate import CORNERS, Candidate, Trial
from torchplate.diagnosis.settings import SETTINGS
from torchplate.effects import CATALOGUE
from torchplate.model import Searched

# Part of the way of a tangent: a step of finite differences. It moves a peak by about a thousandth of its width, of
# whose square the error is; and rounding is as large a part of what it changes.
TINY = 1e-6


def trials(
    searched: Mapping[str, Searched], neutral: Mapping[str, float], unit: Mapping[str, str]
) -> tuple[list[Trial], list[Trial]]:
    """Trials where peaks do not overlap, and trials where they do; `unit` of each of the parameters."""
    if searched.keys() == CORNERS:
        return _holes(), _holes()
    if searched.keys() > CORNERS:
        return _along_lines(searched, neutral, unit, tangent=False), _along_lines(searched, neutral, unit, tangent=True)
    tangents = _combined(searched, neutral, tangent=True)
    steps = _combined(searched, neutral, tangent=False)
    if not searched:
        return steps, steps
    # A change that the fitted parameters nearly undo, such as that of a thickness, shows in its tangent alone; and one
    # that widens or moves a peak by its width, such as that of a dashpot, in a step.
    return (steps, [*tangents, *steps]) if "x" in searched else ([*tangents, *steps], tangents)


def spread_at(candidate: Candidate, x: float, y: float, count: int) -> list[dict[str, float]]:
    """Members of a candidate at one place, of all sizes and strengths: as many weak ones as strong ones.

    Args:
        candidate: that has a place.
        x: along the side x [-].
        y: along the side y [-].
        count: of members.
    """
    if candidate.is_hole:
        sizes = CATALOGUE["stiffness_loss"].parameters["size"].prior
        assert sizes is not None
        parts = SobolEngine(2).draw(count, dtype=torch.float64).tolist()
        return [_hole(x, y, *(_scale_free(sizes, None, part) for part in pair)) for pair in parts]
    own = [key for key in candidate.searched if key not in ("x", "y")]
    drawn = SobolEngine(len(own)).draw(count, dtype=torch.float64).tolist()
    return [
        {"x": x, "y": y}
        | {
            key: _scale_free(candidate.searched[key], candidate.neutral.get(key), part)
            for key, part in zip(own, row, strict=True)
        }
        for row in drawn
    ]


def holes_all_over(count: int) -> list[dict[str, float]]:
    """Holes and notches about places all over the plate, as large as patches are and as long as broad or not.

    Of rectangles whose corners lie anywhere few are small.

    Args:
        count: of members.
    """
    sizes = CATALOGUE["stiffness_loss"].parameters["size"].prior
    assert sizes is not None
    drawn = SobolEngine(4).draw(count + 1, dtype=torch.float64)[1:].tolist()
    return [_hole(x, y, *(_scale_free(sizes, None, part) for part in sides)) for x, y, *sides in drawn]


def _holes() -> list[Trial]:
    """Rectangles without plate, as large as the patches that are tried; what one changes goes with its area."""
    settings = SETTINGS.trials
    every = itertools.product(settings.spread, settings.spread, settings.sizes)
    return [Trial(_hole(x, y, size, size), settings.weakest, settings.believed[1]) for x, y, size in every]


def _along_lines(
    searched: Mapping[str, Searched], neutral: Mapping[str, float], unit: Mapping[str, str], tangent: bool
) -> list[Trial]:
    """What runs along a line, on lines along either side and on half of each: its stiffnesses together, or its mass.

    On whole lines each of them alone, too. Steps are weak, middling and strong: peaks do not move by a rib as stiff as
    the plate as by one of a fiftieth of that.
    """
    settings = SETTINGS.trials
    first, middle, last = settings.spread[0], settings.spread[len(settings.spread) // 2], settings.spread[-1]
    believed = settings.tangent / TINY if tangent else settings.believed[1]
    nothing = {key: neutral[key] for key in searched if key in neutral}
    steps = [{key: _tangent(searched[key], rest) for key, rest in nothing.items()}]
    if not tangent:
        parts = (first, middle, last)
        steps = [{key: _scale_free(searched[key], rest, part) for key, rest in nothing.items()} for part in parts]
    strengths = [[key for key in nothing if unit[key] == kind] for kind in dict.fromkeys(map(unit.get, nothing))]
    alone = [[key] for together in strengths if len(together) > 1 for key in together]
    found = []
    for at, (begin, end) in itertools.product(settings.spread, ((first, last), (first, middle), (middle, last))):
        every = [*strengths, *alone] if (begin, end) == (first, last) else strengths
        for along, across in ("xy", "yx"):
            line = {f"{along}0": begin, f"{along}1": end, f"{across}0": at, f"{across}1": at} | nothing
            members = [{key: step[key] for key in step if key in some} for some in every for step in steps]
            found += [Trial(line | member, 0.0, believed, line if tangent else None) for member in members]
    return found


def _hole(x: float, y: float, length_x: float, length_y: float) -> dict[str, float]:
    """A rectangle about a place, as far as it is on the plate: one that reaches an edge is a notch."""
    ends = ((x, length_x), (y, length_y))
    (x0, x1), (y0, y1) = ((max(0.0, at - 0.5 * side), min(1.0, at + 0.5 * side)) for at, side in ends)
    return {"x0": x0, "y0": y0, "x1": x1, "y1": y1}


def as_large(hole: Mapping[str, float], area: float) -> dict[str, float]:
    """A rectangle of so many times its area; a side on an edge of the plate stays there."""
    found = dict(hole)
    for axis in "xy":
        low, high = hole[f"{axis}0"], hole[f"{axis}1"]
        middle = 0.5 * (low + high) if low > 0 and high < 1 else low if low <= 0 else high
        for end, value in (("0", low), ("1", high)):
            found[axis + end] = min(max(middle + area**0.5 * (value - middle), 0.0), 1.0)
    return found


def _scale_free(interval: Searched, neutral: float | None, part: float) -> float:
    """A value of an interval, equal steps of the part being equal ratios of what it changes."""
    if interval.low > 0 and (interval.logarithmic or neutral is None):
        return interval.low * (interval.high / interval.low) ** part
    begin = interval.low if neutral is None else neutral
    far = max(interval.low, interval.high, key=lambda end: abs(end - begin))
    return begin + (far - begin) * SETTINGS.trials.weakest ** (1 - part)


def yielding(searched: Mapping[str, Searched], neutral: Mapping[str, float]) -> tuple[list[Trial], list[Trial]]:
    """Springs of a held edge from rigid to soft, together; and a little softer, for what goes with their compliance.

    What the edge leaves free, as a simple support its slope, has no rigid spring: a soft and a stiff one are tried.
    """
    held = {key: value for key, value in neutral.items() if value > 0}
    axes = {
        key: [held[key] * part for part in (1.0, *SETTINGS.trials.yields)]
        if key in held
        else [interval.low, math.sqrt(interval.low * interval.high)]
        for key, interval in searched.items()
    }
    every = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    rigid, softer = every[0], SETTINGS.trials.softer
    softest = softer / SETTINGS.trials.yields[-1]
    near = [Trial(rigid | {key: softer * held[key]}, 0.0, softest) for key in held]
    return [Trial(values, 1.0, 1.0) for values in every[1:]], near


def _combined(searched: Mapping[str, Searched], neutral: Mapping[str, float], tangent: bool) -> list[Trial]:
    """All combinations of places and values, or one value at a time where there would be too many."""
    axes: dict[str, Sequence[float]] = {}
    settings = SETTINGS.trials
    # What has a size, or a frequency of its own, shows over a wide part of the plate, or hardly by its place alone.
    widely = any(key not in ("x", "y") and key not in neutral for key in searched)
    for key, interval in searched.items():
        if key in ("x", "y"):
            axes[key] = settings.spread if widely else settings.places
        elif key == "size":
            axes[key] = settings.sizes
        elif tangent:
            axes[key] = [_tangent(interval, neutral.get(key))]
        else:
            axes[key] = _steps(interval, neutral.get(key), at_place="x" in searched)
    believed = (-settings.tangent / TINY, settings.tangent / TINY) if tangent else settings.believed
    # Each may be what alone is missing.
    in_place, rest = "x" in axes, None
    alone = {} if in_place else {key: _at_rest(searched[key], neutral.get(key)) for key in axes}
    whole = {key: [*alone.get(key, ()), *values] for key, values in axes.items()}
    if in_place or (not tangent and math.prod(len(values) for values in whole.values()) <= settings.most_members):
        every = [dict(zip(axes, values, strict=True)) for values in itertools.product(*whole.values())]
        every = [one for one in every if not one or any(value not in alone.get(key, ()) for key, value in one.items())]
    else:
        rest = {key: neutral.get(key, values[0]) for key, values in axes.items()}
        every = [rest | {key: value} for key, values in axes.items() for value in values]
        if not tangent and 3 ** len(axes) <= settings.most_corners:
            corners = {key: [_between(searched[key], rest[key], end) for end in (0, None, 1)] for key in axes}
            every += [dict(zip(axes, values, strict=True)) for values in itertools.product(*corners.values())]
        # Where nothing is strong, no place is tried.
        every = [one for one in every if not neutral or any(one[key] != rest[key] for key in neutral)]
    begin = rest if tangent and neutral and not in_place else None
    return [Trial(values, _least(values, searched, neutral, believed[0]), believed[1], begin) for values in every]


def _least(
    values: Mapping[str, float], searched: Mapping[str, Searched], neutral: Mapping[str, float], believed: float
) -> float:
    """The least multiple of a step: none the other way, where nothing lies there, as no negative mass does."""
    moved = [key for key, value in values.items() if key in neutral and value != neutral[key]]
    one_sided = any(neutral[key] <= searched[key].low or neutral[key] >= searched[key].high for key in moved)
    return 0.0 if one_sided else believed


def _at_rest(interval: Searched, neutral: float | None) -> list[float]:
    """The value of an interval that is nearest to the neutral one; none where there is no neutral one."""
    return [] if neutral is None else [min(max(neutral, interval.low), interval.high)]


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
        return [between(interval.low, interval.high, part) for part in SETTINGS.trials.spread]
    ends = (interval.low, interval.high)
    if at_place:
        # One step will do: its multiple of either sign follows from the residual.
        return [between(neutral, max(ends, key=lambda end: abs(end - neutral)), SETTINGS.trials.at_place)]
    apart = 1e-9 * abs(interval.high - interval.low)
    return [between(neutral, end, part) for end in ends if abs(end - neutral) > apart for part in SETTINGS.trials.parts]
