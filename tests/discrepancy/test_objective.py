"""Measures of the gap, each from the registry, and the function of theta that a search minimises."""

import math
from dataclasses import replace

import pytest
import torch

from torchplate.discrepancy import OBJECTIVES, Evidence, Measured, Objective, relative_frf_norm
from torchplate.discrepancy.measure import check_suits
from torchplate.discrepancy.natural_frequency import mode_weight, natural_frequency_error
from torchplate.measurement import NaturalFrequencies

# Two lines, one response, two references; the second pair is measured only where a case says so.
MODEL = torch.tensor([[[3.0 + 4.0j, 2.0]], [[0.0, 1.0j]]], dtype=torch.complex128)
MEASURED = torch.tensor([[[0.0 + 5.0j, 1.0]], [[12.0, -1.0j]]], dtype=torch.complex128)
FIRST = torch.tensor([[True, False]])
BOTH = torch.tensor([[True, True]])
# γ² / (1 − γ²) of 9, 3, 3 and 1, each over |H_measured|².
PRECISION = torch.tensor([[[9 / 25, 3.0]], [[3 / 144, 1.0]]], dtype=torch.float64)
# By hand, for both pairs. Pair 1: measured norm 13, |3+4i−5i| = √10, |−12| = 12, amplitudes 5−5 and 0−12.
# Pair 2: measured norm √2, 2−1 = 1, i−(−i) = 2i, amplitudes 2−1 and 1−1.
# The logarithm takes a model without its zero: 3+4i → ratios 5/5 and 24/12, then 2/1 and 1/1.
NO_ZERO = torch.tensor([[[3.0 + 4.0j, 2.0]], [[24.0j, 1.0j]]], dtype=torch.complex128)
BY_HAND = {
    "relative_frf_norm": (MODEL, math.sqrt(10 + 144) / 13 + math.sqrt(1 + 4) / math.sqrt(2)),
    "relative_amplitude_norm": (MODEL, 12 / 13 + 1 / math.sqrt(2)),
    "log_amplitude": (NO_ZERO, math.log(2) * math.sqrt(2 / 4)),
    # |e|² / |H|² = 10/25, 1, 1 and 4, weighed by 9, 3, 3 and 1.
    "coherence_weighted": (MODEL, math.sqrt((9 * 10 / 25 + 3 + 3 + 4) / 16)),
    # Along the lines: |−5i (3+4i)|² / (169 · 25) and |2 + i·i|² / (2 · 5).
    "frac": (MODEL, 1 - (625 / (169 * 25) + 1 / 10) / 2),
    # Across the pairs: |−5i (3+4i) + 2|² = |22 − 15i|² over 26 · 29, then |i·i|² over 145 · 1.
    "csac": (MODEL, 1 - ((22**2 + 15**2) / (26 * 29) + 1 / 145) / 2),
    "csf": (MODEL, 1 - (2 * math.hypot(22, 15) / (26 + 29) + 2 / (145 + 1)) / 2),
}


def of(frf, pairs, precision=None):
    """As a measure sees it; where the test says nothing of the coherence, it falls from line to line."""
    if precision is None:
        quality = torch.linspace(8.0, 2.0, len(frf), dtype=torch.float64)[:, None, None]
        power = frf.abs().square()
        precision = torch.where(power > 0, quality / torch.where(power > 0, power, 1.0), 0.0)
    return Measured(frf, pairs, precision)


def line_levels(model, seen):
    """Weight and logarithm of ‖measured‖ / ‖model‖ over the FRFs, line by line."""
    for one, other in zip(model[:, seen.pairs], seen.frf[:, seen.pairs], strict=True):
        cosine = abs(complex((one.conj() * other).sum())) / (float(one.norm()) * float(other.norm()))
        yield cosine, math.log(float(other.norm()) / float(one.norm()))


