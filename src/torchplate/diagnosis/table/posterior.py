"""From marginal likelihoods to probabilities: of each hypothesis, each effect, each mesh, and of parameters.

Prior odds, stated: nothing is missing, one effect, two effects as `TableSettings.prior_number` has them; shared evenly
by the effects (or pairs of effects) that this table can see, then by the options of each; and evenly by the two meshes.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.table.comparison import Comparison, Weighed
from torchplate.diagnosis.table.settings import TableSettings
from torchplate.diagnosis.table.whole_box import sample


@dataclass(frozen=True, eq=False)
class Entry:
    """A hypothesis on one mesh and its posterior probability."""

    comparison: Comparison
    weighed: Weighed
    probability: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of its effects."""
        return self.weighed.names


@dataclass(frozen=True, eq=False)
class Posterior:
    """All hypotheses on all meshes, the most probable first.

    Attributes:
        entries: their probabilities add up to 1.
        settings: constants.
    """

    entries: tuple[Entry, ...]
    settings: TableSettings

    @classmethod
    def of(cls, compared: Sequence[Comparison], settings: TableSettings) -> "Posterior":
        """Of everything that was weighed."""
        rows: list[tuple[Comparison, Weighed, float]] = []
        for one in compared:
            mesh = 1.0 if len(compared) == 1 else _of_mesh(one, settings)
            for weighed in one.counted(settings.level):
                share = mesh * _prior(one, weighed, settings)
                rows.append((one, weighed, math.log(share) - 0.5 * weighed.evidence))
        log = torch.tensor([row[2] for row in rows], dtype=torch.float64)
        probability = (log - log.logsumexp(0)).exp().tolist()
        entries = [Entry(one, weighed, p) for (one, weighed, _), p in zip(rows, probability, strict=True)]
        return cls(tuple(sorted(entries, key=lambda one: -one.probability)), settings)

    def nothing(self) -> float:
        """Probability that nothing is missing."""
        return sum(one.probability for one in self.entries if not one.names)

    def number(self, n: int) -> float:
        """Probability that so many effects are missing."""
        return sum(one.probability for one in self.entries if len(one.names) == n)

    def mesh(self, kind: str) -> float:
        """Probability of a mesh."""
        return sum(one.probability for one in self.entries if one.comparison.kind == kind)

    def has(self, names: Sequence[str]) -> float:
        """Probability that one of these effects is among what is missing."""
        return sum(one.probability for one in self.entries if set(one.names) & set(names))

    def best(self) -> Entry:
        """The hypothesis to name: the likeliest number of effects, then the likeliest effects, then options and mesh.

        Nothing, where no effect is more probable than that.
        """
        every = {name for one in self.entries for name in one.names}
        if not every or max(self.has([name]) for name in every) <= self.nothing():
            return next(one for one in self.entries if not one.names)
        n = 2 if self.number(2) > self.number(1) else 1
        total: dict[tuple[str, ...], float] = defaultdict(float)
        for one in self.entries:
            if len(one.names) == n:
                total[tuple(sorted(one.names))] += one.probability
        names = max(total, key=lambda key: total[key])
        return next(one for one in self.entries if tuple(sorted(one.names)) == names)

    def rivals(self, best: Entry, name: str) -> list[tuple[str, float]]:
        """Effects in the place of one that is named, the others staying, and their probabilities; itself the first."""
        others = list(best.names)
        others.remove(name)
        total: dict[str, float] = defaultdict(float)
        for one in self.entries:
            if len(one.names) != len(best.names):
                continue
            rest = list(one.names)
            if all(other in rest for other in others):
                for other in others:
                    rest.remove(other)
                total[rest[0]] += one.probability
        ranked = sorted(((key, p) for key, p in total.items() if key != name), key=lambda pair: -pair[1])
        return [(name, total[name]), *ranked]

    def equivalent(self, best: Entry, name: str) -> tuple[str, ...]:
        """The others of the smallest set that holds `set_probability` in the place of one effect."""
        ranked = self.rivals(best, name)
        whole = sum(p for _, p in ranked)
        held, found = ranked[0][1], []
        for other, p in ranked[1:]:
            if held >= self.settings.set_probability * whole:
                break
            held += p
            found.append(other)
        return tuple(found)


