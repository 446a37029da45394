"""What effects that are known to be there take off the gap of a measured plate."""

import math

import pytest
import torch

from torchplate.cli.config import dump
from torchplate.cli.config.build import load_run
from torchplate.measurement import Channel, Measurement
from torchplate.studies import gaps as study
from torchplate.studies.gaps import STEPS, config, steps

# E_x, E_y, G_xy [GPa] of a plate that is no plate of the study.
TRUE = (11.0, 1.1, 0.7)


@pytest.fixture
def raw(request):
    return load_run(request.config.rootpath / "configs" / "real" / "spruce_3R.yaml").raw


def test_each_step_adds_what_is_known_to_be_there_and_nothing_else(raw, tmp_path):
    seen = []
    for n_step in range(len(STEPS)):
        path = tmp_path / f"{n_step}.yaml"
        path.write_text(dump(config(raw, n_step)))
        seen.append(load_run(path).config.effects)
    assert [len(one) for one in seen] == [2, 3, 4, 5, 5, 6]
    assert [one["loss"]["effect"] for one in seen] == ["hysteretic_damping"] * 4 + ["directional_damping"] * 2
    # 2 cm off both sides of 579.4 × 217.6 mm.
    assert seen[-1]["sensor"]["y"] == pytest.approx(1 - 20 / 217.6, abs=1e-5)
    # Together the terms scatter as much as the calliper's readings do.
    every = [value["std"] for value in seen[-1]["calliper"].values() if isinstance(value, dict)]
    assert math.hypot(*every) == pytest.approx(0.13 / 5, rel=0.01)
    assert all("value" in value for value in seen[-1]["calliper"].values() if isinstance(value, dict))


@pytest.mark.check
def test_the_grain_takes_off_the_gap_what_it_is(raw, tmp_path, monkeypatch):
    """And where the measurement is no part of the project, nothing is done."""
    e, shear = (TRUE[0] * TRUE[1]) ** 0.5, 2.2 * TRUE[2] / (TRUE[0] * TRUE[1]) ** 0.5
    raw["mesh"] |= {"n_x": 10, "n_y": 6}
    raw["measurement"] = {"file": "plate.npz", "band": [20.0, 320.0], "gain": "unknown"}
    (tmp_path / "spruce_3R.yaml").write_text(dump(raw))
    monkeypatch.setattr(study, "CONFIGS", tmp_path)
    monkeypatch.setattr(study, "OUT", tmp_path)
    monkeypatch.setattr(study, "STEPS", STEPS[:2])
    assert steps("3R") is None
    truth = config(raw, 1)
    del truth["measurement"]
    truth["effects"]["plate"] |= {"youngs_modulus": 1e9 * e, "density": 412.4, "thickness": 0.00487}
    truth["effects"]["loss"]["stiffness_loss_factor"] = 0.015
    truth["effects"]["grain"] |= {"young_ratio": TRUE[1] / TRUE[0], "shear_factor": shear}
    truth["mesh"] |= {"length_x": 0.5794, "length_y": 0.2176, "n_x": 30, "n_y": 18}
    (tmp_path / "truth.yaml").write_text(dump(truth))
    lines = torch.arange(20.0, 320.0, 1.0, dtype=torch.float64)
    places = [(0.0345, 0.092), (0.9655, 0.908)]
    model = load_run(tmp_path / "truth.yaml").model()
    nothing = torch.zeros(0, dtype=torch.float64)
    frf = model.frf(nothing, lines, response=[places[1]], reference=[places[0]])
    generator = torch.Generator().manual_seed(1)
    noise = torch.complex(*torch.randn(2, *frf.shape, generator=generator, dtype=torch.float64))
    ends = [Channel(k, "w", (x * 0.5794, y * 0.2176, 0.0)) for k, (x, y) in enumerate(places, 1)]
    measured = Measurement(
        lines, frf * (1 + 0.01 * noise), torch.ones(1, 1, dtype=torch.bool), (ends[1],), (ends[0],), "receptance", "m/N"
    )
    measured.to_npz(tmp_path / "plate.npz")
    found = steps("3R")
    assert found is not None
    isotropic, grain = found
    assert isotropic.gap > 0.6
    # The noise, and what the model as such is allowed to leave.
    assert grain.gap < 0.1
    assert grain.moduli == pytest.approx(TRUE, rel=0.02)
