"""What the data can see: standard errors that repeats confirm, blind parameters and flat directions."""

from dataclasses import replace

import pytest
import torch

from torchplate.discrepancy import OBJECTIVES, Evidence, Objective, sensitivity
from torchplate.discrepancy.covariance import Rows, noise_variance
from torchplate.discrepancy.measure import Measured
from torchplate.discrepancy.sensitivity import sensitivity_by
from torchplate.measurement import NaturalFrequencies
from torchplate.search import JACOBIANS, least_squares


def table_of(model, theta, modes):
    frequency = model.natural_frequencies(theta, max(modes))
    return NaturalFrequencies(torch.tensor(modes), frequency[[mode - 1 for mode in modes]])


def solver(objective, theta):
    """Pseudo-inverse of the residuals' Jacobian over the unit cube, by differences of its own."""
    space, n = objective.model.space, len(theta)
    steps = 1e-5 * torch.cat([torch.eye(n), -torch.eye(n)]).double()
    residual = objective.residual(space.to_si(space.to_cube(theta) + steps))
    return torch.linalg.pinv(((residual[:n] - residual[n:]) / 2e-5).mT)


@pytest.mark.check
def test_standard_errors_are_the_spread_of_estimates_from_noisy_repeats(bench):
    model = bench.model(["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"])
    truth, estimates, predicted = bench.truth(model), [], []
    inverse = solver(Objective(model, Evidence(bench.measurement(model, truth))), truth)
    for seed in range(40):
        objective = Objective(model, Evidence(bench.measurement(model, truth, noise=0.02, seed=seed)))
        # Two Gauss–Newton steps from the truth, which lies well within reach, with the Jacobian of the truth.
        position = model.space.to_cube(truth)
        for _ in range(2):
            position = position - inverse @ objective.residual(model.space.to_si(position))
        estimates.append(model.space.to_si(position))
        if seed < 5:
            predicted.append(sensitivity(objective, estimates[-1]).std)
    spread = torch.stack(estimates).std(0)
    # The spread over 40 repeats has a standard error of 1/√78 = 11 %; three of them.
    assert (spread / torch.stack(predicted).mean(0)).tolist() == pytest.approx([1.0] * 3, abs=0.34)


def test_natural_frequencies_see_no_damping(bench):
    names = ["plate.youngs_modulus", "wires.stiffness", "wires.viscous_damping", "loss.stiffness_loss_factor"]
    model = bench.model(names)
    truth = bench.truth(model)
    seen = sensitivity(Objective(model, Evidence(None, table_of(model, truth, [1, 2, 4, 6, 9]))), truth)
    unseen = [name == "wires.viscous_damping" or "loss" in name for name in model.names]
    assert sum(unseen) == 2
    assert seen.blind.tolist() == unseen
    assert seen.std.isinf().tolist() == unseen
    assert seen.flat.shape == (0, 4)


@pytest.mark.parametrize("sides", [(0.5, 0.32), (0.4, 0.4)])
@pytest.mark.parametrize("modes", [[4, 5, 7, 9], [6]])
def test_young_and_density_of_a_free_plate_are_one_direction_to_natural_frequencies(bench, sides, modes):
    model = bench.model(["plate.youngs_modulus", "plate.density"], wires=False, sides=sides)
    truth = bench.truth(model)
    seen = sensitivity(Objective(model, Evidence(None, table_of(model, truth, modes))), truth)
    assert seen.blind.tolist() == [False, False]
    assert seen.std.isinf().all()
    (direction,) = seen.flat
    # Frequencies keep while E/ρ does: dE/E = dρ/ρ, in units of the intervals.
    low, high = model.space.low, model.space.high
    relative = direction * (high - low) / truth
    # The Jacobian is exact; rounding of 1e-14 in the frequencies, over singular values that differ by 1e-7 at least.
    assert float(relative[0] / relative[1]) == pytest.approx(1.0, rel=1e-6)


