"""The 12-dof rectangle against its definition, closed forms of the literature and Gauss quadrature."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchplate.plate import element

CORNERS = torch.tensor([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], dtype=torch.float64)
SIDES = [(0.1, 0.02), (0.3, 0.12), (0.07, 0.07), (0.05, 0.11), (0.2, 1.0)]


def symmetric_positive(seed: int) -> torch.Tensor:
    """A full rigidity: every one of its six entries is there."""
    factor = torch.randn(3, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return factor @ factor.mT + 0.1 * torch.eye(3, dtype=torch.float64)


def orthotropic(seed: int) -> torch.Tensor:
    rigidity = symmetric_positive(seed)
    rigidity[[0, 1, 2, 2], [2, 2, 0, 1]] = 0.0
    return rigidity


def inner_places(n_place: int, seed: int) -> torch.Tensor:
    return torch.rand(n_place, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def corner_values(power_x: int, power_y: int, a: float, b: float) -> torch.Tensor:
    """The dofs w, dw/dy, −dw/dx of x^p y^q at the four corners, written out by hand."""
    dofs = []
    for corner in CORNERS.tolist():
        x, y = corner[0] * a, corner[1] * b
        slope_x = power_x * x ** (power_x - 1) * y**power_y if power_x else 0.0
        slope_y = power_y * x**power_x * y ** (power_y - 1) if power_y else 0.0
        dofs += [x**power_x * y**power_y, slope_y, -slope_x]
    return torch.tensor(dofs, dtype=torch.float64)


@pytest.mark.parametrize(("a", "b"), SIDES)
def test_each_shape_function_is_one_at_its_own_dof_and_zero_at_all_others(a: float, b: float) -> None:
    rows = []
    for corner in CORNERS:
        slope = torch.autograd.functional.jacobian(lambda place: element.shape_functions(place, a, b), corner)
        rows += [element.shape_functions(corner, a, b), slope[:, 1] / b, -slope[:, 0] / a]
    # Rounding only; a rotation's shape function is of the size of a side, and the sides differ by 10 at most.
    torch.testing.assert_close(torch.stack(rows), torch.eye(12, dtype=torch.float64), rtol=0, atol=1e-13)


@pytest.mark.parametrize(("a", "b"), SIDES)
def test_a_rigid_motion_of_the_corners_is_a_rigid_motion_everywhere(a: float, b: float) -> None:
    height, tilt_x, tilt_y = 0.7, -1.3, 0.4
    dofs = torch.cat(
        [
            torch.tensor([height + tilt_x * x * a + tilt_y * y * b, tilt_y, -tilt_x], dtype=torch.float64)
            for x, y in CORNERS.tolist()
        ]
    )
    place = inner_places(9, seed=1)
    expected = height + tilt_x * a * place[:, 0] + tilt_y * b * place[:, 1]
    # A dozen products of numbers of order one.
    torch.testing.assert_close(element.shape_functions(place, a, b) @ dofs, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("a", "b"), SIDES)
@pytest.mark.parametrize("power", [tuple(power) for power in element.EXPONENT.tolist()])
def test_each_of_the_twelve_monomials_is_reproduced(power: tuple[int, int], a: float, b: float) -> None:
    place = inner_places(7, seed=2)
    expected = (a * place[:, 0]) ** power[0] * (b * place[:, 1]) ** power[1]
    found = element.shape_functions(place, a, b) @ corner_values(*power, a, b)
    # Rounding of the corner values, which are the largest of the field.
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-14 * a ** power[0] * b ** power[1])


def test_the_polynomial_has_the_twelve_terms_of_the_paper() -> None:
    cubic = {(p, q) for p in range(4) for q in range(4) if p + q <= 3}
    assert {tuple(power) for power in element.EXPONENT.tolist()} == cubic | {(3, 1), (1, 3)}


@pytest.mark.parametrize("order", [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (2, 1), (3, 1), (1, 3)])
def test_each_derivative_of_the_shape_functions_is_the_slope_of_the_one_before(order: tuple[int, int]) -> None:
    a, b = 0.3, 0.12
    place = inner_places(1, seed=3)[0]
    # Lower the order along y where there is one, else along x.
    axis, side = (1, b) if order[1] else (0, a)
    before = (order[0], order[1] - 1) if order[1] else (order[0] - 1, 0)
    slope = torch.autograd.functional.jacobian(lambda at: element.shape_functions(at, a, b, *before), place)
    found = element.shape_functions(place, a, b, *order)
    # Rounding, at the size of the largest derivative.
    torch.testing.assert_close(found, slope[:, axis] / side, rtol=0, atol=1e-13 * found.abs().max().item())


@pytest.mark.parametrize(("a", "b"), SIDES)
@pytest.mark.parametrize("rigidity", [symmetric_positive(4), orthotropic(5)], ids=["full", "orthotropic"])
def test_the_stiffness_is_symmetric_with_three_rigid_motions_and_no_other_without_energy(
    rigidity: torch.Tensor, a: float, b: float
) -> None:
    stiffness = element.stiffness(rigidity, a, b)
    assert torch.equal(stiffness, stiffness.mT)
    scale = torch.tensor([1.0, b, a], dtype=torch.float64).repeat(4)
    energy = torch.linalg.eigvalsh(stiffness / scale[:, None] / scale)
    # Three zeros up to rounding; the softest other deformation of a 5 : 1 element stands far above it.
    assert energy[:3].abs().max() < 1e-13 * energy[-1]
    assert energy[3] > 1e-5 * energy[-1]
    rigid = torch.stack([corner_values(*power, a, b) for power in ((0, 0), (1, 0), (0, 1))], dim=-1)
    residual = (stiffness @ rigid) / scale[:, None]
    assert residual.abs().max() < 1e-12 * (stiffness / scale[:, None]).abs().max() * max(1, a, b)


@pytest.mark.parametrize(("a", "b"), SIDES)
def test_the_energy_of_a_constant_curvature_is_half_moment_times_curvature_times_area(a: float, b: float) -> None:
    rigidity = symmetric_positive(6)
    along_x, along_y, twist = 0.8, -0.5, 1.7
    dofs = along_x / 2 * corner_values(2, 0, a, b) + along_y / 2 * corner_values(0, 2, a, b)
    dofs = dofs + twist * corner_values(1, 1, a, b)
    curvature = -torch.tensor([along_x, along_y, 2 * twist], dtype=torch.float64)
    expected = 0.5 * curvature @ rigidity @ curvature * a * b
    # Differences of stiffness terms: entries grow as 1/side² against curvature, so a few digits are lost at 5 : 1.
    torch.testing.assert_close(0.5 * dofs @ element.stiffness(rigidity, a, b) @ dofs, expected, rtol=1e-10, atol=0)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    ratio=st.floats(0.2, 5.0),
    side=st.floats(0.01, 2.0),
    areal_mass=st.floats(0.5, 200.0),
    seed=st.integers(0, 10**6),
    full=st.booleans(),
)
def test_stiffness_and_mass_equal_gauss_quadrature_at_any_side_ratio(
    reference, ratio: float, side: float, areal_mass: float, seed: int, full: bool
) -> None:
    rigidity = symmetric_positive(seed) if full else orthotropic(seed)
    a, b = side, ratio * side
    stiffness, mass = reference.element(rigidity.numpy(), areal_mass, a, b)
    # Compared with rotations times their sides, so that all entries have one unit. The reference inverts A in metres,
    # which costs it the digits of a condition number near 1e4 for sides of order one.
    scale = np.tile([1.0, b, a], 4)
    unit = np.outer(scale, scale)
    for found, expected in (
        (element.stiffness(rigidity, a, b), stiffness),
        (element.mass(torch.tensor(areal_mass, dtype=torch.float64), a, b), mass),
    ):
        np.testing.assert_allclose(
            found.numpy() / unit, expected / unit, rtol=0, atol=1e-10 * np.abs(expected / unit).max()
        )


@pytest.mark.parametrize(("a", "b", "poisson"), [(0.1, 0.04, 0.3), (0.05, 0.05, 0.2), (0.3, 1.1, 0.0)])
def test_corner_entries_are_those_printed_for_this_element(a: float, b: float, poisson: float) -> None:
    # Petyt, Introduction to Finite Element Vibration Analysis (1990), section 6.2: the deflection of the first corner.
    rigidity = torch.tensor([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]], dtype=torch.float64)
    printed = (4 * ((a / b) ** 2 + (b / a) ** 2) + 0.4 * (7 - 2 * poisson)) / (a * b)
    # Exact formulas: rounding only.
    assert element.stiffness(rigidity, a, b)[0, 0].item() == pytest.approx(printed, rel=1e-13)
    one = torch.tensor(1.0, dtype=torch.float64)
    assert element.mass(one, a, b)[0, 0].item() == pytest.approx(3454 / 25200 * a * b, rel=1e-13)


@pytest.mark.parametrize(("a", "b"), SIDES)
def test_the_mass_is_positive_definite_and_weighs_rigid_motions_exactly(a: float, b: float) -> None:
    mass = element.mass(torch.tensor(3.0, dtype=torch.float64), a, b)
    assert torch.equal(mass, mass.mT)
    assert torch.linalg.eigvalsh(mass).min() > 0
    rigid = torch.stack([corner_values(*power, a, b) for power in ((0, 0), (1, 0), (0, 1))])
    moments = (
        3.0
        * a
        * b
        * torch.tensor(
            [[1, a / 2, b / 2], [a / 2, a**2 / 3, a * b / 4], [b / 2, a * b / 4, b**2 / 3]], dtype=torch.float64
        )
    )
    # Sums of 144 products.
    torch.testing.assert_close(rigid @ mass @ rigid.mT, moments, rtol=1e-12, atol=0)


def test_a_batch_of_elements_equals_its_members() -> None:
    a, b = 0.3, 0.12
    rigidity = torch.stack([symmetric_positive(seed) for seed in range(6)]).reshape(2, 3, 3, 3)
    areal_mass = torch.arange(1.0, 7.0, dtype=torch.float64).reshape(2, 3)
    stiffness, mass = element.stiffness(rigidity, a, b), element.mass(areal_mass, a, b)
    assert stiffness.shape == mass.shape == (2, 3, 12, 12)
    for row in range(2):
        for column in range(3):
            # The same products in another order.
            torch.testing.assert_close(
                stiffness[row, column], element.stiffness(rigidity[row, column], a, b), rtol=1e-13, atol=1e-10
            )
            torch.testing.assert_close(
                mass[row, column], element.mass(areal_mass[row, column], a, b), rtol=1e-14, atol=0
            )


def test_an_elements_matrices_keep_the_dtype_of_what_they_are_made_of() -> None:
    single = element.stiffness(symmetric_positive(7).float(), 0.3, 0.12)
    double = element.stiffness(symmetric_positive(7), 0.3, 0.12)
    assert single.dtype == torch.float32
    # Single precision of a sum of six products.
    torch.testing.assert_close(single.double(), double, rtol=0, atol=1e-6 * double.abs().max().item())


@pytest.mark.parametrize(("a", "b"), SIDES)
def test_a_mass_that_goes_with_the_place_is_integrated_as_the_points_of_gauss_are(a: float, b: float) -> None:
    """m = 1 + 2ξ − 3ξη² about the middle, against 7 × 7 points, of which products of two cubes and it are exact."""
    point, weight = (torch.from_numpy(part) for part in np.polynomial.legendre.leggauss(7))
    place = torch.cartesian_prod(point, point) / 2
    each = torch.cartesian_prod(weight, weight).prod(-1) / 4

    def areal_mass(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return 1 + 2 * x - 3 * x * y**2

    powers = torch.arange(7)
    moments = torch.einsum("g,gp,gq->pq", each * areal_mass(*place.T), place[:, :1] ** powers, place[:, 1:] ** powers)
    found = torch.einsum("k,kpq->pq", moments.flatten(), element.uneven_mass_pattern(a, b))
    shape = element.shape_functions(place + 0.5, a, b)
    expected = a * b * (shape.mT * (each * areal_mass(*place.T))) @ shape
    torch.testing.assert_close(found, expected, rtol=1e-11, atol=1e-13 * float(expected.abs().max()))


def test_what_is_kept_of_an_element_has_gradients_wherever_it_was_made_first():
    """Inference mode marks what is made in it, and that may not be saved for a gradient."""
    a, b = 0.0731, 0.0419
    with torch.inference_mode():
        element.patterns(a, b), element.uneven_patterns(a, b), element.uneven_mass_pattern(a, b)
    kept = (*element.patterns(a, b), element.uneven_patterns(a, b), element.uneven_mass_pattern(a, b))
    assert not any(one.is_inference() for one in kept)
