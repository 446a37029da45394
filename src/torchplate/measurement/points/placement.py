"""Where each channel sits on the plate: by its coordinates, or by its node's number on the grid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.measurement.measurement import Channel, Measurement, MeasurementError
from torchplate.measurement.points.frame import METRES

OFF_PLATE: Final = 0.01
"""How far off the plate a channel may sit, over the longer side [-]. A ruler, a sensor's radius and a plate cut a
little small explain about 1 %; more is a wrong unit, a wrong side length or another origin."""
ROUNDING: Final = 1e-5
"""From where on it is said, likewise [-]: the six digits of a universal file's coordinates leave less."""


UNIT: Final = {"m": "metres", "mm": "millimetres", "cm": "centimetres", "in": "inches"}


@dataclass(frozen=True)
class Match:
    """One channel on the plate.

    Args:
        label: The channel's, such as "3w".
        place: Relative place (x, y) [-], 0 to 1: the coordinates over the sides. Off the plate: the nearest edge's.
        nearest_node: Label of the nearest node of the grid, from 1.
        distance: From the channel's coordinate to that node [m], ≥ 0; exactly 0 for a match by number.
        outside: How far the coordinate lies off the plate [m]; 0 on it.
    """

    label: str
    place: tuple[float, float]
    nearest_node: int
    distance: float
    outside: float


@dataclass(frozen=True)
class Placement:
    """Every channel's place, in the measurement's order.

    Args:
        response: Sensor places.
        reference: Force places. Empty for a transmissibility, whose reference is the motion of all held edges.
        by: "coordinate" or "node": what the match went by.
        remark: the same in a sentence, with what to do where it is a guess.
    """

    response: tuple[Match, ...]
    reference: tuple[Match, ...]
    by: str
    remark: str = ""

    @property
    def response_place(self) -> Float[Tensor, "n_response 2"]:
        """Relative (x, y) of the responses [-], float64."""
        return _table(self.response)

    @property
    def reference_place(self) -> Float[Tensor, "n_reference 2"]:
        """Relative (x, y) of the references [-], float64."""
        return _table(self.reference)


def place(measurement: Measurement, length_x: float, length_y: float, n_x: int, n_y: int) -> Placement:
    """Match every channel to the plate 0 ≤ x ≤ length_x, 0 ≤ y ≤ length_y.

    Where the measurement holds coordinates the match is by them, else by node number on the n_x × n_y grid,
    whose nodes count along x first, then y, from 1.

    Args:
        measurement: Its channels must all be out of the plate (direction "w").
        length_x: Side along x [m], > 0.
        length_y: Side along y [m], > 0.
        n_x: Elements along x, ≥ 1.
        n_y: Elements along y, ≥ 1.

    Raises:
        MeasurementError: A channel in the plate, off the plate by more than `OFF_PLATE` of the longer side,
            without coordinates where others have them, or with a node number that is not on the grid.
    """
    ends = measurement.response
    if measurement.kind != "transmissibility":
        ends = (*measurement.response, *measurement.reference)
    grid = _Grid(length_x, length_y, n_x, n_y, measurement.source or "Measurement")
    placed, by_coordinate = _matched(ends, grid)
    n_response = len(measurement.response)
    return Placement(
        response=tuple(placed[:n_response]),
        reference=tuple(placed[n_response:]),
        by="coordinate" if by_coordinate else "node",
        remark=_remark(placed, _counts(n_response, len(placed) - n_response), grid, by_coordinate),
    )


def place_points(
    points: Sequence[Channel], source: str, length_x: float, length_y: float, n_x: int, n_y: int
) -> Placement:
    """The same for the points of mode shapes, which stand as responses.

    Raises:
        MeasurementError: As `place`.
    """
    grid = _Grid(length_x, length_y, n_x, n_y, source or "Modal model")
    placed, by_coordinate = _matched(points, grid)
    counted = f"{len(placed)} point{'s' * (len(placed) != 1)} of the mode shapes"
    by = "coordinate" if by_coordinate else "node"
    return Placement(tuple(placed), (), by, _remark(placed, counted, grid, by_coordinate))


def _matched(ends: Sequence[Channel], grid: "_Grid") -> tuple[list[Match], bool]:
    """Each channel's place, and whether it is by coordinates."""
    located = [channel.coordinate is not None for channel in ends]
    unit = _unit_of(ends, grid)
    for channel in ends:
        if channel.direction != "w":
            raise MeasurementError(
                f"{grid.source}: expected out-of-plane channels (direction w), got "
                f"{channel.label}. A bending plate does not move that way: leave the channel out."
            )
        if any(located) and channel.coordinate is None:
            raise MeasurementError(
                f"{grid.source}: expected coordinates for every channel or for none, got none "
                f"for {channel.label}. Add its node to dataset 15 or 2411, or remove all coordinates to match by "
                "node number."
            )
    return [grid.by_coordinate(c, unit) if any(located) else grid.by_node(c) for c in ends], any(located)


