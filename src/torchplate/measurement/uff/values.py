"""The values of a dataset 58, record 12, in the format's eight cases, ASCII and binary.

pyuff reads the headers well, but of the values it drops nothing that pads the last record, reads no Fortran
D exponents, and takes every binary number for double precision where the format stores an uneven abscissa in
single. So the values are read here, by the format's own columns.

Source: Universal File Format, datasets 58 and 58b, University of Cincinnati SDRL.
"""

from typing import Final

import numpy as np
from jaxtyping import Complex, Float

# Ordinate data type: (is complex, bytes of one number)
ORDINATE: Final = {2: (False, 4), 4: (False, 8), 5: (True, 4), 6: (True, 8)}
SINGLE_WIDTH, DOUBLE_WIDTH = 13, 20


class ValuesError(ValueError):
    """The values do not follow their header; the message says how, the caller names file and record."""


def decode(
    body: bytes, *, ordinate_type: int, n_point: int, even: bool, byte_order: int | None
) -> tuple[Float[np.ndarray, " n"] | None, Complex[np.ndarray, " n"]]:
    """Read the abscissa (None where the spacing is even) and the ordinate.

    Args:
        body: What follows the header's last line up to the closing -1.
        ordinate_type: 2 real single, 4 real double, 5 complex single, 6 complex double.
        n_point: Number of values, or of pairs where the spacing is uneven.
        even: True where the file stores no abscissa.
        byte_order: 1 little endian, 2 big endian, None for ASCII.

    Raises:
        ValuesError: An unknown type, fewer values than the header says, text that is no number.
    """
    if ordinate_type not in ORDINATE:
        raise ValuesError(f"ordinate data type {ordinate_type}, where the format knows 2, 4, 5 and 6")
    is_complex, size = ORDINATE[ordinate_type]
    if byte_order is None:
        abscissa, parts = _ascii(body, is_complex, size, n_point, even)
    else:
        abscissa, parts = _binary(body, is_complex, size, n_point, even, "<" if byte_order == 1 else ">")
    ordinate = parts[:, 0] + 1j * parts[:, 1] if is_complex else parts[:, 0].astype(np.complex128)
    return abscissa, ordinate


def _ascii(body: bytes, is_complex: bool, size: int, n_point: int, even: bool) -> tuple[np.ndarray | None, np.ndarray]:
    width = SINGLE_WIDTH if size == 4 else DOUBLE_WIDTH
    n_part = 2 if is_complex else 1
    point = ([] if even else [SINGLE_WIDTH]) + [width] * n_part
    stops = np.cumsum(_line_widths(point, single=size == 4)).tolist()
    starts = [0, *stops[:-1]]
    values: list[float] = []
    for line in body.decode("ascii", errors="replace").splitlines():
        for start, stop in zip(starts, stops, strict=True):
            text = line[start:stop].strip()
            if text:
                try:
                    values.append(float(text.upper().replace("D", "E")))
                except ValueError:
                    raise ValuesError(f"{text!r} in columns {start + 1} to {stop}, where a number belongs") from None
    n_needed = n_point * len(point)
    if len(values) < n_needed:
        raise ValuesError(f"{len(values)} numbers, where its header promises {n_needed}")
    table = np.array(values[:n_needed], dtype=np.float64).reshape(n_point, len(point))
    return (None, table) if even else (table[:, 0], table[:, 1:])


def _line_widths(point: list[int], *, single: bool) -> list[int]:
    if single:
        return [SINGLE_WIDTH] * 6
    if len(point) == 1 or point == [DOUBLE_WIDTH] * 2:
        return [DOUBLE_WIDTH] * 4
    return point * 2 if len(point) == 2 else point


def _binary(
    body: bytes, is_complex: bool, size: int, n_point: int, even: bool, order: str
) -> tuple[np.ndarray | None, np.ndarray]:
    n_part = 2 if is_complex else 1
    # By the format an uneven abscissa is single precision beside any ordinate; pyuff and others write it in the
    # ordinate's own precision. The number of bytes tells which.
    layouts = [0] if even else [size, 4]
    for abscissa_size in layouts:
        length = n_point * (abscissa_size + n_part * size)
        if len(body) >= length:
            fields = [("ordinate", f"{order}f{size}", (n_part,))]
            head = [("abscissa", f"{order}f{abscissa_size}", (1,))] if abscissa_size else []
            table = np.frombuffer(body[:length], dtype=np.dtype(head + fields))
            parts = table["ordinate"].astype(np.float64)
            return (table["abscissa"][:, 0].astype(np.float64) if abscissa_size else None), parts
    raise ValuesError(f"{len(body)} bytes, where its header promises at least {length}")
