"""From fitted hypotheses to a name, the names that are as good, and how sure that is.

A hypothesis is judged by everything that speaks against it: squared residuals on fitted and on held-out FRFs over their
variance (noise, and what is left of the mesh error), tolerances broken, and a penalty for each parameter. Differences
count in units of the best one's own mean square where that is above 1: a model that leaves something unexplained knows
less of what is small.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.fit import Fit
from torchplate.diagnosis.target import FrfTarget, Target

# What a parameter must take from the sum of squares to pay for itself.
PENALTY = 8.0
# Hypotheses closer than this to the best, or than this part of all that speaks against it, cannot be told from it: the
# variance of the noise and of the mesh error is not known any better.
EQUIVALENT, EQUIVALENT_PART = 14.0, 4e-3
# An effect is taken where it takes more than chance does; where so much is left that this was not asked, this part of
# all that speaks against the model; and at least so much.
LEAST_PART, LEAST_FALL = 0.04, 60.0
# The same where the model is doubted: independent numbers are few then; or it makes the gap so much smaller.
LEAST_FALL_IN_DOUBT, HALVED = 8.0, 0.5
# A doubted model counts as one that leaves so much.
DOUBT = 20.0
# Where little is left the gap must fall by this part of itself: what moves residuals about within the variance of the
# model is no effect. Before that it need not: peaks that do not overlap make it 1 wherever they are.
SMALLEST_STEP = 0.005
# Held-out residuals may rise by this part of the whole fall; or by more, where the gap falls to this part of itself.
HELD, LARGE_STEP = 0.05, 0.75
# Mean square up to which nothing but noise is left.
NOISE_ONLY = 1.08
# A mean square that is little; the same where nothing was named, and the model is not doubted.
LITTLE, VERY_LITTLE = 3.0, 1.35
# A gap in noise floors that is at the floor: where something was named or the model is doubted, and where nothing was.
AT_FLOOR, BELOW_FLOOR = 1.1, 1.0


@dataclass(frozen=True)
class Hypothesis:
    """A model with one more effect, fitted.

    Attributes:
        candidate: the effect.
        label: in the model.
        fit: of the model.
        coincidence: what it costs that it ended where something of the model's own is already.
    """

    candidate: Candidate
    label: str
    fit: Fit
    coincidence: float = 0.0

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.candidate.name

    @property
    def penalty(self) -> float:
        """Of its parameters; a choice among channels or edges is one, too, but not that of the edge that is held.

        Where the model is doubted few numbers are independent, and each parameter of which nothing is known beforehand
        costs more than the one before.
        """
        own = len(self.candidate.searched) + bool(self.candidate.options and not self.candidate.replaces)
        if self.fit.by_noise:
            return PENALTY * own
        n = self.fit.misfit.n_fitted + self.fit.misfit.n_heldout
        without = len(self.fit.theta) - self.fit.n_told - len(self.candidate.searched)
        whole = penalty_of_few(n, without + own)
        return whole if whole == math.inf else whole - penalty_of_few(n, without)

    @property
    def cost(self) -> float:
        """What speaks against it."""
        return self.fit.cost + self.penalty + self.coincidence


@dataclass(frozen=True)
class Choice:
    """The best hypothesis and those beside it.

    Attributes:
        best: the one to name.
        equivalent: names of the others that are as good.
        next_best: the best of those that are not; None if there is none.
        margin: by which that one is worse.
        alike: by which an equivalent may be.
    """

    best: Hypothesis
    equivalent: tuple[str, ...]
    next_best: Hypothesis | None
    margin: float
    alike: float = EQUIVALENT

    def holds(self, one: Hypothesis) -> bool:
        """Whether a hypothesis is the best or as good."""
        return abs(one.cost - self.best.cost) <= self.alike * _unit(self.best)


def _unit(best: Hypothesis) -> float:
    """What differences count in: a model that leaves something unexplained knows less of what is small."""
    return max(1.0, best.fit.reduced_misfit) if best.fit.by_noise else 1.0


def penalty_of_few(n: float, n_parameter: int) -> float:
    """What parameters add to twice the negative logarithm of a likelihood of few numbers: 2 k n / (n − k − 1).

    Source: Hurvich and Tsai, Biometrika 76 (1989) 297, the corrected information criterion.

    Args:
        n: independent numbers.
        n_parameter: k; infinite where there are no fewer than n - 1.
    """
    room = n - n_parameter - 1
    return 2 * n_parameter * n / room if room > 0 else math.inf


def choose(hypotheses: Sequence[Hypothesis], best: Hypothesis | None = None) -> Choice:
    """The best of some hypotheses, at least one, and its equivalents.

    Args:
        hypotheses: all of them.
        best: the one to name; left out, it is the one that least speaks against, and where the model is doubted the
            one that closes most of the gap among those that are as good.
    """
    ranked = sorted(hypotheses, key=lambda one: one.cost)
    if best is None:
        near = [one for one in ranked if one.cost - ranked[0].cost <= EQUIVALENT]
        best = ranked[0] if ranked[0].fit.by_noise else min(near, key=lambda one: one.fit.gap, default=ranked[0])
    unit = _unit(best)
    alike = max(EQUIVALENT, EQUIVALENT_PART * best.cost / unit) if best.fit.by_noise else EQUIVALENT
    equivalent, others = [], []
    for other in ranked:
        if other.name == best.name:
            continue
        if abs(other.cost - best.cost) / unit <= alike:
            equivalent.append(other.name)
        else:
            others.append(other)
    next_best = others[0] if others else None
    margin = (others[0].cost - best.cost) / unit if others else math.inf
    return Choice(best, tuple(dict.fromkeys(equivalent)), next_best, margin, alike)


def is_noise(fit: Fit) -> bool:
    """Whether nothing but noise is left."""
    return fit.by_noise and fit.reduced_misfit <= NOISE_ONLY


def is_explained(fit: Fit, target: Target, named: bool) -> bool:
    """Whether nothing but noise is left, or the gap is at its floor: lines far below the others may say otherwise."""
    if is_noise(fit) or not isinstance(target, FrfTarget):
        return is_noise(fit)
    if named or not fit.by_noise:
        return (fit.reduced_misfit < LITTLE or not fit.by_noise) and fit.gap <= AT_FLOOR * target.floor
    return fit.reduced_misfit < VERY_LITTLE and fit.gap <= BELOW_FLOOR * target.floor


def confidence_in_the_end(choice: Choice, last: Fit, more_followed: bool) -> float:
    """Probability that the set is right, now that the last model is known.

    Args:
        choice: as it was made.
        last: the last model.
        more_followed: whether other effects were named after it: with them the model explains what a rival, alone, did
            not.
    """
    misfit = last.reduced_misfit
    margin = choice.margin
    if more_followed and choice.next_best is not None and last.by_noise:
        margin = max(margin, (choice.next_best.cost - last.cost) / max(1.0, misfit))
    return confidence(margin - choice.alike, misfit if last.by_noise else DOUBT)


def confidence(margin: float, misfit: float) -> float:
    """Probability that the set is right.

    Args:
        margin: by which the next best is worse than an equivalent.
        misfit: mean square that the named model leaves.
    """
    certain = 1 / (1 + math.exp(-max(-50.0, min(50.0, margin / 20.0))))
    # What is still unexplained may be what the name really stands for.
    return 0.98 * certain * min(1.0, (NOISE_ONLY / max(misfit, 1e-9)) ** 0.25)


def is_needed(before: Fit, after: Hypothesis, by_chance: float = 0.0) -> bool:
    """Whether an effect takes enough from what speaks against the model, on held-out FRFs too.

    Args:
        before: the fit without it.
        after: with it.
        by_chance: what the best of the catalogue takes once in a hundred times where nothing is missing; 0 if not
            known.
    """
    if not after.fit.by_noise:
        fall = before.cost - after.cost
        halved = fall > 0 and after.fit.gap <= HALVED * before.gap
        return halved or fall > LEAST_FALL_IN_DOUBT
    unit = max(1.0, after.fit.reduced_misfit)
    fall = before.cost - after.cost
    # Held-out FRFs may object; one that the missing effect hardly touches may rise a little while all others fall.
    held = float(after.fit.misfit.heldout) - float(before.misfit.heldout) < HELD * fall
    held = held or after.fit.gap <= LARGE_STEP * before.gap
    nearer = before.reduced_misfit > LITTLE or after.fit.gap < (1 - SMALLEST_STEP) * before.gap
    least = max(LEAST_FALL, by_chance if by_chance > 0 else LEAST_PART * before.cost / unit)
    return held and nearer and fall / unit > least
