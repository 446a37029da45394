"""Ways to the Jacobian of a residual on the unit cube, for many places in one call."""

import warnings
from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

Residual = Callable[[Tensor], Tensor]
"""Positions [*batch, n_dimension] in [0, 1] → real residuals [*batch, n_residual], for any leading dimensions."""


class JacobianRule(NamedTuple):
    """How J is had from the residual alone.

    Attributes:
        differentiate: (function, position, residual there) → J.
        n_evaluation: Residuals that it evaluates for each dimension.
    """

    differentiate: Callable[[Residual, Tensor, Tensor], Tensor]
    n_evaluation: int


def central_differences(
    function: Residual,
    position: Float[Tensor, "*batch n_dimension"],
    residual: Float[Tensor, "*batch n_residual"],
) -> Float[Tensor, "*batch n_residual n_dimension"]:
    """J by differences of second order, all steps in one call [2 n_dimension, *batch, n_dimension].

    With steps a and b, r' = ((r_a − r) b/a − (r_b − r) a/b) / (b − a). Inside, a = −h and b = h = ε^⅓; within h of an
    edge both go inward, h and 2h. The error is of the order of ε^⅔ (4e-11 in float64).
    """
    step = torch.finfo(position.dtype).eps ** (1 / 3)
    low, high = position < step, position > 1.0 - step
    first = torch.where(low, step, -step)
    second = torch.where(low, 2.0 * step, torch.where(high, -2.0 * step, step))
    value, offset = _shifted(function, position, torch.stack((first, second)))
    (at_a, at_b), (a, b) = value - residual, offset
    return ((at_a * (b / a) - at_b * (a / b)) / (b - a)).movedim(0, -1)


def forward_differences(
    function: Residual,
    position: Float[Tensor, "*batch n_dimension"],
    residual: Float[Tensor, "*batch n_residual"],
) -> Float[Tensor, "*batch n_residual n_dimension"]:
    """J by one step of √ε in each dimension, inward at the upper edge; half the price, error about √ε (1e-8)."""
    step = torch.finfo(position.dtype).eps ** 0.5
    value, offset = _shifted(function, position, torch.where(position > 1.0 - step, -step, step).unsqueeze(0))
    # In place: a Jacobian of many residuals is most of the memory of a fit.
    return (value[0] - residual).div_(offset[0]).movedim(0, -1)


def _shifted(function: Residual, position: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
    """Residuals [n_step, n_dimension, *batch, n_residual] one dimension off, and by how much, after rounding."""
    n_dimension = position.shape[-1]
    axes = torch.eye(n_dimension, dtype=torch.bool, device=position.device)
    axes = axes.reshape(n_dimension, *(1,) * (position.ndim - 1), n_dimension)
    place = torch.where(axes, position + step.unsqueeze(1), position)
    value = function(place.flatten(0, 1)).unflatten(0, (len(step), n_dimension))
    offset = torch.where(axes, place - position, 0.0).sum(dim=-1, keepdim=True)
    return value, offset


def forward_mode(
    function: Residual,
    position: Float[Tensor, "*batch n_dimension"],
    residual: Float[Tensor, "*batch n_residual"],  # noqa: ARG001
) -> Float[Tensor, "*batch n_residual n_dimension"]:
    """J by forward-mode automatic differentiation, exact to rounding.

    The starts are independent, so that one tangent per dimension serves them all: a `vmap` of n_dimension `jvp`s, where
    `jacfwd` of the whole batch would need n_dimension times as many as there are starts. The function must allow
    `torch.func.jvp` and `torch.func.vmap`.
    """
    n_dimension = position.shape[-1]
    axes = torch.eye(n_dimension, dtype=position.dtype, device=position.device)
    axes = axes.reshape(n_dimension, *(1,) * (position.ndim - 1), n_dimension).expand(n_dimension, *position.shape)

    def along(tangent: Tensor) -> Tensor:
        return torch.func.jvp(function, (position,), (tangent,))[1]

    with warnings.catch_warnings():
        # The first use makes torch compile rules of its own by a function that it has itself deprecated.
        warnings.filterwarnings("ignore", message="`torch.jit.script", category=DeprecationWarning)
        return torch.func.vmap(along)(axes).movedim(0, -1)


JACOBIANS: dict[str, JacobianRule] = {
    "central": JacobianRule(central_differences, 2),
    "forward": JacobianRule(forward_differences, 1),
    "autograd": JacobianRule(forward_mode, 0),
}
"""The ways to a Jacobian by the name they have in `least_squares`."""
