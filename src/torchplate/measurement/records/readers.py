"""Readers of time records: universal files (58 type 1), WAV, MAT, NPZ, CSV and text, LVM."""

import math
import re
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from torchplate.measurement.formats.archive import plain
from torchplate.measurement.formats.parsing import reads
from torchplate.measurement.level import FORCE, MOTION, SI_LABEL, quantity_of, to_si
from torchplate.measurement.measurement import MeasurementError
from torchplate.measurement.read import UFF_SUFFIX
from torchplate.measurement.records.recording import Motion, Recording
from torchplate.measurement.records.tables import FORCE_NAME, READERS, RecordTable
from torchplate.measurement.uff.dataset import Record, open_uff
from torchplate.measurement.uff.geometry import geometry_of

SAME_RATE = 1e-3
"""Relative [-]: natural frequencies of careful tests scatter by as much, and times of few digits are less off."""


@dataclass(frozen=True)
class Layout:
    """What a file does not say of its channels.

    Args:
        force: Name or number (from 1) of the force channel; None to find it by its name or unit, else by its pulses.
        rate: Samples per second [Hz], where the file does not say; before what it says, which is noted.
        reference: Node that is hit, where the file does not say.
        responses: Nodes of the response channels in the file's order, likewise.
        scale: Factors to N and to the responses' SI unit; (1, 1) to go by the units that the file states.
        motion: What the responses are, where the file does not say.

    Raises:
        ValueError: A rate that is none, or a factor of nothing.
    """

    force: str | None = None
    rate: float | None = None
    reference: int | None = None
    responses: tuple[int, ...] = ()
    scale: tuple[float, float] = (1.0, 1.0)
    motion: Motion | None = None

    def __post_init__(self) -> None:
        if self.rate is not None and not 0 < self.rate < math.inf:
            raise ValueError(f"Expected a rate above 0 Hz, got {self.rate:g}. Leave it out where the file has its own.")
        if not all(0 < abs(factor) < math.inf for factor in self.scale):
            raise ValueError(
                f"Expected factors other than 0 to N and SI, got {self.scale[0]:g} and {self.scale[1]:g}. Leave them "
                "out where the file has its units."
            )


@reads("time records")
def read_recordings(path: Path, layout: Layout | None = None) -> list[Recording]:
    """Read the hits' time records of a file, one `Recording` for each force record.

    Raises:
        MeasurementError: The file is absent, of another format, or without force and responses.
    """
    layout = layout or Layout()
    if not path.is_file():
        raise MeasurementError(f"{path}: expected a file with time records, got none there. Check the path.")
    suffix = path.suffix.lower()
    if suffix in UFF_SUFFIX:
        return _from_uff(path, layout)
    if suffix not in READERS:
        raise MeasurementError(
            f"{path}: expected time records in a {', '.join((*UFF_SUFFIX, *READERS))} file, got the suffix "
            f"{suffix or 'none'!r}. Export them in one of these."
        )
    try:
        table = READERS[suffix](path)
    except (MeasurementError, MemoryError):
        raise
    except Exception as error:  # whatever a reader says of a file that is not of its format
        reason = re.split(r"[.;(] ?", plain(" ".join(str(error).split())))[0][:120]
        raise MeasurementError(
            f"{path}: expected a {suffix[1:].upper()} file with time records, got one that does not parse ({reason}). "
            "Export it again, or as CSV with the columns time, force, response."
        ) from error
    return _from_table(table, path, layout)


