"""Names are compared by marginal likelihood and prior, and a set of names is as sure as its posterior probability."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from torchplate.diagnosis.candidates.candidate import Candidate, nameable
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.remarks import would_take
from torchplate.diagnosis.selection.criterion import (
    Hypothesis,
    Weight,
    choose,
    evidence,
    excessive,
    is_explained,
    is_needed,
    is_noise,
    known_section,
    weight_of,
)
from torchplate.diagnosis.settings import Comparison
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy.judged import Judged
from torchplate.discrepancy.specimen import Found
from torchplate.effects import CATALOGUE

N = 2000.0
SETTINGS = Comparison()
# Of N numbers where nothing but noise is left.
WEIGHT = 1 / (1 + N * SETTINGS.misspecified)
# −2 ln of the odds of nothing against any one name, beforehand.
ODDS = 2 * math.log(len(nameable()) / (1 - SETTINGS.beyond))
NONE = torch.zeros(0, dtype=torch.float64)


def fitted(cost: float, information: Sequence[float] = (), **others: Any) -> Fit:
    """A fit of such a −2 ln L, whose parameters are seen so well."""
    judged = Judged(cost, 1.0, {}, 1.0, N, NONE)
    judged = judged._replace(**{key: others.pop(key) for key in tuple(others) if key in Judged._fields})
    seen = torch.diag(torch.tensor(information, dtype=torch.float64))
    n = len(information)
    fields = {
        "prior": 0.0,
        "left": 0.1,
        "gap": 0.1,
        "told": torch.zeros(n, dtype=torch.float64),
        "n_modal": 300.0,
        "n_mode": 10,
    }
    return Fit(
        model=None,  # type: ignore[arg-type]
        reduced=None,  # type: ignore[arg-type]
        theta=torch.zeros(n, dtype=torch.float64),
        covariance=torch.zeros(n, n, dtype=torch.float64),
        prediction=NONE,
        expected=NONE,
        judged=judged,
        beside=SimpleNamespace(about=None),  # type: ignore[arg-type]
        information=seen,
        **(fields | others),
    )


def hypothesis(name: str, cost: float, information: Sequence[float] = (), n_option: int = 1, **fit: Any) -> Hypothesis:
    """An effect that leaves such a −2 ln L."""
    pairs = {"channel_polarity": ((3, None),), "channel_swap": ((None, 7), (None, 9))}
    options = {"channels": pairs[name]} if name in pairs else {}
    candidate = Candidate(CATALOGUE[name](**options), options, {}, {})
    return Hypothesis(candidate, f"{name}_1", fitted(cost, information, **fit), n_option=n_option)


# So much worse that nothing else counts.
FAR = 2000.0


def test_the_most_probable_is_named():
    every = [hypothesis("thickness", 700.0), hypothesis("density", 200.0), hypothesis("time_delay", 500.0)]
    found = choose(every, fitted(FAR))
    assert found.best.name == "density"
    assert found.equivalent == ()
    assert found.next_best is not None
    assert found.next_best.name == "time_delay"


def test_twins_share_the_posterior_and_are_all_in_the_set():
    names = ("density", "thickness", "sensor_gain")
    every = [hypothesis(name, 200.0) for name in names]
    for order in (every, every[::-1]):
        found = choose([hypothesis("orthotropy", 260.0), *order], fitted(FAR))
        assert {found.best.name, *found.equivalent} == set(names)
        probable = dict(found.probability)
        # What is beyond the catalogue keeps its part.
        share = (1 - SETTINGS.beyond) / 3
        assert [probable[name] for name in names] == pytest.approx([share] * 3)
        assert found.confidence == pytest.approx(1 - SETTINGS.beyond)


def test_a_number_that_was_measured_is_wrong_once_in_twenty_times():
    """FRFs part none of the three: the one that somebody measured is not in the set, unless it alone explains them."""
    assert SETTINGS.slip == 1 / 20
    density, thickness, gain = (hypothesis(name, 200.0) for name in ("density", "thickness", "sensor_gain"))
    thickness = replace(thickness, candidate=replace(thickness.candidate, overrules=True))
    found = choose([thickness, density, gain], fitted(FAR))
    assert {found.best.name, *found.equivalent} == {"density", "sensor_gain"}
    probable = dict(found.probability)
    assert probable["thickness"] == pytest.approx(probable["density"] / 20)
    # It costs what one in twenty costs, and no more.
    price = 2 * math.log(20) / WEIGHT
    assert choose([thickness, hypothesis("density", 200.0 + 1.1 * price)], fitted(FAR)).best is thickness
    assert choose([thickness, hypothesis("density", 200.0 + 0.9 * price)], fitted(FAR)).best is not thickness


def test_the_set_is_the_smallest_that_holds_the_credible_probability():
    # Of two, the second is in the set where its odds are above 5 to 95.
    edge = 2 * math.log(SETTINGS.credible / (1 - SETTINGS.credible)) / WEIGHT
    for part, equivalent in ((0.98, ("thickness",)), (1.02, ())):
        found = choose([hypothesis("density", 200.0), hypothesis("thickness", 200.0 + part * edge)], fitted(FAR))
        assert (found.best.name, found.equivalent) == ("density", equivalent)


def test_confidence_is_the_posterior_probability_of_the_set():
    costs = {"density": 200.0, "thickness": 203.0, "time_delay": 215.0}
    nothing = 199.0
    likely = {name: math.exp(-0.5 * WEIGHT * (cost - 200.0)) for name, cost in costs.items()}
    each = SETTINGS.missing * (1 - SETTINGS.beyond) / len(nameable())
    named = {name: each * one for name, one in likely.items()}
    # What no effect describes is as likely as the catalogue is on the whole.
    beyond = sum(named.values()) * SETTINGS.beyond / (1 - SETTINGS.beyond)
    none = (1 - SETTINGS.missing) * math.exp(-0.5 * WEIGHT * (nothing - 200.0))
    whole = sum(named.values()) + beyond + none
    found = choose([hypothesis(*one) for one in costs.items()], fitted(nothing))
    assert (found.best.name, found.equivalent) == ("density", ("thickness",))
    assert found.confidence == pytest.approx((named["density"] + named["thickness"]) / whole)
    assert dict(found.probability) == pytest.approx({name: one / whole for name, one in named.items()})


def test_a_choice_among_many_options_costs_its_prior():
    # One exchange among 121 references, of which there are 7,260.
    n_pair = 121 * 120 // 2
    price = 2 * math.log(n_pair) / WEIGHT
    for part, best in ((0.95, "density"), (1.05, "channel_swap")):
        swap = hypothesis("channel_swap", 200.0 - part * price, n_option=n_pair)
        assert choose([hypothesis("density", 200.0), swap], fitted(FAR)).best.name == best


def test_two_options_of_one_name_are_no_rivals_and_count_together():
    one, other = (hypothesis("channel_polarity", cost, n_option=2) for cost in (200.0, 200.0))
    found = choose([one, other, hypothesis("density", 200.0)], fitted(FAR))
    probable = dict(found.probability)
    assert set(probable) == {"channel_polarity", "density"}
    assert probable["channel_polarity"] == pytest.approx(probable["density"])
    alone = choose([one, other], fitted(FAR))
    assert (alone.equivalent, alone.next_best) == ((), None)


def test_a_parameter_on_its_bound_costs_and_makes_less_sure():
    price = -2 * math.log(SETTINGS.on_bound) / WEIGHT
    inside = hypothesis("point_mass", 200.0)
    for part, best in ((0.9, "point_mass"), (1.1, "stiffness_loss")):
        on_bound = hypothesis("stiffness_loss", 200.0 - part * price, n_on_bound=1)
        assert choose([inside, on_bound], fitted(FAR)).best.name == best
    nothing = fitted(215.0)
    sure = [choose([hypothesis("stiffness_loss", 200.0, n_on_bound=k)], nothing).confidence for k in (0, 1)]
    assert sure[0] > 0.9
    assert sure[1] < 0.2


def test_a_parameter_costs_what_the_data_say_of_it_more_than_its_prior_did():
    free = evidence(fitted(200.0), Weight())
    # On the unit cube a uniform prior has the precision 12.
    assert evidence(fitted(200.0, [12e4]), Weight()) - free == pytest.approx(math.log(1 + 1e4))
    assert evidence(fitted(200.0, [12e4, 12e2]), Weight()) - free == pytest.approx(
        math.log(1 + 1e4) + math.log(1 + 1e2)
    )
    # What the data do not see costs nothing, and what is known as well beforehand next to nothing.
    assert evidence(fitted(200.0, [0.0]), Weight()) == pytest.approx(free)
    told = torch.tensor([12e4], dtype=torch.float64)
    assert evidence(fitted(200.0, [12e4], told=told), Weight()) - free == pytest.approx(math.log(2.0))
    # So a model of fewer parameters is named where one of more is hardly nearer.
    few, many = hypothesis("ground_spring", 200.0, [12e4]), hypothesis("stiffness_loss", 199.0, [12e4, 12e4])
    assert choose([few, many], fitted(FAR)).best.name == "ground_spring"
    assert choose([few, hypothesis("stiffness_loss", 180.0, [12e4, 12e4])], fitted(FAR)).best.name == "stiffness_loss"


def test_a_broken_tolerance_and_a_coincidence_speak_against_a_name():
    honest = hypothesis("density", 205.0)
    assert choose([honest, hypothesis("thickness", 200.0, prior=40.0)], fitted(FAR)).best.name == "density"
    spring = hypothesis("ground_spring", 200.0)
    assert replace(spring, coincidence=12.0).cost == pytest.approx(spring.cost + 12.0)
    assert choose([honest, replace(spring, coincidence=12.0)], fitted(FAR)).best.name == "density"


@pytest.mark.parametrize("n_modal", [60.0, 3000.0, 40_000.0])
def test_no_test_counts_more_than_the_model_of_noise_and_nuisances_is_worth(n_modal):
    for n in (30.0, 3e3, 3e5, 3e7):
        left = [fitted(0.0, n=n, noise_scale=kappa, n_modal=n_modal) for kappa in (0.9, 1.0, 1.2, 2.0, 10.0, 1e3)]
        effective = [weight_of([one]).likelihood * n for one in left]
        assert max(effective) <= min(n, 1 / SETTINGS.misspecified) * (1 + 1e-9)
        # The more is left that is not noise, the less each line says.
        assert all(after <= before * (1 + 1e-9) for before, after in itertools.pairwise(effective))
        assert effective[-1] == pytest.approx(min(n_modal, effective[0]), rel=0.02)


def test_where_twice_the_noise_is_left_half_of_it_says_no_more_than_modes_do():
    n, n_modal = 3e5, 60.0
    independent = 1 / n + SETTINGS.misspecified
    assert independent < 1 / n_modal
    found = weight_of([fitted(0.0, n=n, noise_scale=2**0.5, n_modal=n_modal)]).likelihood
    assert 1 / (n * found) == pytest.approx(0.5 * independent + 0.5 / n_modal, rel=1e-9)


def test_where_modes_wander_by_more_than_their_width_they_count_by_their_number():
    found = [weight_of([fitted(0.0, second_order=part)]).likelihood * N for part in (0.0, 0.3, 0.9, 1.0)]
    assert found == sorted(found, reverse=True)
    assert found[-1] == pytest.approx(2 * 10)


def test_about_a_specimen_what_the_second_order_leaves_is_of_each_channel():
    known = SimpleNamespace(about=Found(NONE, torch.zeros(0, 0, dtype=torch.float64)))
    found = fitted(0.0, second_order=1.0)._replace(beside=known)
    assert weight_of([found]).likelihood * N == pytest.approx(300.0)


def test_what_nuisances_cost_is_not_tempered():
    """A thickness that would have to wander far is as improbable however many lines say so."""
    plain, wide = (fitted(cost, complexity=cost, n=1e6) for cost in (0.0, 40.0))
    weight = weight_of([plain])
    assert weight.likelihood < 0.02
    assert evidence(wide, weight) - evidence(plain, weight) == pytest.approx(40.0)
    # The same fall of the data's part is worth no more than the model of the noise is.
    worse = fitted(40.0, n=1e6)
    assert evidence(worse, weight) - evidence(plain, weight) == pytest.approx(weight.likelihood * 40.0)
    # Where far more than noise is left, nuisances that have taken some of it say no more than the data.
    plain, wide = (fitted(cost, complexity=cost, n=1e6, noise_scale=100.0) for cost in (0.0, 4e4))
    weight = weight_of([plain, wide])
    assert evidence(wide, weight) - evidence(plain, weight) < 2 * weight.likelihood * 4e4


def test_what_nuisances_cost_counts_alike_for_all_that_are_compared():
    """A model whose mesh and section are not known has that to pay beside every effect, however much these leave."""
    alike = {"complexity": 4000.0, "n": 1e4, "n_modal": 650.0}
    before, after = fitted(0.0, noise_scale=2.3, **alike), hypothesis("density", -2e4, noise_scale=1.15, **alike)
    weight = weight_of([before, after.fit])
    assert evidence(before, weight) - evidence(after.fit, weight) == pytest.approx(weight.likelihood * 2e4)
    assert is_needed(before, after)


def test_the_fit_that_leaves_least_says_what_numbers_are_worth():
    good, bad = fitted(0.0), fitted(500.0, noise_scale=20.0)
    assert weight_of([bad, good]) == weight_of([good])
    assert weight_of([good]).likelihood > 3 * weight_of([bad]).likelihood


def test_nothing_is_named_where_nothing_is_more_probable():
    before = fitted(200.0, gap=0.1)
    # A fall of less than the prior odds, and what its parameters cost.
    for information, price in (((), ODDS), ((12e4,), ODDS + math.log(1 + WEIGHT * 1e4))):
        for part, needed in ((0.95, False), (1.05, True)):
            after = hypothesis("density", 200.0 - part * price / WEIGHT, information)
            assert is_needed(before, after) == needed
            assert (choose([after], before).confidence > 0.5 * (1 - SETTINGS.beyond)) == needed


def test_what_chance_takes_is_no_effect():
    before, after = fitted(200.0), hypothesis("density", 100.0)
    assert is_needed(before, after)
    assert is_needed(before, after, by_chance=99.0)
    assert not is_needed(before, after, by_chance=101.0)


def test_what_leaves_much_parts_less():
    # Ten times the noise is left: as many numbers as there are of the modes.
    square = 200.0
    pair = [("density", 0.0), ("thickness", 30.0)]
    sharp = choose([hypothesis(name, square + more) for name, more in pair], fitted(FAR))
    assert sharp.equivalent == ()
    left = choose([hypothesis(name, square + more, noise_scale=10.0) for name, more in pair], fitted(FAR))
    assert left.equivalent == ("thickness",)


def test_a_second_best_that_is_followed_is_no_rival_of_itself():
    best, followed, near = (
        hypothesis(*one) for one in (("density", 100.0), ("thickness", 200.0), ("orthotropy", 203.0))
    )
    found = choose([best, followed, near], fitted(FAR), followed)
    assert found.best is followed
    assert found.confidence > 0.97
    # Whatever is needed to hold the credible probability stands beside it.
    assert "density" in found.equivalent
    assert dict(found.probability)["thickness"] < 1e-9


def test_a_choice_holds_what_is_as_probable():
    best, same, far = (hypothesis("orthotropy", cost) for cost in (200.0, 204.0, 230.0))
    found = choose([best, same, far], fitted(FAR))
    assert found.holds(best)
    assert found.holds(same)
    assert not found.holds(far)


@pytest.mark.parametrize(
    ("judged", "by_noise", "noise"),
    [
        ({"noise_scale": 1.0}, True, True),
        ({"noise_scale": 0.99 * SETTINGS.noise_limit**0.5}, True, True),
        ({"noise_scale": 1.01 * SETTINGS.noise_limit**0.5}, True, False),
        ({"scale": {"position_std": 0.9 * SETTINGS.size_limit}}, True, True),
        ({"scale": {"position_std": 1.1 * SETTINGS.size_limit}}, True, False),
        # Where residuals are weighed by an inflated error, what is left is no measure of the noise.
        ({"noise_scale": 1.0}, False, False),
    ],
)
def test_noise_is_what_noise_and_nuisances_of_a_usual_size_explain(judged, by_noise, noise):
    last = fitted(200.0, by_noise=by_noise, gap=0.02, **judged)
    assert is_noise(last) == noise
    target = object.__new__(FrfTarget)
    # Of a frozen target the noise alone is asked.
    vars(target)["noise"] = SimpleNamespace(floor=0.01)
    assert is_explained(last, target) == noise
    # No wider than noise alone makes it: whatever the lines say of their variance.
    assert is_explained(last._replace(gap=0.0099), target) == by_noise


def test_a_nuisance_that_would_have_to_be_too_large_is_told_with_its_size():
    last = fitted(200.0, scale={"position_std": 4.5, "calibration_std": 1.2, "mesh": 1.0})
    assert excessive(last) == {"position_std": 4.5}


@pytest.mark.parametrize(("scale", "said"), [(99.94, "99.9 times"), (4.8e5, "more than 100 times")])
def test_a_nuisance_that_would_have_to_be_absurdly_large_is_not_told_to_a_digit(scale, said):
    (sentence,) = would_take(fitted(200.0, scale={"damping_scatter": scale}))
    assert f"a scatter of the modes' damping {said} as large as was said" in sentence


def test_beside_a_model_error_lines_say_no_more_than_modes_do():
    """However small what is left is over that error, whose size nobody knows."""
    few, many = (fitted(200.0, by_noise=one, noise_scale=0.05) for one in (False, True))
    assert weight_of([few]).likelihood == pytest.approx(few.n_modal / N, rel=0.05)
    assert weight_of([many]).likelihood == pytest.approx(WEIGHT)


@pytest.mark.parametrize(
    ("large", "names", "left"),
    [
        ((), ("thickness", "damping_scatter"), [1.0, 2.0]),
        (("damping_scatter",), ("thickness", "damping_scatter"), [1.0, 0.0]),
        (("damping_scatter",), (), None),
        (("thickness",), ("thickness", "damping_scatter"), None),
    ],
)
def test_of_a_section_is_known_what_has_not_taken_on_something_else(large, names, left):
    """Dampings that have are put back to their law; of a wandering that has, nothing is known."""
    scale = {name: 1.1 * SETTINGS.size_limit if name in large else 1.0 for name in ("thickness", "damping_scatter")}
    about = Found(torch.tensor([1.0, 2.0]).double(), torch.eye(2).double(), names=names)
    fit = fitted(0.0, scale=scale)._replace(beside=SimpleNamespace(about=about))
    found = known_section(fit)
    assert (found and found.shift.tolist()) == left
    assert known_section(fit._replace(beside=SimpleNamespace(about=None))) is None
