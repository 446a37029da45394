"""Parameters and specimen fitted at once.

A section that wanders by a part of a per cent moves modes by more than the width of their peaks, and a damping that
is off by a tenth shows far above a good test's noise. The FRFs are not linear in either, and a fit of the parameters
alone, beside a covariance, ends wherever the peaks happen to catch. Here both are unknowns of one least squares, each
term of the specimen with its own prior: first where spectra are smoothed a little, then at the sharp level beside the
nuisances that are left. What each channel has of its own, its place, level and drift, is among these, and taken anew
wherever they are looked at again.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior, Problem
from torchplate.discrepancy import Found, Marginal, OfChannels, Specimens, specimen_columns
from torchplate.model import PlateModel
from torchplate.search import JACOBIANS, Descent, least_squares, recalled


class Ended(NamedTuple):
    """Where a fit ended.

    Attributes:
        position: of the parameters, on the unit cube.
        found: the specimen.
        value: half the sum of squares, priors included.
        cost: −2 ln of the posterior probability there, up to a constant of the measurement.
    """

    position: Float[Tensor, " n"]
    found: Found
    value: float
    cost: float


class Joint:
    """A hypothesis in one basis, its specimen unknown.

    Args:
        builder: what evaluates it.
        model: whose parameters are fitted.
        specimens: that it may stand for, in the basis.
        prior: what is known of its parameters beforehand.
        scale: of each group of nuisances, times what was said of it; 1 where it is left out.
        hopeless: sum of squares beyond which it need not come to its end.
        beat: −2 ln of a posterior probability, likewise.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        model: PlateModel,
        specimens: Specimens,
        prior: Prior,
        scale: Mapping[str, float] | None = None,
        hopeless: float = math.inf,
        beat: float = math.inf,
    ) -> None:
        self.builder, self.model, self.specimens, self.prior = builder, model, specimens, prior
        self.target, self.settings = builder.target, builder.target.settings.fitting
        self.scale, self.hopeless, self.beat = dict(scale or {}), hopeless, beat
        self._before: tuple[Tensor, Tensor, Marginal | None, int] | None = None
        self.std = model.known.new_tensor([self.scale.get(name, 1.0) for name in specimens.names])

    def descend(
        self,
        position: Float[Tensor, " n"],
        shift: Float[Tensor, " n_known"],
        level: int,
        n_iteration: int,
        damping: float,
        marginal: Marginal | None = None,
        channels: OfChannels | None = None,
    ) -> tuple[Float[Tensor, " n"], Float[Tensor, " n_off"], float]:
        """Least squares in parameters and specimen from one place, at one level.

        Args:
            position: of the parameters, on the unit cube.
            shift: of the specimen, in standard deviations, as far as it is known.
            level: of the residuals.
            n_iteration: at most.
            damping: of the first step.
            marginal: noise and the other nuisances, for the sharp level; left out, about the start.
            channels: what each has of its own, which stays as it is.

        Returns:
            Position, shift, and half the sum of squares there, priors included.
        """
        sharp = level == self.target.levels - 1
        n, far = len(position), 2 * self.settings.farthest
        shift = self._known(shift)
        if sharp and marginal is None:
            marginal = self._beside(position, shift, channels)

        def residual(whole: Float[Tensor, "*batch n_both"]) -> Float[Tensor, "*batch n_residual"]:
            rows = [self._residual(row[:n], far * (row[n:] - 0.5), channels, level, marginal) for row in _rows(whole)]
            return torch.stack(rows).unflatten(0, whole.shape[:-1])

        def jacobian(whole: Float[Tensor, "*batch n_both"]) -> Float[Tensor, "*batch n_residual n_both"]:
            rows = [self._jacobian(row[:n], far * (row[n:] - 0.5), channels, level, marginal) for row in _rows(whole)]
            return torch.stack([_times(one, n, far) for one in rows]).unflatten(0, whole.shape[:-1])

        start = torch.cat([position.clamp(0.0, 1.0), 0.5 + shift / far])[None]

        def descend() -> Descent:
            before = self.builder.n_evaluation
            ended = least_squares(
                residual,
                start,
                jacobian=jacobian,
                n_iteration=n_iteration,
                objective_tolerance=self.settings.tolerance if sharp else self.target.settings.wide.tolerance,
                # Rounding on the unit cube.
                step_tolerance=1e-7,
                damping=damping,
            )
            n_evaluation = self.builder.n_evaluation - before
            return Descent(start, ended.position, ended.objective, n_evaluation, ended.jacobian)

        # What a descent does hangs on its start alone, so that it can be recalled.
        self._before = None
        ended, known = recalled(start, descend)
        if known:
            self.builder.count(ended.n_evaluation)
        place = ended.position[0]
        return place[:n], far * (place[n:] - 0.5), float(ended.objective[0])

    def descend_sharply(
        self, position: Float[Tensor, " n"], shift: Float[Tensor, " n_known"], channels: OfChannels | None = None
    ) -> Ended:
        """At the sharp level, the other nuisances linear about where each part of the way begins.

        How they show changes with the model too, which no part of the way knows. One that ends less probable than it
        began is taken again step by step, and each step as far as it leads down.

        Args:
            position: of the parameters, on the unit cube.
            shift: of the specimen, in standard deviations, as far as it is known.
            channels: what each has of its own, as far as it is known.
        """
        settings, sharp = self.settings, self.target.levels - 1
        here, value, n_iteration = (position, self._known(shift)), math.inf, settings.n_together
        marginal, cost, seen = self._judged(*here, channels)
        for left in reversed(range(settings.n_way)):
            *end, half = self.descend(*here, sharp, n_iteration, settings.damping, marginal, channels)
            # At this rate it would not get there in all the parts that are left.
            if 2 * (half - left * max(0.0, value - half)) > self.hopeless:
                value = min(value, half)
                break
            value = min(value, half)
            for part in settings.parts if n_iteration == 1 else (1.0,):
                there = torch.lerp(here[0], end[0], part), torch.lerp(here[1], end[1], part)
                at = seen if channels is None or seen is None else channels.towards(seen, part)
                beside, after, again = self._judged(*there, at)
                if after < cost:
                    break
            fallen = cost - after
            # A part that leads up says nothing: it is taken again step by step.
            behind = (fallen > 0 or n_iteration == 1) and min(cost, after) - left * max(0.0, fallen) > self.beat
            if fallen > 0:
                here, marginal, cost, channels, seen = there, beside, after, at, again
            if behind:
                break
            if fallen < max(settings.little, 2 * settings.tolerance * value):
                if n_iteration == 1 or fallen > 0:
                    break
                n_iteration = 1
        self._before = None
        slope = self._jacobian(*here, channels, sharp, marginal)
        n = len(position)
        # By columns of equal length: a parameter that is known to a millionth of its interval drowns no other.
        norm = slope.norm(dim=0).clamp(min=1e-300)
        unit = slope / norm
        inverse = torch.linalg.pinv(unit.mT @ unit, hermitian=True, rtol=1e-12)
        spread = (inverse / norm[:, None] / norm)[n:, n:]
        return Ended(here[0], Found(here[1], spread, channels), value, cost)

    def beside(self, position: Float[Tensor, " n"], about: Found) -> Problem:
        """The fit of the parameters alone, the specimen as it was found."""
        model = self.specimens.of(about)
        marginal = self.target.marginal(model, self.model.space.to_si(position), about)
        return Problem(self.builder, model, self.prior, marginal.rescaled(self.scale))

    def _known(self, shift: Tensor) -> Float[Tensor, " n_off"]:
        """What is known of some, and nothing of the others."""
        found, n, far = torch.zeros_like(self.std), min(len(shift), len(self.std)), self.settings.farthest
        found[:n] = shift[:n].clamp(-far, far)
        return found

    def _judged(
        self, position: Tensor, shift: Tensor, channels: OfChannels | None
    ) -> tuple[Marginal, float, OfChannels | None]:
        """Noise and nuisances about a place, −2 ln of its posterior probability, and what it says of channels."""
        marginal = self._beside(position, shift, channels)
        problem, theta = self._problem(shift, channels, marginal), self.model.space.to_si(position)
        residual = marginal.residual(self.target.off(self.builder.predict(problem.model, theta), marginal.about))
        prior = problem.told(theta).square().sum() + (shift / self.std).square().sum()
        seen = marginal.channels(residual)
        return marginal, marginal.cost(residual) + float(prior), seen and seen.within(self.settings.farthest)

    def _beside(self, position: Tensor, shift: Tensor, channels: OfChannels | None) -> Marginal:
        """Noise and the nuisances that are left."""
        theta, nothing = self.model.space.to_si(position), position.new_zeros(0)
        about = None if channels is None else Found(nothing, nothing[:, None], channels)
        return self.target.marginal(self.specimens.at(shift, channels), theta, about, specimen=False).rescaled(
            self.scale
        )

    def _problem(self, shift: Tensor, channels: OfChannels | None, marginal: Marginal | None) -> Problem:
        return Problem(self.builder, self.specimens.at(shift, channels), self.prior, marginal)

    def _weight(self, level: int, n_residual: int) -> float:
        """Of a term that is off by its standard deviation."""
        return 1.0 if level == self.target.levels - 1 else self.target.settings.wide.told * n_residual**0.5

    def _residual(
        self, position: Tensor, shift: Tensor, channels: OfChannels | None, level: int, marginal: Marginal | None
    ) -> Tensor:
        found = self._problem(shift, channels, marginal).residual(position, level)
        return torch.cat([found, self._weight(level, len(found)) * shift / self.std])

    def _jacobian(
        self, position: Tensor, shift: Tensor, channels: OfChannels | None, level: int, marginal: Marginal | None
    ) -> Tensor:
        """Of the parameters by differences, of the specimen by its modes."""
        problem, n = self._problem(shift, channels, marginal), len(position)

        def along(where: Tensor) -> Tensor:
            return problem.residual(where, level)

        theta = self.model.space.to_si(position)
        prediction = problem.predict(theta, level)
        here = problem.deviations(prediction, theta, level)
        found = here.new_zeros(len(here) + len(shift), n + len(shift))
        if n:
            found[: len(here), :n] = JACOBIANS["forward"].differentiate(along, position[None], here[None])[0]
        columns = self._columns(problem, theta, prediction, level)
        found[: columns.shape[-1], n:] = columns.mT
        found[len(here) :, n:] = torch.diag(self._weight(level, len(here)) / self.std)
        return found

    def _columns(self, problem: Problem, theta: Tensor, prediction: Tensor, level: int) -> Tensor:
        """Of the specimen; those from before, where the FRFs have hardly moved since."""
        target, marginal = self.target, problem.marginal
        if self._before is not None:
            known, there, beside, at = self._before
            near = at == level and beside is marginal
            if near and float((prediction - there).norm()) <= self.settings.still * float(prediction.norm()):
                return known
        frequency, decay = target.lines(level)
        columns = specimen_columns(problem.model, theta, frequency, self.specimens, decay).movedim(-1, 0)
        if target.gain_is_unknown:
            columns = columns * target.gain_of(problem.model, theta)
        if marginal is not None:
            found = -marginal.whitened(marginal.over_noise(columns))
        else:
            found = target.residual(columns, level) - target.residual(torch.zeros_like(columns[:1]), level)
        self._before = found, prediction, marginal, level
        return found


def _rows(places: Float[Tensor, "*batch n"]) -> Float[Tensor, "n_row n"]:
    return places.reshape(-1, places.shape[-1])


def _times(jacobian: Float[Tensor, "n_residual n_both"], n: int, factor: float) -> Float[Tensor, "n_residual n_both"]:
    """The columns after the first n times a factor."""
    return torch.cat([jacobian[:, :n], factor * jacobian[:, n:]], dim=-1)
