"""The workshop stratum: 200 cases with all nuisances, on all of them, at their standard deviations.

40 have nothing hidden, 20 something beyond the catalogue, 30 two effects, 110 one: each effect at least four times. No
draw is thrown away because it does not show: `detect.seen` says whether it does. Every other case is made by the second
truth. Layouts from 1 to 121 FRFs, most of 6 to 40; 60 to 3,200 lines, most of 200 to 1,200, up to 100, 200 or 400 Hz.
A patch has any aspect from 0.4 to 2.5. Noise: `noise`; nuisances: `nuisances`. A hit and a sensor may have one mark: at
such a drive point both truths, whose functions are some centimetres wide, give way less than under a point force.
"""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import torch

from blind import beyond, noise
from blind.cases import ALONE, NOISE, PAIRS, Case, Slot, as_measurement, known, seed_of
from blind.detect import seen, seen_beyond
from blind.effects import Hidden, Truth, apply, bare, draw_hidden, needs_loss
from blind.fisher import Marginal
from blind.nuisances import WORKSHOP, Drawn, spoil
from blind.plates import (
    ALUMINIUM,
    STEEL,
    Rng,
    Specimen,
    config,
    draw_specimen,
    log_uniform,
    off_symmetry,
    wires_of,
)
from blind.response import Damping, Test

N_NOTHING, N_BEYOND, N_TWO, N_ONE = 40, 20, 30, 110
# FRFs times lines: a case stays at some seconds.
N_DATA = 40_000
TOP = ((100.0, 0.1), (200.0, 0.2), (400.0, 0.7))
ASPECT = (0.4, 2.5)
PATCHES = ("stiffness_loss", "damping_patch")


@cache
def suite() -> tuple[Slot, ...]:
    """All slots, mixed."""
    return mixed(ALONE, PAIRS, (N_NOTHING, N_BEYOND, N_TWO, N_ONE), beyond.KINDS, 200)


