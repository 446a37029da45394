"""The tables stratum: 200 cases of which 10 to 20 natural frequencies are all that is known.

50 have nothing hidden, 40 two effects, 110 one; effects that undamped natural frequencies can see only. The modes are
flexible ones, the three of the plate on its soft wires counted before them; some are missing. Each frequency scatters
by 0.05 to 0.3 %, log, and is rounded to 0.1 or 0.01 Hz or to 3 or 4 digits. In half of the cases the config says how
far they scatter. E is searched, or known to 1 % in a third of the cases (where density or thickness is hidden: in two
thirds; else nothing parts them from E). The sheet's other numbers are right.
"""

from dataclasses import replace
from functools import cache
from math import floor, log10
from typing import Any

import numpy as np

from blind.cases import Case, Slot, known, seed_of
from blind.detect import seen
from blind.effects import Hidden, Truth, apply, bare, draw_hidden
from blind.plates import ALUMINIUM, STEEL, Rng, Specimen, config, draw_specimen, log_uniform, wires_of
from blind.ritz import modes
from blind.workshop import ASPECT, mixed

ALONE = (
    "point_mass", "stiffness_loss", "orthotropy", "aspect_ratio", "poisson_ratio", "thickness_taper", "edge_spring",
    "ground_spring", "density", "thickness", "point_mass", "stiffness_loss", "support_asymmetry",
)  # fmt: skip
PAIRS = (
    ("point_mass", "orthotropy"), ("stiffness_loss", "aspect_ratio"), ("edge_spring", "point_mass"),
    ("thickness_taper", "poisson_ratio"), ("ground_spring", "orthotropy"), ("stiffness_loss", "poisson_ratio"),
    ("aspect_ratio", "point_mass"), ("thickness_taper", "edge_spring"),
)  # fmt: skip
N_NOTHING, N_TWO, N_ONE = 50, 40, 110
N_RIGID = 3
N_FREQUENCY = (10, 20)
SCATTER = (0.0005, 0.003)
# How a value is printed: decimals, or significant digits.
PRINTED = (("decimals", 1), ("decimals", 2), ("digits", 3), ("digits", 4))
E_STD = 0.01
N_MODE, N_TURN, STEP = 90, 12, 1e-5


@cache
def suite() -> tuple[Slot, ...]:
    """All slots, mixed."""
    return mixed(ALONE, PAIRS, (N_NOTHING, 0, N_TWO, N_ONE), ("",), 201)


def draw(seed_set: str, index: int, by: str | None = None) -> Case:
    """One case: the same for ever for a seed set and an index from 0 to 199.

    Args:
        seed_set: any word.
        index: from 0 to 199.
        by: which truth; left out, each makes every other case.
    """
    slot, rng = suite()[index], np.random.default_rng([*seed_of(seed_set, index), 2])
    kind = STEEL if rng.random() < 0.5 else ALUMINIUM
    specimen = draw_specimen(rng, kind, False, frozenset(slot.names))
    whole = {name: {"value": value["value"]} for name, value in specimen.stated.items()}
    right = replace(
        specimen.plate, length_x=kind.sides[0], length_y=kind.sides[1], density=kind.density,
        thickness=kind.thickness, by=by or ("spectral" if index % 2 else "ritz"),
    )  # fmt: skip
    specimen = replace(specimen, plate=right, stated=whole)
    hidden = [_hidden(rng, name, specimen, slot.turn) for name in slot.names]
    scales_all = bool({"density", "thickness"} & set(slot.names))
    e_known, k_known = bool(rng.random() < (2 / 3 if scales_all else 1 / 3)), bool(rng.random() < 0.5)
    n = int(rng.integers(N_FREQUENCY[0], N_FREQUENCY[1] + 1))
    missing = int(rng.choice([0, 0, 1, 2]))
    chosen = np.sort(rng.permutation(n + missing)[:n]) + N_RIGID
    truth = _with(specimen, hidden)
    exact = modes(truth.plate).frequency[chosen]
    scatter = log_uniform(rng, *SCATTER)
    style, digits = PRINTED[rng.integers(len(PRINTED))]
    places = [digits if style == "decimals" else digits - 1 - floor(log10(f)) for f in exact]
    # Two modes that change places are numbered as they are found.
    values = np.sort(exact * (1 + scatter * rng.standard_normal(n)))
    values = np.array([round(float(v), p) for v, p in zip(values, places, strict=True)])
    std = np.sqrt((scatter * exact) ** 2 + 10.0 ** (-2 * np.array(places)) / 12)
    told = bool(rng.random() < 0.5)
    e_off = E_STD * float(rng.standard_normal())
    settings = _config(specimen, e_known, k_known, e_off, index)
    settings["measurement"] = {
        "natural_frequencies": {
            int(mode) + 1: {"value": float(v), "std": float(f"{s:.2g}")} if told else float(v)
            for mode, v, s in zip(chosen, values, std, strict=True)
        }
    }
    falls = []
    for left_out in range(len(hidden)):
        without = _with(specimen, [h for k, h in enumerate(hidden) if k != left_out])
        model = Searched(without, len(wires_of(specimen)), e_known, k_known)
        falls.append(model.left(exact, chosen, std / exact, told))
    return Case(
        name=f"{index:03d}", kind=slot.kind, config=settings, measurement=None, truth=hidden, noise=scatter,
        shows=tuple(falls), youngs_modulus=right.young,
        young_is_seen=not (scales_all or known(settings)), sides=kind.sides, file="", specimen=specimen,
        extra={"n_frequency": float(n), "std_told": float(told)}, stratum="tables",
        detectable=tuple(seen(fall, len(h.parameters)) for fall, h in zip(falls, hidden, strict=True)),
    )  # fmt: skip


