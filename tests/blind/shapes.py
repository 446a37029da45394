"""The shapes stratum: 48 cases with a hole, a rib, a turned grain or a mass on a spring, or with nothing of the kind.

8 have nothing hidden, 40 one effect, each of the four ten times. Half of the plates, and all with a turned grain, are
orthotropic, and their config says how. Noise and test are those of the clean stratum. The truth is a Ritz plate of its
own: strains in the grain's axes, ribs as line integrals, holes as what is left out of every integral, a mass on a
spring as the force that it answers with.

| effect | hidden size |
|---|---|
| absorber | mass 0.003 to 0.04 M, log; tuned to 20 to 350 Hz; damping ratio 0.005 to 0.2, log |
| grain_angle | ±0.04 to 0.5 rad, beside Ey/Ex 0.3 to 0.7 |
| rib | along x or y, EI 0.02 to 0.3 D √A, GJ a quarter to a half of it, 0.005 to 0.03 M/√A |
| cut_out | sides of 0.06 to 0.25, a third of them at an edge; clear of wires, responses and references |

`thickness_field` is here too (each term 0.005 to 0.02), as a truth that tests draw and no suite asks to name.
"""

from dataclasses import dataclass, replace
from functools import cache
from math import pi, sqrt
from typing import Any

import numpy as np
import scipy.linalg

from blind.cases import N_AVERAGE, N_TRY, NOISE, SHOWS, Case, Slot, known, measure, seed_of
from blind.detect import detectable
from blind.effects import Hidden, Truth, bare
from blind.nuisances import CLEAN
from blind.plates import ALUMINIUM, STEEL, Rng, Specimen, config, draw_specimen, log_uniform, wires_of
from blind.ritz import GRADED, N_SPAN, WHOLE, Interval, RitzPlate, about
from blind.splines import Splines

NAMES = ("absorber", "grain_angle", "rib", "cut_out")
N_NOTHING, N_EACH = 8, 10
# Directions of the splines that hold less than this part of the mass of their like on the whole plate are in a hole.
IN_A_HOLE = 1e-7
# Gauss points of a rib, to each of so many parts.
N_GAUSS, N_PART = 6, 40
# What a cut keeps clear of, relative to the plate.
CLEAR = 0.02

Rectangle = tuple[float, float, float, float]
# x0, y0, x1, y1, EI, GJ, mass per length.
Rib = tuple[float, float, float, float, float, float, float]
# x, y, m, k, c.
Absorber = tuple[float, float, float, float, float]


@dataclass(frozen=True)
class ShapedMatrices:
    """Mass, stiffness and the directions of the splines that are on the plate."""

    mass: np.ndarray
    stiffness: np.ndarray
    x: Splines
    y: Splines
    turn: np.ndarray
    hysteretic: None = None

    def rows(self, place: Any) -> np.ndarray:
        """Deflection at relative places over the directions [n_place, n]."""
        return products(self.x, self.y, np.asarray(place, float).reshape(-1, 2)) @ self.turn


