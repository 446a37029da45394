"""What parts effects that look alike, the cheapest first."""

import itertools

from torchplate.diagnosis.next_measurement import next_measurements
from torchplate.effects import CATALOGUE

CALM = {"unexplained": False, "few": False, "symmetric": False}


def test_what_is_named_alone_needs_nothing():
    assert next_measurements([], **CALM) == []
    assert next_measurements([("point_mass",), ("density",)], **CALM) == []


def test_any_two_effects_can_be_parted():
    for pair in itertools.combinations(sorted(set(CATALOGUE) - {"plate"}), 2):
        said = next_measurements([pair], **CALM)
        assert len(said) == 1, pair
        assert all(name in said[0] for name in pair), pair


def test_the_cheapest_comes_first_and_one_effect_fewer_than_there_are_is_asked():
    said = next_measurements([("sensor_gain", "density", "thickness")], **CALM)
    assert len(said) == 2
    assert "weigh the plate" in said[0]
    assert "calliper" in said[1]
    # Whatever set it comes from.
    said = next_measurements([("time_delay", "exponential_window"), ("thickness", "density")], **CALM)
    costs = [
        next(kind.check.cost for kind in CATALOGUE.values() if kind.check and one.startswith(kind.check.action))
        for one in said
    ]
    assert costs == sorted(costs)
    assert len(said) == 2


def test_an_effect_that_nobody_knows_a_check_for_does_no_harm():
    assert next_measurements([("density", "rust")], **CALM) == next_measurements([("density", "rust")], **CALM)
    assert "weigh" in next_measurements([("rust", "density")], **CALM)[0]


def test_what_has_no_name_asks_for_more():
    calm = next_measurements([], unexplained=True, few=False, symmetric=False)
    assert any("twice as hard" in one for one in calm)
    few = next_measurements([], unexplained=True, few=True, symmetric=False)
    assert set(few) - set(calm)
    assert any("more FRFs" in one for one in few)


def test_sensors_on_a_line_of_symmetry_ask_for_one_off_it():
    (said,) = next_measurements([], unexplained=False, few=False, symmetric=True)
    assert "symmetry" in said
