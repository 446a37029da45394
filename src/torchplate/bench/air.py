"""What the air around a plate costs: to prepare its mass once for a geometry, and in each generation of a search."""

import statistics
import time
from collections.abc import Callable
from typing import Any

import torch

from torchplate.bench.problem import LINES, members, paper_model
from torchplate.effects import AirLoading
from torchplate.model import PlateModel, reduce
from torchplate.plate import Mesh, dragged

# Sides [m]: the paper's plate, a spruce plate, and a strip ten times as long as wide.
SIDES = {"square": (0.48, 0.48), "1 to 2.7": (0.58, 0.214), "1 to 10": (1.0, 0.1)}
AIR = 1.2  # kg/m³


@torch.no_grad()
def air(n_repeat: int = 15) -> dict[str, Any]:
    """CPU seconds of this process: other work on the machine does not count.

    `prepared_s`: the mass of the air by geometry, from nothing; it is kept, so that a process sees that once. `search`:
    one generation with the air over the same without it, in shared modes and in a reduced basis.
    """
    prepared = {}
    for name, sides in SIDES.items():
        began = time.process_time()
        dragged(Mesh(*sides, 20, 20))
        prepared[name] = time.process_time() - began
    search = {}
    for way, bent in (("shared modes", False), ("reduced basis", True)):
        plain = paper_model(bent=bent)
        loaded = plain.replaced(
            effects=plain.effects | {"air": AirLoading()}, known=plain.known_values | {"air.density": AIR}
        )
        search[way] = _ratio(_generation(loaded), _generation(plain), n_repeat)
    return {"prepared_s": prepared, "search": search}


def _generation(model: PlateModel) -> Callable[[], object]:
    found = reduce(model, LINES)
    assert found is not None
    theta = members(model)
    return lambda: found[0].frf(theta, LINES)


def _ratio(one: Callable[[], object], other: Callable[[], object], n_repeat: int) -> float:
    """Median of the CPU seconds of one over those of the other, turn by turn."""
    ratios = []
    for turn in range(n_repeat + 1):
        taken = []
        for way in (one, other):
            began = time.process_time()
            for _ in range(10):
                way()
            taken.append(time.process_time() - began)
        # The first turn warms up.
        if turn:
            ratios.append(taken[0] / taken[1])
    return statistics.median(ratios)
