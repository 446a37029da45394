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
from torchplate.diagnosis.settings import Comparison
from torchplate.diagnosis.target import DOUBTFUL, FrfTarget
from torchplate.discrepancy.marginal import Judged, Marginal
from torchplate.discrepancy.wandering import Found, wandered
from torchplate.model import PlateModel
from torchplate.search.jacobian import JACOBIANS
from torchplate.search.least_squares import least_squares

# Iterations at the wide levels, where it is enough to see which starts lead somewhere; and at the sharp one.
N_WIDE, N_SHARP = (3, 4, 6), 12
# Of several starts the best goes on alone after so many sharp ones.
N_TOGETHER = 5
# Damping of the first steps; and of those at the end, where something is known beforehand: valleys that only this makes
# unlevel are long.
USUAL, FREE = 1e-3, 1e-9
# Bases built for one fit, and the relative change of the misfit at which the last is good; where it still falls to this
# part with each of them, so many at most: nuisances are linear about where each begins.
N_BASIS, SETTLED, FALLING, N_MOST = 3, 2e-2, 0.85, 8
# Times that a fit goes on beside nuisances as they are found; how much smaller one has to be, and by what part of a
# peak's width the section has to move a mode; and the fall of −2 ln L that is worth no further time.
N_SETTLED, FEWER, WIDTH, LITTLE = 4, 0.5, 0.3, 1.0
# Standard deviations that a term of a section is put into the model with, at most: a twentieth of its thickness.
FARTHEST = 10.0
# A parameter off by its standard deviation weighs at the wide levels as much as this part of all that is measured.
TOLD_PART = 0.05


class Fit(NamedTuple):
    """A fitted model, and what it was judged by.

    Attributes:
        model: in all dofs, its mesh error taken off at the end.
        reduced: in the basis of the end, its section as it was found to wander.
        theta: its searched parameters in SI units.
        covariance: of theta, noise and nuisances as large as they were found; NaN where a parameter is not seen.
        prediction: of the target, its section uniform.
        expected: likewise, its section as it was found to wander.
        judged: its residuals on what the fit saw.
        prior: what the tolerances add to the sum of squares.
        gap: over all that was measured.
        marginal: noise and nuisances beside it.
        information: of the data on theta, on the unit cube.
        told: inverse variance of what is known of each parameter beforehand, on the unit cube.
        n_on_bound: parameters that sit on the edge of their intervals.
        by_noise: whether residuals were weighed by the noise, and not by what the model as such leaves.
        n_modal: numbers that what is left says, where it is not noise.
        n_mode: modes in the band.
        comparison: by which it is compared with others.
    """

    model: PlateModel
    reduced: PlateModel
    theta: Float[Tensor, " n_parameter"]
    covariance: Float[Tensor, "n_parameter n_parameter"]
    prediction: Tensor
    expected: Tensor
    judged: Judged
    prior: float
    gap: float
    marginal: Marginal
    information: Float[Tensor, "n_parameter n_parameter"]
    told: Float[Tensor, " n_parameter"]
    n_on_bound: int = 0
    by_noise: bool = True
    n_modal: float = 2.0
    n_mode: int = 1
    comparison: Comparison = Comparison()

    @property
    def about(self) -> Found | None:
        """How far the section of `reduced` wanders."""
        return self.marginal.about

    @property
    def reduced_misfit(self) -> float:
        """Mean square of the residuals over noise and nuisances as large as was said: 1 where nothing else is left."""
        return self.judged.white

    @property
    def square(self) -> float:
        """Their sum of squares."""
        return self.judged.white * self.judged.n

    @property
    def cost(self) -> float:
        """−2 ln of the likelihood times what is known beforehand, up to a constant of the measurement."""
        return self.judged.cost + self.prior


