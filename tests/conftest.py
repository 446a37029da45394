"""Where the tensors of a test live, and how often the shapes of a function's arguments are checked."""

import dataclasses
import functools
import gc
import os
from collections import Counter
from collections.abc import Callable
from types import FunctionType
from typing import Any

import jaxtyping
import pytest
import torch

NO_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no CUDA device")

# Whether a file outlives a power cut no test can see, and a busy disk lets each wait for it.
os.fsync = lambda _: None  # type: ignore[assignment]

# Shapes and types are checked at the first calls of each function: to check thousands that are alike takes half
# of the time of all tests. `make check` checks three in each test; else it is one in each file of tests.
IN_EACH_TEST = os.environ.get("CHECKED_CALLS")
FIRST_CALLS = int(IN_EACH_TEST or 1)

_every_call = jaxtyping.jaxtyped
_n_call: Counter[int] = Counter()
_counted_in = ""


def at_first_calls(target: Any = None, *, typechecker: Callable) -> Any:
    """`jaxtyping.jaxtyped` as its import hook writes it before each function and class."""
    if target is None:
        return functools.partial(at_first_calls, typechecker=typechecker)
    if dataclasses.is_dataclass(target) and not hasattr(target.__init__, "__wrapped__"):
        target.__init__ = at_first_calls(target.__init__, typechecker=typechecker)
        return target
    if not isinstance(target, FunctionType):
        return target if isinstance(target, type) else _every_call(target, typechecker=typechecker)
    key, checked = id(target.__code__), None

    @functools.wraps(target)
    def call(*args: Any, **options: Any) -> Any:
        nonlocal checked
        if _n_call[key] >= FIRST_CALLS:
            return target(*args, **options)
        _n_call[key] += 1
        checked = checked or _every_call(target, typechecker=typechecker)
        return checked(*args, **options)

    return call


# Before any module of the package is imported: the hook looks the name up in each of them.
jaxtyping.jaxtyped = at_first_calls


def pytest_collection_finish() -> None:
    """What is there before the first test stays to the end: the garbage collector need not go through it again."""
    gc.collect()
    gc.freeze()
    # Figures and graphs make many objects that are freed without it: a tenth of the time of all tests.
    gc.set_threshold(50_000, 20, 100)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Each test, or each file of tests, begins to count anew."""
    global _counted_in
    where = item.nodeid if IN_EACH_TEST else str(item.path)
    if where != _counted_in:
        _n_call.clear()
        _counted_in = where


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=NO_GPU)])
def device(request: pytest.FixtureRequest) -> torch.device:
    """Each kind of device in turn."""
    return torch.device(request.param)


@pytest.fixture
def collect() -> Callable[[], object]:
    """Collects what the test itself has left: all that was there before takes half a second to go through."""
    gc.collect()
    gc.freeze()
    return gc.collect
