"""A measurement as a universal file: dataset 164 (SI), 2411 (nodes) and one 58 or 58b per FRF and coherence.

The columns are the format's own, so pyuff and others read the files. pyuff does not write them: it gives six digits
to an abscissa, too few for 1e-6, and states a byte count for complex binary records that is half of what follows.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch

from torchplate.measurement.level import MOTION_OF_KIND, SI_LABEL, SPECIFIER
from torchplate.measurement.measurement import Channel, Measurement, MeasurementError
from torchplate.measurement.uff.values import DOUBLE_WIDTH, SINGLE_WIDTH

DIRECTION_NUMBER: Final = {"u": 1, "v": 2, "w": 3, "tx": 4, "ty": 5, "tz": 6}


def write_uff(measurement: Measurement, path: Path, binary: bool = False) -> None:
    """Write every measured pair; reading the file back gives the same to 1e-6 of each value, 1e-12 in binary.

    Args:
        measurement: On any device. Coherence and coordinates are written where there are any; notes are not.
        path: The file; one that exists is replaced.
        binary: Write 58b, little endian, IEEE double precision, instead of ASCII.

    Raises:
        MeasurementError: A node that is given two places, a channel the format has no direction for.
    """
    frequency = measurement.frequency.detach().cpu().numpy().astype(np.float64)
    step = float(frequency[-1] - frequency[0]) / max(len(frequency) - 1, 1)
    spacing = (_number(float(frequency[0])), _number(step))
    written = float(spacing[0]) + float(spacing[1]) * np.arange(len(frequency))
    # Even only where the header's digits give every line back; else the lines are written themselves.
    even = len(frequency) > 1 and bool((np.abs(written - frequency) <= 1e-8 * frequency[-1]).all())
    header = _Header(measurement, spacing if even else None, binary)
    blocks = [units_block(), nodes_block((*measurement.response, *measurement.reference), measurement.source)]
    for j, k in measurement.pairs:
        ends = (measurement.response[j], measurement.reference[k])
        frf = measurement.frf[:, j, k].detach().cpu().numpy().astype(np.complex128)
        blocks.append(_function(frequency, frf, ends, header))
        if measurement.coherence is not None:
            coherence = measurement.coherence[:, j, k].detach().cpu()
            if bool(torch.isfinite(coherence).all()):
                real = coherence.numpy().astype(np.float64)
                blocks.append(_function(frequency, real, ends, header))
    Path(path).write_bytes(b"".join(blocks))


def block(lines: list[str], body: bytes = b"") -> bytes:
    """A dataset between its two lines of -1; the number of the dataset is the first line."""
    return b"".join(f"{line}\n".encode() for line in ["    -1", *lines]) + body + b"    -1\n"


def units_block() -> bytes:
    """Dataset 164: metre and newton."""
    code = f"{1:10d}{'SI: metre (newton)':<20s}{2:10d}"
    factors = [f"{1.0:25.16E}{1.0:25.16E}{1.0:25.16E}".replace("E", "D"), f"{273.15:25.16E}".replace("E", "D")]
    return block([f"{164:6d}", code, *factors])


def nodes_block(channels: Iterable[Channel], source: str) -> bytes:
    """Dataset 2411 with the places of the channels that have any; empty where none has.

    Raises:
        MeasurementError: A node that is given two places.
    """
    places: dict[int, tuple[float, float, float]] = {}
    for channel in channels:
        if channel.coordinate is None:
            continue
        if places.setdefault(channel.node, channel.coordinate) != channel.coordinate:
            raise MeasurementError(
                f"{source or 'Measurement'}: expected one place for node {channel.node}, got "
                f"{places[channel.node]} and {channel.coordinate}. Give the two channels nodes of their own."
            )
    lines = [f"{2411:6d}"]
    for node, place in sorted(places.items()):
        lines += [f"{node:10d}{0:10d}{0:10d}{11:10d}", "".join(f"{x:25.16E}" for x in place).replace("E", "D")]
    return block(lines) if places else b""


class _Header(NamedTuple):
    measurement: Measurement
    spacing: tuple[str, str] | None  # first line and step as written; None where the spacing is uneven
    binary: bool


def _function(frequency: np.ndarray, value: np.ndarray, ends: tuple[Channel, Channel], header: _Header) -> bytes:
    measurement, even = header.measurement, header.spacing is not None
    is_frf = np.iscomplexobj(value)
    columns = [value.real, value.imag] if is_frf else [value]
    table = np.stack(columns if even else [frequency, *columns], axis=1)
    kind = measurement.kind
    if is_frf:
        motion = MOTION_OF_KIND.get(kind, "acceleration")
        sides = (motion, motion if kind == "transmissibility" else "force")
        quantities = [_quantity(SPECIFIER[side], side.capitalize(), SI_LABEL[side]) for side in sides]
        function_type = 5 if kind == "transmissibility" else 4
    else:
        quantities = [_quantity(0, "NONE", "NONE")] * 2
        function_type = 6
    first, step = header.spacing or (_number(0.0), _number(0.0))
    identity = f"{58:6d}"
    if header.binary:
        identity += f"b{1:6d}{2:6d}{11:12d}{table.size * 8:12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    response, reference = (_end(channel, measurement) for channel in ends)
    lines = [
        identity,
        (kind + windowed(measurement.window)) if is_frf else "coherence",
        *["NONE"] * 4,
        f"{function_type:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10s}{response} {'NONE':<10s}{reference}",
        f"{6 if is_frf else 4:10d}{len(frequency):10d}{int(even):10d}{first}{step}{_number(0.0)}",
        _quantity(18, "Frequency", "Hz"),
        *quantities,
        _quantity(0, "NONE", "NONE"),
    ]
    return block(lines, table.astype("<f8").tobytes() if header.binary else _text(table, even))


def windowed(rate: float) -> str:
    """What stands in the first line of a dataset 58 of an exponential window's rate [1/s]; `uff.WINDOW` finds it."""
    return f", exponential window of {rate:.9g} 1/s" if rate > 0 else ""


