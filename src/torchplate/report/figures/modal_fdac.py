"""FDAC of a modal model: the shapes that its modes and the model's make between their resonances, line against line.

A modal model holds no FRFs, so those of both are made from the paired modes alone, for a force at one of the points:

    H_j(ω) = Σ_r φ_jr φ_pr / (ω_r² − ω² + 2iζ_r ω_r ω)

with the measured shapes scaled to the model's, which have unit modal mass, and the measured damping on both sides.
"""

from typing import Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Complex, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torchplate.discrepancy import mac
from torchplate.report.figures.paired_shapes import Shapes
from torchplate.report.figures.style import FOUND, INDEX, INK, NARROW, bare, colour_bar

SHADES = INDEX.resampled(20)
N_LINE: Final = 200
"""Lines along each side: more cannot be told apart on paper."""
BESIDE: Final = 0.1
"""Part of the lowest frequency below it, and of the highest above it, that is drawn."""
DAMPING: Final = 0.01
"""Damping ratio where none was measured: it rounds the ridge at resonances and moves nothing."""


class ModalFdac(NamedTuple):
    """The criterion.

    Attributes:
        frequency: of the lines [Hz].
        value: at each line of the model, a row, with each line of the measured modes.
        point: index of the point that the force acts at.
    """

    frequency: Float[Tensor, " n_line"]
    value: Float[Tensor, "n_line n_line"]
    point: int


def modal_fdac(shapes: Shapes) -> ModalFdac:
    """FDAC of two modes and points or more, the force at the point that all modes move most."""
    hertz = torch.tensor([shapes.hertz, shapes.model_hertz], dtype=torch.float64)
    measured, model = shapes.measured.to(torch.complex128), shapes.model.to(torch.complex128)
    factor = (measured.conj() * model).sum(-1, keepdim=True) / measured.abs().square().sum(-1, keepdim=True)
    measured = factor * measured
    moved = measured.abs() / measured.abs().amax(-1, keepdim=True)
    point = int(moved.amin(0).argmax())
    ratio = torch.tensor(shapes.damping_ratio, dtype=torch.float64).nan_to_num(DAMPING)
    line = torch.linspace((1 - BESIDE) * float(hertz.min()), (1 + BESIDE) * float(hertz.max()), N_LINE).double()
    frfs = [_frf(shape, f, ratio, line, point) for shape, f in zip((measured, model), hertz, strict=True)]
    # Rows of mac are of its first argument; a column of the criterion is a measured line.
    return ModalFdac(line, mac(*frfs).T.real, point)


def _frf(
    shape: Complex[Tensor, "n_mode n_point"],
    hertz: Float[Tensor, " n_mode"],
    ratio: Float[Tensor, " n_mode"],
    line: Float[Tensor, " n_line"],
    point: int,
) -> Complex[Tensor, "n_line n_point"]:
    own = hertz**2 - line[:, None] ** 2 + 2j * ratio * hertz * line[:, None]
    return (shape[:, point] / own) @ shape


def fdac_figure(criterion: ModalFdac, narrow: bool = False) -> Figure:
    """The square, with the diagonal dashed."""
    width = NARROW if narrow else 5.0
    figure = Figure(figsize=(width, 1.2 * width), layout="constrained")
    axis: Axes = figure.subplots()
    line = criterion.frequency.numpy()
    image = axis.pcolormesh(
        line, line, criterion.value.numpy(), shading="nearest", cmap=SHADES, vmin=0, vmax=1, rasterized=True
    )
    ends = [line[0], line[-1]]
    axis.plot(ends, ends, color=FOUND, lw=1.2, ls=(0, (5, 4)))
    axis.set_box_aspect(1)
    axis.set_title("FDAC of the paired modes", loc="left", fontsize=9.5, color=INK, fontweight="bold")
    axis.set_xlabel("frequency, measured [Hz]", fontsize=8.5, color=INK)
    axis.set_ylabel("frequency, model [Hz]", fontsize=8.5, color=INK)
    bare(axis, length=3.5)
    colour_bar(figure, image, axis, "FDAC [-]", location="bottom", shrink=0.6, aspect=30, pad=0.02)
    return figure


def fdac_told(criterion: ModalFdac, shapes: Shapes) -> str:
    """What the square shows, in words."""
    diagonal = criterion.value.diagonal()
    least = int(diagonal.argmin())
    low, high = float(criterion.frequency[0]), float(criterion.frequency[-1])
    return (
        f"FDAC of {len(shapes.hertz)} paired modes, {low:.4g} to {high:.4g} Hz: on the diagonal, where each line meets "
        f"itself, its mean is {float(np.mean(diagonal.numpy())):.2f}, least {float(diagonal[least]):.2f} at "
        f"{float(criterion.frequency[least]):.4g} Hz."
    )


def fdac_caption(criterion: ModalFdac, shapes: Shapes) -> str:
    """How it is made, and how to read it."""
    assumed = "" if np.isfinite(shapes.damping_ratio).all() else f", {DAMPING:g} where no damping was measured"
    return (
        f"FDAC of FRFs that are made from the paired modes alone, for a force at {shapes.label[criterion.point]}, with "
        f"the measured damping ratios on both sides{assumed}: strong colour where the model's shape at one frequency "
        "is the measured one at another. A ridge below the dashed diagonal says that the model has these shapes at too "
        "low a frequency, one above it at too high a frequency. Modes that were not measured are in neither."
    )
