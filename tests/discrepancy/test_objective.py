"""Measures of the gap, each from the registry, and the function of theta that a search minimises."""

import math

import pytest
import torch

from torchplate.discrepancy import OBJECTIVES, Evidence, Objective, relative_frf_norm
from torchplate.discrepancy.objective import natural_frequency_error
from torchplate.measurement import NaturalFrequencies

# Two lines, one response, two references; the second pair is measured only where a case says so.
MODEL = torch.tensor([[[3.0 + 4.0j, 2.0]], [[0.0, 1.0j]]], dtype=torch.complex128)
MEASURED = torch.tensor([[[0.0 + 5.0j, 1.0]], [[12.0, -1.0j]]], dtype=torch.complex128)
FIRST = torch.tensor([[True, False]])
BOTH = torch.tensor([[True, True]])
# By hand, for both pairs. Pair 1: measured norm 13, |3+4i−5i| = √10, |−12| = 12, amplitudes 5−5 and 0−12.
# Pair 2: measured norm √2, 2−1 = 1, i−(−i) = 2i, amplitudes 2−1 and 1−1.
# The logarithm takes a model without its zero: 3+4i → ratios 5/5 and 24/12, then 2/1 and 1/1.
NO_ZERO = torch.tensor([[[3.0 + 4.0j, 2.0]], [[24.0j, 1.0j]]], dtype=torch.complex128)
BY_HAND = {
    "relative_frf_norm": (MODEL, math.sqrt(10 + 144) / 13 + math.sqrt(1 + 4) / math.sqrt(2)),
    "relative_amplitude_norm": (MODEL, 12 / 13 + 1 / math.sqrt(2)),
    "log_amplitude": (NO_ZERO, math.log(2) * math.sqrt(2 / 4)),
}
# What each gain minimises, as its docstring says.
CRITERIA = {
    "relative_frf_norm": lambda model, measured, pairs: squares(model - measured, measured, pairs),
    "relative_amplitude_norm": lambda model, measured, pairs: squares(model.abs() - measured.abs(), measured, pairs),
    "log_amplitude": lambda model, measured, pairs: float(
        ((model.abs() / measured.abs()).log() ** 2).sum(0)[pairs].sum()
    ),
}


def squares(difference, measured, pairs):
    return float((difference.abs().square().sum(0) / measured.abs().square().sum(0))[pairs].sum())


def random_frfs(seed, *shape):
    generator = torch.Generator().manual_seed(seed)
    return torch.complex(*torch.randn(2, *shape, generator=generator, dtype=torch.float64))


def example(table, name):
    if name not in table:
        pytest.fail(f"The objective '{name}' has no case worked by hand. Add it to the tests' tables.")
    return table[name]


