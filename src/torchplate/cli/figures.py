"""Figures of a run: FRFs over each other, convergence, natural frequencies. Drawn without a screen."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image
from torch import Tensor

from torchplate.cli.writing import write_bytes

# Okabe and Ito's colours: told apart by every reader, and in print.
MEASURED, NOMINAL, UPDATED, RESIDUAL = "black", "#56B4E9", "#D55E00", "#999999"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
AMPLITUDE = {
    "receptance": "|receptance| [m/N]",
    "mobility": "|mobility| [m/(N s)]",
    "accelerance": "|accelerance| [m/(N s²)]",
    "transmissibility": "|transmissibility| [-]",
}


class Curve(NamedTuple):
    """One line of an overlay: FRFs [n_frequency, n_response, n_reference] and how they are drawn."""

    label: str
    frf: Tensor
    colour: str
    width: float = 1.2


def frf_overlay(
    frequency: Tensor,
    measured: Tensor,
    curves: Sequence[Curve],
    pairs: Sequence[tuple[int, int, str]],
    kind: str,
) -> Figure:
    """Measured and modelled amplitudes, with what is left between the last curve and the measurement.

    Args:
        frequency: lines [Hz].
        measured: FRFs [n_frequency, n_response, n_reference].
        curves: what is laid over them, the updated model last.
        pairs: (response index, reference index, title) of each panel.
        kind: of the FRFs, for the axis.
    """
    n_row = len(pairs)
    figure = Figure(figsize=(9, 1.2 + 2.3 * n_row), layout="constrained")
    axes = figure.subplots(n_row, 1, sharex=True, squeeze=False)[:, 0]
    line = frequency.cpu().numpy()
    for axis, (j, k, title) in zip(axes, pairs, strict=True):
        truth = measured[:, j, k].abs().cpu().numpy()
        axis.semilogy(line, truth, color=MEASURED, lw=1.6, label="measured")
        for curve in curves:
            axis.semilogy(
                line, curve.frf[:, j, k].abs().cpu().numpy(), color=curve.colour, lw=curve.width, label=curve.label
            )
        left = (curves[-1].frf[:, j, k].cpu() - measured[:, j, k].cpu()).abs().numpy()
        axis.semilogy(line, left, color=RESIDUAL, lw=0.7, ls=":", label=f"|{curves[-1].label} − measured|")
        positive = truth[truth > 0]
        if len(positive):
            axis.set_ylim(positive.min() / 5, positive.max() * 3)
        axis.set_title(title, loc="left", fontsize=9)
        _quiet(axis)
    figure.supylabel(AMPLITUDE[kind], fontsize=9)
    axes[-1].set_xlabel("frequency [Hz]")
    axes[-1].set_xlim(line[0], line[-1])
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncol=len(labels), frameon=False, fontsize=8)
    return figure


class Convergence(NamedTuple):
    """Best objective of repeated searches: a row for each search, a column for each generation."""

    n_evaluation: np.ndarray
    best: np.ndarray


def convergence(runs: Mapping[str, Convergence], objective: str) -> Figure:
    """Best objective against evaluations and against generations: the median, and the quartiles where seeds repeat."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for colour, (label, run) in zip(COLOURS * (1 + len(runs) // len(COLOURS)), runs.items(), strict=False):
        lower, middle, upper = np.nanquantile(run.best, [0.25, 0.5, 0.75], axis=0)
        for axis, step in ((left, np.nanmedian(run.n_evaluation, axis=0)), (right, np.arange(run.best.shape[1]))):
            axis.plot(step, middle, color=colour, lw=1.6, label=label)
            if len(run.best) > 1:
                axis.fill_between(step, lower, upper, color=colour, alpha=0.2, lw=0)
    left.set_xlabel("evaluations of the model")
    right.set_xlabel("generation (cycle)")
    left.set_ylabel(f"best {objective}")
    for axis in (left, right):
        axis.set_yscale("log")
        _quiet(axis)
    right.legend(frameon=False, fontsize=8)
    return figure


def natural_frequencies(
    mode: Sequence[int], measured: Sequence[float], models: Mapping[str, Sequence[float]]
) -> Figure:
    """Relative deviation of each model's natural frequencies from the measured ones, mode by mode."""
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    axis = figure.subplots()
    width = 0.8 / len(models)
    for index, (colour, (label, found)) in enumerate(zip(COLOURS, models.items(), strict=False)):
        deviation = 100 * (np.asarray(found) / np.asarray(measured) - 1)
        axis.bar(np.arange(len(mode)) + (index + 0.5) * width - 0.4, deviation, width, color=colour, label=label)
    axis.axhline(0, color="black", lw=0.8)
    axis.set_xticks(
        np.arange(len(mode)), [f"{number}\n{hertz:g} Hz" for number, hertz in zip(mode, measured, strict=True)]
    )
    axis.tick_params(axis="x", labelsize=8)
    axis.set_xlabel("mode, and its measured natural frequency")
    axis.set_ylabel("model − measured [%]")
    axis.legend(frameon=False, fontsize=8)
    _quiet(axis)
    axis.grid(False, axis="x")
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG of few colours, a third of the size, and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=90)
    with Image.open(drawn) as image:
        image.convert("RGB").quantize(64).save(small, format="png", optimize=True)
    write_bytes(path, small.getvalue())
    return path


def _quiet(axis: Axes) -> None:
    """Grid behind, no box around."""
    axis.grid(True, which="major", color="0.92", lw=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
