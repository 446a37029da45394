"""Rows of the verification page that were written by long commands say what those wrote."""

import json
from pathlib import Path

import pytest

from torchplate.bench.recorded import air, blind, speed

TABLE = """Cases 3 to 9, at commit abc1234, on a machine with other work on it.

### workshop: rates

| what | n | of | rate | 90 % interval |
| --- | --- | --- | --- | --- |
| one effect, named right (of the detectable) | 4 | 5 | 80 % | 44 to 95 % |
|   a twin named as if sure | 1 | 5 | 20 % | 0 to 35 % |
| 90 % intervals of right names hold the truth | 8 | 10 | 80 % | 39 to 80 % |
| crashes | 0 | 11 | 0 % | 0 to 20 % |

### errors and times

| what | n | median | worst |
| --- | --- | --- | --- |
| seconds | 16 | 58.74 s | 124.73 s |
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "blind" / "workshop" / "Y").mkdir(parents=True)
    (tmp_path / "blind" / "workshop" / "Y" / "table.md").write_text(TABLE)
    return tmp_path / "blind"


def test_every_rate_of_a_blind_set_is_held_against_what_is_wanted(folder: Path) -> None:
    source = "`runs/blind/workshop/Y/table.md`, abc1234"
    assert [row.cells() for row in blind(folder)] == [
        f"| workshop: one effect, named right (of the detectable) | {source} | 5 of 5 | 4 of 5 | −1 of 5 |",
        f"| workshop: a twin named as if sure | {source} | 0 of 5 | 1 of 5 | +1 of 5 |",
        f"| workshop: 90 % intervals of right names hold the truth | {source} | 9 of 10 | 8 of 10 | −1 of 10 |",
        f"| workshop: crashes | {source} | 0 of 11 | 0 of 11 | none |",
    ]


def test_a_table_whose_cases_were_run_at_two_commits_says_both(folder: Path) -> None:
    path = folder / "workshop" / "Y" / "table.md"
    path.write_text(TABLE.replace("at commit abc1234", "0 to 5 at commit abc1234 and 6 to 10 at commit def5678"))
    assert all(", abc1234 and def5678 |" in row.cells() for row in blind(folder))


def test_times_are_held_against_scipy_at_its_best(tmp_path: Path) -> None:
    seconds = {"1": (2.0, 0.1), "2": (5.0, 0.05)}
    found = {
        n: {"rows": [{"name": "SciPy", "seconds": theirs}, {"name": "torchplate", "seconds": ours}]}
        for n, (theirs, ours) in seconds.items()
    }
    path = tmp_path / "bench.json"
    path.write_text(json.dumps({"generation": found, "identification": found}))
    rows = [row.cells() for row in speed(path)]
    assert rows[:2] == [
        "| one generation: torchplate, 1 thread | SciPy, 1 thread | 2 s | 0.1 s | 20 × as fast |",
        "| one generation: torchplate, 2 threads | SciPy, 1 thread | 2 s | 0.05 s | 40 × as fast |",
    ]
    assert len(rows) == 4


def test_what_lies_in_runs_is_read() -> None:
    assert {row.case.split(":")[0] for row in blind()} >= {"clean", "tables", "workshop"}
    assert all(0 <= row.ours <= row.of for row in blind())
    assert all(row.value > row.ours for row in speed() if "shared modes" in row.case)


def test_what_the_air_costs_is_held_against_its_limits(tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    told = {"prepared_s": {"square": 1.5, "1 to 10": 0.04}, "search": {"shared modes": 1.03}}
    path.write_text(json.dumps({"air": {"1": told}}))
    ends = [row.cells().split("|")[3:6] for row in air(path)]
    assert [[cell.strip() for cell in row] for row in ends] == [
        ["at most 1 s", "1.5 s", "above"],
        ["at most 1 s", "0.04 s", "within"],
        ["at most 1.1 times", "1.03 times", "within"],
    ]


def test_the_air_costs_no_more_than_it_may() -> None:
    assert all(row.ours <= row.value for row in air())
