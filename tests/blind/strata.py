"""The strata of the benchmark, by name: what each index holds, and how a case of it is drawn."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from blind import cases, real, shapes, states, tables, workshop
from blind.cases import Case, Slot


@dataclass(frozen=True)
class Stratum:
    """Kinds by index, and from a seed set, an index and the name of a truth (None: the stratum's own) to a case."""

    suite: Callable[[], tuple[Slot, ...]]
    draw: Callable[..., Case]

    def case(self, seed_set: str, index: int, by: str | None) -> Case:
        """One case."""
        given: dict[str, Any] = {} if by is None else {"by": by}
        return self.draw(seed_set, index, **given)


STRATA = {
    "clean": Stratum(cases.suite, cases.draw),
    "workshop": Stratum(workshop.suite, workshop.draw),
    "tables": Stratum(tables.suite, tables.draw),
    "real": Stratum(real.suite, real.draw),
    "shapes": Stratum(shapes.suite, shapes.draw),
    "states": Stratum(states.suite, states.draw),
}
# Those without nuisances.
PERFECT = ("clean", "real")
TRUTHS = ("ritz", "spectral")
