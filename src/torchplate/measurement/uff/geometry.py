"""Units and nodes of a universal file: datasets 164, 15 and 2411, in the global coordinate system.

Source: Universal File Format, University of Cincinnati SDRL.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from torchplate.measurement.formats.parsing import reads
from torchplate.measurement.level import Units
from torchplate.measurement.measurement import MeasurementError
from torchplate.measurement.uff.coordinate_system import GLOBAL, CoordinateSystem, systems_of
from torchplate.measurement.uff.dataset import UffFile, in_global, open_uff

Point = tuple[float, float, float]


@dataclass(eq=False)
class Geometry:
    """What a universal file says of its nodes.

    Attributes:
        units: Of the file.
        places: Where each node is, in global coordinates [m].
        turned: Of nodes whose directions are not the global ones: x, y, z in global coordinates, one a row.
        notes: What is to be said of them.
    """

    units: Units = field(default_factory=Units)
    places: dict[int, Point] = field(default_factory=dict)
    turned: dict[int, np.ndarray] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def geometry_of(file: UffFile) -> Geometry:
    """Units and nodes of an open file, out of the coordinate systems that it defines.

    Raises:
        MeasurementError: A dataset does not parse, or a node is in a system whose axes cannot be.
    """
    found = Geometry()
    stated = _units(file, found.notes)
    found.units = next(reversed(stated.values()), Units())
    if len({*stated.values()}) > 1:
        found.notes.append(
            "The file states different units (dataset 164): places are taken in those that stand before them, levels "
            "without a label of their own in the last."
        )
    systems = systems_of(file.read(index) for index in file.of_type(18, 2420))
    moved: dict[int, list[int]] = {}
    strange: dict[int, list[int]] = {}
    for index in file.of_type(15, 2411):
        dataset = file.read(index)
        before = [units for at, units in stated.items() if at < index]
        units = before[-1] if before else next(iter(stated.values()), Units())
        columns = ("node_nums", "def_cs", "disp_cs", "x", "y", "z")
        for node, of_place, of_direction, *xyz in zip(*(dataset[name] for name in columns), strict=True):
            label, own, ways = int(node), int(of_place), int(of_direction)
            place = _system(systems, own, label, file.path, strange).point(np.array(xyz, dtype=np.float64))
            if own in systems and systems[own] is not GLOBAL:
                moved.setdefault(own, []).append(label)
            x, y, z = (place / units.length).tolist()
            found.places[label] = (x, y, z)
            rows = _system(systems, ways, label, file.path, {}).directions(place)
            found.turned.pop(label, None)
            if not np.array_equal(rows, np.eye(3)):
                found.turned[label] = rows
    if moved:
        n, named = sum(map(len, moved.values())), ", ".join(map(str, sorted(moved)[:6]))
        found.notes.append(
            f"The places of {n} node{'s' * (n > 1)} were turned into the global coordinate system, from "
            f"{named}{', ...' * (len(moved) > 6)} (dataset 18 or 2420)."
        )
    if strange:
        n, named = sum(map(len, strange.values())), ", ".join(map(str, sorted(strange)[:6]))
        found.notes.append(
            f"The file gives {n} node{'s' * (n > 1)} in coordinate systems that it does not define ({named}): the "
            "places are taken as global. Export datasets 18 or 2420 with them if they are not."
        )
    return found


def _system(
    systems: dict[int, CoordinateSystem | None], number: int, node: int, path: Path, strange: dict[int, list[int]]
) -> CoordinateSystem:
    """The system of that number; the global one where the file defines none so."""
    if number not in systems:
        strange.setdefault(number, []).append(node)
        return GLOBAL
    found = systems[number]
    if found is None:
        raise MeasurementError(
            f"{path}: expected coordinate system {number} of node {node} with three axes at right angles, by a system "
            "that the file defines, got another. Correct dataset 18 or 2420, or export the nodes in the global system."
        )
    return found


@reads("a universal file")
def read_geometry(path: Path) -> tuple[dict[int, Point], int | None]:
    """Every node of a universal file [m by its units], and the axis most of its FRFs point along, 1 to 3, if any.

    Raises:
        MeasurementError: Not a universal file, or a dataset that does not parse.
    """
    file = open_uff(path)
    geometry = geometry_of(file)
    axes = [0, 0, 0, 0]
    for index in file.of_type(58):
        header = file.header(index)
        turned = geometry.turned.get(int(header["rsp_node"]))
        direction = int(header["rsp_dir"])
        if int(header["func_type"]) in (4, 5) and abs(direction) in (1, 2, 3):
            axes[abs(in_global(direction, turned)[0])] += 1
    return geometry.places, axes.index(max(axes)) if any(axes) else None


def _units(file: UffFile, notes: list[str]) -> dict[int, Units]:
    """Each dataset 164 of a file by its place there."""
    found: dict[int, Units] = {}
    for index in file.of_type(164):
        dataset = file.read(index)
        stated = Units(float(dataset["length"]), float(dataset["force"]))
        if int(dataset["units_code"]) == 1:
            # Code 1 is metre and newton by definition; factors of feet beside it are copied from the format's
            # example, as in pyuff's own.
            if stated != Units():
                notes.append("Dataset 164 says SI but gives other factors; SI was taken.")
            found[index] = Units()
            continue
        if min(stated) <= 0:
            raise MeasurementError(
                f"{file.path}: expected positive unit factors in dataset 164, got length {stated.length:g} and force "
                f"{stated.force:g}. Correct or remove that dataset."
            )
        found[index] = stated
    return found