def test_the_level_of_frfs_parts_young_from_density(bench):
    model = bench.model(["plate.youngs_modulus", "plate.density"], wires=False)
    truth = bench.truth(model)
    frfs = bench.measurement(model, truth, noise=0.01)
    seen = sensitivity(Objective(model, Evidence(frfs)), truth)
    assert seen.std.isfinite().all()
    assert seen.flat.shape == (0, 2)
    # Without a level only E/ρ shows, exactly.
    unknown = sensitivity(Objective(model, Evidence(frfs, None, True)), truth)
    assert unknown.std.isinf().all()
    (direction,) = unknown.flat
    relative = direction * (model.space.high - model.space.low) / truth
    assert float(relative[0] / relative[1]) == pytest.approx(1.0, rel=1e-6)


def test_a_flat_direction_leaves_the_other_parameters_their_standard_errors(bench):
    names = ["plate.youngs_modulus", "plate.density", "loss.stiffness_loss_factor"]
    model = bench.model(names, wires=False)
    truth = bench.truth(model)
    seen = sensitivity(Objective(model, Evidence(bench.measurement(model, truth, noise=0.01), None, True)), truth)
    assert seen.std.isinf().tolist() == ["loss" not in name for name in model.names]
    # Of what has no standard error nothing is correlated.
    assert seen.correlation.isfinite().tolist() == torch.diag(seen.std.isfinite()).tolist()


def test_more_parameters_than_residuals_leave_flat_directions(bench):
    model = bench.model(["plate.youngs_modulus", "plate.density", "wires.stiffness"])
    truth = bench.truth(model)
    seen = sensitivity(Objective(model, Evidence(None, table_of(model, truth, [2, 6]))), truth)
    assert seen.flat.shape == (1, 3)
    assert seen.std.isinf().any()


def test_an_estimate_on_zero_has_the_standard_error_of_one_beside_it(bench):
    model = bench.model(["loss.mass_loss_factor"])
    truth = bench.truth(model)
    objective = Objective(model, Evidence(bench.measurement(model, truth, noise=0.01)))
    # η = 0 is the edge of what makes sense; a thousandth of the interval above it the residuals are as steep, to 1 %.
    on, beside = (float(sensitivity(objective, theta).std) for theta in (truth, truth + 0.9))
    assert on == pytest.approx(beside, rel=0.02)


def complex_normal(generator, *shape):
    return torch.complex(*torch.randn(2, *shape, generator=generator, dtype=torch.float64))


N_AVERAGE = 8


def equal_noise(frf, n_test, generator):
    """3 % of each FRF's root mean square, at every line."""
    return frf + 0.03 * frf.abs().square().mean(0).sqrt() * complex_normal(generator, n_test, *frf.shape), None


def proportional_noise(frf, n_test, generator):
    return frf + 0.01 * frf.abs() * complex_normal(generator, n_test, *frf.shape), None


def averaged(frf, n_test, generator):
    """Means of records with noise of both kinds, and the coherence that an analyser finds in these very records."""
    std = N_AVERAGE**0.5 * (0.02 * frf.abs().square().mean(0).sqrt() + 0.01 * frf.abs())
    records = frf + std * complex_normal(generator, N_AVERAGE, n_test, *frf.shape)
    mean = records.mean(0)
    return mean, mean.abs().square() / records.abs().square().mean(0)


