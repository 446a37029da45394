"""When a search stops, what it reports, and what it refuses."""

import pytest
import torch
from torch import Tensor

from torchplate.search import ArtificialBeeColony, DifferentialEvolution, Jde, Progress, Status, minimize


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def valley(x: Tensor) -> Tensor:
    return 1.0 + (x - torch.tensor([0.2, 0.7], dtype=x.dtype)).square().sum(dim=-1)


def test_tolerance_stops_when_the_members_agree():
    outcome = minimize(
        valley,
        DifferentialEvolution(n_member=10),
        n_dimension=2,
        n_generation=1000,
        tolerance=1e-4,
        generator=seeded(0),
    )
    assert outcome.status == (Status.tolerance,)
    deviation = outcome.fitness.std(correction=0) / outcome.fitness.mean()
    # Below the tolerance, and not by far: the generation before was still above it.
    assert 1e-6 < deviation <= 1e-4


def test_without_tolerance_only_the_budget_stops():
    outcome = minimize(
        valley,
        DifferentialEvolution(n_member=10),
        n_dimension=2,
        n_generation=150,
        tolerance=None,
        generator=seeded(0),
    )
    assert outcome.status == (Status.budget,)
    assert int(outcome.n_generation) == 150


def test_stagnation_stops_after_that_many_generations_without_improvement():
    history: list[Progress] = []
    outcome = minimize(
        valley,
        DifferentialEvolution(n_member=6),
        n_dimension=2,
        n_generation=1000,
        tolerance=None,
        stagnation=4,
        generator=seeded(1),
        on_generation=history.append,
    )
    assert outcome.status == (Status.stagnation,)
    best = torch.stack([progress.best_objective for progress in history])
    idle = (best.diff() >= 0.0).tolist()
    assert idle[-5:] == [False, True, True, True, True]
    assert all(not all(idle[k : k + 4]) for k in range(len(idle) - 4))


def test_the_target_stops_at_the_first_generation_that_reaches_it():
    history: list[Progress] = []
    outcome = minimize(
        valley,
        DifferentialEvolution(n_member=10),
        n_dimension=2,
        n_generation=1000,
        target=1.001,
        generator=seeded(2),
        on_generation=history.append,
    )
    assert outcome.status == (Status.target,)
    assert history[-1].best_objective <= 1.001 < history[-2].best_objective


def test_every_status_says_what_to_do():
    for status in Status:
        sentences = status.value.rstrip(".").split(". ")
        assert len(sentences) == 2, status
        assert sentences[1].split()[0] in {"Raise", "Lower", "Repeat", "Evaluate"}, status


def test_progress_reports_mean_and_spread_of_the_members():
    population = torch.tensor([[0.1, 0.5], [0.3, 0.5], [0.2, 0.5], [0.8, 0.5]], dtype=torch.float64)
    seen: list[Progress] = []
    minimize(
        lambda x: torch.where(x[..., 0] > 0.7, torch.nan, 10.0 * x[..., 0]),
        DifferentialEvolution(n_member=4),
        n_dimension=2,
        n_generation=0,
        generator=seeded(3),
        initial=population,
        on_generation=seen.append,
    )
    (progress,) = seen
    # Mean of 1, 3, 2; the fourth is no number. Places 0.1, 0.3, 0.2, 0.8: mean 0.35, variance 0.29 / 4.
    assert torch.allclose(progress.mean_objective, torch.tensor(2.0, dtype=torch.float64))
    assert torch.allclose(progress.spread, torch.tensor((0.29 / 4) ** 0.5 / 2, dtype=torch.float64))
    assert progress.best_objective == 1.0
    assert progress.best_position.tolist() == [0.1, 0.5]
    assert int(progress.n_evaluation) == 4


def test_a_larger_budget_continues_a_search_that_had_spent_its_own():
    history: list[Progress] = []
    optimizer = DifferentialEvolution(n_member=8)
    minimize(
        valley,
        optimizer,
        n_dimension=2,
        n_evaluation=80,
        generator=seeded(4),
        on_generation=history.append,
    )
    whole = minimize(valley, optimizer, n_dimension=2, n_evaluation=160, generator=seeded(4))
    more = minimize(
        valley,
        optimizer,
        n_dimension=2,
        n_evaluation=160,
        generator=seeded(5),
        resume=history[-1].checkpoint(),
    )
    assert torch.equal(more.population, whole.population)
    assert int(more.n_evaluation) == 160


def test_a_larger_budget_continues_a_search_that_had_stopped_within_a_cycle():
    """Eight sources, eight employed bees, and nothing left for eight onlookers."""
    history: list[Progress] = []
    colony = ArtificialBeeColony(n_member=8)
    short = minimize(valley, colony, n_dimension=2, n_evaluation=20, generator=seeded(4), on_generation=history.append)
    assert int(short.n_evaluation) == 16
    more = minimize(
        valley, colony, n_dimension=2, n_evaluation=60, generator=seeded(5), resume=history[-1].checkpoint()
    )
    assert int(more.n_evaluation) > 50


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "needs a budget, got none. Give"),
        ({"n_evaluation": 5}, "initial population of 8, got 5. Raise"),
        ({"n_generation": -1}, "0 or more, got -1. Give"),
        ({"n_generation": 1, "initial": torch.zeros(8, 3)}, r"= \[8, 2\], got \[8, 3\]. Change"),
        ({"n_generation": 1, "initial": torch.full((8, 2), 1.5)}, "got members outside"),
        ({"n_generation": 1, "device": "meta"}, "device, meta, got one on cpu. Make"),
    ],
)
def test_an_unusable_setting_is_refused_with_what_to_do(settings, message):
    with pytest.raises(ValueError, match=message):
        minimize(valley, DifferentialEvolution(n_member=8), n_dimension=2, generator=seeded(6), **settings)


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        (lambda x: x, r"shape \[8\], got \[8, 2\]. Reduce"),
        (lambda x: valley(x) + 1j, "real numbers, got complex ones. Take"),
    ],
)
def test_an_unusable_objective_is_refused_with_what_to_do(objective, message):
    with pytest.raises(ValueError, match=message):
        minimize(objective, DifferentialEvolution(n_member=8), n_dimension=2, n_generation=1, generator=seeded(6))


def test_a_checkpoint_of_another_search_is_refused():
    history: list[Progress] = []
    minimize(valley, Jde(n_member=8), n_dimension=2, n_generation=1, generator=seeded(7), on_generation=history.append)
    checkpoint = history[-1].checkpoint()
    with pytest.raises(ValueError, match=r"from differential_evolution, got one of jde\. Resume"):
        minimize(
            valley,
            DifferentialEvolution(n_member=8),
            n_dimension=2,
            n_generation=2,
            generator=seeded(7),
            resume=checkpoint,
        )
    with pytest.raises(ValueError, match=r"in 3 dimensions, got \[\] in 2\. Give"):
        minimize(valley, Jde(n_member=8), n_dimension=3, n_generation=2, generator=seeded(7), resume=checkpoint)


def test_search_knows_nothing_of_plates():
    import ast
    from pathlib import Path

    import torchplate.search

    folder = Path(torchplate.search.__file__).parent
    for file in folder.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            ours = [name for name in names if name.startswith("torchplate")]
            assert all(name.startswith(("torchplate.search", "torchplate.nearest")) for name in ours), file
