"""The bench of the command line's tests: a small plate, its measurement, and a short way to run configs on them."""

import importlib.util
import sys
from pathlib import Path

_FILE = Path(__file__).parent.parent / "cli" / "conftest.py"
_SPEC = importlib.util.spec_from_file_location("torchplate_cli_bench", _FILE)
assert _SPEC is not None
assert _SPEC.loader is not None
_CLI = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = _CLI
_SPEC.loader.exec_module(_CLI)

bench, command, make_config, measured = _CLI.bench, _CLI.command, _CLI.make_config, _CLI.measured
