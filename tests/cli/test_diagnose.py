"""`torchplate diagnose`: a folder that says what is missing, and a model with it."""

import json
import os
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import yaml
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchplate.cli.config.build import load_model, load_run
from torchplate.cli.config.plate_test import tolerances
from torchplate.cli.machine import device as machine
from torchplate.cli.main import main
from torchplate.cli.verbs.diagnose import _say, diagnose
from torchplate.cli.verbs.plan import plan, read_doubts
from torchplate.diagnosis.candidates import catalogue
from torchplate.effects import CATALOGUE
from torchplate.measurement import SI_UNIT, Channel, Measurement
from torchplate.model import ritz_basis
from torchplate.notation import percent
from torchplate.planning import Lab

RESPONSE, REFERENCE = (4, 7), (1, 6, 10)
LINES = torch.linspace(15.0, 300.0, 100, dtype=torch.float64)
HIDDEN = {"x": 0.31, "y": 0.68, "mass": 0.03}
SHARE = 0.01
PERFECT = ("position_std", "frequency_drift", "calibration_std", "damping_scatter")
# What the files say needs a few candidates; of which `make check` has all.
FEW = {"point_mass", "ground_spring", "stiffness_loss", "density", "viscous_damping", "sensor_gain"}
EVERY_CANDIDATE = "CHECKED_CALLS" in os.environ


def write_measurement(truth: Path, path: Path) -> None:
    """FRFs of a config's model with noise in proportion to them."""
    model = load_model(truth)
    frf = model.frf(model.known.new_zeros(0), LINES, list(RESPONSE), list(REFERENCE), "accelerance")
    generator = torch.Generator().manual_seed(21)
    white = torch.view_as_complex(torch.randn(*frf.shape, 2, generator=generator, dtype=torch.float64))
    noise = SHARE * (0.5 * (frf.abs().square() + frf.abs().square().mean(0))).sqrt() * white / 2**0.5
    Measurement(
        frequency=LINES,
        frf=frf + noise,
        measured=torch.ones(frf.shape[1:], dtype=torch.bool),
        response=tuple(map(Channel, RESPONSE)),
        reference=tuple(map(Channel, REFERENCE)),
        kind="accelerance",
        unit=SI_UNIT["accelerance"],
    ).to_npz(path)


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory, make_config) -> SimpleNamespace:
    """A mass is hidden, the mesh has twelve elements, the thickness is known to 5 µm."""
    folder = tmp_path_factory.mktemp("diagnosed")
    hidden = {"effects.hidden": {"effect": "point_mass", **HIDDEN}}
    mesh = {"mesh.n_x": 4, "mesh.n_y": 3}
    finer = {"mesh.refine": 4, "mesh.extrapolate": True, "measurement": {"band": [0.0, 400.0]}}
    truth = folder / "truth.yaml"
    truth.write_text(json.dumps(make_config(changes=mesh | hidden | finer)))
    write_measurement(truth, folder / "plate.npz")
    known = {"effects.plate.thickness": {"value": 0.0031, "std": 5e-6}, "measurement.band": [20.0, 400.0]}
    # What a test of usual imperfection may hide, and how long it takes to say so, is for tests/diagnosis.
    known |= {f"measurement.{name}": 0.0 for name in PERFECT}
    path = folder / "configs" / "plate.yaml"
    path.parent.mkdir()
    changes = known | {"measurement.file": "../plate.npz"}
    path.write_text(json.dumps(make_config(["plate.youngs_modulus"], mesh | changes)))
    out, console = folder / "runs" / "one", Console(file=StringIO(), width=200)
    with pytest.MonkeyPatch.context() as patch:
        # Figures are made and not rendered, which takes as long as the diagnosis: tests/report renders them, and so
        # does the diagnosis of a dead channel in `make check`.
        patch.setattr("torchplate.report.diagnosis.png", lambda _: b"\x89PNG\r\n\x1a\n")
        patch.setattr("torchplate.report.forms.page.svg", lambda *_: "")
        patch.setattr("torchplate.cli.progress.log.log_figures", lambda _: {})
        if not EVERY_CANDIDATE:
            patch.setattr(catalogue, "NEVER", catalogue.NEVER | (set(CATALOGUE) - FEW))
        found = diagnose(path, out, ["search.seed=3", "measurement.band=[20.0, 290.0]"], console=console)
    content = json.loads((out / "diagnosis.json").read_text())
    return SimpleNamespace(found=found, content=content, folder=out, path=path, shown=console.file.getvalue())


