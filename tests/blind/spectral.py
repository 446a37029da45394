"""A second truth: the same plates by C1 elements of high degree, with whole integrals in the plane.

w(x, y) = Σ q_ij f_i(x) g_j(y): cubic Hermite functions at a few element ends (the sides and wherever rigidity or a
heavy point asks for one) and, within each element, twice integrated Legendre polynomials up to degree 22. The
integrals are taken point by point over the plate, with the thickness and the modulus at that point. Nothing of
`splines` or of the sums of `ritz` is in it; only the description of a plate is common to both.

It knows free edges, patches, tapers, wander, points and edge springs: no clamp, hinge, residual stress or curvature.

Source: Szabó and Babuška, Finite Element Analysis (1991), chapter 3, for the hierarchic functions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from blind.ritz import GRADED, LIGHT, RitzPlate, add_air, lost, thickness_at, wander

# Degree of an element of length ℓ, relative to the side: enough for some six half waves along the side, to 1e-6.
DEGREE = 4.0
DEGREE_PER_LENGTH = 18.0
# Element ends nearer than this are one.
SAME = 1e-6


@dataclass(frozen=True)
class Line:
    """All functions along one side, relative to its length."""

    ends: tuple[float, ...]

    @property
    def degrees(self) -> list[int]:
        """Of each element."""
        return [max(5, int(DEGREE + ceil(DEGREE_PER_LENGTH * length))) for length in np.diff(self.ends)]

    @property
    def size(self) -> int:
        """How many functions there are."""
        return 2 * len(self.ends) + sum(degree - 3 for degree in self.degrees)

    def at(self, place: np.ndarray, order: int = 0) -> np.ndarray:
        """All functions or a derivative at places [n, size]."""
        place = np.asarray(place, float).clip(0.0, 1.0)
        element = np.clip(np.searchsorted(self.ends, place, side="right") - 1, 0, len(self.ends) - 2)
        found = np.zeros((len(place), self.size))
        first = 2 * len(self.ends)
        for index, degree in enumerate(self.degrees):
            own = element == index
            low, length = self.ends[index], self.ends[index + 1] - self.ends[index]
            values = [f.deriv(order)(2 * (place[own] - low) / length - 1) for f in _functions(degree)]
            columns = [2 * index, 2 * index + 1, 2 * index + 2, 2 * index + 3, *range(first, first + degree - 3)]
            # Slopes over the side, not over the element.
            scale = np.array([1.0, length / 2, 1.0, length / 2, *[1.0] * (degree - 3)]) * (2 / length) ** order
            found[np.ix_(own, columns)] = np.stack(values, axis=1) * scale
            first += degree - 3
        return found

    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss points and weights, element by element."""
        place, weight = [], []
        for low, high, degree in zip(self.ends[:-1], self.ends[1:], self.degrees, strict=True):
            point, gauss = np.polynomial.legendre.leggauss(degree + 3)
            place.append(low + (high - low) * (point + 1) / 2)
            weight.append((high - low) * gauss / 2)
        return np.concatenate(place), np.concatenate(weight)


def _functions(degree: int) -> list[np.polynomial.Polynomial | np.polynomial.Legendre]:
    """On −1 to 1: value and slope at either end, then those that vanish there with their slopes."""
    hermite = [
        np.polynomial.Polynomial(c)
        for c in ([0.5, -0.75, 0, 0.25], [0.25, -0.25, -0.25, 0.25], [0.5, 0.75, 0, -0.25], [-0.25, -0.25, 0.25, 0.25])
    ]
    # ∫∫ P_k vanishes at both ends for k ≥ 2, as P_k has no part of 1 and of ξ.
    inner = [np.polynomial.Legendre.basis(k).integ(2, lbnd=-1) * sqrt(k) for k in range(2, degree - 1)]
    return [*hermite, *inner]


class SpectralMatrices(NamedTuple):
    """As `ritz.Matrices`."""

    mass: np.ndarray
    stiffness: np.ndarray
    hysteretic: np.ndarray | None
    x: Line
    y: Line

    def rows(self, place: Sequence[Sequence[float]]) -> np.ndarray:
        """Deflection at relative places over the coefficients [n_place, n]."""
        x, y = np.asarray(place, float).reshape(-1, 2).T
        return (self.x.at(x)[:, :, None] * self.y.at(y)[:, None, :]).reshape(len(x), -1)


