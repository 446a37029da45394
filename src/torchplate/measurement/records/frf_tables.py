"""FRFs in tables that name no nodes: MAT and NPZ files of any names, CSV and text.

A table has a frequency axis, and of each FRF complex values, a real and an imaginary part, or an amplitude and a phase.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from torchplate.measurement.formats.parsing import reads
from torchplate.measurement.formats.text_table import complex_of
from torchplate.measurement.level import KIND_OF_MOTION, Units, factor_to_si, hertz_of, likely_kind
from torchplate.measurement.measurement import SI_UNIT, Channel, Measurement, MeasurementError
from torchplate.measurement.records.readers import Layout
from torchplate.measurement.records.tables import MAPPINGS, flat, headed, rows_of
from torchplate.notation import counted

FREQUENCY: Final = frozenset({"f", "fr", "freq", "freqs", "frequency", "frequencies", "frequenz", "hz", "w", "omega"})
IN_RADIANS: Final = frozenset({"w", "omega"})
PARTS: Final = {
    "real": frozenset({"re", "real", "realteil"}),
    "imaginary": frozenset({"im", "imag", "imaginary", "imaginär", "imaginärteil"}),
    "amplitude": frozenset({"mag", "magnitude", "abs", "amp", "amplitude", "betrag", "db", "modulus"}),
    "phase": frozenset({"phase", "phi", "angle", "arg", "ang"}),
    "coherence": frozenset({"coh", "coherence", "gamma", "cxy", "kohärenz"}),
}
"""Words in a head or a name, by what the column or array is."""
PLAIN: Final = frozenset({"freq", "freqs", "frequency", "frequencies", "frequenz", "hz"})
"""Names of a frequency axis that nothing else has: f may be a force, w a response."""
DECIBEL_OVER: Final = re.compile(r"dB\W+(?:re|rel|ref)\b[.:\s]*(\d[\d.]*(?:[eE][-+]?\d+)?)", re.IGNORECASE)
"""Decibel over a value, as dB re 1e-6 m/s²/N."""
HALF_OF_IT: Final = 0.5
"""Of π [-]: what phases pass at a resonance. In radians, phases that stay below it pass none."""
OTHER_HALF: Final = {"real": "imaginary", "amplitude": "phase"}


@dataclass(frozen=True)
class FrfTable:
    """FRFs whose nodes nobody has named yet.

    Args:
        frequency: [Hz].
        frf: [line, FRF], or [line, response, reference] where the file has them so.
        unit: As the file writes it; empty where it writes none.
        coherence: γ² in the shape of the FRFs, where the file has one for each.
        notes: What was assumed, a sentence each.
    """

    frequency: np.ndarray
    frf: np.ndarray
    unit: str = ""
    coherence: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    @property
    def n_frf(self) -> int:
        """How many FRFs it holds."""
        return int(np.prod(self.frf.shape[1:]))


@dataclass(frozen=True)
class _Column:
    """One column of a table, or one array of a file, its lines first."""

    name: str
    part: str
    unit: str
    value: np.ndarray

    @property
    def stem(self) -> tuple[str, ...]:
        """The name without what says which part it is."""
        return tuple(word for word in _words(self.name) if word not in PARTS.get(self.part, ()))


@reads("FRFs")
def read_frf_table(path: Path) -> FrfTable | None:
    """The FRFs of a MAT, NPZ, CSV or text file; None where it holds none, and time records, say.

    Raises:
        MeasurementError: FRFs without a phase, or of another number of lines than the frequencies.
    """
    suffix = path.suffix.lower()
    if not path.is_file() or suffix not in (*MAPPINGS, ".csv", ".txt"):
        return None
    found = _of_arrays(MAPPINGS[suffix](path)) if suffix in MAPPINGS else _of_columns(path)
    if found is None:
        return None
    frequency, notes, columns = found
    return _assembled(path, frequency, notes, columns)


def _of_arrays(content: Mapping[str, Any]) -> tuple[np.ndarray, list[str], list[_Column]] | None:
    arrays = {
        key: np.asarray(value)
        for key, value in flat(content)
        if isinstance(value, np.ndarray | list) and np.asarray(value).dtype.kind in "iufc"
    }
    complex_ones = [value for value in arrays.values() if value.dtype.kind == "c"]
    axis = next(
        (
            key
            for key, value in arrays.items()
            if value.size == max(value.shape, default=0) > 1
            and value.dtype.kind != "c"
            and set(_words(key)) & FREQUENCY
            and bool((np.diff(value.ravel()) > 0).all())
        ),
        None,
    )
    if axis is None:
        return None
    lines = arrays.pop(axis).ravel().astype(np.float64)
    columns = []
    for key, value in arrays.items():
        if len(lines) not in value.shape:
            continue
        part = "complex" if value.dtype.kind == "c" else _part_of(key)
        columns.append(_Column(key, part, "", np.moveaxis(value, value.shape.index(len(lines)), 0)))
    if not columns and not complex_ones:
        return None
    radians = bool(set(_words(axis)) & IN_RADIANS)
    notes = [f"The axis {axis} was taken as rad/s, by its name."] if radians else []
    return lines / (2 * np.pi) if radians else lines, notes, columns


def _of_columns(path: Path) -> tuple[np.ndarray, list[str], list[_Column]] | None:
    try:
        heads, rows = rows_of(path, complex_of)
    except MeasurementError:
        return None
    if not rows or len({len(row) for row in rows}) != 1:
        return None
    table = np.array(rows).T
    names, units = headed([cells for cells in heads if len(cells) == len(table)], len(table))
    rises = [bool((np.diff(value.real) > 0).all()) for value in table]
    at = next((i for i, up in enumerate(rises) if up and _is_frequency(names[i], units[i])), None)
    notes = []
    if at is None and (at := _axis_that_does_not_rise(names, units)) is not None:
        if not bool((np.diff(table[at].real) < 0).all()):
            raise MeasurementError(
                f"{path}: expected frequencies that rise from line to line, got {names[at]!r}, which repeats some or "
                "goes back. Sort the lines and remove those that come twice."
            )
        table = table[:, ::-1]
        notes.append("The lines go from high to low frequencies, and were turned round.")
    if at is None or at + 1 == len(names):
        return None
    hertz = hertz_of(units[at])
    if hertz is None:
        raise MeasurementError(f"{path}: expected frequencies in Hz, got a column in {units[at]!r}. Convert them.")
    columns = []
    for i, (name, unit, value) in enumerate(zip(names, units, table, strict=True)):
        if i > at:
            complex_one = bool(np.iscomplexobj(value) and value.imag.any())
            columns.append(_Column(name, "complex" if complex_one else _part_of(name), unit, value))
    return hertz * table[at].real, notes, [replace(one, value=_real(one)) for one in columns]


def _assembled(path: Path, frequency: np.ndarray, notes: list[str], columns: Sequence[_Column]) -> FrfTable | None:
    """Complex FRFs from their parts."""
    parts = {part: [one for one in columns if one.part == part] for part in ("complex", *PARTS)}
    found = [one.value for one in parts["complex"]]
    units = [one.unit for one in parts["complex"]]
    for first, second in OTHER_HALF.items():
        others = list(parts[second])
        for one in parts[first]:
            other = next((two for two in others if two.stem == one.stem), others[0] if others else None)
            if other is None:
                raise MeasurementError(
                    f"{path}: expected the {second} part beside {one.name!r}, got none: no FRF can be compared without "
                    "its phase. Export real and imaginary parts."
                )
            others.remove(other)
            with np.errstate(invalid="ignore"):  # what is no number is told below
                found.append(one.value + 1j * other.value if first == "real" else _polar(path, one, other, notes))
            units.append(one.unit if first == "real" or not _is_decibel(one) else "")
    if not found:
        names = ", ".join(one.name for one in columns) or "nothing else"
        raise MeasurementError(
            f"{path}: expected FRFs beside the frequencies, as complex values or as parts named real and imaginary, or "
            f"magnitude and phase, got {names}. Name them so."
        )
    whole = found[0] if len(found) == 1 else np.concatenate([one.reshape(len(one), -1) for one in found], axis=1)
    whole = whole[:, None] if whole.ndim == 1 else whole
    broken = ~np.isfinite(whole).reshape(len(whole), -1).all(axis=1)
    if broken.any() and (frequency[broken] != 0).any():
        where = float(frequency[broken & (frequency != 0)][0])
        raise MeasurementError(
            f"{path}: expected finite FRFs, got NaN or infinity at {where:g} Hz. Remove that line, or export it again."
        )
    coherence = [one.value for one in parts["coherence"]]
    told = np.concatenate([one.reshape(len(one), -1) for one in coherence], axis=1) if coherence else None
    told = told.real.reshape(whole.shape) if told is not None and told.size == whole.size else None
    if broken.any():
        notes.append("The line at 0 Hz holds no finite number, and was left out.")
        frequency, whole, told = frequency[~broken], whole[~broken], None if told is None else told[~broken]
    return FrfTable(frequency, whole, next(filter(None, units), ""), told, tuple(dict.fromkeys(notes)))


def _polar(path: Path, amplitude: _Column, phase: _Column, notes: list[str]) -> np.ndarray:
    level = amplitude.value.real
    if _is_decibel(amplitude):
        over = DECIBEL_OVER.search(amplitude.name) or DECIBEL_OVER.search(amplitude.unit)
        unit = "the FRF in SI units" if over is None else f"the FRF over {over.group(1)} in SI units"
        notes.append(f"Levels in dB were taken as 20 log of {unit}.")
        level = 10 ** (level / 20) * (1.0 if over is None else float(over.group(1)))
    elif bool((level < 0).any()):
        raise MeasurementError(
            f"{path}: expected amplitudes of 0 and above in {amplitude.name!r}, got {level.min():.4g}. If they are "
            f"levels in dB, name the column '{amplitude.name} [dB]'."
        )
    return level * np.exp(1j * _in_radians(phase, notes) * phase.value.real)


def _in_radians(phase: _Column, notes: list[str]) -> float:
    """Factor of a column of phases to radians, as its head says, else by how far they go."""
    head = f"{phase.name} {phase.unit}"
    words, most = set(_words(head)), float(np.abs(phase.value).max())
    if words & {"pi"} or "π" in head:
        notes.append(f"Phases in {phase.name!r} were taken as parts of π, by its head.")
        return float(np.pi)
    if words & {"deg", "degree", "degrees", "grad"} or "°" in head:
        return float(np.pi / 180)
    if words & {"rad", "radian", "radians"}:
        return 1.0
    # An FRF goes through half a turn at least, which is 3 in radians and 180 in degrees.
    if most > 10 * np.pi:
        return float(np.pi / 180)
    if HALF_OF_IT < most <= 1:
        notes.append(
            f"All phases in {phase.name!r} lie within ±1, where a resonance turns them by 3.14 rad: they look like "
            "parts of π, and were taken in rad, as nothing says otherwise. If they are, name the column "
            f"'{phase.name} [pi]'."
        )
    return 1.0


def frfs_of_tables(
    paths: Sequence[Path], tables: Sequence[FrfTable], layout: Layout, references: Sequence[int]
) -> Measurement:
    """The FRFs of tables as one measurement.

    Args:
        paths: Of the files.
        tables: What they hold.
        layout: The responses' nodes, what they are, and factors to SI.
        references: Nodes that are hit: one for each file, or those of the one file's columns.

    Raises:
        MeasurementError: Another number of FRFs than of nodes, or files of other lines.
    """
    blocks: list[np.ndarray] = []
    coherence: list[np.ndarray] = []
    notes: list[str] = []
    for path, table, own in zip(paths, tables, _own_references(len(paths), references), strict=True):
        if len(table.frequency) != len(tables[0].frequency) or not np.allclose(table.frequency, tables[0].frequency):
            raise MeasurementError(
                f"{path}: expected the lines of {paths[0]}, got others. Export all with one setting, or convert them "
                "one by one."
            )
        blocks.append(_placed(path, table.frf, layout.responses, own))
        if table.coherence is not None:
            coherence.append(_placed(path, table.coherence, layout.responses, own))
        notes += table.notes
    frf = np.concatenate(blocks, axis=2)
    unit = next((table.unit for table in tables if table.unit), "")
    kind = KIND_OF_MOTION[layout.motion] if layout.motion else likely_kind(0, unit)
    if kind is None:
        kind = "accelerance"
        notes.append("Nothing says what the FRFs are: taken as accelerance. --motion velocity or displacement if not.")
    factor, strange = factor_to_si(kind, unit, "", Units())
    if layout.scale != (1.0, 1.0):
        factor, strange = layout.scale[1] / layout.scale[0], None
    elif not unit:
        notes.append(
            f"The FRFs have no unit: taken as {SI_UNIT[kind]}. Give --scale FORCE RESPONSE, or write gain: unknown in "
            "the config."
        )
    return Measurement(
        frequency=torch.from_numpy(tables[0].frequency.copy()),
        frf=torch.from_numpy(factor * frf.astype(np.complex128)),
        measured=torch.ones(frf.shape[1:], dtype=torch.bool),
        response=tuple(Channel(node) for node in layout.responses),
        reference=tuple(Channel(node) for node in references),
        kind=kind,
        unit=SI_UNIT[kind],
        coherence=torch.from_numpy(np.concatenate(coherence, axis=2)) if len(coherence) == len(blocks) else None,
        source=str(paths[0]),
        notes=tuple(dict.fromkeys([*notes, *([strange] if strange else [])])),
    )


def _own_references(n_file: int, references: Sequence[int]) -> list[Sequence[int]]:
    return [references] if n_file == 1 else [[one] for one in references]


def _placed(path: Path, values: np.ndarray, responses: Sequence[int], references: Sequence[int]) -> np.ndarray:
    """[line, response, reference]."""
    shape, wanted = values.shape[1:], (len(responses), len(references))
    n_frf = int(np.prod(shape))
    if shape == wanted:
        return values
    if len(shape) == 2 and shape == wanted[::-1]:
        return values.transpose(0, 2, 1)
    if 1 in wanted and n_frf == max(wanted):
        return values.reshape(len(values), *wanted)
    raise MeasurementError(
        f"{path}: expected the nodes of its {counted(n_frf, 'FRF')}, got {counted(wanted[0], 'response')} and "
        f"{counted(wanted[1], 'reference')}. "
        + (
            f"Save them as an array [line, response, reference] of {wanted[0]} × {wanted[1]}."
            if n_frf == wanted[0] * wanted[1]
            else "Give one node for each column: --response 3 --reference 28 102, say, for two hits and one sensor."
        )
    )


def _words(name: str) -> list[str]:
    """The words of a name: of "FRF_real [m/s²]" frf, real, m, s."""
    return [word for word in re.split(r"[^a-zà-ÿ]+", name.lower()) if word]


def _part_of(name: str) -> str:
    words = set(_words(name))
    if "db" in words:  # before what it is over: dB re 1e-6
        return "amplitude"
    if "°" in name and not words & PARTS["amplitude"]:
        return "phase"
    return next((part for part, known in PARTS.items() if words & known), "")


def _is_frequency(name: str, unit: str) -> bool:
    return (_words(name)[:1] or [""])[0] in FREQUENCY or _is_hertz(unit)


def _axis_that_does_not_rise(names: Sequence[str], units: Sequence[str]) -> int | None:
    """The column that is a frequency axis by its name, or by its unit."""
    words = [(_words(name)[:1] or [""])[0] for name in names]
    return next(
        (i for i, (word, unit) in enumerate(zip(words, units, strict=True)) if word in PLAIN or _is_hertz(unit)), None
    )


def _is_hertz(unit: str) -> bool:
    return unit != "" and hertz_of(unit) is not None


def _is_decibel(one: _Column) -> bool:
    return "db" in {*_words(one.name), *_words(one.unit)}


def _real(one: _Column) -> np.ndarray:
    return one.value if one.part == "complex" else one.value.real
