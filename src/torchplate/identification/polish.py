"""The finish of a population search by least squares."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Objective
from torchplate.search import Outcome, least_squares


@torch.no_grad()
def polished(
    searched: Objective,
    outcome: Outcome,
    say: Callable[[str], object] = lambda _: None,
    weighted: bool = False,
) -> Outcome:
    """Every search's best, finished by least squares on the residuals, and kept where the objective is lower.

    Args:
        searched: what was minimised.
        outcome: of the search.
        say: is told how far it went.
        weighted: residuals weigh as in the objective at the best, whose least place and theirs are then one.
    """
    space = searched.model.space
    weight = _weight(searched, outcome) if weighted else None

    def residual(position: Tensor) -> Tensor:
        found = searched.residual(space.to_si(position))
        return found if weight is None else weight * found

    finish = least_squares(residual, outcome.best_position, jacobian="autograd")
    objective = searched(space.to_si(finish.position))
    lower = objective < outcome.best_objective
    say(
        f"polished by least squares: objective {float(outcome.best_objective.min()):.6g} before, "
        f"{float(torch.where(lower, objective, outcome.best_objective).min()):.6g} after"
    )
    return outcome._replace(
        best_position=torch.where(lower[..., None], finish.position, outcome.best_position),
        best_objective=torch.where(lower, objective, outcome.best_objective),
        # A tangent of the exact Jacobian costs about as much as a residual, and the objective is evaluated once more.
        n_evaluation=outcome.n_evaluation + finish.n_evaluation + finish.n_jacobian * len(space) + 1,
    )


def _weight(searched: Objective, outcome: Outcome) -> Float[Tensor, " n_residual"]:
    """√W of the equations Jᵀ W r = 0 that hold where the objective is least, at the best, relative to the greatest."""
    best = searched.model.space.to_si(outcome.best_position[outcome.best_objective.argmin()])
    weight = searched.estimating_weight(searched.residual(best), searched.rows(best))
    return (weight / weight.amax()).sqrt()
