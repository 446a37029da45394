"""The plate's sides and axes, proposed from the points of a test.

Everything here is a proposal: each part comes with the sentence that says where it is from, and whether it is a guess.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from torchplate.measurement.measurement import MOST, MeasurementError
from torchplate.measurement.points.frame import METRES, Frame
from torchplate.notation import percent

SLACK: Final = 0.01
"""How far a point may lie off where it should be, over the longer side [-]; see `placement.OFF_PLATE`."""
LARGE: Final = 10.0
"""A plate of more than this side is taken as one in millimetres [units of the file]."""
SMALL: Final = 100.0
"""A plate of less than this side in millimetres is more likely one in centimetres [units of the file]."""
LEAST_FILL: Final = 0.25
"""Points that span less of the longer side tell no unit [-]."""
TURNED: Final = 0.7
"""A turned grid must line its points up on this part of the rows and columns that the file's own axes need, or less."""


class Said(NamedTuple):
    """A part of the proposal, and where it is from."""

    text: str
    guess: bool


@dataclass(frozen=True)
class Proposal:
    """Sides and frame of a plate.

    Args:
        frame: Unit, origin and axes.
        length_x: Side along the frame's x [m].
        length_y: Side along the frame's y [m].
        unit, axes, origin, sides: Where each is from.
    """

    frame: Frame
    length_x: float
    length_y: float
    unit: Said
    axes: Said
    origin: Said
    sides: Said


