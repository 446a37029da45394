"""Numbers of a config that may be and that hardly anybody means: what they look like, and how to write them."""

import math
from collections.abc import Iterator, Mapping
from typing import Final

from torchplate.cli.schema import Config, Known, quantity
from torchplate.effects import ExponentialWindow, Plate
from torchplate.measurement import Measurement, peak_width
from torchplate.model import PlateModel
from torchplate.notation import percent

SPREADS: Final = {
    "frequency_drift": (0.02, "of each natural frequency"),
    "calibration_std": (0.3, "of the level"),
    "damping_scatter": (1.0, "of each mode's damping"),
    "thickness_scatter": (0.2, "of the thickness"),
}
"""Relative standard deviations beyond which no test can be used [-], and of what they are. Drift: a plate that warms by
40 K has 1 %. Level: a sensor without any calibration keeps its data sheet's 20 %. Damping: all of it. Thickness:
sheets are rolled to 10 %."""
MOST_DELAY: Final = 0.1
"""[s]: anti-alias filters and telemetry delay by milliseconds."""
RATIOS: Final = {("aspect_ratio", "ratio"), ("stiffness_loss", "factor"), ("sensor_gain", "gain")}
"""Factors near 1, which leaves a model as it was, by effect and parameter."""
MOST_RATIO: Final = {"ratio": 5.0, "factor": 20.0, "gain": 1e5}
"""[-]: sides are a few per cent off; a patch is stiffened by another of the same thickness by 8."""


BROAD: Final = 2.0
"""Width that a window gives every peak over half of the measured ones', from where no damping explains it [-]."""
MILD, USUAL = 0.5, (1.0, 12.0)
"""Records over time constants [-]: below the first a window still leaves 60 % at their end, and ends nothing; of usual
windows, 37 % to 0.0006 %."""
CENTRED, BESIDE = 0.02, 0.1
"""How near the middle of supports lies to that of a side, and how far beside it, of the side [-]."""


def odd_values(config: Config, model: PlateModel, frfs: Measurement | None = None) -> Iterator[str]:
    """A sentence for each.

    Args:
        config: as it was written.
        model: that it makes.
        frfs: that were measured.
    """
    yield from _spreads(config)
    yield from _places(model)
    if frfs is not None:
        yield from _windows(model, frfs.to("cpu"))
    yield from _beyond_their_values(config)
    longer = max(model.mesh.length_x, model.mesh.length_y)
    low, high = model.values(model.space.low), model.values(model.space.high)
    for label, effect in model.effects.items():
        for name, parameter in effect.parameters.items():
            ends = float(low[label][name]), float(high[label][name])
            least, key = min(map(abs, ends)), f"effects.{label}.{name}"
            if ends[0] * ends[1] < 0 or isinstance(effect, Plate):
                continue
            if parameter.unit == "m" and least > longer:
                found = f"m is more than the longer side, {longer:g} m"
                yield f"{key}: {_span(*ends)} {found}. {_instead('mm', 1e-3, ends)}"
            if parameter.unit == "s" and least > MOST_DELAY:
                yield f"{key}: {_span(*ends)} s is longer than sensors delay. {_instead('ms', 1e-3, ends)}"
            if (effect.name, name) in RATIOS and least > MOST_RATIO[name]:
                found = "is unusual: 1 leaves the plate as it was"
                yield f"{key}: {_span(*ends)} {found}. {_instead('per cent', 0.01, ends)}"


def _places(model: PlateModel) -> Iterator[str]:
    """Supports whose places lie about the plate's middle as metres, and beside it as shares of the sides."""
    sides = model.mesh.length_x, model.mesh.length_y
    for label, effect in model.effects.items():
        at = list(getattr(effect, "at", ()))
        ends = [(min(values), max(values)) for values in zip(*at, strict=True)]
        spread = [(low, high, side) for (low, high), side in zip(ends, sides, strict=False) if high > low]
        if not spread or any(high > (1 + 1e-6) * side for (_, high), side in zip(ends, sides, strict=True)):
            continue
        if all(
            abs(low + high - side) < 2 * CENTRED * side and abs(low + high - 1) > 2 * BESIDE
            for low, high, side in spread
        ):
            shares = ", ".join(f"[{x / sides[0]:.3g}, {y / sides[1]:.3g}]" for x, y in at)
            yield (
                f"effects.{label}.at: as shares of the sides these places lie beside the middle of the plate, and "
                f"as metres about it. If they are in m, write [{shares}]."
            )


