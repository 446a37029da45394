"""What holds for every optimiser, drawn from the registry."""

import io
from typing import Any

import pytest
import torch
from torch import Tensor

from torchplate.search import (
    OPTIMIZERS,
    Candidates,
    Optimizer,
    Outcome,
    Progress,
    State,
    Status,
    minimize,
    optimizer_named,
)


@pytest.fixture(params=sorted(OPTIMIZERS))
def optimizer(request: pytest.FixtureRequest) -> Optimizer[Any]:
    return OPTIMIZERS[request.param](n_member=12)


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def bowl(x: Tensor) -> Tensor:
    """A slanted bowl whose value at the optimum (0.3, 0.8, 0.45) is 2."""
    z = x - torch.tensor([0.3, 0.8, 0.45], dtype=x.dtype)
    return 2.0 + z.square().sum(dim=-1) + 0.5 * (z[..., 0] + z[..., 1]).abs()


@pytest.mark.parametrize("name", sorted(OPTIMIZERS))
def test_95_of_100_seeds_reach_the_basin(name, problem):
    outcome = minimize(
        problem.objective,
        OPTIMIZERS[name](n_member=problem.n_member),
        n_dimension=problem.n_dimension,
        batch_shape=(100,),
        n_evaluation=problem.n_evaluation,
        target=problem.target,
        generator=seeded(1),
    )
    n_reached = int(problem.reached(outcome.best_position).sum())
    assert n_reached >= 95, f"{name} reaches the basin of {problem.name} from {n_reached} of 100 seeds"


def test_an_optimum_in_a_corner_is_found(optimizer):
    corner = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    outcome = minimize(
        lambda x: ((x - corner) * torch.tensor([1.0, 2.0, 3.0])).abs().sum(dim=-1),
        optimizer,
        n_dimension=3,
        batch_shape=(20,),
        n_evaluation=3000,
        target=5e-4,
        generator=seeded(3),
    )
    # 20 searches; 1e-3 of the interval is what a report would call "on the bound".
    assert ((outcome.best_position - corner).abs() < 1e-3).all()


def test_every_candidate_lies_on_the_unit_cube(optimizer):
    seen = []

    def objective(x: Tensor) -> Tensor:
        seen.append(x)
        return (x - torch.tensor([0.02, 0.97], dtype=x.dtype)).square().sum(dim=-1)

    minimize(
        objective, optimizer, n_dimension=2, batch_shape=(10,), n_generation=30, generator=seeded(2), tolerance=None
    )
    assert all(((x >= 0.0) & (x <= 1.0)).all() for x in seen)


def test_the_count_of_evaluations_is_the_number_of_places_evaluated(optimizer):
    n_seen = 0

    def objective(x: Tensor) -> Tensor:
        nonlocal n_seen
        n_seen += x.shape[0]
        return torch.ones(x.shape[0], dtype=x.dtype)  # a plateau, so that scouts fly too

    outcome = minimize(objective, optimizer, n_dimension=2, n_generation=40, generator=seeded(4), tolerance=None)
    assert int(outcome.n_evaluation) == n_seen
    assert int(outcome.n_generation) == 40


@pytest.mark.parametrize("n_evaluation", [100, 101, 137])
def test_the_budget_of_evaluations_is_kept_and_nearly_used(optimizer, n_evaluation):
    outcome = minimize(bowl, optimizer, n_dimension=3, batch_shape=(3,), n_evaluation=n_evaluation, generator=seeded(4))
    assert (outcome.n_evaluation <= n_evaluation).all()
    assert (outcome.n_evaluation > n_evaluation - optimizer.n_member).all()
    assert outcome.status == (Status.budget,) * 3


def test_the_best_is_the_objective_at_the_best_position_and_never_rises(optimizer):
    history: list[Progress] = []
    outcome = minimize(
        bowl,
        optimizer,
        n_dimension=3,
        batch_shape=(4,),
        n_generation=60,
        generator=seeded(5),
        on_generation=history.append,
    )
    best = torch.stack([progress.best_objective for progress in history])
    assert [progress.generation for progress in history] == list(range(61))
    assert (best.diff(dim=0) <= 0.0).all()
    assert torch.equal(bowl(outcome.best_position), outcome.best_objective)
    assert torch.equal(best[-1], outcome.best_objective)
    assert (history[-1].n_evaluation == outcome.n_evaluation).all()
    assert (outcome.fitness >= outcome.best_objective.unsqueeze(-1)).all()


