"""How alike measured and modelled mode shapes are: MAC of every pair, COMAC point by point, FDAC between the modes."""

from functools import partial

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.patches import Rectangle

from torchplate.report.blocks.document import Panel, Picture
from torchplate.report.figures.modal_fdac import fdac_caption, fdac_figure, fdac_told, modal_fdac
from torchplate.report.figures.paired_shapes import Shapes
from torchplate.report.figures.style import INDEX, INK, MUTED, NARROW, bare, colour_bar, dress

SHADES = INDEX.resampled(20)
MOST_NUMBERS = 12
"""Modes up to which each cell of a square holds its number: more of them and they run into each other."""
ALIKE = 0.1
"""Two measured shapes with a greater MAC than this are hardly told apart at these points; of a good choice of points it
is below (Ewins, Modal Testing, 2000)."""
MOST_NAMED = 3
"""Points that are named beside the map, those of the least COMAC."""


def agreement(shapes: Shapes) -> dict[str, tuple[Picture, Figure]]:
    """The pictures for the page by name, each with its figure for a file of its own."""
    squares = (
        Panel(partial(_square_alone, shapes, "between"), _between_told(shapes)),
        Panel(partial(_square_alone, shapes, "among"), _among_told(shapes)),
    )
    text = (
        "MAC of each measured mode, a row, with the model's modes that they are paired with: strong colour on the "
        "diagonal where they are alike. AutoMAC of the measured modes with each other: colour beside the diagonal says "
        "that the points are too few to tell two modes apart."
    )
    place = (
        "COMAC at each point over all pairs of modes, drawn as what it lacks of 1: a large dot is a point at which the "
        "sizes of the shapes disagree, for a sensor that is misplaced or a model that is wrong nearby. A sign does not "
        "count in it."
    )
    mapped = (Panel(partial(comac_figure, shapes, narrow=True), _points_told(shapes)),)
    found = {
        "mac": (Picture("mac", text, squares), mac_figure(shapes)),
        "comac": (Picture("comac", place, mapped), comac_figure(shapes)),
    }
    # With one mode or one point the operating shape is the same at every frequency.
    if len(shapes.hertz) > 1 and len(shapes.label) > 1:
        criterion = modal_fdac(shapes)
        panel = Panel(partial(fdac_figure, criterion, narrow=True), fdac_told(criterion, shapes))
        found["fdac"] = Picture("fdac", fdac_caption(criterion, shapes), (panel,)), fdac_figure(criterion)
    return found


def mac_figure(shapes: Shapes) -> Figure:
    """Both squares beside each other."""
    figure = Figure(figsize=(9, 4.6), layout="constrained")
    for part, kind in zip(figure.subfigures(1, 2, squeeze=False)[0], ("between", "among"), strict=True):
        _square(part, shapes, kind)
    return figure


def _square_alone(shapes: Shapes, kind: str) -> Figure:
    figure = Figure(figsize=(NARROW, 3.9), layout="constrained")
    _square(figure, shapes, kind)
    return figure


