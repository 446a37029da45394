"""The real stratum: what measured plates carry beside what the clean suite hides, in a perfect test.

Each effect at least five times alone, and as many cases with nothing hidden as of one effect twice over.
"""

from functools import cache

import numpy as np

from blind.cases import Case, Slot, draw_slot, seed_of

ALONE = ("roving_mass", "air_loading", "directional_damping", "frequency_dependent_loss")
PAIRS: tuple[tuple[str, str], ...] = (
    ("air_loading", "roving_mass"), ("directional_damping", "point_mass"), ("frequency_dependent_loss", "air_loading"),
)  # fmt: skip
N_TIMES, N_NOTHING = 6, 10


@cache
def suite() -> tuple[Slot, ...]:
    """All slots, mixed."""
    slots = [Slot("none", (), turn) for turn in range(N_NOTHING)]
    slots += [Slot("two", pair, N_TIMES + index) for index, pair in enumerate(PAIRS)]
    slots += [Slot("one", (name,), turn) for name in ALONE for turn in range(N_TIMES)]
    order = np.random.default_rng(202).permutation(len(slots))
    return tuple(slots[index] for index in order)


def draw(seed_set: str, index: int, by: str | None = None) -> Case:
    """One case: the same for ever for a seed set, an index and a suite.

    Args:
        seed_set: any word.
        index: of the suite.
        by: which truth; left out, each makes every other case.
    """
    rng = np.random.default_rng([*seed_of(seed_set, index), 2])
    return draw_slot(suite()[index], rng, index, by or ("spectral" if index % 2 else "ritz"), "real")