Prior = Mapping[str, tuple[float, float]]


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
        self._roughly = model.without_coupling()
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

        At the wide levels a smoothed residual is about 1, whatever the noise: the latter weigh a part of all of them.
        """
        sharp = level == self.target.levels - 1
        if sharp:
            assert self.marginal is not None
            found = self.marginal.whitened(self.marginal.residual(self.target.off(prediction)))
        else:
            found = self.target.residual(prediction, level)
        if not self._index:
            return found
        # Where the level of what is left is not known, it scales what is known beforehand.
        by_level = 1.0 if self.target.trusts_the_noise else DOUBTFUL**0.5
        weight = by_level if sharp else TOLD_PART * found.shape[-1] ** 0.5
        return torch.cat([found, weight * self.told(theta)], dim=-1)

    def told(self, theta: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_prior"]:
        """Deviations from what is known beforehand, over its standard deviation."""
        return (theta[..., self._index] - self._mean) / self._std

    def descend(
        self, start: Float[Tensor, "n_start n"], level: int, n_iteration: int, damping: float = USUAL
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
        self, start: Float[Tensor, "n_start n"], damping: float
    ) -> tuple[Float[Tensor, "n_end n"], Float[Tensor, " n_end"], Float[Tensor, "n_end n_residual n"]]:
        """Where least squares ends at the sharp level, from the best of several starts to the end."""
        level = self.target.levels - 1
        if len(start) == 1:
            return self.descend(start, level, N_SHARP, damping)
        places, values, _ = self.descend(start, level, N_TOGETHER, damping)
        return self.descend(places[values.argmin()][None], level, N_SHARP - N_TOGETHER, damping)


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
    about: Found | None = None,
) -> Fit:
    """Fit a model from several starts.

    Args:
        builder: what builds and evaluates it.
        model: in all dofs.
        start: positions on the unit cube, the best one first.
        prior: what is known of its parameters beforehand.
        wide: whether to begin at the wide levels.
        hopeless: sum of squares of the fitted residuals beyond which the first basis is the last.
        about: how far the plate's section wanders, as far as is known at the start.
    """
    prior, target = prior or {}, builder.target
    if not model.names:
        return _unfitted(builder, model)
    position = start[0]
    value = torch.inf
    for turn in range(N_MOST):
        theta = model.space.to_si(position)
        if turn == 0 or (turn == 1 and builder.held):
            corrected = builder.corrected(model, theta).model
        plain = builder.reduced(corrected, theta[None])
        reduced = wandered(plain, theta, target.wandering, about)
        starts = start if turn == 0 else position[None]
        if turn == 0 and wide:
            starts, _ = widely(Problem(builder, reduced, prior), starts, keep=2)
        marginal = target.marginal(reduced, model.space.to_si(starts[0]), about)
        problem = Problem(builder, reduced, prior, marginal)
        places, values, _ = problem.descend_sharply(starts, FREE if turn and problem.knows else USUAL)
        best = int(values.argmin())
        before, value = value, float(values[best])
        moved = (places[best] - position).abs().max()
        position = places[best]
        if turn > 0 and abs(before - value) <= SETTLED * value:
            break
        if 2 * value > hopeless or float(moved) < 1e-6:
            break
        if turn + 1 >= N_BASIS and value > FALLING * before:
            break
    if problem.knows and not turn and 2 * value <= hopeless:
        places, _, _ = problem.descend(position[None], target.levels - 1, N_SHARP, FREE)
        position = places[0]
    if 2 * value > hopeless:
        return _judged(builder, corrected, reduced, prior, position, marginal)
    return _settled(builder, corrected, plain, prior, position, about)


def _settled(
    builder: ModelBuilder,
    model: PlateModel,
    plain: PlateModel,
    prior: Prior,
    position: Tensor,
    about: Found | None,
    fitted_on: bool = True,
) -> Fit:
    """Judged where it ended, and fitted on beside nuisances as they are found there, unless told not to.

    Nuisances that turn out smaller than was said are taken as small; a section that wanders by a part of a peak's width
    is put into the model, and the rest of it is linear about that.
    """
    target = builder.target
    best: Fit | None = None
    scale: Mapping[str, float] = {}
    for turn in range(1 + N_SETTLED):
        theta = model.space.to_si(position)
        reduced = wandered(plain, theta, target.wandering, about)
        marginal = target.marginal(reduced, theta, about)
        if scale:
            marginal = marginal.rescaled(scale)
        if turn and len(model.names) and fitted_on:
            problem = Problem(builder, reduced, prior, marginal)
            position = problem.descend(position[None], target.levels - 1, N_TOGETHER)[0][0]
        found = _judged(builder, model, reduced, prior, position, marginal)
        # Likelihoods about a uniform section and about one that wanders are not of one kind.
        alike = best is not None and (best.about is None) == (found.about is None)
        if best is not None and alike and found.cost > best.cost:
            break
        enough = best is not None and alike and best.cost - found.cost < LITTLE
        best = found
        smaller = {name: min(1.0, one) for name, one in found.judged.scale.items()}
        fewer = any(one <= FEWER * scale.get(name, 1.0) for name, one in smaller.items())
        further = found.judged.found is not None and (about is None or _moved(found) > WIDTH)
        if enough or not (fewer or further):
            break
        if fewer:
            scale = smaller
        if further and found.judged.found is not None:
            about = found.judged.found.within(FARTHEST)
    assert best is not None
    return best


def _moved(fit: Fit) -> float:
    """How far the plate's section wanders from where its fit was taken about, in widths of the peak it moves most."""
    marginal, found = fit.marginal, fit.judged.found
    if marginal.second is None or found is None:
        return 0.0
    before = torch.zeros_like(found.shift) if marginal.about is None else marginal.about.shift
    return marginal.second.widths(found.shift - before)


