"""FRFs and coherence of a universal file (dataset 58, ASCII or binary) as one measurement, with nodes and units."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import torch

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
from torchplate.measurement.uff.dataset import ALIGNED, End, Record, UffFile, open_uff
from torchplate.measurement.uff.geometry import Point, geometry_of

FUNCTION_TYPE: Final = {0: "unknown", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "FRF"}
FUNCTION_TYPE_READ: Final = {4: "FRF", 5: "transmissibility", 6: "coherence"}
WINDOW: Final = re.compile(r"exponential window of (\d[\d.]*(?:e[-+]?\d+)?) 1/s")
"""As `uff_writer.windowed` writes it."""
SHAPES: Final = {55: "data at nodes, such as mode shapes", 2414: "analysis data, such as mode shapes"}


def read_uff(path: Path, kind: str | None = None, normal: int = 3) -> Measurement:
    """Read the out-of-plane FRFs of a universal file, in SI units.

    A channel that points along -z counts as out of the plate with its sign turned. In-plane and rotational
    channels are left out, with a note.

    Args:
        path: The file; ASCII and binary records may be mixed.
        kind: Overrides what the file's specifiers say.
        normal: The file's axis that points out of the plate, 1 to 3.

    Raises:
        MeasurementError: Not a universal file, no FRF in it or only its amplitudes, lines that differ between records,
            a pair that comes twice, values that do not follow their header, a kind that the file does not settle.
    """
    file = open_uff(path)
    geometry = geometry_of(file)
    places, notes = geometry.places, geometry.notes
    records = [file.record(index, normal, geometry.turned) for index in file.of_type(58)]
    frfs = [r for r in records if r.function_type in (4, 5)]
    if not frfs:
        seen = sorted({r.function_type for r in records})
        named = ", ".join(f"{t} ({(FUNCTION_TYPE | FUNCTION_TYPE_READ).get(t, 'other')})" for t in seen)
        came = f"function types {named}" if records else "no dataset 58"
        action = "Export the FRFs from the analyser"
        if file.of_type(*SHAPES):
            action = f"Its mode shapes go into a config, as measurement: {{modal_model: {{file: {path.name}}}}}"
        elif 1 in {r.function_type for r in records}:
            action = f"Make them from its time records: torchplate frf {path.name} --out FRFS.uff"
        raise MeasurementError(
            f"{path}: expected FRFs (dataset 58 with function type 4, or 5 for transmissibility), got {came}. {action}."
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
    _complex(frfs, path, notes)
    if strange := next((r for r in frfs if r.axis), None):
        notes.append(f"The unit label {strange.axis!r} of the frequency axis is not known; taken as Hz.")
    notes += [*_turned(frfs), *_unplaced(frfs, places)]
    found, factor = _kind_and_factor(frfs, kind, geometry.units, path, notes)
    return _assemble(frfs, [r for r in records if r.function_type == 6], places, found, factor, path, notes)


def _complex(frfs: list[Record], path: Path, notes: list[str]) -> None:
    """Refuse amplitudes and levels in dB, and name FRFs of one part alone."""
    halves = [r for r in frfs if r.value.any() and not (r.value.real.any() and r.value.imag.any())]
    for record in halves:
        in_db = "db" in record.labels[0].lower()
        if not record.is_complex and (in_db or record.value.real.min() >= 0):
            raise MeasurementError(
                f"{path}: expected complex FRFs, got {'levels in dB' if in_db else 'amplitudes without a phase'} in "
                f"{record.label}. Export real and imaginary parts (ordinate data type 5 or 6)."
            )
    if halves:
        missing = "imaginary" if halves[0].value.real.any() else "real"
        notes.append(
            f"Of {len(frfs)} FRFs {len(halves)} have no {missing} part, the first {halves[0].label}: an amplitude or "
            "one part alone? Those of a damped model have both: export real and imaginary parts (ordinate data type 5 "
            "or 6)."
        )


def _left_out(file: UffFile, records: list[Record]) -> list[str]:
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
        if n_set := len(file.of_type(number)):
            found.append(f"Left out {n_set} dataset{'s' * (n_set > 1)} {number} ({name}): only FRFs are read.")
    return found


def _turned(frfs: list[Record]) -> list[str]:
    """What is to be said of directions that the file gives in coordinate systems of their own."""
    notes = []
    if n := sum(r.turned for r in frfs):
        notes.append(
            f"The directions of {n} FRF{'s' * (n > 1)} were turned from the nodes' own coordinate systems into the "
            "global one."
        )
    worst = min(frfs, key=lambda r: r.cosine)
    if worst.cosine < ALIGNED:
        notes.append(
            f"A direction of {worst.label} is turned by {math.degrees(math.acos(worst.cosine)):.0f} degrees from the "
            "nearest axis of the file, along which it is taken. Check the node's coordinate system."
        )
    return notes


def _unplaced(frfs: list[Record], places: Mapping[int, Point]) -> list[str]:
    """What is to be said of FRFs at nodes that the geometry has not."""
    nodes = {r.response[0] for r in frfs} | {r.reference[0] for r in frfs if r.function_type != 5}
    missing = sorted(nodes - set(places))
    if not places or not missing:
        return []
    first = ", ".join(map(str, missing[:4])) + (" ..." if len(missing) > 4 else "")
    return [
        f"The geometry, with the labels {min(places)} to {max(places)}, has no place for {len(missing)} of the FRFs' "
        f"{len(nodes)} nodes: {first}. Make the labels agree in the export, or give a table of nodes "
        "(measurement.nodes)."
    ]


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
            f"{', and others that differ' if stated else ''}. Set measurement.kind (--kind of `torchplate new`) to one "
            f"of {', '.join(KINDS)}."
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
        window=_window(frfs),
    )


def _window(frfs: list[Record]) -> float:
    """Rate of the exponential window that the FRFs' first lines state as `uff_writer` does [1/s]; 0 where none does."""
    found = {match.group(1) if (match := WINDOW.search(r.text)) else "0" for r in frfs}
    return float(found.pop()) if len(found) == 1 else 0.0


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
