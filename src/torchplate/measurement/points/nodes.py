"""A table of nodes, for files that hold no coordinates: node, x, y and, if wanted, z, one node a line."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from torchplate.measurement.formats.parsing import reads
from torchplate.measurement.formats.text_table import cells_of, lines_of, number_of
from torchplate.measurement.measurement import Channel, Measurement, MeasurementError
from torchplate.measurement.points.frame import METRES
from torchplate.measurement.points.heads import is_head, is_row_of_units, known, units_of
from torchplate.measurement.read import UFF_SUFFIX
from torchplate.measurement.uff.geometry import read_geometry

Point = tuple[float, float, float]


class NodeTable(NamedTuple):
    """Places of nodes.

    Attributes:
        places: node label → (x, y, z) in the table's own unit; z is 0 where the table has none.
        unit: of METRES, where the table's head states one.
        source: the table's path.
    """

    places: dict[int, Point]
    unit: str | None
    source: str

    def scaled(self, unit: str) -> dict[int, Point]:
        """The places in this unit, where the table's head states its own; else as they are."""
        if self.unit in (None, unit):
            return self.places
        factor = METRES[self.unit] / METRES[unit]
        return {node: (factor * x, factor * y, factor * z) for node, (x, y, z) in self.places.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """What the head of the table was taken for."""
        return () if self.unit is None else (f"places are taken in {self.unit}, as the head of {self.source} says.",)


def read_nodes(path: Path) -> dict[int, Point]:
    """Read a table of nodes, as `read_node_table` does.

    Returns:
        Node label → (x, y, z) in the table's own unit; z is 0 where the table has none.
    """
    return read_node_table(path).places


@reads("a table of nodes")
def read_node_table(path: Path) -> NodeTable:
    """Read a table of nodes; columns apart by commas, semicolons, tabs or blanks; a first line of words is its head.

    A comma within a number is a decimal point where something else parts the columns. The head, or a row below it, may
    state the unit of the places: x [mm], y (mm), x_mm.

    A universal file is taken for its datasets 15 and 2411.

    Raises:
        MeasurementError: The file is absent, or a line is not a node with two or three numbers, or a node comes twice,
            or the head states a unit that is not known, or several.
    """
    if path.suffix.lower() in UFF_SUFFIX:
        places, _ = read_geometry(path)
        if not places:
            raise MeasurementError(
                f"{path}: expected nodes (dataset 15 or 2411), got none. Export the geometry, or write a table "
                "with the columns node, x, y."
            )
        return NodeTable(places, None, str(path))
    lines = _lines(path)
    found: dict[int, Point] = {}
    units: list[str] = []
    heads = 0
    for number, line in enumerate(lines, start=1):
        text, _, remark = line.partition("#")
        cells = cells_of(text)
        if not cells:
            # NumPy writes its heads as remarks.
            if not found and is_head(head := cells_of(remark)):
                units += units_of(head)
            continue
        try:
            values = [number_of(cell) for cell in cells]
        except ValueError:
            if not found and (heads == 0 or (heads == 1 and is_row_of_units(cells))):
                units += cells[1:] if heads else units_of(cells)
                heads += 1
                continue
            values = []
        heads = max(heads, 1)
        if len(values) not in (3, 4) or values[0] != int(values[0]):
            raise MeasurementError(
                f"{path}: expected a node label and two or three coordinates in line {number}, got "
                f"{line.strip()[:60]!r}. Write it as 12, 0.1, 0.05."
            )
        node = int(values[0])
        if node in found:
            raise MeasurementError(f"{path}: expected each node once, got {node} again in line {number}. Remove one.")
        found[node] = (values[1], values[2], values[3] if len(values) == 4 else 0.0)
    if not found:
        raise MeasurementError(f"{path}: expected a node in each line, got none. Write node, x, y[, z], one a line.")
    return NodeTable(found, _one_unit(units, path), str(path))


def _lines(path: Path) -> list[str]:
    """The lines of a table.

    Raises:
        MeasurementError: It cannot be read.
    """
    if path.exists() and not path.is_file():  # a pipe that nobody writes into would be waited for
        raise MeasurementError(f"{path}: expected a table of nodes, got what is no file. Check the path.")
    try:
        return lines_of(path)
    except FileNotFoundError as error:
        raise MeasurementError(
            f"{path}: expected a table of nodes, got no such file. Write it, a node a line as 12, 0.1, 0.05, or check "
            "the path."
        ) from error
    except OSError as error:
        raise MeasurementError(
            f"{path}: expected a table of nodes (node, x, y[, z]), got none that can be read. Check the path."
        ) from error


def _one_unit(stated: Sequence[str], path: Path) -> str | None:
    """The unit of all places, from what a head states of each column.

    Raises:
        MeasurementError: It is not known, or another for another column.
    """
    shown = list(dict.fromkeys(text for unit in stated if (text := unit.strip("[]() ")[:20])))
    units = {known(unit) for unit in shown}
    if len(units) > 1 or None in units:
        raise MeasurementError(
            f"{path}: expected one unit of length in the table's head, of {', '.join(METRES)}, got "
            f"{' and '.join(map(repr, shown))}. Write the places in one of these, as node, x [mm], y [mm]."
        )
    return units.pop() if units else None


def with_nodes(measurement: Measurement, nodes: Mapping[int, Point], source: str) -> Measurement:
    """The measurement with the coordinates of its channels taken from a table.

    Raises:
        MeasurementError: The table lacks a node that was measured.
    """
    channels = measurement.response
    if measurement.kind != "transmissibility":
        channels = (*channels, *measurement.reference)
    missing = sorted({c.node for c in channels if c.node not in nodes})
    if missing:
        raise MeasurementError(
            f"{source}: expected every measured node, got none of {', '.join(map(str, missing[:6]))}. Add "
            f"{'it' if len(missing) == 1 else 'them'}."
        )

    def placed(channel: Channel) -> Channel:
        return replace(channel, coordinate=nodes.get(channel.node, channel.coordinate))

    return replace(
        measurement,
        response=tuple(placed(channel) for channel in measurement.response),
        reference=tuple(placed(channel) for channel in measurement.reference),
    )


def with_node_table(measurement: Measurement, table: NodeTable, unit: str) -> Measurement:
    """The measurement with the coordinates of its channels taken from a table, and the note on the table's unit.

    Args:
        measurement: It.
        table: Of the nodes.
        unit: That the coordinates are to be in, where the table says its own; a table that says none is in it.

    Raises:
        MeasurementError: The table lacks a node that was measured.
    """
    found = with_nodes(measurement, table.scaled(unit), table.source)
    return replace(found, notes=(*found.notes, *table.notes))
