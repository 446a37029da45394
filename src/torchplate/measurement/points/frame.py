"""Where the plate lies in the coordinates of a test: unit, origin, the directions of its sides."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from torchplate.measurement.measurement import Channel, Measurement

METRES: Final = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
"""Length units that coordinates come in [m]."""
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Frame:
    """The plate's own axes, in the coordinates of the file.

    Plate x = (p − origin) · x_axis and y = (p − origin) · y_axis, times the unit; z is their cross product.

    Args:
        unit: Of the coordinates and of `origin`: "m", "cm", "mm" or "in".
        origin: The plate's corner (0, 0).
        x_axis: Direction of the side x; any length but 0.
        y_axis: Direction of the side y, at a right angle to x_axis to 1 %.

    Raises:
        ValueError: An unknown unit, an axis of no length, axes that are not at a right angle.
    """

    unit: str = "m"
    origin: Vector = (0.0, 0.0, 0.0)
    x_axis: Vector = (1.0, 0.0, 0.0)
    y_axis: Vector = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        if self.unit not in METRES:
            raise ValueError(f"Expected a unit out of {', '.join(METRES)}, got {self.unit!r}. Name one of these.")
        lengths = [math.hypot(*axis) for axis in (self.x_axis, self.y_axis)]
        if min(lengths) == 0:
            raise ValueError(
                f"Expected x_axis and y_axis of some length, got {self.x_axis} and {self.y_axis}. Give the directions "
                "of the plate's sides."
            )
        if abs(float(np.dot(self.x_axis, self.y_axis))) > 0.01 * lengths[0] * lengths[1]:
            raise ValueError(
                f"Expected x_axis and y_axis at a right angle, got {self.x_axis} and {self.y_axis}. Correct one."
            )

    @property
    def axes(self) -> np.ndarray:
        """Unit vectors along x, y and z of the plate, one a row."""
        x = np.asarray(self.x_axis, dtype=np.float64)
        x = x / np.linalg.norm(x)
        y = np.asarray(self.y_axis, dtype=np.float64)
        y = y - x * (x @ y)
        y = y / np.linalg.norm(y)
        return np.stack([x, y, np.cross(x, y)])

    @property
    def normal(self) -> int:
        """The file's axis that is nearest to the plate's normal: 1, 2 or 3, as a universal file counts directions."""
        return int(np.abs(self.axes[2]).argmax()) + 1

    def on_plate(self, point: Sequence[float] | Float[np.ndarray, " 3"]) -> Vector:
        """A point of the file in the plate's own axes [m]."""
        moved = METRES[self.unit] * (self.axes @ (np.asarray(point, dtype=np.float64) - np.asarray(self.origin)))
        # −0 would be printed.
        x, y, z = (moved + 0.0).tolist()
        return x, y, z


def in_frame(measurement: Measurement, frame: Frame) -> Measurement:
    """The measurement with the coordinates of its channels in the plate's own axes."""

    def moved(channel: Channel) -> Channel:
        if channel.coordinate is None:
            return channel
        return replace(channel, coordinate=frame.on_plate(channel.coordinate))

    return replace(
        measurement,
        response=tuple(moved(channel) for channel in measurement.response),
        reference=tuple(moved(channel) for channel in measurement.reference),
    )
