"""The assurance criteria of a diagnosis as one figure: CSAC and CSF over frequency, FDAC line against line."""

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from torch import Tensor

from torchplate.diagnosis import Overlay, csac_by_line, csf_by_line, fdac, fdac_frequency
from torchplate.measurement import Measurement
from torchplate.report.blocks.document import Panel
from torchplate.report.figures.style import FOUND, INDEX, INK, NARROW, Curve, bare, colour_bar, curves, dress

# Steps of a twentieth: a PNG of few colours has some left for the lines.
SHADES = INDEX.resampled(20)
Criterion = Callable[[Measurement, Tensor], Tensor]


def assurance(overlay: Overlay) -> Figure:
    """CSAC and CSF of each line, before and after, and below the FDAC of both; the CSF alone for a single FRF."""
    shapes = several(overlay)
    figure = Figure(figsize=(9.6, 9.0) if shapes else (9, 2.6), layout="constrained")
    top: FigureBase = figure
    if shapes:
        top, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[1, 1.75])[:, 0]
        _fdac(below, overlay.measured, curves(overlay))
    _by_line(top, overlay)
    return figure


def assurance_panels(overlay: Overlay) -> tuple[Panel, ...]:
    """The same in parts that a narrow screen holds."""
    measured, models, shapes = overlay.measured, curves(overlay), several(overlay)
    means = [
        f"{name} {model.label} {float(np.nanmean(_values(criterion, measured, model))):.3f}"
        for name, criterion in _criteria(shapes).items()
        for model in models
    ]
    panels = [Panel(partial(_lines, overlay), f"Mean over the lines: {', '.join(means)}.")]
    for model in models if shapes else ():
        mean = float(np.nanmean(fdac(measured, model.frf).diagonal().cpu().numpy()))
        which = "the model" if model.label == "model" else f"the model {model.label}"
        told = f"FDAC of {which}: on the diagonal, where each line meets itself, its mean is {mean:.3f}."
        panels.append(Panel(partial(_square, measured, model), told))
    return tuple(panels)


def _lines(overlay: Overlay) -> Figure:
    figure = Figure(figsize=(NARROW, 3.9 if several(overlay) else 2.4), layout="constrained")
    _by_line(figure, overlay)
    return figure


def _square(measured: Measurement, model: Curve) -> Figure:
    figure = Figure(figsize=(NARROW, 3.9), layout="constrained")
    _fdac(figure, measured, [model])
    return figure


def _criteria(shapes: bool) -> dict[str, Criterion]:
    return {"CSAC": csac_by_line, "CSF": csf_by_line} if shapes else {"CSF": csf_by_line}


def _values(criterion: Criterion, measured: Measurement, model: Curve) -> np.ndarray:
    value = criterion(measured, model.frf).cpu().numpy()
    # Where either is zero, as an accelerance is at 0 Hz, there is nothing to compare.
    return np.where(value > 0, value, np.nan)


def _by_line(figure: FigureBase, overlay: Overlay) -> None:
    """The criteria along frequency, below each other."""
    measured, models = overlay.measured, curves(overlay)
    line, criteria = measured.frequency.cpu().numpy(), _criteria(several(overlay))
    axes = figure.subplots(len(criteria), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (name, criterion) in zip(axes, criteria.items(), strict=True):
        for model in models:
            axis.plot(line, _values(criterion, measured, model), color=model.colour, lw=1.3, label=model.label)
        axis.set(ylim=(0, 1.04), yticks=(0, 0.25, 0.5, 0.75, 1))
        axis.set_ylabel(f"{name} [-]", color=INK)
        dress(axis)
    axes[-1].set_xlabel("frequency [Hz]", color=INK)
    if len(line) > 1:
        axes[0].set_xlim(line[0], line[-1])
    figure.legend(handles=axes[0].get_legend_handles_labels()[0], loc="outside upper right", ncol=len(models),
                  frameon=False, fontsize=8.5)  # fmt: skip


def caption(overlay: Overlay) -> str:
    """What is to be seen on it, a sentence for each criterion."""
    level = (
        "CSF: 1 at each line where the level is right, too; a resonance of wrong frequency or damping pulls it down."
    )
    if not several(overlay):
        return (
            "CSF: 1 at each line where the amplitude is right. CSAC and FDAC compare FRFs with each other: with a "
            "single one they are always 1, and left out."
        )
    return (
        "CSAC: 1 at each line where the operating shape is right, whatever its level; noise lowers it where the FRFs "
        f"are weak. {level} FDAC: the shape at each line of the model beside that at each measured line, of strong "
        "colour where they agree; a ridge below the dashed diagonal says that the model has these shapes at too low a "
        "frequency, one above it at too high a frequency."
    )


def several(overlay: Overlay) -> bool:
    """Whether there is more than one FRF, so that there are shapes to compare."""
    return len(overlay.measured.pairs) > 1


def _fdac(figure: FigureBase, measured: Measurement, models: list[Curve]) -> None:
    """One square for each model, on one scale of colours."""
    axes = figure.subplots(1, len(models), squeeze=False)[0]
    line = fdac_frequency(measured).cpu().numpy()
    ends = [line[0], line[-1]]
    axis: Axes
    for axis, model in zip(axes, models, strict=True):
        value = fdac(measured, model.frf).cpu().numpy()
        image = axis.pcolormesh(line, line, value, shading="nearest", cmap=SHADES, vmin=0, vmax=1, rasterized=True)
        axis.plot(ends, ends, color=FOUND, lw=1.2, ls=(0, (5, 4)))
        axis.set_box_aspect(1)
        axis.set_title(f"FDAC, {model.label}", loc="left", fontsize=9.5, color=INK, fontweight="bold")
        axis.set_xlabel("frequency, measured [Hz]", color=INK)
        bare(axis, length=3.5)
    axes[0].set_ylabel("frequency, model [Hz]", color=INK)
    colour_bar(figure, image, list(axes), "FDAC [-]", location="bottom", shrink=0.5, aspect=40, pad=0.02)
