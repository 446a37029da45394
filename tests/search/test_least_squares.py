"""Levenberg-Marquardt on the unit cube: against SciPy, against itself one start at a time, and against the theory."""

import gc
import math
import sys
from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from scipy import optimize
from torch import Tensor

from torchplate.search import JACOBIANS, LeastSquaresProgress, LeastSquaresStatus, least_squares
from torchplate.search.least_squares import triangular_factor

Status = LeastSquaresStatus


def tensor(*value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def uniform(seed: int, *shape: int) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def rosenbrock(x: Tensor, optimum: Tensor) -> Tensor:
    z = 1.0 + (x - optimum) * tensor(4.0, 3.0, 3.5)
    return torch.cat((10.0 * (z[..., 1:] - z[..., :-1] ** 2), 1.0 - z[..., :-1]), dim=-1)


TIME = torch.linspace(0.0, 4.0, 60, dtype=torch.float64)


def decay(x: Tensor, least: float = 0.0) -> Tensor:
    amplitude, rate, pulsation, phase = x.unsqueeze(-2).unbind(dim=-1)
    envelope = (2.0 * amplitude + 0.2).unsqueeze(-1) * torch.exp(-(2.0 * rate + least).unsqueeze(-1) * TIME)
    wave = torch.cos((1.0 + 5.0 * pulsation).unsqueeze(-1) * TIME + 3.0 * phase.unsqueeze(-1))
    return (envelope * wave).squeeze(-2)


NOISE = 0.02 * torch.randn(60, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
RECORD = decay(tensor(0.37, 0.22, 0.61, 0.28)) + NOISE


def powell(x: Tensor) -> Tensor:
    a, b, c, d = ((x - tensor(0.3, 0.6, 0.45, 0.7)) * tensor(4.0, 5.0, 6.0, 3.0)).unbind(dim=-1)
    return torch.stack((a + 10.0 * b, 5.0**0.5 * (c - d), (b - 2.0 * c) ** 2, 10.0**0.5 * (a - d) ** 2), dim=-1)


class Fit(NamedTuple):
    """A fit with one minimum on the cube; `held` are the parameters that lie on a bound there."""

    residual: Callable[[Tensor], Tensor]
    n_dimension: int
    held: tuple[int, ...] = ()
    tolerance: float = 1e-8

    def starts(self, n: int = 8) -> Tensor:
        return uniform(1, n, self.n_dimension)


FITS = {
    "rosenbrock": Fit(lambda x: rosenbrock(x, tensor(0.7, 0.55, 0.62)), 3),
    # Without the cube the optimum would be at 1.15 along the second axis.
    "rosenbrock_on_a_bound": Fit(lambda x: rosenbrock(x, tensor(0.7, 1.15, 0.62)), 3, held=(1,)),
    "decay": Fit(lambda x: decay(x) - RECORD, 4),
    # The rate wanted is 0.44; the least that the cube has is 0.6.
    "decay_on_a_bound": Fit(lambda x: decay(x, least=0.6) - RECORD, 4, held=(1,)),
    # J is singular at the solution: the objective goes as the fourth power of the error, and steps only halve it.
    "powell": Fit(powell, 4, tolerance=1e-6),
}


@pytest.fixture(params=sorted(FITS))
def fit(request: pytest.FixtureRequest) -> Fit:
    return FITS[request.param]


def by_scipy(residual: Callable[[Tensor], Tensor], start: Tensor) -> Tensor:
    """SciPy's bounded trust region, to the last digit."""
    result = optimize.least_squares(
        lambda x: residual(torch.from_numpy(x)).numpy(),
        start.numpy(),
        jac="3-point",
        bounds=(0.0, 1.0),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        max_nfev=500,
    )
    return torch.from_numpy(result.x)


def sum_of_squares(residual: Tensor) -> Tensor:
    return 0.5 * residual.square().sum(dim=-1)


@pytest.mark.check
def test_every_start_ends_where_scipy_ends(fit):
    start = fit.starts()
    ours = least_squares(fit.residual, start, n_iteration=100)
    assert all(status.settled for status in ours.status)
    theirs = torch.stack([by_scipy(fit.residual, one) for one in start])
    # 1e-8: both differentiate by differences, whose error of 1e-10 displaces a minimum that is not zero (SciPy's
    # interior method also stops that short of a bound).
    assert (ours.position - theirs).abs().max() < fit.tolerance
    assert (ours.objective <= sum_of_squares(fit.residual(theirs)) + 1e-13).all()


def test_random_nonlinear_fits_end_where_scipy_ends_inside_and_on_several_bounds():
    """tanh of a random linear map, plus a little of its square, against unreachable data; 30 fits in one batch."""
    n_fit, n_residual, n_dimension = 30, 15, 5
    matrix = 2.0 * uniform(5, n_fit, n_residual, n_dimension) - 1.0
    target = (matrix @ (1.6 * uniform(6, n_fit, n_dimension, 1) - 0.3)).squeeze(-1) + 0.2 * uniform(7, n_fit, 15)

    def residual(x: Tensor, which: slice | int = slice(None)) -> Tensor:
        value = (matrix[which] @ x.unsqueeze(-1)).squeeze(-1)
        return torch.tanh(value) + 0.1 * value**2 - torch.tanh(target[which])

    start = 0.25 + 0.5 * uniform(8, n_fit, n_dimension)
    ours = least_squares(residual, start, shared=False)
    assert all(status.settled for status in ours.status)
    theirs = torch.stack([by_scipy(lambda x, k=k: residual(x, k), start[k]) for k in range(n_fit)])
    # 1e-7: SciPy stays strictly inside, and where a bound barely binds it stops a little farther from it.
    assert (ours.position - theirs).abs().max() < 1e-7
    n_held = ((ours.position == 0.0) | (ours.position == 1.0)).sum(dim=-1)
    assert set(n_held.tolist()) >= {0, 1, 2}


@pytest.mark.check
def test_a_parameter_on_its_bound_is_exactly_there_and_its_gradient_points_outward(fit):
    outcome = least_squares(fit.residual, fit.starts(), n_iteration=100, jacobian="autograd")
    on_bound = (outcome.position == 0.0) | (outcome.position == 1.0)
    expected = torch.zeros(fit.n_dimension, dtype=torch.bool)
    expected[list(fit.held)] = True
    assert (on_bound == expected).all()
    gradient = (outcome.jacobian.mT @ outcome.residual.unsqueeze(-1)).squeeze(-1)
    outward = torch.where(outcome.position == 0.0, gradient, -gradient)
    assert (outward[on_bound] > 0.1).all()
    # The free gradient is zero to 1e-7 of the product of column and residual norms, which is where the fall of the
    # objective, 1e-14 of it, ends in rounding; 1e-12 is rounding of residuals that themselves vanish.
    length = outcome.jacobian.norm(dim=-2) * outcome.residual.norm(dim=-1, keepdim=True)
    assert (outcome.gradient[~on_bound].abs() <= 1e-7 * length[~on_bound] + 1e-12).all()
    assert (outcome.gradient[on_bound] == 0.0).all()
    assert torch.allclose(outcome.gradient_norm, outcome.gradient.norm(dim=-1))


def test_a_step_across_bounds_ends_exactly_on_them():
    """To rounding would not do: a parameter beside its bound is not held there."""
    outside = tensor(-0.3, 1.7, 0.4, 1.2)
    outcome = least_squares(lambda x: (x - outside) * tensor(3.0, 1.0, 2.0, 0.7), uniform(4, 200, 4), n_iteration=1)
    assert (outcome.position[:, [0, 1, 3]] == tensor(0.0, 1.0, 1.0)).all()
    # A damping of 1e-3 leaves as much of the error, at most 0.6.
    assert (outcome.position[:, 2] - 0.4).abs().max() < 1e-3


def test_a_start_on_the_wrong_bound_leaves_it():
    fit = FITS["decay"]
    wrong = torch.stack((torch.zeros(4), torch.ones(4), tensor(0.0, 1.0, 1.0, 0.0))).to(torch.float64)
    outcome = least_squares(fit.residual, wrong, n_iteration=100)
    reached = least_squares(fit.residual, fit.starts(1)).position
    # 1e-7: the objective is level to rounding within √1e-16 of the minimum, times a modest condition number.
    assert (outcome.position - reached).abs().max() < 1e-7


def test_convergence_to_a_zero_residual_is_quadratic():
    optimum = tensor(0.42, 0.27, 0.66)

    def residual(x: Tensor) -> Tensor:
        z = x - optimum
        return torch.stack((torch.sin(3.0 * z[..., 0]) + z[..., 1] ** 2, torch.expm1(z[..., 1] - z[..., 2]), *z.T), -1)

    seen: list[LeastSquaresProgress] = []
    start = optimum + tensor(0.21, -0.17, 0.13)
    least_squares(lambda x: residual(x.reshape(-1, 3)), start, jacobian="autograd", on_iteration=seen.append)
    error = torch.stack([(one.position - optimum).norm() for one in seen])
    error = error[error > 1e-14]
    # With eₖ₊₁ ≤ C eₖ², C about 1 here, 0.3 needs five steps to rounding; a linear rate of ⅓ would need thirty.
    assert len(error) <= 6
    assert (error[1:] <= 1.0 * error[:-1] ** 2).all()
    assert error[-1] < 1e-6


@pytest.mark.check
def test_a_batch_gives_what_each_start_gives_alone(fit):
    start = fit.starts(4).reshape(2, 2, -1)
    batch = least_squares(fit.residual, start, n_iteration=100)
    assert batch.position.shape == start.shape
    assert batch.objective.shape == batch.n_evaluation.shape == (2, 2)
    for k, one in enumerate(start.flatten(0, 1)):
        alone = least_squares(fit.residual, one, n_iteration=100)
        # Sums of another batch shape round differently, and a step more or less near the end is then possible.
        assert (alone.position - batch.position.flatten(0, 1)[k]).abs().max() < fit.tolerance
        assert abs(int(alone.n_iteration) - int(batch.n_iteration.flatten()[k])) <= 2
        assert alone.status[0].settled == batch.status[k].settled


@pytest.mark.parametrize("shared", [True, False])
def test_the_other_starts_of_a_batch_do_not_change_a_start(fit, shared):
    start = fit.starts(6)
    other = torch.cat((start[:1], uniform(9, 5, fit.n_dimension)))
    first = least_squares(fit.residual, start, n_iteration=8, shared=shared)
    second = least_squares(fit.residual, other, n_iteration=8, shared=shared)
    # Eight steps, so that rounding has not grown: sums over fewer starts may be taken in another order.
    assert (first.position[0] - second.position[0]).abs().max() < 1e-9
    assert first.n_evaluation[0] == second.n_evaluation[0]


def test_starts_may_have_data_of_their_own():
    truth = uniform(11, 2, 5, 4) * 0.4 + 0.3
    record = decay(truth)
    outcome = least_squares(lambda x: decay(x) - record, truth + 0.05, shared=False)
    # Zero residuals: the last step is quadratic.
    assert (outcome.position - truth).abs().max() < 1e-10


def test_starts_with_data_of_their_own_are_refused_as_shared():
    record = decay(uniform(11, 5, 4) * 0.4 + 0.3)
    with pytest.raises((ValueError, RuntimeError), match=r"shared=False|must match the size"):
        least_squares(lambda x: decay(x) - record, uniform(12, 5, 4))


@pytest.mark.parametrize("jacobian", sorted(JACOBIANS))
def test_every_residual_evaluated_is_counted_and_no_other(jacobian):
    n_row = n_jacobian = 0
    fit = FITS["decay"]

    def counted(x: Tensor) -> Tensor:
        nonlocal n_row
        n_row += math.prod(x.shape[:-1])
        return fit.residual(x)

    start = torch.cat((fit.starts(5), torch.full((1, 4), 0.5, dtype=torch.float64)))
    seen: list[LeastSquaresProgress] = []
    outcome = least_squares(counted, start, jacobian=jacobian, on_iteration=seen.append)
    assert seen[0].iteration == 0
    assert torch.equal(seen[-1].n_evaluation, outcome.n_evaluation)
    assert len(set(outcome.n_evaluation.tolist())) > 1
    n_jacobian = int(outcome.n_jacobian.sum())
    # Autograd calls the function once for each batch of Jacobians: its rows are not evaluations of the residual alone.
    price = {"central": 8, "forward": 4, "autograd": 0}[jacobian]
    assert torch.equal(outcome.n_evaluation, 1 + outcome.n_iteration + price * outcome.n_jacobian)
    assert n_row == int(outcome.n_evaluation.sum()) + (n_jacobian if jacobian == "autograd" else 0)


def test_a_stopped_start_is_frozen_while_the_others_go_on():
    seen: list[LeastSquaresProgress] = []
    optimum = tensor(0.7, 0.55, 0.62)
    start = torch.stack((optimum + 1e-3, tensor(0.1, 0.9, 0.2)))
    least_squares(FITS["rosenbrock"].residual, start, on_iteration=seen.append)
    count = torch.stack([one.n_evaluation for one in seen])
    last = int((count[:, 0] == count[-1, 0]).to(torch.int64).argmax())
    assert last < len(seen) - 3
    assert count[-1, 1] > count[last, 1]
    assert all(torch.equal(one.position[0], seen[last].position[0]) for one in seen[last:])


def test_the_objective_of_a_start_never_rises(fit):
    seen: list[LeastSquaresProgress] = []
    least_squares(fit.residual, fit.starts(), n_iteration=60, on_iteration=seen.append)
    # Rounding of the objective itself; the fall is computed more exactly than that.
    assert (torch.stack([one.objective for one in seen]).diff(dim=0) <= 1e-15).all()
    assert all(((one.position >= 0.0) & (one.position <= 1.0)).all() for one in seen)


def test_a_spent_budget_is_said_and_never_exceeded():
    fit = FITS["rosenbrock"]
    few = least_squares(fit.residual, fit.starts(), n_iteration=3)
    assert set(few.status) == {Status.budget}
    assert set(few.n_iteration.tolist()) == {3}
    paid = least_squares(fit.residual, fit.starts(), n_evaluation=40)
    assert set(paid.status) == {Status.budget}
    # A step may cost 1 + 6; whatever is left over is less than that.
    assert ((paid.n_evaluation > 33) & (paid.n_evaluation <= 40)).all()
    none = least_squares(fit.residual, fit.starts(), n_iteration=0)
    assert torch.equal(none.position, fit.starts())
    assert torch.equal(none.objective, sum_of_squares(fit.residual(fit.starts())))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_places_without_a_number_are_never_taken_and_do_not_keep_the_minimum_from_being_found(bad):
    """Outside a ball about the minimum there is no number, and first steps along the valley lead there."""
    fit = FITS["rosenbrock"]
    optimum = tensor(0.7, 0.55, 0.62)
    n_bad = 0

    def walled(x: Tensor) -> Tensor:
        nonlocal n_bad
        outside = (x - optimum).norm(dim=-1, keepdim=True) > 0.35
        n_bad += int(outside.sum())
        return torch.where(outside, bad, fit.residual(x))

    seen: list[LeastSquaresProgress] = []
    start = fit.starts(200)
    start = start[(start - optimum).norm(dim=-1) < 0.34]
    outcome = least_squares(walled, start, n_iteration=100, on_iteration=seen.append)
    assert n_bad > 10
    assert all(one.objective.isfinite().all() for one in seen)
    assert all(((one.position - optimum).norm(dim=-1) <= 0.35).all() for one in seen)
    assert outcome.jacobian.isfinite().all()
    # Zero residuals: the last step is quadratic. A few starts descend right into the wall, and end there.
    found = (outcome.position - optimum).abs().amax(dim=-1) < 1e-8
    assert found.double().mean() > 0.8
    assert {outcome.status[k] for k in torch.nonzero(~found).flatten().tolist()} <= {Status.stuck, Status.budget}


def test_a_descent_that_ends_at_a_wall_is_said_to_be_stuck():
    target = tensor(0.2, 0.6)
    outcome = least_squares(
        lambda x: torch.where(x[..., :1] < 0.37, torch.nan, x - target), tensor(0.8, 0.1), n_iteration=100
    )
    assert outcome.status == (Status.stuck,)
    # Differences of 6e-6 need as much room.
    assert 0.37 <= outcome.position[0] < 0.371


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_start_without_a_number_says_so_and_leaves_the_others_alone(bad):
    fit = FITS["decay"]
    start = fit.starts(4)
    start[2, 0] = 0.9
    broken = least_squares(lambda x: torch.where(x[..., :1] == 0.9, bad, fit.residual(x)), start)
    assert broken.status[2] is Status.no_number
    assert broken.objective[2] == math.inf
    assert int(broken.n_iteration[2]) == 0
    whole = least_squares(fit.residual, start)
    # The minimum is level to rounding within 1e-8.
    assert torch.allclose(broken.position[[0, 1, 3]], whole.position[[0, 1, 3]], rtol=0.0, atol=1e-8)


def test_a_place_whose_jacobian_has_no_number_is_never_taken():
    """The residual is a number everywhere; its derivative is infinite on a line right in the way."""

    def residual(x: Tensor) -> Tensor:
        return x - tensor(0.31, 0.62)

    def jacobian(x: Tensor) -> Tensor:
        exact = torch.eye(2, dtype=torch.float64).expand(*x.shape, 2)
        return torch.where((x[..., :1, None] < 0.4), torch.inf, exact)

    seen: list[LeastSquaresProgress] = []
    outcome = least_squares(residual, tensor(0.9, 0.1), jacobian=jacobian, on_iteration=seen.append)
    assert all(one.position[0] >= 0.4 for one in seen)
    assert outcome.position[0] < 0.5
    assert outcome.jacobian.isfinite().all()


def test_a_flat_direction_is_left_where_it_is_and_the_rest_is_fitted():
    """The third parameter does nothing; of the first two only the sum is seen."""

    def residual(x: Tensor) -> Tensor:
        total = x[..., :1] + x[..., 1:2]
        return torch.cat((total - 0.9, total**2 - 0.81, 2.0 * x[..., 3:] - 0.5), dim=-1)

    start = uniform(13, 8, 4) * 0.4 + 0.1
    for jacobian in JACOBIANS:
        outcome = least_squares(residual, start, jacobian=jacobian)
        assert all(status.settled for status in outcome.status)
        assert torch.equal(outcome.position[:, 2], start[:, 2])
        # Zero residuals are met to rounding; forward differences of 1e-8 still leave a fast linear rate.
        assert (outcome.position[:, :2].sum(dim=-1) - 0.9).abs().max() < 1e-10
        # The shortest step moves both alike: their difference is what no residual sees. Forward differences see it
        # with an error of 1e-8, which the smallest singular value, 1e-8 too, may turn into a step.
        if jacobian != "forward":
            moved = outcome.position - start
            assert (moved[:, 0] - moved[:, 1]).abs().max() < 1e-3


@pytest.mark.parametrize("tolerance", [1e-14, 1e-4])
def test_a_jacobian_of_the_wrong_sign_ends_stuck(tolerance):
    """Whatever the tolerance: that a heavily damped step promises little says nothing of a minimum."""
    fit = FITS["decay"]

    def reversed_sign(x: Tensor) -> Tensor:
        return -JACOBIANS["autograd"].differentiate(fit.residual, x, fit.residual(x))

    start = uniform(14, 3, 4) * 0.4 + 0.3
    outcome = least_squares(fit.residual, start, jacobian=reversed_sign, objective_tolerance=tolerance)
    assert set(outcome.status) == {Status.stuck}
    assert torch.equal(outcome.position, start)


@pytest.mark.parametrize(("name", "tolerance"), [("central", 2.2e-7), ("forward", 6.6e-6)])
def test_differences_agree_with_autograd_inside_and_on_the_edges(name, tolerance):
    """Central: ε^⅔/3 = 1.2e-11 times third derivatives, up to 2.2 · 20³; forward: √ε/2 times second ones, 2.2 · 20²."""
    place = uniform(15, 3, 7, 4)
    place[0, 0], place[0, 1] = 0.0, 1.0
    place[0, 2], place[0, 3] = 1e-7, 1.0 - 1e-9
    seen: list[Tensor] = []

    def watched(x: Tensor) -> Tensor:
        seen.append(x)
        return decay(x)

    found = JACOBIANS[name].differentiate(watched, place, decay(place))
    exact = JACOBIANS["autograd"].differentiate(decay, place, decay(place))
    assert found.shape == exact.shape == (3, 7, 60, 4)
    assert (found - exact).abs().max() < tolerance
    assert len(seen) == 1
    assert all(((x >= 0.0) & (x <= 1.0)).all() for x in seen)


def test_forward_mode_agrees_with_reverse_mode():
    place = uniform(16, 5, 4)
    found = JACOBIANS["autograd"].differentiate(decay, place, decay(place))
    reverse = torch.stack([torch.autograd.functional.jacobian(decay, one) for one in place])
    # The same derivative in another order of operations.
    assert (found - reverse).abs().max() < 1e-13


@pytest.mark.parametrize("n_row", [3, 40, 512, 1024, 1500])
@pytest.mark.parametrize("batch", [(), (3,)], ids=str)
def test_blocks_of_rows_have_the_factor_of_all_of_them(n_row, batch):
    """With columns of which two are all but parallel: their products would not tell them apart."""
    matrix = uniform(21, *batch, n_row, 6) - 0.5
    matrix[..., 5] = matrix[..., 1] + 1e-9 * matrix[..., 5]
    found, whole = triangular_factor(matrix), torch.linalg.qr(matrix, mode="r").R
    assert found.shape == whole.shape
    assert (found.tril(-1) == 0).all()
    # Rounding of the columns, whatever is left of one beside the others.
    assert torch.allclose(found.abs(), whole.abs(), rtol=0.0, atol=1e-14 * n_row)
    if n_row > 6:
        assert 1e-11 < float(found[..., 5, 5].abs().min()) <= float(found[..., 5, 5].abs().max()) < 1e-7
        assert torch.allclose(found[..., 5, 5].abs(), whole[..., 5, 5].abs(), rtol=1e-4)


@pytest.mark.parametrize("n_iteration", [2, 100])
def test_starts_whose_last_jacobian_is_not_wanted_end_at_the_same_places_for_less(fit, n_iteration):
    """After a step that promised too little to go on, and after the last one that is allowed."""
    settings = {"jacobian": "forward", "n_iteration": n_iteration, "objective_tolerance": 1e-4}
    whole = least_squares(fit.residual, fit.starts(), **settings)
    spared = least_squares(fit.residual, fit.starts(), **settings, jacobian_at_end=False)
    # 1e-10: a sum over more rows may be rounded otherwise, and these fits magnify that a thousand times at most.
    assert torch.allclose(spared.position, whole.position, rtol=0.0, atol=1e-10)
    assert torch.allclose(spared.objective, whole.objective, rtol=1e-9)
    assert torch.allclose(spared.residual, fit.residual(spared.position), rtol=0.0, atol=1e-13)
    assert torch.equal(spared.n_iteration, whole.n_iteration)
    less = whole.n_jacobian - spared.n_jacobian
    # One for each start that ended by a step that was taken; where J is singular at the end, the last ones are refused.
    assert set(less.tolist()) <= {0, 1}
    assert less.sum() >= (0 if n_iteration == 100 and fit is FITS["powell"] else len(less) / 2)
    assert torch.equal(whole.n_evaluation - spared.n_evaluation, fit.n_dimension * less)
    assert spared.jacobian.shape == (*whole.jacobian.shape[:-2], 0, fit.n_dimension)
    assert torch.equal(spared.gradient_norm.isnan(), less > 0)


@pytest.mark.parametrize("jacobian", ["central", "forward", "autograd"])
def test_every_jacobian_leads_to_the_same_minimum(jacobian):
    fit = FITS["decay_on_a_bound"]
    outcome = least_squares(fit.residual, fit.starts(), jacobian=jacobian, n_iteration=100)
    exact = by_scipy(fit.residual, fit.starts()[0])
    # An error of 1e-8 in J (forward) displaces the minimum by about as much times ‖r‖ / ‖J‖ and the condition number.
    assert (outcome.position - exact).abs().max() < 1e-7
    assert torch.allclose(outcome.normal_matrix, outcome.jacobian.mT @ outcome.jacobian)
    # Forward differences again bound the comparison.
    assert torch.allclose(outcome.residual, fit.residual(outcome.position), rtol=0.0, atol=1e-14)


def test_many_starts_find_the_global_minimum_of_a_multimodal_fit():
    """A pulsation of 3 to 43 against 60 samples: a local minimum at nearly every beat of the two waves."""
    truth = tensor(0.43, 0.61)
    clock = torch.linspace(0.0, 3.0, 60, dtype=torch.float64)

    def wave(x: Tensor) -> Tensor:
        pulsation, phase = 3.0 + 40.0 * x[..., :1], 2.0 * x[..., 1:]
        return torch.cos(pulsation * clock + phase)

    data = wave(truth) + 0.1 * NOISE / NOISE.std()
    outcome = least_squares(lambda x: wave(x) - data, uniform(17, 100, 2))
    winner = int(outcome.objective.argmin())
    best = outcome.position[winner]
    assert outcome.status[winner].settled
    # Noise of 0.1 on 60 samples: standard deviations of 0.001 and 0.02 in these units; four of them.
    assert ((best - truth).abs() < tensor(0.004, 0.08)).all()
    found = outcome.objective < 1.01 * outcome.objective.min()
    # The basin is a beat, 2π / 3 of the pulsation's interval of 40, to either side: about a tenth of the starts.
    assert 5 <= int(found.sum()) <= 20


def test_a_badly_conditioned_linear_fit_is_solved_in_a_few_steps():
    """A condition number of 1e6: normal equations would keep 4 digits of 16, the QR factorisation keeps 10."""
    left, _, right = torch.linalg.svd(uniform(18, 40, 5) - 0.5, full_matrices=False)
    matrix = left @ torch.diag(torch.logspace(0.0, -6.0, 5, dtype=torch.float64)) @ right
    truth = tensor(0.31, 0.72, 0.55, 0.44, 0.63)

    def residual(x: Tensor) -> Tensor:
        return (x - truth) @ matrix.T

    outcome = least_squares(
        residual,
        truth + tensor(0.1, -0.2, 0.15, 0.2, -0.1),
        jacobian=lambda x: matrix.expand(*x.shape[:-1], 40, 5),
        damping=1e-12,
    )
    assert (outcome.position - truth).abs().max() < 1e-8
    assert int(outcome.n_iteration) <= 6


def test_fewer_residuals_than_parameters_are_met():
    outcome = least_squares(lambda x: x[..., :1] * x[..., 1:2] + x[..., 2:] - 0.8, uniform(19, 10, 3))
    assert (outcome.objective < 1e-20).all()


def test_single_precision_positions_stay_so():
    optimum = torch.tensor([0.7, 0.55, 0.62])
    outcome = least_squares(
        lambda x: (x - optimum) * torch.tensor([1.0, 3.0, 2.0]) + (x - optimum) ** 2, torch.full((2, 3), 0.3)
    )
    assert outcome.position.dtype == torch.float32
    # A few units of the last place.
    assert (outcome.position - optimum).abs().max() < 1e-6


def test_the_noise_of_a_residual_is_what_objective_tolerance_is_for():
    """Residuals that are rounded to 1e-6: beneath that a step's fall is chance."""
    fit = FITS["decay"]

    def coarse(x: Tensor) -> Tensor:
        return (fit.residual(x) * 1e6).round() / 1e6

    exact = JACOBIANS["autograd"].differentiate

    def jacobian(x: Tensor) -> Tensor:
        return exact(fit.residual, x, fit.residual(x))

    outcome = least_squares(coarse, fit.starts(), jacobian=jacobian, objective_tolerance=1e-6)
    assert set(outcome.status) == {Status.objective}
    best = least_squares(fit.residual, fit.starts()).objective.min()
    # The tolerance is relative to the objective; a start may stop one step of that size above the minimum.
    assert (outcome.objective < best * (1.0 + 1e-4)).all()


def test_every_status_says_what_to_do():
    for status in Status:
        sentences = status.value.rstrip(".").split(". ")
        assert len(sentences) == 2, status
        assert sentences[1].split()[0] in {"Start", "Raise", "Evaluate"}, status


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"jacobian": "centrol"}, r"No jacobian named 'centrol'\. Did you mean 'central'\?"),
        ({"n_evaluation": 8}, r"n_evaluation >= 9, got 50 and 8\. Raise it"),
        ({"n_iteration": -1}, r"n_iteration >= 0 .* got -1 and None\. Raise it"),
        ({"jacobian": lambda x: torch.zeros(*x.shape, 60)}, r"= \[3, 60, 4\], got .* \[3, 4, 60\]\. Put"),
    ],
)
def test_an_unusable_setting_is_refused_with_what_to_do(settings, message):
    with pytest.raises(ValueError, match=message):
        least_squares(FITS["decay"].residual, FITS["decay"].starts(3), **settings)


