"""Readers of time records: universal files (58 type 1), WAV, MAT, NPZ, CSV and text, LVM."""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from torchplate.measurement.archive import arrays_of, plain
from torchplate.measurement.level import FORCE, MOTION, SI_LABEL, to_si
from torchplate.measurement.mat_elements import check_elements
from torchplate.measurement.measurement import MeasurementError
from torchplate.measurement.parsing import reads
from torchplate.measurement.read import UFF_SUFFIX
from torchplate.measurement.recording import Motion, Recording
from torchplate.measurement.uff import Record, open_uff, read_geometry

FORCE_NAME: Final = re.compile(
    r"force|hammer|exc|impact|kraft|^f\d*$|\[\s*(k|m)?n\s*\]|\(\s*(k|m)?n\s*\)", re.IGNORECASE
)
RATE_NAME: Final = ("fs", "rate", "sampling_rate", "sample_rate", "samplerate", "sampling_freq", "fsamp", "sr")
STEP_NAME: Final = ("dt", "ts", "step")
TIME_NAME: Final = ("t", "time", "time_s", "zeit")


@dataclass(frozen=True)
class Layout:
    """What a file does not say of its channels.

    Args:
        force: Name or number (from 1) of the force channel; None to find it by its name or unit, else the first.
        rate: Samples per second [Hz], where the file does not say.
        reference: Node that is hit, where the file does not say.
        responses: Nodes of the response channels in the file's order, likewise.
        scale: Factors to N and to the responses' SI unit.
        motion: What the responses are, where the file does not say.
    """

    force: str | None = None
    rate: float | None = None
    reference: int | None = None
    responses: tuple[int, ...] = ()
    scale: tuple[float, float] = (1.0, 1.0)
    motion: Motion | None = None


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
    if suffix not in _READERS:
        raise MeasurementError(
            f"{path}: expected time records in a {', '.join((*UFF_SUFFIX, *_READERS))} file, got the suffix "
            f"{suffix or 'none'!r}. Export them in one of these."
        )
    try:
        table = _READERS[suffix](path)
    except (MeasurementError, MemoryError):
        raise
    except Exception as error:  # whatever a reader says of a file that is not of its format
        reason = plain(" ".join(str(error).split()))[:120]
        raise MeasurementError(
            f"{path}: expected a {suffix[1:].upper()} file with time records, got one that does not parse ({reason}). "
            "Export it again, or as CSV with the columns time, force, response."
        ) from error
    return _from_table(table, path, layout)


@dataclass(frozen=True)
class _Table:
    rate: float | None
    names: tuple[str, ...]
    channels: np.ndarray  # [n_hit, n_channel, n_sample]


def _from_table(table: _Table, path: Path, layout: Layout) -> list[Recording]:
    rate = layout.rate or table.rate
    if rate is None:
        raise MeasurementError(f"{path}: expected a sampling rate or a time column, got neither. Give --rate in Hz.")
    table = replace(table, names=tuple(map(plain, table.names)))
    n_channel = table.channels.shape[1]
    if n_channel < 2:
        raise MeasurementError(
            f"{path}: expected a force and at least one response, got {n_channel} channel. Export the hammer's channel "
            "beside the responses."
        )
    force = _force_channel(table.names, n_channel, path, layout)
    others = [i for i in range(n_channel) if i != force]
    if layout.responses and len(layout.responses) != len(others):
        raise MeasurementError(
            f"{path}: expected a node for each of {len(others)} responses, got {len(layout.responses)}. Correct "
            "--response."
        )
    return [
        Recording(
            rate=float(rate),
            force=layout.scale[0] * hit[force].astype(np.float64),
            response=layout.scale[1] * hit[others].astype(np.float64),
            reference=layout.reference or 0,
            responses=layout.responses or tuple(range(1, len(others) + 1)),
            motion=layout.motion,
            has_unit=layout.scale != (1.0, 1.0),
            source=f"{path}" + (f", record {number}" if len(table.channels) > 1 else ""),
        )
        for number, hit in enumerate(table.channels, start=1)
    ]


def _force_channel(names: tuple[str, ...], n_channel: int, path: Path, layout: Layout) -> int:
    if layout.force is None:
        return next((i for i, name in enumerate(names) if FORCE_NAME.search(name)), 0)
    if layout.force.isdecimal() and 1 <= int(layout.force) <= n_channel:
        return int(layout.force) - 1
    near = [i for i, name in enumerate(names) if name.strip().lower() == layout.force.strip().lower()]
    if not near:
        raise MeasurementError(
            f"{path}: expected a force channel out of {', '.join(names)} or 1 to {n_channel}, got {layout.force!r}. "
            "Correct --force."
        )
    return near[0]


