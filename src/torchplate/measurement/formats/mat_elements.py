"""The elements of a MAT file of version 5, walked before SciPy reads it: it crashes on types that the format has not.

Source: MathWorks, MAT-File Format, level 5: a tag of type and length, the data, padded to 8 bytes; short data in the
tag itself; a compressed element holds one other.
"""

import struct
import zlib
from typing import Final

HEAD: Final = 128
MATRIX, COMPRESSED = 14, 15
NUMBERS: Final = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18})
"""Integers, floats and text of each width."""
DEEPEST: Final = 30
ROOM: Final = 2**30
"""Bytes that a compressed element may grow to."""


def check_elements(content: bytes) -> None:
    """Walk all elements of a file.

    Raises:
        ValueError: A type that the format has not, a length beyond its place, or data that do not decompress.
    """
    order = ">" if content[126:128] == b"MI" else "<"
    _walk(content, HEAD, len(content), order, frozenset({MATRIX, COMPRESSED}), 0)


def _walk(content: bytes, start: int, end: int, order: str, allowed: frozenset[int], depth: int) -> None:
    if depth > DEEPEST:
        raise ValueError("arrays nested without end")
    while start < end:
        if end - start < 8:
            raise ValueError("an element without a tag")
        kind, length = struct.unpack_from(f"{order}II", content, start)
        data, after = start + 8, start + 8 + length
        if kind >> 16:
            kind, length = kind & 0xFFFF, kind >> 16
            data, after = start + 4, start + 8
            if length > 4:
                raise ValueError(f"{length} bytes in a short element")
        if kind not in allowed:
            raise ValueError(f"an element of type {kind}")
        if data + length > end:
            raise ValueError("an element that is longer than its place")
        if kind == COMPRESSED:
            inner = zlib.decompressobj()
            whole = inner.decompress(content[data : data + length], ROOM)
            if inner.unconsumed_tail:
                raise ValueError("a compressed element without end")
            _walk(whole, 0, len(whole), order, frozenset({MATRIX}), depth + 1)
        elif kind == MATRIX:
            _walk(content, data, data + length, order, NUMBERS | {MATRIX}, depth + 1)
        # Elements are padded from their own beginning; those that are compressed are not.
        start = after if kind == COMPRESSED else after + -(after - start) % 8