@pytest.mark.parametrize(
    ("residual", "message"),
    [
        (lambda x: decay(x) + 1j, r"complex128 .*Stack real and imaginary"),
        (lambda x: decay(x).sum(dim=-1), r"\*batch = \[3\], got .*keep the leading dimensions"),
    ],
)
def test_an_unusable_residual_is_refused_with_what_to_do(residual, message):
    with pytest.raises(ValueError, match=message):
        least_squares(residual, FITS["decay"].starts(3))


def test_a_start_outside_the_cube_is_refused():
    with pytest.raises(ValueError, match=r"outside \[0, 1\]\. Scale it first"):
        least_squares(decay, tensor(0.2, 1.2, 0.1, 0.4))


def wave(x: Tensor, n: int = 900) -> Tensor:
    """Two parameters and many residuals that do not vanish."""
    time = torch.linspace(0.0, 3.0, n, dtype=torch.float64)
    a, b = x.unsqueeze(-2).unbind(dim=-1)
    return a.unsqueeze(-1).squeeze(-2) * torch.sin((1 + 2 * b).unsqueeze(-1).squeeze(-2) * time) - 0.6 * time.cos()


def test_many_residuals_are_factored_some_at_a_time_and_come_out_as_all_at_once(monkeypatch):
    start, sizes = tensor(0.3, 0.4).expand(2, 2) + tensor(0.0, 0.2)[:, None], []
    qr = torch.linalg.qr

    def counted(rows: Tensor, *told: str, **more: str) -> Tensor:
        sizes.append(rows.shape[-2])
        return qr(rows, *told, **more)

    whole = least_squares(wave, start)
    monkeypatch.setattr(torch.linalg, "qr", counted)
    monkeypatch.setattr(sys.modules["torchplate.search.least_squares"], "ROWS_AT_ONCE", 128)
    parts = least_squares(wave, start)
    assert max(sizes) <= 128
    assert sizes.count(128) > 7
    assert all(status.settled for status in parts.status)
    assert torch.allclose(parts.position, whole.position, rtol=1e-9)
    assert torch.allclose(parts.objective, whole.objective, rtol=1e-12)


