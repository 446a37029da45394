"""The gap step by step, as bars from the baseline down to the noise."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from torchplate.diagnosis import Diagnosis, Step
from torchplate.notation import number_of_percent, percent
from torchplate.report.figures.style import AFTER, BEFORE, INK, MEASURED, MUTED, NARROW, PAPER, dress, plain

FAINT = 0.4
"""Opacity of the bars of FRFs that no fit saw; of the steps between the first and the last a little more."""


def gap_figure(diagnosis: Diagnosis, narrow: bool = False) -> Figure:
    """The gap after each step as bars, from the baseline down to the noise floor.

    Args:
        diagnosis: what was found.
        narrow: for a narrow screen: the names of the steps above their bars.
    """
    gap, steps = diagnosis.gap, _steps(diagnosis)
    paired = any(step.heldout is not None for step in steps)
    paper = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.8, "alpha": 0.85}
    opaque = paper | {"alpha": 1.0}
    row = (0.62 if paired else 0.46) + 0.2 * narrow
    figure = Figure(figsize=(NARROW if narrow else 9, 1.35 + 0.2 * narrow + row * len(steps)), layout="constrained")
    axis = figure.subplots()
    logarithmic = _scale(axis, diagnosis, steps, narrow)
    height = (0.34 if paired else 0.56) * (0.8 if narrow else 1)
    for turn, step in enumerate(steps):
        colour = BEFORE if turn == 0 else AFTER
        between = 0 < turn < len(steps) - 1
        own = [step.gap] + ([step.heldout] if step.heldout is not None else [])
        for second, value in enumerate(own):
            place = turn + 0.12 * narrow + (second - (len(own) - 1) / 2) * (height + 0.04)
            look: dict[str, Any] = {"alpha": FAINT, "hatch": "//////"} if second else {"alpha": 0.6 if between else 1.0}
            axis.barh(place, value, height, color=colour, edgecolor=PAPER if second else "none", lw=0, zorder=2, **look)
            axis.annotate(percent(value), (value, place), (4, 0), textcoords="offset points", va="center",
                          fontsize=8.5, color=INK, zorder=5,
                          bbox=paper)  # fmt: skip
        if narrow:
            top = turn + 0.12 - (len(own) * (height + 0.04)) / 2
            axis.annotate(_name(step), (0, top), (0, 1), xycoords=("axes fraction", "data"), bbox=opaque,
                          textcoords="offset points", va="bottom", fontsize=8.5, color=INK, zorder=6)  # fmt: skip
    axis.axvline(gap.noise_floor, color=MEASURED, lw=1.2, ls=(0, (5, 3)), zorder=3)
    axis.set_yticks(range(len(steps)), [""] * len(steps) if narrow else [_name(step) for step in steps])
    axis.set_ylim(len(steps) - 0.5, -0.5)
    what = "gap [%]" if narrow else "gap ‖measured − model‖ / ‖measured‖, mean over FRFs [%]"
    axis.set_xlabel(f"{what}{', log scale' if logarithmic else ''}", fontsize=8.5 if narrow else 10)
    floor = f"noise floor {percent(gap.noise_floor)}"
    handles: list[Line2D | Patch] = [Line2D([], [], color=MEASURED, lw=1.2, ls=(0, (5, 3)), label=floor)]
    if paired:
        unseen = Patch(facecolor=MUTED, alpha=FAINT, hatch="//////", edgecolor=PAPER, lw=0, label="held-out FRFs")
        handles = [Patch(facecolor=MUTED, label="fitted FRFs"), unseen, *handles]
    figure.legend(handles=handles, loc="outside upper left" if narrow else "outside upper right",
                  ncol=2 if narrow else len(handles), frameon=False, fontsize=8.5)  # fmt: skip
    dress(axis)
    axis.grid(False, axis="y")
    axis.tick_params(axis="y", length=0, labelcolor=INK)
    return figure


def _steps(diagnosis: Diagnosis) -> tuple[Step, ...]:
    gap = diagnosis.gap
    return diagnosis.steps or (
        Step("baseline", gap.baseline, gap.heldout_baseline, math.nan),
        Step("final", gap.final, gap.heldout_final, math.nan),
    )


def _name(step: Step) -> str:
    return plain(step.label.replace("- ", "− "))


def _scale(axis: Axes, diagnosis: Diagnosis, steps: Sequence[Step], narrow: bool) -> bool:
    """Ends of the axis of gaps; whether it is logarithmic, so that the last steps are seen beside the first."""
    floor = diagnosis.gap.noise_floor
    values = [value for step in steps for value in (step.gap, step.heldout) if value is not None and value > 0]
    everything = [*values, *([floor] if floor > 0 else [])]
    low, high = min(everything, default=0.5), max(everything, default=1.0)
    if high > 8 * low:
        axis.set_xscale("log")
        axis.set_xlim(low / 2, high * (high / low) ** (0.3 if narrow else 0.12) * 1.5)
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: number_of_percent(value)))
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_minor_formatter(NullFormatter())
        return True
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: number_of_percent(value)))
    axis.set_xlim(0, (1.35 if narrow else 1.18) * high)
    return False


def gap_told(diagnosis: Diagnosis) -> str:
    """The same in words."""
    parts = []
    for step in _steps(diagnosis):
        unseen = "" if step.heldout is None else f" ({percent(step.heldout)} on FRFs held out)"
        parts.append(f"{step.label} {percent(step.gap)}{unseen}")
    return f"Bars of the gap: {'; '.join(parts)}. Noise alone makes {percent(diagnosis.gap.noise_floor)}."


def step_tags(steps: Sequence[Step]) -> Iterator[tuple[str, Step]]:
    """A name for each step that a tag can carry: "+ point_mass" is point_mass, "- sensor_gain" removed_sensor_gain."""
    seen: Counter[str] = Counter()
    for step in steps:
        name = step.label.removeprefix("+ ").strip()
        name = f"removed_{name[2:]}" if name.startswith(("- ", "− ")) else name
        name = name.replace(" ", "_")
        seen[name] += 1
        yield name if seen[name] == 1 else f"{name}_{seen[name]}", step
