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
from torchplate.diagnosis.field.forced_model import ForcedModel
from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.field.law import Law
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior
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
        law: what it says of what is attached there; None where it is not the same in all hits.
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
    law: Law | None


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
    model = ForcedModel(builder, fit, prior, seen, alike=True)
    # Of one hit nobody can say whether others would do alike.
    for alike in (True, False) if int(seen.any(0).sum()) > 1 else (False,):
        told = apart
        if not alike:
            # A hit of which one FRF at most is seen tells nothing of another.
            told = apart & (seen.sum(0) > 0)
        n_seen = int(seen.sum() if alike else seen.sum(0).max())
        if n_seen > 1 and bool(told.any()):
            found = _followed(model.of_law(alike), fit, told, grid)
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
    law = model.law(theta, place) if model.alike else None
    return OneForce(
        model.whole, theta, place, _pair(std), others, left, without, model.alike, size, tuple(explained.tolist()), law
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
