"""What an effect does to a plate, drawn: an FRF with it and without it, and what its natural frequencies do.

The SVG is written by hand, so that it is the same on each day, a few kilobytes, and takes its colours from the page.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import torch
from torch import Tensor

from torchplate.effects import CATALOGUE, Effect
from torchplate.model import PlateModel
from torchplate.plate import Mesh

# An aluminium plate on two soft springs, where the examples of the effects have theirs.
SIDES, ELEMENTS = (0.41, 0.29), (10, 8)
RESPONSE, REFERENCE = (3, (0.6, 0.7)), (8, 5)
BAND = (4.0, 900.0)  # Hz
PLATE = {
    "plate": (
        "plate",
        {},
        {"youngs_modulus": 70e9, "poisson_ratio": 0.33, "density": 2700.0, "thickness": 0.0031},
    ),
    "springs": ("support_spring", {"at": ((0.21, 0.0), (0.66, 0.94))}, {"stiffness": 900.0, "viscous_damping": 1.0}),
    "loss": ("hysteretic_damping", {}, {"stiffness_loss_factor": 5e-3}),
}
N_MODE = 16
NONE = torch.zeros(0, dtype=torch.float64)

HEIGHT, TOP, BOTTOM = 190, 22, 34
FRF, SHIFT = (40, 366), (44, 246)  # left and right ends of the two panels, which stand side by side where there is room
MARGIN = 8


@dataclass(frozen=True)
class Signature:
    """Without and with an effect: FRFs [n_frequency], natural frequencies [n_mode].

    Attributes:
        effect: which.
        frequency: lines [Hz].
        before: FRF of the plate without it [m/(N s²)].
        after: with it.
        natural_before: natural frequencies [Hz].
        natural_after: with it.
    """

    effect: type[Effect]
    frequency: Tensor
    before: Tensor
    after: Tensor
    natural_before: Tensor
    natural_after: Tensor

    @property
    def moves(self) -> bool:
        """Whether undamped natural frequencies can see it."""
        return self.effect.moves_natural_frequencies()

    @property
    def shift(self) -> list[tuple[int, float]]:
        """Number and change [%] of each natural frequency that is not a rigid body's on the springs."""
        change = 100 * (self.natural_after / self.natural_before - 1)
        return [
            (mode, float(value)) for mode, value in enumerate(change, 1) if self.natural_before[mode - 1] > BAND[0] * 10
        ]

    @property
    def phase(self) -> Tensor:
        """By how much the phase of the FRF is turned [degrees], -180 to 180."""
        turned = torch.rad2deg((self.after / self.before).angle())
        # A half turn is one, whichever way rounding takes it.
        return torch.where(turned < -179.9, turned + 360, turned)

    @property
    def sentence(self) -> str:
        """What the picture states, for those who do not see it."""
        if self.effect.name == "plate":
            return f"FRF of the plate of these pictures; its first elastic mode is at {self.natural_before[3]:.0f} Hz."
        if self.moves:
            mode, change = max(self.shift, key=lambda entry: abs(entry[1]))
            return f"{self.effect.name}: most of all it moves natural frequency {mode}, by {change:+.1f} %."
        level = 20 * (self.after.abs() / self.before.abs()).log10()
        low, high, turned = float(level.min()), float(level.max()), float(self.phase.abs().max())
        return (
            f"{self.effect.name}: no natural frequency moves; this FRF changes by {low:+.1f} to {high:+.1f} dB, "
            f"its phase by up to {turned:.0f}°."
        )


@functools.cache
def bare() -> tuple[PlateModel, Tensor]:
    """The plate without any of them, and its natural frequencies [Hz]."""
    model = model_of()
    return model, model.natural_frequencies(NONE, N_MODE)


def model_of(extra: tuple[str, dict[str, Any], dict[str, float]] | None = None) -> PlateModel:
    """The plate, with one effect more."""
    parts = PLATE if extra is None or extra[0] == "plate" else PLATE | {"extra": extra}
    effects = {label: CATALOGUE[name](**options) for label, (name, options, _) in parts.items()}
    known = {f"{label}.{key}": value for label, (_, _, values) in parts.items() for key, value in values.items()}
    return PlateModel(Mesh(*SIDES, *ELEMENTS), effects, known, kind="accelerance")


def signature(effect: type[Effect], options: dict[str, Any], value: dict[str, float]) -> Signature:
    """What the effect does with these options and values."""
    plate, frequencies = bare()
    changed = model_of((effect.name, options, value))
    natural = [frequencies, changed.natural_frequencies(NONE, N_MODE)]
    lines = [torch.logspace(math.log10(BAND[0]), math.log10(BAND[1]), 120, dtype=torch.float64)]
    # A peak is narrower than the steps between these.
    spread = torch.linspace(-1, 1, 11, dtype=torch.float64) ** 3 * 0.04 + 1
    lines += [(found[found > 1.0, None] * spread).flatten() for found in natural]
    frequency = torch.cat(lines).sort().values
    frequency = frequency[(frequency >= BAND[0]) & (frequency <= BAND[1])]
    frfs = [model.frf(NONE, frequency, RESPONSE, REFERENCE)[:, 0, 0] for model in (plate, changed)]
    return Signature(effect, frequency, *frfs, *natural)


def draw(found: Signature) -> str:
    """The two panels, as one line of HTML."""
    if found.effect.name == "plate":
        right = _bars([(mode, float(value)) for mode, value in enumerate(found.natural_before, 1)], "Hz")
    elif found.moves:
        right = _bars(found.shift, "%")
    else:
        right = _phase(found)
    panels = _panel(FRF, _amplitude(found)) + _panel(SHIFT, right)
    return f'<div class="signature" role="img" aria-label="{escape(found.sentence)}">{panels}</div>'


