"""Mode shapes of a model as small multiples, the measured ones beside where there are channels enough to draw them."""

from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.tri import Triangulation
from torch import Tensor

from torchplate.measurement import Measurement
from torchplate.model import DENSE, PlateModel, SparseModel
from torchplate.report.blocks.document import Panel
from torchplate.report.figures.measured_shapes import Shape, measured_shapes, roved
from torchplate.report.figures.style import INK, MUTED, NARROW, SHADED, SHAPE, TITLE

N_MODE = 12
"""Modes that are drawn."""
N_GRID = 21
"""Places along each side at which a shape is looked at: five to a half wave of the fourth order."""
RIGID = 1e-3
"""A mode below this part of the band's end does not bend the plate."""
LEVELS = np.linspace(-1, 1, 12)


class Mode(NamedTuple):
    """One mode of the model.

    Attributes:
        number: counted from 1, rigid-body modes included.
        frequency: [Hz].
        field: deflection over a grid of places, the largest ±1 [n_y, n_x].
        measured: at the resonance that was measured; None where none was, or from too few places.
    """

    number: int
    frequency: float
    field: Float[Tensor, "n_y n_x"]
    measured: Shape | None


@torch.no_grad()
def modes_of(model: PlateModel, theta: Float[Tensor, " n_parameter"], measurement: Measurement | None) -> list[Mode]:
    """The lowest modes that bend the plate in the measured band, or from zero where no FRF was measured.

    Args:
        model: its responses and references are those of the measurement.
        theta: its searched parameters in SI units.
        measurement: FRFs, if any.
    """
    low, high = (0.0, 0.0) if measurement is None else (float(one) for one in measurement.frequency[[0, -1]])
    full = SparseModel(model, theta)  # of all dofs, whatever basis the model was searched in
    solved = full.modes(N_MODE + 6, high, dense=full.stiffness.shape[0] <= DENSE)
    hertz = solved.frequency.double().cpu()
    least = max(low, RIGID * (high or float(hertz[-1])))
    kept = [int(index) for index in torch.nonzero(hertz >= least).flatten() if not high or float(hertz[index]) <= high]
    kept = kept[:N_MODE]
    if not kept:
        return []
    shape = solved.shape[:, kept].double().cpu()
    x = torch.linspace(0, 1, N_GRID, dtype=torch.float64)
    grid = torch.stack(torch.meshgrid(x, x, indexing="xy"), -1).reshape(-1, 2)
    field = _deflection(model, grid) @ shape
    seen = _measured(model, measurement, hertz[kept], shape)
    found = []
    for turn, index in enumerate(kept):
        one = field[:, turn]
        largest = one[one.abs().argmax()]
        beside = seen.get(turn)
        if beside is not None and float(largest) < 0:
            beside = beside._replace(value=-beside.value)
        found.append(Mode(index + 1, float(hertz[index]), (one / largest).reshape(N_GRID, N_GRID), beside))
    return found


def _deflection(model: PlateModel, place: Float[Tensor, "n_place 2"]) -> Float[Tensor, "n_place n_free"]:
    """Deflection at relative places as rows over the free dofs."""
    rows = model.mesh.deflection_at(place.to(model.known))
    return rows[..., model.assembly.free].double().cpu()


def _measured(
    model: PlateModel, measurement: Measurement | None, hertz: Tensor, shape: Float[Tensor, "n_free n_mode"]
) -> dict[int, Shape]:
    if measurement is None:
        return {}
    ends = []
    for points in (model.response, model.reference):
        ends.append(torch.zeros(0, 2) if points is None else model.mesh.places(list(points)))
    measurement = measurement.to(torch.device("cpu"))
    found = roved(measurement, *(end.double().cpu() for end in ends))
    if found is None:
        return {}
    found = found._replace(frf=found.frf.to(torch.complex128))
    at_channels = _deflection(model, found.place) @ shape
    return measured_shapes(measurement.frequency.double(), found, hertz, at_channels)


def mode_shapes(modes: list[Mode], sides: tuple[float, float]) -> tuple[Panel, ...]:
    """A panel for each mode: the model's shape, and the measured one beside where any mode has one.

    Args:
        modes: to be drawn.
        sides: of the plate [m].
    """
    paired = any(mode.measured is not None for mode in modes)
    return tuple(Panel(partial(_drawn, mode, sides, paired), told(mode, paired), small=not paired) for mode in modes)


