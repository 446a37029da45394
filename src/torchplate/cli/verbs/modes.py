"""`torchplate modes FILE`: natural frequencies, damping and mode shapes of measured FRFs."""

import shlex
from pathlib import Path

import numpy as np
from rich.console import Console

from torchplate.cli.config import InputError
from torchplate.cli.folder.writing import asked_for
from torchplate.cli.progress.console import speaking
from torchplate.cli.results.table import plain_table
from torchplate.discrepancy import mac
from torchplate.measurement import (
    MODAL_SUFFIX,
    Analysed,
    MeasurementError,
    ModalModel,
    propose,
    read_measurement,
    read_node_table,
    with_node_table,
    write_modal_model,
)
from torchplate.measurement import modes as analyse
from torchplate.notation import number_of_percent, percent

# Of the matrix, what a terminal holds in one line.
MOST_COLUMNS = 12


def modes(
    file: Path,
    out: Path | None = None,
    lowest: float | None = None,
    highest: float | None = None,
    order: int = 40,
    nodes: Path | None = None,
    console: Console | None = None,
    *,
    force: bool = False,
) -> Analysed:
    """Estimate the modes of measured FRFs, print them, and write them if wanted.

    Args:
        file: FRFs.
        out: .csv, .uff, .unv or .uf.
        lowest: end of the band [Hz].
        highest: the other end [Hz].
        order: modes at most that the polynomials can hold.
        nodes: table of the nodes' places [m].
        console: where is said what was found.
        force: write over another file of that name.

    Raises:
        InputError: `out` has another suffix or holds something else, or the order is too low.
        MeasurementError: The FRFs cannot be used, or the package for it is not there.
    """
    console = console or speaking()
    if out is not None and out.suffix.lower() not in MODAL_SUFFIX:
        raise InputError(f"--out {out}: Expected a name that ends in .csv or .uff, got '{out.suffix}'. Rename it.")
    if order < 4:
        raise InputError(f"--order {order}: Expected 4 or more, got {order}. Raise it.")
    measurement = read_measurement(file)
    if nodes is not None:
        measurement = with_node_table(measurement, read_node_table(nodes), "m")
    found = analyse(measurement, lowest, highest, order)
    _say(found, console)
    if out is not None:
        with asked_for(out, force=force) as partial:
            write_modal_model(found.model, partial, out.suffix)
        console.print(f"Modes: {out}", highlight=False, markup=False, soft_wrap=True)
        key = f"measurement: {{modal_model: {{file: {shlex.quote(out.name)}}}{_frame(found.model)}}}"
        console.print(f"Next: in a config, {key}", highlight=False, markup=False, soft_wrap=True)
    return found


def _frame(model: ModalModel) -> str:
    """The plate's frame in the coordinates of its points, as a key of the config, where they are not its own in m."""
    points = [channel.coordinate for channel in model.point if channel.coordinate is not None]
    if not points:
        return ""
    try:
        frame = propose(np.array(points, dtype=np.float64)).frame
    except MeasurementError:
        return ""
    if frame.unit == "m":
        return ""
    origin = ", ".join(f"{value:g}" for value in frame.origin)
    return f", frame: {{unit: {frame.unit}, origin: [{origin}]}}"


def _say(found: Analysed, console: Console) -> None:
    model = found.model
    table = plain_table("mode", "frequency [Hz]", "damping ratio", "indicator", "collinearity", "orders")
    for index, (hertz, ratio) in enumerate(zip(model.frequency.tolist(), model.damping_ratio.tolist(), strict=True)):
        told = (found.indicator[index], found.collinearity[index])
        numbers = [f"{hertz:.3f}", percent(ratio), *(f"{one:.2f}" for one in told)]
        table.add_row(str(index + 1), *numbers, percent(float(found.orders[index]), 2))
    console.print(table)
    console.print(
        "  indicator: 1 where all FRFs are in quadrature with the force; collinearity: 1 where all points move in "
        "phase; orders: in how many fits the mode came back.",
        highlight=False,
        style="dim",
    )
    if len(model.point) > 2:
        alike = mac(model.shape, model.shape)
        n_mode = min(len(alike), MOST_COLUMNS)
        console.print("MAC of the modes with each other [%]", highlight=False)
        matrix = plain_table("", *(str(number + 1) for number in range(n_mode)))
        matrix.padding = (0, 1)
        for number, row in enumerate(alike[:n_mode, :n_mode].tolist(), start=1):
            matrix.add_row(str(number), *(number_of_percent(value, decimals=0) for value in row))
        console.print(matrix)
        if len(alike) > n_mode:
            console.print(f"  of the first {n_mode}; --out writes all shapes.", style="dim", highlight=False)
    for note in model.notes:
        console.print(f"  Note: {note}", highlight=False, markup=False, soft_wrap=True)
