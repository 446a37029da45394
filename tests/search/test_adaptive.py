"""What jDE, SaDE and L-SHADE learn, against hand-worked cases and the distributions they state."""

import math

import pytest
import torch
from scipy import stats
from torch import Tensor

from torchplate.search import Candidates, Jde, LShade, Progress, Sade, minimize
from torchplate.search.l_shade import TERMINAL, positive_cauchy
from torchplate.search.sade import UNCROSSED, cut_normal


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def all_of(position: Tensor) -> Candidates:
    return Candidates(position, torch.ones(position.shape[:-1], dtype=torch.bool))


def double(*value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def test_jde_renews_a_tenth_of_f_and_cr_over_their_ranges():
    population = torch.rand((1000, 10, 2), generator=seeded(1), dtype=torch.float64)
    jde = Jde(n_member=10)
    _, state = jde.ask(jde.init(population, population.sum(dim=-1)), seeded(2))
    new_weight = state.trial_weight[state.trial_weight != 0.5]
    new_rate = state.trial_rate[state.trial_rate != 0.9]
    # 10 000 draws at 0.1: deviation 0.003, four of them.
    assert abs(len(new_weight) / 10000 - 0.1) < 0.012
    assert abs(len(new_rate) / 10000 - 0.1) < 0.012
    # Kolmogorov-Smirnov, seed fixed; false alarm 1 in 1000 each.
    assert stats.kstest(new_weight.numpy(), "uniform", args=(0.1, 0.9)).pvalue > 1e-3
    assert stats.kstest(new_rate.numpy(), "uniform").pvalue > 1e-3


def test_jde_keeps_f_and_cr_only_with_the_trial_they_made():
    jde = Jde(n_member=4)
    state = jde.init(double(0.1, 0.2, 0.3, 0.4).unsqueeze(-1), double(1, 2, 3, 4))
    state = state._replace(trial_weight=double(0.6, 0.7, 0.8, 0.9), trial_rate=double(0.1, 0.2, 0.3, 0.4))
    state = jde.tell(state, all_of(torch.full((4, 1), 0.5).double()), double(0.5, 2.0, 3.5, torch.nan))
    assert state.weight.tolist() == [0.6, 0.7, 0.5, 0.5]
    assert state.rate.tolist() == [0.1, 0.2, 0.9, 0.9]
    assert state.fitness.tolist() == [0.5, 2.0, 3.0, 4.0]


def test_sade_prefers_strategies_by_their_success_rates():
    """Two generations of six: strategy 0 won 2 of 4, 1 won 0 of 3, 2 won 1 of 1, 3 won 3 of 4."""
    sade = Sade(n_member=6, learning_period=2)
    state = sade.init(torch.rand((6, 2), generator=seeded(3), dtype=torch.float64), torch.ones(6).double())
    state = state._replace(
        used=torch.tensor([[0, 0, 0, 0, 1, 1], [1, 2, 3, 3, 3, 3]]),
        success=torch.tensor([[1, 0, 1, 0, 0, 0], [0, 1, 1, 1, 0, 1]]),
        rate=torch.tensor([[0.3, 0.9, 0.7, 0.9, 0.1, 0.2], [0.3, 0.8, 0.2, 0.6, 0.9, 0.4]]).double(),
        generation=torch.tensor(2),
    )
    share, centre = sade.learned(state)
    score = [2 / 4 + 0.01, 0.01, 1.01, 3 / 4 + 0.01]
    assert torch.allclose(share, double(*score) / sum(score))
    # Lower medians of {0.3, 0.7}, of nothing, of {0.8}, of {0.2, 0.6, 0.4}.
    assert torch.allclose(centre, double(0.3, 0.5, 0.8, 0.4))


def test_sade_draws_evenly_before_it_has_learned():
    sade = Sade(n_member=8, learning_period=3)
    state = sade.init(torch.rand((8, 2), generator=seeded(4), dtype=torch.float64), torch.ones(8).double())
    success = state.success.clone()
    success[:2] = torch.tensor([1, 1, 0, 0, 0, 0, 0, 0])
    used = state.used.clone()
    used[:2] = torch.arange(8) // 2
    taught = state._replace(success=success, used=used)
    share, centre = sade.learned(taught._replace(generation=torch.tensor(2)))
    assert share.tolist() == [0.25] * 4
    assert float(sade.learned(taught._replace(generation=torch.tensor(3)))[0][0]) > 0.9
    assert centre.tolist() == [0.5] * 4
    _, asked = sade.ask(state, seeded(5))
    assert asked.trial_used.sort().values.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]


def test_sade_forgets_what_is_older_than_its_learning_period():
    sade = Sade(n_member=6, learning_period=2)
    state = sade.init(torch.full((6, 1), 0.5).double(), torch.full((6,), 9.0).double())
    for k, fitness in enumerate((8.0, 8.5, 7.0)):
        state = state._replace(trial_used=torch.full((6,), k), trial_rate=torch.full((6,), 0.1 * k).double())
        state = sade.tell(state, all_of(state.population), torch.full((6,), fitness).double())
    assert state.used[:, 0].tolist() == [2, 1]
    assert state.success[:, 0].tolist() == [1, 0]
    assert int(state.generation) == 3


