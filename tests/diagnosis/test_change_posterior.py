"""Which change is named: by evidence and prior, and only where it takes more than chance."""

import math

import pytest
import scipy.stats

from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.posterior import Weighed, chance, choose
from torchplate.diagnosis.change.settings import SETTINGS
from torchplate.diagnosis.settings import Comparison

NONE = Weighed(None, 1000.0, 990.0)


def weighed(name: str, evidence: float, cost: float | None = None, n_option: int = 1, n_place: int = 1) -> Weighed:
    change = Change(name, name, n_option=n_option)
    return Weighed(change, evidence, evidence - 10 if cost is None else cost, 3, n_place)


def choice(*some: Weighed):
    return choose(NONE, some, n_name=30, n_tried=40, comparison=Comparison(), settings=SETTINGS)


def test_the_most_probable_is_named_with_those_that_are_nearly_as_good():
    found = choice(weighed("rib", 907.0), weighed("point_mass", 900.0), weighed("absorber", 901.0))
    assert found.best.change.name == "point_mass"
    assert found.equivalent == ("absorber",)
    assert found.next_best.change.name == "rib"
    # What no catalogue holds keeps 2 %.
    assert 0.9 < found.confidence < 0.98
    assert found.needed


def test_a_change_less_probable_than_none_is_not_named():
    assert not choice(weighed("point_mass", 1001.0, 950.0)).needed


def test_a_change_that_chance_would_make_is_not_named():
    found = choice(weighed("point_mass", 975.0, 970.0, n_place=20))
    assert found.by_chance == pytest.approx(scipy.stats.chi2.isf(0.01 / 800, 3))
    assert NONE.cost - 970.0 < found.by_chance
    assert not found.needed


def test_one_choice_among_many_costs_its_share():
    few, many = (choice(weighed("channel_swap", 985.0, n_option=n)) for n in (1, 100))
    assert few.confidence > many.confidence
    assert math.isclose(chance(weighed("a", 0.0), 40, SETTINGS), scipy.stats.chi2.isf(0.01 / 40, 3))