def _from_table(table: RecordTable, path: Path, layout: Layout) -> list[Recording]:
    rate = layout.rate or table.rate
    if rate is None:
        raise MeasurementError(f"{path}: expected a sampling rate or a time column, got neither. Give --rate in Hz.")
    table = replace(table, names=tuple(map(plain, table.names)))
    n_channel = table.channels.shape[1]
    if n_channel < 2:
        raise MeasurementError(
            f"{path}: expected a force and at least one response, got {n_channel} channel. Export the hammer's channel "
            "beside the responses"
            + (
                "; if it is a table of natural frequencies, write them into a config, as measurement: "
                "{natural_frequencies: {1: 41.3, 2: 77.9}}."
                if path.suffix.lower() in (".csv", ".txt")
                else "."
            )
        )
    if not table.channels.shape[-1]:
        raise MeasurementError(f"{path}: expected samples, got none. Export it again.")
    force, remark = _force_channel(table, path, layout)
    others = [i for i in range(n_channel) if i != force]
    if layout.responses and len(layout.responses) != len(others):
        raise MeasurementError(
            f"{path}: expected a node for each of {len(others)} responses, got {len(layout.responses)}. Correct "
            "--response."
        )
    factor, motion, has_unit = _units(table, force, others, path, layout)
    return [
        Recording(
            rate=float(rate),
            force=factor[force] * hit[force].astype(np.float64),
            response=factor[others, None] * hit[others].astype(np.float64),
            reference=layout.reference or 0,
            responses=layout.responses or tuple(range(1, len(others) + 1)),
            motion=motion,
            has_unit=has_unit,
            source=f"{path}" + (f", record {number}" if len(table.channels) > 1 else ""),
            notes=tuple(filter(None, (remark, _of_rate(table.rate, layout)))),
        )
        for number, hit in enumerate(table.channels, start=1)
    ]


def _of_rate(own: float | None, layout: Layout) -> str:
    """What is said where the file has another rate [Hz] than was told; times that were rounded have nearly the same."""
    if own is None or layout.rate is None or abs(layout.rate - own) < SAME_RATE * own:
        return ""
    return (
        f"The file's own rate is {own:.6g} Hz, and {layout.rate:.6g} Hz was taken, as --rate says: leave it out if the "
        "file is right."
    )


def _units(
    table: RecordTable, force: int, others: list[int], path: Path, layout: Layout
) -> tuple[np.ndarray, Motion | None, bool]:
    """Factors to SI by channel, what the responses are, and whether all that is known: as told, else by the units."""
    factor = np.ones(len(table.names))
    if layout.scale != (1.0, 1.0):
        factor[force], factor[others] = layout.scale
        return factor, layout.motion, True
    units = [*table.units, *[""] * (len(table.names) - len(table.units))]
    stated = {quantity for i in others if (quantity := quantity_of(units[i])) not in (None, "force")}
    if len(stated) > 1:
        named = " and ".join(sorted(map(str, stated)))
        raise MeasurementError(
            f"{path}: expected responses of one kind, got units of {named}. Export one kind of sensor, and leave the "
            "other channels out."
        )
    motion = layout.motion or _motion(stated.pop() if stated else None)
    known = to_si("force", units[force])
    found = [to_si(motion or "acceleration", units[i]) for i in others]
    factor[force] = known or 1.0
    factor[others] = [one or 1.0 for one in found]
    return factor, motion, known is not None and None not in found


def _force_channel(table: RecordTable, path: Path, layout: Layout) -> tuple[int, str]:
    """The force's channel, and a sentence where nothing in the file says that it is one."""
    names, n_channel = table.names, table.channels.shape[1]
    if layout.force is None:
        named = next((i for i, name in enumerate(names) if FORCE_NAME.search(name)), None)
        if named is None:
            named = next((i for i, unit in enumerate(table.units) if quantity_of(unit) == "force"), None)
        if named is not None:
            return named, ""
        found = _most_like_a_pulse(table.channels)
        return found, (
            f"No channel is named as the force: {names[found]!r}, of {n_channel}, has the shortest pulses and was "
            f"taken; --force names another: --force {1 if found else 2}, say."
            + (" The first number of --scale is the force's, the second the responses'." if found else "")
        )
    if layout.force.isdecimal() and 1 <= int(layout.force) <= n_channel:
        return int(layout.force) - 1, ""
    near = [i for i, name in enumerate(names) if name.strip().lower() == layout.force.strip().lower()]
    if not near:
        raise MeasurementError(
            f"{path}: expected a force channel out of {', '.join(names)} or 1 to {n_channel}, got {layout.force!r}. "
            "Correct --force."
        )
    return near[0], ""


