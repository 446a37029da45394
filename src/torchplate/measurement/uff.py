"""Universal files: FRFs and coherence from dataset 58 (ASCII or binary), nodes from 15 or 2411, units from 164.

Source: Universal File Format, University of Cincinnati SDRL. pyuff finds the datasets and reads their headers.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyuff
import torch
from jaxtyping import Complex, Float

from torchplate.measurement.archive import plain
from torchplate.measurement.level import Units, factor_to_si, kind_of
from torchplate.measurement.measurement import (
    KINDS,
    SI_UNIT,
    Channel,
    Kind,
    Measurement,
    MeasurementError,
    checked_kind,
)
from torchplate.measurement.parsing import reads
from torchplate.measurement.uff_values import ValuesError, decode

FUNCTION_TYPE: Final = {0: "unknown", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "FRF"}
FUNCTION_TYPE_READ: Final = {4: "FRF", 5: "transmissibility", 6: "coherence"}
SHAPES: Final = {55: "data at nodes, such as mode shapes", 2414: "analysis data, such as mode shapes"}
DIRECTION: Final = {0: "w", 1: "u", 2: "v", 3: "w", 4: "tx", 5: "ty", 6: "tz"}

End = tuple[int, str]
Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Record:
    """One dataset 58 as the file gives it: ends with their sign, lines, values, what the level is of."""

    number: int
    function_type: int
    response: End
    reference: End
    sign: int
    scalar: bool
    frequency: Float[np.ndarray, " n"]
    value: Complex[np.ndarray, " n"]
    numerator: int
    denominator: int
    labels: tuple[str, str]
    text: str

    @property
    def label(self) -> str:
        """Record number and channels: "record 3 (1w/2w)"."""
        response, reference = self.response, self.reference
        return f"record {self.number} ({response[0]}{response[1]}/{reference[0]}{reference[1]})"


def read_uff(path: Path, kind: str | None = None, normal: int = 3) -> Measurement:
    """Read the out-of-plane FRFs of a universal file, in SI units.

    A channel that points along -z counts as out of the plate with its sign turned. In-plane and rotational
    channels are left out, with a note.

    Args:
        path: The file; ASCII and binary records may be mixed.
        kind: Overrides what the file's specifiers say.
        normal: The file's axis that points out of the plate, 1 to 3.

    Raises:
        MeasurementError: Not a universal file, no FRF in it, lines that differ between records, a pair that
            comes twice, values that do not follow their header, a kind that the file does not settle.
    """
    file, units, places, notes = _open(path)
    records = [_record(file, index, path, normal) for index in _of_type(file, 58)]
    frfs = [r for r in records if r.function_type in (4, 5)]
    if not frfs:
        seen = sorted({r.function_type for r in records})
        named = ", ".join(f"{t} ({(FUNCTION_TYPE | FUNCTION_TYPE_READ).get(t, 'other')})" for t in seen)
        came = f"function types {named}" if records else "no dataset 58"
        raise MeasurementError(
            f"{path}: expected FRFs (dataset 58 with function type 4, or 5 for transmissibility), got {came}. "
            "Export the FRFs from the analyser."
        )
    notes += _left_out(file, records)
    plane = [r for r in frfs if (r.response[1], r.reference[1]) != ("w", "w")]
    frfs = [r for r in frfs if (r.response[1], r.reference[1]) == ("w", "w")]
    if not frfs:
        raise MeasurementError(
            f"{path}: expected out-of-plane FRFs (response and reference direction {normal} or -{normal}), got none; "
            "the first is "
            f"{plane[0].label}. A bending plate has no in-plane FRFs: export the z direction."
        )
    if plane:
        many = "FRFs that are" if len(plane) > 1 else "FRF that is"
        notes.append(f"Left out {len(plane)} {many} not out of the plate, the first {plane[0].label}.")
    if any(r.scalar for r in frfs):
        notes.append("Channels with direction 0 (scalar) were taken as out of the plate.")
    found, factor = _kind_and_factor(frfs, kind, units, path, notes)
    return _assemble(frfs, [r for r in records if r.function_type == 6], places, found, factor, path, notes)


def _left_out(file: Any, records: list[Record]) -> list[str]:
    """What the file holds besides FRFs and coherence: a sentence for each kind."""
    found = []
    for function_type in sorted({r.function_type for r in records} - set(FUNCTION_TYPE_READ)):
        own = [r for r in records if r.function_type == function_type]
        name = FUNCTION_TYPE.get(function_type, "other")
        first = own[0].label if len(own) == 1 else f"the first {own[0].label}"
        # Some exporters write 0 for whatever they measure.
        action = " If these are FRFs, export them with function type 4." if function_type == 0 else ""
        found.append(
            f"Left out {len(own)} record{'s' * (len(own) > 1)} of dataset 58 with function type {function_type} "
            f"({name}), not an FRF: {first}.{action}"
        )
    for number, name in SHAPES.items():
        if n_set := len(_of_type(file, number)):
            found.append(f"Left out {n_set} dataset{'s' * (n_set > 1)} {number} ({name}): only FRFs are read.")
    return found


class UffFile:
    """A universal file, open for reading one dataset at a time.

    Attributes:
        types: The number of each dataset, in the file's order.
    """

    def __init__(self, file: Any, path: Path) -> None:
        self._file, self._path = file, path
        self.types: tuple[int, ...] = tuple(int(t) for t in file.get_set_types())

    def read(self, index: int) -> dict[str, Any]:
        """A dataset as pyuff reads it.

        Raises:
            MeasurementError: It does not parse.
        """
        return _read(self._file, index, self._path)

    def header(self, index: int) -> dict[str, Any]:
        """The header of a dataset 58.

        Raises:
            MeasurementError: It does not parse.
        """
        return _read(self._file, index, self._path, header_only=True)

    def record(self, index: int) -> Record:
        """A dataset 58 with its values.

        Raises:
            MeasurementError: It does not parse.
        """
        return _record(self._file, index, self._path, 3)


def open_uff(path: Path) -> UffFile:
    """Open a universal file, whatever it holds.

    Raises:
        MeasurementError: It is absent, cut short, or no universal file.
    """
    return UffFile(_complete(path), path)


@reads("a universal file")
def read_geometry(path: Path) -> tuple[dict[int, Point], int | None]:
    """Every node of a universal file [m by its units], and the axis most of its FRFs point along, 1 to 3, if any.

    Raises:
        MeasurementError: Not a universal file, or a dataset that does not parse.
    """
    file, _, places, _ = _open(path)
    axes = [0, 0, 0, 0]
    for index in _of_type(file, 58):
        header = _read(file, index, path, header_only=True)
        direction = abs(int(header["rsp_dir"]))
        if int(header["func_type"]) in (4, 5) and direction in (1, 2, 3):
            axes[direction] += 1
    return places, axes.index(max(axes)) if any(axes) else None


def _complete(path: Path) -> Any:
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise MeasurementError(
            f"{path}: expected a universal file (.uff, .unv), got none that can be read ({error.strerror}). "
            "Check the path."
        ) from error
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


def _open(path: Path) -> tuple[Any, Units, dict[int, Point], list[str]]:
    file = _complete(path)
    notes: list[str] = []
    units = _units(file, path, notes)
    places: dict[int, Point] = {}
    for index in _of_type(file, 15, 2411):
        dataset = _read(file, index, path)
        columns = (dataset["node_nums"], dataset["x"], dataset["y"], dataset["z"])
        for node, x, y, z in zip(*columns, strict=True):
            places[int(node)] = (float(x) / units.length, float(y) / units.length, float(z) / units.length)
    return file, units, places, notes


def _of_type(file: Any, *types: int) -> list[int]:
    return [i for i, t in enumerate(file.get_set_types()) if int(t) in types]


def _read(file: Any, index: int, path: Path, *, header_only: bool = False) -> dict[str, Any]:
    try:
        dataset: dict[str, Any] = file.read_sets(index, header_only=header_only)
    except Exception as error:  # pyuff raises bare Exception for whatever it does not understand
        raise MeasurementError(
            f"{path}: expected dataset {int(file.get_set_types()[index])} at place {index + 1} of the file in the "
            "format's columns, got one that does not parse. Export it again, or remove that dataset."
        ) from error
    return {key: plain(value) if isinstance(value, str) else value for key, value in dataset.items()}


def _units(file: Any, path: Path, notes: list[str]) -> Units:
    units = Units()
    for index in _of_type(file, 164):
        dataset = _read(file, index, path)
        stated = Units(float(dataset["length"]), float(dataset["force"]))
        if int(dataset["units_code"]) == 1:
            # Code 1 is metre and newton by definition; factors of feet beside it are copied from the format's
            # example, as in pyuff's own.
            if stated != Units():
                notes.append("Dataset 164 says SI but gives other factors; SI was taken.")
            continue
        if min(stated) <= 0:
            raise MeasurementError(
                f"{path}: expected positive unit factors in dataset 164, got length {stated.length:g} and force "
                f"{stated.force:g}. Correct or remove that dataset."
            )
        units = stated
    return units


def _record(file: Any, index: int, path: Path, normal: int) -> Record:
    header = _read(file, index, path, header_only=True)
    number = index + 1
    start, end = (int(i) for i in file._block_ind[index])
    with Path(path).open("rb") as stream:
        stream.seek(start)
        block = stream.read(end - start + 1)
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
    directions = (int(header["rsp_dir"]), int(header["ref_dir"]))
    if any(abs(d) not in DIRECTION for d in directions):
        raise MeasurementError(
            f"{path}: expected directions from -6 to 6 in record {number}, got {directions}. Correct the record."
        )
    return Record(
        number=number,
        function_type=int(header["func_type"]),
        response=(int(header["rsp_node"]), DIRECTION[_seen(abs(directions[0]), normal)]),
        reference=(int(header["ref_node"]), DIRECTION[_seen(abs(directions[1]), normal)]),
        sign=-1 if (directions[0] < 0) != (directions[1] < 0) else 1,
        scalar=0 in directions,
        frequency=frequency,
        value=value,
        numerator=int(header["ordinate_spec_data_type"]),
        denominator=int(header["orddenom_spec_data_type"]),
        labels=(header["ordinate_axis_units_lab"], header["orddenom_axis_units_lab"]),
        text=header["id1"],
    )


def _seen(direction: int, normal: int) -> int:
    """A direction of the file as the plate counts it, whose z is the file's axis `normal`."""
    if direction == 0:
        return 0
    turn, axis = divmod(direction - 1, 3)
    return 3 * turn + (axis - normal) % 3 + 1