def test_a_jacobian_that_is_not_asked_for_is_not_held_while_the_next_is_made(collect):
    n, start, held = 901, tensor(0.3, 0.4)[None], []

    def n_held() -> int:
        collect()
        every = [one for one in gc.get_objects() if type(one) is Tensor]
        return len({one.untyped_storage().data_ptr() for one in every if one.untyped_storage().nbytes() == 8 * n * 2})

    def jacobian(x: Tensor) -> Tensor:
        held.append(n_held())
        time = torch.linspace(0.0, 3.0, n, dtype=torch.float64)
        a, pulsation = x[:, :1], 1 + 2 * x[:, 1:]
        return torch.stack([(pulsation * time).sin(), 2 * a * time * (pulsation * time).cos()], dim=-1)

    spared = least_squares(lambda x: wave(x, n), start, jacobian=jacobian, jacobian_at_end=False)
    assert len(held) > 2
    assert max(held) == 0
    assert spared.status[0].settled
    assert spared.jacobian.shape == (1, 0, 2)
    with pytest.raises(ValueError, match="jacobian_at_end=True"):
        _ = spared.normal_matrix
    held.clear()
    kept = least_squares(lambda x: wave(x, n), start, jacobian=jacobian)
    assert max(held) == 1
    assert torch.equal(spared.position, kept.position)
    assert kept.normal_matrix.shape == (1, 2, 2)
