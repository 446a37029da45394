"""The modules that make pages of the documentation, which lie beside it and not in the package."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def pages() -> ModuleType:
    """`docs/generate/pages.py`."""
    sys.path.insert(0, str(ROOT / "docs" / "generate"))
    try:
        return importlib.import_module("pages")
    finally:
        sys.path.pop(0)


@pytest.fixture(scope="session")
def signature(pages) -> ModuleType:
    """`docs/generate/signature.py`."""
    return sys.modules["signature"]
