"""Time records as tables of channels, from files that name no nodes: WAV, MAT, NPZ, CSV and text, LVM."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from torchplate.measurement.formats.archive import arrays_of, plain, quoted
from torchplate.measurement.formats.mat_elements import check_elements
from torchplate.measurement.formats.text_table import cells_of, lines_of, number_of, unit_in
from torchplate.measurement.level import is_unit, second_of
from torchplate.measurement.measurement import MeasurementError

FORCE_NAME: Final = re.compile(
    r"force|hammer|exc|impact|kraft|^f\d*$|\[\s*(k|m)?n\s*\]|\(\s*(k|m)?n\s*\)", re.IGNORECASE
)
RATE_NAME: Final = ("fs", "rate", "sampling_rate", "sample_rate", "samplerate", "sampling_freq", "fsamp", "sr")
STEP_NAME: Final = ("dt", "ts", "step")
TIME_NAME: Final = ("t", "time", "time_s", "zeit")

Number = TypeVar("Number", float, complex)


@dataclass(frozen=True)
class RecordTable:
    """What a file holds, channel by channel; its rate [Hz] and the channels' units, where it tells them."""

    rate: float | None
    names: tuple[str, ...]
    channels: np.ndarray  # [n_hit, n_channel, n_sample]
    units: tuple[str, ...] = ()


def _from_wav(path: Path) -> RecordTable:
    from scipy.io import wavfile

    try:
        rate, data = wavfile.read(path)
    except (ValueError, EOFError) as error:
        raise MeasurementError(
            f"{path}: expected a WAV file, got one that does not parse ({error}). Export it again."
        ) from error
    columns = data[:, None] if data.ndim == 1 else data
    if columns.dtype == np.uint8:  # the only samples of WAV without a sign: 128 is silence
        columns = columns.astype(np.int16) - 128
        full = 128.0
    else:
        full = float(np.iinfo(columns.dtype).max) + 1 if np.issubdtype(columns.dtype, np.integer) else 1.0
    names = tuple(f"channel {i}" for i in range(1, columns.shape[1] + 1))
    return RecordTable(float(rate), names, (columns.T / full)[None])


