"""Direct solves with sparse matrices of a plate, by SuperLU through scipy, and what is made of them.

A matrix may be bordered by further unknowns, and lack something of low rank and dense.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

# From columns to the inverse of a matrix times these.
Solve: TypeAlias = Callable[[np.ndarray], np.ndarray]
# An ordering for symmetric patterns, and no pivots: half the fill of SuperLU's default.
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}
# What a solve without pivots may leave over, relative to ‖Z‖ ‖x‖: hundreds of times rounding. Else pivots are sought.
BACKWARD = 1e-13


def factor(matrix: scipy.sparse.csc_array) -> Any:
    """Factors of a symmetric matrix, without pivots: right where it is positive definite."""
    return scipy.sparse.linalg.splu(matrix, **SYMMETRIC)


def solver(matrix: scipy.sparse.csc_array) -> Solve:
    """Solves with a complex symmetric matrix: without pivots where what that leaves over is as small as with them."""
    factors = factor(matrix)
    norm = scipy.sparse.linalg.norm(matrix, 1)

    def solve(right: np.ndarray) -> np.ndarray:
        found: np.ndarray = factors.solve(right)
        if np.linalg.norm(matrix @ found - right) <= BACKWARD * norm * np.linalg.norm(found):
            return found
        again: np.ndarray = scipy.sparse.linalg.splu(matrix).solve(right)
        return again

    return solve


def cut(solve: Solve, size: int, whole: int) -> Solve:
    """A solve with a bordered matrix of some size as one over the first unknowns."""
    if size == whole:
        return solve

    def found(right: np.ndarray) -> np.ndarray:
        return solve(np.concatenate([right, np.zeros((whole - size, *right.shape[1:]), right.dtype)]))[:size]

    return found


def with_low_rank(solve: Solve, more: tuple[np.ndarray, np.ndarray] | None) -> Solve:
    """A solve with A made one with A + Uᵀ B U (Woodbury, 1950); B need not have an inverse."""
    if more is None:
        return solve
    rows, middle = more
    columns = solve(np.ascontiguousarray(rows.T).astype(middle.dtype))
    small = np.linalg.solve(np.eye(len(rows)) + middle @ (rows @ columns), middle)

    def corrected(right: np.ndarray) -> np.ndarray:
        moved: np.ndarray = solve(right)
        return moved - columns @ (small @ (rows @ moved))

    return corrected
