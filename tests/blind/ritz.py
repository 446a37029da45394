"""The truth: free, held or sprung Kirchhoff plates by an isogeometric Ritz method.

w(x, y) = Σ q_ij N_i(x/Lx) N_j(y/Ly) with splines of degree 5, C4 within the plate, C1 where the rigidity jumps and C0
at a hinge. Every integral is a sum of products of one-dimensional ones, so every matrix is a sum of Kronecker products.
Nothing here is shared with torchplate. Energy: U = ½ ∫ κᵀ D κ, κ = (w,xx, w,yy, 2w,xy).

Source: Leissa, The free vibration of rectangular plates, J. Sound Vib. 31 (1973) 257, for values to hold it against;
Lekhnitskii, Anisotropic Plates (1968), for the orthotropic D; Leissa, Vibration of Shells, NASA SP-288, for the shallow
shell.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import comb, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.linalg

from blind.air import added_mass
from blind.splines import Splines

if TYPE_CHECKING:
    from blind.spectral import SpectralMatrices

Interval = tuple[float, float]
WHOLE: Interval = (0.0, 1.0)
# Spans a side, even ones: FRFs up to 400 Hz to 3e-4 at the least damping of the suite, breaks as below.
N_SPAN = 14
# Knots on either side of a patch's edge, relative to the plate: its corners are singular, weakly.
GRADED = (0.005, 0.02)
# Plates whose modes are kept.
N_KEPT = 4
# A mass below this share of the plate bends it so little that its r² log r needs no spans of its own.
LIGHT = 0.0025
# Smooth fields of unit mean square over the plate: cos(iπx) cos(jπy), scaled. A plate wanders along the first five;
# whoever looks for an effect does not know that the others are not there.
WANDER = ((1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
N_WANDER = 5
# Step of a difference, relative: its square and rounding over it are both 1e-8.
LOST_STEP = 1e-4
Weight = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Patch:
    """A rectangle of area (size · √(Lx Ly))² [m²] with its centre at a relative place; a square at aspect 1."""

    x: float
    y: float
    size: float
    factor: float = 1.0  # rigidity there over the sound one [-]
    loss_factor: float = 0.0  # beyond the plate's [-]
    aspect: float = 1.0  # its side along x over that along y [-]


@dataclass(frozen=True)
class RitzPlate:
    """Everything that makes a plate and its supports; places are relative, 0 to 1.

    Args:
        length_x: nominal side [m]; the real one is length_x / √aspect_ratio.
        length_y: nominal side [m]; the real one is length_y √aspect_ratio.
        young: √(Ex Ey) [Pa].
        poisson: √(νx νy) [-].
        density: [kg/m³].
        thickness: at the middle of the plate [m].
        young_ratio: Ey/Ex [-].
        shear_factor: G over E / (2 (1 + ν)) [-].
        taper: slopes of h(x, y)/h over x and y [-].
        masses: (x, y, kg).
        springs: (x, y, N/m).
        dashpots: (x, y, N s/m).
        edges: clamped or simply_supported for x0, x1, y0, y1.
        edge_springs: (edge, N/m², N/rad) per nominal length of edge.
        stress: amplitude P of the Airy function P 256 (x(1-x) y(1-y))² of a residual stress [N m].
        curvature: of a shallow shell, 1/R along x and y [1/m].
        hinge: (place along x, N/rad per length), or None.
        thickness_wander: how far h(x, y) is off its mean along each of `WANDER`, relative [-].
        modulus_wander: likewise of E(x, y).
        loss: beyond the common one, of E_x, E_y and G [-].
        air: density of the air on both sides [kg/m³].
        loaded: places under which the functions are fine, as something heavy is to sit there (x, y).
        by: which discretisation finds the modes: "ritz" or "spectral".
    """

    length_x: float
    length_y: float
    young: float
    poisson: float
    density: float
    thickness: float
    aspect_ratio: float = 1.0
    young_ratio: float = 1.0
    shear_factor: float = 1.0
    taper: tuple[float, float] = (0.0, 0.0)
    patches: Sequence[Patch] = ()
    masses: Sequence[tuple[float, float, float]] = ()
    springs: Sequence[tuple[float, float, float]] = ()
    dashpots: Sequence[tuple[float, float, float]] = ()
    edges: Mapping[str, str] = field(default_factory=dict)
    edge_springs: Sequence[tuple[str, float, float]] = ()
    stress: float = 0.0
    curvature: tuple[float, float] = (0.0, 0.0)
    hinge: tuple[float, float] | None = None
    thickness_wander: tuple[float, ...] = ()
    modulus_wander: tuple[float, ...] = ()
    loss: tuple[float, float, float] = (0.0, 0.0, 0.0)
    air: float = 0.0
    loaded: tuple[tuple[float, float], ...] = ()
    by: str = "ritz"

    @property
    def mass(self) -> float:
        """Of the bare plate [kg]."""
        return self.density * self.thickness * self.length_x * self.length_y

    @property
    def sides(self) -> tuple[float, float]:
        """The real sides [m]."""
        return self.length_x / sqrt(self.aspect_ratio), self.length_y * sqrt(self.aspect_ratio)

    def covered(self, patch: Patch) -> tuple[Interval, Interval]:
        """The part of the plate under a patch; the nominal sides say what is square."""
        stretch = sqrt(self.length_y / self.length_x)
        long = sqrt(patch.aspect)
        half_x, half_y = patch.size * stretch * long / 2, patch.size / stretch / long / 2
        return (
            (max(patch.x - half_x, 0.0), min(patch.x + half_x, 1.0)),
            (max(patch.y - half_y, 0.0), min(patch.y + half_y, 1.0)),
        )


class Matrices(NamedTuple):
    """Mass [kg], stiffness with springs [N/m], the stiffness of patches times their loss factors, and the splines."""

    mass: np.ndarray
    stiffness: np.ndarray
    hysteretic: np.ndarray | None
    x: Splines
    y: Splines
    kept: np.ndarray  # which products of splines no edge holds

    def rows(self, place: Sequence[Sequence[float]]) -> np.ndarray:
        """Deflection at relative places over the coefficients [n_place, n]."""
        x, y = np.asarray(place, float).reshape(-1, 2).T
        return (self.x.at(x)[:, :, None] * self.y.at(y)[:, None, :]).reshape(len(x), -1)[:, self.kept]


class Modes(NamedTuple):
    """Undamped modes: ω² [rad²/s²], coefficients of mass-normalised shapes, and the matrices they belong to."""

    eigenvalue: np.ndarray
    shape: np.ndarray
    matrices: "Matrices | SpectralMatrices"

    @property
    def frequency(self) -> np.ndarray:
        """Natural frequencies [Hz]."""
        return np.sqrt(self.eigenvalue.clip(0.0)) / (2 * np.pi)

    def deflection(self, place: Sequence[Sequence[float]]) -> np.ndarray:
        """Modal deflection at places [n_place, n_mode] [1/√kg]."""
        return self.matrices.rows(place) @ self.shape


_KEPT: dict[str, Modes] = {}


def modes(plate: RitzPlate, n_span: int = N_SPAN) -> Modes:
    """All modes of a plate; those of the last few plates are kept."""
    key = f"{plate} {n_span}"
    if key not in _KEPT:
        while len(_KEPT) >= N_KEPT:
            del _KEPT[next(iter(_KEPT))]
        _KEPT[key] = _solve(plate, n_span)
    return _KEPT[key]


def _solve(plate: RitzPlate, n_span: int) -> Modes:
    found = matrices_of(plate, n_span)
    # A mass-normalised basis: splines at an edge weigh little.
    scale = 1 / np.sqrt(np.diag(found.mass))
    value, shape = scipy.linalg.eigh(
        found.stiffness * scale * scale[:, None], found.mass * scale * scale[:, None], check_finite=False
    )
    return Modes(value, shape * scale[:, None], found)


def matrices_of(plate: RitzPlate, n_span: int = N_SPAN) -> "Matrices | SpectralMatrices":
    """Mass and stiffness by the discretisation that the plate asks for; one with a shape of its own brings them."""
    own = getattr(plate, "own_matrices", None)
    if own is not None:
        return own(n_span)
    if plate.by == "ritz":
        return matrices(plate, n_span)
    from blind.spectral import matrices as spectral

    return spectral(plate)


def matrices(plate: RitzPlate, n_span: int = N_SPAN) -> Matrices:
    """Mass and stiffness over the products of splines."""
    x, y = (Splines(n_span, breaks) for breaks in _breaks(plate, n_span))
    kept = _kept(plate, x, y)
    stiffness = _bending(plate, x, y, WHOLE, WHOLE)
    hysteretic = np.zeros_like(stiffness)
    for patch in plate.patches:
        under = _bending(plate, x, y, *plate.covered(patch))
        stiffness += (patch.factor - 1) * under
        hysteretic += patch.loss_factor * under
    if any(plate.loss):
        hysteretic += lost(plate, lambda part: _bending(part, x, y, WHOLE, WHOLE))
    stiffness += _edges(plate, x, y)
    if plate.stress:
        stiffness += _residual_stress(plate, x, y)
    if any(plate.curvature):
        stiffness += _membrane(plate, x, y)
    if plate.hinge is not None:
        place, rotational = plate.hinge
        jump = (x.at(place, 1) - x.left_of(place, 1)) / plate.sides[0]
        stiffness += rotational * plate.sides[1] * np.kron(np.outer(jump, jump), y.integral(0, 0))
    found = Matrices(_mass(plate, x, y), stiffness, None, x, y, np.ones(x.size * y.size, bool))
    for matrix, terms in ((found.mass, plate.masses), (found.stiffness, plate.springs)):
        for place_x, place_y, coefficient in terms:
            row = found.rows([(place_x, place_y)])[0]
            matrix += coefficient * np.outer(row, row)
    add_air(plate, found)
    cut = np.ix_(kept, kept)
    lossy = hysteretic[cut] if any(plate.loss) or any(patch.loss_factor for patch in plate.patches) else None
    return Matrices(found.mass[cut], found.stiffness[cut], lossy, x, y, kept)


def lost(plate: RitzPlate, bending: Callable[[RitzPlate], np.ndarray]) -> np.ndarray:
    """Σ η_q ∂K/∂ln q over the moduli E_x, E_y and G: by differences, which are nearly exact in these."""
    total: np.ndarray = np.zeros(())
    for index, loss in enumerate(plate.loss):
        ends = []
        for factor in (1 - LOST_STEP, 1 + LOST_STEP):
            along = [factor if index == k else 1.0 for k in range(3)]
            mean = sqrt(along[0] * along[1])
            ends.append(
                bending(
                    replace(
                        plate,
                        young=plate.young * mean,
                        young_ratio=plate.young_ratio * along[1] / along[0],
                        shear_factor=plate.shear_factor * along[2] / mean,
                    )
                )
            )
        total = total + loss * (ends[1] - ends[0]) / (2 * LOST_STEP)
    return total


def add_air(plate: RitzPlate, found: "Matrices | SpectralMatrices") -> None:
    """The mass of the air, into the mass matrix."""
    if plate.air:
        place, own = added_mass(plate.sides)
        rows = found.rows(place.tolist())
        found.mass[:] += plate.air * (rows.T @ own @ rows)


def about(place: float, n_span: int) -> dict[float, int]:
    """Breaks on either side of a heavy point, where the deflection goes with r² log r, and how smooth it is at each."""
    return {place + offset / n_span: 4 for offset in (-0.35, -0.1, 0.1, 0.35)} | {place: 2}


def _breaks(plate: RitzPlate, n_span: int) -> tuple[dict[float, int], dict[float, int]]:
    found: tuple[dict[float, int], dict[float, int]] = ({}, {})
    for along in (0, 1):
        heavy = [
            *(t for t in plate.masses if t[2] > LIGHT * plate.mass),
            *(t for t in plate.springs if t[2] > 3e3),
            *(t for t in plate.dashpots if t[2] > 1),
            *plate.loaded,
        ]
        for term in heavy:
            found[along].update(about(term[along], n_span))
    for patch in plate.patches:
        for own, interval in zip(found, plate.covered(patch), strict=True):
            if patch.factor != 1:
                own |= {edge + sign * offset: 4 for edge in interval for offset in GRADED for sign in (-1, 1)}
            own |= dict.fromkeys(interval, 1)
    if plate.hinge is not None:
        found[0][plate.hinge[0]] = 0
    return found


def _kept(plate: RitzPlate, x: Splines, y: Splines) -> np.ndarray:
    free = [np.ones(x.size, bool), np.ones(y.size, bool)]
    for edge, condition in plate.edges.items():
        n_held = {"free": 0, "simply_supported": 1, "clamped": 2}[condition]
        own = free["xy".index(edge[0])]
        for index in range(n_held):
            own[index if edge[1] == "0" else -1 - index] = False
    return np.outer(*free).ravel()


def wander(coefficient: Sequence[float], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Σ c_k φ_k(x, y) of the fields in `WANDER` [-]."""
    total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
    for value, (i, j) in zip(coefficient, WANDER, strict=False):
        total = total + value * sqrt(2.0 ** ((i > 0) + (j > 0))) * np.cos(i * np.pi * x) * np.cos(j * np.pi * y)
    return total