def judged_at(builder: ModelBuilder, fit: Fit, prior: Prior, position: Tensor) -> Fit:
    """A model that was fitted beside other evidence, as it is; beside nuisances as large as any fit's are judged at."""
    return _settled(builder, fit.model, fit.reduced, prior, position, fit.about, fitted_on=False)


def _judged(
    builder: ModelBuilder,
    model: PlateModel,
    reduced: PlateModel,
    prior: Prior,
    position: Tensor,
    marginal: Marginal,
) -> Fit:
    """A fitted model beside noise and nuisances."""
    target, theta = builder.target, model.space.to_si(position)
    prediction = expected = builder.predict(reduced, theta)
    if marginal.about is not None:
        prediction = builder.predict(wandered(reduced, theta, target.wandering, None), theta)
    judged = marginal.judge(marginal.residual(target.off(expected)))
    problem = Problem(builder, reduced, prior, marginal)

    def over_noise(where: Tensor) -> Tensor:
        off = target.off(builder.predict(reduced, reduced.space.to_si(where)))
        return marginal.over_noise(off)

    n = len(model.names)
    if n:
        here = over_noise(position)
        jacobian = JACOBIANS["forward"].differentiate(over_noise, position[None], here[None])[0]
        information = marginal.precision(jacobian.mT, judged)
    else:
        information = position.new_zeros(0, 0)
    slope = _slope(model, position)
    known = torch.zeros(n, dtype=position.dtype)
    for name, (_, std) in prior.items():
        if name in model.names:
            index = model.names.index(name)
            known[index] = (slope[index] / std) ** 2
    told = problem.told(theta)
    return Fit(
        model,
        reduced,
        theta,
        _covariance(information, known, slope),
        prediction,
        expected,
        judged,
        float(told.square().sum()),
        target.whole_gap(prediction),
        marginal,
        information,
        known,
        int(model.space.at_bound(theta).sum()) if n else 0,
        target.trusts_the_noise,
        target.n_modal,
        target.n_mode,
        target.settings.comparison,
    )


def _unfitted(builder: ModelBuilder, model: PlateModel) -> Fit:
    """A model of numbers alone."""
    theta = model.known.new_zeros(0)
    corrected = builder.corrected(model, theta).model
    return _settled(builder, corrected, builder.reduced(corrected, theta[None]), {}, theta, None)


def _slope(model: PlateModel, position: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """SI units for a unit of the cube."""
    step = 1e-6
    return (model.space.to_si(position + step) - model.space.to_si(position - step)) / (2 * step)


def _covariance(information: Tensor, known: Tensor, slope: Tensor) -> Tensor:
    """Of theta in SI units; NaN where neither the data nor anything else says something."""
    precision = information + torch.diag(known)
    norm = precision.diagonal().clamp(min=0.0).sqrt()
    seen = norm > 1e-9 * norm.max().clamp(min=1e-300) if len(norm) else norm > 0
    scaled = precision[seen][:, seen] / norm[seen] / norm[seen][:, None]
    inverse = torch.linalg.pinv(scaled, hermitian=True, rtol=1e-10)
    whole = precision.new_full(precision.shape, torch.nan)
    side = slope[seen] / norm[seen]
    whole[seen[:, None] & seen] = (inverse * side[:, None] * side).flatten()
    return whole
