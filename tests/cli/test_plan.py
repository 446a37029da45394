"""`torchplate plan`: what to measure next, and a config that says it."""

import json
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import yaml
from rich.console import Console

from torchplate.cli.config.build import load_model, load_run
from torchplate.cli.folder.opening import HYPOTHESES, relocated
from torchplate.cli.main import main
from torchplate.cli.verbs.plan import plan, read_doubts
from torchplate.diagnosis.rivals import Doubt, Rival
from torchplate.effects import CATALOGUE
from torchplate.measurement import SI_UNIT, Channel, Measurement
from torchplate.model import Searched
from torchplate.planning import Lab

# Without wires a heavier plate is a sensor that reads too little, E taking the factor up.
FACTOR = 1.07
RESPONSE, REFERENCE = (4, 7), (1, 6, 10)
LAB = Lab(("sensor", "mass"), masses=(0.08,), n_place=1)


def write_measurement(truth: Path, path: Path) -> None:
    """FRFs of a config's model with a noise of one per cent."""
    model, lines = load_model(truth), torch.linspace(60.0, 400.0, 90, dtype=torch.float64)
    frf = model.frf(model.known.new_zeros(0), lines, list(RESPONSE), list(REFERENCE), "accelerance")
    noise = torch.randn(*frf.shape, 2, generator=torch.Generator().manual_seed(8), dtype=torch.float64)
    Measurement(
        lines,
        frf + 0.007 * frf.abs() * torch.view_as_complex(noise),
        torch.ones(frf.shape[1:], dtype=torch.bool),
        tuple(map(Channel, RESPONSE)),
        tuple(map(Channel, REFERENCE)),
        "accelerance",
        SI_UNIT["accelerance"],
    ).to_npz(path)


def doubt_of(recipe) -> Doubt:
    """What a diagnosis would leave open, were it as sure of the parameters as this."""
    model = recipe.model_as_given()
    values = {"plate.youngs_modulus": 2.04e11, "loss.stiffness_loss_factor": 6.2e-3}
    found = []
    for name, key, young, value, ends in (
        ("density", "value", 1.0, FACTOR * 7700.0, Searched(6000.0, 9500.0)),
        ("sensor_gain", "gain", 1 / FACTOR, 1 / FACTOR, Searched(0.5, 2.0)),
    ):
        own = values | {"plate.youngs_modulus": young * 2.04e11, f"{name}_1.{key}": value}
        whole = model.replaced(
            effects={**model.effects, f"{name}_1": CATALOGUE[name]()},
            searched=model.searched | {f"{name}_1.{key}": ends},
        )
        position = whole.space.to_cube(torch.tensor([own[one] for one in whole.names], dtype=torch.float64))
        precision = torch.diag(torch.full((len(position),), 1e5, dtype=torch.float64))
        probability = 0.55 if name == "density" else 0.4
        found.append(
            Rival(
                name,
                f"{name}_1",
                probability,
                whole.effects,
                whole.known_values,
                whole.searched,
                position,
                precision,
            )
        )
    return Doubt("density_1", tuple(found), 1.0, 1.0, True, 0.01)


def write_diagnosis(recipe, folder: Path, doubts, verdict="explained") -> None:
    """What a plan reads of a diagnosis's folder."""
    folder.mkdir(parents=True)
    raw = relocated(recipe, folder)
    (folder / "config.yaml").write_text(yaml.safe_dump(raw))
    (folder / "diagnosis.json").write_text(json.dumps({"verdict": verdict}))
    told = {"schema": "torchplate.hypotheses/1", "doubts": [one.to_dict() for one in doubts]}
    (folder / HYPOTHESES).write_text(json.dumps(told))


@pytest.fixture(scope="module")
def planned(tmp_path_factory, make_config) -> SimpleNamespace:
    """A plan of a plate that is diagnosed already."""
    folder = tmp_path_factory.mktemp("planned")
    free = {"effects.wires": ..., "measurement.band": [60.0, 400.0]}
    truth, path = folder / "truth.yaml", folder / "plate.yaml"
    heavier = {"effects.wires": ..., "effects.plate.density": FACTOR * 7700.0, "measurement": {}}
    truth.write_text(json.dumps(make_config(changes=heavier)))
    write_measurement(truth, folder / "plate.npz")
    path.write_text(json.dumps(make_config(["plate.youngs_modulus", "loss.stiffness_loss_factor"], free)))
    recipe = load_run(path)
    write_diagnosis(recipe, folder / "runs" / "plate" / "one", [doubt_of(recipe)])
    console = Console(file=StringIO(), width=200)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        found = plan(path, lab=LAB, console=console)
    where = folder / "runs" / "plate" / "one"
    return SimpleNamespace(found=found, folder=where, path=path, shown=console.file.getvalue(), home=folder)