# What each gain minimises, as its docstring says.
AMPLITUDES = lambda model, seen: squares(model.abs() - seen.frf.abs(), seen.frf, seen.pairs)  # noqa: E731
CRITERIA = {
    "relative_frf_norm": lambda model, seen: squares(model - seen.frf, seen.frf, seen.pairs),
    "relative_amplitude_norm": AMPLITUDES,
    "log_amplitude": lambda model, seen: float(((model.abs() / seen.frf.abs()).log() ** 2).sum(0)[seen.pairs].sum()),
    "coherence_weighted": lambda model, seen: float((seen.precision * (model - seen.frf).abs() ** 2).sum()),
    "frac": AMPLITUDES,
    "csac": AMPLITUDES,
    "csf": lambda model, seen: sum(weight * log**2 for weight, log in line_levels(model, seen)),
}


def squares(difference, measured, pairs):
    return float((difference.abs().square().sum(0) / measured.abs().square().sum(0))[pairs].sum())


def seeded(seed):
    return torch.Generator().manual_seed(seed)


def random_frfs(seed, *shape):
    generator = torch.Generator().manual_seed(seed)
    return torch.complex(*torch.randn(2, *shape, generator=generator, dtype=torch.float64))


def example(table, name):
    if name not in table:
        pytest.fail(f"The objective '{name}' has no case worked by hand. Add it to the tests' tables.")
    return table[name]


def functions(name):
    """What a measure computes from FRFs: its gap, its gain, its residuals."""
    measure = OBJECTIVES[name]
    return measure.gap, measure.gain, measure.deviation.residual


