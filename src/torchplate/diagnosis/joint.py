"""Parameters and specimen fitted at once.

A section that wanders by a part of a per cent moves modes by more than the width of their peaks, and a damping that
is off by a tenth shows far above a good test's noise. The FRFs are not linear in either, and a fit of the parameters
alone, beside a covariance, ends wherever the peaks happen to catch. Here both are unknowns of one least squares, each
term of the specimen with its own prior: first where spectra are smoothed a little, then at the sharp level beside the
nuisances that are left. What each channel has of its own, its place, level and drift, is among these, and taken anew
wherever they are looked at again.
"""

import itertools
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
from torchplate.search import JACOBIANS, Descent, LeastSquaresStatus, least_squares, recalled

# Columns of the specimen that are whitened together.
AT_ONCE = 8
# Position of the parameters on the unit cube, and shift of the specimen in standard deviations.
Place = tuple[Float[Tensor, " n"], Float[Tensor, " n_off"]]


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


class Lower(NamedTuple):
    """Where a part of the way led down.

    Attributes:
        place: that it led to.
        channels: what each has of its own, there.
        marginal: noise and nuisances about there.
        fallen: by how much −2 ln of the posterior probability fell.
        misfit: what it was before.
    """

    place: Place
    channels: OfChannels | None
    marginal: Marginal
    fallen: float
    misfit: float


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
        self._recent: list[tuple[Tensor, Tensor, OfChannels | None, Tensor]] = []
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
            return _stacked([_times(one, n, far) for one in rows]).unflatten(0, whole.shape[:-1])

        start = torch.cat([position.clamp(0.0, 1.0), 0.5 + shift / far])[None]

        def descend() -> Descent:
            before, tried, factor = self.builder.n_evaluation, n_iteration, damping
            for _ in range(self.settings.n_refused + 1):
                ended = least_squares(
                    residual,
                    start,
                    jacobian=jacobian,
                    n_iteration=tried,
                    objective_tolerance=self.settings.tolerance if sharp else self.target.settings.wide.tolerance,
                    # Rounding on the unit cube.
                    step_tolerance=1e-7,
                    damping=factor,
                    jacobian_at_end=False,
                )
                if ended.status[0] is not LeastSquaresStatus.budget or not torch.equal(ended.position, start):
                    break
                # Every step was refused: it goes on with the damping that the next one would have had.
                factor *= 2.0 ** (tried * (tried + 1) / 2)
                tried = self.settings.n_together
            n_evaluation = self.builder.n_evaluation - before
            return Descent(start, ended.position, ended.objective, n_evaluation)

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

        A part ends with the channels as they are seen there, and is taken as far as all that is put in becomes more
        probable; one that does not lead down is taken again step by step. Only the first is damped as a fair start is:
        where parameters and specimen do almost the same, the way along both is flat, and a damped step on it so short
        that it looks like the end. What the second order of the nuisances adds
        to the noise stays as it is as long as parts take much: a variance that shrinks with every part lifts the walls
        of the valley before the way is in it.

        Args:
            position: of the parameters, on the unit cube.
            shift: of the specimen, in standard deviations, as far as it is known.
            channels: what each has of its own, as far as it is known.
        """
        settings, sharp = self.settings, self.target.levels - 1
        here: Place = (position, self._known(shift))
        value, n_iteration, held, damping = math.inf, settings.n_together, False, settings.damping
        marginal, cost = self._judged(*here, channels)
        louder, noise = self._louder(here, channels, marginal)
        best, costs = (cost, here, channels, marginal), [cost]
        for left in reversed(range(settings.n_way)):
            *end, half = self.descend(*here, sharp, n_iteration, damping, louder, channels)
            half *= noise
            # At this rate it would not get there in as many parts as it may be hoped to go on so.
            left = min(left, settings.hoped)
            if 2 * (half - left * max(0.0, value - half)) > self.hopeless:
                value = min(value, half)
                break
            value = min(value, half)
            least = max(settings.little, 2 * settings.tolerance * value / noise)
            there = self._lower(here, (end[0], end[1]), channels, louder)
            if there is None:
                if n_iteration == 1 and not held:
                    break
                if n_iteration == 1:
                    marginal, cost = self._judged(*here, channels)
                    (louder, noise), held = self._louder(here, channels, marginal), False
                n_iteration = settings.n_together if n_iteration == 1 else 1
                continue
            here, channels, about, fallen, misfit = there
            held = fallen > settings.far * misfit
            marginal = about.with_variance(marginal.variance) if held else about
            after = self._cost(*here, channels, marginal)
            louder, noise = self._louder(here, channels, marginal)
            behind, cost = after - left * max(0.0, cost - after) > self.beat, after
            if cost < best[0]:
                best = cost, here, channels, marginal
            costs.append(best[0])
            # Far off, where all that is left is taken for noise, ways lead round and round.
            fell = costs[-1 - settings.patience] - best[0] if len(costs) > settings.patience else math.inf
            lost = noise > settings.lost and fell < settings.far * (noise - 1) * marginal.n
            if behind or lost or (not held and fallen < least and damping < settings.damping):
                break
            if not held:
                damping = settings.near
        self._before = None
        if noise > settings.lost:
            cost, here, channels, marginal = best
        slope = self._jacobian(*here, channels, sharp, marginal)
        self._before = None
        # Of the specimen where the parameters are what they are: what is not linear in it alone is what it adds.
        own = slope[:, len(position) :]
        # Its prior is among the rows, so that nothing is left unknown.
        spread = torch.cholesky_inverse(torch.linalg.cholesky(own.mT @ own)) if own.shape[-1] else own.mT @ own
        return Ended(here[0], Found(here[1], spread, channels, self.specimens.names), value, cost)

    def _louder(self, here: Place, channels: OfChannels | None, marginal: Marginal) -> tuple[Marginal, float]:
        """The same beside as much noise as is left, and how many times its variance: far off, priors count for more.

        Without it channels and specimen take on what the parameters have not found yet.
        """
        noise = max(1.0, self._misfit(here, channels, marginal) / max(1.0, marginal.n))
        return (marginal if noise == 1 else marginal.with_variance(noise * marginal.variance)), noise

    def _lower(self, here: Place, end: Place, channels: OfChannels | None, marginal: Marginal) -> Lower | None:
        """How far a part of the way leads down; None where nowhere.

        Least squares of a part goes no farther than what is linear beside it, and beyond its end the way may go on as
        it was: where nuisances about its beginning say so it is tried twice as far, and again. That it leads down is
        said by those about its end: what is linear about the beginning counts there what it promised.

        Args:
            here: where it begins.
            end: where least squares ended.
            channels: what each has of its own, here.
            marginal: noise and nuisances about here.
        """
        before, seen = self._misfit(here, channels, marginal), self._seen(end, channels, marginal)
        begun, far = channels or (seen and seen.none()), self.settings.farthest

        def at(part: float) -> tuple[Place, OfChannels | None, float]:
            position, shift = (torch.lerp(one, other, part) for one, other in zip(here, end, strict=True))
            there = position.clamp(0.0, 1.0), shift.clamp(-far, far)
            found = None if seen is None or begun is None else begun.towards(seen, part).within(far)
            return there, found, self._misfit(there, found, marginal)

        whole, *less = self.settings.parts
        ahead = [at(whole)]
        while ahead[0][-1] < before and 2 * whole <= self.settings.longest:
            whole *= 2
            farther = at(whole)
            if farther[-1] >= ahead[0][-1]:
                break
            ahead.insert(0, farther)
        for there, found, misfit in itertools.chain(ahead, map(at, less)):
            if misfit >= before:
                continue
            about = self._beside(*there, found)
            fallen = before - self._misfit(there, found, about.with_variance(marginal.variance))
            if fallen > 0:
                return Lower(there, found, about, fallen, before)
        return None

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

    def _judged(self, position: Tensor, shift: Tensor, channels: OfChannels | None) -> tuple[Marginal, float]:
        """Noise and nuisances about a place, and −2 ln of its posterior probability.

        Args:
            position: of the parameters, on the unit cube.
            shift: of the specimen.
            channels: what each has of its own.
        """
        marginal = self._beside(position, shift, channels)
        return marginal, self._cost(position, shift, channels, marginal)

    def _cost(self, position: Tensor, shift: Tensor, channels: OfChannels | None, marginal: Marginal) -> float:
        """−2 ln of the posterior probability of a place, beside noise and nuisances about it."""
        residual, prior = self._off(position, shift, channels, marginal)
        return marginal.cost(marginal.residual(residual)) + prior

    def _off(
        self, position: Tensor, shift: Tensor, channels: OfChannels | None, marginal: Marginal
    ) -> tuple[Tensor, float]:
        """Residuals about some channels, and −2 ln of what was said beforehand of all else."""
        problem, theta = self._problem(shift, channels, marginal), self.model.space.to_si(position)
        prior = problem.told(theta).square().sum() + (shift / self.std).square().sum()
        about = None if channels is None else self._about(channels)
        return self.target.off(self._predicted(problem, theta, shift, channels), about), float(prior)

    def _misfit(self, place: Place, channels: OfChannels | None, marginal: Marginal) -> float:
        """−2 ln of the posterior probability of all that is put in, beside noise and nuisances about another place."""
        off, prior = self._off(*place, channels, marginal)
        about = None if channels is None else self._about(channels).channels
        return marginal.misfit(off, about, self.settings.farthest, self.target.noise.resonances is not None) + prior

    def _seen(self, place: Place, channels: OfChannels | None, marginal: Marginal) -> OfChannels | None:
        """What is left at a place says of channels, beside nuisances about another."""
        off, _ = self._off(*place, channels, marginal)
        seen = marginal.channels(marginal.residual(off))
        return seen and seen.within(self.settings.farthest)

    def _beside(self, position: Tensor, shift: Tensor, channels: OfChannels | None) -> Marginal:
        """Noise and the nuisances that are left."""
        theta, about = self.model.space.to_si(position), None if channels is None else self._about(channels)
        return self.target.marginal(self.specimens.at(shift, channels), theta, about, specimen=False).rescaled(
            self.scale
        )

    def _about(self, channels: OfChannels) -> Found:
        if self.target.noise.resonances is None:
            # Without resonances no drift can be taken off what was measured.
            channels = channels.without_drift()
        nothing = self.std.new_zeros(0)
        return Found(nothing, nothing[:, None], channels)

    def _predicted(
        self, problem: Problem, theta: Tensor, shift: Tensor, channels: OfChannels | None, level: int | None = None
    ) -> Tensor:
        """FRFs of a specimen; those of the last few are asked for again, by a Jacobian or beside other nuisances."""
        if level is not None and level < self.target.levels - 1:
            return problem.predict(theta, level)
        for where, off, beside, found in self._recent:
            if beside is channels and torch.equal(where, theta) and torch.equal(off, shift):
                self.builder.count(1)
                return found
        found = self.builder.predict(problem.model, theta)
        self._recent = [(theta, shift, channels, found), *self._recent[:3]]
        return found

    def _problem(self, shift: Tensor, channels: OfChannels | None, marginal: Marginal | None) -> Problem:
        return Problem(self.builder, self.specimens.at(shift, channels), self.prior, marginal)

    def _weight(self, level: int, n_residual: int) -> float:
        """Of a term that is off by its standard deviation."""
        return 1.0 if level == self.target.levels - 1 else self.target.settings.wide.told * n_residual**0.5

    def _residual(
        self, position: Tensor, shift: Tensor, channels: OfChannels | None, level: int, marginal: Marginal | None
    ) -> Tensor:
        problem, theta = self._problem(shift, channels, marginal), self.model.space.to_si(position)
        prediction = self._predicted(problem, theta, shift, channels, level)
        found = problem.deviations(prediction, theta, level)
        return torch.cat([found, self._weight(level, len(found)) * shift / self.std])

    def _jacobian(
        self, position: Tensor, shift: Tensor, channels: OfChannels | None, level: int, marginal: Marginal | None
    ) -> Tensor:
        """Of the parameters by differences, of the specimen by its modes."""
        problem, n = self._problem(shift, channels, marginal), len(position)

        def along(where: Tensor) -> Tensor:
            return problem.residual(where, level)

        theta = self.model.space.to_si(position)
        prediction = self._predicted(problem, theta, shift, channels, level)
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
            del known
        # Those are not needed any more while the next ones are made.
        self._before = None
        frequency, decay = target.lines(level)
        columns = specimen_columns(problem.model, theta, frequency, self.specimens, decay).movedim(-1, 0)
        columns = target.at_level(problem.model, theta, columns, level)
        if marginal is not None:
            found = columns.real.new_empty(len(columns), 2 * columns[0].numel())
            # Some at a time: over the noise they need not be held beside what is made of them.
            for some, whitened in zip(columns.split(AT_ONCE), found.split(AT_ONCE), strict=True):
                torch.neg(marginal.whitened(marginal.over_noise(some)), out=whitened)
        else:
            found = target.residual(columns, level) - target.residual(torch.zeros_like(columns[:1]), level)
        self._before = found, prediction, marginal, level
        return found


def _rows(places: Float[Tensor, "*batch n"]) -> Float[Tensor, "n_row n"]:
    return places.reshape(-1, places.shape[-1])


def _times(jacobian: Float[Tensor, "n_residual n_both"], n: int, factor: float) -> Float[Tensor, "n_residual n_both"]:
    """The columns after the first n times a factor, in place."""
    jacobian[:, n:] *= factor
    return jacobian


def _stacked(rows: list[Tensor]) -> Tensor:
    """Some rows beside each other; one alone is not copied."""
    return rows[0][None] if len(rows) == 1 else torch.stack(rows)
