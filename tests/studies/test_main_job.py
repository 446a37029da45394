"""`make run`: two searches of each problem side by side, and what comes of it where one of them fails."""

import subprocess
import sys
from pathlib import Path

import pytest

from torchplate.studies import main_job


@pytest.fixture
def job(monkeypatch):
    """The job with everything that takes long told instead; the colony's process says what it is given to, and ends."""
    told: list[tuple] = []
    own = subprocess.Popen

    def arrange(status: int) -> list[tuple]:
        def colony(words: list[str], **settings):
            told.append(("colony", *words[3:]))
            return own([sys.executable, "-c", f"print('the [colony]'); raise SystemExit({status})"], **settings)

        monkeypatch.setattr(main_job.subprocess, "Popen", colony)
        for name in ("simulate", "run", "compare"):
            monkeypatch.setattr(main_job, name, lambda *given, name=name, **_: told.append((name, *given)))
        return told

    return arrange


def test_both_searches_of_each_problem_are_run_and_compared(job, capsys):
    told = job(0)
    assert main_job.main() == 0
    for name in ("steel_plate", "measured_frequencies"):
        config, folders = (
            Path("configs") / f"{name}.yaml",
            [Path("runs") / name / one for one in (main_job.DE, main_job.ABC)],
        )
        at = told.index(("run", config, folders[0]))
        assert told[at - 1][:5] == ("colony", "run", str(config), "--out", str(folders[1]))
        assert told[at + 1] == ("compare", folders)
    assert capsys.readouterr().out.count("the [colony]") == 2


def test_a_colony_that_fails_ends_the_job_with_its_status(job):
    told = job(2)
    assert main_job.main() == 2
    assert [one[0] for one in told] == ["simulate", "colony", "run"]
