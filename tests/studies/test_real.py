"""Measured plates, diagnosed: what is cheap enough for a test; the rest is `make real`."""

import math
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
@pytest.mark.proof
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
@pytest.mark.parametrize("name", ["wood_A", "wood_B"])
def test_the_grain_of_wood_of_unknown_species_is_named(name, console, tmp_path):
    found = examine(case(name), console, tmp_path, report=False)
    assert found.diagnosis.verdict == "explained"
    assert [(one.name, one.equivalent) for one in found.diagnosis.effects] == [("orthotropy", ())]
    # The grain lies along x: the first mode is that of a strip of E_x, by Euler and Bernoulli, but for the air.
    e, _ = value_of(found.diagnosis, "youngs_modulus")
    ratio, _ = value_of(found.diagnosis, "young_ratio")
    length, thickness, density = {"wood_A": (0.223, 3e-3, 473.9), "wood_B": (0.212, 4.5e-3, 457.0)}[name]
    hertz = case(name).peaks[0]
    strip = 12 * density * (2 * math.pi * hertz * length**2 / 3.516 / thickness) ** 2
    assert 1.0 < e / ratio**0.5 / strip < 1.15
    assert ratio < 0.1


@pytest.mark.check
@pytest.mark.proof
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
