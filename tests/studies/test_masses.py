"""The measured strip that loses mass: what is read of it, and what is made of a diagnosis."""

import pytest

from torchplate.measurement import read_measurement
from torchplate.studies import masses
from torchplate.studies.masses import MASS, STRIP, Lost, config, lost, order, peaks


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
        parameters = {"mass": {"value": mass * STRIP, "std": std * STRIP}}
        return {"name": name, "equivalent": [], "parameters": parameters}

    found = {"verdict": "explained", "effects": [named("m2.mass", 0.01, 0.003), named("point_mass", -0.02, 0.004)]}
    row = lost("3", "b", found)
    assert row.share == pytest.approx(MASS - 0.01 + 0.02)
    assert row.std == pytest.approx(0.005)
    assert row.kind == "m2.mass; point_mass"


def test_a_stiffness_that_is_named_instead_of_a_mass_is_shown_with_its_equivalents():
    one = {"name": "stiffness_loss", "equivalent": ["point_mass"], "parameters": {"factor": {"value": 1.3, "std": 0.1}}}
    row = lost("10", "b", {"verdict": "explained", "effects": [one]})
    assert row.share is None
    assert row.kind == "stiffness_loss or point_mass"


@pytest.mark.parametrize(
    ("shares", "said"),
    [
        ((0.02, 0.03, 0.05), "a < b < c < d: in order"),
        ((0.02, 0.05, 0.04), "a < b < c < d: out of order"),
        ((-0.01, 0.02, 0.04), "a < b < c < d: out of order"),
        ((None, 0.02, 0.04), "no mass is named in b; the others are in order"),
    ],
)
def test_the_order_of_the_states_is_said(shares, said):
    rows = [Lost("10", state, share, 0.001, "") for state, share in zip("bcd", shares, strict=True)]
    assert order(rows) == f"arrangement 10: {said}"


def test_without_its_files_nothing_is_done(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(masses, "DATA", tmp_path)
    masses.main()
    assert "Left out" in capsys.readouterr().out
