"""A universal file, dataset by dataset: records of dataset 58, and units from 164.

Source: Universal File Format, University of Cincinnati SDRL. pyuff finds the datasets and reads their headers.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyuff
from jaxtyping import Complex, Float

from torchplate.measurement.formats.archive import plain
from torchplate.measurement.level import hertz_of, second_of
from torchplate.measurement.measurement import MeasurementError
from torchplate.measurement.uff.values import ORDINATE, ValuesError, decode

DIRECTION: Final = {0: "w", 1: "u", 2: "v", 3: "w", 4: "tx", 5: "ty", 6: "tz"}
ALIGNED: Final = 0.99
"""Cosine between a measured direction and a global axis below which it is said to be turned away [-]: 8 degrees."""
UNREAD: Final = "\ufffd"
"""What stands where a byte is no character."""
HEADER: Final = 4096
"""More bytes than the header of any dataset has."""
FORTRAN: Final = re.compile(rb"(?<=[0-9.])[Dd](?=[+-][0-9])")
"""The D of a number in double precision, as Fortran writes it: 4.00000D+01."""
End = tuple[int, str]


@dataclass(frozen=True, eq=False)
class Record:
    """One dataset 58 as the file gives it: ends with their sign, lines, values, what the level is of.

    The lines are in Hz, or s of a time record. `axis` is the unit of the axis where it is not known; they are then as
    they were. `turned` is whether a direction was turned into the global axes, `cosine` that of the one that is
    farthest from an axis then.
    """

    number: int
    function_type: int
    response: End
    reference: End
    sign: int
    scalar: bool
    is_complex: bool
    frequency: Float[np.ndarray, " n"]
    value: Complex[np.ndarray, " n"]
    numerator: int
    denominator: int
    labels: tuple[str, str]
    text: str
    axis: str = ""
    turned: bool = False
    cosine: float = 1.0

    @property
    def label(self) -> str:
        """Record number and channels: "record 3 (1w/2w)"."""
        response, reference = self.response, self.reference
        return f"record {self.number} ({response[0]}{response[1]}/{reference[0]}{reference[1]})"


class UffFile:
    """A universal file, open for reading one dataset at a time.

    Attributes:
        types: The number of each dataset, in the file's order.
    """

    def __init__(self, file: Any, path: Path) -> None:
        self._file, self.path = file, path
        self.types: tuple[int, ...] = tuple(int(t) for t in file.get_set_types())

    def read(self, index: int) -> dict[str, Any]:
        """A dataset as pyuff reads it.

        Raises:
            MeasurementError: It does not parse.
        """
        return _read(self._file, index, self.path)

    def header(self, index: int) -> dict[str, Any]:
        """The header of a dataset 58.

        Raises:
            MeasurementError: It does not parse.
        """
        return _read(self._file, index, self.path, header_only=True)

    def of_type(self, *types: int) -> list[int]:
        """Indices of the datasets of these numbers."""
        return [i for i, t in enumerate(self.types) if t in types]

    def record(self, index: int, normal: int = 3, turned: Mapping[int, np.ndarray] | None = None) -> Record:
        """A dataset 58 with its values.

        Args:
            index: Of the dataset.
            normal: The file's axis that is the plate's z; the record's directions are counted so.
            turned: Of nodes whose directions are not the global ones, those directions, one a row.

        Raises:
            MeasurementError: It does not parse.
        """
        return _record(self._file, index, self.path, normal, turned or {})


def open_uff(path: Path) -> UffFile:
    """Open a universal file, whatever it holds.

    Raises:
        MeasurementError: It is absent, cut short, or no universal file.
    """
    return UffFile(_complete(path), path)


def _complete(path: Path) -> Any:
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise MeasurementError(
            f"{path}: expected a universal file (.uff, .unv), got none that can be read ({error.strerror}). "
            "Check the path."
        ) from error
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise MeasurementError(
            f"{path}: expected a universal file in plain text, got UTF-16. Save it as ASCII, or export it again."
        )
    if content.startswith((b"\x1f\x8b", b"PK\x03\x04")):
        raise MeasurementError(f"{path}: expected a universal file, got one that is compressed. Unpack it.")
    try:
        file = pyuff.UFF(str(path))
        n_set = file.get_n_sets()
    except Exception as error:  # pyuff raises bare Exception for whatever it does not understand
        raise MeasurementError(
            f"{path}: expected a universal file, got one whose datasets do not part. Export it as UFF 58."
        ) from error
    if n_set == 0:
        came = "an empty file" if not content.strip() else "a file without one complete dataset"
        raise MeasurementError(
            f"{path}: expected a universal file, whose datasets stand between lines that hold only -1, got {came}. "
            "Export it as UFF 58."
        )
    if not content.rstrip().endswith(b"-1"):
        raise MeasurementError(
            f"{path}: expected a last line that holds only -1, got a file that ends within a dataset. "
            "It was cut short: copy or export it again."
        )
    return file


def _read(file: Any, index: int, path: Path, *, header_only: bool = False) -> dict[str, Any]:
    try:
        dataset = _read_by_pyuff(file, index, path, header_only=header_only)
    except Exception as error:  # pyuff raises bare Exception for whatever it does not understand
        raise MeasurementError(
            f"{path}: expected dataset {int(file.get_set_types()[index])} at place {index + 1} of the file in the "
            "format's columns, got one that does not parse. Export it again, or remove that dataset."
        ) from error
    text = {key: value for key, value in dataset.items() if isinstance(value, str)}
    if any(UNREAD in value for value in text.values()):
        header = _header_of(file, index, path)
        text = {key: _as_written(value, header) for key, value in text.items()}
    return dataset | {key: plain(value) for key, value in text.items()}


def _read_by_pyuff(file: Any, index: int, path: Path, *, header_only: bool) -> dict[str, Any]:
    """A dataset as pyuff reads it; where it fails over D exponents, from the same with E in their place."""
    try:
        dataset: dict[str, Any] = file.read_sets(index, header_only=header_only)
    except Exception:  # as above
        block = _block(file, index, path)
        if b"58b" in block.split(b"\n", 2)[1] or not FORTRAN.search(block):
            raise
        number, block = int(file.get_set_types()[index]), FORTRAN.sub(b"E", block)
        if number == 58:
            dataset = pyuff.pyuff._extract58(block, header_only=header_only)
        else:
            dataset = getattr(pyuff.pyuff, f"_extract{number}")(block.decode("utf-8", errors="replace"))
    return dataset


def _block(file: Any, index: int, path: Path) -> bytes:
    """A dataset with the line of -1 before it and without that after it."""
    start, end = (int(i) for i in file._block_ind[index])
    with Path(path).open("rb") as stream:
        stream.seek(start)
        return stream.read(end - start + 1)


def _header_of(file: Any, index: int, path: Path) -> str:
    """The first lines of a dataset in the encoding of Western Windows, which holds Latin-1: ² and µ are one byte."""
    return _block(file, index, path)[:HEADER].decode("cp1252", errors="replace")


def _as_written(text: str, header: str) -> str:
    """Text that is not UTF-8, as pyuff takes it, as it stands in the file."""
    if UNREAD not in text:
        return text
    pattern = "[^\x00-\x7f]{1,3}".join(re.escape(part) for part in text.split(UNREAD))
    found = re.search(pattern, header)
    return found.group() if found else text


def _record(file: Any, index: int, path: Path, normal: int, turned: Mapping[int, np.ndarray]) -> Record:
    header = _read(file, index, path, header_only=True)
    number = index + 1
    block = _block(file, index, path)
    order = int(header["byte_ordering"]) if header["binary"] else None
    if header["binary"] and (order not in (1, 2) or header["fp_format"] not in (0, 2)):
        raise MeasurementError(
            f"{path}: expected IEEE 754 numbers in byte order 1 or 2 in binary record {number}, got floating-point "
            f"format {header['fp_format']} in byte order {order}. Export it as ASCII."
        )
    even, n_point = header["abscissa_spacing"] == 1, int(header["num_pts"])
    try:
        frequency, value = decode(
            b"".join(block.splitlines(keepends=True)[13:]),
            ordinate_type=int(header["ord_data_type"]),
            n_point=n_point,
            even=even,
            byte_order=order,
        )
    except ValuesError as fault:
        raise MeasurementError(
            f"{path}: expected record {number} to hold the {n_point} values its header promises, got {fault}. "
            "Export it again."
        ) from fault
    if frequency is None:
        frequency = header["abscissa_min"] + header["abscissa_inc"] * np.arange(n_point)
    axis = plain(str(header.get("abscissa_axis_units_lab", "")).strip())
    in_si = second_of(axis) if int(header["func_type"]) == 1 else hertz_of(axis)
    directions = (int(header["rsp_dir"]), int(header["ref_dir"]))
    if any(abs(d) not in DIRECTION for d in directions):
        raise MeasurementError(
            f"{path}: expected directions from -6 to 6 in record {number}, got {directions}. Correct the record."
        )
    ends = (int(header["rsp_node"]), int(header["ref_node"]))
    seen = [in_global(d, turned.get(node)) for d, node in zip(directions, ends, strict=True)]
    signed = [direction for direction, _ in seen]
    return Record(
        number=number,
        function_type=int(header["func_type"]),
        response=(ends[0], DIRECTION[_seen(abs(signed[0]), normal)]),
        reference=(ends[1], DIRECTION[_seen(abs(signed[1]), normal)]),
        sign=-1 if (signed[0] < 0) != (signed[1] < 0) else 1,
        scalar=0 in directions,
        is_complex=ORDINATE[int(header["ord_data_type"])][0],
        frequency=frequency if in_si is None else in_si * frequency,
        value=value,
        numerator=int(header["ordinate_spec_data_type"]),
        denominator=int(header["orddenom_spec_data_type"]),
        labels=(header["ordinate_axis_units_lab"], header["orddenom_axis_units_lab"]),
        text=header["id1"],
        axis="" if in_si is not None else axis,
        turned=tuple(signed) != directions,
        cosine=min(cosine for _, cosine in seen),
    )


def in_global(direction: int, rows: Float[np.ndarray, "3 3"] | None) -> tuple[int, float]:
    """A node's signed direction as the nearest of the global axes, and the cosine between them.

    Args:
        direction: −6 to 6 as the format counts: x, y, z, then rotations about them; 0 for none.
        rows: The node's own directions in global coordinates, one a row; None where they are the global ones.
    """
    if direction == 0 or rows is None:
        return direction, 1.0
    turn, axis = divmod(abs(direction) - 1, 3)
    vector = rows[axis] if direction > 0 else -rows[axis]
    nearest = int(np.abs(vector).argmax())
    sign = 1 if vector[nearest] > 0 else -1
    return sign * (3 * turn + nearest + 1), float(abs(vector[nearest]))


def _seen(direction: int, normal: int) -> int:
    """A direction of the file as the plate counts it, whose z is the file's axis `normal`."""
    if direction == 0:
        return 0
    turn, axis = divmod(direction - 1, 3)
    return 3 * turn + (axis - normal) % 3 + 1