@pytest.mark.parametrize("name", OBJECTIVES)
class TestEveryMeasure:
    def test_equals_a_case_worked_by_hand(self, name):
        model, expected = example(BY_HAND, name)
        assert float(OBJECTIVES[name].gap(model, MEASURED, BOTH)) == pytest.approx(expected, rel=1e-12)

    def test_is_zero_for_equal_frfs_and_positive_otherwise(self, name):
        frfs, pairs = random_frfs(1, 5, 2, 3), torch.ones(2, 3, dtype=torch.bool)
        gap = OBJECTIVES[name].gap
        # A quotient of equal numbers may be off one by a rounding.
        assert 0 <= float(gap(frfs, frfs, pairs)) < 1e-15
        assert float(gap(frfs * 1.01, frfs, pairs)) > 0
        changed = frfs.clone()
        changed[3, 1, 2] *= 1.5
        assert float(gap(changed, frfs, pairs)) > 0

    def test_takes_a_batch_as_its_members_one_by_one(self, name):
        members, measured = random_frfs(2, 3, 4, 5, 2, 3), random_frfs(3, 5, 2, 3)
        pairs = torch.tensor([[True, False, True], [True, True, False]])
        measured = torch.where(pairs, measured, 0.0)
        for function in OBJECTIVES[name]:
            whole = function(members, measured, pairs)
            assert whole.shape == (3, 4)
            alone = torch.stack([torch.stack([function(m, measured, pairs) for m in row]) for row in members])
            # The same sums, in another order.
            assert torch.allclose(whole, alone, rtol=1e-13, atol=0)

    def test_ignores_pairs_that_were_not_measured(self, name):
        measured = torch.where(FIRST, MEASURED, 0.0)
        for function in OBJECTIVES[name]:
            other = NO_ZERO.clone()
            other[..., 1] = 17.0 - 2.0j
            assert torch.equal(function(NO_ZERO, measured, FIRST), function(other, measured, FIRST))
            assert bool(function(NO_ZERO, measured, FIRST).isfinite())

    def test_its_gain_finds_a_known_level(self, name):
        model, pairs = random_frfs(4, 6, 2, 2), torch.tensor([[True, True], [False, True]])
        measured = torch.where(pairs, 3.7 * model, 0.0)
        assert float(OBJECTIVES[name].gain(model, measured, pairs)) == pytest.approx(3.7, rel=1e-12)

    def test_its_gain_is_the_best_there_is(self, name):
        model, noise, pairs = random_frfs(5, 9, 2, 2), random_frfs(6, 9, 2, 2), torch.ones(2, 2, dtype=torch.bool)
        measured = 2.3 * model + 0.4 * noise
        gain, criterion = OBJECTIVES[name].gain(model, measured, pairs), example(CRITERIA, name)
        best = criterion(gain * model, measured, pairs)
        # Far enough for a parabola to rise above rounding, near enough that only the minimum passes.
        for factor in (0.999, 1.001):
            assert criterion(factor * gain * model, measured, pairs) > best

    def test_a_level_of_the_model_drops_out_where_the_gain_is_fitted(self, name):
        model, measured, pairs = random_frfs(7, 9, 2, 2), random_frfs(8, 9, 2, 2), torch.ones(2, 2, dtype=torch.bool)
        measured = measured + 2 * model
        gap, gain = OBJECTIVES[name]
        one, other = (gap(gain(m, measured, pairs) * m, measured, pairs) for m in (model, 41.0 * model))
        assert float(one) == pytest.approx(float(other), rel=1e-12)


def test_the_default_is_the_sum_of_the_papers_equation_22():
    model, measured, pairs = random_frfs(9, 7, 2, 3), random_frfs(10, 7, 2, 3), torch.ones(2, 3, dtype=torch.bool)
    total = 0.0
    for j in range(2):
        for k in range(3):
            over = sum(abs(complex(model[f, j, k]) - complex(measured[f, j, k])) ** 2 for f in range(7))
            under = sum(abs(complex(measured[f, j, k])) ** 2 for f in range(7))
            total += math.sqrt(over) / math.sqrt(under)
    assert float(relative_frf_norm(model, measured, pairs)) == pytest.approx(total, rel=1e-12)


def test_the_complex_gain_never_turns_the_sign():
    model, pairs = random_frfs(11, 6, 1, 1), torch.ones(1, 1, dtype=torch.bool)
    assert float(OBJECTIVES["relative_frf_norm"].gain(model, -2.0 * model, pairs)) == 0.0


def test_lines_at_which_the_measurement_is_zero_say_nothing_to_the_logarithm():
    measured = MEASURED.clone()
    measured[0, 0, 0] = 0.0
    changed = NO_ZERO.clone()
    changed[0, 0, 0] = 1e9
    gap, gain = OBJECTIVES["log_amplitude"]
    for function in (gap, gain):
        assert torch.equal(function(NO_ZERO, measured, BOTH), function(changed, measured, BOTH))
    # Ratios 2, 2 and 1 over three lines.
    assert float(gap(NO_ZERO, measured, BOTH)) == pytest.approx(math.log(2) * math.sqrt(2 / 3), rel=1e-12)


