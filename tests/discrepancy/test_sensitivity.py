"""What the data can see: standard errors that repeats confirm, blind parameters and flat directions."""

import pytest
import torch

from torchplate.discrepancy import Evidence, Objective, sensitivity
from torchplate.measurement import NaturalFrequencies


def table_of(model, theta, modes):
    frequency = model.natural_frequencies(theta, max(modes))
    return NaturalFrequencies(torch.tensor(modes), frequency[[mode - 1 for mode in modes]])


def solver(objective, theta):
    """Pseudo-inverse of the residuals' Jacobian over the unit cube, by differences of its own."""
    space, n = objective.model.space, len(theta)
    steps = 1e-5 * torch.cat([torch.eye(n), -torch.eye(n)]).double()
    residual = objective.residual(space.to_si(space.to_cube(theta) + steps))
    return torch.linalg.pinv(((residual[:n] - residual[n:]) / 2e-5).mT)


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
    # Central differences over a ten-thousandth of the interval are good to 1e-6 here.
    assert float(relative[0] / relative[1]) == pytest.approx(1.0, rel=1e-5)


def test_the_level_of_frfs_parts_young_from_density(bench):
    model = bench.model(["plate.youngs_modulus", "plate.density"], wires=False)
    truth = bench.truth(model)
    frfs = bench.measurement(model, truth, noise=0.01)
    seen = sensitivity(Objective(model, Evidence(frfs)), truth)
    assert seen.std.isfinite().all()
    assert seen.flat.shape == (0, 2)
    unknown = sensitivity(Objective(model, Evidence(frfs, None, True)), truth)
    # Without a level only E/ρ shows: what is left is the error of the differences near the peaks.
    assert bool((unknown.std > 100 * seen.std).all())


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
