"""The fit of one hypothesis: from wide to sharp, from several starts, in a basis that follows it.

The wide levels bring each start into the basin of the peaks; the sharp one, weighed by the noise, is the maximum of the
likelihood. Where the parameters move, the basis of the start is no longer that of the end: it is built anew there, and
the fit goes on until that changes nothing.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.joint import Ended, Joint
from torchplate.diagnosis.judged import Fit, beside, judged_beside, settled, unfitted
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior, Problem, one_level, widely
from torchplate.discrepancy import UNIFORM, Found
from torchplate.model import PlateModel


class Beat(NamedTuple):
    """What a fit has to come near in its first basis to be followed to its end.

    Attributes:
        way: of another fit, and what is near it.
        cost: likewise.
        sure: whether that one leaves nothing but noise, so that it counts from the first parts of a way on, even where
            these begin with nothing known of the specimen and say little of its end.
    """

    way: float = math.inf
    cost: float = math.inf
    sure: bool = False


NOBODY = Beat()


class Begun(NamedTuple):
    """Where the starts of a fit lead first, parameters and specimen together where nothing is known of the latter.

    Attributes:
        position: of the parameters, on the unit cube.
        shift: of the specimen, in standard deviations.
        value: half the sum of squares there, priors included.
    """

    position: Float[Tensor, " n"]
    shift: Float[Tensor, " n_off"]
    value: float


def begin(
    builder: ModelBuilder,
    model: PlateModel,
    start: Float[Tensor, "n_start n"],
    prior: Prior,
    about: Found | None = None,
) -> Begun:
    """The first part of a fit where a specimen is fitted too.

    Args:
        builder: what builds and evaluates it.
        model: in all dofs.
        start: positions on the unit cube, the best one first.
        prior: what is known of its parameters beforehand.
        about: the specimen, where it is known.
    """
    theta = model.space.to_si(start[0])
    plain = builder.reduced(builder.corrected(model, theta).model, theta[None], about=about)
    joint = Joint(builder, model, builder.target.specimens(plain, theta), prior)
    return _beside_the_axis(joint, start) if about is None else _beside(joint, start, about)


def fit(
    builder: ModelBuilder,
    model: PlateModel,
    start: Float[Tensor, "n_start n"],
    prior: Prior | None = None,
    wide: bool = True,
    hopeless: float = math.inf,
    about: Found | None = None,
    begun: Begun | None = None,
    beat: Beat = NOBODY,
) -> Fit:
    """Fit a model from several starts.

    Args:
        builder: what builds and evaluates it.
        model: in all dofs.
        start: positions on the unit cube, the best one first.
        prior: what is known of its parameters beforehand.
        wide: whether to begin at the wide levels.
        hopeless: sum of squares of the fitted residuals beyond which the first basis is the last, and is left as soon
            as it leads nowhere near.
        about: how far the plate's section wanders, as far as is known at the start; with how well that is known, which
            stays.
        begun: where these starts led.
        beat: where it is beyond both, the first basis is the last, and is left as soon as it leads nowhere near.
    """
    prior, target, settings = prior or {}, builder.target, builder.target.settings.fitting
    if not model.names:
        return unfitted(builder, model)
    first = start if begun is None else begun.position[None]
    # Beside a specimen that is known, the basis is that of the best start, in which it has begun.
    position = first[0] if about is None else start[0]
    value, way, known = torch.inf, math.inf, about
    # A model where it ended beside a specimen that was known, in the basis of that fit.
    other: PlateModel | None = None
    corrected = builder.corrected(model, model.space.to_si(position)).model
    for turn in range(settings.most_bases):
        theta = model.space.to_si(position)
        if turn == 1 or not builder.is_right_at(corrected, theta):
            corrected = builder.corrected(model, theta).model
        plain = builder.reduced(corrected, theta[None], about=about)
        specimens = target.specimens(plain, theta)
        reduced = specimens.of(about)
        if other is not None and about is not None and _at_rest(builder, other, reduced, theta, about, value):
            break
        starts = first if turn == 0 else position[None]
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
            joint = Joint(builder, model, specimens, prior, hopeless=hopeless, beat=beat.way)
            position, about, value, way = _jointly(joint, starts, about, begun)
            begun = None
            if known is not None:
                about = about.as_sure_as(known)
                other = specimens.of(about)
        moved = (position - last).abs().max()
        far = way > beat.way and target.wandering != UNIFORM
        if 2 * value > hopeless or far:
            reduced = specimens.of(about)
            of_fit = beside(target, reduced, model.space.to_si(position), about)
            found = judged_beside(builder, corrected, reduced, prior, position, of_fit)._replace(way=way)
            if 2 * value > hopeless or found.cost > beat.cost:
                return found
            beat = NOBODY
        if float(moved) < 1e-6:
            break
        at_rest = turn > 0 and abs(before - value) <= settings.settled * value
        if at_rest and builder.is_right_at(corrected, model.space.to_si(position)):
            break
        if turn + 1 >= settings.n_basis and value > settings.falling * before:
            break
    if target.wandering == UNIFORM and problem.knows and not turn:
        places, _, _ = problem.descend(position[None], target.levels - 1, settings.n_iteration, settings.free)
        position = places[0]
    ended = settled(builder, corrected, plain, prior, position, about, specimens=specimens, known=known)
    return ended._replace(way=way)


def _at_rest(
    builder: ModelBuilder, before: PlateModel, now: PlateModel, theta: Tensor, about: Found, value: float
) -> bool:
    """Whether a fit that left no more than noise in one basis has nothing to gain in another.

    Where it came to rest, −2 ln L can fall by no more in the other basis than by the sum of squares of what that
    changes in the residuals: of what they were, nothing lies along what the parameters can do.

    Args:
        builder: what evaluates both.
        before: the model in the basis in which it was fitted.
        now: the same in the other one.
        theta: its parameters, where it ended.
        about: its specimen there.
        value: half the sum of squares there.
    """
    target, settings = builder.target, builder.target.settings.fitting
    change = builder.predict(now, theta) - builder.predict(before, theta)
    if value > settings.lost * change[..., target.fitted].numel():
        return False
    marginal = target.marginal(now, theta, about)
    return float(marginal.whitened(marginal.over_noise(change)).square().sum()) <= settings.little


def _jointly(joint: Joint, starts: Float[Tensor, "n_start n"], about: Found | None, begun: Begun | None) -> Ended:
    """Parameters and specimen at the sharp level; where nothing is known of the specimen, first a little smoothed."""
    if about is None:
        begun = begun or _beside_the_axis(joint, starts)
        return joint.descend_sharply(begun.position, begun.shift)
    start = starts[0] if len(starts) == 1 else _beside(joint, starts, about).position
    return joint.descend_sharply(start, about.shift, about.channels)


def _beside(joint: Joint, starts: Float[Tensor, "n_start n"], about: Found) -> Begun:
    """Parameters at the sharp level, the specimen as it was found: the best end of some starts."""
    sharp, n = joint.target.levels - 1, joint.settings.n_together
    alone = joint.beside(starts[0], about)
    if len(starts) == 1:
        return Begun(starts[0], about.shift, 0.5 * float(alone.residual(starts[0], sharp).square().sum()))
    places, values, _ = alone.descend(starts, sharp, n // 2)
    # The better half goes on: where parameters and specimen end together is seen of one.
    places, values, _ = alone.descend(places[values.argsort()[: (len(starts) + 1) // 2]], sharp, n - n // 2)
    best = int(values.argmin())
    return Begun(places[best], about.shift, float(values[best]))


def _beside_the_axis(joint: Joint, starts: Float[Tensor, "n_start n"]) -> Begun:
    """Parameters and specimen at the last wide level, from the better half of many starts."""
    target, nothing = joint.target, starts.new_zeros(0)
    wide, level = target.settings.wide, target.levels - 2
    if len(starts) > 2 * target.settings.selecting.n_best:
        starts, _ = one_level(Problem(joint.builder, joint.specimens.uniform, joint.prior), starts, level, 1)
    ends = [joint.descend(one, nothing, level, wide.n_iteration[-1], wide.damping) for one in starts]
    return Begun(*min(ends, key=lambda one: one[2]))
