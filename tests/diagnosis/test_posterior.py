"""How well numbers are known that the data see by themselves, together alone, or not at all."""

import pytest
import torch

from torchplate.diagnosis.posterior import UNIFORM, covariance, seen_together

NOTHING = torch.zeros(3, dtype=torch.float64)


def information(*rows: tuple[float, float, float]) -> torch.Tensor:
    jacobian = torch.tensor(rows, dtype=torch.float64)
    return jacobian.mT @ jacobian


def test_of_numbers_that_the_data_see_it_is_the_inverse_of_what_they_say():
    said = information((1e3, 20.0, 0.0), (5.0, 400.0, 30.0), (0.0, 10.0, 600.0))
    slope = torch.tensor([2.0, 1e9, 1e-3], dtype=torch.float64)
    found = covariance(said, NOTHING, slope) / slope / slope[:, None]
    torch.testing.assert_close(found, said.inverse(), rtol=1e-9, atol=0.0)
    assert seen_together(said, NOTHING) == []


def test_numbers_that_undo_one_another_are_known_no_better_than_their_box():
    said = information((1e3, 1e3, 0.0), (0.0, 0.0, 500.0))
    found = covariance(said, NOTHING, torch.ones(3, dtype=torch.float64))
    # Along (1, −1) a uniform distribution over the box: so far that each has half its variance.
    assert float(found[0, 0]) == pytest.approx(1 / UNIFORM / 2, rel=1e-4)
    together = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
    assert float(together @ found @ together) == pytest.approx(1e-6, rel=1e-6)
    assert float(found[2, 2]) == pytest.approx(1 / 500**2)
    assert seen_together(said, NOTHING) == [[0, 1]]


def test_what_is_known_of_one_of_them_parts_them():
    said, known = information((1e3, 1e3, 0.0), (0.0, 0.0, 500.0)), torch.tensor([1e4, 0.0, 0.0], dtype=torch.float64)
    found = covariance(said, known, torch.ones(3, dtype=torch.float64))
    assert float(found[1, 1]) == pytest.approx(1e-4 + 1e-6)
    assert seen_together(said, known) == []


def test_a_number_that_nothing_is_said_of_has_no_variance():
    said = information((1e3, 0.0, 20.0), (30.0, 0.0, 500.0))
    found = covariance(said, NOTHING, torch.ones(3, dtype=torch.float64))
    assert bool(found[1].isnan().all())
    assert not bool(found[[0, 2]][:, [0, 2]].isnan().any())
    assert seen_together(said, NOTHING) == []
