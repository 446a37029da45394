"""A force at one place, of whatever law: something is attached there that no effect describes.

A rattling contact, a spring that hardens, a cable that rubs: whatever is attached at one place g pulls there with
forces f_k(ω), one for each hit k, and the FRFs are

    H_jk = H⁰_jk(θ) + α_jg(θ) f_k,

exactly, however the force depends on the motion; α are the model's own receptances. What is linear there, a cord or a
device with dynamics of its own, pulls alike in all hits, f_k = α_gk y(ω). With y or the f_k free at each line and
eliminated by least squares (variable projection), place and θ together follow from what is left: a baseline that was
bent by trying to explain the force by other means comes back. FRFs put aside choose: they are predicted from the
others, of all hits or of their own, with the error that the force has from these.

Sources: Golub and Pereyra, SIAM J. Numerical Analysis 10 (1973) 413, on variable projection; Kerschen, Worden, Vakakis
and Golinval, Past, present and future of nonlinear system identification in structural dynamics, Mechanical Systems and
Signal Processing 20 (2006) 505, section 5, on a nonlinear element as an unknown force at its place.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.diagnosis.field.aside import worth
from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.localisation.misfit import Misfit
from torchplate.diagnosis.localisation.reach import Reach
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior, Problem
from torchplate.effects import ChannelSwap
from torchplate.model import PlateModel
from torchplate.search import least_squares


class OneForce(NamedTuple):
    """A force at one place that explains a measurement.

    Attributes:
        model: without it, in all dofs.
        theta: the model's parameters beside it.
        place: where it is, relative.
        std: of the place, relative.
        others: places that explain as much.
        left: mean square of what is left of FRFs put aside, over what noise and nuisances make of it [-].
        without: likewise without a force.
        alike: whether its law is the same in all hits.
        size: root mean square of the force over that of the hits [N/N].
        map: part of the misfit that a force at each node of the grid would explain, along x first [-].
    """

    model: PlateModel
    theta: Float[Tensor, " n_own"]
    place: Float[Tensor, " 2"]
    std: tuple[float, float]
    others: tuple[tuple[float, float], ...]
    left: float
    without: float
    alike: bool
    size: float
    map: tuple[float, ...]


class _Seen(NamedTuple):
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
        alike: whether its law is the same in all hits.
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

    def at(self, theta: Float[Tensor, " n_own"], place: Float[Tensor, "n_place 2"]) -> _Seen:
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
        return _Seen(reach.misfit.residual, unit, hit, self.alike, predicted, reach.misfit.inverse)

    def reach(self, theta: Float[Tensor, " n_own"]) -> tuple[Reach, Tensor]:
        """From forces at places to all channels, and what the model says without one.

        Args:
            theta: the model's own parameters.
        """
        predicted = self.builder.predict(self.specimen, theta)
        misfit = Misfit.of(self.target.measurement, self.std, predicted)
        misfit = misfit._replace(residual=self.target.off(predicted, self.about) * misfit.inverse)
        return Reach(misfit, self.target.measurement, self.specimen, theta), predicted

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


def one_force(
    builder: ModelBuilder, fit: Fit, prior: Prior, apart: Bool[Tensor, "n_response n_reference"], grid: Grid
) -> OneForce | None:
    """The force at one place beside which only noise and nuisances are left; None where there is none such.

    One that follows from a spring, a dashpot and a mass is none: a candidate of the catalogue or a field is that.

    Args:
        builder: makes and evaluates models beside the evidence, FRFs put aside among it.
        fit: of the model.
        prior: what is known of its parameters beforehand.
        apart: FRFs put aside.
        grid: nodes at which a force is tried first.
    """
    target, base = builder.target, fit.model
    swapped = any(isinstance(effect, ChannelSwap) for effect in base.effects.values())
    if swapped or target.gain_is_unknown or target.measurement.kind == "transmissibility":
        return None
    if base.response is None or base.reference is None:
        return None
    if (len(base.response), len(base.reference)) != target.measured.shape[1:]:
        return None
    seen = target.fitted & ~apart
    # Of one hit nobody can say whether others would do alike.
    for alike in (True, False) if int(seen.any(0).sum()) > 1 else (False,):
        told = apart
        if not alike:
            # A hit of which one FRF at most is seen tells nothing of another.
            told = apart & (seen.sum(0) > 0)
        n_seen = int(seen.sum() if alike else seen.sum(0).max())
        if n_seen > 1 and bool(told.any()):
            found = _followed(ForcedModel(builder, fit, prior, seen, alike), fit, told, grid)
            if found is not None:
                return found
    return None


def _followed(
    model: ForcedModel, fit: Fit, apart: Bool[Tensor, "n_response n_reference"], grid: Grid
) -> OneForce | None:
    """The place where the best nodes lead; None where more than noise is left, or what the catalogue has is as good."""
    settings, space, seen = model.target.settings, model.whole.space, model.seen
    own, nodes = space.to_cube(fit.theta).clamp(0.0, 1.0), grid.place
    begin = model.misfits(fit.theta, nodes).argsort()[: settings.inferring.n_force]
    found = least_squares(
        model.residual,
        torch.cat([own.expand(len(begin), -1), nodes[begin]], dim=-1),
        jacobian="forward",
        n_iteration=settings.inferring.n_force_step,
        objective_tolerance=settings.inferring.force_falls,
    )
    best = int(found.objective.argmin())
    theta, place = space.to_si(found.position[best, :-2]), found.position[best, -2:]
    there = model.at(theta, place[None])
    noise = there.noise(seen)[:, apart]
    left = 0.5 * float((there.left(seen)[0][:, apart].abs().square() / noise).mean())
    without = 0.5 * float(model.at(fit.theta, place[None]).off[:, apart].abs().square().mean())
    # As densities: a force that nothing tells predicts anything.
    gain = math.log(max(without, 1e-300)) - math.log(max(left, 1e-300)) - float(noise.log().mean())
    # Of those that it was fitted to, beside the numbers that were free.
    n_free = 1 if model.alike else int(seen.any(0).sum())
    fitted = float(found.objective[best]) / (len(model.target.frequency) * max(1, int(seen.sum()) - n_free))
    limit = settings.comparison.noise_limit
    if gain < -math.log(1 - settings.inferring.helps) or max(left, fitted) > limit:
        return None
    # Nuisances that are larger than they were said to be would do as well.
    if without < settings.comparison.size_limit**2 or model.is_linear(theta, place):
        return None
    # Nuisances are alike at neighbouring lines: what is left counts as fewer numbers than there are.
    each = 2 * len(model.target.frequency) * int(model.target.fitted.sum()) / worth(model.target, model.std.square())
    near = found.objective < float(found.objective[best]) + each * math.log(settings.inferring.twin)
    least = 0.5 / (max(grid.n_x, grid.n_y) - 1)
    others = _apart_from(place, found.position[near, -2:], least)
    # A valley in which starts come to rest in several places is as wide as these are apart.
    off = found.position[near, -2:] - place
    valley = off[(off.abs() <= least).all(-1)].square().mean(0)
    jacobian = found.jacobian[best]
    variance = torch.linalg.pinv(jacobian.mT @ jacobian, hermitian=True).diagonal()[-2:].clamp(min=0)
    std = (each * variance + valley).sqrt()
    misfit = float(there.off[:, seen].abs().square().sum())
    explained = (1 - model.misfits(theta, nodes) / misfit).clamp(min=0.0)
    size = float((there.force(seen)[0] * there.hit).abs().square().mean().sqrt())
    return OneForce(
        model.whole, theta, place, _pair(std), others, left, without, model.alike, size, tuple(explained.tolist())
    )


def _apart_from(
    place: Float[Tensor, " 2"], others: Float[Tensor, "n_other 2"], least: float
) -> tuple[tuple[float, float], ...]:
    """Those farther than that from a place and from one another."""
    kept = [place]
    for one in others:
        if all(float((one - other).abs().max()) > least for other in kept):
            kept.append(one)
    return tuple(map(_pair, kept[1:]))


def with_one_force(
    builder: ModelBuilder, fit: Fit, found: OneForce
) -> Complex[Tensor, "n_frequency n_response n_reference"]:
    """FRFs with the force at all lines that were measured, from the fitted ones.

    Args:
        builder: makes and evaluates models beside the whole evidence.
        fit: of the model without the force.
        found: the force.
    """
    whole = builder.target.at_all_lines
    model = ForcedModel(builder.against(whole), fit, {}, whole.fitted, found.alike, nuisances=False)
    return model.at(found.theta, found.place[None]).told(whole.fitted)


def _pair(place: Tensor) -> tuple[float, float]:
    return float(place[0]), float(place[1])
