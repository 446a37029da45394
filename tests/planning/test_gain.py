"""What a test is expected to say, held against closed forms of normal predictions."""

import math

import pytest
import torch

from torchplate.planning.forthcoming import Predicted
from torchplate.planning.gain import expected_gain, narrowed
from torchplate.planning.refit import posterior


def predicted(mean, *columns, n_parameter=0) -> Predicted:
    """What a hypothesis says, by these columns left open."""
    mean = torch.tensor(mean, dtype=torch.float64)
    stack = [torch.tensor(one, dtype=torch.float64) for one in columns]
    return Predicted(mean, torch.stack(stack, dim=-1) if stack else mean.new_zeros(len(mean), 0), n_parameter)


def right(apart: float, prior: float) -> float:
    """Expected probability of the right one of two normals so many standard deviations apart, by the trapezoid rule."""
    x = torch.linspace(-12.0, 12.0 + apart, 20001, dtype=torch.float64)
    one, other = (torch.exp(-0.5 * (x - m) ** 2) / math.sqrt(2 * math.pi) for m in (0.0, apart))
    whole = prior * one + (1 - prior) * other
    both = ((prior * one) ** 2 + ((1 - prior) * other) ** 2) / whole.clamp(min=1e-300)
    return float(torch.trapezoid(both, x))


@pytest.mark.parametrize(("apart", "prior"), [(1.0, 0.5), (2.5, 0.3), (4.0, 0.8)])
def test_two_normals_are_told_as_their_distance_says(apart, prior):
    # Along a direction that is no axis, in more numbers than hypotheses.
    way = torch.tensor([0.6, -0.48, 0.64, 0.0])
    found = expected_gain(
        ["a", "b"], [prior, 1 - prior], [predicted([0.0] * 4), predicted((apart * way).tolist())], seed=3
    )
    # Four hundred draws of something between 0 and 1, from each.
    assert found.probability == pytest.approx(right(apart, prior), abs=0.035)
    assert found.bits <= 1.0


def test_what_a_hypothesis_can_follow_does_not_tell_it():
    far = [30.0, 0.0, 0.0]
    free, held = predicted(far, [40.0, 0.0, 0.0]), predicted(far, [0.0, 40.0, 0.0])
    first = predicted([0.0, 0.0, 0.0], [40.0, 0.0, 0.0])
    told = expected_gain(["a", "b"], [0.5, 0.5], [predicted([0.0] * 3), held])
    followed = expected_gain(["a", "b"], [0.5, 0.5], [first, free])
    assert told.probability > 0.99
    assert told.bits == pytest.approx(1.0, abs=0.02)
    # 30 of √(40² + 40²): hardly apart.
    assert followed.probability < 0.65


def test_hypotheses_of_one_name_are_not_told_apart():
    three = [predicted([0.0, 0.0]), predicted([9.0, 0.0]), predicted([0.0, 0.3])]
    found = expected_gain(["a", "a", "b"], [0.4, 0.2, 0.4], three)
    assert set(found.said) == {"a", "b"}
    # A third of what is called a is at once known for it; between the other two a coin decides.
    assert 0.6 < found.probability < 0.8
    for told in found.said.values():
        assert sum(told.values()) == pytest.approx(1.0)


def test_information_is_no_less_than_pairwise_distances_say():
    """Kolchinsky and Tracey's bound, for one covariance: exp(−|m_i − m_j|² / 8)."""
    means = torch.tensor([[0.0, 0.0], [3.0, 0.5], [-1.0, 4.0]])
    p = torch.tensor([0.5, 0.2, 0.3], dtype=torch.float64)
    found = expected_gain(["a", "b", "c"], p.tolist(), [predicted(one.tolist()) for one in means])
    near = torch.exp(-torch.cdist(means.double(), means.double()).square() / 8)
    least = float(-(p * (near @ p).log()).sum()) / math.log(2)
    entropy = float(-(p * p.log2()).sum())
    assert least < found.bits < entropy


def test_an_interval_narrows_as_the_numbers_of_the_test_say():
    axes = torch.tensor([[2.0, 0.0], [1.0, 0.5]], dtype=torch.float64)
    # The first axis shows two standard deviations of the noise, the second nothing; the last column is a nuisance.
    test = predicted([0.0, 0.0], [2.0, 0.0], [0.0, 0.0], [0.0, 3.0], n_parameter=2)
    found = narrowed(["p", "q"], axes, test)
    assert found["p"] == pytest.approx(math.sqrt(1 / 5))
    assert found["q"] == pytest.approx(math.sqrt((1 / 5 + 0.25) / 1.25))
    hidden = predicted([0.0, 0.0], [2.0, 0.0], [0.0, 0.0], [100.0, 0.0], n_parameter=2)
    assert narrowed(["p", "q"], axes, hidden)["p"] > 0.99


def test_evidence_becomes_probability_by_name():
    found = posterior(["a", "b", "a"], [0.2, 0.5, 0.3], [0.0, 2 * math.log(5.0), 0.0])
    assert found == pytest.approx({"a": 5 / 6, "b": 1 / 6})
