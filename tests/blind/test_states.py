"""The stratum of states: what it holds, what a pair shares, and what counts as right."""

import json
import re
from collections import Counter

import pytest
import torch

from blind.states import CHANGES, draw, judged, report, suite


def test_forty_pairs_ten_of_them_unchanged():
    count = Counter(slot.names[0] if slot.names else "nothing" for slot in suite())
    assert count == {"nothing": 10, **CHANGES}
    assert sum(count.values()) == 40


def test_an_unchanged_pair_differs_by_its_test_alone():
    pair = draw("test", next(index for index, slot in enumerate(suite()) if not slot.names))
    assert not pair.truth
    assert pair.reference["effects"] == pair.config["effects"]
    assert pair.reference["mesh"] == pair.config["mesh"]
    one, other = pair.before.frf, pair.measurement.frf
    off = float((one - other).norm() / one.norm())
    # Hits are off their marks by millimetres, and there is noise; the plate is the same.
    assert 1e-3 < off < 0.5
    assert torch.equal(pair.before.frequency, pair.measurement.frequency)


def record(hidden, verdict, *answers):
    effects = [{"name": name, "equivalent": list(others)} for name, *others in answers]
    truth = {"hidden": [{"effect": hidden}] if hidden else []}
    return {"truth": truth, "diagnosis": {"verdict": verdict, "effects": effects}}


@pytest.mark.parametrize(
    ("hidden", "answers", "right"),
    [
        (None, [], (True, True)),
        (None, [("point_mass",)], (False, False)),
        ("point_mass", [], (False, False)),
        ("point_mass", [("point_mass", "absorber")], (True, True)),
        ("point_mass", [("stiffness_loss",)], (True, False)),
        ("point_mass", [("point_mass", "thickness")], (True, False)),
        ("wires.stiffness", [("support_asymmetry", "wires.stiffness")], (True, True)),
        ("wires.stiffness", [("wires.stiffness",), ("point_mass",)], (True, False)),
    ],
)
def test_what_is_right(hidden, answers, right):
    assert judged(record(hidden, "explained" if answers else "consistent", *answers)) == right


def test_a_change_without_a_name_is_a_change():
    """An unchanged pair of which it is said is wrong; of a changed one the name alone is."""
    assert judged(record(None, "unexplained")) == (False, False)
    assert judged(record("point_mass", "unexplained")) == (True, False)


def test_the_report_counts_what_was_right_and_lists_what_was_wrong(tmp_path):
    records = [
        record(None, "consistent"),
        record(None, "explained", ("stiffness_loss",)),
        record("point_mass", "explained", ("point_mass",)),
        record("wires.stiffness", "consistent"),
    ]
    for number, one in enumerate(records):
        one["truth"]["name"], one["seconds"] = f"{number:03d}", 10.0
    # A place that holds, and a mass that does not.
    records[2]["truth"]["hidden"][0]["parameters"] = {"x": 0.3, "mass": 0.02}
    found = {"x": {"value": 0.31, "low": 0.29, "high": 0.33}, "mass": {"value": 0.03, "low": 0.025, "high": 0.035}}
    records[2]["diagnosis"]["effects"][0]["parameters"] = found
    (tmp_path / "results.jsonl").write_text("\n".join(json.dumps(one) for one in records))
    report(tmp_path)
    table = (tmp_path / "table.md").read_text()
    counts = re.findall(r"^\| ([^|]+?) \| (\d+) \| (\d+) \|", table, flags=re.MULTILINE)
    assert [(int(n), int(of)) for _, n, of in counts] == [(2, 4), (1, 2), (1, 2), (1, 2), (0, 4)]
    assert re.findall(r"^- (\d+)", table, flags=re.MULTILINE) == ["001", "003"]