def _kind_and_factor(
    frfs: list[Record], kind: str | None, units: Units, path: Path, notes: list[str]
) -> tuple[Kind, list[float]]:
    stated = {kind_of(r.numerator, r.denominator, r.function_type) for r in frfs}
    found = stated.pop() if len(stated) == 1 else None
    if kind is not None:
        chosen = checked_kind(kind, f"{path}, measurement.kind")
        if chosen != found:
            notes.append(f"The file's specifiers say {found or 'nothing clear'}; taken as {chosen}, as told.")
    elif found is None:
        first = frfs[0]
        raise MeasurementError(
            f"{path}: expected specifiers that name one kind for all FRFs (8, 11 or 12 over 13), got "
            f"{first.numerator} over {first.denominator} in record {first.number}"
            f"{', and others that differ' if stated else ''}. Set measurement.kind to one of {', '.join(KINDS)}."
        )
    else:
        chosen = found
    texts = " ".join(r.text.lower() for r in frfs)
    if kind is None and chosen != "transmissibility" and "transmissib" in texts:
        notes.append(
            f"The file's text says transmissibility, its specifiers {chosen}; taken as {chosen}. "
            "If the text is right, set measurement.kind: transmissibility."
        )
    factors = []
    for record in frfs:
        factor, note = factor_to_si(chosen, *record.labels, units)
        factors.append(factor)
        if note and note not in notes:
            notes.append(note)
    return chosen, factors


