"""What the data can see: the change of every residual with every parameter, and what follows from it.

The Jacobian J = ∂r/∂u of the residuals over the unit cube is exact, by forward-mode differentiation. A direction in
which J is flat is one that these data cannot see; over the others the covariance is that of `covariance`.
"""

import warnings
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchplate.discrepancy.covariance import Directions
from torchplate.discrepancy.objective import Objective

# Crossing the whole interval then changes the residuals by less than this fraction of the measurement's norm.
BLIND = 1e-4
# Parameters cancel each other in a direction in which the residuals change by less than this part of the steepest.
FLAT = 1e-7
# Part of a flat direction below which a parameter has none in it: the directions are exact to rounding over FLAT.
SHARE = 1e-4


class Sensitivity(NamedTuple):
    """Of one estimate.

    Attributes:
        norm: ‖∂r/∂u‖ for each parameter: the change of the residuals over the whole interval [-].
        std: standard error of each parameter in its unit; infinite where the data cannot see it.
        blind: the parameters that change no residual.
        flat: directions over the unit cube along which nothing changes although their parameters, alone, do.
        correlation: of the errors [-], −1 to 1; NaN beside a parameter whose standard error is infinite or zero.
    """

    norm: Float[Tensor, " n_parameter"]
    std: Float[Tensor, " n_parameter"]
    blind: Bool[Tensor, " n_parameter"]
    flat: Float[Tensor, "n_flat n_parameter"]
    correlation: Float[Tensor, "n_parameter n_parameter"]


@torch.no_grad()
def sensitivity(
    objective: Objective, theta: Float[Tensor, " n_parameter"], *, least_squares: bool = False
) -> Sensitivity:
    """Sensitivity of the residuals at one estimate, and how far noise of the measurement moves it.

    Standard errors and correlations speak of noise alone: they do not know of an effect that the model lacks.

    Args:
        objective: what was minimised.
        theta: where it is least, in SI units.
        least_squares: theta minimises the sum of squares of the residuals and not the objective itself, which may weigh
            FRFs otherwise.
    """
    space = objective.model.space
    with warnings.catch_warnings():
        # The first use makes torch compile rules of its own by a function that it has itself deprecated.
        warnings.filterwarnings("ignore", message="`torch.jit.script", category=DeprecationWarning)
        jacobian = torch.func.jacfwd(lambda u: objective.residual(space.to_si(u)))(space.to_cube(theta))
    return sensitivity_by(objective, theta, objective.residual(theta), jacobian, least_squares=least_squares)


@torch.no_grad()
def sensitivity_by(
    objective: Objective,
    theta: Float[Tensor, " n_parameter"],
    residual: Float[Tensor, " n_residual"],
    jacobian: Float[Tensor, "n_residual n_parameter"],
    *,
    least_squares: bool = False,
) -> Sensitivity:
    """`sensitivity`, where the residuals there and their Jacobian over the unit cube are at hand already."""
    space = objective.model.space
    position = space.to_cube(theta)
    rows = objective.rows(theta)
    weight = torch.ones_like(residual) if least_squares else objective.estimating_weight(residual, rows)

    norm = jacobian.norm(dim=0)
    blind = norm < BLIND
    seen = torch.nonzero(~blind).flatten()
    n = len(theta)
    covariance, flat = theta.new_full((n, n), torch.nan), jacobian.new_zeros(0, n)
    unseen = blind.clone()
    if len(seen):
        directions = Directions.of(jacobian[:, seen], weight)
        level = directions.values < FLAT * directions.values[0]
        flat = jacobian.new_zeros(int(level.sum()), n)
        flat[:, seen] = directions.right[level] / directions.norm
        unseen[seen] |= (directions.right[level].abs() > SHARE).any(0)
        per_unit = torch.func.jvp(space.to_si, (position,), (torch.ones_like(position),))[1][seen]
        over_cube = directions.at(~level).covariance(residual, weight, rows)
        covariance[seen[:, None], seen] = over_cube * per_unit[:, None] * per_unit
    std = torch.where(unseen, torch.inf, covariance.diagonal().sqrt())
    told = std.isfinite() & (std > 0)
    correlation = torch.where(told[:, None] & told, covariance / std[:, None] / std, torch.nan)
    return Sensitivity(norm, std, blind, flat, correlation)
