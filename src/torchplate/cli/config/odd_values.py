"""Numbers of a config that may be and that hardly anybody means: what they look like, and how to write them."""

from collections.abc import Iterator, Mapping
from typing import Final

from torchplate.cli.schema import Config, Known, quantity
from torchplate.effects import Plate
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


def odd_values(config: Config, model: PlateModel) -> Iterator[str]:
    """A sentence for each.

    Args:
        config: as it was written.
        model: that it makes.
    """
    yield from _spreads(config)
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