def test_sade_current_to_rand_is_not_crossed_with_its_target():
    sade = Sade(n_member=40)
    population = 0.45 + 0.1 * torch.rand((40, 6), generator=seeded(6), dtype=torch.float64)
    candidates, state = sade.ask(sade.init(population, population.sum(dim=-1)), seeded(7))
    n_kept = (candidates.position == population).sum(dim=-1)
    assert (n_kept[state.trial_used == UNCROSSED] == 0).all()
    # The others keep about half of their six coordinates at CR near 0.5.
    assert 1.5 < float(n_kept[state.trial_used != UNCROSSED].double().mean()) < 3.5


def test_a_cut_normal_number_has_the_truncated_distribution():
    uniform = torch.rand(5000, generator=seeded(8), dtype=torch.float64)
    drawn = cut_normal(torch.full((5000,), 0.05).double(), 0.1, uniform)
    reference = stats.truncnorm(-0.5, 9.5, loc=0.05, scale=0.1)
    assert stats.kstest(drawn.numpy(), reference.cdf).pvalue > 1e-3


def test_a_positive_cauchy_number_has_the_truncated_distribution():
    uniform = torch.rand(5000, generator=seeded(9), dtype=torch.float64)
    drawn = positive_cauchy(torch.full((5000,), 0.07).double(), uniform)
    cauchy = stats.cauchy(0.07, 0.1)
    inside = drawn[drawn < 1.0].numpy()
    # Of what is positive, the part above 1 is set to 1.
    assert abs(len(inside) / 5000 - (cauchy.cdf(1.0) - cauchy.cdf(0.0)) / cauchy.sf(0.0)) < 0.02
    below_one = lambda x: (cauchy.cdf(x) - cauchy.cdf(0.0)) / (cauchy.cdf(1.0) - cauchy.cdf(0.0))  # noqa: E731
    assert stats.kstest(inside, below_one).pvalue > 1e-3
    assert float(drawn.min()) > 0.0
    assert float(drawn.max()) == 1.0


def l_shade_state(n_member: int = 4, **settings):
    shade = LShade(n_member=n_member, n_memory=2, **settings)
    population = torch.arange(n_member).double().unsqueeze(-1) / 10.0
    return shade, shade.init(population, torch.arange(n_member).double() + 5.0)


def test_l_shade_remembers_weighted_lehmer_means_of_what_improved():
    """Improvements 3 and 1 with F 0.4, 0.8 and CR 0.2, 0.6; a tie and a failure teach nothing."""
    shade, state = l_shade_state()
    state = state._replace(trial_weight=double(0.4, 0.8, 0.9, 0.9), trial_rate=double(0.2, 0.6, 0.9, 0.9))
    state = shade.tell(state, all_of(state.population + 0.5), double(2.0, 5.0, 7.0, 9.0))
    weight = (0.75 * 0.4**2 + 0.25 * 0.8**2) / (0.75 * 0.4 + 0.25 * 0.8)
    rate = (0.75 * 0.2**2 + 0.25 * 0.6**2) / (0.75 * 0.2 + 0.25 * 0.6)
    assert torch.allclose(state.memory_weight, double(weight, 0.5))
    assert torch.allclose(state.memory_rate, double(rate, 0.5))
    assert int(state.slot) == 1
    assert torch.allclose(state.population.flatten(), double(0.5, 0.6, 0.7, 0.3))


def test_l_shade_leaves_its_memory_alone_where_nothing_improved():
    shade, state = l_shade_state()
    after = shade.tell(state, all_of(state.population), state.fitness + 1.0)
    assert torch.equal(after.memory_weight, state.memory_weight)
    assert torch.equal(after.memory_rate, state.memory_rate)
    assert int(after.slot) == 0


def test_l_shade_learns_nothing_from_a_place_that_was_not_wanted():
    shade, state = l_shade_state()
    unwanted = Candidates(state.population, torch.zeros(4, dtype=torch.bool))
    after = shade.tell(state, unwanted, state.fitness - 1.0)
    assert torch.equal(after.fitness, state.fitness)
    assert torch.equal(after.memory_weight, state.memory_weight)
    assert int(after.n_archived) == int(after.slot) == 0


def test_l_shade_ends_a_memory_of_cr_once_only_zero_succeeds():
    shade, state = l_shade_state()
    state = state._replace(trial_weight=torch.full((4,), 0.5).double(), trial_rate=torch.zeros(4).double())
    state = shade.tell(state, all_of(state.population), state.fitness - 1.0)
    assert state.memory_rate.tolist() == [TERMINAL, 0.5]
    both = state._replace(memory_rate=torch.full((2,), TERMINAL).double())
    _, asked = shade.ask(both, seeded(10))
    assert asked.trial_rate.tolist() == [0.0] * 4


