"""The table of load: what is measured is held against what it is to keep to, and a table says so."""

import argparse

import pytest

from torchplate.bench import PAGE, between
from torchplate.studies import load
from torchplate.studies.load import ENDS, FLAT, PARTS, Line, with_line

FEW = argparse.Namespace(runs=2, evaluations=300)


@pytest.mark.parametrize("name", ["evaluations", "frfs"])
def test_a_part_tells_seconds_memory_and_what_it_was_held_against(name):
    line = PARTS[name](FEW)
    assert line.seconds > 0
    assert line.peak_gib > 0.05
    assert "allowed" in line.kept
    assert isinstance(line.held, bool)


@pytest.mark.check
def test_memory_that_grows_is_not_kept_and_one_that_stays_is(monkeypatch):
    """Of four runs those after the second count."""
    monkeypatch.setattr(load, "run", lambda *_, **__: argparse.Namespace(result={"natural_frequencies_hz": [0.0] * 9}))
    for growth, held in ((2 * FLAT, False), (FLAT / 2, True)):
        levels = iter([1.0, 1.0, 1.0, 1.0 + growth])
        monkeypatch.setattr(load, "_resident", lambda levels=levels: next(levels))
        line = load.in_sequence(4)
        assert line.held is held
        assert f"{100 * growth:+.1f} %" in line.kept


def test_a_line_takes_the_place_of_what_was_measured_of_the_same_work_and_others_stay():
    page = PAGE.read_text()
    for line in (Line("1,000 sheets: flat", 9.0, 1.0, "z", True), Line("two", 3.0, 0.25, "y", False)):
        page = with_line(page, line, "abc")
    rows = between(page, ENDS).splitlines()
    page = with_line(page, Line("20 sheets: bent", 2.0, 0.5, "x", True), "def")
    assert "| two | 3 | 0.25 | y: **not kept** | abc |" in page
    now = between(page, ENDS).splitlines()
    assert now[:-2] == rows[:-2]
    assert now[-2:] == ["| 20 sheets: bent | 2 | 0.50 | x: kept | def |", "| two | 3 | 0.25 | y: **not kept** | abc |"]


def test_a_part_that_is_killed_says_by_what(monkeypatch):
    killed = argparse.Namespace(returncode=-9, stderr="scoring 60 candidates\n", stdout="")
    monkeypatch.setattr(load.subprocess, "run", lambda *_, **__: killed)
    with pytest.raises(RuntimeError, match=r"'frfs' to end with 0, got -9:\nscoring 60 candidates"):
        load.measured("frfs", FEW)
