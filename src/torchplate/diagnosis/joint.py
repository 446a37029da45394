"""Parameters and the wandering of the section fitted at once.

A section that wanders by a part of a per cent moves modes by more than the width of their peaks. The FRFs are then far
from linear in it, and a fit of the parameters alone, beside a covariance, ends wherever the peaks happen to catch. Here
both are unknowns of one least squares: each term of the section with its own prior, first where spectra are smoothed a
little, then at the sharp level beside the nuisances that are left.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior, Problem
from torchplate.discrepancy.marginal import Marginal
from torchplate.discrepancy.nuisance import specimen_columns
from torchplate.discrepancy.wandering import Found
from torchplate.model import PlateModel
from torchplate.search.jacobian import JACOBIANS
from torchplate.search.least_squares import least_squares


class Ended(NamedTuple):
    """Where a fit ended.

    Attributes:
        position: of the parameters, on the unit cube.
        found: the section.
        value: half the sum of squares, priors included.
    """

    position: Float[Tensor, " n"]
    found: Found
    value: float


class Joint:
    """A hypothesis in one basis, its section unknown.

    Args:
        builder: what evaluates it.
        model: in a basis.
        prior: what is known of its parameters beforehand.
        theta: parameters where the terms of the section are meant.
        scale: of each group of terms, times what was said of it; 1 where it is left out.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        model: PlateModel,
        prior: Prior,
        theta: Float[Tensor, " n_parameter"],
        scale: Mapping[str, float] | None = None,
    ) -> None:
        self.builder, self.model, self.prior = builder, model, prior
        self.target, self.settings = builder.target, builder.target.settings.fitting
        self.scale = dict(scale or {})
        self.specimens = self.target.specimens(model, theta)
        self.std = theta.new_tensor([self.scale.get(name, 1.0) for name in self.specimens.names])

    @property
    def n_term(self) -> int:
        """Of the section."""
        return len(self.std)

    def descend(
        self,
        position: Float[Tensor, " n"],
        shift: Float[Tensor, " n_term"] | None,
        level: int,
        n_iteration: int,
        damping: float,
        marginal: Marginal | None = None,
    ) -> Ended:
        """Least squares in parameters and section from one place, at one level.

        Args:
            position: of the parameters, on the unit cube.
            shift: of the terms, in standard deviations; none where it is left out.
            level: of the residuals.
            n_iteration: at most.
            damping: of the first step.
            marginal: noise and the other nuisances, for the sharp level; left out, about the start.
        """
        sharp = level == self.target.levels - 1
        n, far = len(position), self.settings.farthest
        shift = torch.zeros_like(self.std) if shift is None else self.known(shift)
        if sharp and marginal is None:
            marginal = self._beside(position, shift)
        start = torch.cat([position.clamp(0.0, 1.0), 0.5 + shift / (2 * far)])

        def residual(places: Float[Tensor, "*batch n_both"]) -> Float[Tensor, "*batch n_residual"]:
            rows = [self._residual(row[:n], 2 * far * (row[n:] - 0.5), level, marginal) for row in places.view(-1, len(start))]
            return torch.stack(rows).view(*places.shape[:-1], -1)

        def jacobian(places: Float[Tensor, "*batch n_both"]) -> Float[Tensor, "*batch n_residual n_both"]:
            rows = []
            for row in places.view(-1, len(start)):
                own, section = self._jacobian(row[:n], 2 * far * (row[n:] - 0.5), level, marginal)
                rows.append(torch.cat([own, 2 * far * section], dim=-1))
            return torch.stack(rows).view(*places.shape[:-1], *rows[0].shape)

        wide = self.target.settings.wide
        ended = least_squares(
            residual,
            start[None],
            jacobian=jacobian,
            n_iteration=n_iteration,
            objective_tolerance=self.settings.tolerance if sharp else wide.tolerance,
            # Rounding on the unit cube.
            step_tolerance=1e-7,
            damping=damping,
        )
        slope = ended.jacobian[0]
        slope = torch.cat([slope[:, :n], slope[:, n:] / (2 * far)], dim=-1)
        spread = torch.linalg.pinv(slope.mT @ slope, hermitian=True, rtol=1e-12)[n:, n:]
        place = ended.position[0]
        return Ended(place[:n], Found(2 * far * (place[n:] - 0.5), spread), float(ended.objective[0]))

    def descend_sharply(self, position: Float[Tensor, " n"], shift: Float[Tensor, " n_term"] | None) -> Ended:
        """At the sharp level, the other nuisances linear about where each part of the way begins.

        A part that ends no more probable than it began is the last, and does not count.
        """
        settings, sharp = self.settings, self.target.levels - 1
        shift = torch.zeros_like(self.std) if shift is None else self.known(shift)
        found = Ended(position, Found(shift, torch.eye(len(shift)).to(shift)), math.inf)
        marginal, cost = self._judged(found.position, found.found.shift)
        for _ in range(settings.most_bases):
            ended = self.descend(found.position, found.found.shift, sharp, settings.n_together, settings.damping, marginal)
            marginal, after = self._judged(ended.position, ended.found.shift)
            if after >= cost:
                # Its spread is that of an end all the same.
                spread = found.found.spread if math.isfinite(found.value) else ended.found.spread
                return found._replace(found=found.found._replace(spread=spread), value=min(found.value, ended.value))
            enough, found, cost = cost - after < settings.little, ended, after
            if enough:
                break
        return found

    def _judged(self, position: Tensor, shift: Tensor) -> tuple[Marginal, float]:
        """Noise and nuisances about a place, and −2 ln of its posterior probability beside them."""
        marginal = self._beside(position, shift)
        problem = self._problem(shift, marginal)
        theta = self.model.space.to_si(position)
        off = self.target.off(self.builder.predict(problem.model, theta))
        prior = problem.told(theta).square().sum() + (shift / self.std).square().sum()
        return marginal, marginal.cost(marginal.over_noise(off)) + float(prior)

    def known(self, shift: Float[Tensor, " n_known"]) -> Float[Tensor, " n_term"]:
        """What is known of some of the terms, and nothing of the others."""
        found, n, far = torch.zeros_like(self.std), min(len(shift), len(self.std)), self.settings.farthest
        found[:n] = shift[:n].clamp(-far, far)
        return found

    def beside(self, position: Float[Tensor, " n"], about: Found) -> Problem:
        """That of the parameters alone, the specimen as it was found."""
        model = self.specimens.at(self.known(about.shift))
        marginal = self.target.marginal(model, self.model.space.to_si(position), about)
        return Problem(self.builder, model, self.prior, marginal.rescaled(self.scale) if self.scale else marginal)

    def _beside(self, position: Tensor, shift: Tensor) -> Marginal:
        """Noise and the nuisances that are left."""
        theta = self.model.space.to_si(position)
        marginal = self.target.marginal(self.specimens.at(shift), theta, specimen=False)
        return marginal.rescaled(self.scale) if self.scale else marginal

    def _problem(self, shift: Tensor, marginal: Marginal | None) -> Problem:
        return Problem(self.builder, self.specimens.at(shift), self.prior, marginal)

    def _weight(self, level: int, n_residual: int) -> float:
        """Of a term that is off by its standard deviation."""
        return 1.0 if level == self.target.levels - 1 else self.target.settings.wide.told * n_residual**0.5

    def _residual(self, position: Tensor, shift: Tensor, level: int, marginal: Marginal | None) -> Tensor:
        found = self._problem(shift, marginal).residual(position, level)
        return torch.cat([found, self._weight(level, len(found)) * shift / self.std])

    def _jacobian(self, position: Tensor, shift: Tensor, level: int, marginal: Marginal | None) -> tuple[Tensor, Tensor]:
        """Of the parameters, by differences; of the section, by its modes."""
        target, problem = self.target, self._problem(shift, marginal)

        def along(where: Tensor) -> Tensor:
            return problem.residual(where, level)

        here = along(position)
        n = len(here)
        own = position.new_zeros(n, 0)
        if len(position):
            own = JACOBIANS["forward"].differentiate(along, position[None], here[None])[0]
        theta = self.model.space.to_si(position)
        every = 1 if marginal is not None else target.smoothing.every
        columns = specimen_columns(problem.model, theta, target.frequency[::every], self.specimens).movedim(-1, 0)
        if target.gain_is_unknown:
            columns = columns * target.gain_of(problem.model, theta)
        if marginal is not None:
            section = -marginal.whitened(marginal.over_noise(columns))
        else:
            nothing = torch.zeros_like(columns[:1])
            section = target.residual(columns, level) - target.residual(nothing, level)
        section = torch.nn.functional.pad(section.mT, (0, 0, 0, n - section.shape[-1]))
        weight = self._weight(level, n)
        own = torch.cat([own, own.new_zeros(self.n_term, own.shape[-1])])
        return own, torch.cat([section, torch.diag(weight / self.std)])
