"""Residuals of one hypothesis on the unit cube, and the ways down from several starts."""

from collections.abc import Mapping
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import Marginal
from torchplate.model import PlateModel, sharing_modes
from torchplate.plate import transformed
from torchplate.search import Descent, least_squares, recalled

Prior = Mapping[str, tuple[float, float]]
# Complex numbers of FRFs of several members that are laid out together: 32 MiB of them.
AT_ONCE = 2**21


class Problem:
    """Residuals of a model on the unit cube.

    Args:
        builder: what evaluates it.
        model: whose searched parameters are fitted, in a basis.
        prior: "label.parameter" → mean and standard deviation.
        marginal: noise and nuisances, for the sharp level.
    """

    def __init__(
        self, builder: ModelBuilder, model: PlateModel, prior: Prior, marginal: Marginal | None = None
    ) -> None:
        self.builder, self.model, self.marginal = builder, model, marginal
        known = [(model.names.index(name), *told) for name, told in prior.items() if name in model.names]
        self._index = [index for index, _, _ in known]
        self._mean, self._std = (model.known.new_tensor([row[k] for row in known]) for k in (1, 2))

    @property
    def knows(self) -> bool:
        """Whether something is known beforehand."""
        return bool(self._index)

    @property
    def target(self) -> FrfTarget:
        """What it is held against."""
        return self.builder.target

    def residual(self, position: Float[Tensor, "*batch n"], level: int) -> Float[Tensor, "*batch n_residual"]:
        """Deviations at a level; at the sharp one with those from what is known beforehand."""
        rows = position.reshape(position.shape[:-1].numel(), position.shape[-1])
        if len(rows) <= self._at_once(level) or transformed():
            theta = self.model.space.to_si(position)
            return self.deviations(self.predict(theta, level), theta, level)
        # What they are made of need not be held beside those of all.
        found = torch.cat([self.residual(some, level) for some in rows.split(self._at_once(level))])
        return found.unflatten(0, position.shape[:-1])

    def squares(self, position: Float[Tensor, "n_member n"], level: int) -> Float[Tensor, " n_member"]:
        """Sums of the squares of these: those of many FRFs are not laid out together."""
        some = position.split(self._at_once(level))
        return torch.cat([self.residual(one, level).square().sum(-1) for one in some])

    def _at_once(self, level: int) -> int:
        """Members whose FRFs are laid out together."""
        n_line = len(self.target.lines(level)[0])
        return max(1, AT_ONCE // (n_line * self.target.measurement.frf[0].numel()))

    def predict(self, theta: Float[Tensor, "*batch n"], level: int) -> Tensor:
        """What the model says at a level: at the wide ones roughly."""
        sharp = level == self.target.levels - 1
        return self.builder.predict(self._evaluated if sharp else self._roughly, theta, level)

    @cached_property
    def _evaluated(self) -> PlateModel:
        """The model in the modes that its members share, where they do; each specimen has its own."""
        return (None if self.model.assembly.unevenness is not None else sharing_modes(self.model)) or self.model

    @cached_property
    def _roughly(self) -> PlateModel:
        return self._evaluated.without_coupling()

    def deviations(
        self, prediction: Tensor, theta: Float[Tensor, "*batch n"], level: int
    ) -> Float[Tensor, "*batch n_residual"]:
        """Those of a prediction at a level, and of these parameters from what is known beforehand.

        At the wide levels a smoothed residual is about 1, whatever the noise: the latter weigh a part of all of them.
        """
        sharp = level == self.target.levels - 1
        if sharp:
            assert self.marginal is not None
            found = self.marginal.whitened(self.marginal.residual(self.target.off(prediction, self.marginal.about)))
        else:
            found = self.target.residual(prediction, level)
        if not self._index:
            return found
        # Where the level of what is left is not known, it scales what is known beforehand.
        by_level = 1.0 if self.target.trusts_the_noise else self.target.settings.selecting.doubtful**0.5
        weight = by_level if sharp else self.target.settings.wide.told * self._n_measured(level, found) ** 0.5
        return torch.cat([found, weight * self.told(theta)], dim=-1)

    def _n_measured(self, level: int, found: Tensor) -> float:
        """Numbers that were measured for those of a wide level."""
        return found.shape[-1] * float(self.target.smoothing.levels[level].stands_for.mean())

    def told(self, theta: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_prior"]:
        """Deviations from what is known beforehand, over its standard deviation."""
        return (theta[..., self._index] - self._mean) / self._std

    def descend(
        self, start: Float[Tensor, "n_start n"], level: int, n_iteration: int, damping: float | None = None
    ) -> tuple[Float[Tensor, "n_start n"], Float[Tensor, " n_start"], int]:
        """Places where least squares ends, half their sums of squares, and what it cost in evaluations.

        Args:
            start: positions.
            level: of the residuals.
            n_iteration: at most.
            damping: of the first step at the sharp level; as usual where it is left out.
        """
        wide, sharp = self.target.settings.wide, self.target.settings.fitting
        is_wide = level < self.target.levels - 1
        start = start.clamp(0.0, 1.0)

        def descend() -> Descent:
            before = self.builder.n_evaluation
            found = least_squares(
                lambda position: self.residual(position, level),
                start,
                jacobian="forward",
                n_iteration=n_iteration,
                objective_tolerance=wide.tolerance if is_wide else sharp.tolerance,
                # Rounding on the unit cube.
                step_tolerance=1e-7,
                damping=wide.damping if is_wide else sharp.damping if damping is None else damping,
                jacobian_at_end=False,
            )
            n_evaluation = self.builder.n_evaluation - before
            return Descent(start, found.position, found.objective, n_evaluation)

        found, known = recalled(start, descend)
        if known:
            self.builder.count(found.n_evaluation)
        return found.position, found.objective, found.n_evaluation

    def descend_sharply(
        self, start: Float[Tensor, "n_start n"], damping: float
    ) -> tuple[Float[Tensor, "n_end n"], Float[Tensor, " n_end"], int]:
        """Where least squares ends at the sharp level, from the best of several starts to the end."""
        level, settings = self.target.levels - 1, self.target.settings.fitting
        if len(start) == 1:
            return self.descend(start, level, settings.n_iteration, damping)
        places, values, _ = self.descend(start, level, settings.n_together, damping)
        rest = settings.n_iteration - settings.n_together
        return self.descend(places[values.argmin()][None], level, rest, damping)


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
    end, value, _ = problem.descend(start, level, problem.target.settings.wide.n_iteration[level])
    kept = value.argsort()[: max(keep, len(start) // 2)]
    return end[kept], value[kept]
