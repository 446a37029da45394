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
from torchplate.cli.verbs.diagnose import diagnose

# Case → what is hidden in it.
SAMPLE = {
    69: "nothing",
    85: "nothing",
    86: "mesh_discretisation",
    82: "orthotropy",
    102: "density",
    99: "stiffness_loss",
    110: "point_mass",
    15: "ground_dashpot",
    75: "exponential_window",
    4: "channel_polarity",
    47: "support_spring and channel_polarity",
    63: "a clipped channel, beyond the catalogue",
}
# What takes longest of them runs in `make proofs`.
LONG = (47, 85, 102)
BAND = "measurement.band=[5.0, 150.0]"


def in_the_lower_band(config: Path, out: Path) -> None:
    diagnose(config, out, [BAND], report=False)


# `make test` names a hidden mass in tests/cli/test_diagnose.py.
@pytest.mark.check
@pytest.mark.parametrize(
    "index",
    [
        pytest.param(index, id=f"{index}-{name}", marks=[pytest.mark.proof] if index in LONG else [])
        for index, name in SAMPLE.items()
    ],
)
def test_what_is_hidden_is_named(index, tmp_path):
    found = run_case("A", index, tmp_path, in_the_lower_band)
    assert found["diagnosis"], found.get("error")
    assert verdict(found).right, json.dumps(found["diagnosis"]["effects"], indent=1)