def test_the_latest_diagnosis_of_the_config_is_taken_and_what_parts_its_names_is_proposed(planned):
    assert "density (0.58) or sensor_gain (0.42)" in planned.shown
    content = json.loads((planned.folder / "plan.json").read_text())
    assert content["schema"] == "torchplate.plan/1"
    assert (content["needed"], content["label"], content["config"]) == (True, "density_1", "plan.yaml")
    first = content["proposed"]
    assert (first["kind"], first["parts"]) == ("mass", "density | sensor_gain")
    assert first["probability"] > 0.95
    assert first["probability"] <= min(first["linear"], first["confirmed"])
    assert {one["kind"] for one in content["tests"]} == {"sensor", "mass"}
    assert "mass of 80 g" in planned.shown


def test_the_config_it_writes_holds_both_states_and_says_what_to_do(planned):
    text = (planned.folder / "plan.yaml").read_text()
    raw, before = yaml.safe_load(text), yaml.safe_load(planned.path.read_text())
    measured, proposed = raw["measurement"]
    assert measured["name"] == "measured"
    assert (planned.folder / measured["file"]).resolve() == (planned.home / "plate.npz").resolve()
    assert (proposed["name"], proposed["file"]) == ("proposed", "TO BE MEASURED.uff")
    assert proposed["band"] == measured["band"] == [60.0, 400.0]
    mass = proposed["effects"]["added_mass"]
    assert mass["effect"] == "point_mass"
    assert mass["mass"] == {"value": 0.08, "std": pytest.approx(1.6e-4)}
    # What was diagnosed stays as it was given: the joint diagnosis asks again.
    assert {key: raw[key] for key in ("mesh", "effects")} == {key: before[key] for key in ("mesh", "effects")}
    comments = " ".join(line.removeprefix("# ") for line in text.splitlines() if line.startswith("#"))
    assert "stick it on firmly with its middle at node" in comments
    assert "density (0.58) or sensor_gain (0.42)" in comments


def test_hypotheses_come_back_from_their_file_as_they_were(planned):
    recipe = load_run(planned.path)
    verdict, (back,) = read_doubts(planned.folder)
    there = doubt_of(recipe)
    assert verdict == "explained"
    assert back.probability == pytest.approx(there.probability)
    for one, other in zip(back.rivals, there.rivals, strict=True):
        assert torch.equal(one.position, other.position)
        assert torch.equal(one.precision, other.precision)
        given = recipe.model_as_given()
        models = [rival.model(given) for rival in (one, other)]
        assert models[0].names == models[1].names
        assert models[0].known_values == models[1].known_values


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "Expected a folder without results, got one that holds plan.json"),
        (["--from", "nowhere"], "--from nowhere: Expected the folder of a diagnosis, got one without diagnosis.json"),
        (["--from", "another", "--out", "other"], "got one of another mesh, model or measurement"),
        (["--masses", "-0.1", "--out", "other"], "masses above 0 kg, got -0.1"),
        (["--from", "unexplained", "--out", "other"], "one that no effect of the catalogue explains"),
        (["--from", "table", "--out", "other"], "Expected FRFs for a plan"),
        (["--from", "broken", "--out", "other"], "as `torchplate diagnose` writes them, got others"),
    ],
)
def test_what_cannot_be_planned_is_said_in_a_sentence(planned, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(planned.home)
    recipe = load_run(planned.path)
    for name, doubts in (("unexplained", [doubt_of(recipe)]), ("table", []), ("broken", [])):
        if not Path(name).exists():
            write_diagnosis(recipe, Path(name), doubts, name)
    if not Path("another").exists():
        write_diagnosis(load_run(planned.path, ["mesh.n_x=4"]), Path("another"), [])
    (Path("broken") / HYPOTHESES).write_text('{"doubts": [{"label": "x"}]}')
    assert main(["plan", str(planned.path), *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_config_that_changed_since_is_diagnosed_anew(planned, monkeypatch):
    monkeypatch.chdir(planned.home)
    asked = []

    def diagnosed(config, folder, *others, **more):
        asked.append(folder)
        write_diagnosis(load_run(config, others[0]), folder, [], "consistent")

    monkeypatch.setattr("torchplate.cli.verbs.plan.diagnose", diagnosed)
    # Without hypotheses it ends there.
    with pytest.raises(ValueError, match="Expected FRFs for a plan"):
        plan(planned.path, overrides=["mesh.n_x=4"], console=Console(file=StringIO()))
    assert len(asked) == 1
    assert asked[0] != planned.folder