def _from_wav(path: Path) -> _Table:
    from scipy.io import wavfile

    try:
        rate, data = wavfile.read(path)
    except (ValueError, EOFError) as error:
        raise MeasurementError(
            f"{path}: expected a WAV file, got one that does not parse ({error}). Export it again."
        ) from error
    columns = data[:, None] if data.ndim == 1 else data
    full = float(np.iinfo(columns.dtype).max) + 1 if np.issubdtype(columns.dtype, np.integer) else 1.0
    names = tuple(f"channel {i}" for i in range(1, columns.shape[1] + 1))
    return _Table(float(rate), names, (columns.T / full)[None])


def _from_mat(path: Path) -> _Table:
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(str(path))[0] == 1:
        check_elements(path.read_bytes())
    try:
        content = loadmat(path, squeeze_me=True, simplify_cells=True)
    except NotImplementedError:
        raise MeasurementError(
            f"{path}: expected a MAT file up to version 7, got version 7.3. Save it with -v7."
        ) from None
    return _from_mapping(content, path)


def _from_npz(path: Path) -> _Table:
    return _from_mapping(arrays_of(path), path)


def _from_mapping(content: Mapping[str, Any], path: Path) -> _Table:
    """Arrays by name: the rate by its usual names, the force by its own, everything else as long is a response."""
    numbers: dict[str, np.ndarray] = {}
    for key, value in _flat(content):
        if isinstance(value, np.ndarray | float | int) and np.issubdtype(np.asarray(value).dtype, np.number):
            numbers[key] = np.asarray(value)
    rate = next((float(v) for k, v in numbers.items() if _word(k) in RATE_NAME and v.size == 1), None)
    if rate is None:
        rate = next((1 / float(v) for k, v in numbers.items() if _word(k) in STEP_NAME and v.size == 1), None)
    time = next((v for k, v in numbers.items() if _word(k) in TIME_NAME and v.size > 1), None)
    if rate is None and time is not None:
        rate = _rate_of(np.ravel(time if time.ndim == 1 else time.reshape(-1, time.shape[-1])[0]), path)
    signals = {k: v for k, v in numbers.items() if v.size > 1 and v is not time}
    forces = [k for k in signals if FORCE_NAME.search(_word(k))]
    if not forces or len(signals) < 2:
        raise MeasurementError(
            f"{path}: expected arrays named force, response and fs (or time), got {', '.join(content) or 'none'}. Save "
            "them under these names."
        )
    force = np.atleast_2d(signals.pop(forces[0]))
    n_hit, n_sample = force.shape
    if n_hit > n_sample:
        force = force.T
        n_hit, n_sample = force.shape
    blocks, names = [force[:, None]], [forces[0]]
    for key, value in signals.items():
        block = _as_hits(value, n_hit, n_sample)
        if block is None:
            raise MeasurementError(
                f"{path}: expected '{key}' with {n_hit} hits of {n_sample} samples as the force, got the shape "
                f"{value.shape}. Save responses as (hit, channel, sample)."
            )
        blocks.append(block)
        names += [key] if block.shape[1] == 1 else [f"{key} {i}" for i in range(1, block.shape[1] + 1)]
    return _Table(rate, tuple(names), np.concatenate(blocks, axis=1))


def _as_hits(value: np.ndarray, n_hit: int, n_sample: int) -> np.ndarray | None:
    """An array of responses as (hit, channel, sample), whatever the order of its axes."""
    if value.shape == (n_hit, n_sample):
        return value[:, None]
    if value.shape == (n_sample,) and n_hit == 1:
        return value[None, None]
    if n_hit == 1 and value.ndim == 2 and n_sample in value.shape:
        return (value if value.shape[1] == n_sample else value.T)[None]
    if value.shape == (n_sample, n_hit):
        return value.T[:, None]
    if value.ndim == 3 and value.shape[0] == n_hit and value.shape[2] == n_sample:
        return value
    if value.ndim == 3 and value.shape[0] == n_hit and value.shape[1] == n_sample:
        return value.transpose(0, 2, 1)
    return None


