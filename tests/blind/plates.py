"""The two plates under test, and how they were tested: numbers drawn, nothing hidden yet.

Both: β 1.5e-3 to 8e-3, log, band 5 to 400 Hz.

| plate | sides [m], h [m] | E [GPa] | ρ, ν | wires | k [N/m] | c [N s/m] |
|---|---|---|---|---|---|---|
| steel | 0.48 × 0.48, 0.0027 | 185-215 | 7860, 0.3 | nodes 2, 10, 112, 120 of 10 × 10 | 800-1800 | 0.3-1.2 |
| aluminium | 0.60 × 0.36, 0.003 | 66-74 | 2700, 0.33 | near the corners of 12 × 8 | 300-900 | 0.1-0.5 |
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from blind.response import Damping, Test
from blind.ritz import RitzPlate

Rng = np.random.Generator

# Responses × references.
LAYOUTS = ((1, 6), (1, 12), (1, 24), (8, 1), (16, 1), (2, 5), (3, 4), (2, 12), (4, 10), (6, 2))


@dataclass(frozen=True)
class Kind:
    """What is common to all specimens of a plate: known numbers and ranges."""

    name: str
    sides: tuple[float, float]
    thickness: float
    density: float
    poisson: float
    young: tuple[float, float]
    grid: tuple[int, int]
    wires: tuple[int, ...]
    stiffness: tuple[float, float]
    viscous: tuple[float, float]
    searched: dict[str, tuple[float, float]]


STEEL = Kind(
    "steel", (0.48, 0.48), 0.0027, 7860.0, 0.3, (185e9, 215e9),
    (10, 10), (2, 10, 112, 120), (800.0, 1800.0), (0.3, 1.2),
    {"young": (150e9, 260e9), "stiffness": (400.0, 3000.0), "viscous": (0.1, 2.5)},
)  # fmt: skip
ALUMINIUM = Kind(
    "aluminium", (0.60, 0.36), 0.003, 2700.0, 0.33, (66e9, 74e9),
    (12, 8), (15, 25, 93, 103), (300.0, 900.0), (0.1, 0.5),
    {"young": (50e9, 90e9), "stiffness": (150.0, 1800.0), "viscous": (0.03, 1.2)},
)  # fmt: skip
BETA = (1.5e-3, 8e-3)
SEARCHED_BETA = (1e-4, 5e-2)


@dataclass(frozen=True)
class Specimen:
    """One plate with its wires, its test and what the test sheet says of it.

    Args:
        kind: which plate.
        grid: elements along x and y of the config's mesh, which also name the nodes.
        refine: `mesh.refine` of the config.
        plate: the truth without anything hidden.
        damping: likewise.
        stiffness: of each wire [N/m].
        viscous: of each wire [N s/m].
        test: places, lines and kind of FRF.
        response: node labels.
        reference: node labels.
        stated: what the config says: a number, and a std where it is known as well as that.
    """

    kind: Kind
    grid: tuple[int, int]
    refine: int
    plate: RitzPlate
    damping: Damping
    stiffness: float
    viscous: float
    test: Test
    response: tuple[int, ...]
    reference: tuple[int, ...]
    stated: dict[str, dict[str, float]]

    def place(self, node: int) -> tuple[float, float]:
        """Relative place of a node of the config's grid."""
        return place_of(node, self.grid)


