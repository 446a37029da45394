"""The suite: 160 cases, whose kinds are the same for every seed set; only the numbers differ.

24 have nothing hidden, 16 something beyond the catalogue, 24 two effects, 96 one: every effect of the catalogue at
least four times alone and five in all. A draw is kept if what is left of it, after what the config searches is fitted,
is at least half the noise; beyond the catalogue twice the noise.

Noise is complex Gaussian in the frequency domain, ‖noise‖ / ‖H‖ = 0.3 to 3 %, log: in half of the cases in proportion
to |H|, in half the same on all lines; in half with the coherence that so many averages would report.
"""

import hashlib
from dataclasses import dataclass, field, replace
from itertools import chain as joined
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from blind import beyond
from blind.detect import Fitted, detectable, remains
from blind.effects import Hidden, Truth, apply, bare, draw_hidden, needs_loss
from blind.nuisances import CLEAN
from blind.plates import ALUMINIUM, STEEL, Rng, Specimen, config, draw_specimen, log_uniform, place_of, wires_of
from torchplate.measurement import SI_UNIT, Channel, Measurement, write_uff

# Alone four times each, these five times.
FIVE_TIMES = ("mesh_discretisation", "point_mass", "stiffness_loss", "edge_spring")
ALONE = (
    "support_spring", "hysteretic_damping", "aspect_ratio", "orthotropy", "poisson_ratio", "density", "thickness",
    "thickness_taper", "stiffness_loss", "damping_patch", "point_mass", "ground_spring", "ground_dashpot",
    "support_asymmetry", "edge_spring", "viscous_damping", "exponential_window", "time_delay", "sensor_gain",
    "sensor_position", "channel_polarity", "channel_swap", "mesh_discretisation",
)  # fmt: skip
PAIRS = (
    ("point_mass", "exponential_window"), ("point_mass", "orthotropy"), ("stiffness_loss", "sensor_gain"),
    ("stiffness_loss", "time_delay"), ("damping_patch", "channel_polarity"), ("damping_patch", "density"),
    ("ground_spring", "exponential_window"), ("ground_spring", "poisson_ratio"), ("ground_dashpot", "aspect_ratio"),
    ("ground_dashpot", "sensor_position"), ("support_asymmetry", "orthotropy"), ("support_asymmetry", "time_delay"),
    ("edge_spring", "viscous_damping"), ("edge_spring", "sensor_gain"), ("thickness_taper", "channel_swap"),
    ("thickness_taper", "hysteretic_damping"), ("thickness", "sensor_position"), ("support_spring", "channel_polarity"),
    ("thickness", "support_spring"), ("poisson_ratio", "channel_swap"), ("aspect_ratio", "exponential_window"),
    ("density", "ground_spring"), ("point_mass", "hysteretic_damping"), ("stiffness_loss", "viscous_damping"),
)  # fmt: skip
N_NOTHING, N_BEYOND = 24, 16
NOISE = (0.003, 0.03)
# What must be left of a hidden effect, over the noise.
SHOWS, SHOWS_BEYOND = 0.5, 2.0
# Draws on one specimen before another is taken.
N_TRY = 4
N_AVERAGE = (4, 5, 8, 10)
# What is hidden, the FRFs, what is left of each effect, sizes of what is beyond the catalogue.
Drawn = tuple[list[Hidden], np.ndarray, tuple[float, ...], dict[str, float]]


@dataclass(frozen=True)
class Slot:
    """What the suite holds at one index."""

    kind: str  # "none", "one", "two" or "beyond"
    names: tuple[str, ...]
    turn: int  # counts the slots of the same names


