"""Formulas and crossovers of the ten variants against hand arithmetic; the whole against SciPy."""

from itertools import permutations

import numpy as np
import pytest
import torch
from scipy import optimize, stats
from torch import Tensor

from torchplate.search import BOUNDS, STRATEGIES, Candidates, DifferentialEvolution, minimize
from torchplate.search.crossover import binomial, exponential
from torchplate.search.mutation import MUTATIONS, distinct_indices


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


# One coordinate, F = 0.5, target 1, best 2, members 10, 20, 40, 80, 160: each donor worked by hand.
BY_HAND = {
    "rand/1": 10 + 0.5 * (20 - 40),
    "best/1": 2 + 0.5 * (10 - 20),
    "rand/2": 10 + 0.5 * (20 - 40) + 0.5 * (80 - 160),
    "best/2": 2 + 0.5 * (10 - 20) + 0.5 * (40 - 80),
    "current-to-best/1": 1 + 0.5 * (2 - 1) + 0.5 * (10 - 20),
}


def test_there_are_ten_variants():
    assert len(STRATEGIES) == 10
    assert set(STRATEGIES) == {f"{mutation}/{cross}" for mutation in BY_HAND for cross in ("bin", "exp")}


@pytest.mark.parametrize("name", sorted(MUTATIONS))
def test_a_donor_is_what_hand_arithmetic_gives(name):
    x, b, *r = (torch.full((1, 1), float(v)) for v in (1, 2, 10, 20, 40, 80, 160))
    donor = MUTATIONS[name].formula(x, b, r[: MUTATIONS[name].n_index], torch.full((1, 1), 0.5))
    assert float(donor) == BY_HAND[name]


@pytest.mark.parametrize("strategy", sorted(STRATEGIES))
def test_with_full_crossover_a_trial_is_a_donor_of_the_other_members(strategy):
    """With as few members as the formula allows, each trial is one of the permutations of the others."""
    mutation, _ = STRATEGIES[strategy]
    n_member = mutation.n_index + 1
    population = 0.45 + 0.1 * torch.rand((n_member, 3), generator=seeded(1), dtype=torch.float64)
    optimizer = DifferentialEvolution(strategy=strategy, n_member=n_member, differential_weight=0.7, crossover_rate=1.0)
    state = optimizer.init(population, torch.arange(n_member, dtype=torch.float64).flip(0))
    best = population[-1]
    candidates, _ = optimizer.ask(state, seeded(2))
    for i, trial in enumerate(candidates.position):
        others = [population[k] for k in range(n_member) if k != i]
        possible = [
            mutation.formula(population[i], best, list(order), torch.tensor(0.7)) for order in permutations(others)
        ]
        assert any(torch.allclose(trial, donor, atol=1e-12) for donor in possible)


@pytest.mark.parametrize("n_index", [1, 2, 5])
def test_indices_are_distinct_and_evenly_spread(n_index):
    index = distinct_indices((4000,), 7, n_index, seeded(3))
    own = torch.arange(7).expand(4000, 7)
    together = torch.cat((own.unsqueeze(0), index)).sort(dim=0).values
    assert (together.diff(dim=0) > 0).all()
    assert (index >= 0).all()
    assert (index < 7).all()
    for j in range(n_index):
        for member in range(7):
            share = torch.bincount(index[j, :, member], minlength=7) / 4000
            others = share[torch.arange(7) != member]
            # Binomial deviation sqrt(1/6 · 5/6 / 4000) = 0.0059; 210 comparisons, hence 5 of them.
            assert ((others - 1 / 6).abs() < 0.03).all()


def test_binomial_crossover_takes_what_lies_below_the_rate_and_j_rand():
    uniform = torch.tensor([[0.1, 0.9, 0.5, 0.79], [0.9, 0.9, 0.9, 0.9]])
    mask = binomial(uniform, torch.tensor([[1], [2]]), torch.tensor([[0.8]]))
    assert mask.tolist() == [[True, True, True, True], [False, False, True, False]]
    assert binomial(uniform, torch.tensor([[0], [0]]), torch.tensor([[0.5]])).tolist()[0] == [
        True,
        False,
        False,
        False,
    ]


def test_exponential_crossover_takes_a_cyclic_run():
    uniform = torch.tensor([[0.1, 0.9, 0.1, 0.1], [0.1, 0.1, 0.9, 0.1], [0.9, 0.1, 0.1, 0.1], [0.1, 0.1, 0.1, 0.9]])
    mask = exponential(uniform, torch.tensor([[1], [3], [0], [2]]), torch.tensor([[0.5]]))
    # Runs of 2 from 1, 3 from 3 (over the end), 1 from 0, all 4.
    assert mask.int().tolist() == [[0, 1, 1, 0], [1, 1, 0, 1], [1, 0, 0, 0], [1, 1, 1, 1]]


@pytest.mark.parametrize("cross", ["bin", "exp"])
@pytest.mark.parametrize(("rate", "n_changed"), [(0.0, 1), (1.0, 5)])
def test_crossover_changes_one_coordinate_at_rate_0_and_all_at_rate_1(cross, rate, n_changed):
    population = 0.4 + 0.2 * torch.rand((50, 8, 5), generator=seeded(4), dtype=torch.float64)
    optimizer = DifferentialEvolution(strategy=f"rand/1/{cross}", n_member=8, crossover_rate=rate)
    state = optimizer.init(population, population.sum(dim=-1))
    candidates, _ = optimizer.ask(state, seeded(5))
    changed = candidates.position != population
    assert (changed.sum(dim=-1) == n_changed).all()
    # Every coordinate has its turn as j_rand: 400 draws of 5, a fifth each, ± 5 deviations of 0.02.
    assert ((changed.double().mean(dim=(0, 1)) - n_changed / 5).abs() < 0.1).all()


