"""Every effect of the catalogue in a YAML file, and what is said where one cannot be had."""

import copy
import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from torchplate.cli.config import InputError
from torchplate.cli.config.build import load_model
from torchplate.effects import CATALOGUE

NONE = torch.zeros(0, dtype=torch.float64)
LINES = torch.tensor([40.0, 170.0], dtype=torch.float64)
# Supports and channels are those that the examples of the effects speak of.
BASE: dict[str, Any] = {
    "mesh": {"length_x": 0.41, "length_y": 0.29, "n_x": 5, "n_y": 4},
    "measurement": {"response": [3, [0.6, 0.7]], "reference": [8, 5]},
    "effects": {
        "plate": {
            "effect": "plate",
            "youngs_modulus": 7e10,
            "poisson_ratio": 0.31,
            "density": 2700.0,
            "thickness": 0.0031,
        },
        "wires": {"effect": "support_spring", "at": [[0.21, 0.0], [0.66, 0.94]], "stiffness": 900.0},
        "loss": {"effect": "hysteretic_damping", "stiffness_loss_factor": 0.01},
        # Some effects change what only a plate with a grain has.
        "grain": {"effect": "orthotropy", "young_ratio": 0.6, "shear_factor": 1.2},
    },
}


def _write(folder: Path, effects: dict[str, Any]) -> Path:
    config = copy.deepcopy(BASE)
    config["effects"] |= effects
    path = folder / "plate.yaml"
    path.write_text(yaml.safe_dump(config))
    return path


@pytest.mark.check
@pytest.mark.parametrize("name", [name for name in CATALOGUE if name != "plate"])
def test_every_effect_can_be_written_and_searched(tmp_path, name):
    spec = importlib.util.spec_from_file_location("examples", Path(__file__).parents[1] / "effects" / "conftest.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    options, values = module.EXAMPLES[name]
    # Tuples as the lists that they are in a file.
    written = {"effect": name, **json.loads(json.dumps(options))}
    model = load_model(_write(tmp_path, {"added": written | values}))
    bare = load_model(_write(tmp_path, {}))
    # Seen at all; what each effect does is tested where it lives.
    assert not torch.allclose(model.frf(NONE, LINES), bare.frf(NONE, LINES), rtol=1e-4, atol=0.0)
    intervals = {key: sorted((0.9 * number, 1.1 * number)) for key, number in values.items()}
    assert load_model(_write(tmp_path, {"added": written | intervals})).names == tuple(f"added.{key}" for key in values)


def test_channels_may_be_written_in_every_way(tmp_path):
    ways = [[3, 8], 5, [None, 8], [[0.6, 0.7], None]]
    model = load_model(_write(tmp_path, {"added": {"effect": "channel_polarity", "channels": ways}}))
    bare = load_model(_write(tmp_path, {}))
    # Between them they name every FRF, some of them twice.
    assert torch.allclose(model.frf(NONE, LINES), -bare.frf(NONE, LINES), rtol=1e-12)


WRONG = {
    "channel that is no list": ({"effect": "channel_polarity", "channels": 3}, ["effects.added.channels", "list", "3"]),
    "channel of three": ({"effect": "channel_polarity", "channels": [[3, 8, 5]]}, ["effects.added.channels"]),
    "channel off the grid": (
        {"effect": "channel_polarity", "channels": [[3, 99]]},
        ["effects", "added", "1 to 30", "99"],
    ),
    "no channel": ({"effect": "channel_polarity"}, ["effects.added", "channels", "[[3, 28]]"]),
    "misspelt option": ({"effect": "channel_swap", "chanels": [3, 8]}, ["effects.added.chanels", "'channels'?"]),
    "one channel to exchange": ({"effect": "channel_swap", "channels": [3]}, ["effects.added", "two channels", "1"]),
    "unknown edge": ({"effect": "edge_spring", "edge": "left"}, ["effects.added", "x0, x1, y0, y1", "left"]),
    "no edge": ({"effect": "edge_spring"}, ["effects.added", "x0, x1, y0, y1"]),
    "sensor off the grid": ({"effect": "sensor_position", "response": 99}, ["effects", "added", "1 to 30", "99"]),
    "no support there": (
        {"effect": "support_asymmetry", "nodes": [2], "factor_1": 1.5},
        ["effects", "added", "[2]", "support_spring"],
    ),
    "a factor too many": (
        {"effect": "support_asymmetry", "at": [[0.21, 0.0], [0.66, 0.94]], "factor_3": 1.5},
        ["effects.added.factor_3", "factor_1, factor_2"],
    ),
    "a mesh no finer": ({"effect": "mesh_discretisation", "refine": 1}, ["effects.added", "at least 2", "1"]),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_had_is_told_with_file_and_key(tmp_path, case):
    written, parts = WRONG[case]
    path = _write(tmp_path, {"added": written})
    with pytest.raises(InputError) as told:
        load_model(path)
    for part in [str(path), *parts]:
        assert part in str(told.value)


@pytest.mark.parametrize("searched", [(), ("wires.stiffness",)])
def test_half_an_exchange_is_told_before_a_run(bench, make_config, command, searched):
    # The measurement's responses are nodes 4 and 7: see tests/cli/conftest.py.
    changes = {"effects.swap": {"effect": "channel_swap", "channels": [4, 5]}}
    path = bench.write(make_config(searched, changes))
    status, _, told = command("run", path)
    assert status == 2
    assert "effects: swap: Expected two channels of one kind" in told
