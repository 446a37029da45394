"""What a plan ends with: every test with what it is expected to bring, and the one that is proposed."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torchplate.diagnosis import Doubt
from torchplate.planning.gain import Gain
from torchplate.planning.proposal import Proposal

SCHEMA = "torchplate.plan/1"
# A name that is as probable needs no further test; a test that makes it so, on the mean, is enough [-].
SURE = 0.95
# What is less probable after a test is not said, on the mean [-].
SAID = 0.05


@dataclass(frozen=True)
class Scored:
    """One test.

    Attributes:
        proposal: what is done.
        gain: what it is expected to bring, all that is not known taken for small.
        confirmed: expected probability of the right name where nothing is; None where that was not asked.
    """

    proposal: Proposal
    gain: Gain
    confirmed: float | None = None

    @property
    def probability(self) -> float:
        """Expected, of the right name: the smaller of what both ways say."""
        return self.gain.probability if self.confirmed is None else min(self.confirmed, self.gain.probability)

    @property
    def narrowing(self) -> float:
        """Standard deviations of the parameters after the test over those before, on the geometric mean."""
        ratios = [max(ratio, 1e-300) for ratio in self.gain.narrowed.values()]
        return math.exp(sum(map(math.log, ratios)) / len(ratios)) if ratios else 1.0

    @property
    def says(self) -> str:
        """What would be said, in a few words: the names that it parts, and those that it leaves together."""
        groups: list[set[str]] = []
        for name, told in self.gain.said.items():
            joined = {name} | {other for other, probability in told.items() if probability > SAID}
            apart = [one for one in groups if not one & joined]
            groups = [*apart, joined.union(*(one for one in groups if one & joined))]
        return " | ".join(" or ".join(sorted(one)) for one in groups)

    def to_dict(self) -> dict[str, Any]:
        """As `plan.json` has it."""
        return {
            "test": self.proposal.title,
            "kind": self.proposal.can,
            "cost": self.proposal.cost,
            "probability": self.probability,
            "linear": self.gain.probability,
            "confirmed": self.confirmed,
            "bits": self.gain.bits,
            "parts": self.says,
            "said": {name: dict(told) for name, told in self.gain.said.items()},
            "narrowed": dict(self.gain.narrowed),
        }


@dataclass(frozen=True, eq=False)
class Plan:
    """What to do next.

    Attributes:
        doubt: what the diagnosis left open.
        needed: whether a further test is needed for the name.
        scored: every test, the one to make first.
        seconds: it took.
    """

    doubt: Doubt
    needed: bool
    scored: tuple[Scored, ...]
    seconds: float = 0.0

    @property
    def proposed(self) -> Scored:
        """The cheapest test that tells, on the mean; else the one that tells most.

        Where none is needed for the name, the one that narrows the parameters most.
        """
        return self.scored[0]

    @property
    def sure(self) -> float:
        """From when on a name counts as told."""
        return SURE

    @property
    def before(self) -> Mapping[str, float]:
        """Probabilities of the names."""
        return self.doubt.probability

    def after(self, seconds: float) -> "Plan":
        """The same, and how long it took."""
        return dataclasses.replace(self, seconds=seconds)

    def to_dict(self) -> dict[str, Any]:
        """The content of `plan.json`, but for the name of the config's file."""
        return {
            "schema": SCHEMA,
            "needed": self.needed,
            "label": self.doubt.label,
            "before": dict(self.before),
            "proposed": self.proposed.to_dict() | {"instruction": self.proposed.proposal.instruction},
            "tests": [one.to_dict() for one in self.scored],
            "seconds": self.seconds,
        }