@dataclass(frozen=True)
class ShapedPlate(RitzPlate):
    """A free plate on springs, of uniform thickness, with what this stratum hides.

    Args:
        grain_angle: from the side x to the axis of E_x [rad].
        ribs: along lines of the plate.
        cuts: rectangles without plate.
        absorbers: masses on springs.
    """

    grain_angle: float = 0.0
    ribs: tuple[Rib, ...] = ()
    cuts: tuple[Rectangle, ...] = ()
    absorbers: tuple[Absorber, ...] = ()

    @property
    def rigidity(self) -> np.ndarray:
        """D over (w,xx, w,yy, 2w,xy) [N m]."""
        mean = self.young * self.thickness**3 / 12
        plane, root = mean / (1 - self.poisson**2), sqrt(self.young_ratio)
        shear = self.shear_factor * mean / (2 * (1 + self.poisson))
        own = np.array(
            [[plane / root, plane * self.poisson, 0], [plane * self.poisson, plane * root, 0], [0, 0, shear]]
        )
        c, s = np.cos(self.grain_angle), np.sin(self.grain_angle)
        # What the curvatures along and across the grain are of those along the sides.
        turn = np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]])
        return turn.T @ own @ turn

    def own_matrices(self, n_span: int = N_SPAN) -> ShapedMatrices:
        """Mass and stiffness over the splines that are on the plate."""
        x, y = (Splines(n_span, breaks) for breaks in self._breaks(n_span))
        stiffness, mass = self._bending(x, y, WHOLE, WHOLE), self._inertia(x, y, WHOLE, WHOLE)
        scale = 1 / np.sqrt(np.diag(mass))
        for x0, y0, x1, y1 in self.cuts:
            stiffness -= self._bending(x, y, (x0, x1), (y0, y1))
            mass -= self._inertia(x, y, (x0, x1), (y0, y1))
        for rib in self.ribs:
            more = self._rib(x, y, rib)
            stiffness, mass = stiffness + more[0], mass + more[1]
        for matrix, terms in ((mass, self.masses), (stiffness, self.springs)):
            for place_x, place_y, coefficient in terms:
                row = products(x, y, np.array([[place_x, place_y]]))[0]
                matrix += coefficient * np.outer(row, row)
        turn = np.diag(scale)
        if self.cuts:
            value, vector = scipy.linalg.eigh(scale[:, None] * mass * scale)
            there = value > IN_A_HOLE
            turn = scale[:, None] * vector[:, there] / np.sqrt(value[there])
        return ShapedMatrices(turn.T @ mass @ turn, turn.T @ stiffness @ turn, x, y, turn)

    def forces(self, s: np.ndarray) -> tuple[list[tuple[float, float]], np.ndarray]:
        """Where masses on springs sit, and what they answer a motion with there [n_s, n] [N/m]."""
        found = [s**2 * m * (k + s * c) / (k + s * c + s**2 * m) for _, _, m, k, c in self.absorbers]
        return [one[:2] for one in self.absorbers], np.array(found).reshape(len(found), len(s)).T

    def _breaks(self, n_span: int) -> tuple[dict[float, int], dict[float, int]]:
        found: tuple[dict[float, int], dict[float, int]] = ({}, {})
        for place in self.absorbers:
            for own, at in zip(found, place[:2], strict=True):
                own |= about(at, n_span)
        for x0, y0, x1, y1 in self.cuts:
            for own, edges in zip(found, ((x0, x1), (y0, y1)), strict=True):
                own |= {edge + sign * offset: 4 for edge in edges for offset in GRADED for sign in (-1, 1)}
                own |= dict.fromkeys(edges, 1)
        for x0, y0, x1, y1, *_ in self.ribs:
            # Across the rib the curvature jumps; at its ends moments are singular.
            along, across = (0, y0) if y0 == y1 else (1, x0)
            found[1 - along][across] = 1
            ends = (x0, x1) if along == 0 else (y0, y1)
            found[along].update({end + sign * offset: 4 for end in ends for offset in GRADED for sign in (-1, 1)})
            found[along].update(dict.fromkeys(ends, 1))
        return found

    def _bending(self, x: Splines, y: Splines, over_x: Interval, over_y: Interval) -> np.ndarray:
        """∫ κᵀ D κ over a rectangle of the plate."""
        lx, ly = self.sides
        orders = ((2, 0), (0, 2), (1, 1))
        scale = (1 / lx**2, 1 / ly**2, 2 / (lx * ly))
        total = np.zeros((x.size * y.size,) * 2)
        for i, first in enumerate(orders):
            for j, second in enumerate(orders):
                weight = self.rigidity[i, j] * scale[i] * scale[j] * lx * ly
                if weight:
                    along = x.integral(first[0], second[0], over_x), y.integral(first[1], second[1], over_y)
                    total += weight * np.kron(*along)
        return total

    def _inertia(self, x: Splines, y: Splines, over_x: Interval, over_y: Interval) -> np.ndarray:
        lx, ly = self.sides
        return self.density * self.thickness * lx * ly * np.kron(x.integral(0, 0, over_x), y.integral(0, 0, over_y))

    def _rib(self, x: Splines, y: Splines, rib: Rib) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and mass of a line that bends, twists and moves with the plate."""
        x0, y0, x1, y1, bending, torsion, heavy = rib
        lx, ly = self.sides
        way = np.array([(x1 - x0) * lx, (y1 - y0) * ly])
        length = float(np.hypot(*way))
        c, s = way / length
        point, gauss = np.polynomial.legendre.leggauss(N_GAUSS)
        t = ((np.arange(N_PART)[:, None] + (point + 1) / 2) / N_PART).ravel()
        weight = np.tile(gauss / 2, N_PART) * length / N_PART
        place = np.array([x0, y0]) + t[:, None] * np.array([x1 - x0, y1 - y0])
        xx, yy = products(x, y, place, 2, 0) / lx**2, products(x, y, place, 0, 2) / ly**2
        xy, w = products(x, y, place, 1, 1) / (lx * ly), products(x, y, place)
        along, twist = c * c * xx + s * s * yy + 2 * c * s * xy, c * s * (yy - xx) + (c * c - s * s) * xy
        stiffness = bending * (along.T * weight) @ along + torsion * (twist.T * weight) @ twist
        return stiffness, heavy * (w.T * weight) @ w


def products(x: Splines, y: Splines, place: np.ndarray, order_x: int = 0, order_y: int = 0) -> np.ndarray:
    """Products of splines, or a derivative, at relative places [n_place, n]."""
    along_x, along_y = x.at(place[:, 0], order_x), y.at(place[:, 1], order_y)
    return (along_x[:, :, None] * along_y[:, None, :]).reshape(len(place), -1)


def shaped(plate: RitzPlate) -> ShapedPlate:
    """The same plate, to which a shape can be given."""
    return ShapedPlate(**{name: getattr(plate, name) for name in RitzPlate.__dataclass_fields__})


def apply(truth: Truth, hidden: Hidden) -> Truth:
    """The truth with one of this stratum's effects in it."""
    p, plate = hidden.parameters, truth.plate
    if hidden.effect == "thickness_field":
        return replace(truth, plate=replace(plate, thickness_wander=tuple(p.values())))
    assert isinstance(plate, ShapedPlate)
    change: dict[str, Any] = {
        "absorber": lambda: {"absorbers": (*plate.absorbers, tuple(p.values()))},
        "grain_angle": lambda: {"grain_angle": p["angle"]},
        "rib": lambda: {"ribs": (*plate.ribs, tuple(p.values()))},
        "cut_out": lambda: {"cuts": (*plate.cuts, tuple(p.values()))},
    }[hidden.effect]()
    return replace(truth, plate=replace(plate, **change))


