"""What users of the model give comes through, or one sentence says what to write instead."""

import numpy as np
import pytest
import torch

from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

MESH = Mesh(0.7, 0.4, 5, 3)
INTERVALS = {
    "plate.youngs_modulus": Searched(5e10, 9e10),
    "wires.stiffness": Searched(1e2, 1e4, logarithmic=True),
    "loss.stiffness_loss_factor": Searched(1e-4, 1e-2),
}
THETA = [6e10, 900.0, 3e-3]
LINES = [20.0, 33.0, 71.0, 120.0]
# Rounding at the scale of the highest eigenvalue, where sums are taken in another order.
ROUNDING = 1e-8


@pytest.fixture(scope="module")
def model(plates) -> PlateModel:
    return plates.build(MESH, None, INTERVALS, response=[3], reference=[7, 24])


@pytest.fixture(scope="module")
def expected(model: PlateModel) -> torch.Tensor:
    return model.frf(torch.tensor(THETA, dtype=torch.float64), torch.tensor(LINES, dtype=torch.float64))


@pytest.mark.parametrize(
    "theta",
    [THETA, tuple(THETA), np.array(THETA), [torch.tensor(value, dtype=torch.float64) for value in THETA]],
    ids=["list", "tuple", "array", "list of tensors"],
)
@pytest.mark.parametrize("lines", [LINES, np.array(LINES), torch.tensor(LINES)], ids=["list", "array", "single"])
def test_lists_and_arrays_come_through(model, expected, theta, lines) -> None:
    torch.testing.assert_close(model.frf(theta, lines), expected, rtol=0, atol=0)
    assert model.natural_frequencies(theta, 5).shape == (5,)


def test_whole_numbers_are_numbers(model, expected) -> None:
    theta, lines = torch.tensor([60_000_000_000, 900, 0]), torch.tensor([20, 33])
    assert torch.isfinite(torch.view_as_real(model.frf(theta, lines))).all()
    torch.testing.assert_close(model.frf(THETA, lines), expected[:2], rtol=ROUNDING, atol=0)


def test_a_single_line_is_one_line(model, expected) -> None:
    torch.testing.assert_close(model.frf(THETA, 33.0), expected[1:2], rtol=ROUNDING, atol=0)


def test_tensors_in_a_list_keep_their_gradient(model) -> None:
    stiffness = torch.tensor(900.0, dtype=torch.float64, requires_grad=True)
    model.frf([torch.tensor(6e10, dtype=torch.float64), stiffness, 3e-3], LINES).abs().sum().backward()
    assert stiffness.grad is not None
    assert float(stiffness.grad) != 0


def test_called_it_is_frf(model, expected) -> None:
    torch.testing.assert_close(model(THETA, LINES), expected, rtol=0, atol=0)
    torch.testing.assert_close(model(THETA, LINES, [3], reference=[24]), expected[..., 1:], rtol=0, atol=0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((), ["theta, one value in SI units for each of plate.youngs_modulus", "model(theta, frequency)"]),
        ((THETA,), ["frequency lines [Hz]", "got none", "model(theta, torch.linspace", "model.natural_frequencies"]),
        ((THETA, None, [3]), ["frequency lines [Hz]", "got none"]),
    ],
)
def test_called_without_lines_it_says_what_to_write(model, given, words) -> None:
    for call in (model, model.frf):
        with pytest.raises(ValueError, match=r"^Expected ") as told:
            call(*given)
        assert all(word in str(told.value) for word in words), told.value
        assert "\n" not in str(told.value)


@pytest.mark.parametrize("response", [3, np.int64(3), [np.int64(3)], np.array([3]), torch.tensor([3]), torch.tensor(3)])
def test_a_node_may_stand_alone_and_come_from_anywhere(model, expected, response) -> None:
    torch.testing.assert_close(model.frf(THETA, LINES, response), expected, rtol=0, atol=0)


@pytest.mark.parametrize("place", [(0.4, 0.0), [0.4, 0.0], [(0.4, 0.0)], np.array([[0.4, 0.0]])])
def test_a_place_may_stand_alone(model, expected, place) -> None:
    # Node 3 of 5 × 3 is at two fifths of the edge; its place is rounded.
    torch.testing.assert_close(model.frf(THETA, LINES, place), expected, rtol=ROUNDING, atol=0)


@pytest.mark.parametrize("batch", [(0,), (0, 2), (3, 0)])
def test_an_empty_batch_has_an_empty_answer(model, batch) -> None:
    theta = torch.zeros(*batch, 3, dtype=torch.float64, requires_grad=True)
    found = model.frf(theta, LINES)
    assert found.shape == (*batch, 4, 1, 2)
    found.abs().sum().backward()
    assert theta.grad is not None
    assert model.natural_frequencies(theta, 5).shape == (*batch, 5)
    assert model.frf(theta.float(), LINES).dtype == torch.complex64


def test_no_line_has_an_empty_answer(model) -> None:
    assert model.frf([THETA, THETA], []).shape == (2, 0, 1, 2)