@pytest.mark.check
def test_a_dead_channel_is_left_out_and_every_number_that_is_written_is_one(diagnosed, tmp_path, command):
    measurement = Measurement.from_npz(diagnosed.folder.parents[1] / "plate.npz")
    measurement.frf[:, 0, 1] = 0
    measurement.to_npz(tmp_path / "plate.npz")
    content = json.loads(diagnosed.path.read_text())
    content["measurement"]["file"] = "plate.npz"
    (tmp_path / "plate.yaml").write_text(json.dumps(content))
    status, stdout, _ = command("diagnose", tmp_path / "plate.yaml", "--out", tmp_path / "out")
    assert status == 0
    assert "Left out 1 of 6 FRFs" in stdout
    assert "4w/6w" in stdout

    def no_number(word: str) -> None:
        pytest.fail(f"{word} is no number of JSON")

    for name in ("diagnosis.json", "hypotheses.json"):
        json.loads((tmp_path / "out" / name).read_text(), parse_constant=no_number)
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert "point_mass" in [effect["name"] for effect in found["effects"]]


def test_the_last_gap_of_each_table_of_the_report_is_the_final_one(diagnosed):
    """The first refit of an effect leaves more than the last model, and stands nowhere as what is left."""
    content, final = diagnosed.content, percent(diagnosed.content["gap"]["final"])
    lines = [line.strip("|").split("|") for line in (diagnosed.folder / "report.md").read_text().splitlines()]
    rows = {row[0].strip().partition("<br>")[0]: [cell.strip() for cell in row] for row in lines if len(row) > 1}
    last = content["effects"][-1]
    assert last["gap_after"] == content["gap"]["final"]
    assert rows["fitted"][2] == final
    assert rows[f"`{last['name']}`"][5] == final
    assert rows[f"+ {last['name']}"][1] == final


NUMBER = (int, float)
GAP = {"metric", "baseline", "final", "heldout_baseline", "heldout_final", "noise_floor", "expected"}


def test_diagnosis_json_is_what_the_contract_says(diagnosed):
    content = diagnosed.content
    assert content["schema"] == "torchplate.diagnosis/1"
    assert content["verdict"] in ("consistent", "explained", "partly_explained", "unexplained")
    assert content["model"] == "model.yaml"
    assert set(content["gap"]) == GAP
    assert content["gap"]["metric"] == "relative_frf_norm"
    assert all(isinstance(content["gap"][key], float) for key in GAP - {"metric"})
    for one in content["effects"]:
        assert one["name"] in CATALOGUE
        assert isinstance(one["label"], str)
        assert set(one["equivalent"]) <= set(CATALOGUE) - {one["name"]}
        assert 0 < one["confidence"] <= 1
        assert isinstance(one["evidence"], str)
        assert one["evidence"].endswith(".")
        assert isinstance(one["gap_before"], float)
        assert isinstance(one["gap_after"], float)
        for name, told in one["parameters"].items():
            assert set(told) == {"value", "std", "unit", "low", "high"}
            assert isinstance(told["value"], NUMBER)
            assert isinstance(told["std"], NUMBER)
            assert told["unit"] == CATALOGUE[one["name"]].parameters[name].unit
    assert all(len(band) == 2 and band[0] < band[1] for band in content["location"]["bands_hz"])
    assert content["location"]["bands_hz"]
    assert len(content["location"]["channels"]) == len(RESPONSE) * len(REFERENCE)
    for row in content["location"]["channels"]:
        assert set(row) == {"response", "reference", "gap"}
        assert row["response"] in {f"{node}w" for node in RESPONSE}
        assert row["reference"] in {f"{node}w" for node in REFERENCE}
        assert isinstance(row["gap"], float)
    assert all(isinstance(sentence, str) for sentence in content["next_measurements"])