def _flat(content: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, value in content.items():
        if str(key).startswith("__"):
            continue
        found += _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else [(f"{prefix}{key}", value)]
    return found


def _word(key: str) -> str:
    return key.rpartition(".")[2].lower()


def _from_text(path: Path) -> _Table:
    """Columns: time first unless a rate is given, then the channels; a head line names them."""
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    names: list[str] = []
    rows: list[list[float]] = []
    for line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = _cells(line)
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            if rows:
                raise MeasurementError(
                    f"{path}: expected numbers in each row, got {line.strip()[:60]!r}. Remove that line."
                ) from None
            names = cells
    widths = {len(row) for row in rows}
    if len(widths) != 1:
        raise MeasurementError(
            f"{path}: expected rows of equal length (time, force, response ...), got "
            f"{'none' if not rows else f'rows of {min(widths)} and {max(widths)} numbers'}. Export it as a table."
        )
    table = np.array(rows).T
    if len(names) != len(table):
        names = [f"column {i}" for i in range(1, len(table) + 1)]
    # A time column rises evenly.
    rises = len(table[0]) > 1 and bool((np.diff(table[0]) > 0).all())
    if rises:
        return _Table(_rate_of(table[0], path), tuple(names[1:]), table[None, 1:])
    return _Table(None, tuple(names), table[None])


def _cells(line: str) -> list[str]:
    """The cells of a row; a comma is a decimal point where semicolons or tabs part the columns."""
    for mark in (";", "\t"):
        if mark in line:
            cells = [cell.strip() for cell in line.split(mark)]
            return [cell.replace(",", ".") for cell in cells if cell]
    cells = line.split(",") if "," in line else line.split()
    return [cell.strip().strip('"') for cell in cells if cell.strip()]


def _rate_of(time: np.ndarray, path: Path) -> float:
    steps = np.diff(time)
    step = float(np.median(steps)) if steps.size else 0.0
    if step <= 0 or float(np.abs(steps - step).max()) > 0.01 * step + 4e-7 * abs(float(time[-1])):
        raise MeasurementError(
            f"{path}: expected times that rise in equal steps, got steps from {steps.min():g} to {steps.max():g} s. "
            "Export it with one sampling rate."
        )
    return float((len(time) - 1) / (time[-1] - time[0]))


def _from_lvm(path: Path) -> _Table:
    try:
        import lvm_read
    except ImportError:
        raise MeasurementError(
            f"{path}: expected the package lvm-read, to read LVM files, found none. Install torchplate-fem[lvm], or "
            "export CSV."
        ) from None
    content = lvm_read.read(str(path), read_from_pickle=False, dump_file=False)
    segments = [content[i] for i in range(content["Segments"])]
    rate = 1 / float(segments[0]["Delta_X"][0])
    columns = [np.asarray(segment["data"], dtype=float) for segment in segments]
    names = [str(name) for name in segments[0].get("Channel names", [])]
    if names and names[0].lower().startswith("x"):
        names = names[1:]
        wide = columns[0].shape[1] == len(names) + 1
        columns = [c[:, 1:] for c in columns] if wide else columns
    least = min(len(c) for c in columns)
    stack = np.stack([c[:least].T for c in columns])
    kept = [i for i in range(stack.shape[1]) if np.isfinite(stack[:, i]).all()]
    named = [names[i] if i < len(names) else f"channel {i + 1}" for i in kept]
    return _Table(rate, tuple(named), stack[:, kept])


_READERS: Final[dict[str, Callable[[Path], _Table]]] = {
    ".wav": _from_wav,
    ".mat": _from_mat,
    ".npz": _from_npz,
    ".csv": _from_text,
    ".txt": _from_text,
    ".lvm": _from_lvm,
}
RECORD_SUFFIX: Final = tuple(_READERS)


def _from_uff(path: Path, layout: Layout) -> list[Recording]:
    """Force records and the responses that go with each, by their order in the file."""
    file = open_uff(path)
    records = [file.record(i) for i, kind in enumerate(file.types) if kind == 58]
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
    places = tuple(read_geometry(path)[0].items())
    found = []
    for number, force in enumerate(forces):
        own = [records_of[number] for records_of in by_channel.values()]
        units = [to_si("force", force.labels[0])]
        motion = MOTION.get(own[0].numerator)
        units += [to_si(MOTION.get(r.numerator, "acceleration"), r.labels[0]) for r in own]
        factor = [1.0 if unit is None else unit for unit in units]
        lengths = {len(r.value) for r in (force, *own)}
        if len(lengths) > 1:
            raise MeasurementError(
                f"{path}: expected records of one length in each hit, got {min(lengths)} and {max(lengths)} values at "
                f"{force.label}. Export all channels with one setting."
            )
        found.append(
            Recording(
                rate=layout.rate or 1 / float(np.median(np.diff(force.frequency))),
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