def _quantity(specifier: int, name: str, unit: str) -> str:
    return f"{specifier:10d}{0:5d}{0:5d}{0:5d} {name:<20s} {unit:<20s}"


def _end(channel: Channel, measurement: Measurement) -> str:
    if channel.direction not in DIRECTION_NUMBER:
        raise MeasurementError(
            f"{measurement.source or 'Measurement'}: expected a direction out of {', '.join(DIRECTION_NUMBER)}, got "
            f"{channel.direction!r} at node {channel.node}. Name one of these."
        )
    return f"{channel.node:10d}{DIRECTION_NUMBER[channel.direction]:4d}"


def _number(value: float) -> str:
    """Fill the format's 13 columns with all the digits they hold: E13.5 reads "440.48828125" as well."""
    fitting = [f"{value:.{digits}g}" for digits in range(17, 5, -1)]
    short = next(text for text in fitting if len(text) < SINGLE_WIDTH)
    mantissa, mark, exponent = short.partition("e")
    # Without a point Fortran would place one five digits from the right.
    return f"{mantissa if '.' in mantissa else mantissa + '.'}{mark}{exponent}".rjust(SINGLE_WIDTH)


def _text(table: np.ndarray, even: bool) -> bytes:
    ordinate = [f"{x:{DOUBLE_WIDTH}.12E}" for x in (table if even else table[:, 1:]).reshape(-1)]
    if even:
        return _lines(ordinate, 4)
    n_part = table.shape[1] - 1
    cells: list[str] = []
    for i, x in enumerate(table[:, 0].tolist()):
        cells += [_number(x), *ordinate[i * n_part : (i + 1) * n_part]]
    return _lines(cells, 3 if n_part == 2 else 4)


def _lines(cells: list[str], n_column: int) -> bytes:
    rows = ("".join(cells[i : i + n_column]) for i in range(0, len(cells), n_column))
    return "".join(f"{row}\n" for row in rows).encode()
