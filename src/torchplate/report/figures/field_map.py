"""A field that was inferred without a name, as a map over the plate."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from torchplate.diagnosis import ONE_FORCE, Diagnosis, FoundField
from torchplate.report.figures.plate_map import draw_channels, draw_plate
from torchplate.report.figures.style import FOUND, INK, MUTED, NARROW, PAPER, SHADED, SHAPE, shade

QUANTITIES = {
    "stiffness": ("bending stiffness, more than the plate's [%]", 100.0),
    "mass": ("mass per area, more than the plate's [%]", 100.0),
    "loss": ("loss factor beyond the plate's [%]", 100.0),
    "support": ("springs to the ground, one a node [N/m]", 1.0),
}
"""What the shades of each kind are, and what a value is times."""
EXPLAINED = ("what one force there would explain of the misfit [%]", 100.0)


def field_map(diagnosis: Diagnosis, field: FoundField, narrow: bool = False) -> Figure:
    """The field over the plate, its centre and what these data cannot tell from it.

    Args:
        diagnosis: whose plate and channels they are.
        field: that was found.
        narrow: for a narrow screen.
    """
    mesh = diagnosis.model.mesh
    sides = 1e3 * mesh.length_x, 1e3 * mesh.length_y
    ratio = sides[1] / sides[0]
    longest = 5.4
    n = max(1, len(field.directions))
    # Several maps one below another where the plate is wide or the screen is narrow.
    below = narrow or ratio < 0.5
    size = max(longest / max(ratio, 1) + 2.1, 5.0), longest * min(ratio, 1) + 1.9
    if narrow:
        size = NARROW, n * min(max(2.7 * ratio, 0.6), 4.5) + 2.2
    elif n > 1:
        size = (size[0], n * (size[1] - 1.5) + 1.5) if below else (9.0, 2.7 * ratio + 2.2)
    figure = Figure(figsize=size, layout="constrained")
    axes = list(figure.subplots(*((n, 1) if below else (1, n)), squeeze=False, sharex=True, sharey=True).flat)
    label, factor = _quantity(field)
    values = factor * np.array(field.values).reshape(n, field.n_y, field.n_x)
    top = float(np.abs(values).max()) or 1.0
    x, y = (np.linspace(0, side, n) for side, n in zip(sides, (field.n_x, field.n_y), strict=True))
    for axis, one in zip(axes, values, strict=True):
        image = axis.contourf(x, y, one, levels=np.linspace(-top, top, 31), cmap=SHAPE, zorder=0)
        image.set_edgecolor("face")
        image.set_gid(SHADED)
    on_top = narrow or ratio < 0.4 or n > 1
    where: dict[str, Any] = {"location": "top", "aspect": 50} if on_top else {"location": "right"}
    bar = figure.colorbar(image, ax=axes, shrink=0.7, pad=0.02, ticks=MaxNLocator(5), **where)
    bar.set_label(label, color=INK, fontsize=8.5)
    bar.outline.set_visible(False)
    shade(bar)
    bar.ax.tick_params(colors=MUTED, labelsize=8.5)
    for axis, name in zip(axes, field.directions, strict=False):
        axis.set_title(name, fontsize=8.5, color=INK)
    for axis in axes:
        handles = _marked(axis, diagnosis, field, sides)
        axis.set_xlabel("x [mm]" if not below or axis is axes[-1] else "", color=INK)
        axis.set_ylabel("y [mm]" if below or axis is axes[0] else "", color=INK)
    figure.legend(handles=handles, loc="outside lower center", ncol=1 if narrow else 2, frameon=False,
                  fontsize=8.5)  # fmt: skip
    return figure


def _marked(axis: Axes, diagnosis: Diagnosis, field: FoundField, sides: tuple[float, float]) -> list[Line2D]:
    """The plate, its channels, and where the field sits, drawn; what they are called."""
    handles = draw_plate(axis, diagnosis, sides) + draw_channels(axis, diagnosis, sides)
    marks = [("its centre", [field.place], FOUND), ("or there, by symmetry", list(field.others), PAPER)]
    for name, places, colour in marks:
        if places:
            style: dict[str, Any] = {"marker": "P", "ms": 9, "mfc": colour, "mec": FOUND, "mew": 1.0, "ls": "none"}
            axis.plot(*(side * np.array(one) for side, one in zip(sides, zip(*places, strict=True), strict=True)),
                      **style, zorder=6)  # fmt: skip
            handles.append(Line2D([], [], **style, label=name))
    margin = 0.045 * max(sides)
    axis.set(xlim=(-margin, sides[0] + margin), ylim=(-margin, sides[1] + margin), aspect="equal")
    axis.tick_params(colors=MUTED, labelsize=8.5, length=0)
    axis.spines[:].set_visible(False)
    return handles


def _quantity(field: FoundField) -> tuple[str, float]:
    """What its shades are, and what a value is times."""
    return EXPLAINED if field.form == ONE_FORCE else QUANTITIES[field.kind]


def field_told(field: FoundField) -> str:
    """The same in words."""
    largest = max(range(len(field.values)), key=lambda k: abs(field.values[k]))
    part, node = divmod(largest, field.n_x * field.n_y)
    row, column = divmod(node, field.n_x)
    direction = f" ({field.directions[part]})" if field.directions else ""
    label, factor = _quantity(field)
    x, y = column / (field.n_x - 1), row / (field.n_y - 1)
    return (
        f"A field over the plate, {label}: the largest value, {factor * field.values[largest]:.3g}{direction}, is at "
        f"x {x:.2f}, y {y:.2f} of the sides; its centre is at x {field.place[0]:.2f}, y {field.place[1]:.2f}."
    )
