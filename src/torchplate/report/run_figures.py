"""Figures of a run: FRFs over each other, convergence, natural frequencies. Drawn without a screen."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, MaxNLocator
from torch import Tensor

from torchplate.discrepancy import Objective
from torchplate.identification import nominal
from torchplate.measurement import Measurement, NaturalFrequencies
from torchplate.notation import percent
from torchplate.report.blocks.document import Panel
from torchplate.report.figures.style import (
    COLOURS,
    INK,
    MEASURED,
    MUTED,
    NARROW,
    NOMINAL,
    RESIDUAL,
    TITLE,
    UPDATED,
    Curve,
    dress,
)

AMPLITUDE = {
    "receptance": "|receptance| [m/N]",
    "mobility": "|mobility| [m/(N s)]",
    "accelerance": "|accelerance| [m/(N s²)]",
    "transmissibility": "|transmissibility| [-]",
}


class Pair(NamedTuple):
    """One FRF that is drawn: the indices of its channels, and its name."""

    response: int
    reference: int
    title: str


class Drawn(NamedTuple):
    """What was measured, and the models that are laid over it, the updated one last."""

    measured: Measurement
    curves: Sequence[Curve]


def shown(objective: Objective, n_panel: int) -> list[Pair]:
    """The FRFs that are drawn, spread over all of them."""
    measurement = objective.evidence.measurement
    assert measurement is not None
    pairs = measurement.pairs
    chosen = torch.linspace(0, len(pairs) - 1, min(n_panel, len(pairs))).round().long().tolist()
    return [Pair(j, k, measurement.pair_label(j, k)) for j, k in map(pairs.__getitem__, chosen)]


def overlay(objective: Objective, theta: Tensor) -> Drawn:
    """The FRFs of the model at theta, and of the middle of every interval where there is one."""
    measurement = objective.evidence.measurement
    assert measurement is not None
    curves = []
    if objective.model.names:
        curves.append(Curve("nominal", objective.frf(nominal(objective)), NOMINAL))
    curves.append(Curve("updated" if objective.model.names else "model", objective.frf(theta), UPDATED))
    return Drawn(measurement, curves)


def frf_figure(drawn: Drawn, pairs: Sequence[Pair], narrow: bool = False) -> Figure:
    """Measured and modelled amplitudes, with what is left between the last curve and the measurement.

    Args:
        drawn: the FRFs.
        pairs: which of them, each on a panel of its own.
        narrow: for a narrow screen.
    """
    measured, curves = drawn
    n_row = len(pairs)
    size = (NARROW, 0.7 + 2.2 * n_row) if narrow else (9, 1.2 + 2.3 * n_row)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(n_row, 1, sharex=True, squeeze=False)[:, 0]
    line = measured.frequency.cpu().numpy()
    for axis, (j, k, title) in zip(axes, pairs, strict=True):
        truth = measured.frf[:, j, k].abs().cpu().numpy()
        axis.semilogy(line, truth, color=MEASURED, lw=1.6, label="measured")
        for curve, width in zip(curves[::-1], (1.2, 1.0), strict=False):
            axis.semilogy(line, curve.frf[:, j, k].abs().cpu().numpy(), color=curve.colour, lw=width, label=curve.label)
        left = (curves[-1].frf[:, j, k].cpu() - measured.frf[:, j, k].cpu()).abs().numpy()
        axis.semilogy(line, left, color=RESIDUAL, lw=0.7, ls=":", label=f"|{curves[-1].label} − measured|")
        positive = truth[truth > 0]
        if len(positive):
            axis.set_ylim(positive.min() / 5, positive.max() * 3)
            # Of at least a decade its tens have labels; to lay out the empty ones between takes most of the time.
            axis.tick_params(axis="y", which="minor", labelleft=False)
        axis.set_title(title, loc="left", y=TITLE, fontsize=9.5, color=INK, fontweight="bold")
        gaps = " → ".join(percent(_gap(measured, curve, j, k)) for curve in curves)
        axis.set_title(f"gap {gaps}", loc="right", y=TITLE, fontsize=8.5, color=MUTED)
        dress(axis)
    figure.supylabel(AMPLITUDE[measured.kind], fontsize=8.5 if narrow else 9)
    axes[-1].set_xlabel("frequency [Hz]", fontsize=8.5 if narrow else 10)
    if len(line) > 1:
        axes[-1].set_xlim(line[0], line[-1])
    handles, labels = axes[0].get_legend_handles_labels()
    key: dict[str, Any] = {"loc": "outside upper right", "ncol": len(labels)}
    if narrow:
        key = {"loc": "outside lower left", "ncol": 2}
    figure.legend(handles, labels, frameon=False, fontsize=8, **key)
    return figure


def frf_panels(drawn: Drawn, pairs: Sequence[Pair]) -> tuple[Panel, ...]:
    """Each FRF on its own, for a narrow screen."""
    panels = []
    for pair in pairs:
        measured, (j, k, title) = drawn.measured, pair
        gaps = [f"{percent(_gap(measured, curve, j, k))} {curve.label}" for curve in drawn.curves]
        curves = [("measured", measured.frf), *((curve.label, curve.frf) for curve in drawn.curves)]
        tops = [
            f"{name} at {float(measured.frequency[int(frf[:, j, k].abs().argmax())]):.4g} Hz" for name, frf in curves
        ]
        told = f"FRF {title}: its gap is {', '.join(gaps)}. Highest peak: {', '.join(tops)}."
        panels.append(Panel(partial(frf_figure, drawn, [pair], narrow=True), told))
    return tuple(panels)


def _gap(measured: Measurement, curve: Curve, j: int, k: int) -> float:
    truth = measured.frf[:, j, k].cpu()
    return float((curve.frf[:, j, k].cpu() - truth).norm() / truth.norm().clamp(min=1e-300))


class Convergence(NamedTuple):
    """Best objective of repeated searches: a row for each search, a column for each generation."""

    n_evaluation: np.ndarray
    best: np.ndarray


def convergence(runs: Mapping[str, Convergence], objective: str, narrow: bool = False) -> Figure:
    """Best objective against evaluations and against generations: the median, and the quartiles where seeds repeat.

    Args:
        runs: by the name of the search.
        objective: what was minimised.
        narrow: for a narrow screen, below each other.
    """
    figure = Figure(figsize=(NARROW, 4.6) if narrow else (9, 3.6), layout="constrained")
    ends = [(float(np.nanmin(run.best)), float(np.nanmax(run.best))) for run in runs.values()]
    # Within a factor of two a logarithmic axis has a single digit to tell its ticks apart by.
    far = max(high for _, high in ends) > 2 * min(low for low, _ in ends)
    left, right = figure.subplots(*((2, 1) if narrow else (1, 2)), sharey=True)
    for colour, (label, run) in zip(COLOURS * (1 + len(runs) // len(COLOURS)), runs.items(), strict=False):
        lower, middle, upper = np.nanquantile(run.best, [0.25, 0.5, 0.75], axis=0)
        for axis, step in ((left, np.nanmedian(run.n_evaluation, axis=0)), (right, np.arange(run.best.shape[1]))):
            axis.plot(step, middle, color=colour, lw=1.6, label=label)
            if len(run.best) > 1:
                axis.fill_between(step, lower, upper, color=colour, alpha=0.2, lw=0)
    left.set_xlabel("evaluations of the model")
    right.set_xlabel("generation (cycle)")
    for axis in (left, right) if narrow else (left,):
        axis.set_ylabel(f"best {objective}", fontsize=8.5 if narrow else 10)
    for axis in (left, right):
        if far:
            axis.set_yscale("log")
            for formatter in (axis.yaxis.set_major_formatter, axis.yaxis.set_minor_formatter):
                # Plain numbers: a search often ends within a decade.
                formatter(LogFormatter(minor_thresholds=(1, 0.4)))
        else:
            axis.ticklabel_format(axis="y", useOffset=False, style="plain")
        axis.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        dress(axis)
    right.legend(frameon=False, fontsize=8)
    return figure


def convergence_told(runs: Mapping[str, Convergence], objective: str) -> str:
    """The same in words."""
    parts = [
        f"{label}: from {float(np.nanmedian(run.best[:, 0])):.4g} to {float(np.nanmin(run.best)):.4g} in "
        f"{float(np.nanmedian(run.n_evaluation[:, -1])):.0f} evaluations"
        for label, run in runs.items()
    ]
    return f"Best {objective} over the search. {'; '.join(parts)}."


def natural_frequencies(objective: Objective, table: NaturalFrequencies, theta: Tensor, narrow: bool = False) -> Figure:
    """Relative deviation of each model's natural frequencies from the measured ones, mode by mode."""
    figure = Figure(figsize=(NARROW, 3.2) if narrow else (9, 3.2), layout="constrained")
    axis = figure.subplots()
    deviations = _deviations(objective, table, theta)
    width, mode = 0.8 / len(deviations), np.arange(len(table.mode))
    for index, (colour, (label, deviation)) in enumerate(zip(COLOURS, deviations.items(), strict=False)):
        axis.bar(mode + (index + 0.5) * width - 0.4, 100 * deviation, width, color=colour, label=label)
    axis.axhline(0, color=MEASURED, lw=0.8)
    named = zip(table.mode.tolist(), table.frequency.tolist(), strict=True)
    axis.set_xticks(mode, [f"{number}" if narrow else f"{number}\n{hertz:g} Hz" for number, hertz in named])
    axis.set_xlabel("mode" if narrow else "mode, and its measured natural frequency")
    axis.set_ylabel("model − measured [%]")
    axis.legend(frameon=False, fontsize=8)
    _bars(axis)
    return figure


def natural_frequencies_told(objective: Objective, table: NaturalFrequencies, theta: Tensor) -> str:
    """The same in words."""
    parts = []
    for label, deviation in _deviations(objective, table, theta).items():
        worst = int(np.abs(deviation).argmax())
        parts.append(f"{label} at most {percent(float(deviation[worst]))}, mode {int(table.mode[worst])}")
    return f"Model over measured natural frequencies, less one: {'; '.join(parts)}."


def _deviations(objective: Objective, table: NaturalFrequencies, theta: Tensor) -> dict[str, np.ndarray]:
    """(model − measured) / measured of each model [-]."""
    models = {"nominal": nominal(objective), "updated": theta} if objective.model.names else {"model": theta}
    return {
        label: (objective.natural_frequencies(member).cpu() / table.frequency.cpu() - 1).numpy()
        for label, member in models.items()
    }


def _bars(axis: Axes) -> None:
    dress(axis)
    axis.grid(False, axis="x")
    axis.tick_params(axis="x", labelsize=8)
