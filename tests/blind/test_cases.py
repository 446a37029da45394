"""The suite is the same for ever, holds what it says, and its files are what torchplate reads."""

from collections import Counter

import numpy as np
import pytest
import torch

from blind import real, shapes
from blind.cases import NOISE, draw, effects_of_suite, suite
from blind.strata import STRATA
from torchplate.cli.config.build import load_run
from torchplate.effects import CATALOGUE

# The truth of a benchmark that only `make blind` runs.
pytestmark = pytest.mark.check


def index_of(kind: str, turn: int = 0) -> int:
    return [i for i, slot in enumerate(suite()) if slot.kind == kind][turn]


def test_the_suite_holds_what_it_says():
    kinds = Counter(slot.kind for slot in suite())
    assert kinds == {"none": 24, "beyond": 16, "two": 24, "one": 96}
    alone = Counter(slot.names[0] for slot in suite() if slot.kind == "one")
    # A field of thickness is no candidate where the section may wander.
    assert set(alone) | set(real.ALONE) | set(shapes.NAMES) == set(CATALOGUE) - {"plate", "thickness_field", "field"}
    assert min(alone.values()) >= 4
    assert min(Counter(effects_of_suite()).values()) >= 5


def test_every_effect_of_the_catalogue_is_hidden_alone_in_some_stratum():
    every = {name for one in STRATA.values() for slot in one.suite() if slot.kind == "one" for name in slot.names}
    # Nobody asks for the name of a thickness that wanders: every test has it.
    assert set(CATALOGUE) - every <= {"plate", "thickness_field", "field"}


def test_a_case_is_the_same_whenever_it_is_drawn():
    index = index_of("two")
    first, again, other = draw("A", index), draw("A", index), draw("B", index)
    assert first.record() == again.record()
    assert torch.equal(first.measurement.frf, again.measurement.frf)
    assert first.record()["noise"] != other.record()["noise"]


@pytest.mark.parametrize("turn", range(2))
def test_nothing_is_missing_where_nothing_is_hidden(tmp_path, turn):
    """The files as torchplate reads them, its model on a finer mesh at the true values, and what is left: the noise."""
    case = draw("test", index_of("none", turn))
    specimen = case.specimen
    case.write(tmp_path)
    # What comes with a std is set to what is so.
    real = {
        "mesh.length_x": specimen.plate.length_x, "mesh.length_y": specimen.plate.length_y,
        "effects.plate.density": specimen.plate.density, "effects.plate.thickness": specimen.plate.thickness,
        "mesh.refine": 2,
    }  # fmt: skip
    run = load_run(tmp_path / "config.yaml", [f"{key}={value!r}" for key, value in real.items()])
    measurement = run.measurement().band(5.0, 60.0)
    model = run.model()
    truth = {
        "plate.youngs_modulus": specimen.plate.young, "wires.stiffness": specimen.stiffness,
        "wires.viscous_damping": specimen.viscous, "loss.stiffness_loss_factor": specimen.damping.beta,
    }  # fmt: skip
    theta = torch.tensor([[truth[name] for name in model.names]], dtype=torch.float64)
    found = model.frf(theta, measurement.frequency)[0].numpy()
    left = np.linalg.norm(found - measurement.frf.numpy(), axis=0) / np.linalg.norm(measurement.frf, axis=0)
    # Twenty elements leave an error of 2e-4 in the frequencies below 60 Hz: up to a tenth of a peak's width. Noise that
    # is flat over the whole band is larger in this part of it.
    assert left.mean() < 0.1 + 8 * case.noise
    assert NOISE[0] <= case.noise <= NOISE[1]


def test_coherence_says_how_large_the_noise_is():
    for turn in range(24):
        case = draw("A", index_of("none", turn))
        if case.measurement.coherence is not None:
            break
    n_average = case.config["measurement"]["n_average"]
    gamma = case.measurement.coherence
    variance = case.measurement.frf.abs() ** 2 * (1 - gamma) / ((n_average - 1) * gamma)
    said = variance.sum(0).sqrt() / case.measurement.frf.abs().square().sum(0).sqrt()
    # The mean of thousands of gamma variables.
    assert float(said.mean()) == pytest.approx(case.noise, rel=0.1)
