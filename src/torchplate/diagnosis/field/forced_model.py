"""A fitted model with a free force at a place, and what such forces would have to do."""

import copy
import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.diagnosis.field.law import Law
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.localisation.misfit import Misfit
from torchplate.diagnosis.localisation.reach import Reach
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior, Problem


class Seen(NamedTuple):
    """What a force at places would have to do, in standard deviations.

    Attributes:
        off: what was measured less the model.
        reach: what a unit of force at each place makes of each FRF; of one alike in all hits, a unit of y.
        hit: force for each unit.
        alike: whether it is alike in all hits.
        predicted: what the model says, in the FRFs' unit.
        inverse: one over the standard deviation; 0 where nothing was measured.
    """

    off: Complex[Tensor, "n_frequency n_response n_reference"]
    reach: Complex[Tensor, "n_place n_frequency n_response n_reference"]
    hit: Complex[Tensor, "n_place n_frequency 1 n_reference"]
    alike: bool
    predicted: Complex[Tensor, "n_frequency n_response n_reference"]
    inverse: Float[Tensor, "n_frequency n_response n_reference"]

    def force(self, seen: Bool[Tensor, "n_response n_reference"]) -> tuple[Tensor, Tensor]:
        """The best units at each place, line and hit, and the sum of squares that weighs them, from some FRFs."""
        over = (2, 3) if self.alike else (2,)
        size = (self.reach.abs().square() * seen).sum(over, keepdim=True)
        return (self.reach.conj() * self.off * seen).sum(over, keepdim=True) / size.clamp(min=1e-300), size

    def left(self, seen: Bool[Tensor, "n_response n_reference"]) -> Tensor:
        """What the best forces from some FRFs leave of all of them [n_place, n_frequency, n_response, n_reference]."""
        return self.off - self.reach * self.force(seen)[0]

    def noise(self, seen: Bool[Tensor, "n_response n_reference"]) -> Tensor:
        """Variance of each FRF about what the force at the first place predicts: its own noise and the force's."""
        return 1 + self.reach[0].abs().square() / self.force(seen)[1][0].clamp(min=1e-300)

    def told(
        self, seen: Bool[Tensor, "n_response n_reference"]
    ) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """What the model says with the best force at the first place, in the FRFs' unit."""
        more = self.reach[0] * self.force(seen)[0][0]
        return self.predicted + torch.where(self.inverse > 0, more / self.inverse.clamp(min=1e-300), 0.0)


class ForcedModel:
    """A fitted model with a free force at a place.

    Args:
        builder: makes and evaluates models beside the evidence.
        fit: of the model without a force.
        prior: what is known of the model's own parameters beforehand.
        seen: FRFs that the force is fitted to.
        alike: whether its law is the same in all hits; another may be asked for later.
        nuisances: whether they count beside the noise.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        fit: Fit,
        prior: Prior,
        seen: Bool[Tensor, "n_response n_reference"],
        alike: bool,
        nuisances: bool = True,
    ) -> None:
        self.builder, self.target, self.seen, self.about = builder, builder.target, seen, fit.about
        self.alike = alike
        self.whole = builder.corrected(builder.adopt(fit.model), fit.theta).model
        self.reduced = builder.reduced(self.whole, fit.theta[None], about=fit.about)
        self.specimen = self.target.specimen(self.reduced, fit.theta, fit.about)
        self.problem = Problem(builder, self.reduced, prior)
        # Of the real and of the imaginary part.
        self.std = self.target.variance.sqrt()
        if nuisances:
            self.std = (0.5 * self.target.marginal(self.reduced, fit.theta, fit.about).power()).sqrt()

    def of_law(self, alike: bool) -> "ForcedModel":
        """The same with a force alike in all hits, or with one for each."""
        twin = copy.copy(self)
        twin.alike = alike
        return twin

    def at(self, theta: Float[Tensor, " n_own"], place: Float[Tensor, "n_place 2"]) -> Seen:
        """What forces at places would have to do and could.

        Args:
            theta: the model's own parameters.
            place: relative.
        """
        reach, predicted = self.reach(theta)
        alpha = reach.receptance(reach.response, place).movedim(-1, 0)
        hit = alpha.new_ones(len(place), len(reach.s), 1, len(reach.reference))
        if self.alike:
            hit = reach.receptance(place, reach.reference).movedim(1, 0)[:, :, None]
        unit = alpha[..., None] * reach.weight * hit
        return Seen(reach.misfit.residual, unit, hit, self.alike, predicted, reach.misfit.inverse)

    def reach(self, theta: Float[Tensor, " n_own"]) -> tuple[Reach, Tensor]:
        """From forces at places to all channels, and what the model says without one.

        Args:
            theta: the model's own parameters.
        """
        predicted = self.builder.predict(self.specimen, theta)
        misfit = Misfit.of(self.target.measurement, self.std, predicted)
        misfit = misfit._replace(residual=self.target.off(predicted, self.about) * misfit.inverse)
        return Reach(misfit, self.target.measurement, self.specimen, theta), predicted

    def law(self, theta: Float[Tensor, " n_own"], place: Float[Tensor, " 2"]) -> Law:
        """What a force at a place, alike in all hits, says of what is attached there, from all FRFs that fits see.

        Args:
            theta: the model's own parameters.
            place: relative.
        """
        reach, _ = self.reach(theta)
        pull, weight = self.at(theta, place[None]).force(self.target.fitted)
        own = reach.receptance(place[None], place[None])
        return Law(reach.s, pull.flatten(), weight.flatten(), own.flatten())

    def is_linear(self, theta: Float[Tensor, " n_own"], place: Float[Tensor, " 2"]) -> bool:
        """Whether a spring, a dashpot and a mass there do as well: the catalogue has these.

        A force that is free has two numbers more at each line, of each hit or of all alike. They have to earn ln n each
        of −2 ln L, n the numbers that were measured (Schwarz, Annals of Statistics 6, 1978, 461).

        Args:
            theta: the model's own parameters.
            place: relative.
        """
        reach, _ = self.reach(theta)
        misfit = reach.misfit
        linear = misfit.total - reach.kinds(place[None])[0][0]["place"] * misfit.excess
        measured = misfit.inverse > 0
        free = self.at(theta, place[None]).left(measured.any(0)).abs().square() * measured
        n_free = measured.any(2).any(1) if self.alike else measured.any(1)
        return linear - float(free.sum()) < 2 * int(n_free.sum()) * math.log(2 * int(measured.sum()))

    def residual(self, position: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_residual"]:
        """What is left of the FRFs that are seen, and of what is known beforehand; the last two numbers are the place.

        Args:
            position: of the model's own parameters and of the place, on the unit cube.
        """
        rows = []
        for one in position.reshape(-1, position.shape[-1]):
            theta = self.whole.space.to_si(one[:-2])
            left = self.at(theta, one[None, -2:]).left(self.seen)[0][:, self.seen]
            rows.append(torch.cat([torch.view_as_real(left).flatten(), self.problem.told(theta)]))
        return torch.stack(rows).unflatten(0, position.shape[:-1])

    def misfits(self, theta: Float[Tensor, " n_own"], place: Float[Tensor, "n_place 2"]) -> Float[Tensor, " n_place"]:
        """The sum of squares that the best forces at places leave of the FRFs that are seen."""
        left = self.at(theta, place).left(self.seen)
        return (left.abs().square() * self.seen).sum((1, 2, 3))