def place_of(node: int, grid: tuple[int, int]) -> tuple[float, float]:
    """Relative place of a node: labels count along x first, from 1."""
    row, column = divmod(node - 1, grid[0] + 1)
    return column / grid[0], row / grid[1]


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """A scale: equal ratios are equally likely."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def off_symmetry(grid: tuple[int, int]) -> list[int]:
    """Nodes off the two middle lines."""
    nodes = range(1, (grid[0] + 1) * (grid[1] + 1) + 1)
    places = {node: place_of(node, grid) for node in nodes}
    return [node for node, (x, y) in places.items() if abs(x - 0.5) > 1e-9 and abs(y - 0.5) > 1e-9]


def draw_specimen(rng: Rng, kind: Kind, coarse: bool, hidden: frozenset[str]) -> Specimen:
    """A specimen and its test.

    Args:
        rng: where all numbers come from.
        kind: which plate.
        coarse: whether the config's mesh is 6 × 6 (6 × 4), too coarse for the band.
        hidden: names of what will be hidden: what they contradict is not stated with a std.
    """
    grid = ((6, 6) if kind is STEEL else (6, 4)) if coarse else kind.grid
    wires = tuple(kind.wires) if not coarse else corners(grid)
    young = float(rng.uniform(*kind.young))
    stiffness, viscous = log_uniform(rng, *kind.stiffness), log_uniform(rng, *kind.viscous)
    beta = log_uniform(rng, *BETA)
    stated, real = _stated(rng, kind, hidden)
    n_response, n_reference = LAYOUTS[rng.integers(len(LAYOUTS))]
    nodes = rng.permutation(off_symmetry(grid))
    if n_response + n_reference > len(nodes):
        n_response, n_reference = 2, 5
    response = tuple(sorted(int(node) for node in nodes[:n_response]))
    reference = tuple(sorted(int(node) for node in nodes[n_response : n_response + n_reference]))
    step = 0.5 if n_response * n_reference <= 12 and rng.random() < 0.5 else 1.0
    of_test = Test(
        [place_of(node, grid) for node in response],
        [place_of(node, grid) for node in reference],
        np.arange(5.0, 400.0 + step / 2, step),
        str(rng.choice(["accelerance"] * 6 + ["receptance", "mobility"])),
    )
    at = [place_of(node, grid) for node in wires]
    plate = RitzPlate(
        real["length_x"], real["length_y"], young, kind.poisson, real["density"], real["thickness"],
        springs=[(*place, stiffness) for place in at], dashpots=[(*place, viscous) for place in at],
    )  # fmt: skip
    refine = 1 if coarse else int(rng.choice([1, 2, 2]))
    return Specimen(kind, grid, refine, plate, Damping(beta), stiffness, viscous, of_test, response, reference, stated)


def corners(grid: tuple[int, int]) -> tuple[int, ...]:
    """Wires at the second node from each corner along x, on the edges y0 and y1."""
    n_x, n_y = grid
    last = n_y * (n_x + 1)
    return 2, n_x, last + 2, last + n_x


def wires_of(specimen: Specimen) -> tuple[int, ...]:
    """Nodes where the config's wires are."""
    return tuple(specimen.kind.wires) if specimen.grid == specimen.kind.grid else corners(specimen.grid)


def _stated(rng: Rng, kind: Kind, hidden: frozenset[str]) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """What the sheet says and what is so; in a third of the cases some numbers have a std, which the truth obeys."""
    real = {
        "length_x": kind.sides[0], "length_y": kind.sides[1], "density": kind.density, "thickness": kind.thickness,
    }  # fmt: skip
    std = {"length_x": 0.0005, "length_y": 0.0005, "density": 0.004 * kind.density, "thickness": 0.00001}
    choice = rng.integers(9)
    wanted = {0: ("length_x", "length_y"), 1: ("thickness",), 2: ("density", "thickness")}.get(int(choice), ())
    if "aspect_ratio" in hidden and "length_x" in wanted:
        wanted = ()
    stated: dict[str, dict[str, float]] = {}
    for name, value in real.items():
        off = std[name] * float(rng.standard_normal())
        if name in wanted and name not in hidden:
            stated[name] = {"value": round(value, 6), "std": std[name]}
            real[name] = value + off
        else:
            stated[name] = {"value": value}
    return stated, real


def config(specimen: Specimen, file: str, with_loss: bool, n_average: int | None, seed: int) -> dict[str, Any]:
    """The YAML config that the diagnosis gets."""
    searched, stated = specimen.kind.searched, specimen.stated

    def number(name: str) -> float | dict[str, float]:
        return stated[name] if "std" in stated[name] else stated[name]["value"]

    measurement: dict[str, Any] = {"file": file, "band": [5.0, 400.0]}
    if n_average is not None:
        measurement["n_average"] = n_average
    effects: dict[str, Any] = {
        "plate": {
            "effect": "plate",
            "youngs_modulus": list(searched["young"]),
            "poisson_ratio": specimen.kind.poisson,
            "density": number("density"),
            "thickness": number("thickness"),
        },
        "wires": {
            "effect": "support_spring",
            "nodes": list(wires_of(specimen)),
            "stiffness": list(searched["stiffness"]),
            "viscous_damping": list(searched["viscous"]),
        },
    }
    if with_loss:
        low, high = SEARCHED_BETA
        effects["loss"] = {
            "effect": "hysteretic_damping",
            "stiffness_loss_factor": {"low": low, "high": high, "scale": "log"},
        }
    mesh = {"length_x": number("length_x"), "length_y": number("length_y")}
    mesh |= {"n_x": specimen.grid[0], "n_y": specimen.grid[1]}
    if specimen.refine > 1:
        mesh["refine"] = specimen.refine
    return {"mesh": mesh, "measurement": measurement, "effects": effects, "search": {"seed": seed}}
