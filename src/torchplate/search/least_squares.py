"""Bounded nonlinear least squares on the unit cube: Levenberg-Marquardt, many starts in one batch.

Minimises ½ Σ r² of residuals r over [0, 1]^n_dimension. Leading dimensions are independent starts: each keeps its own
damping and stops by itself.

Sources: Moré (1978), "The Levenberg-Marquardt algorithm: implementation and theory", Lecture Notes in Mathematics 630
(column scaling, the damped step from a QR factorisation, the stopping tests); Nielsen (1999), "Damping parameter in
Marquardt's method", IMM-REP-1999-05 (the damping follows the gain ratio); Fan and Yuan (2005), "On the quadratic
convergence of the Levenberg-Marquardt method without nonsingularity assumption", Computing 74 (damping in proportion
to ‖r‖); Kanzow, Yamashita and Fukushima (2004), "Levenberg-Marquardt methods with strong local convergence properties
for solving nonlinear equations with convex constraints", J. Computational and Applied Mathematics 172 (the projected
form).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchplate.search.jacobian import JACOBIANS, Residual
from torchplate.search.least_squares_outcome import LeastSquaresOutcome, LeastSquaresProgress, LeastSquaresStatus
from torchplate.search.optimizer import unknown_name

MIN_GAIN = 1e-4
"""A step is taken where the sum of squares falls by more than this part of what the linear model promised (Moré)."""
LEAST_DAMPING = 1e-14
"""Below it the damping does not shrink: in a direction the data cannot see, the step would be made of rounding alone.

