"""A modal model: natural frequencies, damping ratios and mode shapes at points of a plate; and its table.

The table (CSV) has a line for each mode and the columns mode, frequency_hz, damping_ratio, then one for each point that
is headed by the node's label or by its place "x,y" [m]. A complex deflection is written as 1.2+0.3j.
"""

import csv
import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import torch
from jaxtyping import Float, Num
from torch import Tensor

from torchplate.measurement.formats.archive import plain
from torchplate.measurement.formats.text_table import complex_of, lines_of, with_point
from torchplate.measurement.measurement import Channel, MeasurementError

HEAD: Final = ("mode", "frequency_hz", "damping_ratio")
EXAMPLE: Final = f"Write the columns {', '.join(HEAD)}, then one for each node, such as 1, 2, 3"


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Modes as a modal test gives them, in any order.

    Args:
        frequency: Natural frequencies [Hz], > 0.
        damping_ratio: Over critical [-], ≥ 0; NaN where none is told.
        shape: Deflections at the points, each mode on a scale of its own; real or complex.
        point: Where they are.
        unit: Of the shapes' scale, as text; "-" where it means nothing.
        source: Path or name of where the numbers come from.
        notes: What the reader had to assume or leave out, one sentence each.

    Raises:
        MeasurementError: No mode, no point, shapes that do not fit, a frequency that is not positive, a negative
            damping ratio, a shape that is not finite or zero everywhere, a point that comes twice.
    """

    frequency: Float[Tensor, " n_mode"]
    damping_ratio: Float[Tensor, " n_mode"]
    shape: Num[Tensor, "n_mode n_point"]
    point: tuple[Channel, ...]
    unit: str = "-"
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n_mode, n_point = len(self.frequency), len(self.point)
        if self.shape.shape != (n_mode, n_point) or self.damping_ratio.shape != (n_mode,):
            raise self._error(
                f"shapes of {n_mode} modes at {n_point} points and {n_mode} damping ratios",
                f"{tuple(self.shape.shape)} and {tuple(self.damping_ratio.shape)}",
                "Give one row for each mode, one column for each point",
            )
        if not n_mode or not n_point:
            raise self._error(
                "at least one mode with its shape",
                f"{n_mode} modes at {n_point} points",
                "Without shapes give the frequencies as measurement.natural_frequencies",
            )
        labels = [channel.label if channel.node else str(channel.coordinate) for channel in self.point]
        if (again := next((one for one in labels if labels.count(one) > 1), None)) is not None:
            raise self._error("each point once", f"{again} again", "Leave out one of them")
        for number, (hertz, ratio, shape) in enumerate(
            zip(self.frequency.tolist(), self.damping_ratio.tolist(), self.shape, strict=True), start=1
        ):
            if not 0.0 < hertz < math.inf:
                raise self._error(
                    "positive frequencies in Hz", f"{hertz:g} for mode {number}", "Correct it, or leave the mode out"
                )
            if ratio < 0.0 or ratio == math.inf:
                raise self._error(
                    "damping ratios of zero or more", f"{ratio:g} for mode {number}", "Leave out what is not known"
                )
            size = float(shape.abs().max())
            if not 0.0 < size < math.inf:
                raise self._error(
                    "finite shapes that are not zero everywhere",
                    f"one of {size:g} for mode {number} at {hertz:g} Hz",
                    "Correct it, or leave the mode out",
                )

    def _error(self, expected: str, came: str, action: str) -> MeasurementError:
        return MeasurementError(f"{self.source or 'Modal model'}: expected {expected}, got {came}. {action}.")

    @property
    def is_complex(self) -> bool:
        """Whether the shapes are complex."""
        return self.shape.is_complex()

    def to(self, device: torch.device | str) -> "ModalModel":
        """Move every tensor to `device`."""
        return replace(
            self,
            frequency=self.frequency.to(device),
            damping_ratio=self.damping_ratio.to(device),
            shape=self.shape.to(device),
        )

    def band(self, low: float, high: float) -> "ModalModel":
        """Only the modes between two frequencies [Hz], with a note of what was left out.

        Raises:
            MeasurementError: None is there.
        """
        kept = (self.frequency >= low) & (self.frequency <= high)
        if bool(kept.all()):
            return self
        if not bool(kept.any()):
            raise self._error(
                f"modes between {low:g} and {high:g} Hz",
                f"modes from {float(self.frequency.min()):g} to {float(self.frequency.max()):g} Hz",
                "Widen the band",
            )
        n_out = int((~kept).sum())
        note = f"Left out {n_out} mode{'s' * (n_out > 1)} of the modal model outside {low:g} to {high:g} Hz."
        return replace(
            self,
            frequency=self.frequency[kept],
            damping_ratio=self.damping_ratio[kept],
            shape=self.shape[kept],
            notes=(*self.notes, note),
        )

    def with_points(self, moved: Callable[[Channel], Channel]) -> "ModalModel":
        """The same with each point changed, such as to other coordinates."""
        return replace(self, point=tuple(moved(channel) for channel in self.point))

    def to_csv(self) -> str:
        """The table; a point with coordinates is headed by its place, another by its node."""
        stream = io.StringIO()
        table = csv.writer(stream, lineterminator="\n")
        heads = [
            str(channel.node) if channel.coordinate is None else ",".join(repr(x) for x in channel.coordinate[:2])
            for channel in self.point
        ]
        table.writerow([*HEAD, *heads])
        rows = zip(self.frequency.tolist(), self.damping_ratio.tolist(), self.shape.tolist(), strict=True)
        for number, (hertz, ratio, shape) in enumerate(rows, start=1):
            cells = [str(value).strip("()") for value in shape]
            table.writerow([number, repr(hertz), "" if math.isnan(ratio) else repr(ratio), *cells])
        return stream.getvalue()


def is_modal_table(path: Path) -> bool:
    """Whether a file begins as a table of modes does; its cells may still be wrong."""
    if not path.is_file():  # a pipe that nobody writes into would be waited for
        return False
    try:
        first = next((line for line in lines_of(path) if line.strip() and not line.startswith("#")), "")
    except OSError:
        return False
    return tuple(cell.strip().lower() for cell in re.split(r"[,;\t]", first)[: len(HEAD)]) == HEAD


def read_modal_table(path: Path) -> ModalModel:
    """Read a table of modes; columns apart by commas, semicolons or tabs.

    Raises:
        MeasurementError: The file is absent, lacks a column, or holds a cell that is no number.
    """
    try:
        text = lines_of(path)
    except OSError as error:
        raise MeasurementError(
            f"{path}: expected a table of modes (.csv), got none that can be read. Check the path."
        ) from error
    lines = [line for line in text if line.strip() and not line.startswith("#")]
    first = lines[0] if lines else ""
    mark = ";" if ";" in first else "\t" if "\t" in first else ","
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=mark, skipinitialspace=True)]
    if not rows or tuple(cell.lower() for cell in rows[0][: len(HEAD)]) != HEAD or len(rows[0]) == len(HEAD):
        came = f"{first[:60]!r}" if first else "an empty file"
        raise MeasurementError(
            f"{path}: expected a first line '{', '.join(HEAD)}' and a column for each point after it, got {came}. "
            f"{EXAMPLE}; without shapes give measurement.natural_frequencies."
        )
    points = tuple(_point(head, path) for head in rows[0][len(HEAD) :])
    frequency, ratio, shape = [], [], []
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(rows[0]):
            raise MeasurementError(
                f"{path}: expected {len(rows[0])} cells in each line, got {len(row)} in line {number}. Fill it up; a "
                'place as head stands in quotes: "0.1,0.2".'
            )
        hertz, damping, *rest = (
            _cell(text, head, number, path) for text, head in zip(row[1:], rows[0][1:], strict=True)
        )
        frequency.append(hertz.real)
        ratio.append(damping.real)
        shape.append(rest)
    if not shape:
        raise MeasurementError(f"{path}: expected a line for each mode, got none. {EXAMPLE}.")
    deflection = torch.tensor(shape, dtype=torch.complex128)
    return ModalModel(
        torch.tensor(frequency, dtype=torch.float64),
        torch.tensor(ratio, dtype=torch.float64),
        deflection if bool((deflection.imag != 0).any()) else deflection.real,
        points,
        source=str(path),
    )


def _point(head: str, path: Path) -> Channel:
    parts = [part for part in re.split(r"[,;\s]+", head) if part]
    try:
        if len(parts) == 1:
            return Channel(int(parts[0].removesuffix("w")))
        x, y = (float(part) for part in parts)
    except ValueError:
        raise MeasurementError(
            f'{path}: expected a node\'s label or a place "x,y" [m] as head of a column of deflections, got '
            f"'{plain(head[:60])}'. "
            'Write 12, or "0.1,0.2" in quotes.'
        ) from None
    return Channel(0, coordinate=(x, y, 0.0))


def _cell(text: str, head: str, number: int, path: Path) -> complex:
    if not text and head.lower() == HEAD[2]:
        return complex(math.nan)
    try:
        return complex_of(with_point(text.replace(" ", "")))
    except ValueError:
        raise MeasurementError(
            f"{path}: expected a number under '{plain(head[:60])}' in line {number}, got '{plain(text[:60])}'. Write "
            "it as 1.2, complex as 1.2+0.3j."
        ) from None