def _mat(path: Path) -> Mapping[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError, matfile_version

    try:
        if matfile_version(str(path))[0] == 1:
            check_elements(path.read_bytes())
        content: Mapping[str, Any] = loadmat(path, squeeze_me=True, simplify_cells=True)
    except NotImplementedError:
        raise MeasurementError(
            f"{path}: expected a MAT file up to version 7, got version 7.3. Save it with -v7."
        ) from None
    except (MatReadError, NameError) as error:  # of variables that SciPy never set
        said = "" if isinstance(error, NameError) else f" ({quoted(str(error))})"
        raise MeasurementError(f"{path}: expected a MAT file, got a broken one{said}. Save it again.") from None
    return content


MAPPINGS: Final[dict[str, Callable[[Path], Mapping[str, Any]]]] = {".mat": _mat, ".npz": arrays_of}
"""What reads files of arrays by name."""


def _from_arrays(path: Path) -> RecordTable:
    return _from_mapping(MAPPINGS[path.suffix.lower()](path), path)


def _from_mapping(content: Mapping[str, Any], path: Path) -> RecordTable:
    """Arrays by name: the rate by its usual names, the force by its own, everything else as long is a response."""
    numbers: dict[str, np.ndarray] = {}
    for key, value in flat(content):
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
            f"{path}: expected arrays named force, response and fs (or time), got {_named(content)}. Save "
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
    return RecordTable(rate, tuple(names), np.concatenate(blocks, axis=1))


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


def flat(content: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """The values of a mapping and of those within it, by their names with points between."""
    found: list[tuple[str, Any]] = []
    for key, value in content.items():
        if str(key).startswith("__"):
            continue
        found += flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else [(f"{prefix}{key}", value)]
    return found


def _named(content: Mapping[str, Any]) -> str:
    """The names in a file, without those of its format."""
    return quoted(", ".join(key for key in content if not str(key).startswith("__"))) or "none"


def _word(key: str) -> str:
    return key.rpartition(".")[2].lower()


def _from_text(path: Path) -> RecordTable:
    """Columns: time first unless a rate is given, then the channels; a head line names them, and may give units."""
    heads, rows = rows_of(path, number_of)
    widths = {len(row) for row in rows}
    if len(widths) != 1:
        raise MeasurementError(
            f"{path}: expected rows of equal length (time, force, response ...), got "
            f"{'none' if not rows else f'rows of {min(widths)} and {max(widths)} numbers'}. Export it as a table."
        )
    table = np.array(rows).T
    names, units = headed([cells for cells in heads if len(cells) == len(table)], len(table))
    time = _time_column(names, table)
    if time is None:
        return RecordTable(None, names, table[None], units)
    seconds = table[time] * _seconds(units[time], path)
    # What stands before the time counts the rows.
    return RecordTable(_rate_of(seconds, path), names[time + 1 :], table[None, time + 1 :], units[time + 1 :])


def rows_of(path: Path, number: Callable[[str], Number]) -> tuple[list[list[str]], list[list[Number]]]:
    """The cells of the lines above a table of numbers, and its rows.

    Args:
        path: Of the text.
        number: A cell as a number; a ValueError where it is none.

    Raises:
        MeasurementError: A line within the table that is no row of numbers.
    """
    heads: list[list[str]] = []
    rows: list[list[Number]] = []
    indexed = False
    for line in lines_of(path):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = cells_of(line)
        try:
            rows.append([number(cell) for cell in cells])
        except ValueError:
            if rows:
                raise MeasurementError(
                    f"{path}: expected numbers in each row, got {line.strip()[:60]!r}. Remove that line."
                ) from None
            heads.append(cells)
            indexed = line[0] in ",;\t"
    # pandas counts the rows in a column of its own, whose head is empty.
    if indexed and [row[0] for row in rows] == [*range(len(rows))] and len(rows[0]) == len(heads[-1]) + 1:
        rows = [row[1:] for row in rows]
    return heads, rows


def headed(heads: list[list[str]], n_column: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Name and unit of each column, from a line of names and, below it, one of units."""
    if not heads:
        return tuple(f"column {i}" for i in range(1, n_column + 1)), ("",) * n_column
    bare = tuple(cell.strip("[]() ") for cell in heads[-1])
    if len(heads) > 1 and all(is_unit(unit) for unit in bare):
        return tuple(heads[-2]), bare
    return tuple(heads[-1]), tuple(unit_in(name) for name in heads[-1])


def _time_column(names: Sequence[str], table: np.ndarray) -> int | None:
    """The column that is headed as time; else the first, where it rises, which a time does."""
    named = [i for i, name in enumerate(names) if re.split(r"[\s\[(]", name.strip().lower())[0] in TIME_NAME]
    return next((i for i in (*named, 0) if len(table[i]) > 1 and bool((np.diff(table[i]) > 0).all())), None)


def _seconds(unit: str, path: Path) -> float:
    """Factor from a column of times to seconds."""
    if not unit:
        return 1.0
    factor = second_of(unit)
    if factor is None:
        raise MeasurementError(
            f"{path}: expected times in s, ms or µs, got a column in {plain(unit)!r}. Convert it, or leave it out and "
            "give --rate."
        )
    return factor


def _rate_of(time: np.ndarray, path: Path) -> float:
    steps = np.diff(time)
    step = float(np.median(steps)) if steps.size else 0.0
    if step <= 0 or float(np.abs(steps - step).max()) > 0.01 * step + 4e-7 * abs(float(time[-1])):
        raise MeasurementError(
            f"{path}: expected times that rise in equal steps, got steps from {steps.min():g} to {steps.max():g} s. "
            "Export it with one sampling rate."
        )
    return float((len(time) - 1) / (time[-1] - time[0]))


def _from_lvm(path: Path) -> RecordTable:
    try:
        import lvm_read
    except ImportError:
        raise MeasurementError(
            f"{path}: expected the package lvm-read, to read LVM files, found none. Install torchplate-fem[lvm], or "
            "export CSV."
        ) from None
    content = lvm_read.read(str(path), read_from_pickle=False, dump_file=False)
    segments = [content[i] for i in range(content["Segments"])]
    steps = [float(step) for step in segments[0]["Delta_X"]]
    rate = 1 / next(step for step in steps if np.isfinite(step))
    columns = [np.asarray(segment["data"], dtype=float) for segment in segments]
    heads = [str(name) for name in segments[0].get("Channel names", [])]
    heads += [f"channel {i + 1}" for i in range(len(heads), columns[0].shape[1])]
    # LabVIEW writes times in no column, in the first one, or in one before each channel; text stands in the last.
    seen = [i for i in range(columns[0].shape[1]) if heads[i] not in ("X_Value", "Comment")]
    n_channel = int(segments[0].get("Channels", len(seen)))
    if len(seen) < n_channel:
        raise MeasurementError(
            f"{path}: expected {n_channel} channels, as its head says, got {len(seen)}. Write it with one column of "
            "times, or with none."
        )
    least = min(len(c) for c in columns)
    stack = np.stack([c[:least].T for c in columns])
    stated = [str(unit) for unit in segments[0].get("Y_Unit_Label", [])]
    if len(stated) > len(seen):
        stated = [unit for unit in stated if unit]
    told = dict(zip(seen, stated, strict=False))
    kept = [i for i in seen if np.isfinite(stack[:, i]).all()]
    units = tuple(told.get(i) or unit_in(heads[i]) for i in kept)
    return RecordTable(rate, tuple(heads[i] for i in kept), stack[:, kept], units)


READERS: Final[dict[str, Callable[[Path], RecordTable]]] = {
    ".wav": _from_wav,
    ".mat": _from_arrays,
    ".npz": _from_arrays,
    ".csv": _from_text,
    ".txt": _from_text,
    ".lvm": _from_lvm,
}
RECORD_SUFFIX: Final = tuple(READERS)
