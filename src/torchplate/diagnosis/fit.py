"""The fit of one hypothesis: from wide to sharp, from several starts, in a basis that follows it.

The wide levels bring each start into the basin of the peaks; the sharp one, weighed by the noise, is the maximum of the
likelihood. Where the parameters move, the basis of the start is no longer that of the end: it is built anew there, and
the fit goes on until that changes nothing.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.target import DOUBTFUL, Misfit, Target
from torchplate.model import PlateModel
from torchplate.search.least_squares import least_squares

# Iterations at the wide levels, where it is enough to see which starts lead somewhere; and at the sharp one.
N_WIDE, N_SHARP = (3, 4, 6), 12
# Of several starts the best goes on alone after so many sharp ones.
N_TOGETHER = 5
# Damping of the steps at the end, where something is known beforehand: valleys that only this makes unlevel are long.
FREE = 1e-9
# Bases built for one fit at most, and the relative change of the misfit at which the last is good.
N_BASIS, SETTLED = 3, 2e-2
# A parameter off by its standard deviation weighs at the wide levels as much as this part of all that is measured.
TOLD_PART = 0.05


class Fit(NamedTuple):
    """A fitted model.

    Attributes:
        model: in all dofs, its mesh error taken off at the end.
        reduced: in the basis of the end.
        theta: its searched parameters in SI units.
        covariance: of theta, from the noise; NaN where a parameter is not seen.
        prediction: of the target.
        misfit: sums of squares there, and those of the prior.
        prior: what the tolerances add to the sum of squares.
        gap: over all that was measured.
        by_noise: whether residuals were weighed by the noise, and not by what the model as such leaves.
        n_told: parameters that something is known of beforehand.
    """

    model: PlateModel
    reduced: PlateModel
    theta: Float[Tensor, " n_parameter"]
    covariance: Float[Tensor, "n_parameter n_parameter"]
    prediction: Tensor
    misfit: Misfit
    prior: float
    gap: float
    by_noise: bool = True
    n_told: int = 0

    @property
    def reduced_misfit(self) -> float:
        """Mean square of all residuals over their variance: 1 where nothing but noise is left."""
        total = self.misfit.n_fitted + self.misfit.n_heldout
        return float(self.misfit.fitted + self.misfit.heldout) / max(1.0, total)

    @property
    def cost(self) -> float:
        """Everything that speaks against it: fitted and held-out residuals, and tolerances broken.

        Twice the negative logarithm of the likelihood: at the noise as it is; or, where the model is doubted, at the
        one level of what it leaves that is likeliest, n ln(SSR / n).
        """
        square = float(self.misfit.fitted + self.misfit.heldout)
        if self.by_noise:
            return square + self.prior
        total = self.misfit.n_fitted + self.misfit.n_heldout
        return total * (1 + math.log(max(square, 1e-300) / total)) + self.prior


Prior = Mapping[str, tuple[float, float]]


class Problem:
    """Residuals of a model on the unit cube.

    Args:
        builder: what evaluates it.
        model: whose searched parameters are fitted, in a basis.
        prior: "label.parameter" → mean and standard deviation.
    """

    def __init__(self, builder: ModelBuilder, model: PlateModel, prior: Prior) -> None:
        self.builder, self.model = builder, model
        self._roughly = model.without_coupling()
        known = [(model.names.index(name), *told) for name, told in prior.items() if name in model.names]
        self._index = [index for index, _, _ in known]
        self._mean, self._std = (model.known.new_tensor([row[k] for row in known]) for k in (1, 2))

    @property
    def knows(self) -> bool:
        """Whether something is known beforehand."""
        return bool(self._index)

    @property
    def target(self) -> Target:
        """What it is held against."""
        return self.builder.target

    def residual(self, position: Float[Tensor, "*batch n"], level: int) -> Float[Tensor, "*batch n_residual"]:
        """Deviations at a level; at the sharp one with those from what is known beforehand."""
        theta = self.model.space.to_si(position)
        return self.deviations(self.predict(theta, level), theta, level)

    def predict(self, theta: Float[Tensor, "*batch n"], level: int) -> Tensor:
        """What the model says at a level: at the wide ones roughly."""
        sharp = level == self.target.levels - 1
        return self.builder.predict(self.model if sharp else self._roughly, theta, level)

    def deviations(
        self, prediction: Tensor, theta: Float[Tensor, "*batch n"], level: int
    ) -> Float[Tensor, "*batch n_residual"]:
        """Those of a prediction at a level, and of these parameters from what is known beforehand.

        Where the model is doubted the latter count at the wide levels too: a smoothed residual is then about 1,
        whatever the noise.
        """
        sharp = level == self.target.levels - 1
        found = self.target.residual(prediction, level)
        if not self._index or (not sharp and self.target.trusts_the_noise):
            return found
        # Where the level of what is left is not known, it scales what is known beforehand.
        by_level = 1.0 if self.target.trusts_the_noise else DOUBTFUL**0.5
        weight = by_level if sharp else TOLD_PART * found.shape[-1] ** 0.5
        return torch.cat([found, weight * self.told(theta)], dim=-1)

    def told(self, theta: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_prior"]:
        """Deviations from what is known beforehand, over its standard deviation."""
        return (theta[..., self._index] - self._mean) / self._std

    def descend(
        self, start: Float[Tensor, "n_start n"], level: int, n_iteration: int, damping: float = 1e-3
    ) -> tuple[Float[Tensor, "n_start n"], Float[Tensor, " n_start"], Float[Tensor, "n_start n_residual n"]]:
        """Places where least squares ends, half their sums of squares, and the Jacobians there."""
        found = least_squares(
            lambda position: self.residual(position, level),
            start.clamp(0.0, 1.0),
            jacobian="forward",
            n_iteration=n_iteration,
            objective_tolerance=1e-2 if level < self.target.levels - 1 else 1e-4,
            step_tolerance=1e-7,
            damping=1e-2 if level < self.target.levels - 1 else damping,
        )
        return found.position, found.objective, found.jacobian

    def descend_sharply(
        self, start: Float[Tensor, "n_start n"]
    ) -> tuple[Float[Tensor, "n_end n"], Float[Tensor, " n_end"], Float[Tensor, "n_end n_residual n"]]:
        """Where least squares ends at the sharp level, from the best of several starts to the end."""
        level = self.target.levels - 1
        if len(start) == 1:
            return self.descend(start, level, N_SHARP)
        places, values, _ = self.descend(start, level, N_TOGETHER)
        return self.descend(places[values.argmin()][None], level, N_SHARP - N_TOGETHER)


def widely(
    problem: Problem, start: Float[Tensor, "n_start n"], keep: int = 1
) -> tuple[Float[Tensor, "n_kept n"], Float[Tensor, " n_kept"]]:
    """The best ends of several starts after all wide levels, best first, and their sums of squares at the last."""
    value = start.new_zeros(len(start))
    for level in range(problem.target.levels - 1):
        start, value = one_level(problem, start, level, keep)
    return start[:keep], value[:keep]


def one_level(
    problem: Problem, start: Float[Tensor, "n_start n"], level: int, keep: int
) -> tuple[Float[Tensor, "n_kept n"], Float[Tensor, " n_kept"]]:
    """The better half of the ends at one wide level, `keep` of them at least, and half their sums of squares."""
    end, value, _ = problem.descend(start, level, N_WIDE[level])
    kept = value.argsort()[: max(keep, len(start) // 2)]
    return end[kept], value[kept]


def fit(
    builder: ModelBuilder,
    model: PlateModel,
    start: Float[Tensor, "n_start n"],
    prior: Prior | None = None,
    wide: bool = True,
    hopeless: float = math.inf,
    near: PlateModel | None = None,
) -> Fit:
    """Fit a model from several starts.

    Args:
        builder: what builds and evaluates it.
        model: in all dofs.
        start: positions on the unit cube, the best one first.
        prior: what is known of its parameters beforehand.
        wide: whether to begin at the wide levels.
        hopeless: sum of squares of the fitted residuals beyond which the first basis is the last.
        near: much the same model, whose mesh error is taken off: what is taken off there does for the first basis.
    """
    prior = prior or {}
    if not model.names:
        return _unfitted(builder, model)
    position = start[0]
    value = torch.inf
    for turn in range(N_BASIS):
        theta = model.space.to_si(position)
        borrowed = turn == 0 and near is not None
        if turn == 0 and near is not None:
            corrected = builder.corrected_as(model, near)
        elif turn == (near is not None):
            corrected = builder.corrected(model, theta)[0]
        reduced = builder.reduced(corrected, theta[None])
        problem = Problem(builder, reduced, prior)
        starts = start if turn == 0 else position[None]
        if turn == 0 and wide and builder.target.levels > 1:
            starts, _ = widely(problem, starts, keep=2)
        places, values, jacobian = problem.descend_sharply(starts)
        best = int(values.argmin())
        before, value = value, float(values[best])
        moved = (places[best] - position).abs().max()
        position = places[best]
        if turn > 0 and abs(before - value) <= SETTLED * value:
            break
        if 2 * value > hopeless or (float(moved) < 1e-6 and not borrowed):
            break
    if problem.knows and 2 * value <= hopeless:
        places, _, jacobian = problem.descend(position[None], builder.target.levels - 1, N_SHARP, FREE)
        position, best = places[0], 0
    theta = model.space.to_si(position)
    prediction = builder.predict(reduced, theta)
    misfit = builder.target.misfit(prediction)
    covariance = _covariance(jacobian[best], model, position, max(1.0, 2 * value / max(1.0, misfit.n_fitted)))
    told = problem.told(theta)
    by_noise, gap = builder.target.trusts_the_noise, builder.target.whole_gap(prediction)
    return Fit(
        corrected,
        reduced,
        theta,
        covariance,
        prediction,
        misfit,
        float(told.square().sum()),
        gap,
        by_noise,
        len(told),
    )


def _unfitted(builder: ModelBuilder, model: PlateModel) -> Fit:
    """A model of numbers alone."""
    theta = model.known.new_zeros(0)
    corrected = builder.corrected(model, theta).model
    reduced = builder.reduced(corrected, theta[None])
    prediction = builder.predict(reduced, theta)
    misfit, by_noise = builder.target.misfit(prediction), builder.target.trusts_the_noise
    gap = builder.target.whole_gap(prediction)
    return Fit(corrected, reduced, theta, theta.new_zeros(0, 0), prediction, misfit, 0.0, gap, by_noise)


def _covariance(jacobian: Tensor, model: PlateModel, position: Tensor, scale: float) -> Tensor:
    """Of theta in SI units, at noise `scale` times as strong; NaN where the data say nothing."""
    if not len(model.names):
        return jacobian.new_zeros(0, 0)
    step = 1e-6
    slope = (model.space.to_si(position + step) - model.space.to_si(position - step)) / (2 * step)
    norm = jacobian.norm(dim=0)
    seen = norm > 1e-9 * norm.max().clamp(min=1e-300)
    scaled = jacobian[:, seen] / norm[seen]
    inverse = torch.linalg.pinv(scaled.mT @ scaled, hermitian=True, rtol=1e-10) * scale
    whole = jacobian.new_full((len(norm), len(norm)), torch.nan)
    side = slope[seen] / norm[seen]
    whole[seen[:, None] & seen] = (inverse * side[:, None] * side).flatten()
    return whole