def _panel(ends: tuple[int, int], parts: list[str]) -> str:
    width = ends[1] + MARGIN
    return (
        f'<svg viewBox="0 0 {width} {HEIGHT}" style="flex-basis: {width}px" aria-hidden="true">{"".join(parts)}</svg>'
    )


def _amplitude(found: Signature) -> list[str]:
    curves = [20 * one.abs().clamp(min=1e-9).log10() for one in (found.before, found.after)]
    high = 20 * math.ceil(max(float(curve.max()) for curve in curves) / 20)
    low = max(high - 120, 20 * math.floor(min(float(curve.min()) for curve in curves) / 20))
    across = _log_axis(found.frequency)
    parts = _frame(
        FRF, "|H| in dB re 1 m/(N s²)", "Hz", [(level, f"{level}") for level in range(low, high + 1, 40)], low, high
    )
    parts += [
        _text(_log_axis(torch.tensor([f]))[0], HEIGHT - BOTTOM + 14, f"{f}", "middle") for f in (10, 30, 100, 300)
    ]
    for name, curve in zip(("before", "after"), curves, strict=True):
        if name == "after" and found.effect.name == "plate":
            continue
        down = [_height(float(level), low, high) for level in curve.clamp(min=low)]
        parts.append(_line(name, across, down))
    return parts


def _bars(values: Sequence[tuple[int, float]], unit: str) -> list[str]:
    most = max(abs(value) for _, value in values) or 1.0
    step = 10 ** math.floor(math.log10(most))
    reach = step * math.ceil(most / step)
    low, high = (
        (-reach if min(value for _, value in values) < 0 else 0.0),
        (reach if max(value for _, value in values) > 0 else 0.0),
    )
    title = "natural frequencies in Hz" if unit == "Hz" else "change of natural frequencies in %"
    ticks = [(level, f"{level:g}") for level in sorted({low, 0.0, high})]
    parts = _frame(SHIFT, title, "mode", ticks, low, high)
    width = (SHIFT[1] - SHIFT[0]) / len(values)
    zero = _height(0.0, low, high)
    for index, (mode, value) in enumerate(values):
        left, end = SHIFT[0] + (index + 0.18) * width, _height(value, low, high)
        parts.append(
            f'<rect class="after" x="{left:.1f}" y="{min(zero, end):.1f}" width="{0.64 * width:.1f}" '
            f'height="{abs(zero - end):.1f}"/>'
        )
        if index % 2 == 0:
            parts.append(_text(left + 0.32 * width, HEIGHT - BOTTOM + 14, str(mode), "middle"))
    return [*parts, f'<path class="axis" d="M{SHIFT[0]} {zero:.1f}H{SHIFT[1]}"/>']


def _phase(found: Signature) -> list[str]:
    phase = found.phase
    most = float(phase.abs().max())
    reach = next((step for step in (1, 5, 20, 45, 90, 180) if most <= step), 180)
    parts = _frame(
        SHIFT, "change of the phase in degrees", "Hz", [(a, f"{a}") for a in (-reach, 0, reach)], -reach, reach
    )
    parts += [
        _text(_log_axis(torch.tensor([f]), SHIFT)[0], HEIGHT - BOTTOM + 14, f"{f}", "middle")
        for f in (10, 30, 100, 300)
    ]
    return [
        *parts,
        _line("after", _log_axis(found.frequency, SHIFT), [_height(float(one), -reach, reach) for one in phase]),
    ]


def _frame(
    ends: tuple[int, int], title: str, along: str, ticks: Sequence[tuple[float, str]], low: float, high: float
) -> list[str]:
    left, right = ends
    parts = [
        _text(left, 12, title, "start"),
        _text(right, HEIGHT - 4, along, "end"),
        f'<path class="axis" d="M{left} {TOP}V{HEIGHT - BOTTOM}H{right}"/>',
    ]
    for level, text in ticks:
        at = _height(level, low, high)
        parts += [f'<path class="grid" d="M{left} {at:.1f}H{right}"/>', _text(left - 5, at + 4, text, "end")]
    return parts


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text.replace("-", "−"))}</text>'


def _height(value: float, low: float, high: float) -> float:
    return TOP + (HEIGHT - TOP - BOTTOM) * (high - value) / (high - low)


def _log_axis(frequency: Tensor, ends: tuple[int, int] = FRF) -> list[float]:
    low, high = (math.log(end) for end in BAND)
    return [ends[0] + (ends[1] - ends[0]) * (math.log(float(one)) - low) / (high - low) for one in frequency]


def _line(name: str, across: Sequence[float], down: Sequence[float]) -> str:
    points = thinned([*zip(across, down, strict=True)], 0.2)
    return f'<path class="{name}" d="M{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'


def thinned(points: list[tuple[float, float]], tolerance: float) -> list[tuple[float, float]]:
    """The points without those that lie on the straight line of the others, to a tolerance.

    Source: Douglas and Peucker (1973), "Algorithms for the reduction of the number of points required to represent a
    digitized line or its caricature".
    """
    (x0, y0), (x1, y1) = points[0], points[-1]
    length = math.hypot(x1 - x0, y1 - y0) or 1.0
    off = [abs((x1 - x0) * (y0 - y) - (x0 - x) * (y1 - y0)) / length for x, y in points]
    worst = max(range(len(points)), key=off.__getitem__)
    if off[worst] <= tolerance or len(points) < 3:
        return [points[0], points[-1]]
    return thinned(points[: worst + 1], tolerance)[:-1] + thinned(points[worst:], tolerance)
