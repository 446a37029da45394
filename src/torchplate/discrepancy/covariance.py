"""The covariance of an estimate, from the Jacobian of its residuals and the noise of each.

An estimate at which Jᵀ W r = 0 has, to first order, the covariance

    (Jᵀ W J)⁻¹ Jᵀ W Σ W J (Jᵀ W J)⁻¹,    Σ = diag(variance of each residual),

whether or not W is the inverse of Σ (the sandwich; Huber, 1967; White, Econometrica 48, 1980; Seber and Wild, Nonlinear
Regression, 1989, ch. 2). σ² (JᵀJ)⁻¹ with one σ² for all would claim that an FRF is as noisy in its valleys as on its
peaks, which is where nearly all of J is.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

# Turns of the weighted regression that splits noise in two, at most, and the relative change at which it has settled.
N_TURN = 30
SETTLED = 1e-3


class Rows(NamedTuple):
    """What is known of each residual.

    Attributes:
        group: an index for each FRF, one for the table of natural frequencies, two for a modal model.
        slope: how far noise of one unit moves the residual.
        amplitude: |H| of the model where the residual is an FRF's, else 0.
        variance: of the residual, as the measurement says; NaN where it does not.
    """

    group: Int[Tensor, " n_residual"]
    slope: Float[Tensor, " n_residual"]
    amplitude: Float[Tensor, " n_residual"]
    variance: Float[Tensor, " n_residual"]


class Directions(NamedTuple):
    """√W J of unit columns, taken apart: U diag(values) Vᵀ.

    Attributes:
        left: U.
        values: falling.
        right: Vᵀ, a direction in each row.
        norm: the columns' norms, divided out.
    """

    left: Float[Tensor, "n_residual n_direction"]
    values: Float[Tensor, " n_direction"]
    right: Float[Tensor, "n_direction n_parameter"]
    norm: Float[Tensor, " n_parameter"]

    @classmethod
    def of(
        cls, jacobian: Float[Tensor, "n_residual n_parameter"], weight: Float[Tensor, " n_residual"]
    ) -> "Directions":
        """Directions of a Jacobian without a zero column.

        Columns are scaled, so that a direction counts as flat only where parameters cancel each other.
        """
        weighted = weight.sqrt()[:, None] * jacobian
        norm = weighted.norm(dim=0)
        # Rows of zeros where there are fewer residuals than parameters: every direction then has its singular value.
        lacking = max(0, jacobian.shape[1] - jacobian.shape[0])
        scaled = torch.cat([weighted / norm, weighted.new_zeros(lacking, jacobian.shape[1])])
        left, values, right = torch.linalg.svd(scaled, full_matrices=False)
        return cls(left[: len(jacobian)], values, right, norm)

    def at(self, kept: Tensor) -> "Directions":
        """Some of the directions."""
        return Directions(self.left[:, kept], self.values[kept], self.right[kept], self.norm)

    def covariance(
        self, residual: Float[Tensor, " n_residual"], weight: Float[Tensor, " n_residual"], rows: Rows
    ) -> Float[Tensor, "n_parameter n_parameter"]:
        """The sandwich over these directions alone."""
        variance = noise_variance(residual, 1 - self.left.square().sum(-1), rows)
        half = self.right.mT / self.values @ (self.left * (weight * variance).sqrt()[:, None]).mT / self.norm[:, None]
        return half @ half.mT


def noise_variance(
    residual: Float[Tensor, " n_residual"], freedom: Float[Tensor, " n_residual"], rows: Rows
) -> Float[Tensor, " n_residual"]:
    """The variance of each residual: the measurement's word where it has one, else from the residuals of its group.

    Each FRF's noise is taken as σ² = a + b |H|², a ≥ 0 of the sensor and b ≥ 0 in proportion to the signal; a table's
    as a alone. a and b fit the squared residuals by a regression weighed by 1/σ⁴, turn by turn; of a, b and both, that
    is taken which the Bayesian information criterion prefers. Source: Rocke and Lorenzato, "A two-component model for
    measurement error in analytical chemistry", Technometrics 37 (1995); Carroll and Ruppert, Transformation and
    Weighting in Regression (1988), ch. 3.

    Args:
        residual: at the estimate.
        freedom: 1 − leverage: the part of each residual's variance that the fit has left.
        rows: what is known of each.
    """
    variance = rows.variance.clone()
    for group in rows.group[variance.isnan()].unique():
        own = torch.nonzero((rows.group == group) & rows.variance.isnan()).flatten()
        free = freedom[own].clamp(min=0.0)
        # With less than one degree of freedom there is next to nothing to estimate from.
        free = free / free.sum().clamp(min=torch.finfo(free.dtype).tiny, max=1.0)
        variance[own] = _two_components(residual[own], free, rows.slope[own], rows.amplitude[own])
    return variance


def _two_components(residual: Tensor, free: Tensor, slope: Tensor, amplitude: Tensor) -> Tensor:
    """Variance slope² (a + b amplitude²) of each residual: a alone, b alone or both, as their likelihood says."""
    square = residual.square()
    if not bool((square > 0).any()):
        return square
    parts = slope.square()[:, None] * torch.stack([torch.ones_like(amplitude), amplitude.square()], dim=-1)
    parts = parts[:, parts.amax(0) > 0]
    candidates = [_regressed(square, free, parts[:, [part]]) for part in range(parts.shape[1])]
    if parts.shape[1] == 2:
        # b ≥ 0 and a ≥ 0 are biased upward where there is none: the second must pay for itself (BIC).
        candidates.append(_regressed(square, free, parts))
    price = [0.0, 0.0, float(torch.tensor(len(square)).log())]
    costs = [
        float((free * variance.log() + square / variance).sum()) + extra
        for variance, extra in zip(candidates, price[: len(candidates)], strict=True)
    ]
    return candidates[costs.index(min(costs))]


def _regressed(square: Tensor, free: Tensor, parts: Tensor) -> Tensor:
    """Σ level · part, level ≥ 0, fitted to the squared residuals by a regression weighed by one over its own square."""
    parts = parts / parts.mean(0)
    least = 1e-12 * float(square.mean())
    variance = parts.mean(-1) * square.mean()
    for _ in range(N_TURN):
        design = free[:, None] * parts / variance[:, None]
        level = _nonnegative(design.mT @ design, design.mT @ (square / variance))
        before, variance = variance, (parts @ level).clamp(min=least)
        if bool(((variance - before).abs() <= SETTLED * before).all()):
            break
    return variance


def _nonnegative(normal: Tensor, right: Tensor) -> Tensor:
    """The least-squares solution with one or two unknowns that are not negative."""
    alone = right / normal.diagonal()
    if len(right) == 1:
        return alone
    determinant = normal[0, 0] * normal[1, 1] - normal[0, 1] ** 2
    both = torch.stack(
        [normal[1, 1] * right[0] - normal[0, 1] * right[1], normal[0, 0] * right[1] - normal[0, 1] * right[0]]
    )
    if bool((both >= 0).all()) and float(determinant) > 1e-12 * float(normal[0, 0] * normal[1, 1]):
        return both / determinant
    best = int((alone * right).argmax())
    return torch.where(torch.arange(2, device=right.device) == best, alone, 0.0)
