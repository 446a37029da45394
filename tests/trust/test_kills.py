"""Nothing is lost by `kill -9`: a sample here, and more on request.

TORCHPLATE_KILLS=50 python -m pytest tests/trust/test_kills.py -m check -s
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DRIVER = Path(__file__).parent / "killing.py"
KILLS = int(os.environ.get("TORCHPLATE_KILLS", "3"))


def killed(*arguments: object) -> None:
    # A process of its own: a child that is forked while torch's threads are at work may hang.
    ended = subprocess.run(
        [sys.executable, str(DRIVER), *map(str, arguments)], capture_output=True, text=True, check=False
    )
    print(ended.stdout)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    kills, commands, same = map(int, re.search(r"(\d+) kills of (\d+) commands: (\d+) ended", ended.stdout).groups())
    assert kills >= int(arguments[arguments.index("--kills") + 1])
    assert same == commands


@pytest.mark.check
def test_a_run_that_is_killed_ends_as_the_undisturbed_one():
    killed("--verb", "run", "--kills", 1, "--generations", 6)


@pytest.mark.check
def test_a_run_that_is_killed_often_ends_as_the_undisturbed_one():
    killed("--verb", "run", "--kills", KILLS)


@pytest.mark.check
def test_a_diagnosis_that_is_killed_ends_as_the_undisturbed_one():
    killed("--verb", "diagnose", "--kills", KILLS)