def _windows(model: PlateModel, frfs: Measurement) -> Iterator[str]:
    """Windows that make peaks broader than they are, or that end nothing."""
    if frfs.window and not any(isinstance(one, ExponentialWindow) for one in model.effects.values()):
        yield (
            f"The FRFs were windowed by exp(-{frfs.window:.4g} t/s), and no effect of the config takes it off. Add "
            f"window: {{effect: exponential_window, rate: {frfs.window:.6g}}} to the effects."
        )
    record = None if frfs.step is None else 1 / frfs.step
    low, high = model.values(model.space.low), model.values(model.space.high)
    for label, effect in model.effects.items():
        if not isinstance(effect, ExponentialWindow):
            continue
        key, (least, most) = f"effects.{label}.rate", (float(end[label]["rate"]) for end in (low, high))
        width, measured = least / math.pi, peak_width(frfs)
        if measured is not None and width > BROAD * measured:
            hint = ""
            if record is not None and least == most and 0 < least < 100:
                written = math.log(100 / least) / record
                hint = f" If the window falls to {least:g} % in a record of {record:.3g} s, write {written:.3g}."
            yield (
                f"{key}: {_span(least, most)} 1/s makes every peak {width:.3g} Hz wide and more, and the measured ones "
                f"are {measured:.2g} Hz wide. It is one over the window's time constant in s.{hint}"
            )
        elif record is not None and least == most and _is_time_constant(most, record):
            left = percent(math.exp(-most * record), 2)
            yield (
                f"{key}: {most:g} 1/s leaves {left} of a record of {record:.3g} s (one over the line spacing), which "
                f"ends no ringing. If {most:g} s is the window's time constant, write {1 / most:.3g}."
            )


def _is_time_constant(rate: float, record: float) -> bool:
    """Whether a window of this rate [1/s] does nothing in a record [s], and one of this time constant what is usual."""
    return 0 < rate * record < MILD and USUAL[0] <= record / rate <= USUAL[1]


def _spreads(config: Config) -> Iterator[str]:
    for name, (most, what) in SPREADS.items():
        std = getattr(config.measurement, name)
        if std is not None and std > most:
            yield (
                f"measurement.{name}: {std:g} is {percent(std)} {what}, more than any test that can be used. If it is "
                f"in per cent, write {0.01 * std:g}."
            )


def _beyond_their_values(config: Config) -> Iterator[str]:
    """Standard deviations larger than the number that they are of."""
    numbers = {f"mesh.{side}": getattr(config.mesh, side) for side in ("length_x", "length_y")}
    for label, body in config.effects.items():
        for name, value in body.items():
            if isinstance(value, Mapping) and "value" in value:
                numbers[f"effects.{label}.{name}"] = quantity(value)
    for mode, number in (config.measurement.natural_frequencies or {}).items():
        numbers[f"measurement.natural_frequencies.{mode}"] = number
    for key, number in numbers.items():
        if isinstance(number, Known) and number.std > abs(number.value) > 0:
            yield (
                f"{key}: the standard deviation, {number.std:g}, is larger than the value, {number.value:g}: it is in "
                f"the value's unit. If it is in per cent of it, write {0.01 * number.std * abs(number.value):g}."
            )


def _span(low: float, high: float) -> str:
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _instead(unit: str, factor: float, ends: tuple[float, float]) -> str:
    low, high = (factor * end for end in ends)
    return f"If it is in {unit}, write {f'{low:g}' if low == high else f'[{low:g}, {high:g}]'}."
