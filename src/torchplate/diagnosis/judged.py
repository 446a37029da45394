"""A fitted model beside noise and nuisances: what it was judged by, and as large as they are found there."""

import math
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.joint import Joint
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.posterior import covariance
from torchplate.diagnosis.problem import Prior, Problem
from torchplate.diagnosis.settings import Comparison
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import UNIFORM, Found, Judged, Marginal, Specimens, as_it_is_meant
from torchplate.model import PlateModel
from torchplate.search import JACOBIANS

# Noise and nuisances that were made last, which are likely to be asked for again; and how many bytes of their columns
# are kept beyond the newest (128 MiB).
LAST: deque[Marginal] = deque(maxlen=3)
MOST_KEPT = 2**27


class Beside:
    """Noise and nuisances beside a model: made where they are asked for, and again once others have been since.

    They hold as many columns as there are nuisances, each as long as all FRFs: of every hypothesis that was ever fitted
    these would be gigabytes.

    Args:
        make: them.

    Attributes:
        about: how far off the specimen is that they are taken about; None where it is not.
        scale: of each group, times what was said of it; 1 where it is left out.
    """

    def __init__(self, make: Callable[[], Marginal]) -> None:
        found = _made(make)
        self._make, self._made = make, weakref.ref(found)
        self.about, self.scale = found.about, found.scale

    def __call__(self) -> Marginal:
        """As they are."""
        found = self._made()
        if found is None:
            found = _made(self._make)
            self._made = weakref.ref(found)
        return found


def _made(make: Callable[[], Marginal]) -> Marginal:
    """What is made, kept beside the last ones as far as these are not too large; there is room for it before it is."""
    # It will be about as large as the newest.
    while LAST and sum(one.nbytes for one in LAST) + LAST[-1].nbytes > MOST_KEPT:
        LAST.popleft()
    LAST.append(found := make())
    while len(LAST) > 1 and sum(one.nbytes for one in LAST) > MOST_KEPT:
        LAST.popleft()
    return found


def beside(
    target: FrfTarget,
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    about: Found | None = None,
    scale: Mapping[str, float] | None = None,
) -> Beside:
    """Those of a target beside a model.

    Args:
        target: that it is held against.
        model: in a basis.
        theta: its parameters.
        about: how far off the specimen is that it is.
        scale: of each group of nuisances, times what was said of it; 1 where it is left out.
    """
    return Beside(lambda: target.marginal(model, theta, about).rescaled(scale or {}))


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
        gap: over all FRFs that a fit sees: what is held out chooses nothing.
        left: the same of what is expected: what the specimen that was found leaves.
        beside: noise and nuisances beside it.
        information: of the data on theta, on the unit cube.
        told: inverse variance of what is known of each parameter beforehand, on the unit cube.
        n_on_bound: parameters that sit on the edge of their intervals.
        by_noise: whether residuals were weighed by the noise, and not by what the model as such leaves.
        n_modal: numbers that what is left says, where it is not noise.
        n_mode: modes in the band.
        comparison: by which it is compared with others.
        way: −2 ln of the posterior probability where parameters and specimen had come to together, before nuisances
            were taken as they are found; infinite where no specimen is fitted.
        as_found: whether the specimen is known in any case, and what it makes expected is what is predicted.
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
    left: float
    beside: Beside
    information: Float[Tensor, "n_parameter n_parameter"]
    told: Float[Tensor, " n_parameter"]
    n_on_bound: int = 0
    by_noise: bool = True
    n_modal: float = 2.0
    n_mode: int = 1
    comparison: Comparison = Comparison()
    way: float = math.inf
    as_found: bool = False

    @property
    def marginal(self) -> Marginal:
        """Noise and nuisances beside it."""
        return self.beside()

    @property
    def about(self) -> Found | None:
        """How far the section of `reduced` wanders."""
        return self.beside.about

    @property
    def predicted(self) -> PlateModel:
        """The model in its basis, as it predicts."""
        return self.reduced if self.as_found else as_it_is_meant(self.reduced)

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


