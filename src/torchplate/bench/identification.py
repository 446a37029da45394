"""The paper's whole identification, by this package and by SciPy's Differential Evolution on the peer."""

import time
from typing import Any

import numpy as np
import scipy.optimize
import torch
from torch import Tensor

from torchplate.bench.peer import Peer
from torchplate.bench.problem import LINES, N_MEMBER, REFERENCE, RESPONSE, TRUTH, paper_model
from torchplate.discrepancy import Evidence, Objective
from torchplate.measurement import SI_UNIT, Channel, Measurement
from torchplate.model import PlateModel, reduce
from torchplate.search import DifferentialEvolution, least_squares, minimize

NOISE = 0.01
# Done when the objective is this close to the best that is known.
CLOSE_TO_BEST = 1e-3
N_GENERATION = 300
# Generations of Differential Evolution before the gradients finish.
N_BASIN = 5


def identification() -> dict[str, Any]:
    """Seconds and evaluations to within 0.1 % of the best objective, preparation included."""
    model = paper_model()
    generator = torch.Generator().manual_seed(1)
    clean = model.frf(torch.tensor(TRUTH, dtype=torch.float64), LINES)
    noise = torch.randn(clean.shape, dtype=clean.dtype, generator=generator)
    measured = clean + NOISE * noise * clean.abs().square().mean(0).sqrt()
    channels = tuple(Channel(label) for label in (*RESPONSE, *REFERENCE))
    pairs = torch.ones(1, len(REFERENCE), dtype=torch.bool)
    measurement = Measurement(LINES, measured, pairs, channels[:1], channels[1:], "accelerance", SI_UNIT["accelerance"])
    best = _best(model, measurement)

    rows = [_search(model, measurement, best, in_single) for in_single in (False, True)]

    began = time.perf_counter()
    searched = _objective(model, measurement)
    basin = minimize(
        lambda position: searched(model.space.to_si(position)),
        DifferentialEvolution(n_member=N_MEMBER, strategy="rand/1/bin", differential_weight=0.8, crossover_rate=0.8),
        n_dimension=len(model.names),
        n_generation=N_BASIN,
        generator=torch.Generator().manual_seed(0),
    )
    # On so few parameters differences of one batch are four times as fast as forward mode, and as good for a step.
    finish = least_squares(
        lambda position: searched.residual(model.space.to_si(position)), basin.best_position, jacobian="central"
    )
    rows.append(
        {
            "name": f"torchplate, {N_BASIN} generations of DE and least squares",
            "seconds": time.perf_counter() - began,
            "n_evaluation": int(basin.n_evaluation + finish.n_evaluation),
            "objective": float(searched(model.space.to_si(finish.position))),
        }
    )
    rows.append(_peer(model, measured, rows[0]["n_evaluation"]))
    for row in rows:
        row["over_best"] = row["objective"] / best - 1
        row["ratio"] = rows[-1]["seconds"] / row["seconds"]
    return {"best": best, "n_thread": torch.get_num_threads(), "rows": rows}


def _search(model: PlateModel, measurement: Measurement, best: float, in_single: bool) -> dict[str, Any]:
    """Differential Evolution until it is close to the best, preparation included."""
    marks: list[tuple[int, Tensor]] = []
    began = time.perf_counter()
    whole = _objective(model, measurement)
    searched = whole.of(whole.model.in_single_precision()) if in_single else whole
    prepared = time.perf_counter() - began

    @torch.no_grad()
    def objective(position: Tensor) -> Tensor:
        return searched(model.space.to_si(position))

    minimize(
        objective,
        DifferentialEvolution(n_member=N_MEMBER, strategy="rand/1/bin", differential_weight=0.8, crossover_rate=0.8),
        n_dimension=len(model.names),
        n_generation=N_GENERATION,
        target=best * (1 + CLOSE_TO_BEST),
        generator=torch.Generator().manual_seed(0),
        on_generation=lambda progress: marks.append((int(progress.n_evaluation), progress.best_position)),
    )
    n_evaluation, position = marks[-1]
    # What was found is said in double precision.
    found = float(whole(model.space.to_si(position)))
    return {
        "name": "torchplate, DE" + ", single precision" * in_single,
        "seconds": time.perf_counter() - began,
        "prepared_s": prepared,
        "n_evaluation": n_evaluation,
        "objective": found,
    }


def _objective(model: PlateModel, measurement: Measurement) -> Objective:
    found = reduce(model, measurement.frequency)
    assert found is not None
    return Objective(found[0], Evidence(measurement))


def _best(model: PlateModel, measurement: Measurement) -> float:
    """The objective's minimum on all dofs: from the truth, by a long local search on the objective itself."""
    searched = _objective(model, measurement)
    start = model.space.to_cube(torch.tensor(TRUTH, dtype=torch.float64))

    def value(position: np.ndarray) -> float:
        return float(searched(model.space.to_si(torch.from_numpy(position))))

    found = scipy.optimize.minimize(
        value,
        start.numpy(),
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * len(start),
        options={"xatol": 1e-7, "fatol": 1e-9, "maxfev": 2000},
    )
    return float(found.fun)


def _peer(model: PlateModel, measured: torch.Tensor, n_evaluation: int) -> dict[str, Any]:
    """SciPy's Differential Evolution with the same settings and evaluations, one candidate at a time."""
    peer, target = Peer(model), measured.numpy()
    norm = np.linalg.norm(target, axis=0)

    def objective(theta: np.ndarray) -> float:
        return float((np.linalg.norm(target - peer.frf(theta), axis=0) / norm).sum())

    space = model.space
    began = time.perf_counter()
    found = scipy.optimize.differential_evolution(
        objective,
        scipy.optimize.Bounds(space.low.numpy(), space.high.numpy()),
        strategy="rand1bin",
        popsize=N_MEMBER // len(model.names),
        maxiter=max(1, n_evaluation // N_MEMBER - 1),
        mutation=0.8,
        recombination=0.8,
        rng=0,
        polish=False,
        init="random",
        tol=0.0,
    )
    taken = time.perf_counter() - began
    return {
        "name": "SciPy, DE, one candidate at a time",
        "seconds": taken,
        "n_evaluation": found.nfev,
        "objective": found.fun,
    }
