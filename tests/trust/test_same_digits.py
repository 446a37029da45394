"""A diagnosis makes the same descents, to the last bit, whatever memory, order and threads its process is given."""

import ast
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import torchplate

FOLDER = Path(__file__).parent
ALONE = """
import pathlib, sys
import killing
killing.DIAGNOSED = killing.WHOLE
# Of two effects a diagnosis judges the first again: more descents, of more kinds.
killing.HIDDEN["gain"] = {"effect": "sensor_gain", "gain": 1.2}
killing.without_rendering()
killing.Killing(sys.argv[1], pathlib.Path(sys.argv[2]), 0, 15)
"""
# glibc fills what is allocated and freed with these bytes; blocks of any size come from the heap, where they were
# others before. Sets of words have another order. Elsewhere than with glibc only the last differs.
OTHERWISE = {"MALLOC_PERTURB_": "165", "MALLOC_MMAP_THRESHOLD_": str(2**30), "PYTHONHASHSEED": "77"}
# Of torch and of SciPy's OpenBLAS.
ONE_THREAD, TWO_THREADS = ({"OMP_NUM_THREADS": n, "OPENBLAS_NUM_THREADS": n} for n in ("1", "2"))


@pytest.fixture(scope="module")
def digests():
    spec = importlib.util.spec_from_file_location("torchplate_digests", FOLDER / "digests.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_where_two_diagnoses_part_is_told(digests, tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    one.write_text("a b 1.0\nc d 2.0\n")
    for text, words in (
        ("a b 1.0\nc e 2.5\n", "end elsewhere from one start at descent 1: c d 2.0 against c e 2.5"),
        ("f b 1.0\nc d 2.0\n", "start elsewhere at descent 0"),
        ("a b 1.0\n", "share their first 1 descents; one made 2, the other 1"),
    ):
        other.write_text(text)
        assert words in digests.parted(one, other)


def test_each_descent_leaves_a_line_of_its_own(digests, tmp_path, monkeypatch):
    from torchplate.search import Descent, Recall, recall, recalled, recalling

    monkeypatch.setattr(recall.Recall, "next", Recall.next)
    digests.written_to(tmp_path / "trail")
    start = torch.tensor([[0.25, 0.5]], dtype=torch.float64)
    with recalling(Recall([], lambda _: None)):
        for end in (0.5, 0.5 + 2**-52):
            value = torch.tensor([end], dtype=torch.float64)
            recalled(start, lambda value=value: Descent(start, start * value, value, 3))
    first, second = (line.split() for line in (tmp_path / "trail").read_text().splitlines())
    assert first[0] == second[0]
    # The last bit shows.
    assert first[1] != second[1]


def test_least_squares_are_solved_by_singular_values():
    """LAPACK's gelsy, which is meant elsewhere, takes pivots that torch leaves as memory held them (its issue 187411).

    Two diagnoses of one test then began elsewhere by a last bit, and ended elsewhere by far more.
    """
    found = []
    for path in sorted(Path(torchplate.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "torch.linalg.lstsq":
                found.append((path.name, {one.arg: ast.unparse(one.value) for one in node.keywords}))
    assert found
    assert [name for name, options in found if options.get("driver") != "'gelsd'"] == []


def alone(verb: str, folder: Path, others: dict[str, str]) -> None:
    """A whole command, in a process with an environment of its own."""
    folder.mkdir()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(FOLDER), os.environ.get("PYTHONPATH", "")])} | others
    command = [sys.executable, "-c", ALONE, verb, str(folder)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.check
def test_a_diagnosis_hangs_on_nothing_that_a_process_happens_to_have(tmp_path):
    trails = []
    for name, others in (("one", {"PYTHONHASHSEED": "1"} | ONE_THREAD), ("other", OTHERWISE | TWO_THREADS)):
        alone("diagnose", tmp_path / name, others)
        trails.append((tmp_path / name / "whole_differential_evolution.descents").read_text().splitlines())
    assert len(trails[0]) > 50
    assert trails[0] == trails[1]


@pytest.mark.check
def test_a_run_says_the_same_digits_on_one_thread_and_on_two(tmp_path):
    """Sums of a whole generation are made in another order: the last of sixteen digits, and none that is printed."""
    for name, others in (("one", ONE_THREAD), ("two", TWO_THREADS)):
        alone("run", tmp_path / name, others)
    for search in ("differential_evolution", "artificial_bee_colony"):
        one, two = (tmp_path / name / f"whole_{search}" for name in ("one", "two"))
        tables = [
            [line for line in (folder / "report.md").read_text().splitlines() if line.startswith("|")]
            for folder in (one, two)
        ]
        assert len(tables[0]) > 5
        assert tables[0] == tables[1]
        values = [json.loads((folder / "result.json").read_text())["parameters"] for folder in (one, two)]
        for label, found in values[0].items():
            assert values[1][label]["value"] == pytest.approx(found["value"], rel=1e-12)
