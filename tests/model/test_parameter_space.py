"""The unit cube against SI units."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchplate.model import ParameterSpace, Searched

SPACE = ParameterSpace(
    ["plate.youngs_modulus", "loss.stiffness_loss_factor", "wires.stiffness", "plate.poisson_ratio"],
    ["Pa", "-", "N/m", "-"],
    [Searched(150e9, 260e9), Searched(9e-8, 9e-3, logarithmic=True), Searched(700.0, 2000.0), Searched(-0.5, 0.25)],
)


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_the_middle_of_the_cube_is_the_mean_and_on_the_log_scale_the_geometric_mean() -> None:
    found = SPACE.to_si(torch.full((4,), 0.5, dtype=torch.float64))
    expected = tensor(205e9, math.sqrt(9e-8 * 9e-3), 1350, -0.125)
    torch.testing.assert_close(found, expected, rtol=1e-14, atol=0)


def test_a_place_off_the_middle_goes_where_the_formula_says() -> None:
    found = SPACE.to_si(tensor(0.2, 0.7, 0.9, 0.1))
    expected = tensor(150e9 + 0.2 * 110e9, 9e-8 * 1e5**0.7, 700 + 0.9 * 1300, -0.5 + 0.1 * 0.75)
    torch.testing.assert_close(found, expected, rtol=1e-14, atol=0)


def test_the_corners_of_the_cube_are_the_ends_of_the_intervals() -> None:
    # A logarithm and a power lie between, so rounding on the log scale.
    torch.testing.assert_close(SPACE.to_si(tensor(0, 0, 0, 0)), tensor(150e9, 9e-8, 700, -0.5), rtol=1e-15, atol=0)
    torch.testing.assert_close(SPACE.to_si(tensor(1, 1, 1, 1)), tensor(260e9, 9e-3, 2000, 0.25), rtol=1e-15, atol=0)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.lists(st.floats(0, 1), min_size=4, max_size=4))
def test_the_way_to_si_and_back_ends_where_it_began(position: list[float]) -> None:
    cube = tensor(*position)
    back = SPACE.to_cube(SPACE.to_si(cube))
    # Rounding of a value against the width of its interval: 260/110, and ln(1e5) on the log scale.
    torch.testing.assert_close(back, cube, rtol=0, atol=1e-14)


def test_leading_dimensions_are_members() -> None:
    cube = torch.rand(2, 3, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = SPACE.to_si(cube)
    assert found.shape == (2, 3, 4)
    torch.testing.assert_close(found[1, 2], SPACE.to_si(cube[1, 2]), rtol=0, atol=0)
    torch.testing.assert_close(SPACE.to_cube(found), cube, rtol=0, atol=1e-14)


def test_a_value_within_a_thousandth_of_an_end_is_at_its_bound() -> None:
    # On the log scale the thousandth is one of the decades: 9e-8 · 1e5^0.0005 is on the bound, on a linear scale both
    # of the small values would be.
    theta = torch.stack(
        [
            tensor(150e9 + 0.0005 * 110e9, 9e-8 * 1e5**0.0005, 2000 - 0.6, 0.2),
            tensor(150e9 + 0.002 * 110e9, 9e-8 * 1e5**0.002, 2000 - 2.6, 0.2499),
        ]
    )
    assert SPACE.at_bound(theta).tolist() == [[True, True, True, False], [False, False, False, True]]
    assert SPACE.at_bound(theta, tolerance=0.01).tolist() == [[True, True, True, False], [True] * 4]


def test_a_value_beyond_its_interval_is_at_its_bound_too() -> None:
    assert SPACE.at_bound(tensor(149e9, 1e-2, 650, 0.3)).tolist() == [True] * 4


def test_gradients_pass_through_both_scales() -> None:
    cube = tensor(0.2, 0.7, 0.9, 0.1).requires_grad_()
    (slope,) = torch.autograd.grad(SPACE.to_si(cube).sum(), cube)
    expected = tensor(110e9, 9e-8 * 1e5**0.7 * math.log(1e5), 1300, 0.75)
    torch.testing.assert_close(slope, expected, rtol=1e-12, atol=0)
    theta = tensor(160e9, 1e-4, 900, 0.1).requires_grad_()
    (slope,) = torch.autograd.grad(SPACE.to_cube(theta).sum(), theta)
    expected = tensor(1 / 110e9, 1 / (1e-4 * math.log(1e5)), 1 / 1300, 1 / 0.75)
    torch.testing.assert_close(slope, expected, rtol=1e-12, atol=0)


def test_nothing_searched_is_a_space_of_no_dimension() -> None:
    space = ParameterSpace([], [], [])
    assert len(space) == 0
    assert space.to_si(torch.zeros(3, 0, dtype=torch.float64)).shape == (3, 0)


@pytest.mark.parametrize(
    ("low", "high", "logarithmic", "message"),
    [
        (2.0, 1.0, False, r"low < high, got \[2, 1\]\. Swap"),
        (1.0, 1.0, False, r"low < high, got \[1, 1\]"),
        (float("nan"), 1.0, False, r"low < high"),
        (0.0, 1.0, True, r"positive low end for scale: log, got 0\. "),
        (-1.0, 1.0, True, r"positive low end for scale: log, got -1\. "),
    ],
)
def test_an_interval_that_cannot_be_searched_is_refused(
    low: float, high: float, logarithmic: bool, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Searched(low, high, logarithmic)
