"""The searches beside those of other packages: evaluations to a target, whether they differ by chance, and times.

Each algorithm has the same members, the same problems and the same number of seeds. SciPy is always there; pymoo, pygmo
(pagmo) and evosax take part where they are installed, and the table says so where they are not. Ours are all seeds of a
problem in one batch: what one search takes of it is told.
"""

import functools
import importlib.util
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize
import scipy.stats
import torch
from torch import Tensor

from torchplate.search import ArtificialBeeColony, DifferentialEvolution, LShade, minimize

N_MEMBER = 40
N_SEED = 21
# A search that has not met the target by then counts as this many.
N_EVALUATION = 40_000


class Problem(NamedTuple):
    """An objective on the unit cube whose only minimum, 0, is off the middle.

    Attributes:
        name: of the problem.
        optimum: where it is.
        target: what no other basin reaches.
        values: objective of positions less the optimum [*batch n], in NumPy.
    """

    name: str
    optimum: tuple[float, ...]
    target: float
    values: Callable[[np.ndarray], np.ndarray]


def _ellipsoid(z: np.ndarray) -> np.ndarray:
    return ((z * np.asarray([1.0, 2.0, 3.0, 4.0])) ** 2).sum(-1)


def _rosenbrock(z: np.ndarray) -> np.ndarray:
    z = 1.0 + z * np.asarray([4.0, 3.0, 3.5])
    return (100.0 * (z[..., 1:] - z[..., :-1] ** 2) ** 2 + (1.0 - z[..., :-1]) ** 2).sum(-1)


def _rastrigin(z: np.ndarray) -> np.ndarray:
    z = z * np.asarray([8.0, 10.0, 9.0])
    return (z**2 - 10.0 * np.cos(2 * math.pi * z) + 10.0).sum(-1)


PROBLEMS = (
    Problem("ellipsoid, 4", (0.23, 0.71, 0.38, 0.64), 1e-4, _ellipsoid),
    Problem("Rosenbrock, 3", (0.7, 0.55, 0.62), 1e-3, _rosenbrock),
    Problem("Rastrigin, 3", (0.31, 0.57, 0.68), 0.1, _rastrigin),
)


class Counted:
    """An objective of single positions or rows of them, that knows at which evaluation the target was met."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.n, self.met = problem, 0, N_EVALUATION

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Values of rows [n_row, n]."""
        value = self.problem.values(rows - np.asarray(self.problem.optimum))
        hit = np.flatnonzero(value <= self.problem.target)
        if len(hit):
            # To the end of the generation, as ours are counted.
            self.met = min(self.met, N_MEMBER * math.ceil((self.n + int(hit[0]) + 1) / N_MEMBER))
        self.n += len(rows)
        return value

    @property
    def done(self) -> bool:
        """Whether there is no more to see."""
        return self.met < N_EVALUATION or self.n >= N_EVALUATION


def ours(problem: Problem, optimizer: Any) -> list[int]:
    """Evaluations of all seeds at once, to the end of the generation."""
    optimum = torch.tensor(problem.optimum, dtype=torch.float64)

    def objective(position: Tensor) -> Tensor:
        return torch.from_numpy(problem.values((position - optimum).numpy()))

    found = minimize(
        objective,
        optimizer,
        n_dimension=len(problem.optimum),
        batch_shape=(N_SEED,),
        n_evaluation=N_EVALUATION,
        target=problem.target,
        tolerance=None,
        generator=torch.Generator().manual_seed(0),
    )
    met = found.best_objective <= problem.target
    return torch.where(met, found.n_evaluation, N_EVALUATION).tolist()


def scipy_de(problem: Problem, seed: int) -> Counted:
    """`scipy.optimize.differential_evolution`, rand/1/bin."""
    counted, n = Counted(problem), len(problem.optimum)

    def stop(*_: Any, **__: Any) -> bool:
        return counted.done

    population = np.random.default_rng(seed).random((N_MEMBER, n))
    # Its stubs know objectives of one position only.
    search: Any = scipy.optimize.differential_evolution
    search(
        lambda x: counted(x.T),
        [(0.0, 1.0)] * n,
        strategy="rand1bin",
        mutation=0.8,
        recombination=0.8,
        init=population,
        maxiter=N_EVALUATION // N_MEMBER,
        updating="deferred",
        vectorized=True,
        polish=False,
        tol=0.0,
        callback=stop,
        rng=seed,
    )
    return counted


