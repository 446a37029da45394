"""Kind and place of a field without a name, on diagnoses made by hand."""

import pytest

from blind.field import field_of


def record(name, extra, field, verdict="unexplained", kind="beyond"):
    truth = {"kind": kind, "hidden": [{"effect": name}], "extra": extra}
    return {"truth": truth, "diagnosis": {"verdict": verdict, "field": field}}


def field(kind, x, y, *others):
    return {"kind": kind, "place": {"x": x, "y": y}, "others": [{"x": a, "y": b} for a, b in others]}


def test_a_hinge_has_a_place_along_x_alone():
    right, off = field_of(record("hinge", {"x": 0.4, "rotational_stiffness": 1e3}, field("stiffness", 0.47, 0.1)))
    assert right
    assert off == pytest.approx(0.07)


def test_the_nearest_of_places_that_are_said_to_be_alike_counts():
    extra = {"cubic": 1e9, "x": 0.2, "y": 0.7, "noise_sensor": 1.0}
    right, off = field_of(record("cubic_spring", extra, field("support", 0.8, 0.7, (0.22, 0.65))))
    assert right
    assert off == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("name", "kind", "good"),
    [("curvature", "stiffness", True), ("curvature", "mass", False), ("clipped_channel", "loss", False)],
)
def test_a_kind_is_right_or_wrong_and_a_whole_plate_has_no_place(name, kind, good):
    assert field_of(record(name, {"level": 0.3}, field(kind, 0.5, 0.5))) == (good, None)


def test_no_field_is_right_where_nothing_is_wrong_with_the_plate():
    assert field_of(record("clipped_channel", {"level": 0.3}, None)) == (True, None)
    assert field_of(record("hinge", {"x": 0.4}, None)) == (False, 1.0)


def test_a_field_is_asked_for_where_something_is_missing_alone():
    assert field_of(record("hinge", {"x": 0.4}, None, verdict="consistent")) is None
    assert field_of(record("point_mass", {}, None, kind="one")) is None
