"""Coordinate systems of a universal file (datasets 18 and 2420), and the way from them to the global one.

Source: Universal File Format, University of Cincinnati SDRL, datasets 18, 2411 and 2420. The fourth row of a
2420's matrix is the origin, so a point is a row: global = local · (rows 1 to 3) + row 4. Angles are in degrees.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

CARTESIAN, CYLINDRICAL, SPHERICAL = 0, 1, 2
NAME: Final = {CARTESIAN: "Cartesian", CYLINDRICAL: "cylindrical", SPHERICAL: "spherical"}
RIGHT: Final = 0.01
"""How far the axes of a system may be from unit length and from right angles to each other [-], as files round."""


@dataclass(frozen=True, eq=False)
class CoordinateSystem:
    """Where a system lies in the global one.

    Args:
        kind: Cartesian (x, y, z), cylindrical (r, θ, z) or spherical (r, θ from z, φ); angles in degrees.
        axes: Unit vectors along its own x, y and z, one a row.
        origin: In the file's unit of length.
    """

    kind: int
    axes: Float[np.ndarray, "3 3"]
    origin: Float[np.ndarray, " 3"]

    def point(self, value: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """A point of this system in global coordinates."""
        first, second, third = (float(part) for part in value)
        if self.kind == CYLINDRICAL:
            angle = math.radians(second)
            value = np.array([first * math.cos(angle), first * math.sin(angle), third])
        elif self.kind == SPHERICAL:
            value = first * _spherical(math.radians(second), math.radians(third))[0]
        return value @ self.axes + self.origin

    def directions(self, place: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
        """Unit vectors along the three coordinates at a global place, one a row, in global coordinates."""
        if self.kind == CARTESIAN:
            return self.axes
        x, y, z = (float(part) for part in self.axes @ (place - self.origin))
        angle = math.atan2(y, x)
        if self.kind == CYLINDRICAL:
            c, s = math.cos(angle), math.sin(angle)
            return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ self.axes
        return _spherical(math.atan2(math.hypot(x, y), z), angle) @ self.axes


GLOBAL: Final = CoordinateSystem(CARTESIAN, np.eye(3), np.zeros(3))


def _spherical(theta: float, phi: float) -> Float[np.ndarray, "3 3"]:
    """Unit vectors along r, θ and φ, in a system's own x, y and z."""
    ct, st, cp, sp = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
    return np.array([[st * cp, st * sp, ct], [ct * cp, ct * sp, -st], [-sp, cp, 0.0]])


def systems_of(datasets: Iterable[Mapping[str, Any]]) -> dict[int, CoordinateSystem | None]:
    """The systems that datasets 18 and 2420 define, by number; None for one whose axes cannot be.

    0 is the global one, and so is 1 where no dataset defines it, as many exporters mean it.

    Args:
        datasets: As pyuff reads them.
    """
    found: dict[int, CoordinateSystem | None] = {}
    waiting: dict[int, tuple[int, int, np.ndarray]] = {}
    for one in datasets:
        if int(one["type"]) == 18:
            columns = (one["cs_num"], one["cs_type"], one["ref_cs_num"], one["ref_o"], one["x_point"], one["xz_point"])
            for label, kind, reference, *three in zip(*columns, strict=True):
                waiting[int(label)] = int(kind), int(reference), np.array(three, dtype=np.float64)
        else:
            named = (one["CS_sys_labels"], one["CS_types"], one["CS_matrices"])
            for label, kind, matrix in zip(*named, strict=True):
                table = np.asarray(matrix, dtype=np.float64)
                found[int(label)] = _system(int(kind), table[:3], table[3]) if table.shape == (4, 3) else None
    for label in {0, 1} - set(found) - (set(waiting) - {0}):
        found[label] = GLOBAL
    while waiting:
        ready = [label for label, (_, reference, _) in waiting.items() if reference in found]
        if not ready:
            return found | dict.fromkeys(waiting)
        for label in ready:
            kind, reference, points = waiting.pop(label)
            under = found[reference]
            if label not in found:
                found[label] = None if under is None else _by_points(kind, np.stack([under.point(p) for p in points]))
    return found


def _by_points(kind: int, points: np.ndarray) -> CoordinateSystem | None:
    """By its origin, a point on its +x axis and one in its +xz plane."""
    origin, along, beside = points
    x = along - origin
    y = np.cross(beside - origin, x)
    lengths = float(np.linalg.norm(x)), float(np.linalg.norm(y))
    if min(lengths) <= 0:
        return None
    x, y = x / lengths[0], y / lengths[1]
    return _system(kind, np.stack([x, y, np.cross(x, y)]), origin)


def _system(kind: int, axes: np.ndarray, origin: np.ndarray) -> CoordinateSystem | None:
    if kind not in NAME or not np.isfinite(axes).all() or not np.isfinite(origin).all():
        return None
    return CoordinateSystem(kind, axes, origin) if np.abs(axes @ axes.T - np.eye(3)).max() <= RIGHT else None