def test_natural_frequencies_are_compared_relative_to_the_measured_ones():
    measured = torch.tensor([10.0, 50.0], dtype=torch.float64)
    model = torch.tensor([[10.3, 48.0], [10.0, 50.0]], dtype=torch.float64)
    expected = [math.sqrt((0.03**2 + 0.04**2) / 2), 0.0]
    assert natural_frequency_error(model, measured).tolist() == pytest.approx(expected, rel=1e-12)


class TestObjective:
    names = ("plate.youngs_modulus", "wires.stiffness", "wires.viscous_damping")

    @pytest.mark.parametrize("name", OBJECTIVES)
    @pytest.mark.parametrize("gain_is_unknown", [False, True])
    def test_is_least_at_the_truth(self, bench, name, gain_is_unknown):
        model = bench.model(self.names)
        truth = bench.truth(model)
        objective = Objective(model, Evidence(bench.measurement(model, truth), None, gain_is_unknown), name)
        others = model.space.to_si(torch.rand(6, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))
        values = objective(torch.cat([truth[None], others]))
        # The logarithm of one has the rounding of the FRFs themselves.
        assert float(values[0]) < 1e-9
        assert bool((values[1:] > 1e-3).all())

    def test_adds_the_error_of_the_natural_frequencies(self, bench):
        model = bench.model(self.names)
        truth = bench.truth(model)
        table = model.natural_frequencies(truth, 7)[[3, 6]] / torch.tensor([1.03, 1.04], dtype=torch.float64)
        evidence = Evidence(bench.measurement(model, truth), NaturalFrequencies(torch.tensor([4, 7]), table))
        found = float(Objective(model, evidence)(truth))
        assert found == pytest.approx(math.sqrt((0.03**2 + 0.04**2) / 2), rel=1e-9)

    def test_the_gap_is_the_mean_over_frfs(self, bench):
        model = bench.model(self.names)
        truth = bench.truth(model)
        objective = Objective(model, Evidence(bench.measurement(model, truth, noise=0.1)))
        assert float(objective.gap(truth)) == pytest.approx(float(objective(truth)) / 4, rel=1e-12)

    def test_the_squares_of_its_residuals_are_those_of_its_measures(self, bench):
        model = bench.model(self.names)
        truth = bench.truth(model)
        frfs = bench.measurement(model, truth, noise=0.1)
        frfs = frfs.select(torch.tensor([[True, True], [False, True]]))
        table = NaturalFrequencies(torch.tensor([4]), model.natural_frequencies(truth, 4)[3:] * 1.05)
        found = Objective(model, Evidence(frfs, table)).residual(truth)
        frf = model.frf(truth, frfs.frequency)
        expected = squares(frf - frfs.frf, frfs.frf, frfs.measured) + (1 - 1 / 1.05) ** 2
        assert found.shape == (2 * 3 * 82 + 1,)
        assert float(found.square().sum()) == pytest.approx(expected, rel=1e-12)

    def test_a_name_that_is_not_there_is_met_by_the_nearest(self, bench):
        model = bench.model(self.names)
        evidence = Evidence(bench.measurement(model, bench.truth(model)))
        with pytest.raises(KeyError, match="Did you mean 'log_amplitude'"):
            Objective(model, evidence, "log_amplitud")

    def test_nothing_to_compare_with_is_refused(self):
        with pytest.raises(ValueError, match="Give a measurement"):
            Evidence()


def test_a_line_at_which_the_model_is_exactly_zero_says_nothing_on_the_log_scale():
    # An accelerance at 0 Hz: the measurement has noise there. By hand, pair 1 has the line 5/5 left, pair 2 2/1, 1/1.
    measure = OBJECTIVES["log_amplitude"]
    assert float(measure.gap(MODEL, MEASURED, BOTH)) == pytest.approx(math.log(2) * math.sqrt(1 / 3), rel=1e-12)
    assert float(measure.gain(MODEL, MEASURED, BOTH)) == pytest.approx(2 ** (-1 / 3), rel=1e-12)