def pymoo_de(problem: Problem, seed: int) -> Counted:
    """Pymoo's `DE`, rand/1/bin."""
    from pymoo.algorithms.soo.nonconvex.de import DE
    from pymoo.core.problem import Problem as Space

    counted = Counted(problem)

    class Objective(Space):  # type: ignore[misc]
        def _evaluate(self, x: np.ndarray, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = counted(x)

    method = DE(pop_size=N_MEMBER, variant="DE/rand/1/bin", CR=0.8, F=0.8, dither=None, jitter=False)
    method.setup(Objective(n_var=len(problem.optimum), xl=0.0, xu=1.0), seed=seed, verbose=False)
    while not counted.done and method.has_next():
        method.next()
    return counted


def _pagmo(problem: Problem, seed: int, algorithm: str, **options: Any) -> Counted:
    import pygmo

    counted = Counted(problem)

    class Objective:
        def fitness(self, x: np.ndarray) -> list[float]:
            return [float(counted(x[None])[0])]

        def get_bounds(self) -> tuple[list[float], list[float]]:
            return [0.0] * len(problem.optimum), [1.0] * len(problem.optimum)

    # pagmo may copy what it is given: this one stays itself.
    Objective.__deepcopy__ = lambda self, _: self  # type: ignore[attr-defined]
    method = pygmo.algorithm(getattr(pygmo, algorithm)(gen=1, seed=seed, **options))
    population = pygmo.population(pygmo.problem(Objective()), N_MEMBER, seed=seed)
    while not counted.done:
        population = method.evolve(population)
    return counted


def pagmo_de(problem: Problem, seed: int) -> Counted:
    """Pagmo's `de`, rand/1/bin."""
    return _pagmo(problem, seed, "de", F=0.8, CR=0.8, variant=7, ftol=0.0, xtol=0.0)


def pagmo_abc(problem: Problem, seed: int) -> Counted:
    """Pagmo's `bee_colony`: sources and their onlookers, its own limit."""
    return _pagmo(problem, seed, "bee_colony", limit=20)


@functools.cache
def _evosax(n_dimension: int) -> Any:
    """The method of so many numbers: what it has compiled belongs to the object."""
    import jax
    from evosax.algorithms import DifferentialEvolution as Theirs

    jax.config.update("jax_enable_x64", True)
    return Theirs(population_size=N_MEMBER, solution=jax.numpy.zeros(n_dimension))


def evosax_de(problem: Problem, seed: int) -> Counted:
    """Evosax's `DifferentialEvolution`, rand/1/bin; it knows no bounds: what leaves the cube is put on its edge."""
    import jax

    counted, n = Counted(problem), len(problem.optimum)
    method = _evosax(n)
    settings = method.default_params.replace(elitism=False, crossover_rate=0.8, differential_weight=0.8)
    first, key = jax.random.split(jax.random.key(seed))
    members = jax.random.uniform(first, (N_MEMBER, n))
    state = method.init(first, members, jax.numpy.asarray(counted(np.asarray(members))), settings)
    while not counted.done:
        key, asking, telling = jax.random.split(key, 3)
        trial, state = method.ask(asking, state, settings)
        trial = jax.numpy.clip(trial, 0.0, 1.0)
        state, _ = method.tell(telling, trial, jax.numpy.asarray(counted(np.asarray(trial))), state, settings)
    return counted


DE = DifferentialEvolution("rand/1/bin", N_MEMBER, 0.8, crossover_rate=0.8)
# Ours, and the peers of the same algorithm.
GROUPS: tuple[tuple[str, Any, tuple[tuple[str, str, Any], ...]], ...] = (
    (
        "DE rand/1/bin",
        DE,
        (
            ("SciPy", "scipy", scipy_de),
            ("pymoo", "pymoo", pymoo_de),
            ("pagmo", "pygmo", pagmo_de),
            ("evosax", "evosax", evosax_de),
        ),
    ),
    ("ABC", ArtificialBeeColony(n_member=N_MEMBER), (("pagmo", "pygmo", pagmo_abc),)),
    ("L-SHADE", LShade(n_member=N_MEMBER), (("SciPy DE", "scipy", scipy_de),)),
)


def searches() -> str:
    """The table in Markdown."""
    lines = [
        f"Median evaluations to the target over {N_SEED} seeds, to the end of a generation of {N_MEMBER} members; F",
        "and CR 0.8. p is of the rank-sum test (Mann and Whitney, two-sided) that ours and theirs are alike. A search",
        f"that has not met the target counts as {N_EVALUATION} evaluations. Milliseconds are of one search",
        "on the processor, which others on the machine do not lengthen: ours of all seeds in one batch over their",
        "number, theirs the median of one after another.",
        "",
        "| problem | algorithm | ours | met | ms | package | theirs | met | ms | p |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    known: dict[tuple[str, str], tuple[list[int], float]] = {}
    for problem in PROBLEMS:
        for algorithm, optimizer, peers in GROUPS:
            began = time.process_time()
            evaluations = ours(problem, optimizer)
            own = evaluations, (time.process_time() - began) / N_SEED
            for package, module, run in peers:
                head = f"| {problem.name} | {algorithm} | {_told(own)} | {package} |"
                if importlib.util.find_spec(module) is None:
                    lines.append(f"{head} not installed | | | |")
                    continue
                key = problem.name, run.__name__
                if key not in known:
                    known[key] = _timed(run, problem)
                p = float(scipy.stats.mannwhitneyu(evaluations, known[key][0]).pvalue)
                lines.append(f"{head} {_told(known[key])} | {p:.1g} |")
    return "\n".join(lines)


def _timed(run: Callable[[Problem, int], Counted], problem: Problem) -> tuple[list[int], float]:
    """Evaluations of each seed, and the median of their seconds: what is compiled at the first is no part of it."""
    met, taken = [], []
    for seed in range(N_SEED):
        began = time.process_time()
        met.append(run(problem, seed).met)
        taken.append(time.process_time() - began)
    return met, float(np.median(taken))


def _told(found: tuple[list[int], float]) -> str:
    evaluations, seconds = found
    met = sum(one < N_EVALUATION for one in evaluations)
    return f"{np.median(evaluations):.0f} | {met} of {len(evaluations)} | {1e3 * seconds:.3g}"