def propose(
    points: Float[np.ndarray, "n_point 3"],
    normal: int = 3,
    sides: tuple[float, float] | None = None,
    unit: str | None = None,
    source: str = "The file",
) -> Proposal:
    """Fit a rectangular plate to the points of a test.

    Args:
        points: (x, y, z) of each, in the file's coordinates.
        normal: The file's axis that the measured directions say is out of the plate, 1 to 3; the points decide
            where three of them do not lie on one line.
        sides: The plate's sides along x and y [m], if known.
        unit: Of the points, if known.
        source: Who is named in errors.

    Raises:
        MeasurementError: The points lie in no plane, or are too few to tell a side that is not given, or do not fit
            on the plate.
    """
    # Which NaN is not.
    if not (np.abs(points) < MOST).all():
        raise MeasurementError(
            f"{source}: expected finite coordinates, got NaN or infinity, or more than {MOST:g}. Correct the nodes."
        )
    cloud = np.unique(np.round(points, 12), axis=0)
    base, flat = _plane(cloud, normal, source)
    angle = _angle(cloud @ base[:2].T)
    turn = np.array([[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    axes = turn @ base
    seen = cloud @ axes[:2].T
    low, high = seen.min(axis=0), seen.max(axis=0)
    name, unit_said = _unit(high - low, low, high, sides, unit)
    factor = METRES[name]
    low, high = low * factor, high * factor
    if sides is not None and _swapped(high - low, sides):
        axes = np.stack([axes[1], -axes[0], axes[2]])
        low, high = np.array([low[1], -high[0]]), np.array([high[1], -low[0]])
        angle += math.pi / 2
    found = [_side(low[i], high[i], None if sides is None else sides[i], "xy"[i], source) for i in (0, 1)]
    corner = np.array([start for start, _, _, _ in found]) / factor
    level = float((cloud @ axes[2]).mean())
    # Universal files give places in six digits, and of a plate beside the origin they leave five of its sides.
    digits = 6 if sides is not None else 5
    origin = corner[0] * axes[0] + corner[1] * axes[1] + level * axes[2]
    frame = Frame(name, _vector(origin), _vector(axes[0]), _vector(axes[1]))
    return Proposal(
        frame=frame,
        length_x=float(f"{found[0][1]:.{digits}g}"),
        length_y=float(f"{found[1][1]:.{digits}g}"),
        unit=unit_said,
        axes=_axes_said(axes, angle, flat),
        origin=_join([part[2] for part in found]),
        sides=Said("given", False) if sides is not None else _join([part[3] for part in found]),
    )


def _plane(cloud: np.ndarray, normal: int, source: str) -> tuple[np.ndarray, bool]:
    """Axes with the third out of the plate, and whether that is an axis of the file."""
    centred = cloud - cloud.mean(axis=0)
    extent = float(np.abs(centred).max())
    rank, directions = 0, np.eye(3)
    if extent > 0:
        _, spread, directions = np.linalg.svd(centred, full_matrices=True)
        rank = int((spread > SLACK * spread[0]).sum())
    if rank == 3:
        raise MeasurementError(
            f"{source}: expected the measured points in one plane, got points in space. A plate is flat: measure one "
            "face, or give its nodes by --nodes."
        )
    out = normal - 1
    if rank == 2:
        out = int(np.abs(directions[2]).argmax())
        if abs(directions[2, out]) < 1 - SLACK**2:
            z = directions[2] * np.sign(directions[2, out])
            x = np.eye(3)[(out + 1) % 3]
            x = x - z * (x @ z)
            x = x / np.linalg.norm(x)
            return np.stack([x, np.cross(z, x), z]), False
    # The plane's axes in the file's order; the third is turned where right-handed axes need it.
    inside = np.delete(np.eye(3), out, axis=0)
    return np.vstack([inside, np.cross(*inside)]), True


def _angle(seen: np.ndarray) -> float:
    """By how much the rows of a grid are turned from the axes [rad], −π/4 to π/4; 0 where no grid says otherwise."""
    if len(seen) < 4:
        return 0.0
    extent = float((seen.max(axis=0) - seen.min(axis=0)).max())
    some = seen[np.linspace(0, len(seen) - 1, min(len(seen), 40)).astype(int)]
    step = (some[:, None] - some[None]).reshape(-1, 2)
    step = step[np.hypot(*step.T) > SLACK * extent]
    angles = np.arctan2(step[:, 1], step[:, 0])
    candidates = np.unique(np.round((angles + math.pi / 4) % (math.pi / 2) - math.pi / 4, 4))

    def rows(angle: float) -> int:
        c, s = math.cos(angle), math.sin(angle)
        turned = seen @ np.array([[c, -s], [s, c]])
        return sum(1 + int((np.diff(np.sort(column)) > SLACK * extent).sum()) for column in turned.T)

    straight = rows(0.0)
    count, _, best = min((rows(a), abs(a), a) for a in candidates.tolist())
    if count > TURNED * straight:
        return 0.0
    # The mean over the pairs that point the same way takes the rounding of the file out.
    near = (angles - best + math.pi / 4) % (math.pi / 2) - math.pi / 4
    near = near[np.abs(near) < SLACK]
    return best + float(near.mean()) if abs(best) > 1e-3 else 0.0


def _unit(
    extent: np.ndarray, low: np.ndarray, high: np.ndarray, sides: tuple[float, float] | None, unit: str | None
) -> tuple[str, Said]:
    if unit is not None:
        return unit, Said("the coordinates' unit: given", False)
    reach = float(extent.max())
    if sides is not None and reach > 0:
        # The unit that makes the points fill the plate best without sticking out of it.
        fill = {name: reach * factor / max(sides) for name, factor in METRES.items()}
        fits = {name: part for name, part in fill.items() if LEAST_FILL < part <= 1 + 2 * SLACK}
        if fits:
            name = max(fits, key=lambda key: fits[key])
            share = f"the points then span {percent(fits[name], 2)} of the longer side"
            return name, Said(f"coordinates taken in {name}: {share}", name != "m")
    if float(max(np.abs(low).max(), np.abs(high).max())) > LARGE:
        small = f", one of {reach / 1e3:.3g} m is small" if reach < SMALL else ""
        why = f"a plate of {reach:g} m is not likely"
        others = f"{METRES['cm'] * reach:.3g} or {METRES['in'] * reach:.3g} m"
        remedy = f"give --unit cm or --unit in if they are in one of these ({others})"
        return "mm", Said(f"coordinates taken in mm: {why}{small}; {remedy}", True)
    return "m", Said("coordinates taken in m, as universal files have them", False)


def _swapped(extent: np.ndarray, sides: tuple[float, float]) -> bool:
    """Whether the points fit the sides only when these are exchanged."""
    slack = SLACK * max(sides)
    fits = bool((extent <= np.asarray(sides) + slack).all())
    crossed = bool((extent <= np.asarray(sides[::-1]) + slack).all())
    return crossed and not fits


def _side(low: float, high: float, side: float | None, axis: str, source: str) -> tuple[float, float, Said, Said]:
    """Start and length of one side [m], and where each is from."""
    extent = high - low
    if side is not None:
        slack = SLACK * side
        if extent > side + 2 * slack:
            raise MeasurementError(
                f"{source}: expected points on a plate of {side:g} m along {axis}, got points {extent:g} m apart. "
                "Correct --length (in m), or --unit of the coordinates."
            )
        middle = (low + high) / 2 - side / 2
        if extent >= side - slack:
            return middle, side, Said(f"{axis}: the points span the whole side", False), Said("given", False)
        if low >= -slack and high <= side + slack:
            return 0.0, side, Said(f"{axis} counts from the plate's edge", False), Said("given", False)
        if low >= -side / 2 - slack and high <= side / 2 + slack:
            return -side / 2, side, Said(f"{axis} counts from the plate's middle", True), Said("given", False)
        return middle, side, Said(f"{axis}: the points were put in the middle of the side", True), Said("given", False)
    if extent <= 0:
        raise MeasurementError(
            f"{source}: expected points apart along {axis}, to propose that side, got one place. Give --length LX LY "
            "in m."
        )
    if low > SLACK * extent and low < extent / 2:
        origin = Said(f"{axis} counts from the plate's edge", True)
        return 0.0, low + high, origin, Said(f"side {axis}: the points keep {1e3 * low:.4g} mm from both edges", True)
    where, guess = "a place beside the plate's edge", True
    if abs(low) <= SLACK * extent:
        where, guess = "the plate's edge", False
    elif abs(low + high) <= 2 * SLACK * extent:
        where = "the plate's middle"
    origin = Said(f"{axis} counts from {where}", guess)
    return low, extent, origin, Said(f"side {axis}: the outermost points sit on the edges", True)


def _axes_said(axes: np.ndarray, angle: float, flat: bool) -> Said:
    if not flat:
        return Said("the points lie in a plane of their own", True)
    plane = "".join("xyz"[i] for i in sorted(set(range(3)) - {int(np.abs(axes[2]).argmax())}))
    if abs(angle) > 1e-9:
        return Said(f"turned by {math.degrees(angle):.4g} degrees in the file's {plane} plane", True)
    return Said(f"as the file's, in its {plane} plane", False)


def _join(parts: Sequence[Said]) -> Said:
    return Said("; ".join(dict.fromkeys(part.text for part in parts)), any(part.guess for part in parts))


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(f"{value:.9g}") + 0.0 for value in values.tolist())
    return x, y, z