def settled(
    builder: ModelBuilder,
    model: PlateModel,
    plain: PlateModel,
    prior: Prior,
    position: Tensor,
    about: Found | None,
    scale: Mapping[str, float] | None = None,
    fitted_on: bool = True,
    specimens: Specimens | None = None,
    known: Found | None = None,
) -> Fit:
    """Judged where it ended, and fitted on beside nuisances as they are found there, unless told not to.

    Nuisances that turn out smaller than was said are taken as small; a section that wanders by a part of a peak's width
    is put into the model, and the rest of it is linear about that.
    """
    target, settings = builder.target, builder.target.settings.fitting
    best: Fit | None = None
    scale = scale or {}

    specimens = specimens or target.specimens(plain, model.space.to_si(position))

    def around(position: Tensor, about: Found | None, scale: Mapping[str, float]) -> tuple[PlateModel, Beside]:
        reduced = specimens.of(about)
        return reduced, beside(target, reduced, model.space.to_si(position), about, scale)

    for turn in range(1 + settings.n_settled):
        reduced, of_fit = around(position, about, scale)
        if turn and len(model.names) and fitted_on:
            if target.wandering == UNIFORM:
                problem = Problem(builder, reduced, prior, of_fit())
                position = problem.descend(position[None], target.levels - 1, settings.n_together)[0][0]
            else:
                joint = Joint(builder, model, specimens, prior, scale)
                shift, channels = (position.new_zeros(0), None) if about is None else (about.shift, about.channels)
                position, about, *_ = joint.descend_sharply(position, shift, channels)
                about = about if known is None else about.as_sure_as(known)
            reduced, of_fit = around(position, about, scale)
        found = judged_beside(builder, model, reduced, prior, position, of_fit)
        # Likelihoods about a uniform section and about one that wanders are not of one kind.
        alike = best is not None and (best.about is None) == (found.about is None)
        if best is not None and alike and found.cost > best.cost:
            break
        enough = best is not None and alike and best.cost - found.cost < settings.little
        best = found
        smaller = {name: min(1.0, one) for name, one in found.judged.scale.items()}
        fewer = any(one <= settings.smaller * scale.get(name, 1.0) for name, one in smaller.items())
        further = found.judged.found is not None and (about is None or _moved(found) > settings.moved)
        if target.wandering != UNIFORM and found.reduced_misfit > settings.lost:
            # Nuisances take on what the parameters have not found, and are found as large or small as that is.
            break
        if enough or not (fewer or further):
            break
        if fewer:
            scale = smaller
        if further and found.judged.found is not None:
            about = found.judged.found.within(settings.farthest)
            about = about if known is None else about.as_sure_as(known)
    assert best is not None
    return best


def _moved(fit: Fit) -> float:
    """How far the plate's section wanders from where its fit was taken about, in widths of the peak it moves most."""
    marginal, found = fit.marginal, fit.judged.found
    if marginal.second is None or found is None:
        return 0.0
    before = torch.zeros_like(found.shift) if marginal.about is None else marginal.about.of(len(found.shift)).shift
    return marginal.second.widths(found.shift - before)


def judged_at(builder: ModelBuilder, fit: Fit, prior: Prior, position: Tensor) -> Fit:
    """A model that was fitted beside other evidence, as it is; beside nuisances as large as any fit's are judged at."""
    return settled(builder, fit.model, fit.reduced, prior, position, fit.about, fit.beside.scale, fitted_on=False)


def judged_beside(
    builder: ModelBuilder,
    model: PlateModel,
    reduced: PlateModel,
    prior: Prior,
    position: Tensor,
    of_fit: Beside,
    said: bool = True,
) -> Fit:
    """A fitted model beside noise and nuisances.

    Args:
        builder: makes and evaluates models, beside the evidence.
        model: in all dofs.
        reduced: in a basis.
        prior: what is known of its parameters beforehand.
        position: on the unit cube.
        of_fit: noise and nuisances.
        said: whether what the data say of each parameter is wanted; else it is nothing, and the covariance NaN.
    """
    target, theta, marginal = builder.target, model.space.to_si(position), of_fit()
    prediction = expected = builder.predict(reduced, theta)
    if marginal.about is not None:
        prediction = builder.predict(as_it_is_meant(reduced), theta)
    judged = marginal.judge(marginal.residual(target.off(expected, marginal.about)))
    problem = Problem(builder, reduced, prior, marginal)

    def over_noise(where: Tensor) -> Tensor:
        off = target.off(builder.predict(reduced, reduced.space.to_si(where)), marginal.about)
        return marginal.over_noise(off)

    n = len(model.names)
    if n and said:
        here = over_noise(position)
        jacobian = JACOBIANS["central"].differentiate(over_noise, position[None], here[None])[0]
        information = marginal.precision(jacobian.mT, judged)
    else:
        information = position.new_zeros(n, n)
    slope = _slope(model, position)
    known = torch.zeros(n, dtype=position.dtype)
    for name, (_, std) in prior.items():
        if name in model.names:
            index = model.names.index(name)
            known[index] = (slope[index] / std) ** 2
    told = problem.told(theta)
    # Beside what the model as such leaves, whose size is taken from all lines, they say no more than modes do.
    independent = 1.0 if target.trusts_the_noise else target.independent
    return Fit(
        model,
        reduced,
        theta,
        covariance(independent * information, known, slope) if said else information.new_full((n, n), torch.nan),
        prediction,
        expected,
        judged,
        float(told.square().sum()),
        float(target.gap(prediction)),
        float(target.gap(expected)),
        of_fit,
        information,
        known,
        int(model.space.at_bound(theta).sum()) if n else 0,
        target.trusts_the_noise,
        target.n_modal,
        target.n_mode,
        target.settings.comparison,
    )


def unfitted(builder: ModelBuilder, model: PlateModel) -> Fit:
    """A model of numbers alone."""
    theta = model.known.new_zeros(0)
    corrected = builder.corrected(model, theta).model
    return settled(builder, corrected, builder.reduced(corrected, theta[None]), {}, theta, None)


def _slope(model: PlateModel, position: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """SI units for a unit of the cube."""
    step = 1e-6
    return (model.space.to_si(position + step) - model.space.to_si(position - step)) / (2 * step)