def _square(figure: FigureBase, shapes: Shapes, kind: str) -> None:
    is_between = kind == "between"
    value = (shapes.between if is_between else shapes.among).numpy()
    axis: Axes = figure.subplots()
    n_mode = len(value)
    image = axis.imshow(value, cmap=SHADES, vmin=0, vmax=1)
    hertzs, every = [f"{one:.4g}" for one in shapes.hertz], slice(None, None, -(-n_mode // MOST_NUMBERS))
    columns = [str(number) for number in shapes.number] if is_between else hertzs
    axis.set_xticks(range(n_mode)[every], columns[every], rotation=0 if is_between else 60)
    axis.set_yticks(range(n_mode)[every], hertzs[every])
    axis.set_xlabel("mode of the model" if is_between else "measured [Hz]", fontsize=8.5, color=INK)
    axis.set_ylabel("measured [Hz]", fontsize=8.5, color=INK)
    axis.set_title("MAC" if is_between else "AutoMAC, measured", loc="left", fontsize=9.5, color=INK, fontweight="bold")
    if n_mode <= MOST_NUMBERS:
        for (row, column), one in np.ndenumerate(value):
            # Light on what is dark, on either ground.
            tone = "white" if one > 0.6 else "black"
            axis.text(column, row, f"{one:.2f}", ha="center", va="center", fontsize=7, color=tone)
    bare(axis)
    colour_bar(figure, image, axis, location="bottom", shrink=0.6, aspect=30, pad=0.02)


def comac_figure(shapes: Shapes, narrow: bool = False) -> Figure:
    """A dot at each point, the larger the more its COMAC lacks of 1."""
    width = NARROW if narrow else 6.4
    ratio = shapes.sides[1] / shapes.sides[0]
    figure = Figure(figsize=(width, min(0.8 * width * ratio + 1.1, 7.0)), layout="constrained")
    axis = figure.subplots()
    lacks = 1 - shapes.by_point.numpy()
    place = shapes.place.double().numpy() * shapes.sides
    axis.add_patch(Rectangle((0, 0), *shapes.sides, fill=False, edgecolor=MUTED, lw=1.0))
    size = 12 + 160 * lacks
    most = max(0.1, float(lacks.max()))
    drawn = axis.scatter(place[:, 0], place[:, 1], s=size, c=lacks, cmap=SHADES, vmin=0, vmax=most)
    drawn.set_edgecolor(INK)
    drawn.set_linewidth(0.6)
    for point in _worst(shapes):
        # A point that is called by its place is where it says, and has no room for that.
        name = "" if shapes.label[point].startswith("(") else f"{shapes.label[point]}: "
        axis.annotate(
            f"{name}{1 - lacks[point]:.2f}",
            place[point],
            xytext=(5, 5),
            textcoords="offset points",
            fontsize=8,
            color=INK,
        )
    axis.set_aspect("equal")
    axis.set_xlabel("x [m]", fontsize=8.5)
    axis.set_ylabel("y [m]", fontsize=8.5)
    dress(axis)
    colour_bar(figure, drawn, axis, "1 − COMAC [-]", location="bottom", shrink=0.6, aspect=30, pad=0.02)
    return figure


def _worst(shapes: Shapes) -> list[int]:
    """The points of the least COMAC, the least first."""
    return [int(point) for point in shapes.by_point.argsort()[:MOST_NAMED]]


def _between_told(shapes: Shapes) -> str:
    own = shapes.between.diagonal()
    least = int(own.argmin())
    return (
        f"MAC of the {len(own)} measured modes with the model's: mean {float(own.mean()):.2f} over the pairs, least "
        f"{float(own[least]):.2f} at {shapes.hertz[least]:.4g} Hz with mode {shapes.number[least]} of the model."
    )


def _among_told(shapes: Shapes) -> str:
    beside = shapes.among - torch.eye(len(shapes.hertz), dtype=shapes.among.dtype)
    if len(shapes.hertz) < 2:
        return "AutoMAC: there is one measured mode, and no other to tell it from."
    row, column = divmod(int(beside.argmax()), len(beside))
    most = float(beside[row, column])
    pair = f"{most:.2f}, of {shapes.hertz[row]:.4g} and {shapes.hertz[column]:.4g} Hz"
    if most <= ALIKE:
        return f"AutoMAC of the measured modes: at most {pair}, beside the diagonal: the points tell them apart."
    return f"AutoMAC of the measured modes: up to {pair}: these points hardly tell the two apart."


def _points_told(shapes: Shapes) -> str:
    value = shapes.by_point
    named = ", ".join(f"{shapes.label[point]} {float(value[point]):.2f}" for point in _worst(shapes))
    return f"COMAC of {len(value)} points: mean {float(value.mean()):.2f}, least at {named}."