def test_nan_never_wins(optimizer):
    """A third of the cube, next to the optimum, gives no number."""

    def objective(x: Tensor) -> Tensor:
        return torch.where(x[..., 0] > 0.33, torch.nan, bowl(x))

    outcome = minimize(objective, optimizer, n_dimension=3, batch_shape=(5,), n_generation=60, generator=seeded(6))
    assert outcome.best_objective.isfinite().all()
    assert (outcome.best_position[..., 0] <= 0.33).all()
    assert not outcome.fitness.isnan().any()


def test_nan_told_by_hand_never_wins(optimizer):
    generator = seeded(7)
    population = torch.rand((12, 3), generator=generator, dtype=torch.float64)
    fitness = bowl(population)
    fitness[3] = torch.nan
    state = optimizer.init(population, fitness)
    assert state.fitness[3] == torch.inf
    before = state.best_objective
    for _ in range(optimizer.n_phase):
        candidates, state = optimizer.ask(state, generator)
        state = optimizer.tell(state, candidates, torch.full(candidates.active.shape, torch.nan).double())
        assert isinstance(candidates, Candidates)
        assert isinstance(state, State)
    assert state.best_objective == before
    assert not state.fitness.isnan().any()


def test_an_objective_without_any_number_is_said_so(optimizer):
    outcome = minimize(
        lambda x: torch.where(torch.arange(2).unsqueeze(-1) == 0, torch.nan, bowl(x)),
        optimizer,
        n_dimension=3,
        batch_shape=(2,),
        n_generation=20,
        generator=seeded(8),
    )
    assert outcome.status == (Status.no_number, Status.budget)
    assert outcome.best_objective[0] == torch.inf
    assert outcome.best_objective[1] < 2.1


def test_the_same_seed_gives_the_same_result(optimizer):
    def run(seed: int) -> Outcome:
        return minimize(bowl, optimizer, n_dimension=3, batch_shape=(2,), n_generation=15, generator=seeded(seed))

    first, second, other = run(9), run(9), run(10)
    assert torch.equal(first.population, second.population)
    assert torch.equal(first.fitness, second.fitness)
    assert not torch.equal(first.population, other.population)


@pytest.mark.check
def test_searches_of_a_batch_do_not_see_each_other(optimizer):
    """The second search gets another objective and stops early; the first and third notice nothing."""

    def run(second: Tensor) -> Outcome:
        offset = torch.stack((torch.zeros(()), second, torch.zeros(()))).unsqueeze(-1)
        return minimize(
            lambda x: bowl(x) * (1.0 + offset) - 100.0 * offset,
            optimizer,
            n_dimension=3,
            batch_shape=(3,),
            n_generation=40,
            target=1.0,
            generator=seeded(11),
        )

    alike, stopped = run(torch.tensor(0.0)), run(torch.tensor(1.0))
    assert stopped.status == (Status.budget, Status.target, Status.budget)
    for field in ("best_position", "best_objective", "population", "fitness", "n_evaluation"):
        for k in (0, 2):
            assert torch.equal(getattr(alike, field)[k], getattr(stopped, field)[k])


def test_a_search_that_has_stopped_is_frozen(optimizer):
    history: list[Progress] = []
    outcome = minimize(
        lambda x: bowl(x) - 100.0 * torch.tensor([[0.0], [1.0]]),
        optimizer,
        n_dimension=3,
        batch_shape=(2,),
        n_generation=25,
        target=0.0,
        generator=seeded(12),
        on_generation=history.append,
    )
    assert int(outcome.n_evaluation[1]) == optimizer.n_member
    assert outcome.n_generation.tolist() == [25, 0]
    first = history[0].snapshot["state.population"][1]
    kept = outcome.population[1]
    assert all((first == member).all(dim=-1).any() for member in kept)
    assert torch.equal(outcome.best_position[1], history[0].best_position[1])
    assert outcome.best_objective[0] < history[0].best_objective[0]


