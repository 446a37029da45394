"""Sides, origin and axes are found again from points whose plate is known, however the file counts them."""

import math

import numpy as np
import pytest

from torchplate.measurement import MeasurementError, propose

SIDES = (0.42, 0.3)


def grid(n_x: int = 5, n_y: int = 3, inset: float = 0.0) -> np.ndarray:
    """Points of a roving test on the plate, in its own axes [m]."""
    x = np.linspace(inset, SIDES[0] - inset, n_x)
    y = np.linspace(inset, SIDES[1] - inset, n_y)
    return np.array([(a, b, 0.0) for b in y for a in x])


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


CASES = {
    "metres": grid(),
    "millimetres": 1e3 * grid(),
    "millimetres from the middle": 1e3 * (grid() - [0.21, 0.15, 0]),
    "a plate that stands in xz": grid()[:, [0, 2, 1]] + [0, 0.7, 0],
    "a plate that stands in yz": grid()[:, [2, 0, 1]],
    "turned by 27 degrees": turned(grid(), 27.0) + np.array([0.1, -0.2, 0.05]),
    "turned by -41.3 degrees, in millimetres": 1e3 * turned(grid(), -41.3),
    "digits of an ASCII file": np.round(turned(grid(), 12.0), 5),
}


@pytest.mark.parametrize("given", [False, True], ids=["proposed", "given"])
@pytest.mark.parametrize("points", CASES.values(), ids=CASES)
def test_every_point_comes_back_to_its_place_on_the_plate(points, given):
    found = propose(points, sides=SIDES if given else None)
    # 0.02 mm: five digits after the point of a metre, turned.
    assert (found.length_x, found.length_y) == pytest.approx(SIDES, abs=2e-5)
    places = np.array([found.frame.on_plate(point) for point in points])
    np.testing.assert_allclose(places, grid(), atol=2e-5)


def test_a_grid_turned_by_ninety_degrees_swaps_the_sides_where_these_are_given():
    points = turned(grid(), 90.0)
    found = propose(points, sides=SIDES)
    places = np.array([found.frame.on_plate(point) for point in points])
    assert (found.length_x, found.length_y) == SIDES
    # Which end of a side is its start is free.
    assert {tuple(p) for p in np.round(places[:, :2], 9)} == {tuple(p) for p in np.round(grid()[:, :2], 9)}
    other = propose(points)
    assert (other.length_x, other.length_y) == pytest.approx(SIDES[::-1])


def test_points_that_keep_their_distance_from_the_edge_give_the_sides():
    found = propose(grid(inset=0.02))
    assert (found.length_x, found.length_y) == pytest.approx(SIDES)
    assert found.frame.origin == (0.0, 0.0, 0.0)
    assert found.sides.guess


def test_two_points_near_opposite_corners_are_enough():
    found = propose(np.array([(0.02, 0.02, 0.0), (0.5614, 0.1976, 0.0)]))
    assert (found.length_x, found.length_y) == pytest.approx((0.5814, 0.2176))


def test_points_that_do_not_reach_the_edges_are_counted_from_the_corner_they_say():
    found = propose(grid(inset=0.03)[:7], sides=SIDES)
    assert found.frame.origin == (0.0, 0.0, 0.0)
    assert not found.origin.guess


def test_points_on_both_sides_of_the_origin_are_counted_from_the_middle():
    points = np.array([(-0.1, -0.12, 0.0), (0.15, -0.12, 0.0), (-0.1, 0.1, 0.0), (0.15, 0.1, 0.0)])
    found = propose(points, sides=SIDES)
    assert found.frame.origin == pytest.approx((-0.21, -0.15, 0.0))
    assert found.origin.guess


def test_a_few_scattered_points_do_not_turn_the_plate():
    scattered = [(0.02, 0.05, 0), (0.33, 0.11, 0), (0.21, 0.28, 0), (0.4, 0.02, 0), (0.11, 0.17, 0), (0.07, 0.29, 0)]
    assert propose(np.array(scattered), sides=SIDES).frame.x_axis == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("unit", ["mm", "cm", "in"])
def test_the_sides_tell_the_unit(unit):
    metre = {"mm": 1e3, "cm": 1e2, "in": 1 / 0.0254}[unit]
    found = propose(metre * grid(), sides=SIDES)
    assert found.frame.unit == unit
    np.testing.assert_allclose([found.frame.on_plate(p) for p in metre * grid()], grid(), atol=1e-7)


@pytest.mark.parametrize(
    ("points", "sides", "words"),
    [
        (np.vstack([grid(), [[0.2, 0.1, 0.15]]]), None, "in one plane"),
        ([(0.1, 0.05, 0), (0.2, 0.05, 0), (0.3, 0.05, 0)], None, "Give --length"),
        ([(0.1, 0.05, float("nan"))], None, "NaN"),
        ([*grid(), (1e308, 0.05, 0.0)], None, "more than 1e\\+100"),
    ],
)
def test_points_that_make_no_plate_are_refused(points, sides, words):
    with pytest.raises(MeasurementError, match=words):
        propose(np.array(points), sides=sides, source="test.uff")


def test_points_that_stick_out_of_the_given_sides_are_refused():
    with pytest.raises(MeasurementError, match=r"0\.3 m along x, got points 0\.42 m apart"):
        propose(grid(), sides=(0.3, 0.3), unit="m")


@pytest.mark.parametrize(("reach", "said"), [(48.0, True), (480.0, False)])
def test_coordinates_taken_in_millimetres_say_how_small_a_plate_that_makes(reach, said):
    """Those of a plate of 48 cm in centimetres would be one of 48 mm."""
    points = reach / 0.48 * np.array([(0.0, 0.0, 0.0), (0.48, 0.0, 0.0), (0.0, 0.3, 0.0), (0.48, 0.3, 0.0)])
    text = propose(points).unit.text
    assert ("one of 0.048 m is small" in text) == said
    assert f"({reach / 100:g} or {0.0254 * reach:.3g} m)" in text
