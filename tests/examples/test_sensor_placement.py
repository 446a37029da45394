"""Sensor places by gradient keep the standard errors that they promise."""

import pytest
import torch

from torchplate.examples import sensor_placement
from torchplate.examples.sensor_placement import (
    CORNERS,
    FORCE,
    FREQUENCY,
    Layout,
    correlation,
    information,
    jacobian,
    layout,
    log_det,
    main,
    plate,
    readings,
)

# torch.func.jvp loads its own rules by torch.jit.script, which warns of itself.
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")
TRUTH = torch.tensor([0.45, 0.6, 0.4, 0.55, 0.4, 0.6], dtype=torch.float64)
N_TEST = 40


@pytest.fixture(scope="module")
def found() -> dict[str, tuple[Layout, torch.Tensor | None]]:
    return main(n_random=30, n_start=2, n_step=25, n_test=N_TEST, say=lambda _: None)


@pytest.mark.check
def test_the_gradient_beats_corners_chance_and_the_nodes(found: dict) -> None:
    volume = {name: one.log_det for name, (one, _) in found.items()}
    gradient = volume.pop("gradient")
    # Between the nodes there is more to choose from than on them: 0.5 more was found. The chance layouts lie far below.
    assert gradient > 0.2 + max(volume.values()), (gradient, volume)


@pytest.mark.check
def test_every_standard_error_falls_against_the_corners(found: dict) -> None:
    corners, gradient = found["corners, 10 % inside"][0], found["gradient"][0]
    # The full form finds 0.36 to 0.45 of them.
    assert bool((gradient.standard_error < 0.6 * corners.standard_error).all())


@pytest.mark.check
@pytest.mark.parametrize("name", ["corners, 10 % inside", "gradient"])
def test_fitted_tests_scatter_as_promised(found: dict, name: str) -> None:
    one, scatter = found[name]
    # A standard deviation of 40 draws is known to 1 / √78 = 11 %; three times that.
    ratio = scatter / one.standard_error
    assert bool(((ratio > 0.66) & (ratio < 1.34)).all()), ratio


def test_the_places_gradient_is_that_of_differences() -> None:
    model, n = plate(), 3
    # Inside the elements: the slope across an element's edge jumps a little.
    places = torch.tensor([(0.31, 0.29), (0.66, 0.54), (0.56, 0.79)], dtype=torch.float64)

    def volume(at: torch.Tensor) -> torch.Tensor:
        return log_det(information(jacobian(model, TRUTH, at), at))

    wanted = places.clone().requires_grad_()
    volume(wanted).backward()
    step = 1e-5
    for k in range(n):
        for axis in range(2):
            shift = torch.zeros_like(places)
            shift[k, axis] = step
            expected = float((volume(places + shift) - volume(places - shift)) / (2 * step))
            # The step's square, and rounding 1e-12 over the step, against slopes of order ten.
            assert float(wanted.grad[k, axis]) == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_the_jacobian_is_that_of_differences() -> None:
    model, step = plate(), 1e-5
    places = CORNERS[1:3]
    slope = jacobian(model, TRUTH, places)
    assert slope.shape == (2, 2 * len(FREQUENCY), 6)
    for k in range(6):
        shift = step * torch.eye(6, dtype=torch.float64)[k]
        expected = (readings(model, TRUTH + shift, places) - readings(model, TRUTH - shift, places)) / (2 * step)
        # The step's square times third derivatives of sharp peaks.
        torch.testing.assert_close(slope[..., k], expected, rtol=0, atol=1e-5 * float(expected.abs().max()))


def test_information_of_far_sensors_adds_and_of_one_spot_does_not() -> None:
    generator = torch.Generator().manual_seed(0)
    slope = torch.randn(1, 7, 3, generator=generator, dtype=torch.float64)
    single = slope[0].mT @ slope[0]
    far, near = torch.tensor([[(0.1, 0.1), (0.9, 0.9)], [(0.4, 0.3), (0.4, 0.3)]], dtype=torch.float64)
    twice = slope.expand(2, -1, -1)
    torch.testing.assert_close(information(twice, far), 2 * single)
    # Half shared noise: the mean of two has variance ¾, so that both tell 4/3 of one.
    torch.testing.assert_close(information(twice, near), single * 4 / 3)


def test_noise_correlates_with_distance_alone() -> None:
    matrix = correlation(torch.tensor([(0.2, 0.7), (0.3, 0.7), (0.2, 0.6)], dtype=torch.float64))
    torch.testing.assert_close(matrix.diagonal(), torch.ones(3, dtype=torch.float64))
    torch.testing.assert_close(matrix[0, 1], torch.tensor(0.5, dtype=torch.float64) * torch.exp(torch.tensor(-0.5)))
    torch.testing.assert_close(matrix[0, 1], matrix[0, 2])


def test_readings_at_a_tensor_of_places_are_those_at_numbers() -> None:
    model = plate()
    given = model.frf(model.space.to_si(TRUTH), FREQUENCY, CORNERS.tolist(), FORCE)
    whole = torch.view_as_real(given[..., 0].mT / sensor_placement.NOISE).flatten(-2)
    torch.testing.assert_close(readings(model, TRUTH, CORNERS), whole, rtol=1e-12, atol=0)


def test_more_sensors_never_tell_less() -> None:
    model = plate()
    few, many = layout(model, TRUTH, CORNERS[:2]), layout(model, TRUTH, CORNERS)
    assert few.log_det < many.log_det
    assert bool((many.standard_error < few.standard_error).all())