def draw_hidden(rng: Rng, name: str, specimen: Specimen, turn: int) -> Hidden:
    """One of this stratum's effects, of a random size, its parameters in the catalogue's order."""
    plate = specimen.plate
    area = plate.length_x * plate.length_y
    rigidity = plate.young * plate.thickness**3 / (12 * (1 - plate.poisson**2))
    match name:
        case "absorber":
            mass = plate.mass * log_uniform(rng, 0.003, 0.04)
            omega = 2 * pi * float(rng.uniform(20.0, 350.0))
            x, y = (float(value) for value in rng.uniform(0.06, 0.94, 2))
            viscous = 2 * mass * omega * log_uniform(rng, 0.005, 0.2)
            p = {"x": x, "y": y, "mass": mass, "stiffness": mass * omega**2, "viscous_damping": viscous}
        case "grain_angle":
            p = {"angle": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.04, 0.5))}
        case "rib":
            across, first = float(rng.uniform(0.1, 0.9)), float(rng.uniform(0.0, 0.3))
            last = float(rng.uniform(0.7, 1.0))
            line = (first, across, last, across) if turn % 2 else (across, first, across, last)
            bending = rigidity * sqrt(area) * log_uniform(rng, 0.02, 0.3)
            p = dict(zip(("x0", "y0", "x1", "y1"), line, strict=True))
            p |= {"bending": bending, "torsion": bending * float(rng.uniform(0.25, 0.5))}
            p["mass_per_length"] = plate.mass / sqrt(area) * log_uniform(rng, 0.005, 0.03)
        case "cut_out":
            p = _cut(rng, specimen, at_edge=turn % 3 == 2)
        case "thickness_field":
            sizes = rng.uniform(0.005, 0.02, 5) * rng.choice([-1.0, 1.0], 5)
            p = dict(zip(("a10", "a01", "a11", "a20", "a02"), (float(one) for one in sizes), strict=True))
        case _:
            raise KeyError(name)
    return Hidden(name, {}, p)