def told(mode: Mode, paired: bool) -> str:
    """A mode in words."""
    said = f"Mode {mode.number} of the model at {mode.frequency:.4g} Hz"
    if mode.measured is not None:
        return f"{said}; measured at {mode.measured.frequency:.4g} Hz, MAC {mode.measured.mac:.2f}."
    return f"{said}; no peak was measured near it." if paired else f"{said}."


def modes_caption(modes: list[Mode]) -> str:
    """How to read them."""
    said = (
        f"The lowest {len(modes)} modes of the model in the measured band, or that bend the plate where no band was "
        "measured: number and natural frequency. The two colours move against each other; the line between them is "
        "at rest."
    )
    if any(mode.measured is not None for mode in modes):
        said += (
            " Beside each, the shape that was measured at the nearest resonance (dots: the channels) and its MAC with "
            "the model's: 1 where they are alike, 0 where they have nothing in common."
        )
    return said


def composite(modes: list[Mode], sides: tuple[float, float]) -> Figure:
    """All in one figure, for a file of its own."""
    paired = any(mode.measured is not None for mode in modes)
    n_column = min(3 if paired else 6, len(modes))
    n_row = -(-len(modes) // n_column)
    width = 9.6 / n_column
    figure = Figure(figsize=(9.6, n_row * _height(width, sides, paired)), layout="constrained")
    cells = figure.subfigures(n_row, n_column, squeeze=False).ravel()
    for cell, mode in zip(cells, modes, strict=False):
        _draw(list(cell.subplots(1, 1 + paired, squeeze=False)[0]), mode, sides)
    return figure


def _height(width: float, sides: tuple[float, float], paired: bool) -> float:
    """Of a panel of that width [in]: the plate, and its title."""
    return min(0.95 * width / (1 + paired) * sides[1] / sides[0], 2.6) + 0.32


def _drawn(mode: Mode, sides: tuple[float, float], paired: bool) -> Figure:
    width = NARROW if paired else NARROW / 2 - 0.1
    figure = Figure(figsize=(width, _height(width, sides, paired)), layout="constrained")
    _draw(list(figure.subplots(1, 1 + paired, squeeze=False)[0]), mode, sides)
    return figure


def _draw(axes: list[Axes], mode: Mode, sides: tuple[float, float]) -> None:
    x, y = (np.linspace(0, side, N_GRID) for side in sides)
    field = mode.field.numpy()
    axes[0].contourf(x, y, field, levels=LEVELS, cmap=SHAPE, extend="both").set_gid(SHADED)
    axes[0].contour(x, y, field, levels=[0.0], colors=INK, linewidths=0.8)
    axes[0].set_title(f"{mode.number}: {mode.frequency:.4g} Hz", y=TITLE, fontsize=8.5, color=INK, pad=3)
    for axis in axes:
        axis.add_patch(Rectangle((0, 0), *sides, fill=False, edgecolor=MUTED, lw=1.0))
        axis.set(xlim=(-0.03 * sides[0], 1.03 * sides[0]), ylim=(-0.03 * sides[1], 1.03 * sides[1]), aspect="equal")
        axis.set_axis_off()
    if len(axes) == 1:
        return
    if mode.measured is None:
        axes[1].set_title("no peak near it", y=TITLE, fontsize=8.5, color=MUTED, pad=3)
        return
    seen = mode.measured
    axes[1].set_title(f"{seen.frequency:.4g} Hz, MAC {seen.mac:.2f}", y=TITLE, fontsize=8.5, color=INK, pad=3)
    place = seen.place.numpy() * sides
    value = (seen.value / seen.value.abs().max()).numpy()
    if len(np.unique(place, axis=0)) == len(place):
        mesh = Triangulation(*place.T)
        axes[1].tricontourf(mesh, value, levels=LEVELS, cmap=SHAPE, extend="both").set_gid(SHADED)
    axes[1].plot(*place.T, ls="none", marker="o", ms=2.2, mfc=INK, mec="none")
