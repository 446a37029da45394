"""Medians of ways that take turns, what the machine can do, and the memory that was needed."""

import resource
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import torch

# A turn lasts at least so long [s]: short ways run again and again in it, as they do in a search.
TURN = 0.1


def interleaved(ways: Mapping[str, Callable[[], Any]], n_repeat: int = 5) -> dict[str, float]:
    """Median seconds of each way; they take turns, so that a slow spell of the machine hits all alike."""
    times: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(n_repeat + 1):
        for name, way in ways.items():
            count, began = 0, time.perf_counter()
            while not count or time.perf_counter() - began < TURN:
                way()
                count += 1
            # The first turn warms up.
            if turn:
                times[name].append((time.perf_counter() - began) / count)
    return {name: statistics.median(values) for name, values in times.items()}


def seconds(way: Callable[[], Any], n_repeat: int = 5) -> float:
    """Median seconds of one way."""
    return interleaved({"way": way}, n_repeat)["way"]


def rates() -> dict[str, float]:
    """What the machine does at its best, with the threads it has: 10⁹ operations a second of real matrix products."""
    large = torch.rand(1500, 1500, dtype=torch.float64)
    wide = torch.rand(50, 30, dtype=torch.float64), torch.rand(30, 16000, dtype=torch.float64)
    return {
        "matmul 1500 x 1500 x 1500 [GFLOP/s]": 2e-9 * 1500**3 / seconds(lambda: large @ large),
        "matmul 50 x 30 x 16000 [GFLOP/s]": 2e-9 * 50 * 30 * 16000 / seconds(lambda: wide[0] @ wide[1], 30),
    }


def peak_memory() -> float:
    """The most memory this process has held [GiB]."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**30