def _cut(rng: Rng, specimen: Specimen, at_edge: bool) -> dict[str, float]:
    """A rectangle in which there is no wire and nothing was measured."""
    taken = np.array([specimen.place(n) for n in (*wires_of(specimen), *specimen.response, *specimen.reference)])
    while True:
        size = rng.uniform(0.06, 0.25, 2)
        low = rng.uniform(0.0, 1.0, 2) * (1 - size)
        if at_edge:
            along = int(rng.integers(2))
            low[along] = (1 - size[along]) * float(rng.integers(2))
        else:
            low = 0.04 + low * (0.92 - size) / (1 - size)
        inside = ((taken > low - CLEAR) & (taken < low + size + CLEAR)).all(axis=1)
        if not inside.any():
            x0, y0, x1, y1 = (float(value) for value in (*low, *(low + size)))
            return {"x0": x0, "y0": y0, "x1": x1, "y1": y1}


@cache
def suite() -> tuple[Slot, ...]:
    """All slots, mixed."""
    slots = [Slot("none", (), turn) for turn in range(N_NOTHING)]
    slots += [Slot("one", (name,), turn) for name in NAMES for turn in range(N_EACH)]
    order = np.random.default_rng(48).permutation(len(slots))
    return tuple(slots[index] for index in order)


def draw(seed_set: str, index: int, by: str = "ritz") -> Case:
    """One case: the same for ever for a seed set and an index from 0 to 47.

    Args:
        seed_set: any word.
        index: from 0 to 47.
        by: the truth; this stratum has one, by Ritz.
    """
    del by
    slot, rng = suite()[index], np.random.default_rng([*seed_of(seed_set, index), 3])
    kind = STEEL if rng.random() < 0.5 else ALUMINIUM
    noise = log_uniform(rng, *NOISE)
    while True:
        specimen = draw_specimen(rng, kind, False, frozenset(slot.names))
        plate = shaped(specimen.plate)
        grain = slot.names == ("grain_angle",) or rng.random() < 0.5
        if grain:
            own = {"young_ratio": float(rng.uniform(0.3, 0.7)), "shear_factor": float(rng.uniform(0.8, 1.2))}
            plate = replace(plate, **own)
        else:
            plate = replace(plate, young_ratio=1.0, shear_factor=1.0)
        specimen = replace(specimen, plate=plate)
        found = _hidden(rng, specimen, slot, noise)
        if found is not None:
            break
    hidden, frf, shows = found
    n_average = int(rng.choice(N_AVERAGE)) if rng.random() < 0.5 else None
    measurement = measure(rng, specimen, frf, noise, n_average, proportional=bool(rng.random() < 0.5))
    file = "measurement.npz" if rng.random() < 0.5 else "measurement.uff"
    settings = config(specimen, file, True, n_average, seed=index)
    settings["measurement"] |= CLEAN
    if grain:
        numbers = {"young_ratio": plate.young_ratio, "shear_factor": plate.shear_factor}
        settings["effects"]["grain"] = {"effect": "orthotropy"} | numbers
    return Case(
        name=f"{index:03d}", kind=slot.kind, config=settings, measurement=measurement, truth=hidden, noise=noise,
        shows=shows, youngs_modulus=specimen.plate.young, young_is_seen=not known(settings), sides=kind.sides,
        file=file, specimen=specimen, stratum="shapes", detectable=("yes",) * len(hidden),
    )  # fmt: skip


def _hidden(
    rng: Rng, specimen: Specimen, slot: Slot, noise: float
) -> tuple[list[Hidden], np.ndarray, tuple[float, ...]] | None:
    """What is hidden, its FRFs, and how far it shows; None where no draw shows on this specimen."""
    without = bare(specimen)
    if slot.kind == "none":
        return [], without.frf(), ()
    for _ in range(N_TRY):
        hidden = draw_hidden(rng, slot.names[0], specimen, slot.turn)
        truth = apply(without, hidden)
        shows = detectable(truth, without, len(wires_of(specimen)), SHOWS * noise)
        if shows >= SHOWS * noise:
            return [hidden], truth.frf(), (shows,)
    return None
