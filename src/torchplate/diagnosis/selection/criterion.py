"""By what hypotheses are compared: their marginal likelihood, and the posterior probabilities that follow.

A hypothesis is the model with one more effect. With θ on the unit cube, P the precision of its prior (12 for a uniform
one, 1/σ² for what a ruler says) and A the information of the data, Laplace's approximation about the refit gives

    −2 ln Z = w (−2 ln L) + C + Σ ((θ − μ)/σ)² + ln |P + wA| − ln |P|,

L the likelihood beside the nuisances as they were found, C what these cost: how improbable they are, and ln |I + K|. w
tempers the likelihood, because noise and nuisances are not known any better: n numbers count as n_eff = w n. Of C
counts w + (1 − w) / κ²: where far more than noise is left, κ² times as much, nuisances take on what the model lacks,
and say no more than the data do. w and κ are those of the hypothesis that leaves least, the same for all that are
compared. Where half of all cases of an effect lie near no change, what such a prior holds joins it (`diagnosis.usual`).
Where noise is left, 1/n_eff = 1/n + ε; where more is left, the rest is not independent from line to line, and it says
no more than there are frequencies, dampings and deflections of modes:

    1/n_eff = (1 − u − v) / n₀ + u / min(n₀, n_modal) + v / min(n₀, n_second),    1/n₀ = 1/n + ε,

u = (1 − v) (1 − 1/κ²) the part of what is left that is not noise (beside the error that a model as such leaves, 1 − v),
and v the part of the variance that the second order of the nuisances makes. About a uniform section these are modes
that wander by more than their width, each with a frequency and a damping that all FRFs share: n_second = 2 n_mode.
About a specimen they are of each channel: n_modal.

Sources: Tierney and Kadane, J. American Statistical Association 81 (1986) 82, for Laplace's approximation; Kass and
Raftery, ibid. 90 (1995) 773, for Bayes factors; Miller and Dunson, ibid. 114 (2019) 1113, for tempering by what the
model of the data is worth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate, nameable
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.posterior import UNIFORM
from torchplate.diagnosis.target import FrfTarget
from torchplate.diagnosis.usual import Usual
from torchplate.discrepancy import Found
from torchplate.model import PlateModel

# Groups of nuisances that move no peak: beside what they are meant to be peaks still overlap.
STILL = frozenset({"damping_scatter"})


class Weight(NamedTuple):
    """What counts of what hypotheses cost, the same for all that are compared.

    Attributes:
        likelihood: w = n_eff / n, of −2 ln L [-].
        nuisances: of what these cost [-].
    """

    likelihood: float = 1.0
    nuisances: float = 1.0


@dataclass(frozen=True)
class Hypothesis:
    """A model with one more effect, fitted.

    Attributes:
        candidate: the effect.
        label: in the model.
        fit: of the model.
        coincidence: −2 ln of how likely it is that it ended where something of the model's own is already.
        n_option: choices of fixed options that the effect has here.
    """

    candidate: Candidate
    label: str
    fit: Fit
    coincidence: float = 0.0
    n_option: int = 1

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.candidate.name

    @property
    def own(self) -> dict[str, float]:
        """Values of its own parameters."""
        values = self.fit.model.as_dict(self.fit.theta)
        return {key: values[f"{self.label}.{key}"] for key in self.candidate.searched}

    def beside(self, model: PlateModel) -> Float[Tensor, " n"]:
        """Values of the parameters of the model that it came into."""
        values = self.fit.model.as_dict(self.fit.theta)
        return self.fit.theta.new_tensor([values[name] for name in model.names])

    @property
    def prior(self) -> float:
        """−2 ln of its prior probability, and of the coincidence."""
        settings = self.fit.comparison
        share = settings.missing * (1 - settings.beyond) / len(nameable()) / max(1, self.n_option)
        # Who gives a standard deviation has measured.
        slip = settings.slip if self.candidate.overrules else 1.0
        return -2 * math.log(share * slip) + self.coincidence

    @property
    def cost(self) -> float:
        """−2 ln of likelihood and prior together, every number counted as one."""
        return self.against(Weight())

    def against(self, weight: Weight) -> float:
        """−2 ln Z and of the prior probability, at a weight of likelihood and nuisances."""
        return evidence(self.fit, weight) + self.prior + self.rarity(weight)

    def rarity(self, weight: Weight, fit: Fit | None = None) -> float:
        """−2 ln of what its prior holds of its posterior, over what a uniform one does.

        Args:
            weight: of likelihood and nuisances.
            fit: with it among others; left out, its own.
        """
        if not self.candidate.usual:
            return 0.0
        fit = fit or self.fit
        usual = Usual.of(fit.model, {self.label: self.candidate})
        prior = torch.where(fit.told > 0, fit.told, UNIFORM)
        covariance = torch.linalg.inv(weight.likelihood * fit.information + torch.diag(prior))
        return usual.of_posterior(fit.model.space.to_cube(fit.theta), covariance)


@dataclass(frozen=True)
class Choice:
    """The best hypothesis and those beside it.

    Attributes:
        best: the one to name.
        equivalent: names of the others of the smallest set that holds the credible probability.
        next_best: the best of those outside the set; None if there is none.
        confidence: posterior probability of the set.
        probability: of each name.
        every: hypothesis, with its probability.
    """

    best: Hypothesis
    equivalent: tuple[str, ...]
    next_best: Hypothesis | None
    confidence: float
    probability: tuple[tuple[str, float], ...] = ()
    every: tuple[tuple[Hypothesis, float], ...] = ()

    def holds(self, one: Hypothesis) -> bool:
        """Whether a hypothesis is the best, or one of a name that is in the set and as probable as such."""
        settings = self.best.fit.comparison
        near = -2 * math.log(1 - settings.credible)
        weight = weight_of([self.best.fit])
        return abs(one.against(weight) - self.best.against(weight)) <= near


def evidence(fit: Fit, weight: Weight) -> float:
    """−2 ln Z of a fitted model, up to a constant of the measurement."""
    prior = torch.where(fit.told > 0, fit.told, UNIFORM)
    occam = 0.0
    if len(prior):
        root = prior.rsqrt()
        scaled = torch.eye(len(prior)).to(prior) + weight.likelihood * root[:, None] * fit.information * root
        occam = float(torch.linalg.slogdet(scaled).logabsdet)
    on_bound = -2 * math.log(fit.comparison.on_bound) * fit.n_on_bound
    return tempered(fit, weight) + occam + on_bound


def tempered(fit: Fit, weight: Weight) -> float:
    """−2 ln L and of the prior of the parameters at a fit, the likelihood and what nuisances cost at their weights."""
    judged = fit.judged
    of_data = judged.cost - judged.complexity
    return weight.likelihood * of_data + weight.nuisances * judged.complexity + fit.prior


def weight_of(fits: Sequence[Fit]) -> Weight:
    """Of fits that are compared, from the one that leaves least."""
    best = min(fits, key=lambda one: one.judged.noise_scale)
    n = max(1.0, best.judged.n)
    second, square = best.judged.second_order, best.judged.noise_scale**2
    unexplained = (1 - second) * max(0.0, 1 - 1 / max(1e-18, square))
    if not best.by_noise:
        # Beside the error that a model as such leaves, none of what is left is noise, however little of that it is.
        unexplained = 1 - second
    independent = 1 / n + best.comparison.misspecified
    # What is left of few lines, or of very many modes, says no more than as many independent numbers do.
    of_second = 2 * best.n_mode if best.about is None else best.n_modal
    shared = unexplained * max(independent, 1 / best.n_modal) + second * max(independent, 1 / of_second)
    likelihood = min(1.0, 1 / (n * ((1 - second - unexplained) * independent + shared)))
    return Weight(likelihood, likelihood + (1 - likelihood) / max(1.0, square))


def choose(hypotheses: Sequence[Hypothesis], none: Fit, best: Hypothesis | None = None) -> Choice:
    """The best of some hypotheses, at least one, its equivalents, and how probable they are.

    Args:
        hypotheses: all of them.
        none: the fit without any of them.
        best: the one to name; left out, the most probable.
    """
    settings = none.comparison
    weight = weight_of([one.fit for one in hypotheses])
    costs = {id(one): one.against(weight) for one in hypotheses}
    ranked = sorted(hypotheses, key=lambda one: costs[id(one)])
    best = best or ranked[0]
    least = costs[id(ranked[0])]
    odds: dict[str, float] = {}
    for one in ranked:
        odds[one.name] = odds.get(one.name, 0.0) + math.exp(-0.5 * (costs[id(one)] - least))
    nothing = evidence(none, weight) - 2 * math.log(1 - settings.missing)
    total = sum(odds.values())
    whole = total / (1 - settings.beyond) + math.exp(min(700.0, -0.5 * (nothing - least)))
    names = sorted(odds, key=lambda name: (name != best.name, -odds[name]))
    chosen: list[str] = []
    held = 0.0
    for name in names:
        if chosen and held >= settings.credible * total:
            break
        chosen.append(name)
        held += odds[name]
    outside = [one for one in ranked if one.name not in chosen]
    probability = tuple((name, odds[name] / whole) for name in names)
    every = tuple((one, math.exp(-0.5 * (costs[id(one)] - least)) / whole) for one in ranked)
    return Choice(best, tuple(chosen[1:]), outside[0] if outside else None, held / whole, probability, every)


def is_noise(fit: Fit) -> bool:
    """Whether nothing is left but noise and nuisances of a size that tests have."""
    settings = fit.comparison
    if not fit.by_noise or fit.judged.noise_scale**2 > settings.noise_limit:
        return False
    return not excessive(fit)


def excessive(fit: Fit) -> dict[str, float]:
    """Groups of nuisances that would have to be larger than tests have them, and how many times what was said."""
    return {name: scale for name, scale in fit.judged.scale.items() if scale > fit.comparison.size_limit}


def relieved(before: Fit, after: Fit) -> list[str]:
    """Groups of nuisances that had to be larger than tests have them, and need not with what was added.

    Args:
        before: the fit without what was added.
        after: with it.
    """
    if not (before.by_noise and after.by_noise):
        return []
    still = excessive(after)
    return [name for name in excessive(before) if name not in still]


def remaining(before: Fit, after: Fit) -> float:
    """What part of the gap is left, beside the specimens as they were found [-]; or of the misfit, if that is less.

    The gap does not show what nuisances had taken on: where some had to be larger than tests have them, and need not
    with what was added, the misfit beyond noise and nuisances counts.

    Args:
        before: the fit without what was added.
        after: with it.
    """
    gap = after.left / max(before.left, 1e-300)
    if not relieved(before, after):
        return gap
    more, less = (max(0.0, one.reduced_misfit - 1) ** 0.5 for one in (before, after))
    return min(gap, less / more) if more else gap


def known_section(fit: Fit) -> Found | None:
    """How far the section wanders, where that is known: not where it has taken on something else.

    Modes whose damping has are put back to their law: no peak moves, and of the section nothing else is known.
    """
    too_large = excessive(fit)
    if not too_large or fit.about is None:
        return fit.about
    if too_large.keys() <= STILL and fit.about.names:
        return fit.about.without(STILL)
    return None


def is_needed(before: Fit, after: Hypothesis, by_chance: float = 0.0) -> bool:
    """Whether an effect is more probable than none.

    Args:
        before: the fit without it.
        after: with it.
        by_chance: what the best of the catalogue takes from −2 ln L once in a hundred times where nothing is missing; 0
            if not known.
    """
    settings = before.comparison
    weight = weight_of([before, after.fit])
    none = evidence(before, weight) - 2 * math.log(1 - settings.missing)
    return after.against(weight) < none and before.cost - after.fit.cost > by_chance


def is_explained(fit: Fit, target: FrfTarget) -> bool:
    """Whether nothing but noise and nuisances is left, or the gap is no wider than noise alone makes it."""
    if is_noise(fit):
        return True
    return fit.by_noise and fit.gap <= target.floor


def never_equivalent(best: Fit) -> float:
    """How much less probable, in −2 ln L, a hypothesis has to be for never being the equivalent of the best."""
    comparison = best.comparison
    return -2 * math.log((1 - comparison.credible) * comparison.beyond) / weight_of([best]).likelihood
