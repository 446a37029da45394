"""What the tests know and the pages tell: their examples, their tables, the published values they hold."""

import functools
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

TESTS = Path(__file__).parents[2] / "tests"


@functools.cache
def module_of_tests(file: str) -> ModuleType:
    """A module of the tests, by its path there; importing it runs no test."""
    spec = importlib.util.spec_from_file_location(f"of_tests_{Path(file).stem}", TESTS / file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # A dataclass looks its own module up.
    sys.modules[module.__name__] = module
    spec.loader.exec_module(module)
    return module