def suite() -> tuple[Slot, ...]:
    """All slots, mixed, so that any first part of them is a fair sample."""
    slots = [Slot("none", (), turn) for turn in range(N_NOTHING)]
    slots += [Slot("beyond", (beyond.KINDS[i % 6],), i // 6) for i in range(N_BEYOND)]
    slots += [Slot("two", pair, 4 + index) for index, pair in enumerate(PAIRS)]
    slots += [Slot("one", (name,), turn) for name in ALONE for turn in range(5 if name in FIVE_TIMES else 4)]
    order = np.random.default_rng(160).permutation(len(slots))
    return tuple(slots[index] for index in order)


@dataclass(frozen=True)
class Case:
    """One blind case: what the diagnosis sees (config, measurement), and what is so."""

    name: str
    kind: str
    config: dict[str, Any]
    measurement: Measurement | None  # None where a table of natural frequencies is all there is
    truth: list[Hidden]
    noise: float  # ‖noise‖ / ‖H‖ of every FRF [-]
    shows: tuple[float, ...]  # what is left of each hidden effect after the fit [-]
    youngs_modulus: float  # [Pa]
    young_is_seen: bool  # whether nothing else that is uncertain scales with E
    sides: tuple[float, float]  # nominal [m]
    file: str
    specimen: Specimen
    extra: dict[str, float] = field(default_factory=dict)
    stratum: str = "clean"
    # Of each hidden effect: "yes", "no" or "either"; see `detect.seen`. Empty: all show.
    detectable: tuple[str, ...] = ()

    def write(self, folder: Path) -> Path:
        """Write the measurement and config.yaml; of the truth it says nothing."""
        folder.mkdir(parents=True, exist_ok=True)
        if self.measurement is None:
            pass
        elif self.file.endswith(".npz"):
            self.measurement.to_npz(folder / self.file)
        else:
            write_uff(self.measurement, folder / self.file, binary=True)
        path = folder / "config.yaml"
        path.write_text(yaml.safe_dump(self.config, sort_keys=False, default_flow_style=None, width=120))
        return path

    def record(self) -> dict[str, Any]:
        """The truth as JSON."""
        hidden = [{"effect": h.effect, "options": h.options, "parameters": h.parameters} for h in self.truth]
        return {
            "name": self.name, "kind": self.kind, "hidden": hidden, "noise": self.noise, "shows": list(self.shows),
            "youngs_modulus": self.youngs_modulus, "young_is_seen": self.young_is_seen, "sides": list(self.sides),
            "grid": list(self.specimen.grid), "response": list(self.specimen.response),
            "reference": list(self.specimen.reference),
            "n_frf": int(self.measurement.measured.sum()) if self.measurement else 0,
            "n_line": len(self.measurement.frequency) if self.measurement else 0,
            "stratum": self.stratum, "by": self.specimen.plate.by, "detectable": list(self.detectable),
            "known": known(self.config), "stated": stated(self.config), "extra": self.extra,
        }  # fmt: skip


def known(config: dict[str, Any]) -> list[str]:
    """Numbers that the config gives with a std."""
    whole = config["mesh"] | config["effects"]["plate"]
    return sorted(name for name, value in whole.items() if isinstance(value, dict) and "std" in value)


def stated(config: dict[str, Any]) -> dict[str, float]:
    """Density, thickness and Poisson's ratio as the config says them."""
    plate = config["effects"]["plate"]
    values = {name: plate[name] for name in ("density", "thickness", "poisson_ratio")}
    return {name: value["value"] if isinstance(value, dict) else value for name, value in values.items()}


def seed_of(seed_set: str, index: int) -> list[int]:
    """Seeds of one case."""
    return [int.from_bytes(hashlib.sha256(seed_set.encode()).digest()[:8], "big"), index]


def draw(seed_set: str, index: int, by: str = "ritz") -> Case:
    """One case: the same for ever for a seed set and an index from 0 to 159.

    Args:
        seed_set: any word.
        index: from 0 to 159.
        by: which truth makes the FRFs: "ritz" or "spectral", where it knows what is hidden.
    """
    return draw_slot(suite()[index], np.random.default_rng(seed_of(seed_set, index)), index, by)


def draw_slot(slot: Slot, rng: Rng, index: int, by: str, stratum: str = "clean") -> Case:
    """One case of a perfect plate and test.

    Args:
        slot: what it holds.
        rng: where all numbers come from.
        index: of the slot.
        by: which truth makes the FRFs.
        stratum: whose case it is.
    """
    kind = STEEL if (index + slot.turn) % 2 == 0 else ALUMINIUM
    coarse = slot.names == ("mesh_discretisation",)
    noise = log_uniform(rng, *NOISE)
    drawn = None
    while drawn is None:
        specimen = draw_specimen(rng, kind, coarse, frozenset(slot.names))
        specimen = replace(specimen, plate=replace(specimen.plate, by=beyond.known_by(by, slot.names)))
        drawn = _draw_truth(rng, specimen, slot, noise)
    hidden, frf, shows, extra = drawn
    n_average = int(rng.choice(N_AVERAGE)) if rng.random() < 0.5 else None
    measurement = measure(rng, specimen, frf, noise, n_average, proportional=bool(rng.random() < 0.5))
    file = "measurement.npz" if rng.random() < 0.5 else "measurement.uff"
    settings = config(specimen, file, needs_loss(hidden), n_average, seed=index)
    settings["measurement"] |= CLEAN
    uncertain = {"density", "thickness", "sensor_gain", "aspect_ratio"} & {h.effect for h in hidden}
    return Case(
        name=f"{index:03d}", kind=slot.kind, config=settings, measurement=measurement, truth=hidden, noise=noise,
        shows=shows, youngs_modulus=specimen.plate.young, young_is_seen=not uncertain and not known(settings),
        sides=kind.sides, file=file, specimen=specimen, extra=extra, stratum=stratum,
    )  # fmt: skip


def _draw_truth(rng: Rng, specimen: Specimen, slot: Slot, noise: float) -> Drawn | None:
    """What is hidden, its FRFs, and how far it shows; None where no draw shows on this specimen."""
    if slot.kind == "beyond":
        return _draw_beyond(rng, specimen, slot.names[0], noise)
    if slot.kind == "none":
        return [], bare(specimen).frf(), (), {}
    if slot.names == ("mesh_discretisation",):
        return [Hidden("mesh_discretisation", {}, {})], bare(specimen).frf(), (), {}
    return _draw_hidden(rng, specimen, slot, noise)


def _draw_hidden(rng: Rng, specimen: Specimen, slot: Slot, noise: float) -> Drawn | None:
    n_wire = len(wires_of(specimen))
    for _ in range(N_TRY):
        hidden = [draw_hidden(rng, name, specimen, slot.turn) for name in slot.names]
        truth = _with(specimen, hidden)
        shows = []
        for left_out in range(len(hidden)):
            without = _with(specimen, [h for index, h in enumerate(hidden) if index != left_out])
            shows.append(detectable(truth, without, n_wire, SHOWS * noise))
            if shows[-1] < SHOWS * noise:
                break
        else:
            return hidden, truth.frf(), tuple(shows), {}
    return None


def _with(specimen: Specimen, hidden: list[Hidden]) -> Truth:
    truth = bare(specimen, with_loss=needs_loss(hidden))
    for one in hidden:
        truth = apply(truth, specimen, one)
    return truth


def _draw_beyond(rng: Rng, specimen: Specimen, name: str, noise: float) -> Drawn | None:
    without = bare(specimen)
    fitted = Fitted(without, len(wires_of(specimen)))
    for _ in range(N_TRY):
        frf, extra = beyond.draw(rng, name, without)
        shows = remains(frf, fitted, fitted.n_parameter, SHOWS_BEYOND * noise)
        if shows >= SHOWS_BEYOND * noise:
            return [Hidden(name, {}, {})], frf, (shows,), extra
    return None


def measure(
    rng: Rng, specimen: Specimen, frf: np.ndarray, noise: float, n_average: int | None, proportional: bool
) -> Measurement:
    """The FRFs with noise, and the coherence that so many averages report.

    With averages H_i = H + n_i the mean has the variance σ² and Σ|n_i − mean|² / n is σ² times a gamma variable of
    n − 1, so that γ² = |mean|² / (|mean|² + σ² gamma): of these very averages, as an analyser reports it.
    """
    amplitude = np.abs(frf)
    # Noise of a sensor is never flat in a receptance: rigid-body motion would be all that is seen.
    proportional = proportional or specimen.test.kind == "receptance"
    level = amplitude if proportional else np.sqrt((amplitude**2).mean(axis=0, keepdims=True)) + 0 * amplitude
    sigma = noise * level
    read = frf + sigma * (rng.standard_normal(frf.shape) + 1j * rng.standard_normal(frf.shape)) / np.sqrt(2)
    coherence = None
    if n_average is not None:
        spread = sigma**2 * rng.gamma(n_average - 1, size=frf.shape)
        coherence = torch.from_numpy(np.abs(read) ** 2 / (np.abs(read) ** 2 + spread))
    return as_measurement(specimen, read, coherence, with_places=bool(rng.random() < 0.5))


def as_measurement(
    specimen: Specimen, read: np.ndarray, coherence: torch.Tensor | None, with_places: bool
) -> Measurement:
    """FRFs under the labels of the test sheet, with the places of its marks or without."""
    sides = specimen.kind.sides

    def channels(nodes: tuple[int, ...]) -> tuple[Channel, ...]:
        places = [place_of(node, specimen.grid) for node in nodes]
        return tuple(
            Channel(node, "w", (x * sides[0], y * sides[1], 0.0) if with_places else None)
            for node, (x, y) in zip(nodes, places, strict=True)
        )

    kind: Any = specimen.test.kind
    return Measurement(
        frequency=torch.from_numpy(specimen.test.frequency), frf=torch.from_numpy(read),
        measured=torch.ones(read.shape[1:], dtype=torch.bool), response=channels(specimen.response),
        reference=channels(specimen.reference), kind=kind, unit=SI_UNIT[kind], coherence=coherence,
    )  # fmt: skip


def effects_of_suite() -> list[str]:
    """Every name that is hidden somewhere, as often as it is."""
    return list(joined.from_iterable(slot.names for slot in suite() if slot.kind in ("one", "two")))
