"""The study of the measured strip by band: what it takes for granted of the strip's model, and what it fits."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from torchplate.cli.config.build import load_run
from torchplate.effects import CATALOGUE, Field
from torchplate.model import PlateModel
from torchplate.plate import Mesh

# A study under tests is no module of a package: it is read from beside this file.
_SPEC = importlib.util.spec_from_file_location("strip_by_band", Path(__file__).with_name("strip_by_band.py"))
study = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(study)


@pytest.fixture
def strip(request):
    """The config's strip on a coarse mesh, of these numbers, and with what else is handed over."""
    recipe = load_run(request.config.rootpath / "configs" / "real" / f"{study.STRIP}.yaml")

    def model(thickness=2e-3, mass=1.7e-3, loss=1e-2, **more):
        raw = recipe.raw["effects"]
        effects = {label: CATALOGUE[body["effect"]]() for label, body in raw.items()}
        known = {
            f"{label}.{key}": one["value"] if isinstance(one, dict) else one
            for label, body in raw.items()
            for key, one in body.items()
            if key != "effect" and not (isinstance(one, dict) and "low" in one)
        }
        known |= {"plate.thickness": thickness, "sensor.mass": mass, "loss.stiffness_loss_factor": loss}
        mesh = Mesh(0.0999, 0.02, 6, 2, edges={"x0": "clamped"})
        return PlateModel(mesh, effects | more, known, {}, [(0.96, 0.775)], kind="transmissibility")

    return model


def test_what_each_peak_has_of_its_own_is_a_number_of_the_config(request):
    effects = load_run(request.config.rootpath / "configs" / "real" / f"{study.STRIP}.yaml").raw["effects"]
    for name in study.FREE:
        label, _, key = name.rpartition(".")
        assert key in effects[label]


def test_the_field_without_a_name_and_the_numbers_beside_it_are_left_out(strip):
    beside = strip(2.1e-3, field=Field("mass", 2, 2, (0.1, 0.2, 0.3, 0.4)))
    told = {"plate.thickness": SimpleNamespace(value=1.9e-3)}
    model = study.named(SimpleNamespace(model=beside, parameters=told))
    assert "field" not in model.effects
    assert model.known_values == strip(1.9e-3).known_values


@pytest.mark.parametrize(("low", "high"), study.PEAKS)
@pytest.mark.check
def test_a_peak_of_a_linear_resonance_leaves_nothing(strip, low, high):
    frequency = torch.linspace(low, high, 150, dtype=torch.float64)
    none = torch.zeros(0, dtype=torch.float64)
    measured = strip(2.03e-3, 2.4e-3, 6e-3).frf(none, frequency)[:, 0, 0]
    with torch.no_grad():
        own, left = study.alone(strip(), measured, frequency)
    # Least squares stop where a step changes the squares by less than 1e-8 of them.
    assert float(left.norm() / measured.norm()) < 1e-4
    assert own == pytest.approx(
        {"plate.thickness": 2.03e-3, "sensor.mass": 2.4e-3, "loss.stiffness_loss_factor": 6e-3}, rel=0.02
    )