def test_resuming_from_a_stored_checkpoint_is_identical_to_the_bit(optimizer):
    def run(**kwargs: Any) -> Outcome:
        return minimize(
            bowl, optimizer, n_dimension=3, batch_shape=(2, 2), n_generation=24, target=2.002, stagnation=9, **kwargs
        )

    history: list[Progress] = []
    whole = run(generator=seeded(13), on_generation=history.append)
    stored = io.BytesIO()
    torch.save(history[11].checkpoint(), stored)
    stored.seek(0)
    again: list[Progress] = []
    resumed = run(generator=seeded(999), resume=torch.load(stored, weights_only=True), on_generation=again.append)
    assert [p.generation for p in again] == [p.generation for p in history[12:]]
    assert all(torch.equal(a.best_position, b.best_position) for a, b in zip(again, history[12:], strict=True))
    assert resumed.status == whole.status
    for one, other in zip(resumed, whole, strict=True):
        if isinstance(one, Tensor):
            assert torch.equal(one, other)


def test_a_checkpoint_is_that_of_its_own_generation_however_late_it_is_taken(optimizer):
    at_once: list[dict[str, Tensor]] = []
    history: list[Progress] = []

    def keep(progress: Progress) -> None:
        at_once.append(progress.checkpoint())
        history.append(progress)

    minimize(bowl, optimizer, n_dimension=3, n_generation=5, generator=seeded(14), on_generation=keep)
    for early, progress in zip(at_once, history, strict=True):
        late = progress.checkpoint()
        assert early.keys() == late.keys()
        assert all(torch.equal(early[key], late[key]) for key in early)
    assert not torch.equal(at_once[1]["generator"], at_once[2]["generator"])


def test_a_state_holds_tensors_only(optimizer):
    population = torch.rand((3, 12, 2), generator=seeded(15), dtype=torch.float64)
    state = optimizer.init(population, population.sum(dim=-1))
    assert isinstance(state, State)
    assert isinstance(state, optimizer.state_type)
    assert all(isinstance(value, Tensor) for value in state)


def test_a_plateau_is_crossed_or_left(optimizer):
    """Where all is equal, members still move: ties are accepted, or a scout flies."""
    population = torch.rand((12, 2), generator=seeded(16), dtype=torch.float64)
    outcome = minimize(
        lambda x: torch.full(x.shape[:-1], 3.0, dtype=x.dtype),
        optimizer,
        n_dimension=2,
        n_generation=30,
        tolerance=None,
        generator=seeded(17),
        initial=population,
    )
    assert not torch.equal(outcome.population[0], population[0])


def test_float32_stays_float32(optimizer):
    outcome = minimize(bowl, optimizer, n_dimension=3, n_generation=5, generator=seeded(18), dtype=torch.float32)
    assert outcome.best_position.dtype == outcome.best_objective.dtype == torch.float32


def test_a_search_lives_on_the_device_of_its_generator(optimizer, device):
    progress: list[Progress] = []
    outcome = minimize(
        lambda x: 2.0 + (x - 0.3).square().sum(dim=-1),
        optimizer,
        n_dimension=3,
        n_generation=40,
        batch_shape=(2,),
        stagnation=30,
        generator=torch.Generator(device).manual_seed(11),
        on_generation=progress.append,
    )
    assert outcome.best_position.device.type == outcome.population.device.type == device.type
    # 40 generations come well within 0.1 of the optimum in each direction.
    assert outcome.best_objective.max() < 2.0 + 3 * 0.1**2
    stored = {key: value.cpu() for key, value in progress[20].checkpoint().items()}
    again = minimize(
        lambda x: 2.0 + (x - 0.3).square().sum(dim=-1),
        optimizer,
        n_dimension=3,
        n_generation=40,
        batch_shape=(2,),
        stagnation=30,
        generator=torch.Generator(device),
        resume=stored,
    )
    assert torch.equal(again.best_position, outcome.best_position)


def test_a_wrong_name_is_answered_with_the_nearest():
    with pytest.raises(ValueError, match=r"No optimizer named 'l_shad'\. Did you mean 'l_shade'\? Choose"):
        optimizer_named("l_shad")


def test_the_registry_holds_the_names_of_the_configs():
    assert set(OPTIMIZERS) >= {"differential_evolution", "artificial_bee_colony", "jde", "sade", "l_shade"}
    assert all(optimizer_named(name).name == name for name in OPTIMIZERS)
