"""Colours, curves and axes that all figures share, on light and on dark ground."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import FigureBase
from torch import Tensor

from torchplate.diagnosis import Overlay

# Okabe and Ito's colours: told apart by every reader, and in print.
MEASURED, BEFORE, AFTER, FOUND, BAND = "black", "#E69F00", "#0072B2", "#D55E00", "#56B4E9"
NOMINAL, UPDATED, RESIDUAL = BAND, FOUND, "#999999"
GREEN, PINK = "#009E73", "#CC79A7"
COLOURS = (AFTER, FOUND, GREEN, PINK, BEFORE, BAND, "#000000")
INK, MUTED, GRID, NOISE, PAPER = "#1f2933", "#616e7c", "#e4e7eb", "#c9ced6", "#ffffff"
UNSEEN, UNSEEN_KEY = "#eef4f9", "#dde9f3"
# Shades begin beside white, which is the paper's own.
INDEX = LinearSegmentedColormap.from_list("index", ["#fefefe", "#e3e0ef", "#b9b3d6", "#8579b5", "#54478c"])
SHAPE = LinearSegmentedColormap.from_list("shape", ["#2b6ca3", "#9cc3df", "#fefefe", "#f2bb94", "#c05515"])

ON_DARK = {
    PAPER: "#14191f",
    "#000000": "#ffffff",
    INK: "#e4e9ee",
    MUTED: "#9dabb8",
    GRID: "#2a333d",
    NOISE: "#3b4754",
    UNSEEN: "#1a2531",
    UNSEEN_KEY: "#29394a",
    BEFORE: "#f0b429",
    AFTER: "#4aa3e0",
    FOUND: "#ff8f4a",
    BAND: "#7cc6f2",
    GREEN: "#2fc49e",
    PINK: "#e5a3c9",
    RESIDUAL: "#8a939c",
}
"""What a colour becomes on dark ground: as far from it as the light one is from white."""

SHADED = "shaded"
"""Names what is drawn in shades from the ground's colour on; on dark ground its lightness is turned round."""
LONGEST = 24
"""Letters of a unit or a name on a figure: as many as stand along the side of the smallest."""
TITLE = 1.0
"""Where titles stand, of the height of their axes: where none is told, all ticks are laid out to find that place."""
NARROW = 3.6
"""Width of a figure that a telephone shows without shrinking it [in]: 346 px of 360."""


class Curve(NamedTuple):
    """FRFs of a model, as they are drawn.

    Attributes:
        label: "before" or "after"; "model" where they are one.
        frf: of the model.
        colour: of its lines.
    """

    label: str
    frf: Complex[Tensor, "n_frequency n_response n_reference"]
    colour: str


def curves(overlay: Overlay) -> list[Curve]:
    """The baseline and the last model; only this one where it is the baseline, so that one curve says it all."""
    if bool((overlay.before == overlay.after).all()):
        return [Curve("model", overlay.after, AFTER)]
    return [Curve("before", overlay.before, BEFORE), Curve("after", overlay.after, AFTER)]


def dress(axis: Axes) -> None:
    """Grid behind, no box around."""
    axis.grid(True, which="major", color=GRID, lw=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(which="both", colors=MUTED, labelsize=8.5)
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(MUTED)


def bare(axis: Axes, length: float = 0.0) -> None:
    """No frame: for a picture of the plate, or a square of shades.

    Args:
        axis: it.
        length: of its ticks [pt].
    """
    axis.tick_params(colors=MUTED, labelsize=8.5, length=length)
    axis.spines[:].set_visible(False)


def colour_bar(
    figure: FigureBase, drawn: ScalarMappable, axes: Axes | Sequence[Axes], label: str = "", **where: Any
) -> Colorbar:
    """The scale of a figure's shades, without a frame; it goes dark with the page."""
    bar = figure.colorbar(drawn, ax=axes, **where)
    bar.set_label(label, color=INK, fontsize=8.5)
    bar.outline.set_visible(False)
    shade(bar)
    bar.ax.tick_params(colors=MUTED, labelsize=8.5)
    return bar


def shade(bar: Colorbar) -> None:
    """Mark the colours of a scale as SHADED."""
    if bar.solids is not None:
        bar.solids.set_gid(SHADED)


def plain(text: str) -> str:
    """Text from a file, in which a dollar is a dollar and begins no formula, and which leaves room for the axes."""
    short = text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"
    return short.replace("$", r"\$")


def decibel(amplitude: np.ndarray) -> np.ndarray:
    """Of an amplitude; NaN where there is none."""
    return np.asarray(20 * np.log10(np.where(amplitude > 0, amplitude, np.nan)))


def decibel_unit(unit: str) -> str:
    """The level that 0 dB stands for."""
    return "[dB]" if unit in ("", "-") else f"[dB re 1 {plain(unit)}]"