def test_the_mean_run_of_exponential_crossover_is_a_geometric_sum():
    uniform = torch.rand((20000, 4), generator=seeded(6), dtype=torch.float64)
    start = torch.randint(4, (20000, 1), generator=seeded(7))
    length = exponential(uniform, start, torch.tensor([[0.6]], dtype=torch.float64)).sum(dim=-1).double()
    # E = 1 + 0.6 + 0.36 + 0.216; the deviation of the mean is below 1.5 / sqrt(20000) = 0.011.
    assert abs(float(length.mean()) - 2.176) < 0.05


def test_a_tie_replaces_its_target_and_a_worse_trial_does_not():
    optimizer = DifferentialEvolution(n_member=4)
    population = torch.tensor([[0.1], [0.2], [0.3], [0.4]])
    state = optimizer.init(population, torch.tensor([1.0, 2.0, 3.0, 4.0]))
    trial = Candidates(population + 0.5, torch.tensor([True, True, True, False]))
    state = optimizer.tell(state, trial, torch.tensor([1.0, 2.5, 2.5, 0.0]))
    assert torch.allclose(state.population, torch.tensor([[0.6], [0.2], [0.8], [0.4]]))
    assert state.fitness.tolist() == [1.0, 2.0, 2.5, 4.0]


def test_bound_rules_do_what_they_say():
    position = torch.tensor([[-0.3, 1.2, 0.5, 2.1]])
    target = torch.tensor([[0.2, 0.6, 0.1, 0.9]])
    by_hand = {
        "reflect": [[0.3, 0.8, 0.5, 0.1]],
        "midpoint": [[0.1, 0.8, 0.5, 0.95]],
        "clip": [[0.0, 1.0, 0.5, 1.0]],
    }
    for name, expected in by_hand.items():
        assert torch.allclose(BOUNDS[name](position, target, seeded(8)), torch.tensor(expected)), name
    many = BOUNDS["redraw"](position.expand(5000, 4), target.expand(5000, 4), seeded(9))
    assert (many[:, 2] == 0.5).all()
    # Even over [0, 1]: Kolmogorov-Smirnov, seed fixed; false alarm 1 in 1000.
    assert stats.kstest(many[:, 0].numpy(), "uniform").pvalue > 1e-3
    assert set(BOUNDS) == {*by_hand, "redraw"}


@pytest.mark.parametrize("strategy", sorted(STRATEGIES))
def test_every_strategy_finds_the_bottom_of_a_rotated_bowl(strategy, ellipsoid):
    outcome = minimize(
        ellipsoid.objective,
        DifferentialEvolution(strategy=strategy, n_member=32),
        n_dimension=4,
        batch_shape=(100,),
        n_evaluation=6400,
        target=ellipsoid.target,
        generator=seeded(10),
    )
    assert int(ellipsoid.reached(outcome.best_position).sum()) >= 95


N_MEMBER, TARGET = 24, 1e-4


def evaluations_to_target(ellipsoid, weight: float, n_run: int, seed: int) -> Tensor:
    return minimize(
        ellipsoid.objective,
        DifferentialEvolution("rand/1/bin", N_MEMBER, weight, crossover_rate=0.8, bound="redraw"),
        n_dimension=4,
        batch_shape=(n_run,),
        n_generation=1000,
        target=TARGET,
        tolerance=None,
        generator=seeded(seed),
    ).n_evaluation


def scipy_evaluations_to_target(ellipsoid, seed: int) -> int:
    def stop(intermediate_result: optimize.OptimizeResult) -> None:
        if intermediate_result.fun <= TARGET:
            raise StopIteration

    result = optimize.differential_evolution(
        lambda x: ellipsoid.objective(torch.from_numpy(np.ascontiguousarray(x.T))).numpy(),
        bounds=[(0.0, 1.0)] * 4,
        strategy="rand1bin",
        popsize=N_MEMBER // 4,
        mutation=0.8,
        recombination=0.8,
        init="random",
        updating="deferred",
        vectorized=True,
        polish=False,
        tol=0.0,
        callback=stop,
        rng=seed,
    )
    return N_MEMBER * (1 + result.nit)


@pytest.mark.check
def test_rand_1_bin_needs_as_many_evaluations_as_that_of_scipy(ellipsoid):
    """Two-sample Kolmogorov-Smirnov test at 1 %: one seed in a hundred would fail a right program."""
    theirs = np.array([scipy_evaluations_to_target(ellipsoid, seed) for seed in range(100)])
    ours = evaluations_to_target(ellipsoid, 0.8, n_run=2000, seed=11).numpy()
    assert stats.ks_2samp(ours, theirs).pvalue > 0.01
    # The test would notice F = 0.75, so that passing means something.
    other = evaluations_to_target(ellipsoid, 0.75, n_run=2000, seed=11).numpy()
    assert stats.ks_2samp(other, theirs).pvalue < 0.01


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"strategy": "rand/1/bni"}, r"No strategy named 'rand/1/bni'\. Did you mean 'rand/1/bin'\? Choose"),
        ({"bound": "reflct"}, r"No bound named 'reflct'\. Did you mean 'reflect'\? Choose"),
        ({"differential_weight": 0.0}, r"in \(0, 2\], got 0\.0\. Try"),
        ({"crossover_rate": 1.2}, r"in \[0, 1\], got 1\.2\. Try"),
        ({"strategy": "rand/2/exp", "n_member": 5}, r"at least 6, got 5\. Raise"),
    ],
)
def test_a_wrong_setting_is_refused_with_what_to_do(settings, message):
    with pytest.raises(ValueError, match=message):
        DifferentialEvolution(**settings)