@pytest.mark.parametrize(
    ("noise", "kind", "n_average"),
    [
        (equal_noise, "relative_frf_norm", None),
        pytest.param(proportional_noise, "relative_frf_norm", None, marks=pytest.mark.check),
        pytest.param(averaged, "relative_frf_norm", N_AVERAGE, marks=pytest.mark.check),
        (averaged, "coherence_weighted", N_AVERAGE),
    ],
    ids=["equal", "proportional", "coherence", "coherence, weighed by it"],
)
# Of so many intervals that hold with 90 % each, these percents hold in 99 of 100 cases (binomial).
@pytest.mark.parametrize(
    ("n_test", "low", "high"),
    [pytest.param(200, 85, 95, id="200", marks=pytest.mark.check), pytest.param(60, 80, 98.4, id="60")],
)
@pytest.mark.check
def test_nine_of_ten_intervals_of_90_percent_hold_the_truth(
    bench, noise, kind, n_average, n_test, low, high, record_property
):
    model = bench.fine_model(["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"])
    truth = bench.truth(model)
    # Several lines for each peak, so that a standard error from few lines is not itself uncertain.
    bands = torch.linspace(4.0, 18.0, 17, dtype=torch.float64), torch.linspace(72.0, 110.0, 27, dtype=torch.float64)
    like = bench.measurement(model, truth, frequency=torch.cat(bands))
    frf, coherence = noise(like.frf, n_test, torch.Generator().manual_seed(0))
    measured = [
        replace(like, frf=frf[test], coherence=None if coherence is None else coherence[test]) for test in range(n_test)
    ]
    objectives = [Objective(model, Evidence(one, None, False, n_average), kind) for one in measured]
    seen, deviation = [Measured.of(one) for one in measured], OBJECTIVES[kind].deviation.residual

    def residual(position):
        predicted = model.frf(model.space.to_si(position), like.frequency)
        parts = [deviation(predicted[..., test, :, :, :], one) for test, one in enumerate(seen)]
        return torch.stack([part.flatten(-4) for part in parts], dim=-2)

    # From the truth, in whose neighbourhood the fit is nearly linear: one step arrives, to a small part of the error.
    start = model.space.to_cube(truth).expand(n_test, -1)
    fit = least_squares(residual, start, jacobian="autograd", n_iteration=1, damping=1e-9, shared=False)
    theta = model.space.to_si(fit.position)
    std = torch.stack(
        [
            sensitivity_by(objective, one, fit.residual[test], fit.jacobian[test], least_squares=True).std
            for test, (objective, one) in enumerate(zip(objectives, theta, strict=True))
        ]
    )
    held = 100 * ((theta - truth).abs() <= 1.645 * std).double().mean(0)
    record_property("coverage", dict(zip(model.names, held.tolist(), strict=True)))
    print(kind, dict(zip(model.names, held.tolist(), strict=True)))
    assert all(low <= percent <= high for percent in held.tolist()), held.tolist()


@pytest.mark.check
def test_the_intervals_follow_the_estimate_that_the_objective_makes(bench):
    """One FRF ten times as noisy as the rest counts less to a sum of norms than to a sum of squares."""
    model = bench.model(["plate.youngs_modulus", "loss.stiffness_loss_factor"])
    truth, steps = bench.truth(model), {False: [], True: []}
    clean = bench.measurement(model, truth).frf
    noisy = 0.005 * torch.tensor([[1.0, 10.0], [1.0, 1.0]]) * clean.abs().square().mean(0).sqrt()
    stds = {False: [], True: []}
    for seed in range(60):
        frf = clean + noisy * complex_normal(torch.Generator().manual_seed(seed), *clean.shape)
        objective = Objective(model, Evidence(replace(bench.measurement(model, truth), frf=frf)))
        residual, inverse = objective.residual(truth), {}
        weight = objective.estimating_weight(residual, objective.rows(truth)).sqrt()
        if seed == 0:
            jacobian = torch.func.jacfwd(lambda u, o=objective: o.residual(model.space.to_si(u)))(
                model.space.to_cube(truth)
            )
        for by_squares, root in ((True, torch.ones_like(weight)), (False, weight)):
            # The residuals of all tests have nearly the same Jacobian: it is divided by the measured norms.
            inverse = torch.linalg.pinv(root[:, None] * jacobian)
            steps[by_squares].append(-inverse @ (root * residual))
            if seed < 6:
                stds[by_squares].append(sensitivity(objective, truth, least_squares=by_squares).std)
    width = model.space.high - model.space.low
    spread = {key: torch.stack(value).std(0) * width for key, value in steps.items()}
    for by_squares in (True, False):
        # The spread of 60 has a standard error of 1/√118 = 9 %; three of them, and some for the six standard errors.
        ratio = spread[by_squares] / torch.stack(stds[by_squares]).mean(0)
        assert ratio.tolist() == pytest.approx([1.0] * 2, abs=0.32)
    # What is tested differs: by squares the noisy FRF makes the estimate much worse.
    assert bool((spread[True] > 1.5 * spread[False]).all())