@pytest.mark.parametrize("name", OBJECTIVES)
class TestEveryMeasure:
    def test_equals_a_case_worked_by_hand(self, name):
        model, expected = example(BY_HAND, name)
        assert float(OBJECTIVES[name].gap(model, of(MEASURED, BOTH, PRECISION))) == pytest.approx(expected, rel=1e-12)

    def test_is_zero_for_equal_frfs_and_positive_otherwise(self, name):
        frfs, pairs = random_frfs(1, 5, 2, 3), torch.ones(2, 3, dtype=torch.bool)
        gap, seen = OBJECTIVES[name].gap, of(frfs, pairs)
        # A quotient of equal numbers may be off one by a rounding.
        assert 0 <= float(gap(frfs, seen)) < 1e-15
        changed = frfs.clone()
        changed[3, 1, 2] *= 1.5
        assert float(gap(changed, seen)) > 1e-3
        # What is blind to the level is so to rounding; what is not changes by 1 % or, for CSF, by half its square.
        assert (float(gap(frfs * 1.01, seen)) > 1e-5) == OBJECTIVES[name].sees_level

    def test_takes_a_batch_as_its_members_one_by_one(self, name):
        members, measured = random_frfs(2, 3, 4, 5, 2, 3), random_frfs(3, 5, 2, 3)
        pairs = torch.tensor([[True, False, True], [True, True, False]])
        seen = of(torch.where(pairs, measured, 0.0), pairs)
        for function in functions(name):
            whole = function(members, seen)
            assert whole.shape[:2] == (3, 4)
            alone = torch.stack([torch.stack([function(m, seen) for m in row]) for row in members])
            # The same sums, in another order.
            assert torch.allclose(whole, alone, rtol=1e-13, atol=0)

    def test_ignores_pairs_that_were_not_measured(self, name):
        seen = of(torch.where(FIRST, MEASURED, 0.0), FIRST)
        for function in functions(name):
            other = NO_ZERO.clone()
            other[..., 1] = 17.0 - 2.0j
            assert torch.equal(function(NO_ZERO, seen), function(other, seen))
            assert bool(function(NO_ZERO, seen).isfinite().all())

    def test_its_gain_finds_a_known_level(self, name):
        model, pairs = random_frfs(4, 6, 2, 2), torch.tensor([[True, True], [False, True]])
        seen = of(torch.where(pairs, 3.7 * model, 0.0), pairs)
        assert float(OBJECTIVES[name].gain(model, seen)) == pytest.approx(3.7, rel=1e-12)

    def test_its_gain_is_the_best_there_is(self, name):
        model, noise, pairs = random_frfs(5, 9, 2, 2), random_frfs(6, 9, 2, 2), torch.ones(2, 2, dtype=torch.bool)
        seen = of(2.3 * model + 3.0 * noise, pairs)
        gain, criterion = OBJECTIVES[name].gain(model, seen), example(CRITERIA, name)
        best = criterion(gain * model, seen)
        # Far enough for a parabola to rise above rounding, near enough that only the minimum passes.
        for factor in (0.999, 1.001):
            assert criterion(factor * gain * model, seen) > best

    def test_a_level_of_the_model_drops_out_where_the_gain_is_fitted(self, name):
        model, measured, pairs = random_frfs(7, 9, 2, 2), random_frfs(8, 9, 2, 2), torch.ones(2, 2, dtype=torch.bool)
        seen = of(measured + 2 * model, pairs)
        gap, gain, _ = functions(name)
        one, other = (gap(gain(m, seen)[None, None, None] * m, seen) for m in (model, 41.0 * model))
        assert float(one) == pytest.approx(float(other), rel=1e-12)

    def test_is_the_norm_of_its_residuals_that_it_says_it_is(self, name):
        model, measured = random_frfs(12, 7, 2, 3), random_frfs(13, 7, 2, 3)
        pairs = torch.tensor([[True, False, True], [True, True, True]])
        seen, measure = of(torch.where(pairs, measured, 0.0), pairs), OBJECTIVES[name]
        residual = measure.deviation.residual(model, seen)
        expected = {
            "each": residual.square().sum((0, 3)).sqrt().sum(),
            "joint": residual.norm(),
            # Without residuals of its own: those of the paper's norm.
            "other": relative_frf_norm(model, seen),
        }[measure.norm]
        found = measure.gap(model, seen) if measure.norm != "other" else residual.square().sum((0, 3)).sqrt().sum()
        assert float(found) == pytest.approx(float(expected), rel=1e-12)

    def test_its_slope_is_what_noise_does_to_its_residuals(self, name):
        model, pairs = 2.0 + random_frfs(14, 6, 2, 2), torch.tensor([[True, False], [True, True]])
        seen, deviation = of(torch.where(pairs, model, 0.0), pairs), OBJECTIVES[name].deviation
        noise = 1e-6 * random_frfs(15, 6, 2, 2)
        change = deviation.residual(model + noise, seen) - deviation.residual(model, seen)
        # Along the FRF for a measure of amplitudes, along both axes for a complex one; second order in 1e-6.
        along = (noise * model.conj()).real / model.abs()
        parts = torch.stack([noise.real, noise.imag], -1) if change.shape[-1] == 2 else along[..., None]
        assert torch.allclose(change, deviation.slope(seen)[..., None] * parts, rtol=1e-4, atol=1e-10)


def test_the_default_is_the_sum_of_the_papers_equation_22():
    model, measured, pairs = random_frfs(9, 7, 2, 3), random_frfs(10, 7, 2, 3), torch.ones(2, 3, dtype=torch.bool)
    total = 0.0
    for j in range(2):
        for k in range(3):
            over = sum(abs(complex(model[f, j, k]) - complex(measured[f, j, k])) ** 2 for f in range(7))
            under = sum(abs(complex(measured[f, j, k])) ** 2 for f in range(7))
            total += math.sqrt(over) / math.sqrt(under)
    assert float(relative_frf_norm(model, of(measured, pairs))) == pytest.approx(total, rel=1e-12)


def test_a_measurement_that_is_a_conjugate_by_name_alone_is_compared_as_one():
    generator = torch.Generator().manual_seed(3)
    frf, model = (torch.randn(9, 1, 2, dtype=torch.complex128, generator=generator) for _ in range(2))
    pairs = torch.ones(1, 2, dtype=torch.bool)
    lazy = frf.conj()
    assert lazy.is_conj()
    found = relative_frf_norm(model, Measured(lazy, pairs))
    torch.testing.assert_close(found, relative_frf_norm(model, Measured(lazy.resolve_conj(), pairs)))


