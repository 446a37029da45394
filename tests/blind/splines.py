"""B-splines of degree 5 on 0 to 1 and their one-dimensional integrals, by Gauss quadrature on every span.

Source: Cottrell, Hughes, Bazilevs, Isogeometric Analysis (2009), chapters 2 and 5.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BSpline

DEGREE = 5
# Exact for two splines times a cubic: degree 13 takes 7 points.
N_GAUSS = 9
# Breaks nearer than this are one.
SAME = 1e-9

Weight = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Splines:
    """All splines on a knot vector over 0 to 1.

    Args:
        n_span: spans of equal length, before the breaks are put in.
        breaks: place → continuity there: 0 where the slope may jump, 1 where the curvature may, 2, 3 likewise.
    """

    n_span: int
    breaks: Mapping[float, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        inner = {x: round(c) for x, c in self.breaks.items() if SAME < x < 1 - SAME}
        # An even knot next to a break makes a sliver that brings nothing.
        even = [
            x for x in np.linspace(0, 1, self.n_span + 1)[1:-1] if all(abs(x - b) > 0.3 / self.n_span for b in inner)
        ]
        knots = sorted([*even, *(x for x, c in inner.items() for _ in range(DEGREE - c))])
        whole = np.array([0.0] * (DEGREE + 1) + knots + [1.0] * (DEGREE + 1))
        object.__setattr__(self, "knots", whole)
        object.__setattr__(self, "size", len(whole) - DEGREE - 1)
        object.__setattr__(self, "_all", BSpline(whole, np.eye(self.size), DEGREE))

    knots: np.ndarray = field(init=False)
    size: int = field(init=False)
    _all: BSpline = field(init=False)

    def at(self, place: np.ndarray | float, order: int = 0) -> np.ndarray:
        """All splines at places [..., size], or a derivative; at a C0 break the value from the right."""
        place = np.asarray(place, float)
        return self._all(np.clip(place, 0.0, 1.0), nu=order)

    def left_of(self, place: float, order: int) -> np.ndarray:
        """The same from the left."""
        return self.at(place - 1e-12, order)

    def integral(
        self, order: int, other: int, interval: tuple[float, float] = (0.0, 1.0), weight: Weight | None = None
    ) -> np.ndarray:
        """∫ weight(t) N_i^(order) N_j^(other) dt over an interval whose ends are breaks [size, size]."""
        low, high = max(interval[0], 0.0), min(interval[1], 1.0)
        ends = np.unique(np.concatenate([[low, high], self.knots[(self.knots > low) & (self.knots < high)]]))
        point, gauss = np.polynomial.legendre.leggauss(N_GAUSS)
        length = np.diff(ends)[:, None]
        place = (ends[:-1, None] + length * (point + 1) / 2).ravel()
        factor = (length * gauss / 2).ravel()
        if weight is not None:
            factor = factor * weight(place)
        return (self.at(place, order) * factor[:, None]).T @ self.at(place, other)