REFUSED = {
    "unit cube": ([0.3, 0.8, 0.5], ["plate.youngs_modulus", "5e+10 to 9e+10 [Pa]", "0.3", "to_si", "check=False"]),
    "one in the unit cube": ([6e10, 0.8, 3e-3], ["wires.stiffness", "0.8", "to_si", "check=False"]),
    "negative": ([-6e10, 900.0, 3e-3], ["plate.youngs_modulus above 0 [Pa]", "-6e+10", "check=False"]),
    "negative loss": ([6e10, 900.0, -3e-3], ["loss.stiffness_loss_factor at least 0 [-]", "-0.003"]),
    "not a number": ([6e10, float("nan"), 3e-3], ["wires.stiffness", "nan"]),
    "mPa": ([6e13, 900.0, 3e-3], ["plate.youngs_modulus", "6e+13"]),
    "GPa": ([60.0, 900.0, 3e-3], ["plate.youngs_modulus", "got 60"]),
    "another order": ([900.0, 6e10, 3e-3], ["plate.youngs_modulus", "got 900"]),
    "one of a batch": ([THETA, [-6e10, 900.0, 3e-3]], ["plate.youngs_modulus above 0", "-6e+10"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_theta_that_no_plate_has_is_refused_with_a_way_out(model, case) -> None:
    theta, words = REFUSED[case]
    for call in (
        lambda: model.frf(theta, LINES),
        lambda: model.frf_direct(theta, LINES),
        lambda: model.natural_frequencies(theta, 3),
        lambda: model.modes(theta),
        lambda: model.frf(torch.tensor(theta, requires_grad=True), LINES),
    ):
        with pytest.raises(ValueError, match=r"^Expected ") as told:
            call()
        assert all(word in str(told.value) for word in words), told.value


def test_unchecked_any_value_is_taken(model) -> None:
    assert model.frf([0.3, 0.8, 0.5], LINES, check=False).shape == (4, 1, 2)
    assert model.natural_frequencies([0.3, 0.8, 0.5], 3, check=False).shape == (3,)
    assert model.frf(THETA, [-20.0], check=False).shape == (1, 1, 2)


@pytest.mark.parametrize(
    "theta", [[2e10, 900.0, 3e-3], [6e10, 0.0, 0.0], [6e10, 5e5, 0.5], [6e10, 900.0, 3.0], [5e10, 1e2, 1e-4]]
)
def test_a_theta_outside_its_interval_or_on_its_end_is_fine(model, theta) -> None:
    assert torch.isfinite(torch.view_as_real(model.frf(theta, LINES))).all()


def test_the_ends_of_the_box_are_inside_whatever_rounding_does(plates) -> None:
    # 0.1 + (1 − 0.1) · 1 and its like may exceed what the parameter allows by one digit.
    for low in (0.1, 0.3, 0.7):
        model = plates.build(MESH, None, {"loss.stiffness_loss_factor": Searched(low, 1.0)})
        model.natural_frequencies(model.space.to_si(torch.ones(1, 1, dtype=torch.float64)) + 1e-15, 3)


def test_a_subclass_may_take_values_of_its_own_beside_the_named(plates, model, expected) -> None:
    class Wider(PlateModel):
        def values(self, theta):
            return super().values(theta[..., :3])

    wide = plates.build(MESH, None, INTERVALS, response=[3], reference=[7, 24])
    wide.__class__ = Wider
    torch.testing.assert_close(wide.frf([*THETA, -5.0], LINES), expected, rtol=ROUNDING, atol=0)
    with pytest.raises(ValueError, match="above 0"):
        wide.frf([-6e10, *THETA[1:], -5.0], LINES)


def test_nothing_is_checked_inside_a_transform(model) -> None:
    theta = torch.tensor([THETA, [-6e10, 900.0, 3e-3]], dtype=torch.float64)
    assert torch.func.vmap(lambda one: model.frf(one, torch.tensor(LINES)).abs())(theta).shape == (2, 4, 1, 2)
    slope = torch.func.grad(lambda one: model.natural_frequencies(one, 6)[..., 4])(theta[0])
    assert bool(torch.isfinite(slope).all())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"theta": 6e10}, ["last dimension of 3", "a single number", "model.names"]),
        ({"theta": THETA[:2]}, ["last dimension of 3", "got 2"]),
        ({"theta": ["a", "b", "c"]}, ["theta as real numbers", "list"]),
        ({"theta": torch.tensor(THETA, dtype=torch.complex128)}, ["theta as real numbers", "complex128"]),
        ({"theta": torch.ones(3, dtype=torch.bool)}, ["theta as real numbers", "bool"]),
        ({"frequency": [20.0, -3.0]}, ["from 0 on", "-3"]),
        ({"frequency": [20.0, float("nan")]}, ["from 0 on", "nan"]),
        ({"frequency": [[20.0], [30.0]]}, ["one dimension", "(2, 1)"]),
        ({"frequency": "twenty"}, ["frequency as real numbers", "'twenty'"]),
        ({"frequency": torch.tensor([2j])}, ["frequency as real numbers", "complex64"]),
        ({"response": []}, ["at least one", "response=[3]"]),
        ({"response": "3"}, ["node labels or relative places", "'3'"]),
        ({"response": ["3"]}, ["node labels or relative places", "'3'"]),
        ({"response": 3.0}, ["node labels or relative places", "3.0"]),
        ({"reference": [3.5]}, ["reference=[3]", "3.5"]),
        ({"reference": torch.rand(2, 3)}, ["reference", "(2, 3)"]),
        ({"reference": 99}, ["labels from 1 to 24", "99"]),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(model, change, words) -> None:
    given = {"theta": THETA, "frequency": LINES} | change
    with pytest.raises(ValueError, match=r"^Expected ") as told:
        model.frf(**given)
    assert all(word in str(told.value) for word in words), told.value
    assert "\n" not in str(told.value)


def test_theta_on_another_device_is_one_sentence(model) -> None:
    with pytest.raises(ValueError, match=r"theta on cpu, as the model, got it on meta.*theta\.to\('cpu'\)"):
        model.frf(torch.ones(3, device="meta"), LINES)