def test_the_complex_gain_never_turns_the_sign():
    model, pairs = random_frfs(11, 6, 1, 1), torch.ones(1, 1, dtype=torch.bool)
    assert float(OBJECTIVES["relative_frf_norm"].gain(model, of(-2.0 * model, pairs))) == 0.0


def test_lines_at_which_the_measurement_is_zero_say_nothing_to_the_logarithm():
    measured = MEASURED.clone()
    measured[0, 0, 0] = 0.0
    changed = NO_ZERO.clone()
    changed[0, 0, 0] = 1e9
    seen = of(measured, BOTH)
    for function in functions("log_amplitude"):
        assert torch.equal(function(NO_ZERO, seen), function(changed, seen))
    # Ratios 2, 2 and 1 over three lines.
    assert float(OBJECTIVES["log_amplitude"].gap(NO_ZERO, seen)) == pytest.approx(
        math.log(2) * math.sqrt(2 / 3), rel=1e-12
    )


def test_natural_frequencies_are_compared_relative_to_the_measured_ones():
    # Printed so finely that rounding adds nothing to their common relative scatter.
    measured = torch.tensor([10.000000001, 50.0], dtype=torch.float64)
    model = torch.tensor([1.03, 0.96], dtype=torch.float64) * measured
    model = torch.stack([model, measured])
    expected = [math.sqrt((0.03**2 + 0.04**2) / 2), 0.0]
    alike = mode_weight(NaturalFrequencies(torch.tensor([4, 6]), measured))
    assert natural_frequency_error(model, measured, alike).tolist() == pytest.approx(expected, rel=1e-12)


def test_a_natural_frequency_weighs_by_one_over_its_standard_deviation():
    measured = torch.tensor([10.0, 50.0, 80.0], dtype=torch.float64)
    model = torch.tensor([10.3, 48.0, 80.4], dtype=torch.float64)
    # 0.2 % and 2 % of the frequency; the last counts as known to 0.1 % and to the printed hertz.
    std = torch.tensor([0.02, 1.0, math.nan], dtype=torch.float64)
    weight = mode_weight(NaturalFrequencies(torch.tensor([4, 6, 9]), measured, std))
    last = math.hypot(1e-3 * 80, 1 / math.sqrt(12))
    expected = math.sqrt(
        ((0.3 / 0.02) ** 2 + (2.0 / 1.0) ** 2 + (0.4 / last) ** 2) / (500**2 + 50**2 + (80 / last) ** 2)
    )
    assert float(natural_frequency_error(model, measured, weight)) == pytest.approx(expected, rel=1e-12)


class TestMeasured:
    def test_precision_is_that_of_the_coherence(self, bench):
        model = bench.model(["plate.youngs_modulus"])
        frfs = bench.measurement(model, bench.truth(model))
        coherence = torch.full(frfs.frf.shape, 0.8, dtype=torch.float64)
        coherence[3, 1, 0], coherence[4, 1, 0], coherence[5, 1, 0] = math.nan, 0.0, 1.0
        found = Measured.of(replace(frfs, coherence=coherence)).precision * frfs.frf.abs().square()
        assert float(found[0, 0, 0]) == pytest.approx(0.8 / 0.2, rel=1e-12)
        assert found[3:5, 1, 0].tolist() == [0.0, 0.0]
        # A coherence of 1 is not believed beyond 0.9999.
        assert float(found[5, 1, 0]) == pytest.approx(0.9999 / 0.0001, rel=1e-9)

    def test_a_measure_that_needs_a_coherence_refuses_frfs_without(self, bench):
        model = bench.model(["plate.youngs_modulus"])
        frfs = bench.measurement(model, bench.truth(model))
        with pytest.raises(ValueError, match=r"got none in the measurement\. Export the coherence"):
            check_suits("coherence_weighted", frfs)
        coherence = torch.full(frfs.frf.shape, 0.8, dtype=torch.float64)
        coherence[:, 1, 0] = math.nan
        with pytest.raises(ValueError, match="got none for 7w/1w"):
            check_suits("coherence_weighted", replace(frfs, coherence=coherence))

    @pytest.mark.parametrize("name", OBJECTIVES)
    def test_a_single_frf_is_refused_where_it_says_nothing(self, bench, name):
        model = bench.model(["plate.youngs_modulus"])
        frfs = bench.measurement(model, bench.truth(model))
        single = replace(frfs, coherence=torch.full(frfs.frf.shape, 0.8, dtype=torch.float64))
        single = single.select(torch.tensor([[False, True], [False, False]]))
        other = 3j * (1 + torch.arange(len(single.frf)))[:, None, None] * single.frf
        constant = float(OBJECTIVES[name].gap(other, Measured.of(single))) < 1e-12
        if constant:
            with pytest.raises(ValueError, match="Expected at least 2 FRFs"):
                check_suits(name, single)
        else:
            check_suits(name, single)


