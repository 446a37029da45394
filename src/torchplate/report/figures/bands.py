"""Where in frequency the misfit sits."""

import math

import numpy as np
from jaxtyping import Complex
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from torch import Tensor

from torchplate.diagnosis import Diagnosis, Overlay
from torchplate.notation import percent
from torchplate.report.figures.style import BAND, INK, MEASURED, NARROW, curves, decibel, decibel_unit, dress


def bands_figure(diagnosis: Diagnosis, overlay: Overlay, narrow: bool = False) -> Figure:
    """The misfit of every line over its noise, before and after, and the bands that hold most of it.

    Args:
        diagnosis: what was found.
        overlay: its FRFs.
        narrow: for a narrow screen.
    """
    measured = overlay.measured
    line = measured.frequency.cpu().numpy()
    figure = Figure(figsize=(NARROW if narrow else 9, 4.8), layout="constrained")
    top, axis = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1.9])
    keep = measured.measured
    level = measured.frf[:, keep].abs().square().mean(-1).sqrt().cpu().numpy()
    top.plot(line, decibel(level), color=MEASURED, lw=1.2)
    unit = decibel_unit(measured.unit).replace("re 1 ", "re 1\n")
    top.set_ylabel(f"measured,\nrms {unit}", color=INK, fontsize=8.5)
    for label, frf, colour in curves(overlay):
        misfit = _misfit(overlay, frf)
        axis.plot(line, np.where(misfit > 0, misfit, np.nan), color=colour, lw=1.3, label=label, zorder=3)
    axis.set_yscale("log")
    axis.axhline(1.0, color=MEASURED, lw=1.1, ls=(0, (5, 3)), zorder=4, label="noise alone")
    axis.set_ylabel("|measured − model|² over noise²,\nmean of the FRFs [-]", color=INK, fontsize=8.5)
    axis.set_xlabel("frequency [Hz]", color=INK)
    if len(line) > 1:
        axis.set_xlim(line[0], line[-1])
    for one in (top, axis):
        for band in diagnosis.location.bands:
            one.axvspan(band.low, band.high, color=BAND, alpha=0.25, lw=0, zorder=0)
        dress(one)
    _label_bands(top, diagnosis, 0.13 if narrow else 0.055)
    handles = [*axis.get_legend_handles_labels()[0]]
    if diagnosis.location.bands:
        handles.append(Patch(facecolor=BAND, alpha=0.25, label="most of the misfit before"))
    figure.legend(
        handles=handles,
        loc="outside lower left" if narrow else "outside lower right",
        ncol=2 if narrow else len(handles),
        frameon=False,
        fontsize=8.5,
    )
    figure.align_ylabels()
    return figure


def _misfit(overlay: Overlay, frf: Complex[Tensor, "n_frequency n_response n_reference"]) -> np.ndarray:
    """Mean square of what a model leaves over the noise, line by line; NaN where the noise is zero."""
    keep = overlay.measured.measured
    noise = overlay.noise[:, keep]
    # The noise is that of the real and of the imaginary part.
    ratio = (overlay.measured.frf - frf)[:, keep].abs().square() / (2 * noise.square()).where(noise > 0, math.nan)
    return np.asarray(ratio.nanmean(-1).cpu().numpy())


def bands_told(diagnosis: Diagnosis, overlay: Overlay) -> str:
    """The same in words."""
    parts = []
    for label, frf, _ in curves(overlay):
        misfit = _misfit(overlay, frf)
        if np.isfinite(misfit).any():
            top = float(overlay.measured.frequency[int(np.nanargmax(misfit))])
            middle, most = float(np.nanmedian(misfit)), float(np.nanmax(misfit))
            parts.append(f"{label}, its median is {middle:.3g} and its peak {most:.3g}, at {top:.4g} Hz")
    said = f"Misfit over noise along frequency, where noise alone makes 1: {'; '.join(parts)}."
    if diagnosis.location.bands:
        worst = max(diagnosis.location.bands, key=lambda band: band.share)
        said += f" The worst band, {worst.low:.4g} to {worst.high:.4g} Hz, holds {percent(worst.share)} of it."
    return said


def _label_bands(axis: Axes, diagnosis: Diagnosis, apart: float) -> None:
    """The share of each band above it; of two closer than this part of the axis the larger stays."""
    span = np.ptp(axis.get_xlim())
    named: list[float] = []
    for band in sorted(diagnosis.location.bands, key=lambda band: -band.share):
        middle = (band.low + band.high) / 2
        if all(abs(middle - other) > apart * span for other in named):
            axis.annotate(percent(band.share, 2), (middle, 1), (0, 2), xycoords=("data", "axes fraction"),
                          textcoords="offset points", ha="center", va="bottom", fontsize=8.5, color=INK)  # fmt: skip
            named.append(middle)
