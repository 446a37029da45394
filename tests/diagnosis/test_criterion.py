"""The name goes to the least cost, and what is as good stands beside it."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.fit import Fit
from torchplate.diagnosis.selection.criterion import (
    EQUIVALENT,
    EQUIVALENT_PART,
    LEAST_FALL,
    Hypothesis,
    choose,
    confidence,
    confidence_in_the_end,
    is_explained,
    is_needed,
)
from torchplate.diagnosis.target import FrfTarget, Misfit
from torchplate.effects import CATALOGUE
from torchplate.model import Searched

N_FITTED, N_HELDOUT = 1600, 400


def fitted(
    square: float,
    heldout: float | None = None,
    prior: float = 0.0,
    gap: float | None = None,
    n_fitted: int = N_FITTED,
    by_noise: bool = True,
    n_parameter: int = 0,
) -> Fit:
    """A fit that leaves so much, a fifth of it in held-out FRFs unless told otherwise."""
    held = square / 5 if heldout is None else heldout
    parts = torch.tensor([square - held, held], dtype=torch.float64)
    n_heldout = 0.0 if heldout == 0 else float(N_HELDOUT)
    theta = torch.zeros(n_parameter, dtype=torch.float64)
    misfit = Misfit(parts[0], parts[1], float(n_fitted), n_heldout)
    none = torch.zeros(0, dtype=torch.float64)
    gap = square**0.5 if gap is None else gap
    return Fit(None, None, theta, torch.zeros(0, 0), none, misfit, prior, gap, by_noise)  # type: ignore[arg-type]


def hypothesis(name: str, square: float, n_parameter: int = 1, **fit: Any) -> Hypothesis:
    options = {"channels": ((3, None),)} if "channel" in name else {}
    searched = {f"p{index}": Searched(0.0, 1.0) for index in range(n_parameter)}
    known = fit.pop("n_parameter_before", 0) + n_parameter
    candidate = Candidate(CATALOGUE[name](**options), options, searched, {})
    return Hypothesis(candidate, f"{name}_1", fitted(square, n_parameter=known, **fit))


def test_what_leaves_least_is_named():
    found = choose([hypothesis("thickness", 9000.0), hypothesis("density", 2000.0), hypothesis("time_delay", 5000.0)])
    assert found.best.name == "density"
    assert found.equivalent == ()
    assert found.next_best is not None
    assert found.next_best.name == "time_delay"
    assert found.margin == pytest.approx(3000.0)


def test_twins_within_the_threshold_stand_beside_it_and_others_do_not():
    best = hypothesis("density", 2000.0)
    inside, outside = (
        hypothesis(name, 2000.0 + part * EQUIVALENT) for name, part in (("thickness", 0.98), ("sensor_gain", 1.02))
    )
    for order in ([best, inside, outside], [outside, inside, best]):
        found = choose(order)
        assert (found.best.name, found.equivalent) == ("density", ("thickness",))
        assert found.next_best is not None
        assert found.next_best.name == "sensor_gain"
        assert found.margin == pytest.approx(1.02 * EQUIVALENT)


def test_a_second_best_that_is_followed_is_no_twin_or_rival_of_itself():
    best, followed, near = (
        hypothesis(*one) for one in (("density", 900.0), ("thickness", 2000.0), ("orthotropy", 2005.0, 1))
    )
    found = choose([best, followed, near], followed)
    assert (found.best.name, found.equivalent) == ("thickness", ("orthotropy",))
    assert found.next_best is not None
    assert found.next_best.name == "density"
    assert confidence_in_the_end(found, found.best.fit, False) < 0.1


def test_what_leaves_much_knows_less_of_what_is_small():
    # Four times the noise is left: differences count a quarter.
    square = 4.0 * (N_FITTED + N_HELDOUT)
    found = choose([hypothesis("density", square), hypothesis("thickness", square + 3.9 * EQUIVALENT)])
    assert found.equivalent == ("thickness",)
    found = choose([hypothesis("density", square), hypothesis("thickness", square + 4.1 * EQUIVALENT)])
    assert found.equivalent == ()


def test_what_the_variance_is_not_known_to_parts_nothing():
    # Sixty thousand numbers: a thousandth of all that is left is more than any fixed threshold.
    n = 60000.0
    inside, outside = (
        hypothesis("thickness", n + part * EQUIVALENT_PART * n, n_fitted=int(n)) for part in (0.98, 1.03)
    )
    for other, equivalent in ((inside, ("thickness",)), (outside, ())):
        found = choose([hypothesis("density", n, n_fitted=int(n)), other])
        assert (found.best.name, found.equivalent) == ("density", equivalent)


def test_more_parameters_must_pay_for_themselves():
    few, many = hypothesis("ground_spring", 2000.0, 3), hypothesis("stiffness_loss", 1999.0, 4)
    assert choose([many, few]).best.name == "ground_spring"
    much_better = hypothesis("stiffness_loss", 1900.0, 4)
    assert choose([much_better, few]).best.name == "stiffness_loss"
    # A choice among channels is one too.
    assert hypothesis("channel_polarity", 2000.0, 0).cost > 2000.0


def test_a_broken_tolerance_and_held_out_residuals_speak_against_it():
    honest = hypothesis("density", 2050.0)
    assert choose([honest, hypothesis("thickness", 2000.0, prior=400.0)]).best.name == "density"
    assert choose([honest, hypothesis("thickness", 2000.0 + 300.0, heldout=700.0)]).best.name == "density"


def test_another_option_of_the_same_effect_is_no_rival():
    found = choose([hypothesis("channel_polarity", 2000.0, 0), hypothesis("channel_polarity", 2001.0, 0)])
    assert (found.equivalent, found.next_best, found.margin) == ((), None, math.inf)
    assert 0.9 < confidence_in_the_end(found, found.best.fit, False) < 1


def test_confidence_grows_with_the_margin_and_falls_with_what_is_left():
    margins = [EQUIVALENT, 2 * EQUIVALENT, 5 * EQUIVALENT, 20 * EQUIVALENT, math.inf]
    sure = [confidence(margin, 1.0) for margin in margins]
    assert sure == sorted(sure)
    assert sure[0] < 0.7 < 0.95 < sure[-1] < 1
    # A second best that is followed may have been far worse at the time.
    assert 0 <= confidence(-1e9, 1.0) < 1e-9
    left = [confidence(math.inf, misfit) for misfit in (1.0, 3.0, 30.0, 3000.0)]
    assert left == sorted(left, reverse=True)
    assert left[-1] < 0.3


def test_what_came_after_it_speaks_for_the_first_of_two():
    # At the time a rival was as near, and much was left; with the second effect nothing is.
    first, rival = hypothesis("point_mass", 300000.0, 3), hypothesis("stiffness_loss", 300000.0, 4)
    found = choose([first, rival, hypothesis("density", 309000.0)])
    assert found.next_best is not None
    last = fitted(2000.0)
    assert confidence_in_the_end(found, first.fit, False) < 0.3
    assert confidence_in_the_end(found, last, True) > 0.95
    # Not where the last model leaves as much, nor for the last effect of it.
    assert confidence_in_the_end(found, first.fit, True) < 0.3
    close = choose([hypothesis("point_mass", 2000.0), hypothesis("density", 2000.0 + 1.1 * EQUIVALENT)])
    assert confidence_in_the_end(close, close.best.fit, False) < 0.6


def test_an_effect_is_needed_where_it_takes_much_of_all_there_is():
    before = fitted(20000.0)
    assert is_needed(before, hypothesis("density", 2000.0))
    # A hair, or a part that noise or a mesh may take as well.
    assert not is_needed(before, hypothesis("density", 19990.0))
    assert not is_needed(before, hypothesis("density", 19900.0))
    # Down at the noise, what falls must be more than a few parameters take of it.
    assert not is_needed(fitted(2000.0), hypothesis("stiffness_loss", 1985.0, 4))
    assert is_needed(fitted(2600.0), hypothesis("density", 2000.0))


def test_where_little_is_left_an_effect_must_close_the_gap():
    # Residuals may be moved to lines where the mesh error counts for more.
    before = fitted(5000.0, gap=0.04)
    assert is_needed(before, hypothesis("sensor_position", 2000.0, gap=0.039))
    assert not is_needed(before, hypothesis("sensor_position", 2000.0, gap=0.03995))
    assert not is_needed(before, hypothesis("sensor_position", 2000.0, gap=0.041))
    # Peaks that do not overlap make it 1 wherever they are.
    assert is_needed(fitted(20000.0, gap=1.0), hypothesis("sensor_position", 2000.0, gap=1.1))


def test_an_effect_that_held_out_frfs_do_not_want_is_not_needed():
    before = fitted(20000.0, heldout=4000.0, gap=0.9)
    assert not is_needed(before, hypothesis("density", 11000.0, heldout=9000.0, gap=0.8))
    # Unless peaks begin to overlap on all of them.
    assert is_needed(before, hypothesis("density", 11000.0, heldout=9000.0, gap=0.2))
    assert is_needed(before, hypothesis("density", 6000.0, heldout=3900.0))
    # One that it hardly touches may rise a hair while all others fall.
    assert is_needed(fitted(400000.0, heldout=900.0), hypothesis("channel_polarity", 30000.0, 0, heldout=1100.0))
    # Where nothing is held out, nothing can object.
    assert is_needed(fitted(20000.0, heldout=0), hypothesis("density", 6000.0, heldout=0))


def test_where_the_model_is_doubted_a_part_of_what_is_left_counts():
    # Twelve independent numbers: 12 ln of what is left.
    doubted = {"n_fitted": 12, "heldout": 0, "by_noise": False}
    before = fitted(144.0, **doubted, gap=0.5, prior=20.0)
    assert not is_needed(before, hypothesis("point_mass", 130.0, 3, **doubted, gap=0.45, prior=20.0))
    # A broken tolerance that is whole again counts as much.
    assert is_needed(before, hypothesis("point_mass", 130.0, 3, **doubted, gap=0.45))
    assert is_needed(before, hypothesis("orthotropy", 30.0, 2, **doubted, gap=0.45, prior=20.0))
    # Nearly nothing by the weighed lines, but peaks overlap now.
    assert is_needed(before, hypothesis("point_mass", 60.0, 3, **doubted, gap=0.2, prior=20.0))
    assert not is_needed(before, hypothesis("point_mass", 150.0, 3, **doubted, gap=0.2, prior=20.0))


def test_few_numbers_bear_few_parameters():
    # Thirteen numbers: the first parameter costs little, the seventh much, and a thirteenth is not to be had.
    few = {"n_fitted": 13, "heldout": 0, "by_noise": False}
    assert hypothesis("density", 30.0, 1, **few).penalty == pytest.approx(2.364, rel=1e-3)
    fourth = hypothesis("stiffness_loss", 30.0, 4, n_parameter_before=3, **few)
    assert fourth.penalty == pytest.approx(36.4 - 26 / 3, rel=1e-3)
    assert hypothesis("stiffness_loss", 30.0, 4, n_parameter_before=9, **few).penalty == math.inf
    # Of many numbers each costs two.
    many = {"n_fitted": 100_000, "heldout": 0, "by_noise": False}
    assert hypothesis("point_mass", 30.0, 3, n_parameter_before=5, **many).penalty == pytest.approx(6.0, rel=1e-2)


def test_where_the_model_is_doubted_the_gap_decides_among_those_that_are_as_good():
    few = {"n_fitted": 40, "heldout": 0, "by_noise": False}
    better, nearer = hypothesis("density", 100.0, gap=0.5, **few), hypothesis("thickness", 110.0, gap=0.2, **few)
    far = hypothesis("time_delay", 400.0, gap=0.1, **few)
    assert choose([better, nearer, far]).best is nearer
    by_noise = [replace(one, fit=one.fit._replace(by_noise=True)) for one in (better, nearer)]
    assert choose(by_noise).best is by_noise[0]


def test_what_is_known_beforehand_and_which_edge_is_held_cost_nothing():
    few = {"n_fitted": 13, "heldout": 0, "by_noise": False}
    free = hypothesis("density", 30.0, 1, n_parameter_before=5, **few)
    known = replace(free, fit=free.fit._replace(n_told=5))
    assert known.penalty == pytest.approx(hypothesis("density", 30.0, 1, **few).penalty)
    assert known.penalty < free.penalty
    chosen = hypothesis("channel_polarity", 30.0, 0)
    held = replace(chosen, candidate=replace(chosen.candidate, replaces="held edge x0"))
    assert (chosen.penalty, held.penalty) == (8.0, 0.0)


def test_a_coincidence_costs():
    spring = hypothesis("ground_spring", 2000.0, 3)
    assert replace(spring, coincidence=12.0).cost == spring.cost + 12.0


def test_what_chance_takes_is_no_effect():
    before = fitted(2000.0 + 100.0, gap=0.12)
    after = hypothesis("ground_spring", 2000.0 - 3 * 8.0, 3, gap=0.1)
    assert before.cost - after.cost == pytest.approx(100.0)
    assert LEAST_FALL < 99
    assert is_needed(before, after)
    assert is_needed(before, after, by_chance=99.0)
    assert not is_needed(before, after, by_chance=101.0)


def frfs(floor: float) -> FrfTarget:
    """FRFs of which the floor alone is asked."""
    target = object.__new__(FrfTarget)
    target.noise = SimpleNamespace(floor=floor)  # type: ignore[assignment]
    return target


@pytest.mark.parametrize(
    ("part", "gap", "named", "explained"),
    [
        (1.0, 0.5, False, True),
        (1.0, 0.5, True, True),
        # Deep valleys may say that something is missing, where the gap is at the floor.
        (1.5, 0.0105, True, True),
        # Where nothing was named, less may be left.
        (1.5, 0.0095, False, False),
        (1.3, 0.0105, False, False),
        (1.3, 0.0095, False, True),
        (1.5, 0.0115, True, False),
        (3.5, 0.0105, True, False),
    ],
)
def test_nothing_is_missing_where_noise_is_all_that_is_left(part, gap, named, explained):
    last = fitted(part * (N_FITTED + N_HELDOUT), gap=gap)
    assert is_explained(last, frfs(0.01), named) == explained


def test_a_choice_holds_what_is_as_good_and_not_another_of_the_same_name():
    best, same, far = (hypothesis("orthotropy", square) for square in (2000.0, 2005.0, 5000.0))
    found = choose([best, hypothesis("ground_spring", 2001.0), same, far])
    assert "ground_spring" in found.equivalent
    assert found.holds(best)
    assert found.holds(same)
    assert not found.holds(far)
