"""Mutation testing tries again what survived, and that alone."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("mutating.py")


@pytest.fixture
def mutating(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    spec = importlib.util.spec_from_file_location("mutating", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "mutating", module)
    spec.loader.exec_module(module)
    return module


def test_two_faults_of_one_key_are_told_apart_when_survivors_are_tried_again(mutating, monkeypatch, tmp_path):
    """`2 * x + 2 * y` has two numbers that are alike: one was killed, the other is asked for again."""
    twins = [mutating.Mutant("plate/mesh.py", "Mesh.area", 7, at, at + 1, "2", "3") for at in (100, 120)]
    other = mutating.Mutant("plate/mesh.py", "Mesh.area", 9, 140, 141, "a < b", "a <= b")
    assert twins[0].key == twins[1].key != other.key
    asked = []

    class Driver:
        def __init__(self, folder):
            pass

        def calls(self):
            return {}

        def outcome(self, mutant, *_):
            asked.append(mutant)
            return "tests/plate/test_mesh.py::test_area"

    monkeypatch.setattr(mutating, "every", lambda: [*twins, other])
    monkeypatch.setattr(mutating, "sample", lambda found, *_: found)
    monkeypatch.setattr(mutating, "Driver", Driver)
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    for survivor in (0, 1):
        asked.clear()
        by = ["a test", "a test", ""]
        by[survivor] = ""
        kept = [{"key": one.key, "by": told} for one, told in zip([*twins, other], by, strict=True)]
        before.write_text(json.dumps({"seconds": 60.0, "results": kept}))
        monkeypatch.setattr(sys, "argv", ["mutating.py", "--again", str(before), "--results", str(after)])
        assert mutating.main() == 0
        assert asked == [twins[survivor], other]
        found = json.loads(after.read_text())
        assert [bool(one["by"]) for one in found["results"]] == [True, True, True]
        assert found["results"][1 - survivor]["by"] == "a test"
        assert found["seconds"] == pytest.approx(60.0, abs=10.0)
