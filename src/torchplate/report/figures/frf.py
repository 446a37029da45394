"""Measured and modelled FRFs of a diagnosis: amplitude and phase, and which of them are drawn."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from torchplate.diagnosis import ChannelGap, Diagnosis, Overlay
from torchplate.notation import percent
from torchplate.report.figures.style import (
    AFTER,
    INK,
    MEASURED,
    MUTED,
    NARROW,
    NOISE,
    TITLE,
    UNSEEN,
    UNSEEN_KEY,
    curves,
    decibel,
    decibel_unit,
    dress,
)


def shown(diagnosis: Diagnosis, n_panel: int) -> list[tuple[int, int]]:
    """Indices of the FRFs that are drawn: those that no fit saw, then the others, the worst at the baseline first.

    A panel is kept for the worst of those that were fitted.
    """
    if (overlay := diagnosis.overlay) is None:
        return []
    gap, heldout = channel_gaps(diagnosis, overlay), overlay.heldout
    ranked = sorted(overlay.measured.pairs, key=lambda pair: -gap[pair].before)
    unseen = [pair for pair in ranked if heldout[pair]]
    fitted = [pair for pair in ranked if not heldout[pair]]
    unseen = unseen[: n_panel - 1] if fitted and n_panel > 1 else unseen[:n_panel]
    return unseen + fitted[: n_panel - len(unseen)]


def channel_gaps(diagnosis: Diagnosis, overlay: Overlay) -> dict[tuple[int, int], ChannelGap]:
    """The gaps of each measured FRF by its indices; what the location leaves out is taken from the curves."""
    measured = overlay.measured
    told = {(one.response, one.reference): one for one in diagnosis.location.channels}
    gaps = {}
    for j, k in measured.pairs:
        key = measured.response[j].label, measured.reference[k].label
        level = measured.frf[:, j, k].norm().clamp(min=1e-300)
        parts = (overlay.before - measured.frf, overlay.after - measured.frf, math.sqrt(2) * overlay.noise)
        before, after, floor = (float(part[:, j, k].norm() / level) for part in parts)
        gaps[j, k] = told.get(key) or ChannelGap(*key, before, after, floor, bool(overlay.heldout[j, k]))
    return gaps


def frf_overlay(
    diagnosis: Diagnosis, overlay: Overlay, pairs: Sequence[tuple[int, int]], narrow: bool = False
) -> Figure:
    """Amplitude and phase of FRFs, measured and modelled, two side by side.

    Args:
        diagnosis: what was found.
        overlay: its FRFs.
        pairs: indices of response and reference of those that are drawn.
        narrow: for a narrow screen, below each other.
    """
    measured = overlay.measured
    n_column = 1 if narrow else min(2, len(pairs))
    n_row = math.ceil(len(pairs) / n_column)
    size = (NARROW, 0.6 + 2.7 * n_row) if narrow else (9.6, 0.75 + 2.75 * n_row) if n_column == 2 else (9, 4.4)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(2 * n_row, n_column, sharex=True, squeeze=False, height_ratios=[2.4, 1] * n_row)
    gaps = channel_gaps(diagnosis, overlay)
    for index, pair in enumerate(pairs):
        row, column = divmod(index, n_column)
        amplitude, phase = axes[2 * row, column], axes[2 * row + 1, column]
        _draw(amplitude, phase, overlay, pair, gaps[pair])
        if column == 0:
            amplitude.set_ylabel(f"amplitude\n{decibel_unit(measured.unit)}", color=INK, fontsize=8.5)
            phase.set_ylabel("phase [°]", color=INK, fontsize=8.5)
    for empty in range(len(pairs), n_row * n_column):
        row, column = divmod(empty, n_column)
        axes[2 * row, column].set_visible(False)
        axes[2 * row + 1, column].set_visible(False)
    for column in range(n_column):
        last = 2 * ((len(pairs) - 1 - column) // n_column) + 1
        axes[last, column].set_xlabel("frequency [Hz]", color=INK, fontsize=8.5 if narrow else 10)
        axes[last, column].tick_params(labelbottom=True)
    if len(measured.frequency) > 1:
        axes[0, 0].set_xlim(float(measured.frequency[0]), float(measured.frequency[-1]))
    handles = [*axes[0, 0].get_legend_handles_labels()[0]]
    if not narrow and bool(overlay.heldout[tuple(zip(*pairs, strict=True))].any()):
        handles.append(Patch(facecolor=UNSEEN_KEY, label="held out: no fit saw it"))
    key: dict[str, Any] = {"loc": "outside upper right", "fontsize": 8.5}
    if narrow:
        key = {"loc": "outside lower left", "fontsize": 8, "columnspacing": 1.0, "handlelength": 1.4}
    figure.legend(handles=handles, ncol=len(handles), frameon=False, **key)
    figure.align_ylabels()
    return figure


def _draw(amplitude: Axes, phase: Axes, overlay: Overlay, pair: tuple[int, int], gap: ChannelGap) -> None:
    """One FRF on its two axes."""
    measured, models, (j, k) = overlay.measured, curves(overlay), pair
    line, truth = measured.frequency.cpu().numpy(), measured.frf[:, j, k].cpu().numpy()
    levels = decibel(np.abs(truth))
    amplitude.plot(line, levels, color=MEASURED, lw=1.8, label="measured", zorder=2)
    _phase(phase, line, truth, MEASURED, 1.8)
    for order, (label, frf, colour) in enumerate(models):
        values = frf[:, j, k].cpu().numpy()
        amplitude.plot(line, decibel(np.abs(values)), color=colour, lw=1.1, label=label, zorder=3 + order)
        _phase(phase, line, values, colour, 1.1)
    low, high = _limits([levels, *(decibel(np.abs(frf[:, j, k].cpu().numpy())) for _, frf, _ in models)])
    noise = decibel(math.sqrt(2) * overlay.noise[:, j, k].cpu().numpy())
    low = max(low, float(np.nanmin(noise, initial=math.inf)) - 15) if np.isfinite(noise).any() else low
    amplitude.set_ylim(low, high)
    amplitude.fill_between(line, low, noise, color=NOISE, alpha=0.6, lw=0, zorder=1, label="noise, rms")
    heldout = bool(overlay.heldout[j, k])
    for one in (amplitude, phase):
        dress(one)
        if heldout:
            one.set_facecolor(UNSEEN)
    change = f"gap {percent(gap.before)}" + (f" → {percent(gap.after)}" if len(models) > 1 else "")
    amplitude.set_title(measured.pair_label(j, k), loc="left", y=TITLE, fontsize=9.5, color=INK, fontweight="bold")
    told, colour = (f"held out, {change}", AFTER) if heldout else (change, MUTED)
    amplitude.set_title(told, loc="right", y=TITLE, fontsize=8.5, color=colour)
    phase.set(ylim=(-190, 190), yticks=(-180, 0, 180))


def frf_told(diagnosis: Diagnosis, overlay: Overlay, pair: tuple[int, int]) -> str:
    """One FRF in words: its gap, and where its highest peak lies, measured and modelled."""
    measured, gap = overlay.measured, channel_gaps(diagnosis, overlay)[pair]
    j, k = pair
    models = curves(overlay)
    after = f", {percent(gap.after)} after" if len(models) > 1 else ""
    unseen = ", which no fit saw" if bool(overlay.heldout[pair]) else ""
    peaks = [("measured", measured.frf), *((one.label, one.frf) for one in models)]
    tops = [f"{label} at {float(measured.frequency[int(frf[:, j, k].abs().argmax())]):.4g} Hz" for label, frf in peaks]
    return (
        f"FRF {measured.pair_label(j, k)}{unseen}: gap {percent(gap.before)}{' before' if after else ''}{after}, "
        f"where noise alone makes {percent(gap.floor)}. Highest peak: {', '.join(tops)}."
    )


def _phase(axis: Axes, line: np.ndarray, values: np.ndarray, colour: str, width: float) -> None:
    degrees = np.degrees(np.angle(values))
    # A wrap drawn as a line from +180 to -180 would look like a resonance.
    jump = np.abs(np.diff(degrees, prepend=degrees[0])) > 180
    axis.plot(line, np.where(jump, np.nan, degrees), color=colour, lw=width)


def _limits(levels: Sequence[np.ndarray]) -> tuple[float, float]:
    """Ends of an axis in decibels: all of the measured levels, and what the models need of peaks beyond."""
    truth = levels[0][np.isfinite(levels[0])]
    if not len(truth):
        return -1.0, 1.0
    every = np.concatenate([level[np.isfinite(level)] for level in levels])
    return float(max(every.min(), truth.min() - 10)) - 3, float(min(every.max(), truth.max() + 15)) + 4
