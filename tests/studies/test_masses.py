"""The measured strip that loses mass: what is read of it, and what is made of a diagnosis."""

import pytest

from torchplate.measurement import read_measurement
from torchplate.studies import masses
from torchplate.studies.masses import MASS, STRIP, config, lost, peaks


@pytest.fixture
def data(request):
    folder = request.config.rootpath.parent / "shared" / "data"
    if not (folder / "masses_3a.uff").exists():
        folder = request.config.rootpath.parent.parent / "shared" / "data"
    if not (folder / "masses_3a.uff").exists():
        pytest.skip("the measurement is not part of the project")
    return folder


def test_the_peaks_are_those_that_are_known(data):
    known = {"a": (21.9, 138.4, 380.6, 738.1, 1160.6), "d": (22.5, 144.4, 402.8, 761.6, 1183.1)}
    for state, hertz in known.items():
        # To a line's spacing.
        assert peaks(read_measurement(data / f"masses_3{state}.uff")) == pytest.approx(hertz, abs=0.32)


def test_an_arrangement_is_a_config_of_four_states(data):
    said = config("10", data)
    assert [one["name"] for one in said["measurement"]] == ["a", "b", "c", "d"]
    assert [said["effects"][f"m{k}"]["x"] for k in (1, 6)] == pytest.approx([86 / 380, 288 / 380], abs=1e-5)


def test_the_mass_lost_is_what_all_changes_say_together():
    def named(name, mass, std):
        return {"name": name, "parameters": {"mass": {"value": mass * STRIP, "std": std * STRIP}}}

    found = {"verdict": "explained", "effects": [named("m2.mass", 0.01, 0.003), named("point_mass", -0.02, 0.004)]}
    row = lost("3", "b", found)
    assert row.share == pytest.approx(MASS - 0.01 + 0.02)
    assert row.std == pytest.approx(0.005)
    assert row.kind == "m2.mass + point_mass"


def test_without_its_files_nothing_is_done(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(masses, "DATA", tmp_path)
    masses.main()
    assert "Left out" in capsys.readouterr().out
