"""Colours, curves and axes that all figures of a diagnosis share."""

from typing import NamedTuple

from jaxtyping import Complex
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from torch import Tensor

from torchplate.diagnosis.result import Overlay

# Okabe and Ito's colours: told apart by every reader, and in print.
MEASURED, BEFORE, AFTER, FOUND, BAND = "black", "#E69F00", "#0072B2", "#D55E00", "#56B4E9"
INK, MUTED, GRID, NOISE = "#1f2933", "#616e7c", "#e4e7eb", "#c9ced6"
INDEX = LinearSegmentedColormap.from_list("index", ["#ffffff", "#e3e0ef", "#b9b3d6", "#8579b5", "#54478c"])


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
