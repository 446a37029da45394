"""A list under `measurement`: its states, what is wrong with one, a run of them, and what changed between them."""

import json

import pytest

from torchplate.cli.config import InputError
from torchplate.cli.config.build import load_run

MESH = {"length_x": 0.38, "length_y": 0.01, "n_x": 8, "n_y": 1, "edges": {"x0": "clamped"}}
PLATE = {
    "effect": "plate",
    "youngs_modulus": [1.5e11, 2.5e11],
    "poisson_ratio": 0.3,
    "density": 7850,
    "thickness": 0.005,
}
LUMP = {"effect": "point_mass", "x": 0.45, "y": 0.5, "mass": 0.008}


def states(*more: dict) -> dict:
    table = {1: 25.0, 2: 160.0, 3: 450.0}
    items = [{"name": "before", "natural_frequencies": table}, *more]
    return {"mesh": MESH, "effects": {"plate": PLATE, "lump": LUMP}, "measurement": items, "search": {"seed": 0}}


AFTER = {"name": "after", "natural_frequencies": {1: 25.3, 2: 163.0, 3: 455.0}}
# What is wrong → words that the sentence must hold.
BAD = {
    "one state": ([], ["two states or more", "got 1"]),
    "no name": ([{"natural_frequencies": {1: 25.0}}], ["measurement.2.name", "Add it"]),
    "a name twice": ([AFTER | {"name": "before"}], ["measurement.before", "'before' twice", "Rename"]),
    "a name that cannot be": ([AFTER | {"name": "a b"}], ["measurement.a b.name"]),
    "no mapping": (["after.uff"], ["measurement.2", "keys of a state", "'after.uff'"]),
    "unknown key": ([AFTER | {"bnad": [1, 2]}], ["measurement.after.bnad", "'band'?"]),
    "own of no parameter": ([AFTER | {"own": ["plate.young"]}], ["measurement.after.own", "plate.young", "searched"]),
    "own of a number": ([AFTER | {"own": ["lump.mass"]}], ["measurement.after.own", "lump.mass", "interval"]),
    "effect that is none": ([AFTER | {"effects": {"bolt": {"effect": "bolt"}}}], ["bolt"]),
}


@pytest.mark.parametrize("wrong", BAD)
def test_a_bad_list_gets_one_sentence(wrong, tmp_path):
    more, words = BAD[wrong]
    path = tmp_path / "plate.yaml"
    path.write_text(json.dumps(states(*more)))
    with pytest.raises(InputError) as told:
        assert load_run(path).states
    assert str(told.value).startswith(str(path))
    for word in words:
        assert word in str(told.value)


def test_a_state_has_its_own_effects_beside_the_common_ones(tmp_path):
    path = tmp_path / "plate.yaml"
    magnet = {"effect": "point_mass", "x": 0.9, "y": 0.5, "mass": [0.0, 0.01]}
    path.write_text(json.dumps(states(AFTER | {"effects": {"magnet": magnet}, "own": ["plate.youngs_modulus"]})))
    before, after = load_run(path).states
    assert list(before.run.config.effects) == ["plate", "lump"]
    assert list(after.run.config.effects) == ["plate", "lump", "magnet"]
    assert (before.own, after.own) == ((), ("plate.youngs_modulus", "magnet.mass"))


@pytest.mark.check
def test_a_run_of_two_states_writes_what_is_common_once(tmp_path, command):
    path = tmp_path / "plate.yaml"
    search = {"n_member": 4, "n_generation": 2, "seed": 0, "basis": "full"}
    path.write_text(json.dumps(states(AFTER | {"own": ["plate.youngs_modulus"]}) | {"search": search}))
    status, _, said = command("run", path, "--out", tmp_path / "run")
    assert (status, said) == (0, "")
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert list(result["parameters"]) == ["plate.youngs_modulus", "plate.youngs_modulus@after"]
    assert set(result["states"]) == {"before", "after"}
    assert (tmp_path / "run" / "after" / "report.html").exists()


def test_since_and_a_list_are_not_both_taken(tmp_path, command):
    path = tmp_path / "plate.yaml"
    path.write_text(json.dumps(states(AFTER)))
    status, _, said = command("diagnose", path, "--since", path, "--out", tmp_path / "out")
    assert status == 2
    assert "Leave one" in said