def _of_mesh(one: Comparison, settings: TableSettings) -> float:
    return settings.prior_given_mesh if one.kind == "given" else 1 - settings.prior_given_mesh


def _prior(one: Comparison, weighed: Weighed, settings: TableSettings) -> float:
    """Of a hypothesis: of its number of effects, over pairs of names, over their options."""
    n = len(weighed.names)
    if n == 0:
        return settings.prior_number[0]
    options = Counter(part.name for part in one.seen)
    if n == 1:
        return settings.prior_number[1] / len(options) / options[weighed.names[0]]
    a, b = weighed.names
    # Two of one effect are a pair only where it sits at places or has several options.
    placed = {part.name for part in one.seen if part.candidate.has_place}
    doubled = sum(name in placed or count > 1 for name, count in options.items())
    n_pair = len(options) * (len(options) - 1) / 2 + doubled
    if a != b:
        return settings.prior_number[2] / n_pair / (options[a] * options[b])
    ways = options[a] * (options[a] - 1) / 2 + (options[a] if a in placed else 0)
    return settings.prior_number[2] / n_pair / ways


def pooled(posterior: Posterior, chosen: Entry) -> dict[str, Float[Tensor, " n_draw"]]:
    """Draws of every parameter in SI units, from all hypotheses that have the effects which are named.

    Which edge, which mesh and what else may be missing beside them is as uncertain as the numbers are, and moves them.
    Each hypothesis has as many draws as it is probable; where nothing is named, those without an effect.
    """
    named, settings = Counter(chosen.names), posterior.settings

    def has_them(one: Entry) -> bool:
        return all(one.names.count(name) == times for name, times in named.items()) if named else not one.names

    some = [one for one in posterior.entries if has_them(one)]
    whole = sum(one.probability for one in some)
    found: dict[str, list[Tensor]] = defaultdict(list)
    for one in some:
        evidence, model = one.comparison.plates.evidence, one.weighed.model
        count = max(round(settings.n_draw * one.probability / whole), one is chosen)
        if count and model.names:
            drawn = model.space.to_si(draws(one.weighed, evidence.freedom + evidence.n, count))
            for name, own in zip(model.names, drawn.unbind(-1), strict=True):
                found[name].append(own)
    return {name: torch.cat(parts) for name, parts in found.items()}


def draws(weighed: Weighed, freedom: float, count: int, seed: int = 0) -> Tensor:
    """Positions from the posterior of one hypothesis: as it was integrated, else of Student's t about its minima.

    Minima and their images then are each a Student t cut to the box.
    """
    if weighed.drawn is not None:
        return sample(weighed.drawn, count, seed)
    generator = torch.Generator().manual_seed(seed)
    share = torch.tensor([-0.5 * one.evidence for one in weighed.minima], dtype=torch.float64).softmax(0)
    found = []
    for one, part in zip(weighed.minima, share.tolist(), strict=True):
        own = round(part * count)
        if not own or not len(one.position):
            continue
        lower = torch.linalg.cholesky(torch.linalg.inv(one.precision))
        # Ten times as many, for those that fall outside the box.
        normal = torch.randn(10 * own, len(one.position), generator=generator, dtype=torch.float64)
        scale = _chi(freedom, 10 * own, generator)
        image = one.images[torch.randint(len(one.images), (10 * own,), generator=generator)]
        # A mirror image has the covariance of the place itself but for signs, which marginals do not see.
        place = image + (normal @ lower.mT) / (scale / freedom).sqrt()[:, None]
        inside = place[((place >= 0) & (place <= 1)).all(-1)][:own]
        found.append(inside if len(inside) else one.position[None])
    return torch.cat(found) if found else weighed.best.position[None]


def _chi(freedom: float, count: int, generator: torch.Generator) -> Tensor:
    """χ² of so many degrees of freedom: a sum of squares."""
    return torch.randn(count, round(freedom), generator=generator, dtype=torch.float64).square().sum(-1)