def _hidden(rng: Rng, name: str, specimen: Specimen, turn: int) -> Hidden:
    one = draw_hidden(rng, name, specimen, turn)
    if name == "stiffness_loss":
        one = replace(one, parameters=one.parameters | {"aspect": log_uniform(rng, *ASPECT)})
    return one


def _with(specimen: Specimen, hidden: list[Hidden]) -> Truth:
    truth = bare(specimen)
    for one in hidden:
        truth = apply(truth, specimen, one)
    return truth


def _config(specimen: Specimen, e_known: bool, k_known: bool, e_off: float, seed: int) -> dict[str, Any]:
    """The YAML config: no damping and no sensors, as natural frequencies know of neither."""
    settings = config(specimen, "", with_loss=False, n_average=None, seed=seed)
    if e_known:
        stated = specimen.plate.young / (1 + e_off)
        settings["effects"]["plate"]["youngs_modulus"] = {"value": round(stated, -7), "std": round(E_STD * stated, -7)}
    settings["effects"]["wires"]["viscous_damping"] = 0.0
    if k_known:
        settings["effects"]["wires"]["stiffness"] = float(f"{specimen.stiffness:.4g}")
    return settings


class Searched:
    """Natural frequencies over E and the wires' stiffness in a basis of the truth's lowest modes.

    Args:
        truth: without the effect in question.
        n_wire: how many of its springs are the config's wires.
        e_known: whether E has a standard deviation.
        k_known: whether the wires' stiffness is a number.
    """

    def __init__(self, truth: Truth, n_wire: int, e_known: bool, k_known: bool) -> None:
        found = modes(truth.plate)
        springs = np.array(truth.plate.springs)
        rows = found.deflection(springs[:n_wire, :2].tolist())[:, :N_MODE]
        self.wires = rows.T @ (springs[:n_wire, 2:] * rows)
        self.plate = np.diag(found.eigenvalue[:N_MODE]) - self.wires
        self.penalty = np.array([1 / E_STD if e_known else 0.0, 1e9 if k_known else 0.1])

    def __call__(self, log_ratio: np.ndarray) -> np.ndarray:
        """Logarithms of ω² [n_mode]."""
        young, stiffness = np.exp(log_ratio)
        return np.log(np.linalg.eigvalsh(young * self.plate + stiffness * self.wires).clip(1e-6))

    def left(self, exact: np.ndarray, chosen: np.ndarray, std: np.ndarray, told: bool) -> float:
        """The expected fall of −2 log likelihood for what these frequencies have beyond this model.

        With a scatter that is told it is χ² of what the best E and k leave. One that is not told is fitted, too, and
        n numbers less p fitted ones then fall by (n − p) ln(1 + χ² / (n − p)).

        Args:
            exact: natural frequencies [Hz].
            chosen: their indices.
            std: of each, relative [-].
            told: whether the config says so.
        """
        aim = 2 * np.log(2 * np.pi * exact)

        def residual(at: np.ndarray) -> np.ndarray:
            return np.concatenate([(self(at)[chosen] - aim) / 2 / std, self.penalty * at])

        at = np.zeros(2)
        now = residual(at)
        for _ in range(N_TURN):
            slope = np.stack([(residual(at + STEP * unit) - now) / STEP for unit in np.eye(2)], axis=1)
            move = np.linalg.lstsq(slope, -now, rcond=1e-12)[0]
            move = move * min(1.0, 0.3 / max(float(np.abs(move).max()), 1e-12))
            tried = {part: residual(at + part * move) for part in (1.0, 0.3)}
            part, best = min(tried.items(), key=lambda item: float(np.linalg.norm(item[1])))
            if np.linalg.norm(best) >= np.linalg.norm(now):
                break
            at, now = at + part * move, best
        left = float(now @ now)
        free = len(exact) - int((self.penalty < 1).sum())
        return left if told else free * float(np.log1p(left / free))