def thickness_at(plate: RitzPlate, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """h(x, y) over the thickness at the middle, taper and wander in it [-]."""
    a, b = plate.taper
    return (1 + a * (x - 0.5) + b * (y - 0.5)) * (1 + wander(plate.thickness_wander, x, y))


def _powers(plate: RitzPlate, power: int) -> list[tuple[float, Weight, Weight]]:
    """(h(x, y)/h)^power, times E(x, y)/E in a bending rigidity, as a sum of c f(x) g(y)."""
    if plate.thickness_wander or plate.modulus_wander:
        return _separated(
            lambda x, y: (
                thickness_at(plate, x, y) ** power * (1 + (wander(plate.modulus_wander, x, y) if power == 3 else 0))
            )
        )
    a, b = plate.taper
    terms = [
        (comb(power, i) * comb(power - i, j) * a**i * b**j, _monomial(i), _monomial(j))
        for i, j in itertools.product(range(power + 1), repeat=2)
        if i + j <= power
    ]
    return [term for term in terms if term[0]]


def _monomial(power: int) -> Weight:
    return lambda t: (t - 0.5) ** power


def _separated(field: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> list[tuple[float, Weight, Weight]]:
    """A smooth field as a short sum of products, by interpolation at Chebyshev points and a singular value cut-off."""
    n = 16
    place = 0.5 + 0.5 * np.cos(np.pi * (np.arange(n) + 0.5) / n)
    left, value, right = np.linalg.svd(field(place[:, None], place[None, :]))

    def through(values: np.ndarray) -> Weight:
        return np.polynomial.Chebyshev.fit(place, values, n - 1, domain=[0.0, 1.0])

    kept = int((value > 1e-9 * value[0]).sum())
    return [(float(value[k]), through(left[:, k]), through(right[k])) for k in range(kept)]


def _bending(plate: RitzPlate, x: Splines, y: Splines, over_x: Interval, over_y: Interval) -> np.ndarray:
    """∫ κᵀ D κ over a rectangle of the plate."""
    lx, ly = plate.sides
    mean = plate.young * plate.thickness**3 / 12
    plane, root = mean / (1 - plate.poisson**2), sqrt(plate.young_ratio)
    shear = plate.shear_factor * mean / (2 * (1 + plate.poisson))
    total = np.zeros((x.size * y.size,) * 2)
    for coefficient, i, j in _powers(plate, 3):
        x00, x22, x20, x11 = (_power(x, over_x, i, *n) for n in ((0, 0), (2, 2), (2, 0), (1, 1)))
        y00, y22, y20, y11 = (_power(y, over_y, j, *n) for n in ((0, 0), (2, 2), (2, 0), (1, 1)))
        cross = np.kron(x20, y20.T)
        total += coefficient * (
            plane / root * ly / lx**3 * np.kron(x22, y00)
            + plane * root * lx / ly**3 * np.kron(x00, y22)
            + plane * plate.poisson / (lx * ly) * (cross + cross.T)
            + 4 * shear / (lx * ly) * np.kron(x11, y11)
        )
    return total


def _mass(plate: RitzPlate, x: Splines, y: Splines) -> np.ndarray:
    """∫ ρ h w²."""
    lx, ly = plate.sides
    total = np.zeros((x.size * y.size,) * 2)
    for coefficient, i, j in _powers(plate, 1):
        total += coefficient * np.kron(_power(x, WHOLE, i, 0, 0), _power(y, WHOLE, j, 0, 0))
    return plate.density * plate.thickness * lx * ly * total


def _power(splines: Splines, over: Interval, weight: Weight, order: int, other: int) -> np.ndarray:
    """∫ weight(t) N^(order) N^(other) dt."""
    return splines.integral(order, other, over, weight)


def _edges(plate: RitzPlate, x: Splines, y: Splines) -> np.ndarray:
    """∫ (k w² + κ w,n²) ds."""
    total = np.zeros((x.size * y.size,) * 2)
    for edge, spring, rotational in plate.edge_springs:
        across_x = edge[0] == "x"
        across, along = (x, y) if across_x else (y, x)
        length = plate.length_y if across_x else plate.length_x
        side = plate.length_x if across_x else plate.length_y
        end = float(edge[1])
        value, slope = across.at(end), across.at(end, 1) / side
        own = spring * np.outer(value, value) + rotational * np.outer(slope, slope)
        pair = (own, along.integral(0, 0)) if across_x else (along.integral(0, 0), own)
        total += length * np.kron(*pair)
    return total


def _residual_stress(plate: RitzPlate, x: Splines, y: Splines) -> np.ndarray:
    """∫ (Nx w,x² + 2 Nxy w,x w,y + Ny w,y²), Nx = φ,yy, Ny = φ,xx, Nxy = -φ,xy of φ = 256 P (x(1-x) y(1-y))²."""
    lx, ly = plate.sides
    bump = np.polynomial.Polynomial([0, 0, 1, -2, 1])
    zero, one, two = bump, bump.deriv(), bump.deriv(2)
    along_x = np.kron(x.integral(1, 1, weight=zero), y.integral(0, 0, weight=two)) * lx * ly / lx**2 / ly**2
    along_y = np.kron(x.integral(0, 0, weight=two), y.integral(1, 1, weight=zero)) * lx * ly / lx**2 / ly**2
    cross = np.kron(x.integral(1, 0, weight=one), y.integral(0, 1, weight=one)) / (lx * ly)
    return 256 * plate.stress * (along_x + along_y - cross - cross.T)


def _membrane(plate: RitzPlate, x: Splines, y: Splines) -> np.ndarray:
    """Stiffness on w of εx = u,x + w/Rx, εy = v,y + w/Ry, γ = u,y + v,x, with u and v where they cost least."""
    lx, ly = plate.sides
    extension = plate.young * plate.thickness / (1 - plate.poisson**2)
    law = extension * np.array([[1, plate.poisson, 0], [plate.poisson, 1, 0], [0, 0, (1 - plate.poisson) / 2]])
    # Each field's part of each strain: coefficient, order in x, order in y.
    along_x, along_y = plate.curvature
    strain = {
        (0, 0): (1 / lx, 1, 0), (0, 2): (1 / ly, 0, 1), (1, 1): (1 / ly, 0, 1), (1, 2): (1 / lx, 1, 0),
        (2, 0): (along_x, 0, 0), (2, 1): (along_y, 0, 0),
    }  # fmt: skip
    n = x.size * y.size
    total = np.zeros((3, 3, n, n))
    one_x = {(m, k): x.integral(m, k) for m, k in itertools.product((0, 1), repeat=2)}
    one_y = {(m, k): y.integral(m, k) for m, k in itertools.product((0, 1), repeat=2)}
    for ((f, a), (c, m, k)), ((g, b), (d, p, q)) in itertools.product(strain.items(), repeat=2):
        if law[a, b]:
            total[f, g] += c * d * law[a, b] * lx * ly * np.kron(one_x[m, p], one_y[k, q])
    inner = total[:2, :2].transpose(0, 2, 1, 3).reshape(2 * n, 2 * n)
    coupling = total[:2, 2].reshape(2 * n, n)
    # In-plane rigid motion costs nothing and is not excited: a trace of stiffness keeps it at rest.
    inner[np.diag_indices(2 * n)] += 1e-11 * np.diag(inner).max()
    return total[2, 2] - coupling.T @ scipy.linalg.solve(inner, coupling, assume_a="pos")
