"""What a diagnosis of a table has come to."""

from collections.abc import Sequence
from dataclasses import dataclass

from torchplate.diagnosis.result import Verdict
from torchplate.diagnosis.table.comparison import Comparison, Weighed
from torchplate.diagnosis.table.posterior import Entry, Posterior
from torchplate.diagnosis.table.refit import Prior
from torchplate.diagnosis.table.settings import TableSettings


@dataclass(frozen=True, eq=False)
class Found:
    """What a diagnosis of a table has come to.

    Attributes:
        compared: on each mesh.
        posterior: of all hypotheses.
        prior: what was known beforehand.
        settings: constants.
    """

    compared: tuple[Comparison, ...]
    posterior: Posterior
    prior: Prior
    settings: TableSettings

    @classmethod
    def of(cls, compared: Sequence[Comparison], prior: Prior, settings: TableSettings) -> "Found":
        """Of everything that was weighed."""
        return cls(tuple(compared), Posterior.of(compared, settings), prior, settings)

    @property
    def chosen(self) -> Entry:
        """The hypothesis that is named, if it explains something; else that nothing is missing."""
        best = self.posterior.best()
        if not best.names or self.within_scatter(best) or self.much(best):
            return best
        return self.nothing

    @property
    def nothing(self) -> Entry:
        """That nothing is missing, on the mesh on which it is likelier."""
        return next(one for one in self.posterior.entries if not one.names)

    def within_scatter(self, one: Entry) -> bool:
        """Whether what a hypothesis leaves is within the quantile of its scatter."""
        minimum, evidence = one.weighed.best, one.comparison.plates.evidence
        return minimum.chi_square <= evidence.limit(minimum.n_effective, self.settings.level)

    def much(self, one: Entry) -> bool:
        """Whether a hypothesis takes much of χ² away."""
        before = one.comparison.baseline.best.chi_square
        return one.weighed.best.chi_square <= self.settings.least_part * before

    @property
    def verdict(self) -> Verdict:
        """By what is named and what is left."""
        within = self.within_scatter(self.chosen)
        if not self.chosen.names:
            return "consistent" if within else "unexplained"
        return "explained" if within else "partly_explained"


def compared_on(found: Found, kind: str) -> Comparison | None:
    """The comparison on one kind of mesh; None where there is none."""
    return next((one for one in found.compared if one.kind == kind), None)


def same_on(compared: Comparison, key: tuple[int, ...]) -> Weighed | None:
    """The hypothesis of the same candidates on one mesh."""
    if not key:
        return compared.baseline
    return next((one for one in compared.weighed if one.hypothesis is not None and one.hypothesis.key == key), None)


def key_of(one: Entry) -> tuple[int, ...]:
    """Which effects a hypothesis has."""
    return () if one.weighed.hypothesis is None else one.weighed.hypothesis.key


def pressed_out(one: Entry) -> list[str]:
    """Searched parameters that end on a bound of their interval beyond which there would be more of the same."""
    model, minimum = one.weighed.model, one.weighed.best
    found = []
    for k, name in enumerate(model.names):
        if not bool(minimum.at_bound[k]):
            continue
        label, _, key = name.rpartition(".")
        parameter = model.effects[label].parameters[key]
        low, high = float(model.space.low[k]), float(model.space.high[k])
        at_low = float(minimum.position[k]) < 0.5
        beyond = low - 1e-3 * (high - low) if at_low else high + 1e-3 * (high - low)
        towards_neutral = at_low and parameter.neutral is not None and parameter.neutral <= low
        if beyond in parameter.allowed and not towards_neutral:
            found.append(name)
    return found