def test_the_mass_is_named(diagnosed):
    content = diagnosed.content
    assert content["verdict"] == "explained"
    mesh, mass = content["effects"]
    assert mesh["name"] == "mesh_discretisation"
    assert (mass["name"], mass["equivalent"]) == ("point_mass", [])
    for name, value in HIDDEN.items():
        assert mass["parameters"][name]["value"] == pytest.approx(value, abs=0.03 if name in "xy" else 0.003)
    assert content["gap"]["final"] < 0.1 * content["gap"]["baseline"]


def test_a_plan_goes_on_from_the_hypotheses_that_are_written(diagnosed, tmp_path):
    verdict, (doubt,) = read_doubts(diagnosed.folder)
    assert verdict == "explained"
    assert (doubt.name, doubt.label) == ("point_mass", diagnosed.content["effects"][1]["label"])
    assert doubt.probability["point_mass"] > 0.95
    overrides = ["search.seed=3", "measurement.band=[20.0, 290.0]"]
    lab, console = Lab(("hammer",), n_place=1), Console(file=StringIO(), width=200)
    found = plan(diagnosed.path, tmp_path / "plan", overrides, diagnosed.folder, lab, console)
    assert "No further test is needed for the name" in console.file.getvalue()
    assert not found.needed
    # One hit more narrows something, and nothing is narrowed to nothing.
    assert 0.1 < found.proposed.narrowing < 1.0
    assert {f"{doubt.label}.{name}" for name in HIDDEN} <= set(found.proposed.gain.narrowed)


def test_model_yaml_holds_the_found_numbers_and_loads(diagnosed):
    raw = yaml.safe_load((diagnosed.folder / "model.yaml").read_text())
    model = load_model(diagnosed.folder / "model.yaml")
    assert model.names == ()
    mass = diagnosed.content["effects"][1]
    effect = raw["effects"][mass["label"]]
    assert effect == {"effect": "point_mass"} | {name: told["value"] for name, told in mass["parameters"].items()}
    for label, body in raw["effects"].items():
        numbers = {name: value for name, value in body.items() if name not in ("effect", "nodes", "extrapolate")}
        assert all(isinstance(value, NUMBER) for value in numbers.values()), (label, body)
    # What was known well has hardly moved.
    assert raw["effects"]["plate"]["thickness"] == pytest.approx(0.0031, abs=5e-5)
    assert raw["effects"]["plate"]["poisson_ratio"] == 0.31


@pytest.mark.check
def test_gaps_are_those_of_the_model_that_is_handed_over(diagnosed):
    recipe = load_run(diagnosed.folder / "model.yaml")
    measured, model = recipe.measurement(), recipe.model()
    nothing = model.known[:0]
    # In a basis of its own: all of its dofs would take minutes.
    model = model.projected(ritz_basis(model, nothing[None], measured.frequency, 0, 5.0))
    each = (model.frf(nothing, measured.frequency) - measured.frf).norm(dim=0) / measured.frf.norm(dim=0)
    heldout = diagnosed.found.overlay.heldout
    gap = diagnosed.content["gap"]
    assert float(each[~heldout].mean()) == pytest.approx(gap["final"], rel=0.05)
    assert float(each[heldout].mean()) == pytest.approx(gap["heldout_final"], rel=0.05)
    assert gap["noise_floor"] == pytest.approx(SHARE, rel=0.25)


@pytest.mark.check
def test_run_evaluates_the_model_that_is_handed_over(diagnosed, tmp_path, monkeypatch):
    monkeypatch.setattr("torchplate.report.run.png", lambda *_: b"")
    monkeypatch.setattr("torchplate.report.forms.page._picture", lambda _: "")
    assert main(["run", str(diagnosed.folder / "model.yaml"), "--out", str(tmp_path / "run")]) == 0
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    gap, n_heldout = diagnosed.content["gap"], int(diagnosed.found.overlay.heldout.sum())
    whole = ((6 - n_heldout) * gap["final"] + n_heldout * gap["heldout_final"]) / 6
    assert result["gap"] == pytest.approx(whole, rel=0.05)
    assert result["parameters"] == {}