Against the squared singular values of the scaled Jacobian it is without effect up to a condition number of 1e6.
"""
# Rows of J that are copied and factored at a time, so that of many residuals no second J is made; and of these, those
# that are factored together: with some tens of columns they stay in the cache.
ROWS_AT_ONCE, BLOCK = 2**14, 512


_STATUSES = list(LeastSquaresStatus)
_RUNNING = -1


def least_squares(
    residual: Residual,
    start: Float[Tensor, "*batch n_dimension"],
    *,
    jacobian: Callable[[Tensor], Tensor] | str = "central",
    n_iteration: int = 50,
    n_evaluation: int | None = None,
    gradient_tolerance: float = 1e-8,
    step_tolerance: float = 1e-10,
    objective_tolerance: float = 1e-14,
    damping: float = 1e-3,
    shared: bool = True,
    jacobian_at_end: bool = True,
    on_iteration: Callable[[LeastSquaresProgress], object] | None = None,
) -> LeastSquaresOutcome:
    """Minimise ½ Σ r² over the unit cube from each start.

    A step p solves min ‖J p + r‖² + μ ‖D p‖², D the largest column norms of J so far. A parameter on its bound whose
    gradient points outward is held; one that meets a bound on the way stays there, and the others go on from there
    by a step solved anew. The step is taken if the sum of squares falls; by how much it falls, against what the linear
    model promised, decides whether μ = α ‖r‖ / ‖r at the start‖ grows or shrinks through α. Where the residuals vanish
    at the solution, convergence is quadratic; where they stay large it is linear, and slow at false minima: a start
    whose budget is spent far above the best one is seldom worth more.

    The linear algebra is float64: a QR factorisation of [J r] without Q (2 n_residual n_dimension² operations for each
    Jacobian), and one of 2 n_dimension rows for each step. It sees the condition number of J, not its square.

    A start that has stopped is frozen: it changes no more and spends no evaluations.

    Args:
        residual: Positions [*batch, n_dimension] in [0, 1] → real residuals [*batch, n_residual]; complex ones as
            real and imaginary parts. It is called with other leading dimensions than those of `start`. A place
            where any residual, or any entry of J, is NaN or infinite is never taken.
        start: Where each search begins.
        jacobian: A key of `JACOBIANS`, or a function: positions [*batch, n_dimension] → J [*batch, n_residual,
            n_dimension]. Differences ask for all their places in one call, 2 n_dimension for each start (central);
            a residual that cannot hold as many evaluates them in parts.
        n_iteration: Steps tried at most, by each start.
        n_evaluation: Residuals evaluated at most, by each start; never exceeded: a step that it might not pay for,
            Jacobian included, is not begun.
        gradient_tolerance: A start stops when |Jⱼᵀr| ≤ tolerance · ‖r‖ · max(‖Jⱼ‖, ‖r‖) for every free parameter: the
            cosine between r and a column, where crossing the whole interval changes r by more than r itself is long.
        step_tolerance: A start stops when no parameter moves by more than this part of its interval, although the
            damping is not what keeps the step short (μ ≤ 1).
        objective_tolerance: A start stops when the linear model promises a fall of no more than this part of the
            objective, with the same condition. Raise it to the noise of a residual that is not exact to rounding.
        damping: The first α [-]. 1e-3 for a fair start, 1 for a poor one, 1e-6 for a start that is nearly there.
        shared: Whether every start fits the same residual: only those starts are evaluated that need it, as positions
            [n_start, n_dimension]. False for residuals with data of their own for each start, [*batch, n_residual]:
            positions then always end in [*batch, n_dimension].
        jacobian_at_end: Whether J is wanted where starts end. Without it a step that is the last one by its length, by
            what it promised or by its number is taken, and J is not made there: the same places for fewer evaluations.
            Nor is one held while the next is made, which of many residuals is most of the memory.
        on_iteration: Called with a `LeastSquaresProgress` for the start and after each iteration.

    Returns:
        The place of each start, what it cost, why it stopped, and J there; without rows where it was not wanted.

    Raises:
        ValueError: A start outside the unit cube, a budget that pays for nothing, a residual or Jacobian of the wrong
            shape or kind, or no rule for J of that name.
    """
    n_dimension = start.shape[-1]
    if not bool(((start >= 0.0) & (start <= 1.0)).all()):
        raise ValueError("start must lie on the unit cube, got places outside [0, 1]. Scale it first.")
    problem = _Problem(residual, jacobian, start.shape[:-1], shared)
    price = problem.jacobian_price(n_dimension)
    if n_iteration < 0 or (n_evaluation is not None and n_evaluation < 1 + price):
        raise ValueError(
            f"The budget must pay for the start and its jacobian, n_iteration >= 0 and n_evaluation >= {1 + price}, "
            f"got {n_iteration} and {n_evaluation}. Raise it."
        )

    position = start.detach().reshape(-1, n_dimension).clone()
    every = torch.arange(len(position), device=position.device)
    count = torch.zeros_like(every)
    first = problem.residual_at(position, every)

    def place(position: Tensor, residual: Tensor, rows: Tensor) -> _Place:
        found = _Place.of(position[rows], residual[rows], problem.jacobian_at(position, residual, rows))
        return found if jacobian_at_end else found.without_jacobian()

    here = place(position, first, every)
    n_spent, n_jacobian, n_tried = count + 1 + price, count + 1, count.clone()
    status = torch.where(here.is_number(), _RUNNING, _STATUSES.index(LeastSquaresStatus.no_number))
    scale = here.column_norm.clone()
    alpha, growth = torch.full_like(here.objective, damping), torch.full_like(here.objective, 2.0)
    first_norm = here.residual_norm.clamp(min=torch.finfo(torch.float64).tiny)

    def relative_damping() -> Tensor:
        # ‖r‖ makes μ vanish, and with it the error, quadratically where the residuals do (Fan and Yuan).
        return (alpha * here.residual_norm / first_norm).clamp(min=1e-30)

    def stop(where: Tensor, reason: LeastSquaresStatus) -> None:
        status[where & (status == _RUNNING)] = _STATUSES.index(reason)

    def report(iteration: int) -> None:
        if on_iteration is not None:
            seen = (n_spent.clone(), here.position.clone(), here.finite_objective(), relative_damping())
            on_iteration(LeastSquaresProgress(iteration, *(problem.in_batch(one) for one in seen)))

    stop(here.is_flat(gradient_tolerance), LeastSquaresStatus.gradient)
    report(0)
    for iteration in range(1, n_iteration + 1):
        if n_evaluation is not None:
            stop(n_spent + 1 + price > n_evaluation, LeastSquaresStatus.budget)
        rows = torch.nonzero(status == _RUNNING).flatten()
        if not len(rows):
            break
        now, mu = here.without_jacobian().at(rows), relative_damping()[rows]
        trial = here.position.clone()
        trial[rows] = _trial(now, scale[rows], mu)
        step = (trial[rows] - now.position).to(torch.float64)
        promised = now.promised_fall(step)

        tried = here.residual.clone()
        tried[rows] = problem.residual_at(trial, rows)
        n_tried[rows] += 1
        n_spent[rows] += 1
        # Difference times sum: the fall keeps its digits where it is far smaller than the objective.
        fall = 0.5 * ((now.residual - tried[rows]) * (now.residual + tried[rows])).sum(dim=-1)
        # Where a residual is NaN or infinite the fall is NaN or −∞, and the comparison false.
        taken = (promised > 0.0) & (fall > MIN_GAIN * promised)
        undamped, short = mu <= 1.0, step.abs().amax(dim=-1) <= step_tolerance
        level = promised <= objective_tolerance * now.objective
        last = taken & (undamped & (short | level) | (iteration == n_iteration)) & (not jacobian_at_end)
        if bool(last.any()):
            here = here.ended(rows[last], trial[rows[last]], tried[rows[last]])
        moving = rows[taken & ~last]
        if len(moving):
            there = place(trial, tried, moving)
            n_spent[moving] += price
            n_jacobian[moving] += 1
            sound = there.is_number()
            taken[taken & ~last] = sound
            if not bool(sound.all()):
                moving, there = moving[sound], there.at(torch.nonzero(sound).flatten())
            here = here.moved(moving, there)
            scale[moving] = torch.maximum(scale[moving], there.column_norm)

        gain = torch.where(taken, fall / promised, 0.0)
        shrink = (1.0 - (2.0 * gain - 1.0) ** 3).clamp(min=1.0 / 3.0)
        alpha[rows] = torch.where(taken, (alpha[rows] * shrink).clamp(min=LEAST_DAMPING), alpha[rows] * growth[rows])
        growth[rows] = torch.where(taken, 2.0, 2.0 * growth[rows])

        stop(here.is_flat(gradient_tolerance), LeastSquaresStatus.gradient)
        stop(_spread(rows, undamped & short, status), LeastSquaresStatus.step)
        stop(_spread(rows, undamped & level, status), LeastSquaresStatus.objective)
        stop(_spread(rows, ~undamped & short & ~taken, status), LeastSquaresStatus.stuck)
        report(iteration)
    stop(status == _RUNNING, LeastSquaresStatus.budget)

    gradient = here.free_gradient()
    return LeastSquaresOutcome(
        position=problem.in_batch(here.position),
        objective=problem.in_batch(here.finite_objective()),
        gradient=problem.in_batch(gradient),
        gradient_norm=problem.in_batch(gradient.norm(dim=-1)),
        n_evaluation=problem.in_batch(n_spent),
        n_jacobian=problem.in_batch(n_jacobian),
        n_iteration=problem.in_batch(n_tried),
        status=tuple(_STATUSES[k] for k in status.tolist()),
        residual=problem.in_batch(here.residual),
        jacobian=problem.in_batch(here.jacobian),
    )


def _triangular(
    jacobian: Float[Tensor, "n_start n_residual n_dimension"], residual: Float[Tensor, "n_start n_residual"]
) -> Float[Tensor, "n_start n_row n_both"]:
    """R of [J r] = QR, some rows after others: a copy of all of them is never made."""
    # Parts that have more rows than columns, so that their factors are small.
    n_row = max(ROWS_AT_ONCE, 4 * (jacobian.shape[-1] + 1))
    # Without numbers there is nothing to factor, and LAPACK need not see NaN.
    parts = [
        triangular_factor(torch.cat((some, of_some.unsqueeze(-1)), dim=-1).nan_to_num_(0.0, 0.0, 0.0))
        for some, of_some in zip(jacobian.split(n_row, dim=1), residual.split(n_row, dim=1), strict=True)
    ]
    return parts[0] if len(parts) == 1 else triangular_factor(torch.cat(parts, dim=1))


def triangular_factor(matrix: Float[Tensor, "*batch n_row n"]) -> Float[Tensor, "*batch n_least n"]:
    """R of matrix = QR, its rows' signs left open: of blocks of rows, which stay in the cache, then of their factors.

    As exact as one factorisation of all rows (Demmel et al., SIAM J. Sci. Comput. 34, 2012, A206).
    """
    n_row, n = matrix.shape[-2:]
    n_block = n_row // BLOCK if n < BLOCK // 2 else 0
    if n_block > 1:
        whole, rest = matrix.split([n_block * BLOCK, n_row - n_block * BLOCK], dim=-2)
        factors = torch.linalg.qr(whole.unflatten(-2, (n_block, BLOCK)), mode="r").R.flatten(-3, -2)
        matrix = torch.cat([factors, rest], dim=-2)
    return torch.linalg.qr(matrix, mode="r").R


def _spread(rows: Tensor, where: Tensor, like: Tensor) -> Tensor:
    """A mask over some rows as a mask over all of them."""
    mask = torch.zeros_like(like, dtype=torch.bool)
    mask[rows] = where
    return mask


class _Place(NamedTuple):
    """Starts in a row, and what is known to first order where each of them stands.

    Attributes:
        position: In the dtype of the start; all else is float64.
        residual: r.
        jacobian: J.
        gradient: Jᵀr.
        column_norm: ‖Jⱼ‖.
        factor: R of J = QR.
        turned: The rows of Qᵀr that R sees.
        objective: ½ ‖r‖².
    """

    position: Float[Tensor, "n_start n_dimension"]
    residual: Float[Tensor, "n_start n_residual"]
    jacobian: Float[Tensor, "n_start n_residual n_dimension"]
    gradient: Float[Tensor, "n_start n_dimension"]
    column_norm: Float[Tensor, "n_start n_dimension"]
    factor: Float[Tensor, "n_start n_row n_dimension"]
    turned: Float[Tensor, "n_start n_row"]
    objective: Float[Tensor, " n_start"]

    @classmethod
    def of(cls, position: Tensor, residual: Tensor, jacobian: Tensor) -> "_Place":
        factor = _triangular(jacobian, residual)
        return cls(
            position=position,
            residual=residual,
            jacobian=jacobian,
            gradient=(jacobian.mT @ residual.unsqueeze(-1)).squeeze(-1),
            column_norm=jacobian.norm(dim=-2),
            factor=factor[..., :-1],
            turned=factor[..., -1],
            objective=0.5 * residual.square().sum(dim=-1),
        )

    def without_jacobian(self) -> "_Place":
        """A step is found from R alone; J is the largest of all."""
        nothing = self.jacobian.new_empty(len(self.jacobian), 0, self.jacobian.shape[-1])
        return self._replace(jacobian=nothing)

    def at(self, rows: Tensor) -> "_Place":
        return _Place(*(field[rows] for field in self))

    def moved(self, rows: Tensor, new: "_Place") -> "_Place":
        """The same with some of the starts elsewhere."""
        if len(rows) == len(self.position):
            return new
        return _Place(*(field.index_copy(0, rows, value) for field, value in zip(self, new, strict=True)))

    def ended(self, rows: Tensor, position: Tensor, residual: Tensor) -> "_Place":
        """The same with some of the starts where they end: of the first order nothing is known there."""
        return self._replace(
            position=self.position.index_copy(0, rows, position),
            residual=self.residual.index_copy(0, rows, residual),
            gradient=self.gradient.index_fill(0, rows, torch.nan),
            objective=self.objective.index_copy(0, rows, 0.5 * residual.square().sum(dim=-1)),
        )

    @property
    def residual_norm(self) -> Tensor:
        return (2.0 * self.objective).sqrt()

    def finite_objective(self) -> Tensor:
        return torch.where(self.is_number(), self.objective, torch.inf)

    def is_number(self) -> Bool[Tensor, " n_start"]:
        # A finite norm says that the entries are finite, and that their squares can be summed.
        return self.objective.isfinite() & self.column_norm.isfinite().all(dim=-1)

    def held(self) -> Bool[Tensor, "n_start n_dimension"]:
        """Parameters on a bound whose gradient points outward."""
        return ((self.position <= 0.0) & (self.gradient > 0.0)) | ((self.position >= 1.0) & (self.gradient < 0.0))

    def free_gradient(self) -> Float[Tensor, "n_start n_dimension"]:
        return torch.where(self.held(), 0.0, self.gradient)

    def is_flat(self, tolerance: float) -> Bool[Tensor, " n_start"]:
        length = self.residual_norm.unsqueeze(-1)
        return (self.free_gradient().abs() <= tolerance * length * torch.maximum(self.column_norm, length)).all(dim=-1)

    def promised_fall(self, step: Tensor) -> Float[Tensor, " n_start"]:
        """½ ‖r‖² − ½ ‖r + J p‖²."""
        change = (self.factor @ step.unsqueeze(-1)).squeeze(-1)
        return -(self.gradient * step).sum(dim=-1) - 0.5 * change.square().sum(dim=-1)


def _trial(here: _Place, scale: Tensor, mu: Tensor) -> Tensor:
    """The damped step's end on the cube.

    From the place itself towards the minimum over the free parameters, as far as the first bound; the parameter that
    meets it stays there, and the rest go on. The damped model falls at each turn, so that the step always promises a
    fall, as the projection of the unbounded step onto the cube would not.
    """
    n_dimension = here.position.shape[-1]
    origin = here.position.to(torch.float64)
    scale = torch.where(scale > 0.0, scale, 1.0)
    scaled = here.factor / scale.unsqueeze(-2)
    damping = mu.sqrt()[:, None, None] * torch.eye(n_dimension, dtype=scale.dtype, device=scale.device)
    fixed, end = here.held(), origin
    for _ in range(n_dimension + 1):
        shift = torch.where(fixed, end - origin, 0.0)
        wanted = -(here.turned + (here.factor @ shift.unsqueeze(-1)).squeeze(-1))
        matrix = torch.cat((torch.where(fixed.unsqueeze(-2), 0.0, scaled), damping), dim=-2)
        q, r = torch.linalg.qr(matrix)
        right = q[:, : wanted.shape[-1]].mT @ wanted.unsqueeze(-1)
        free = torch.linalg.solve_triangular(r, right, upper=True).squeeze(-1) / scale
        goal = torch.where(fixed, end, origin + free)
        ahead = goal - end
        room = torch.where(ahead > 0.0, 1.0 - end, end)
        reach = torch.where(ahead.abs() > room, room / ahead.abs(), 1.0)
        part = reach.amin(dim=-1, keepdim=True)
        met = (reach <= part) & (ahead.abs() > room)
        edge = (ahead > 0.0).to(end)
        end = torch.where(met, edge, torch.where(part < 1.0, end + part * ahead, goal)).clamp(0.0, 1.0)
        if not bool(met.any()):
            break
        fixed = fixed | met
    return end.to(here.position.dtype)


@dataclass(frozen=True)
class _Problem:
    """The functions of the user, asked about some of the starts, which stand in a row."""

    function: Residual
    jacobian: Callable[[Tensor], Tensor] | str
    batch_shape: torch.Size
    shared: bool

    def __post_init__(self) -> None:
        if isinstance(self.jacobian, str) and self.jacobian not in JACOBIANS:
            raise ValueError(unknown_name("jacobian", self.jacobian, JACOBIANS))

    def jacobian_price(self, n_dimension: int) -> int:
        return JACOBIANS[self.jacobian].n_evaluation * n_dimension if isinstance(self.jacobian, str) else 0

    def residual_at(self, position: Tensor, rows: Tensor) -> Float[Tensor, "n_row n_residual"]:
        with torch.no_grad():
            return self._answer(self._checked(self._question(position, rows)), rows)

    def jacobian_at(
        self, position: Tensor, residual: Tensor, rows: Tensor
    ) -> Float[Tensor, "n_row n_residual n_dimension"]:
        place, value = self._question(position, rows), self._question(residual, rows)
        if isinstance(self.jacobian, str):
            with torch.no_grad():
                result = JACOBIANS[self.jacobian].differentiate(self._checked, place, value)
        else:
            result = self.jacobian(place).detach()
        shape = (*place.shape[:-1], residual.shape[-1], place.shape[-1])
        if result.shape != shape or result.is_complex():
            raise ValueError(
                f"The jacobian must be real and of shape [*batch, n_residual, n_dimension] = {list(shape)}, got "
                f"{result.dtype} and {list(result.shape)}. Put the parameters last, and stack real and imaginary parts."
            )
        return self._answer(result, rows)

    def in_batch(self, value: Tensor) -> Tensor:
        return value.reshape((*self.batch_shape, *value.shape[1:]))

    def _question(self, value: Tensor, rows: Tensor) -> Tensor:
        return value[rows] if self.shared else self.in_batch(value)

    def _answer(self, value: Tensor, rows: Tensor) -> Tensor:
        value = value.to(torch.float64)
        return value if self.shared else value.reshape(-1, *value.shape[len(self.batch_shape) :])[rows]

    def _checked(self, position: Tensor) -> Tensor:
        value = self.function(position)
        if value.shape[:-1] != position.shape[:-1] or value.is_complex():
            raise ValueError(
                f"The residual must be real and of shape [*batch, n_residual] with *batch = "
                f"{list(position.shape[:-1])}, got {value.dtype} and {list(value.shape)}. Stack real and imaginary "
                f"parts, keep the leading dimensions, and set shared=False if each start has data of its own."
            )
        return value
