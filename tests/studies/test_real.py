"""Measured plates, diagnosed: what is cheap enough for a test; the rest is `make real`."""

from io import StringIO

import pytest
from rich.console import Console

from torchplate.studies import real
from torchplate.studies.real import CASES, examine, show, value_of


@pytest.fixture
def console():
    return Console(file=StringIO(), width=200)


@pytest.fixture(autouse=True)
def configs(monkeypatch, request):
    monkeypatch.setattr(real, "CONFIGS", request.config.rootpath / "configs" / "real")


def case(name):
    return next(one for one in CASES if one.name == name)


def test_every_case_has_a_config():
    configs = sorted(path.stem for path in real.CONFIGS.glob("*.yaml"))
    assert sorted(one.name for one in CASES) == configs


@pytest.mark.check
def test_nothing_is_missing_from_the_strip_that_its_peaks_show(console, tmp_path):
    found = examine(case("free_strip_peaks"), console, tmp_path, report=False)
    assert found.diagnosis.verdict == "consistent"
    assert found.diagnosis.effects == ()
    modulus, _ = value_of(found.diagnosis, "youngs_modulus")
    # ρ = 1000 kg/m³ and h = 10 mm are set.
    assert 0.01 * (modulus / 1000.0) ** 0.5 == pytest.approx(14.85, rel=0.01)
    assert found.worst < 0.01
    show([found], console)
    assert "consistent" in console.file.getvalue()


@pytest.mark.check
def test_frfs_whose_phases_say_nothing_are_not_explained(console, tmp_path):
    found = examine(case("free_strip"), console, tmp_path, ["measurement.band=[25, 60]", "mesh.n_x=40"], report=False)
    if found is None:
        pytest.skip("the measurement is not part of the project")
    assert found.diagnosis.verdict in ("unexplained", "partly_explained")
    assert all(effect.confidence < 0.6 for effect in found.diagnosis.effects)
    assert any("both ways round" in sentence for sentence in found.diagnosis.remarks)


def test_a_case_without_its_measurement_is_left_out(console, tmp_path):
    assert examine(case("cantilever"), console, tmp_path, ["measurement.file=nowhere.uff"]) is None
    assert "left out" in console.file.getvalue()
    assert not list(tmp_path.iterdir())