@pytest.mark.check
def test_a_model_that_is_handed_over_is_found_consistent(diagnosed, tmp_path):
    path = diagnosed.folder / "model.yaml"
    again = diagnose(path, tmp_path / "again", report=False, console=Console(file=StringIO()))
    assert again.verdict == "consistent"
    # Its mesh is mended already.
    assert [one.name for one in again.effects] == []
    assert again.gap.final == pytest.approx(diagnosed.content["gap"]["final"], rel=0.05)


def test_overrides_are_in_the_saved_config(diagnosed):
    saved = yaml.safe_load((diagnosed.folder / "config.yaml").read_text())
    assert saved["search"]["seed"] == 3
    assert saved["measurement"]["band"] == [20.0, 290.0]
    assert (diagnosed.folder / saved["measurement"]["file"]).exists()
    assert float(diagnosed.found.overlay.measured.frequency.max()) <= 290.0


def test_the_report_and_the_log_are_there(diagnosed):
    for name in ("report.md", "report.html"):
        assert "point_mass" in (diagnosed.folder / name).read_text()
    events = EventAccumulator(str(diagnosed.folder))
    events.Reload()
    scalars = events.Tags()["scalars"]
    assert {"gap/baseline", "gap/point_mass"} <= set(scalars)
    baseline = events.Scalars("gap/baseline")
    assert [one.value for one in baseline] == pytest.approx([diagnosed.content["gap"]["baseline"]] * 2, rel=1e-5)
    # The step is the number of evaluations: a level from the first to the last.
    assert [one.step for one in baseline] == [0, diagnosed.found.n_evaluation]
    assert diagnosed.found.n_evaluation > 0


def test_the_screen_says_what_was_found_and_where_it_is(diagnosed):
    assert "explained" in diagnosed.shown
    assert "point_mass" in diagnosed.shown
    assert str(diagnosed.folder) in diagnosed.shown
    assert "noise floor" in diagnosed.shown


def test_no_name_is_broken_on_a_narrow_screen(diagnosed):
    first, *others = diagnosed.found.scores[0]
    longest = max(CATALOGUE, key=len)
    shown = replace(diagnosed.found, scores=((replace(first, name=longest), *others),))
    screen = StringIO()
    _say(Console(file=screen, width=80), shown, diagnosed.folder)
    lines = screen.getvalue().splitlines()
    for row in shown.scores[0]:
        assert any(line.split()[:1] == [row.name] for line in lines), row.name
    assert max(len(line.rstrip()) for line in lines if not line.startswith("  Results")) <= 80


def test_the_screen_has_no_drop_below_zero(diagnosed, tmp_path, monkeypatch):
    first, *others = diagnosed.found.scores[0]
    worse = replace(diagnosed.found, scores=((replace(first, name="worse", expected_drop=-7.82), *others),))
    monkeypatch.setattr("torchplate.cli.verbs.diagnose.find_missing", lambda *_, **__: worse)
    screen = StringIO()
    diagnose(diagnosed.path, tmp_path / "out", report=False, console=Console(file=screen, width=200))
    (row,) = (line for line in screen.getvalue().splitlines() if line.split()[:1] == ["worse"])
    assert row.split()[1] == "none"


class StoppedError(Exception):
    """The search for what is missing was asked for."""


@pytest.fixture
def asked(monkeypatch):
    """What the command line would look for, and how."""
    seen = SimpleNamespace()

    def remembered(model, measurement, table, **settings):
        seen.model, seen.measurement, seen.table, seen.settings = model, measurement, table, settings
        raise StoppedError

    monkeypatch.setattr("torchplate.cli.verbs.diagnose.find_missing", remembered)

    def ask(path: Path, out: Path) -> SimpleNamespace:
        with pytest.raises(StoppedError):
            diagnose(path, out, console=Console(file=StringIO()))
        return seen

    return ask


def test_what_is_known_and_how_well_is_passed_on(bench, make_config, asked):
    changes = {
        "effects.plate.thickness": {"value": 0.0031, "std": 2e-5},
        "effects.wires.stiffness": {"value": 1310.0},
        "mesh.length_x": {"value": 0.41, "std": 5e-4},
        "measurement.gain": "unknown",
        "measurement.n_average": 7,
        "search.seed": 9,
    }
    path = bench.write(make_config(["plate.youngs_modulus"], changes))
    expected = {"plate.thickness": 2e-5, "mesh.length_x": 5e-4}
    assert tolerances(load_run(path)) == expected
    seen = asked(path, bench.folder / "out")
    settings = {key: seen.settings[key] for key in ("tolerance", "n_average", "gain_is_unknown", "seed")}
    assert settings == {"tolerance": expected, "n_average": 7, "gain_is_unknown": True, "seed": 9}
    assert seen.model.names == ("plate.youngs_modulus",)
    assert seen.model.response is not None
    assert seen.measurement.frf.shape[1:] == (2, 3)
    assert seen.table is None