def _assemble(
    frfs: list[Record],
    coherences: list[Record],
    places: dict[int, Point],
    kind: Kind,
    factors: list[float],
    path: Path,
    notes: list[str],
) -> Measurement:
    first = frfs[0]
    responses = sorted({r.response for r in frfs})
    references = sorted({r.reference for r in frfs})
    shape = (len(first.frequency), len(responses), len(references))
    frf = np.zeros(shape, dtype=np.complex128)
    coherence = np.full(shape, np.nan)
    owner: dict[tuple[End, End], Record] = {}
    for record, factor in zip(frfs, factors, strict=True):
        _same_lines(record, first, path)
        pair = (record.response, record.reference)
        if pair in owner:
            raise MeasurementError(
                f"{path}: expected each pair of response and reference once, got {owner[pair].label} and "
                f"{record.label}. Keep one of them."
            )
        owner[pair] = record
        place = (responses.index(pair[0]), references.index(pair[1]))
        frf[:, *place] = record.sign * factor * record.value
    lone = [record for record in coherences if (record.response, record.reference) not in owner]
    if len(lone) == 1:
        notes.append(f"The coherence in {lone[0].label} belongs to no FRF that was read; left out.")
    elif lone:
        notes.append(f"Left out {len(lone)} coherences that belong to no FRF that was read, the first {lone[0].label}.")
    for record in coherences:
        pair = (record.response, record.reference)
        if pair not in owner:
            continue
        _same_lines(record, first, path)
        coherence[:, responses.index(pair[0]), references.index(pair[1])] = record.value.real
    measured = np.zeros(shape[1:], dtype=bool)
    for response, reference in owner:
        measured[responses.index(response), references.index(reference)] = True
    return Measurement(
        frequency=torch.from_numpy(np.asarray(first.frequency, dtype=np.float64)),
        frf=torch.from_numpy(frf),
        measured=torch.from_numpy(measured),
        response=tuple(Channel(node, direction, places.get(node)) for node, direction in responses),
        reference=tuple(Channel(node, direction, places.get(node)) for node, direction in references),
        kind=kind,
        unit=SI_UNIT[kind],
        coherence=torch.from_numpy(coherence) if bool(np.isfinite(coherence).any()) else None,
        source=str(path),
        notes=tuple(notes),
    )


def _same_lines(record: Record, first: Record, path: Path) -> None:
    ours, theirs = record.frequency, first.frequency
    # A hundredth of a line: what header rounding can move, and far less than a resonance is wide.
    if len(ours) == len(theirs) and (
        len(ours) < 2 or float(np.abs(ours - theirs).max()) <= 0.01 * float(np.abs(np.diff(theirs)).min())
    ):
        return
    spans = [f"{len(x)} lines from {x.min():g} to {x.max():g} Hz" if len(x) else "no line" for x in (theirs, ours)]
    raise MeasurementError(
        f"{path}: expected the same frequency lines in every record, got {spans[0]} in {first.label} and "
        f"{spans[1]} in {record.label}. Export them with one setting, or split the file."
    )