def test_l_shade_survives_an_improvement_without_bound():
    shade, state = l_shade_state()
    state = state._replace(fitness=torch.full((4,), torch.inf).double(), trial_weight=torch.full((4,), 0.5).double())
    state = shade.tell(state, all_of(state.population), double(1.0, torch.inf, 2.0, torch.nan))
    assert state.memory_weight.isfinite().all()


def test_l_shade_archives_the_beaten_and_drops_at_random_what_does_not_fit():
    shade, state = l_shade_state(archive_ratio=1.0)
    first = state.population.flatten().tolist()
    state = shade.tell(state, all_of(state.population + 0.5), state.fitness - double(1, 0, 1, -1))
    assert int(state.n_archived) == 2
    assert state.archive.flatten()[:2].tolist() == [first[0], first[2]]
    beaten = state.population.flatten().tolist()
    _, state = shade.ask(state, seeded(11))
    state = shade.tell(state, all_of(state.population / 2.0), state.fitness - double(1, 1, 1, 0))
    assert int(state.n_archived) == 4
    assert state.archive.flatten()[:3].tolist() == beaten[:3]
    assert float(state.archive[3]) in {first[0], first[2]}


def test_l_shade_moves_towards_the_best_and_uses_the_archive():
    """Four members on a line, F fixed by CR = 1: each trial is x + F (p − x) + F (a − b) for allowed p, a, b."""
    shade, state = l_shade_state(best_share=0.5)
    state = state._replace(
        population=0.4 + state.population / 2.0,
        archive=torch.full_like(state.archive, 0.47),
        n_archived=torch.tensor(1),
    )
    from_archive = 0
    for seed in range(60):
        candidates, asked = shade.ask(state, seeded(seed))
        x = state.population.flatten()
        for i in range(4):
            weight = asked.trial_weight[i]
            found = None
            for p in (0, 1):
                for a in set(range(4)) - {i}:
                    for b in (set(range(4)) - {i, a}) | {4}:
                        value = torch.cat((x, double(0.47)))
                        trial = x[i] + weight * (x[p] - x[i]) + weight * (value[a] - value[b])
                        if torch.isclose(trial, candidates.position[i, 0], atol=1e-12):
                            found = b
            if 0.0 < candidates.position[i, 0] < 1.0 and weight < 0.9:
                assert found is not None
                from_archive += found == 4
    # One of the three places that r2 may take is the archive's.
    assert from_archive > 20


def test_l_shade_shrinks_linearly_to_its_least_size():
    sizes: list[tuple[int, int]] = []

    def record(progress: Progress) -> None:
        sizes.append((int(progress.n_evaluation[0]), progress.snapshot["state.population"].shape[-2]))

    outcome = minimize(
        lambda x: (x - 0.3).square().sum(dim=-1),
        LShade(n_member=40),
        n_dimension=2,
        batch_shape=(2,),
        n_evaluation=1500,
        tolerance=None,
        generator=seeded(12),
        on_generation=record,
    )
    for spent, size in sizes[1:]:
        assert size == round(40 + (4 - 40) * spent / 1500)
    assert outcome.population.shape == (2, 4, 2)


@pytest.mark.parametrize("n_generation", [30, 100])
def test_l_shade_reaches_its_least_size_at_the_last_generation(n_generation):
    """The evaluations of n generations follow from dN/dg = −(N0 − Nmin) N / E; within 5 % for the whole steps."""
    outcome = minimize(
        lambda x: (x - 0.3).square().sum(dim=-1),
        LShade(n_member=60),
        n_dimension=2,
        n_generation=n_generation,
        tolerance=None,
        generator=seeded(13),
    )
    expected = 60 + n_generation * 56 / math.log(60 / 4)
    assert float(outcome.n_evaluation) == pytest.approx(expected, rel=0.05)
    assert outcome.population.shape[0] in {4, 5}


def test_l_shade_without_a_plan_keeps_its_size():
    shade, state = l_shade_state(n_member=8)
    candidates, state = shade.ask(state, seeded(14))
    assert shade.tell(state, candidates, state.fitness).fitness.shape == (8,)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Jde(n_member=3), r"at least 4, got 3\. Raise"),
        (lambda: Jde(renew_rate=1.5), r"in \[0, 1\], got 1\.5\. The paper"),
        (lambda: Sade(n_member=5), r"at least 6, got 5\. Raise"),
        (lambda: Sade(learning_period=0), r"at least 1, got 0\. Try"),
        (lambda: LShade(n_member=3), r"n_least = 4, got 3\. Raise"),
        (lambda: LShade(n_least=3), r"at least 4, got 3\. Raise"),
        (lambda: LShade(n_memory=0), r"at least 1, got 0\. The paper"),
        (lambda: LShade(best_share=0.0), r"in \(0, 1\], got 0\.0\. The paper"),
        (lambda: LShade(archive_ratio=0.5), r"at least 1, got 0\.5\. The paper"),
        (lambda: LShade(bound="clp"), r"Did you mean 'clip'"),
    ],
)
def test_a_wrong_setting_is_refused_with_what_to_do(make, message):
    with pytest.raises(ValueError, match=message):
        make()