class TestNoiseVariance:
    @staticmethod
    def rows(n, known=None):
        amplitude = torch.logspace(-1, 1, n, dtype=torch.float64)
        variance = torch.full_like(amplitude, torch.nan) if known is None else known
        return Rows(torch.zeros(n, dtype=torch.int64), torch.linspace(0.5, 2.0, n).double(), amplitude, variance)

    @pytest.mark.parametrize(("a", "b"), [(0.3, 0.0), (0.0, 0.02), (0.1, 0.05)])
    def test_two_kinds_of_noise_are_told_apart(self, a, b):
        rows = self.rows(4000)
        truth = rows.slope.square() * (a + b * rows.amplitude.square())
        residual = truth.sqrt() * torch.randn(4000, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        found = noise_variance(residual, torch.ones_like(residual), rows)
        # 4000 residuals give each level to √(2/1000) or so; three of those.
        assert (found / truth).tolist() == pytest.approx([1.0] * 4000, rel=0.15)

    def test_what_the_measurement_says_is_taken(self):
        known = torch.rand(50, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
        known[7:20] = torch.nan
        rows = self.rows(50, known)
        found = noise_variance(torch.ones(50, dtype=torch.float64), torch.ones(50, dtype=torch.float64), rows)
        assert torch.equal(found[:7], known[:7])
        assert torch.equal(found[20:], known[20:])
        assert bool((found[7:20] > 0).all())

    def test_residuals_that_the_fit_has_made_small_count_for_more(self):
        rows = self.rows(40)._replace(amplitude=torch.zeros(40, dtype=torch.float64))
        residual = rows.slope * (-1.0) ** torch.arange(40)
        # Half of every residual's variance has gone into the fit.
        found = noise_variance(residual, torch.full_like(residual, 0.5), rows)
        assert found.tolist() == pytest.approx((2 * rows.slope.square()).tolist(), rel=1e-9)


@pytest.mark.parametrize("kind", OBJECTIVES)
@pytest.mark.check
def test_the_exact_jacobian_is_that_of_differences(bench, kind):
    model = bench.model(["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"])
    truth = bench.truth(model)
    frfs = bench.measurement(model, truth, noise=0.05)
    frfs = replace(frfs, coherence=torch.full(frfs.frf.shape, 0.9, dtype=torch.float64))
    table = NaturalFrequencies(torch.tensor([4, 7]), model.natural_frequencies(truth, 7)[[3, 6]] * 1.02)
    for gain_is_unknown in (False, True):
        objective = Objective(model, Evidence(frfs, table, gain_is_unknown), kind)

        def residual(position, objective=objective):
            return objective.residual(model.space.to_si(position))

        place = torch.tensor([[0.31, 0.62, 0.44], [0.0, 1.0, 0.7]], dtype=torch.float64)
        with torch.no_grad():
            exact, central = (
                JACOBIANS[rule].differentiate(residual, place, residual(place)) for rule in ("autograd", "central")
            )
        # Central differences have an error of ε^⅔ = 4e-11 times third derivatives, which narrow peaks make large.
        assert float((exact - central).norm() / exact.norm()) < 1e-6


@pytest.mark.check
def test_correlations_are_those_of_estimates_from_noisy_repeats(bench):
    model = bench.model(["plate.youngs_modulus", "plate.density", "wires.stiffness"])
    truth = bench.truth(model)
    objective = Objective(model, Evidence(bench.measurement(model, truth, noise=0.02)))
    found = sensitivity(objective, truth, least_squares=True).correlation
    inverse, estimates = solver(objective, truth), []
    for seed in range(120):
        repeat = bench.measurement(model, truth, noise=0.02, seed=seed)
        estimates.append(-inverse @ Objective(model, Evidence(repeat)).residual(truth))
    # The correlation of 120 pairs has a standard error below 1/√120 = 0.09; three of them.
    assert torch.allclose(found, torch.corrcoef(torch.stack(estimates).mT), atol=0.27)
    assert found.diagonal().tolist() == pytest.approx([1.0] * 3, rel=1e-12)
    assert float(found.fill_diagonal_(0).abs().max()) > 0.5
