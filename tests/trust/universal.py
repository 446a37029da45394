"""Universal files with the datasets that torchplate does not write, for `fuzzing.py` to change."""

from collections.abc import Iterable

import numpy as np


def geometry_and_modes() -> bytes:
    """Units, coordinate systems both ways, nodes in them, trace lines, elements, and modes: one normal, one complex."""
    places = [
        (4, 5, 0, 0.1, 0.2, 0.0),
        (9, 0, 7, 0.25, 0.5, 0.0),
        (11, 6, 0, 0.3, 90.0, 0.1),
        (12, 0, 0, 0.4, 0.3, 0.0),
    ]
    nodes = [line for one in places for line in (_whole(*one[:3], 11), _reals(one[3:], 25, 16))]
    shape = [line for one in places for line in (_whole(one[0]), _reals((0.0, 0.0, 0.1 * one[0]), 13))]
    bent = [line for one in places for line in (_whole(one[0]), _reals((0, 0, 0, 0, 0.1 * one[0], 0.02), 13))]
    return b"".join(
        _dataset(kind, lines)
        for kind, lines in (
            (151, ["plate", "of two makers", "program", *["NONE"] * 4]),
            (164, [f"{9:10d}{'own':20s}{2:10d}", _reals((1000.0, 1.0, 1.0), 25, 16), _reals((0.0,), 25, 16)]),
            (18, [_whole(7, 0, 0, 8, 1), "SYS7", _reals((1.0, 2.0, 0.5, 1.0, 3.0, 0.5), 13), _reals((0, 2, 0.5), 13)]),
            (2420, [_whole(1), "a part", *_matrix(5, 0), *_matrix(6, 1)]),
            (2411, nodes),
            (82, [_whole(1, 5, 3), "outline", _whole(4, 9, 0, 11, 12)]),
            (2412, [_whole(1, 94, 1, 1, 7, 4), _whole(4, 9, 11, 12)]),
            (2414, [*_head(2, 2), _reals((0, 41.237, 0, 1, 0.0031, 0), 13), _reals([0] * 6, 13), *shape]),
            (2414, [*_head(3, 5), _reals([0] * 6, 13), _reals((-0.8, 590.0, 0, 0, 0, 0), 13), *bent]),
        )
    )  # fmt: skip


def hits() -> bytes:
    """Time records of a hit: the force at node 9, and the accelerations at nodes 4 and 12."""
    time = np.arange(64)
    force, motion = np.exp(-0.5 * (time - 12.0) ** 2), np.where(time > 10, np.sin(0.7 * time), 0.0)
    records = ((9, 13, "N", force), (4, 12, "m/s2", motion), (12, 12, "m/s2", -0.5 * motion))
    nodes = [f"{node:10d}{0:10d}{0:10d}{8:10d}{_reals((x, y, 0), 13)}" for node, x, y in ((4, 0, 0), (9, 0.4, 0.3))]
    return b"".join([_dataset(15, nodes), *(_dataset(58, _record(*one)) for one in records)])


def _record(node: int, quantity: int, unit: str, values: np.ndarray) -> list[str]:
    def axis(specifier: int, label: str) -> str:
        return f"{specifier:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {label:20s}"

    head = ["a hit", "NONE", "21-NOV-26 07:32:11", "NONE", "NONE"]
    channel = f"{1:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{node:10d}{3:4d} {'NONE':10s}{9:10d}{3:4d}"
    even = f"{2:10d}{len(values):10d}{1:10d}{0.0:13.5E}{1 / 512:13.5E}{0.0:13.5E}"
    axes = [axis(17, "s"), axis(quantity, unit), axis(0, "NONE"), axis(0, "NONE")]
    return [*head, channel, even, *axes, *(_reals(some, 13) for some in np.array_split(values, 11))]


def _head(analysis: int, of_data: int) -> list[str]:
    """Of a dataset 2414, its first eleven records: modes at nodes, three translations each."""
    what = _whole(1, analysis, 2, 8, of_data, 3)
    return [_whole(1), "mode", _whole(1), *["NONE"] * 5, what, _whole(*[0] * 8), _whole(0, 0)]


def _matrix(number: int, kind: int) -> list[str]:
    """Of a dataset 2420, one system: x is the global z, y the global x."""
    rows = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.1, 0.2, 0.3))
    return [_whole(number, kind, 8), f"CS{number}", *(_reals(row, 25, 16) for row in rows)]


def _whole(*values: int) -> str:
    return "".join(f"{value:10d}" for value in values)


def _reals(values: Iterable[float], width: int, digits: int = 5) -> str:
    return "".join(f"{value:{width}.{digits}E}" for value in values)


def _dataset(kind: int, lines: list[str]) -> bytes:
    return "\n".join(["    -1", f"{kind:6d}", *lines, "    -1\n"]).encode()