def matrices(plate: RitzPlate) -> SpectralMatrices:
    """Mass and stiffness.

    Raises:
        NotImplementedError: for what this truth does not know.
    """
    if plate.edges or plate.stress or any(plate.curvature) or plate.hinge is not None:
        raise NotImplementedError("Clamps, residual stress, curvature and hinges: take the Ritz truth.")
    x, y = (Line(_ends(plate, along)) for along in (0, 1))
    (at_x, weight_x), (at_y, weight_y) = x.quadrature(), y.quadrature()
    lx, ly = plate.sides
    here_x, here_y = at_x[:, None], at_y[None, :]
    thick = thickness_at(plate, here_x, here_y)
    area = weight_x[:, None] * weight_y[None, :] * lx * ly
    bending = area * thick**3 * (1 + wander(plate.modulus_wander, here_x, here_y))
    factor, loss = np.ones_like(bending), np.zeros_like(bending)
    for patch in plate.patches:
        (x0, x1), (y0, y1) = plate.covered(patch)
        under = ((here_x > x0) & (here_x < x1) & (here_y > y0) & (here_y < y1)).astype(float)
        factor += (patch.factor - 1) * under
        loss += patch.loss_factor * under
    f, g = ([own.at(at, order) for order in range(3)] for own, at in ((x, at_x), (y, at_y)))
    curved = [np.kron(f[2], g[0]) / lx**2, np.kron(f[0], g[2]) / ly**2, np.kron(f[1], g[1]) / (lx * ly)]
    plain = np.kron(f[0], g[0])

    def energy(over: np.ndarray, plate: RitzPlate = plate) -> np.ndarray:
        """∫ over κᵀ D κ, κ = (w,xx, w,yy, 2 w,xy)."""
        mean = plate.young * plate.thickness**3 / 12
        plane, root = mean / (1 - plate.poisson**2), sqrt(plate.young_ratio)
        shear = plate.shear_factor * mean / (2 * (1 + plate.poisson))
        w = over.ravel()[:, None]
        along_x = plane / root * curved[0] + plane * plate.poisson * curved[1]
        along_y = plane * plate.poisson * curved[0] + plane * root * curved[1]
        total = curved[0].T @ (w * along_x) + curved[1].T @ (w * along_y)
        return total + 4 * shear * (curved[2].T @ (w * curved[2]))

    stiffness = energy(bending * factor)
    areal = plate.density * plate.thickness * (area * thick).ravel()
    mass = plain.T @ (areal[:, None] * plain)
    lossy = energy(bending * loss) if loss.any() else None
    if any(plate.loss):
        whole = lost(plate, lambda part: energy(bending, part))
        lossy = whole if lossy is None else lossy + whole
    stiffness += _edges(plate, x, y)
    found = SpectralMatrices(mass, stiffness, lossy, x, y)
    for matrix, terms in ((mass, plate.masses), (stiffness, plate.springs)):
        for place_x, place_y, coefficient in terms:
            row = found.rows([(place_x, place_y)])[0]
            matrix += coefficient * np.outer(row, row)
    add_air(plate, found)
    return found


def _ends(plate: RitzPlate, along: int) -> tuple[float, ...]:
    """Element ends: the sides, the edges of patches, and heavy points, where w has r² log r."""
    found = [0.0, 1.0]
    heavy = [*(t for t in plate.masses if t[2] > LIGHT * plate.mass), *(t for t in plate.springs if t[2] > 3e3)]
    wanted = [end for patch in plate.patches for end in plate.covered(patch)[along]]
    wanted += [t[along] for t in (*heavy, *(t for t in plate.dashpots if t[2] > 1))]
    # A small element on either side: what gives under a force is then right to 1e-4.
    wanted += [place[along] + offset for place in plate.loaded for offset in (-GRADED[1], 0.0, GRADED[1])]
    for end in wanted:
        if SAME < end < 1 - SAME and min(abs(end - other) for other in found) > SAME:
            found.append(end)
    return tuple(sorted(found))


def _edges(plate: RitzPlate, x: Line, y: Line) -> np.ndarray:
    """∫ (k w² + κ w,n²) ds."""
    total = np.zeros((x.size * y.size,) * 2)
    for edge, spring, rotational in plate.edge_springs:
        across_x, end = edge[0] == "x", np.array([float(edge[1])])
        across, along = (x, y) if across_x else (y, x)
        side = plate.sides[0 if across_x else 1]
        length = plate.length_y if across_x else plate.length_x
        at, weight = along.quadrature()
        rows = along.at(at)
        for order, coefficient in ((0, spring), (1, rotational / side**2)):
            value = across.at(end, order)
            pair = (value, rows) if across_x else (rows, value)
            over = np.kron(*pair)
            total += coefficient * length * (over.T @ (weight[:, None] * over))
    return total