def mixed(
    alone: tuple[str, ...],
    pairs: tuple[tuple[str, str], ...],
    n_kind: tuple[int, int, int, int],
    kinds: tuple[str, ...],
    seed: int,
) -> tuple[Slot, ...]:
    """Slots of nothing, beyond, two and one, each name in turn."""
    n_nothing, n_beyond, n_two, n_one = n_kind
    slots = [Slot("none", (), turn) for turn in range(n_nothing)]
    slots += [Slot("beyond", (kinds[i % len(kinds)],), i // len(kinds)) for i in range(n_beyond)]
    slots += [Slot("two", pairs[i % len(pairs)], i) for i in range(n_two)]
    slots += [Slot("one", (alone[i % len(alone)],), i // len(alone)) for i in range(n_one)]
    order = np.random.default_rng(seed).permutation(len(slots))
    return tuple(slots[index] for index in order)


def draw(seed_set: str, index: int, by: str | None = None) -> Case:
    """One case: the same for ever for a seed set and an index from 0 to 199.

    Args:
        seed_set: any word.
        index: from 0 to 199.
        by: which truth; left out, each makes every other case.
    """
    slot, rng = suite()[index], np.random.default_rng([*seed_of(seed_set, index), 1])
    by = beyond.known_by(by or ("spectral" if index % 2 else "ritz"), slot.names)
    kind = STEEL if rng.random() < 0.5 else ALUMINIUM
    level = log_uniform(rng, *NOISE)
    hidden_names = frozenset(slot.names)
    specimen = draw_specimen(rng, kind, slot.names == ("mesh_discretisation",), hidden_names)
    specimen = replace(specimen, plate=replace(specimen.plate, by=by))
    specimen = with_layout(rng, specimen, at_least=2 if "channel_swap" in slot.names else 1)
    drawn = spoil(rng, specimen, WORKSHOP, hidden_names, slip=bool(rng.random() < 0.5))
    shape = str(rng.choice(noise.SHAPES))
    hidden, truth, frf, extra = _hide(rng, drawn, slot)
    read, sigma, coherence, n_average = noise.spoil(rng, frf, specimen.test, level, shape)
    falls, detectable = _seen(drawn, slot, hidden, truth, frf, sigma)
    file = "measurement.npz" if rng.random() < 0.5 else "measurement.uff"
    settings = _config(drawn, specimen, file, needs_loss(hidden), n_average, index)
    measurement = as_measurement(
        specimen, read, None if coherence is None else torch.from_numpy(coherence), bool(rng.random() < 0.5)
    )
    return Case(
        name=f"{index:03d}", kind=slot.kind, config=settings, measurement=measurement, truth=hidden, noise=level,
        shows=falls, youngs_modulus=drawn.specimen.plate.young,
        young_is_seen=not known(settings), sides=kind.sides, file=file, specimen=drawn.specimen,
        extra=extra | {"noise_" + shape: 1.0}, stratum="workshop", detectable=detectable,
    )  # fmt: skip


def with_layout(rng: Rng, specimen: Specimen, at_least: int) -> Specimen:
    """The specimen tested at other places and lines."""
    grid = specimen.grid
    every = list(range(1, (grid[0] + 1) * (grid[1] + 1) + 1))
    n = round(log_uniform(rng, 6, 40) if rng.random() < 0.75 else log_uniform(rng, 1, 121))
    n = max(at_least, min(n, len(every)))
    n_response = int(rng.choice([1, 1, 1, 2, 2, 3, 4, n]))
    n_response = min(n_response, n)
    n_reference = max(n // n_response, 1)
    off = off_symmetry(grid)

    def nodes(n_node: int) -> tuple[int, ...]:
        chosen = rng.permutation(off if n_node <= len(off) else every)[:n_node]
        return tuple(sorted(int(node) for node in chosen))

    response, reference = nodes(n_response), nodes(n_reference)
    top = float(rng.choice([t for t, _ in TOP], p=[p for _, p in TOP]))
    n_line = log_uniform(rng, 200, 1200) if rng.random() < 0.75 else log_uniform(rng, 60, 3200)
    n_line = max(60, min(n_line, N_DATA / (n_response * n_reference)))
    step = (top - 5.0) / (round(n_line) - 1)
    # Whole multiples of the spacing, as an analyser has them.
    lines = step * np.arange(np.ceil(5.0 / step), np.floor(top / step) + 1)
    test = Test(
        [specimen.place(j) for j in response], [specimen.place(k) for k in reference], lines, specimen.test.kind
    )
    return replace(specimen, test=test, response=response, reference=reference)


def _hide(rng: Rng, drawn: Drawn, slot: Slot) -> tuple[list[Hidden], Truth, np.ndarray, dict[str, float]]:
    """What is hidden, the truth with it (beyond the catalogue: without), the FRFs, sizes of what is beyond."""
    if slot.kind == "beyond":
        truth = with_all(drawn, [])
        frf, extra = beyond.draw(rng, slot.names[0], truth)
        return [Hidden(slot.names[0], {}, {})], truth, frf, extra
    hidden = []
    for name in slot.names:
        if name == "mesh_discretisation":
            hidden.append(Hidden(name, {}, {}))
            continue
        one = draw_hidden(rng, name, drawn.specimen, slot.turn)
        if name in PATCHES:
            one = replace(one, parameters=one.parameters | {"aspect": log_uniform(rng, *ASPECT)})
        hidden.append(one)
    truth = with_all(drawn, hidden)
    return hidden, truth, truth.frf(), {}


def with_all(drawn: Drawn, hidden: list[Hidden], loss: bool | None = None) -> Truth:
    """The spoilt specimen with some effects in it."""
    specimen = drawn.specimen
    truth = bare(specimen)
    if not (needs_loss(hidden) if loss is None else loss):
        truth = replace(truth, damping=Damping(scatter=specimen.damping.scatter))
    truth = replace(truth, chain=drawn.chain)
    for one in hidden:
        if one.effect != "mesh_discretisation":
            truth = apply(truth, specimen, one)
    return truth


def _seen(
    drawn: Drawn, slot: Slot, hidden: list[Hidden], truth: Truth, frf: np.ndarray, sigma: np.ndarray
) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """The expected fall of each hidden effect, and whether it is to be named."""
    stated = frozenset(name for name, value in drawn.specimen.stated.items() if "std" in value)
    n_wire = len(wires_of(drawn.specimen))

    def fall(without: Truth, aim: np.ndarray | Truth) -> float:
        return Marginal(without, n_wire, sigma, WORKSHOP, stated).left(aim)

    if slot.kind == "beyond":
        found = fall(truth, frf)
        return (found,), (seen_beyond(found, 2 * frf.size),)
    falls: list[float] = []
    words: list[str] = []
    for index, one in enumerate(hidden):
        if one.effect == "mesh_discretisation":
            falls.append(0.0)
            words.append("yes")
            continue
        without = with_all(drawn, [h for k, h in enumerate(hidden) if k != index], needs_loss(hidden))
        falls.append(min(fall(without, truth), as_nuisance(one, drawn, stated)))
        words.append(seen(falls[-1], len(one.parameters)))
    return tuple(falls), tuple(words)


def as_nuisance(hidden: Hidden, drawn: Drawn, stated: frozenset[str]) -> float:
    """What an effect costs that is a nuisance itself, only larger: its squared size in standard deviations."""
    p, std, nominal = hidden.parameters, WORKSHOP, drawn.specimen.stated
    n_response, n_reference = len(drawn.specimen.test.response), len(drawn.specimen.test.reference)
    if hidden.effect == "sensor_position":
        return float((p["dx"] ** 2 + p["dy"] ** 2) / std.position**2)
    if hidden.effect == "sensor_gain":
        # Shared between the gains of responses and of references where it costs least.
        return float((p["gain"] - 1) ** 2 / std.calibration**2 * n_response * n_reference / (n_response + n_reference))
    if hidden.effect in stated and hidden.effect in ("thickness", "density"):
        return float(((p["value"] - nominal[hidden.effect]["value"]) / nominal[hidden.effect]["std"]) ** 2)
    return float("inf")


def _config(
    drawn: Drawn, nominal: Specimen, file: str, with_loss: bool, n_average: int | None, seed: int
) -> dict[str, Any]:
    """The YAML config: the sheet's numbers, all nuisances that it has words for, and the accelerometers."""
    settings = config(drawn.specimen, file, with_loss, n_average, seed)
    top = float(np.ceil(nominal.test.frequency[-1]))
    settings["measurement"] |= {"band": [5.0, top], **WORKSHOP.told()}
    for index, (x, y) in enumerate(drawn.accelerometers):
        settings["effects"][f"accelerometer_{index + 1}"] = {
            "effect": "point_mass", "x": x, "y": y,
            "mass": {"value": WORKSHOP.sensor, "std": WORKSHOP.sensor_std},
        }  # fmt: skip
    return settings
