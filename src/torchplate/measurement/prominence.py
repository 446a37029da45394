"""Peaks of a row of numbers that stand out. `scipy.signal` finds the same and takes half a second to import."""

import numpy as np
from jaxtyping import Float, Int


def prominent(values: Float[np.ndarray, " n"], least: float) -> Int[np.ndarray, " n_peak"]:
    """Places of the peaks that stand out by so much over the higher of their two flanking valleys.

    A valley reaches to the next number that is higher than the peak, or to the end of the row. A level top is one peak,
    in its middle.

    Args:
        values: in their order.
        least: in their unit, > 0.
    """
    if len(values) < 3:
        return np.zeros(0, dtype=np.int64)
    # Where the row changes: the first and last place of each stretch of one value.
    starts = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    ends = np.concatenate([starts[1:], [len(values)]]) - 1
    level = values[starts]
    found = []
    for turn in range(1, len(level) - 1):
        top = level[turn]
        if not (level[turn - 1] < top > level[turn + 1]):
            continue
        higher = np.flatnonzero(~(level <= top))
        before, after = higher[higher < turn], higher[higher > turn]
        left = level[before[-1] + 1 if len(before) else 0 : turn].min()
        right = level[turn + 1 : after[0] if len(after) else len(level)].min()
        if top - max(left, right) >= least:
            found.append((starts[turn] + ends[turn]) // 2)
    return np.array(found, dtype=np.int64)