class TestObjective:
    names = ("plate.youngs_modulus", "wires.stiffness", "wires.viscous_damping")

    @pytest.mark.parametrize("name", OBJECTIVES)
    @pytest.mark.parametrize("gain_is_unknown", [False, True])
    def test_is_least_at_the_truth(self, bench, name, gain_is_unknown):
        model = bench.model(self.names)
        truth = bench.truth(model)
        frfs = bench.measurement(model, truth)
        frfs = replace(frfs, coherence=torch.full(frfs.frf.shape, 0.9, dtype=torch.float64))
        objective = Objective(model, Evidence(frfs, None, gain_is_unknown), name)
        others = model.space.to_si(torch.rand(6, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))
        values = objective(torch.cat([truth[None], others]))
        # The logarithm of one has the rounding of the FRFs themselves.
        assert float(values[0]) < 1e-9
        assert bool((values[1:] > 1e-3).all())

    @pytest.mark.parametrize("name", [name for name, measure in OBJECTIVES.items() if measure.norm != "other"])
    def test_its_gradient_is_that_of_its_weighed_residuals(self, bench, name):
        model = bench.model(self.names)
        truth = bench.truth(model)
        frfs = bench.measurement(model, truth, noise=0.05)
        frfs = replace(frfs, coherence=torch.rand(frfs.frf.shape, generator=seeded(3), dtype=torch.float64))
        table = NaturalFrequencies(torch.tensor([4, 7]), model.natural_frequencies(truth, 7)[[3, 6]] * 1.02)
        objective = Objective(model, Evidence(frfs, table), name, 1.5)
        theta = truth * torch.tensor([1.01, 0.97, 1.1], dtype=torch.float64)
        gradient = torch.func.grad(lambda t: objective(t))(theta)
        residual, rows = objective.residual(theta), objective.rows(theta)
        weighed = objective.estimating_weight(residual, rows) * residual
        _, pulled = torch.func.vjp(objective.residual, theta)
        # At any place: a norm's gradient is Jᵀr / ‖r‖.
        assert pulled(weighed)[0].tolist() == pytest.approx(gradient.tolist(), rel=1e-9)

    def test_adds_the_error_of_the_natural_frequencies(self, bench):
        model = bench.model(self.names)
        truth = bench.truth(model)
        table = model.natural_frequencies(truth, 7)[[3, 6]] / torch.tensor([1.03, 1.04], dtype=torch.float64)
        evidence = Evidence(bench.measurement(model, truth), NaturalFrequencies(torch.tensor([4, 7]), table))
        for weight in (1.0, 2.5):
            found = float(Objective(model, evidence, natural_frequency_weight=weight)(truth))
            assert found == pytest.approx(weight * math.sqrt((0.03**2 + 0.04**2) / 2), rel=1e-9)

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
    assert float(measure.gap(MODEL, of(MEASURED, BOTH))) == pytest.approx(math.log(2) * math.sqrt(1 / 3), rel=1e-12)
    assert float(measure.gain(MODEL, of(MEASURED, BOTH))) == pytest.approx(2 ** (-1 / 3), rel=1e-12)
