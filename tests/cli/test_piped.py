"""What is piped is not cut into lines: whoever looks for a sentence with grep finds it whole."""

import ast
from pathlib import Path

import pytest

import torchplate.cli
from torchplate.cli.progress.console import UNBROKEN, speaking
from torchplate.measurement import Measurement, write_uff


@pytest.fixture
def piped(command, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    return command


@pytest.mark.check
def test_no_verb_speaks_but_where_its_lines_stay_whole():
    """A console of rich's own cuts at 80 letters where it is piped."""
    made = {
        path.name
        for path in Path(torchplate.cli.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Console"
    }
    assert made == {"console.py"}


def test_a_terminal_keeps_its_width_and_columns_count_everywhere(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert speaking().width == UNBROKEN
    monkeypatch.setenv("COLUMNS", "70")
    assert speaking().width == 70
    monkeypatch.delenv("COLUMNS")
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich's word for a terminal
    assert speaking().width < UNBROKEN


def test_sentences_of_run_stand_in_one_line_each(bench, make_config, piped):
    bench.measure(gain=-1.0)
    text = piped("run", bench.write(make_config()), "--out", bench.folder / "out")[1]
    (sign,) = [line for line in text.splitlines() if "sign of all FRFs" in line]
    assert sign.endswith("or turn the sign in the export.")
    (fit,) = [line for line in text.splitlines() if "explains nothing" in line]
    assert fit.endswith("and run again.")


def test_sentences_of_inspect_stand_in_one_line_each(bench, piped):
    frfs = Measurement.from_npz(bench.folder / "plate.npz")
    write_uff(frfs, bench.folder / "plate.uff")
    text = piped("inspect", bench.folder / "plate.uff", "--out", bench.folder / "figure")[1]
    assert any(f"torchplate new {bench.folder / 'plate.uff'}" in line for line in text.splitlines())
    assert any(len(line) > 80 for line in text.splitlines())


@pytest.mark.parametrize("words", [("effects",), ("keys", "mesh")])
def test_what_verbs_tell_of_effects_and_keys_stands_in_one_line_each(words, piped):
    lines = piped(*words)[1].splitlines()
    assert max(map(len, lines)) > 80
    # Nothing is filled up to the length of a line that has none.
    assert max(map(len, lines)) < 1000
