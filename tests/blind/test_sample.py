"""A short stratified sample of the blind benchmark: twelve cases of set A, made by another discretisation.

The whole suite is `make blind`. The cases are the quicker ones, and only the lower part of the band is used; all kinds
are there: nothing hidden, the structure, what holds it, its damping, the sensor chain, two effects, and one beyond the
catalogue.
"""

import json
from pathlib import Path

import pytest

from blind.score import verdict
from blind.suite import run_case
from torchplate.cli.diagnose import diagnose

# Case → what is hidden in it.
SAMPLE = {
    60: "nothing",
    134: "nothing",
    113: "mesh_discretisation",
    13: "orthotropy",
    76: "nothing",
    102: "density",
    25: "channel_polarity",
    147: "time_delay",
    124: "hysteretic_damping",
    123: "thickness_taper",
    107: "ground_spring and exponential_window",
    63: "a clipped channel, beyond the catalogue",
}
BAND = "measurement.band=[5.0, 150.0]"


def in_the_lower_band(config: Path, out: Path) -> None:
    diagnose(config, out, [BAND], report=False)


@pytest.mark.parametrize("index", SAMPLE, ids=[f"{index}-{name}" for index, name in SAMPLE.items()])
def test_what_is_hidden_is_named(index, tmp_path):
    found = run_case("A", index, tmp_path, in_the_lower_band)
    assert found["diagnosis"], found.get("error")
    assert verdict(found).right, json.dumps(found["diagnosis"]["effects"], indent=1)