def test_a_table_alone_is_passed_on(bench, make_config, asked):
    table = {"measurement": {"natural_frequencies": {4: 80.0, 5: {"value": 140.0, "std": 0.2}}}}
    seen = asked(bench.write(make_config(["plate.youngs_modulus"], table)), bench.folder / "out")
    assert seen.measurement is None
    assert seen.table.mode.tolist() == [4, 5]
    assert seen.settings["tolerance"] == {}


BAD = {
    "no measurement": ({"measurement": {}}, ["measurement", "natural_frequencies"]),
    "FRFs and a table": ({"measurement.natural_frequencies": {4: 80.0}}, ["measurement:", "both", "Take one"]),
    "unknown effect": ({"effects.wires.effect": "support_sprin"}, ["effects.wires.effect", "'support_spring'?"]),
    "unknown key": ({"mesh.lenght_x": 0.4}, ["mesh.lenght_x", "Did you mean 'length_x'?"]),
    "measurement not there": ({"measurement.file": "absent.uff"}, ["measurement.file", "absent.uff"]),
    "channel that is not there": (
        {"effects.flip": {"effect": "channel_polarity", "channels": [99]}},
        ["effects", "flip", "99"],
    ),
    "mode beyond the mesh": (
        {"measurement": {"natural_frequencies": {4: 80.0, 37: 90.0}}},
        ["measurement.natural_frequencies", "36", "37"],
    ),
    "mesh beyond the plate": ({"mesh.extrapolate": "perhaps"}, ["mesh.extrapolate", "perhaps"]),
}


def refused(outcome: tuple[int, str, str], *words: str) -> None:
    status, _, stderr = outcome
    assert status == 2
    assert len(stderr.splitlines()) == 1, stderr
    for word in words:
        assert word in stderr
    assert "Error" not in stderr


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_sentence(bench, make_config, command, case):
    changes, words = BAD[case]
    path = bench.write(make_config(["plate.youngs_modulus"], changes))
    out = bench.folder / "out"
    refused(command("diagnose", path, "--out", out), "plate.yaml", *words)
    assert not out.exists()


def test_another_device_is_said_to_bring_a_diagnosis_nothing(monkeypatch, capsys):
    monkeypatch.setattr(machine, "device_named", lambda _: torch.device("meta"))
    machine.on_cpu_alone("cuda", "A diagnosis", Console())
    assert "A diagnosis computes on the CPU" in capsys.readouterr().out
    monkeypatch.setattr(machine, "device_named", torch.device)
    machine.on_cpu_alone("cpu", "A diagnosis", Console())
    assert not capsys.readouterr().out


def test_a_bad_override_a_device_and_a_file_for_a_folder_are_refused(bench, make_config, command):
    path = bench.write(make_config(["plate.youngs_modulus"]))
    refused(
        command("diagnose", path, "--set", "mesh.refin=2", "--out", bench.folder / "out"), "mesh.refin", "'refine'?"
    )
    refused(command("diagnose", path, "--device", "abacus", "--out", bench.folder / "out"), "--device abacus")
    refused(command("diagnose", path, "--out", path), "--out", "plate.yaml", "folder")
    refused(command("diagnose", bench.folder / "none.yaml"), "none.yaml", "Expected a config file")


def test_a_defect_is_not_taken_for_bad_input(bench, make_config, monkeypatch):
    def broken(*_, **__) -> None:
        raise ValueError("a defect")

    monkeypatch.setattr("torchplate.diagnosis.flow.noise_level", broken)
    path = bench.write(make_config(["plate.youngs_modulus"]))
    with pytest.raises(ValueError, match=r"^a defect$"):
        main(["diagnose", str(path), "--out", str(bench.folder / "out")])
