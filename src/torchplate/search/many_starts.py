"""Least squares from many places: a search of the whole cube where the objective has residuals.

Starts are drawn evenly on the unit cube and go down together, in one batch of bounded Levenberg-Marquardt. Each ends in
the minimum whose basin it was drawn in; the best of them is the result. Source: Boender and Rinnooy Kan (1987),
"Bayesian stopping rules for multistart global optimization methods", Mathematical Programming 37.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor

from torchplate.search.jacobian import JACOBIANS, Residual
from torchplate.search.least_squares import least_squares
from torchplate.search.least_squares_outcome import LeastSquaresProgress
from torchplate.search.optimizer import best_member, unknown_name, without_nan
from torchplate.search.outcome import Outcome, Progress


@dataclass(frozen=True)
class LeastSquares:
    """Settings of a search by least squares from many starts.

    Args:
        n_member: starts, ≥ 1.
        jacobian: a key of `JACOBIANS`: "autograd" is exact, "central" and "forward" are differences.
        damping: of the first step, > 0; see `least_squares`.

    Raises:
        ValueError: if a setting is outside its range.
    """

    name: ClassVar[str] = "least_squares"

    n_member: int = 32
    jacobian: Literal["autograd", "central", "forward"] = "autograd"
    damping: float = 1e-3

    def __post_init__(self) -> None:
        if self.n_member < 1:
            raise ValueError(f"n_member must be 1 or more, got {self.n_member}. Raise it.")
        if not self.damping > 0:
            raise ValueError(f"damping must be above 0, got {self.damping}. Raise it.")
        if self.jacobian not in JACOBIANS:
            raise ValueError(unknown_name("jacobian", self.jacobian, JACOBIANS))

    def price(self, n_dimension: int) -> int:
        """Evaluations of one place at which a start arrives: its residual, its Jacobian and its objective.

        A tangent of forward-mode differentiation costs about as much as a residual and counts as one.
        """
        return 2 + max(1, JACOBIANS[self.jacobian].n_evaluation) * n_dimension


@torch.no_grad()
def least_squares_from_many_starts(
    residual: Residual,
    objective: Callable[[Tensor], Tensor],
    settings: LeastSquares,
    *,
    n_dimension: int,
    generator: torch.Generator,
    n_search: int = 1,
    n_generation: int = 100,
    n_evaluation: int | None = None,
    dtype: torch.dtype = torch.float64,
    on_generation: Callable[[Progress], object] | None = None,
) -> Outcome:
    """Minimise residuals from many starts, and judge where each ends by the objective.

    One iteration is a generation. What is minimised is the sum of squares; the objective, which may weigh the residuals
    otherwise, is evaluated wherever a start arrives and decides which of them is best. A Jacobian by forward mode
    counts n_dimension evaluations, by central differences twice as many.

    Args:
        residual: Positions [*batch, n_dimension] in [0, 1] → residuals [*batch, n_residual]; see `least_squares`.
        objective: Positions [*batch, n_dimension] → [*batch]. NaN counts as +inf.
        settings: Of the search.
        n_dimension: Dimensions of the unit cube.
        generator: Source of the starts; its device is where the tensors live.
        n_search: Independent searches, each with starts of its own.
        n_generation: Iterations at most, by each start.
        n_evaluation: Evaluations at most for each search, shared evenly by its starts; never exceeded.
        dtype: Of positions.
        on_generation: Called with a `Progress` after the starts and after each iteration; its checkpoint is empty, for
            this search cannot be resumed.

    Returns:
        The best of the places where the starts of each search ended (and in a `Progress`, where they stand), what all
        of them cost, and why the best one stopped.

    Raises:
        ValueError: A budget that does not pay for the starts.
    """
    n_member, price = settings.n_member, settings.price(n_dimension)
    by_differences = JACOBIANS[settings.jacobian].n_evaluation * n_dimension
    budget = None
    if n_evaluation is not None:
        if n_evaluation < n_member * price:
            raise ValueError(
                f"n_evaluation must pay for {n_member} starts of {price} evaluations each, {n_member * price}, got "
                f"{n_evaluation}. Raise it or lower n_member."
            )
        # `least_squares` counts residuals and differences; tangents and objectives come on top wherever it arrives.
        budget = n_evaluation // n_member * (1 + by_differences) // price
    shape = n_search, n_member, n_dimension
    start = torch.rand(shape, generator=generator, dtype=dtype, device=generator.device)
    fitness = start.new_full(shape[:-1], torch.inf)
    place = torch.full_like(start, torch.nan)
    spent = torch.zeros_like(fitness, dtype=torch.int64)
    arrived = torch.zeros_like(spent)

    def report(progress: LeastSquaresProgress) -> None:
        moved = (progress.position != place).any(-1)
        if bool(moved.any()):
            fitness[moved] = without_nan(objective(progress.position[moved]).to(fitness))
            place[moved] = progress.position[moved]
            arrived[moved] += 1
        spent.copy_(progress.n_evaluation + arrived * (price - 1 - by_differences))
        if on_generation is not None:
            on_generation(
                Progress(
                    generation=progress.iteration,
                    n_evaluation=spent.sum(-1),
                    best_position=best_member(place, fitness),
                    best_objective=fitness.amin(-1),
                    mean_objective=torch.where(fitness.isfinite(), fitness, torch.nan).nanmean(-1),
                    spread=place.std(dim=-2, correction=0).mean(-1),
                    snapshot={},
                )
            )

    found = least_squares(
        residual,
        start,
        jacobian=settings.jacobian,
        n_iteration=n_generation,
        n_evaluation=budget,
        damping=settings.damping,
        on_iteration=report,
    )
    best = fitness.argmin(-1)
    return Outcome(
        best_position=best_member(place, fitness),
        best_objective=fitness.amin(-1),
        n_evaluation=spent.sum(-1),
        n_generation=found.n_iteration.amax(-1),
        status=tuple(found.status[search * n_member + int(member)] for search, member in enumerate(best)),
        population=place,
        fitness=fitness,
    )
