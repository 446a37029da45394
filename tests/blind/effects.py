"""The hidden effects: their ranges, their draws, and what each does to the truth.

Scales that are drawn log-uniformly are marked log; M is the plate's mass, A its area, D its rigidity.

| effect | hidden size |
|---|---|
| support_spring | one more wire, k and c 0.5 to 2 of the others', log |
| hysteretic_damping | β 3e-3 to 1.2e-2, log, with no loss in the config; or η 200 to 3000 1/s², log, beside a known β |
| aspect_ratio | ±1 to 6 % |
| orthotropy | Ey/Ex 0.75 to 0.95 or its inverse; shear factor 0.85 to 1.15 |
| poisson_ratio | ±0.03 to 0.10 |
| density | ±4 to 15 % |
| thickness | ±2 to 8 % |
| thickness_taper | one slope or both, ±0.04 to 0.25 |
| stiffness_loss | size 0.12 to 0.35, factor 0.3 to 0.8 |
| damping_patch | size 0.12 to 0.35, loss factor 0.05 to 0.5, log |
| point_mass | 0.003 to 0.04 M, log |
| ground_spring | 0.5 to 50 D/A, log |
| ground_dashpot | 0.01 to 0.2 √(Dρh), log |
| support_asymmetry | one or two wires, factor 0.3 to 0.7 or 1.4 to 1.9 |
| edge_spring | k 0.1 to 5 D/A^1.5, κ 0.05 to 2 D/√A, log; every third k 30 to 300, κ 1 to 30: a soft clamp |
| viscous_damping | a 0.5 to 4 1/s, b 1e-6 to 1e-5 s, log; one of them or both |
| exponential_window | 0.4 to 5 1/s, log |
| time_delay | ±1e-5 to 3e-4 s, log |
| sensor_gain | ±4 to 35 %, log |
| sensor_position | one response, 4 to 30 mm off, log |
| channel_polarity | one response of several, else one FRF |
| channel_swap | two responses of several, else two references |
| air_loading | 1.15 to 1.25 kg/m³ |
| directional_damping | one direction 0.01 to 0.04, one 0.001 to 0.01, both log; one none |
| frequency_dependent_loss | ±0.2 to 0.7 |
| roving_mass | 0.002 to 0.02 M, log |
| mesh_discretisation | a config mesh of 6 × 6 (6 × 4), and nothing else |
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np

from blind.plates import Rng, Specimen, log_uniform, off_symmetry, wires_of
from blind.response import Chain, Damping, Test
from blind.response import frf as ritz_frf
from blind.ritz import Patch, RitzPlate

Options = dict[str, Any]
Parameters = dict[str, float]


@dataclass(frozen=True)
class Hidden:
    """One effect that the config does not know of, in the words of the catalogue."""

    effect: str
    options: Options
    parameters: Parameters


@dataclass(frozen=True)
class Truth:
    """The plate, its damping and its sensor chain, hidden effects included."""

    plate: RitzPlate
    damping: Damping
    chain: Chain
    test: Test

    def frf(self) -> np.ndarray:
        """The FRFs as they are read, without noise."""
        return ritz_frf(self.plate, self.damping, self.chain, self.test)


def bare(specimen: Specimen, with_loss: bool = True) -> Truth:
    """The specimen with nothing hidden."""
    return Truth(specimen.plate, specimen.damping if with_loss else Damping(), Chain(), specimen.test)


def needs_loss(hidden: list[Hidden]) -> bool:
    """Whether the config has a loss factor to search: not where that is what is hidden."""
    return not any("stiffness_loss_factor" in one.parameters for one in hidden)


def apply(truth: Truth, specimen: Specimen, hidden: Hidden) -> Truth:
    """The truth with one more effect in it."""
    plate, p, test = truth.plate, hidden.parameters, truth.test
    name = hidden.effect
    if name == "support_spring":
        place = specimen.place(hidden.options["nodes"][0])
        springs = [*plate.springs, (*place, p["stiffness"])]
        return replace(
            truth, plate=replace(plate, springs=springs, dashpots=[*plate.dashpots, (*place, p["viscous_damping"])])
        )
    if name == "hysteretic_damping":
        damping = replace(
            truth.damping, beta=p.get("stiffness_loss_factor", truth.damping.beta), eta=p.get("mass_loss_factor", 0.0)
        )
        return replace(truth, damping=damping)
    if name == "frequency_dependent_loss":
        return replace(truth, damping=replace(truth.damping, exponent=p["exponent"]))
    if name == "viscous_damping":
        return replace(truth, damping=replace(truth.damping, a=p["mass_coefficient"], b=p["stiffness_coefficient"]))
    if name == "orthotropy":
        # Beside the grain that the plate has anyway.
        grain = {"young_ratio": plate.young_ratio * p["young_ratio"], "shear_factor": p["shear_factor"]}
        return replace(truth, plate=replace(plate, **grain))
    if name in PLATE:
        return replace(truth, plate=replace(plate, **PLATE[name](p)))
    if name in ADDED:
        field, term = ADDED[name]
        changed: dict[str, Any] = {field: [*getattr(plate, field), term(p, hidden.options)]}
        return replace(truth, plate=replace(plate, **changed))
    if name == "support_asymmetry":
        n = len(wires_of(specimen))
        springs = [
            (x, y, k * p[f"factor_{i + 1}"]) if i < n else (x, y, k) for i, (x, y, k) in enumerate(plate.springs)
        ]
        return replace(truth, plate=replace(plate, springs=springs))
    return replace(truth, chain=_chain(truth.chain, specimen, test, hidden))


# What replaces numbers of the plate, and what adds one term to it.
PLATE: dict[str, Callable[[Parameters], dict[str, Any]]] = {
    "aspect_ratio": lambda p: {"aspect_ratio": p["ratio"]},
    "poisson_ratio": lambda p: {"poisson": p["value"]},
    "air_loading": lambda p: {"air": p["density"]},
    "directional_damping": lambda p: {"loss": (p["loss_x"], p["loss_y"], p["loss_xy"])},
    "density": lambda p: {"density": p["value"]},
    "thickness": lambda p: {"thickness": p["value"]},
    "thickness_taper": lambda p: {"taper": (p["slope_x"], p["slope_y"])},
}
ADDED: dict[str, tuple[str, Callable[[Parameters, Options], Any]]] = {
    "stiffness_loss": (
        "patches",
        lambda p, _: Patch(p["x"], p["y"], p["size"], p["factor"], aspect=p.get("aspect", 1.0)),
    ),
    "damping_patch": (
        "patches",
        lambda p, _: Patch(p["x"], p["y"], p["size"], 1.0, p["loss_factor"], p.get("aspect", 1.0)),
    ),
    "point_mass": ("masses", lambda p, _: (p["x"], p["y"], p["mass"])),
    "ground_spring": ("springs", lambda p, _: (p["x"], p["y"], p["stiffness"])),
    "ground_dashpot": ("dashpots", lambda p, _: (p["x"], p["y"], p["viscous_damping"])),
    "edge_spring": ("edge_springs", lambda p, o: (o["edge"], p["stiffness"], p["rotational_stiffness"])),
}


def _chain(chain: Chain, specimen: Specimen, test: Test, hidden: Hidden) -> Chain:
    p, name = hidden.parameters, hidden.effect
    shape = len(test.response), len(test.reference)
    if name == "exponential_window":
        return replace(chain, rate=p["rate"])
    if name == "time_delay":
        return replace(chain, delay=p["delay"])
    if name == "roving_mass":
        return replace(chain, sensor_mass=p["mass"])
    if name == "sensor_gain":
        return replace(chain, gain=p["gain"])
    if name == "sensor_position":
        return replace(chain, offset={specimen.response.index(hidden.options["response"]): (p["dx"], p["dy"])})
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    found = [index[_rows(specimen, channel)].ravel() for channel in hidden.options["channels"]]
    if name == "channel_polarity":
        sign = np.ones(shape)
        sign.ravel()[np.concatenate(found)] = -1
        return replace(chain, sign=sign)
    if name == "channel_swap":
        reading = index.ravel().copy()
        reading[found[0]], reading[found[1]] = found[1], found[0]
        return replace(chain, reading=reading)
    raise KeyError(name)


def _rows(specimen: Specimen, channel: tuple[int | None, int | None]) -> tuple[Any, Any]:
    response, reference = channel
    return (
        slice(None) if response is None else specimen.response.index(response),
        slice(None) if reference is None else specimen.reference.index(reference),
    )


def draw_hidden(rng: Rng, name: str, specimen: Specimen, turn: int) -> Hidden:
    """An effect of a random size.

    Args:
        rng: where the numbers come from.
        name: of the effect.
        specimen: whose mass and rigidity scale it.
        turn: counts the cases of that effect, for what comes in turns.
    """
    plate, test = specimen.plate, specimen.test
    area = plate.length_x * plate.length_y
    rigidity = plate.young * plate.thickness**3 / (12 * (1 - plate.poisson**2))
    sign = float(rng.choice([-1.0, 1.0]))
    x, y = float(rng.uniform(0.06, 0.94)), float(rng.uniform(0.06, 0.94))
    inner = {"x": 0.15 + 0.7 * x, "y": 0.15 + 0.7 * y, "size": float(rng.uniform(0.12, 0.35))}
    options: Options = {}
    p: Parameters
    match name:
        case "support_spring":
            taken = {*wires_of(specimen)}
            options = {"nodes": [int(rng.choice([node for node in off_symmetry(specimen.grid) if node not in taken]))]}
            p = {"stiffness": specimen.stiffness, "viscous_damping": specimen.viscous}
            p = {key: value * log_uniform(rng, 0.5, 2.0) for key, value in p.items()}
        case "hysteretic_damping":
            p = {"mass_loss_factor": log_uniform(rng, 200.0, 3000.0)}
            if turn % 3 != 2:
                p = {"stiffness_loss_factor": log_uniform(rng, 3e-3, 1.2e-2)}
        case "aspect_ratio":
            p = {"ratio": 1 + sign * float(rng.uniform(0.01, 0.06))}
        case "orthotropy":
            p = {"young_ratio": float(rng.uniform(0.75, 0.95)) ** sign, "shear_factor": float(rng.uniform(0.85, 1.15))}
        case "poisson_ratio":
            p = {"value": specimen.kind.poisson + sign * float(rng.uniform(0.03, 0.10))}
        case "density":
            p = {"value": specimen.kind.density * (1 + sign * float(rng.uniform(0.04, 0.15)))}
        case "thickness":
            p = {"value": specimen.kind.thickness * (1 + sign * float(rng.uniform(0.02, 0.08)))}
        case "thickness_taper":
            slopes = rng.uniform(0.04, 0.25, 2) * rng.choice([-1.0, 1.0], 2) * [(1, 0), (0, 1), (1, 1)][turn % 3]
            p = {"slope_x": float(slopes[0]), "slope_y": float(slopes[1])}
        case "stiffness_loss":
            p = inner | {"factor": float(rng.uniform(0.3, 0.8))}
        case "damping_patch":
            p = inner | {"loss_factor": log_uniform(rng, 0.05, 0.5)}
        case "point_mass":
            p = {"x": x, "y": y, "mass": plate.density * plate.thickness * area * log_uniform(rng, 0.003, 0.04)}
        case "ground_spring":
            p = {"x": x, "y": y, "stiffness": rigidity / area * log_uniform(rng, 0.5, 50.0)}
        case "ground_dashpot":
            scale = sqrt(rigidity * plate.density * plate.thickness)
            p = {"x": x, "y": y, "viscous_damping": scale * log_uniform(rng, 0.01, 0.2)}
        case "support_asymmetry":
            n = len(wires_of(specimen))
            options = {"nodes": list(wires_of(specimen))}
            changed = rng.permutation(n)[: rng.integers(1, 3)]
            ranges = ((0.3, 0.7), (1.4, 1.9))
            p = {
                f"factor_{i + 1}": float(rng.uniform(*ranges[rng.integers(2)])) if i in changed else 1.0
                for i in range(n)
            }
        case "edge_spring":
            options = {"edge": str(rng.choice(["x0", "x1", "y0", "y1"]))}
            soft = turn % 3 != 2
            spring, rotational = ((0.1, 5.0), (0.05, 2.0)) if soft else ((30.0, 300.0), (1.0, 30.0))
            p = {
                "stiffness": rigidity / area**1.5 * log_uniform(rng, *spring),
                "rotational_stiffness": rigidity / area**0.5 * log_uniform(rng, *rotational),
            }
        case "viscous_damping":
            p = {"mass_coefficient": log_uniform(rng, 0.5, 4.0), "stiffness_coefficient": log_uniform(rng, 1e-6, 1e-5)}
            if turn % 3:
                p["mass_coefficient" if turn % 3 == 1 else "stiffness_coefficient"] = 0.0
        case "exponential_window":
            p = {"rate": log_uniform(rng, 0.4, 5.0)}
        case "time_delay":
            p = {"delay": sign * log_uniform(rng, 1e-5, 3e-4)}
        case "air_loading":
            p = {"density": float(rng.uniform(1.15, 1.25))}
        case "directional_damping":
            # One direction loses most.
            losses = rng.permutation([log_uniform(rng, 0.01, 0.04), log_uniform(rng, 0.001, 0.01), 0.0])
            p = {name: float(value) for name, value in zip(("loss_x", "loss_y", "loss_xy"), losses, strict=True)}
        case "frequency_dependent_loss":
            p = {"exponent": sign * float(rng.uniform(0.2, 0.7))}
        case "roving_mass":
            p = {"mass": plate.mass * log_uniform(rng, 0.002, 0.02)}
        case "sensor_gain":
            p = {"gain": log_uniform(rng, 1.04, 1.35) ** sign}
        case "sensor_position":
            options = {"response": specimen.response[rng.integers(len(specimen.response))]}
            distance, angle = log_uniform(rng, 0.004, 0.03), rng.uniform(0, 2 * pi)
            p = {"dx": distance * cos(angle), "dy": distance * sin(angle)}
        case "channel_polarity":
            p, options = {}, {"channels": [_channel(rng, specimen)]}
        case "channel_swap":
            several = len(test.response) > 1
            pair = rng.permutation(specimen.response if several else specimen.reference)[:2].tolist()
            p, options = {}, {"channels": [[node, None] if several else [None, node] for node in pair]}
        case _:
            raise KeyError(name)
    return Hidden(name, options, p)


def _channel(rng: Rng, specimen: Specimen) -> list[int | None]:
    response = specimen.response[rng.integers(len(specimen.response))]
    reference = specimen.reference[rng.integers(len(specimen.reference))]
    return [response, None] if len(specimen.response) > 2 else [response, reference]