def _most_like_a_pulse(channels: np.ndarray) -> int:
    """The channel whose energy is in the fewest samples: a plate rings, a hammer does not."""
    level = channels - np.median(channels, axis=-1, keepdims=True)
    power = level.astype(np.float64) ** 2
    least = np.finfo(np.float64).tiny
    # (Σ x²)² / Σ x⁴: in how many samples the energy is.
    spread = power.sum(axis=(0, 2)) ** 2 / np.maximum((power**2).sum(axis=(0, 2)), least)
    return int(np.where(power.sum(axis=(0, 2)) > 0, spread, np.inf).argmin())


def _from_uff(path: Path, layout: Layout) -> list[Recording]:
    """Force records and the responses that go with each, by their order in the file."""
    file = open_uff(path)
    geometry = geometry_of(file)
    records = [file.record(index, turned=geometry.turned) for index in file.of_type(58)]
    records = [r for r in records if r.function_type == 1]
    if not records:
        raise MeasurementError(
            f"{path}: expected time records (dataset 58 with function type 1), got none. Export the time data, or read "
            f"what it holds: torchplate inspect {path}."
        )
    forces = [r for r in records if _is_force(r, layout)]
    motions = [r for r in records if not _is_force(r, layout) and (r.numerator in MOTION or r.numerator in (0, 1))]
    if not forces or not motions:
        missing = (
            "force (specific data type 13, or unit N)" if not forces else "motion (specific data type 8, 11 or 12)"
        )
        raise MeasurementError(
            f"{path}: expected records of a force and of a motion, got no {missing} among {len(records)} records. Give "
            "the file that holds it beside this one, or name the node of the force by --force."
        )
    by_channel: dict[tuple[int, str], list[Record]] = defaultdict(list)
    for record in motions:
        by_channel[record.response].append(record)
    uneven = [key for key, own in by_channel.items() if len(own) != len(forces)]
    if uneven:
        node, direction = uneven[0]
        raise MeasurementError(
            f"{path}: expected a record of each response for each of {len(forces)} force records, got "
            f"{len(by_channel[uneven[0]])} of {node}{direction}. Export all channels of each hit."
        )
    places = tuple(geometry.places.items())
    found = []
    for number, force in enumerate(forces):
        own = [records_of[number] for records_of in by_channel.values()]
        units = [to_si("force", force.labels[0])]
        motion = MOTION.get(own[0].numerator)
        units += [to_si(MOTION.get(r.numerator, "acceleration"), r.labels[0]) for r in own]
        factor = [1.0 if unit is None else unit for unit in units]
        lengths = {len(r.value) for r in (force, *own)}
        rate = 1 / float(np.median(np.diff(force.frequency)))
        if len(lengths) > 1:
            raise MeasurementError(
                f"{path}: expected records of one length in each hit, got {min(lengths)} and {max(lengths)} values at "
                f"{force.label}. Export all channels with one setting."
            )
        found.append(
            Recording(
                rate=layout.rate or rate,
                force=layout.scale[0] * factor[0] * force.sign * force.value.real,
                response=np.stack(
                    [layout.scale[1] * f * r.sign * r.value.real for f, r in zip(factor[1:], own, strict=True)]
                ),
                reference=layout.reference or force.response[0],
                responses=layout.responses or tuple(r.response[0] for r in own),
                motion=layout.motion or _motion(motion),
                has_unit=all(unit is not None for unit in units),
                source=f"{path}, {force.label}",
                coordinates=places,
                notes=tuple(filter(None, (*geometry.notes, _of_rate(rate, layout)))),
            )
        )
    return found


def _is_force(record: Record, layout: Layout) -> bool:
    if layout.force is not None and layout.force.isdecimal():
        return record.response[0] == int(layout.force)
    return record.numerator in FORCE or to_si("force", record.labels[0]) is not None


def _motion(name: str | None) -> Motion | None:
    for known in ("displacement", "velocity", "acceleration"):
        if name == known and known in SI_LABEL:
            return known
    return None