def _unit_of(ends: Sequence[Channel], grid: "_Grid") -> str:
    """The unit that coordinates far beyond the plate look to be in: of those that fit on it the largest; else mm."""
    placed = [channel.coordinate for channel in ends if channel.coordinate is not None]
    if not placed:
        return ""
    spans = [max(values) - min(0.0, *values) for values in list(zip(*placed, strict=True))[:2]]
    longer = max(grid.length_x, grid.length_y)
    if max(abs(value) for point in placed for value in point[:2]) <= 20 * longer:
        return ""
    fitting = [
        name
        for name, metres in METRES.items()
        if spans[0] * metres <= grid.length_x + OFF_PLATE * longer
        and spans[1] * metres <= grid.length_y + OFF_PLATE * longer
    ]
    return max(fitting, key=METRES.__getitem__, default="mm")


def _counts(n_response: int, n_reference: int) -> str:
    counts = [f"{n_response} response{'s' * (n_response != 1)}"]
    if n_reference:
        counts.append(f"{n_reference} reference{'s' * (n_reference != 1)}")
    return " and ".join(counts)


def _remark(placed: list[Match], counted: str, grid: "_Grid", by_coordinate: bool) -> str:
    subject = f"Matched {counted} to the plate by"
    if by_coordinate:
        text = f"{subject} their coordinates"
        farthest = max(placed, key=lambda match: match.outside)
        if farthest.outside > ROUNDING * max(grid.length_x, grid.length_y):
            text += f"; {farthest.label} lies {1e3 * farthest.outside:.2g} mm off the plate and is taken on its edge"
        return f"{text}."
    sides = [match.place[0] * grid.length_x for match in placed], [match.place[1] * grid.length_y for match in placed]
    spans = [
        f"{axis} {min(side):.3g} to {max(side):.3g} m" if len(placed) > 1 else f"{axis} {side[0]:.3g} m"
        for axis, side in zip("xy", sides, strict=True)
    ]
    nodes = sorted({match.nearest_node for match in placed})
    labels = str(nodes[0]) if len(nodes) == 1 else f"{nodes[0]} to {nodes[-1]}"
    return (
        f"{subject} node number, because the file holds no coordinates: its nodes {labels} are taken as labels of the "
        f"{grid.n_x} × {grid.n_y} mesh, counted along x from the corner (0, 0), so at {', '.join(spans)}. If the test "
        "sheet counts otherwise, give the nodes coordinates (dataset 15 or 2411)."
    )


@dataclass(frozen=True)
class _Grid:
    length_x: float
    length_y: float
    n_x: int
    n_y: int
    source: str

    def _exchanged(self, x: float, y: float) -> str:
        """The question whether the sides were exchanged, where a point would lie on the plate then."""
        most = OFF_PLATE * max(self.length_x, self.length_y)
        if not (-most <= x <= self.length_y + most and -most <= y <= self.length_x + most):
            return ""
        return f"With the sides exchanged it lies on it: length_x {self.length_y:g}, length_y {self.length_x:g}? "

    def by_coordinate(self, channel: Channel, unit: str) -> Match:
        assert channel.coordinate is not None
        x, y, _ = channel.coordinate
        on_x, on_y = min(max(x, 0.0), self.length_x), min(max(y, 0.0), self.length_y)
        outside = math.hypot(x - on_x, y - on_y)
        name = channel.label if channel.node else "each point"
        longer = max(self.length_x, self.length_y)
        if not outside <= OFF_PLATE * longer:
            raise MeasurementError(
                f"{self.source}: expected {name} on the plate of {self.length_x:g} × {self.length_y:g} m, got "
                f"({x:g}, {y:g}) m, {outside:.3g} m off it. "
                + (
                    f"The coordinates look like {UNIT[unit]}: write measurement.frame: {{unit: {unit}}}, or state the "
                    "unit in dataset 164."
                    if unit
                    else f"{self._exchanged(x, y)}Check mesh.length_x and mesh.length_y, and that the coordinates "
                    "start at the plate's corner."
                )
            )
        column, row = round(on_x / self.length_x * self.n_x), round(on_y / self.length_y * self.n_y)
        node_x, node_y = column * self.length_x / self.n_x, row * self.length_y / self.n_y
        return Match(
            label=channel.label,
            place=(on_x / self.length_x, on_y / self.length_y),
            nearest_node=row * (self.n_x + 1) + column + 1,
            distance=math.hypot(x - node_x, y - node_y),
            outside=outside,
        )

    def by_node(self, channel: Channel) -> Match:
        n_node = (self.n_x + 1) * (self.n_y + 1)
        if not 1 <= channel.node <= n_node:
            raise MeasurementError(
                f"{self.source}: expected node numbers from 1 to {n_node} on the {self.n_x} × {self.n_y} mesh, got "
                f"{channel.label}. Set mesh.n_x and mesh.n_y to the test sheet's grid, or give the nodes coordinates."
            )
        row, column = divmod(channel.node - 1, self.n_x + 1)
        return Match(channel.label, (column / self.n_x, row / self.n_y), channel.node, 0.0, 0.0)


def _table(matches: tuple[Match, ...]) -> Float[Tensor, "n 2"]:
    return torch.tensor([m.place for m in matches], dtype=torch.float64).reshape(-1, 2)
