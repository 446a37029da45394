"""What the data can see: the change of every residual with every parameter, and what follows from it.

With residuals r(u) over the unit cube and J = ∂r/∂u, the covariance of the estimate is σ² (JᵀJ)⁻¹, σ² = rᵀr / (n − p)
(Gauss–Newton; Seber and Wild, Nonlinear Regression, 1989, ch. 2). A direction in which J is flat is one that these data
cannot see.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchplate.discrepancy.objective import Objective

# Crossing the whole interval then changes the residuals by less than this fraction of the measurement's norm.
BLIND = 1e-4
# Half the step of the central difference, as a fraction of the interval: the error is its square, rounding 1e-8 / step.
STEP = 1e-4


class Sensitivity(NamedTuple):
    """Of one estimate.

    Attributes:
        norm: ‖∂r/∂u‖ for each parameter: the change of the residuals over the whole interval [-].
        std: standard error of each parameter in its unit; infinite where the data cannot see it.
        blind: the parameters that change no residual.
        flat: directions over the unit cube along which nothing changes although their parameters, alone, do.
    """

    norm: Float[Tensor, " n_parameter"]
    std: Float[Tensor, " n_parameter"]
    blind: Bool[Tensor, " n_parameter"]
    flat: Float[Tensor, "n_flat n_parameter"]


@torch.no_grad()
def sensitivity(objective: Objective, theta: Float[Tensor, " n_parameter"]) -> Sensitivity:
    """Sensitivity of the residuals at one estimate, by central differences in one batch.

    On an edge of the interval the step goes beyond it, at most by a ten-thousandth of its width; where the parameter
    makes no sense there (a negative damping), the difference is one-sided.
    """
    space, n = objective.model.space, len(theta)
    position = space.to_cube(theta)
    steps = STEP * torch.cat([torch.eye(n), -torch.eye(n)]).to(position)
    members = space.to_si(torch.cat([position + steps, position[None]]))
    members = members.clamp(min=_physical_floor(objective).to(members))
    residual, reached = objective.residual(members), space.to_cube(members)
    apart = (reached[:n] - reached[n : 2 * n]).diagonal()
    jacobian = ((residual[:n] - residual[n : 2 * n]) / apart[:, None]).mT
    norm = jacobian.norm(dim=0)
    blind = norm < BLIND
    std = torch.full_like(theta, torch.inf)
    seen = torch.nonzero(~blind).flatten()
    flat = jacobian.new_zeros(0, n)
    if len(seen):
        # Scaled columns, so that a direction counts as flat only where seen parameters cancel each other.
        scaled = jacobian[:, seen] / norm[seen]
        # Rows of zeros where there are fewer residuals than parameters: every direction then has its singular value.
        scaled = torch.cat([scaled, scaled.new_zeros(max(0, len(seen) - len(scaled)), len(seen))])
        _, values, directions = torch.linalg.svd(scaled, full_matrices=False)
        level = values < 1e-5 * values[0]
        flat = jacobian.new_zeros(int(level.sum()), n)
        flat[:, seen] = directions[level] / norm[seen]
        variance = residual[-1].square().sum() / max(1, residual.shape[-1] - len(seen))
        inverse = torch.where(level, torch.inf, 1 / values.clamp(min=torch.finfo(values.dtype).tiny) ** 2)
        spread = (directions.square() * inverse[:, None]).nan_to_num(nan=0.0, posinf=torch.inf).sum(0)
        # Unseen stays infinite where the residuals are zero.
        variance = torch.where(spread.isinf(), 1.0, variance)
        per_unit = space.to_si(position + STEP * torch.eye(n).to(position)).diagonal() - theta
        std[seen] = (variance * spread).sqrt() / norm[seen] * per_unit[seen] / STEP
    return Sensitivity(norm, std, blind, flat)


def _physical_floor(objective: Objective) -> Tensor:
    """The least value that makes sense for each searched parameter: a step must not make a damping negative."""
    parameters = {
        f"{label}.{name}": parameter
        for label, effect in objective.model.effects.items()
        for name, parameter in effect.parameters.items()
    }
    return torch.tensor([parameters[name].allowed.low for name in objective.model.names], dtype=torch.float64)
