"""The fit of one hypothesis: from wide to sharp, from several starts, in a basis that follows it.

The wide levels bring each start into the basin of the peaks; the sharp one, weighed by the noise, is the maximum of the
likelihood. Where the parameters move, the basis of the start is no longer that of the end: it is built anew there, and
the fit goes on until that changes nothing.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.joint import Ended, Joint
from torchplate.diagnosis.judged import Fit, judged_beside, settled, unfitted
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior, Problem, widely
from torchplate.discrepancy import UNIFORM, Found
from torchplate.model import PlateModel


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
    prior, target, settings = prior or {}, builder.target, builder.target.settings.fitting
    if not model.names:
        return unfitted(builder, model)
    position = start[0]
    value = torch.inf
    for turn in range(settings.most_bases):
        theta = model.space.to_si(position)
        if turn == 0 or (turn == 1 and builder.held):
            corrected = builder.corrected(model, theta).model
        plain = builder.reduced(corrected, theta[None])
        specimens = target.specimens(plain, theta)
        reduced = specimens.of(about)
        starts = start if turn == 0 else position[None]
        if turn == 0 and wide:
            starts, _ = widely(Problem(builder, reduced, prior), starts, target.settings.selecting.n_best)
        before, last = value, position
        if target.wandering == UNIFORM:
            marginal = target.marginal(reduced, model.space.to_si(starts[0]))
            problem = Problem(builder, reduced, prior, marginal)
            damping = settings.free if turn and problem.knows else settings.damping
            places, values, _ = problem.descend_sharply(starts, damping)
            best = int(values.argmin())
            position, value = places[best], float(values[best])
        else:
            position, about, value, _ = _jointly(Joint(builder, model, specimens, prior), starts, about)
        moved = (position - last).abs().max()
        if turn > 0 and abs(before - value) <= settings.settled * value:
            break
        if 2 * value > hopeless or float(moved) < 1e-6:
            break
        if turn + 1 >= settings.n_basis and value > settings.falling * before:
            break
    if 2 * value > hopeless:
        reduced = specimens.of(about)
        marginal = target.marginal(reduced, model.space.to_si(position), about)
        return judged_beside(builder, corrected, reduced, prior, position, marginal)
    if target.wandering == UNIFORM and problem.knows and not turn:
        places, _, _ = problem.descend(position[None], target.levels - 1, settings.n_iteration, settings.free)
        position = places[0]
    return settled(builder, corrected, plain, prior, position, about, specimens=specimens)


def _jointly(joint: Joint, starts: Float[Tensor, "n_start n"], about: Found | None) -> Ended:
    """Parameters and specimen at the sharp level; where nothing is known of the specimen, first a little smoothed."""
    settings, target = joint.settings, joint.target
    sharp = target.levels - 1
    if about is None:
        wide, nothing = target.settings.wide, starts.new_zeros(0)
        ends = [joint.descend(one, nothing, sharp - 1, wide.n_iteration[-1], wide.damping) for one in starts]
        position, shift, _ = min(ends, key=lambda one: one[2])
        return joint.descend_sharply(position, shift)
    start = starts[0]
    if len(starts) > 1:
        places, values, _ = joint.beside(start, about).descend(starts, sharp, settings.n_together)
        start = places[values.argmin()]
    return joint.descend_sharply(start, about.shift, about.channels)
