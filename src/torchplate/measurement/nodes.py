"""A table of nodes, for files that hold no coordinates: node, x, y and, if wanted, z, one node a line."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from torchplate.measurement.measurement import Channel, Measurement, MeasurementError
from torchplate.measurement.parsing import reads
from torchplate.measurement.read import UFF_SUFFIX
from torchplate.measurement.text_table import cells_of, lines_of
from torchplate.measurement.uff_geometry import read_geometry

Point = tuple[float, float, float]


@reads("a table of nodes")
def read_nodes(path: Path) -> dict[int, Point]:
    """Read a table of nodes; columns apart by commas, semicolons, tabs or blanks; a first line of words is skipped.

    A comma within a number is a decimal point where something else parts the columns.

    A universal file is taken for its datasets 15 and 2411.

    Returns:
        Node label → (x, y, z) in the table's own unit; z is 0 where the table has none.

    Raises:
        MeasurementError: The file is absent, or a line is not a node with two or three numbers, or a node comes twice.
    """
    if path.suffix.lower() in UFF_SUFFIX:
        places, _ = read_geometry(path)
        if not places:
            raise MeasurementError(
                f"{path}: expected nodes (dataset 15 or 2411), got none. Export the geometry, or write a table "
                "with the columns node, x, y."
            )
        return places
    try:
        lines = lines_of(path)
    except FileNotFoundError as error:
        raise MeasurementError(
            f"{path}: expected a table of nodes, got no such file. Write it, a node a line as 12, 0.1, 0.05, or check "
            "the path."
        ) from error
    except OSError as error:
        raise MeasurementError(
            f"{path}: expected a table of nodes (node, x, y[, z]), got none that can be read. Check the path."
        ) from error
    found: dict[int, Point] = {}
    began = False
    for number, line in enumerate(lines, start=1):
        cells = cells_of(line.partition("#")[0])
        if not cells:
            continue
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            if not began:
                began = True
                continue
            values = []
        began = True
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
    return found


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
