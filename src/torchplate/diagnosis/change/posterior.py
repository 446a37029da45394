"""Which change is most probable, which are as good, and whether any is more probable than none.

Prior odds as everywhere: that anything has changed is as probable as that nothing has; what may have changed shares the
former evenly by name, and a name's options share its part. Evidence: see `selection.criterion`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.settings import ChangeSettings
from torchplate.diagnosis.settings import Comparison


@dataclass(frozen=True)
class Weighed:
    """One hypothesis, fitted.

    Attributes:
        change: the last one that it has more than what it is compared with; None for none.
        evidence: −2 ln of its marginal likelihood.
        cost: −2 ln of its likelihood, at the weight that this has in the evidence.
        n_parameter: of the change.
        n_place: places that were tried [-].
    """

    change: Change | None
    evidence: float
    cost: float
    n_parameter: int = 0
    n_place: int = 1


@dataclass(frozen=True)
class Choice:
    """The most probable change.

    Attributes:
        best: it.
        equivalent: names of the others of the smallest set that holds the credible probability.
        next_best: the best outside of it; None if there is none.
        confidence: posterior probability of the set.
        needed: whether it is more probable than none, and takes more than chance would.
        by_chance: what chance lets the best of all take from −2 ln L with a probability of one per cent.
    """

    best: Weighed
    equivalent: tuple[str, ...]
    next_best: Weighed | None
    confidence: float
    needed: bool
    by_chance: float


def choose(
    none: Weighed,
    weighed: Sequence[Weighed],
    n_name: int,
    n_tried: int,
    comparison: Comparison,
    settings: ChangeSettings,
) -> Choice:
    """The choice among some changes, at least one.

    Args:
        none: without any of them.
        weighed: the changes.
        n_name: names among which the prior probability is shared.
        n_tried: changes that were tried, refitted or not.
        comparison: how hypotheses are compared.
        settings: what is taken for granted.
    """

    def price(one: Weighed) -> float:
        assert one.change is not None
        share = comparison.missing * (1 - comparison.beyond) / n_name / max(1, one.change.n_option)
        return one.evidence - 2 * math.log(share)

    ranked = sorted(weighed, key=price)
    best = ranked[0]
    least = price(best)
    odds: dict[str, float] = {}
    for one in ranked:
        assert one.change is not None
        odds[one.change.name] = odds.get(one.change.name, 0.0) + math.exp(-0.5 * (price(one) - least))
    nothing = none.evidence - 2 * math.log(1 - comparison.missing)
    total = sum(odds.values())
    whole = total / (1 - comparison.beyond) + math.exp(min(700.0, -0.5 * (nothing - least)))
    assert best.change is not None
    first = best.change.name
    chosen: list[str] = []
    held = 0.0
    for name in sorted(odds, key=lambda name: (name != first, -odds[name])):
        if chosen and held >= comparison.credible * total:
            break
        chosen.append(name)
        held += odds[name]
    outside = [one for one in ranked if one.change is not None and one.change.name not in chosen]
    by_chance = chance(best, n_tried, settings)
    needed = least < nothing and none.cost - best.cost > by_chance
    return Choice(best, tuple(chosen[1:]), outside[0] if outside else None, held / whole, needed, by_chance)


def chance(one: Weighed, n_tried: int, settings: ChangeSettings) -> float:
    """What the best of so many changes at so many places takes by chance: a χ² of its parameters, by Bonferroni.

    Source: Gross and Vitells, European Physical Journal C 70 (2010) 525, on the best of many places.
    """
    part = (1 - settings.level) / max(1, n_tried * one.n_place)
    import scipy.stats  # here: a third of what importing this package takes

    return float(scipy.stats.chi2.isf(part, max(1, one.n_parameter)))
