"""`modes` estimates a modal model; `run` and `diagnose` take one; what cannot be used is said in one sentence."""

import json
from dataclasses import replace
from io import StringIO

import pytest
import torch
from rich.console import Console

from torchplate.cli.config.build import load_model, load_run
from torchplate.measurement import Channel, Measurement, ModalModel, read_modal_model, write_modal_model
from torchplate.model import modes_at

NODES = list(range(1, 13))
# A mesh that has enough modes for few points; damping that leaves them apart.
FREE = {"effects.wires": ..., "measurement": {}, "mesh.n_x": 6, "mesh.n_y": 4}


def modal(path, order=(5, 3, 4, 6, 7, 8)) -> ModalModel:
    """Modes of the plate that a config describes, in any order."""
    model = load_model(path)
    nodes = list(range(1, 36, 2))
    true = modes_at(model, model.known.new_zeros(0), model.mesh.places(nodes), 12)
    unknown = torch.full((len(order),), torch.nan, dtype=torch.float64)
    points = tuple(Channel(node) for node in nodes)
    return ModalModel(true.frequency[list(order)], unknown, true.shape[list(order)], points)


@pytest.fixture
def modes_file(bench, make_config):
    """A table of the true plate's modes beside a config, by its changes."""

    def write(name="modes.csv", changes=None, order=(5, 3, 4, 6, 7, 8)):
        config = make_config(changes=FREE | (changes or {}))
        for key in ("wires.stiffness", "wires.viscous_damping"):
            config["effects"].pop(key.split(".")[0], None)
        write_modal_model(modal(bench.write(config, "truth.yaml"), order), bench.folder / name)
        return config

    return write


def interval(config, measurement=None, **search):
    config["effects"]["plate"]["youngs_modulus"] = [1.5e11, 2.6e11]
    config["measurement"] = {"modal_model": {"file": "modes.csv"}} if measurement is None else measurement
    config["search"] |= search
    return config


@pytest.mark.check
@pytest.mark.usefixtures("drawn")
def test_run_takes_a_modal_model_and_shows_its_pairs(bench, modes_file, command):
    path = bench.write(interval(modes_file(), n_generation=8))
    status, text, error = command("run", path, "--out", bench.folder / "out")
    assert (status, error) == (0, "")
    assert "6 modes with shapes at 18 points" in text
    assert "Matched 18 points of the mode shapes to the plate by node number" in text
    result = json.loads((bench.folder / "out" / "result.json").read_text())
    assert result["objective_kind"] == "modal_model"
    assert [pair["mode"] for pair in result["modes"]] == [6, 4, 5, 7, 8, 9]
    assert min(pair["mac"] for pair in result["modes"]) > 0.999
    # Twelve members and eight generations bring E to about a percent; the search itself is tested elsewhere.
    assert result["parameters"]["plate.youngs_modulus"]["value"] == pytest.approx(2.04e11, rel=0.02)
    told = (bench.folder / "out" / "report.md").read_text()
    for words in ("MAC of the 6 measured modes", "AutoMAC of the measured modes", "COMAC of 18 points"):
        assert words in told
    assert {path.name for path in (bench.folder / "out").glob("*ac.png")} == {"mac.png", "comac.png", "fdac.png"}


def test_a_modal_model_counts_beside_frfs(bench, make_config, modes_file):
    modes_file()
    plain = load_run(bench.write(make_config(changes={"mesh.n_x": 6, "mesh.n_y": 4})))
    path = make_config(changes={"mesh.n_x": 6, "mesh.n_y": 4, "measurement.modal_model": {"file": "modes.csv"}})
    recipe = load_run(bench.write(path, "both.yaml"))
    theta = torch.zeros(0, dtype=torch.float64)
    model = recipe.model()
    whole, frfs = recipe.objective(model), plain.objective(plain.model())
    modes = recipe.modal_evidence(model)
    assert float(whole(theta)) == pytest.approx(float(frfs(theta) + modes.error(model, theta)))
    assert float(whole.gap(theta)) == pytest.approx(float(frfs.gap(theta)))


def test_the_run_folder_finds_the_modal_model_again(bench, modes_file, command):
    path = bench.write(modes_file() | {"measurement": {"modal_model": {"file": "modes.csv"}}})
    assert command("run", path, "--out", bench.folder / "deep" / "out")[0] == 0
    again = load_run(bench.folder / "deep" / "out" / "config.yaml")
    assert again.modal_model is not None


def test_band_frame_and_nodes_hold_for_a_modal_model(bench, modes_file, make_config):
    config = modes_file()
    found = read_modal_model(bench.folder / "modes.csv")
    mesh = load_model(bench.write(config, "truth.yaml")).mesh
    places = mesh.places([one.node for one in found.point]) * torch.tensor([410.0, 290.0], dtype=torch.float64)
    # The sheet's numbers, in mm about the centre.
    renamed = [1000 + one.node for one in found.point]
    lines = [f"{node}, {x - 205}, {y - 145}" for node, (x, y) in zip(renamed, places.tolist(), strict=True)]
    (bench.folder / "nodes.csv").write_text("\n".join(lines))
    write_modal_model(replace(found, point=tuple(Channel(node) for node in renamed)), bench.folder / "modes.csv")
    config["measurement"] = {
        "modal_model": {"file": "modes.csv"},
        "nodes": "nodes.csv",
        "frame": {"unit": "mm", "origin": [-205.0, -145.0, 0.0]},
        "band": [0.0, float(found.frequency.median())],
    }
    recipe = load_run(bench.write(config))
    model = recipe.model()
    pairs = recipe.modal_evidence(model).pairs(model, model.known.new_zeros(0))
    assert [pair.mode for pair in pairs] == [6, 4, 5]
    assert min(pair.mac for pair in pairs) > 0.999
    assert any("Left out 3 modes" in remark for remark in recipe.remarks(model))


def test_diagnose_numbers_the_modes_by_their_shapes(bench, modes_file, monkeypatch):
    import torchplate.cli.verbs.diagnose as verb

    class ReachedError(Exception):
        pass

    seen = []

    def instead(model, measurement, table, **_):
        seen.append(table)
        raise ReachedError

    monkeypatch.setattr(verb, "find_missing", instead)
    config = modes_file(order=(8, 3, 6, 5))
    config["measurement"] = {"modal_model": {"file": "modes.csv", "frequency_std": 0.002}}
    told = StringIO()
    with pytest.raises(ReachedError):
        verb.diagnose(bench.write(config), bench.folder / "out", console=Console(file=told, width=300))
    assert seen[0].mode.tolist() == [4, 6, 7, 9]
    torch.testing.assert_close(seen[0].std, 0.002 * seen[0].frequency)
    (line,) = [line for line in told.getvalue().splitlines() if "paired by MAC" in line]
    assert "9: " in line


BAD = {
    "absent": ({"file": "none.csv"}, ["measurement.modal_model", "none.csv", "no file"]),
    "another suffix": ({"file": "plate.npz"}, ["measurement.modal_model", "'.npz'"]),
    "no file": ({"frequency_std": 0.1}, ["measurement.modal_model.file", "Add it"]),
    "a std of nothing": (
        {"file": "modes.csv", "shape_std": 0},
        ["measurement.modal_model.shape_std", "greater than 0"],
    ),
    "an unknown key": ({"file": "modes.csv", "shape_sdt": 0.1}, ["shape_sdt", "'shape_std'?"]),
    "a point off the mesh": ({"file": "off.csv"}, ["measurement.modal_model", "99w", "12"]),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("verb", ["run", "diagnose"])
def test_a_modal_model_that_cannot_be_used_is_said(name, verb, bench, make_config, command):
    given, words = BAD[name]
    (bench.folder / "modes.csv").write_text("mode,frequency_hz,damping_ratio,1,2\n1,60,0,1,2\n")
    (bench.folder / "off.csv").write_text("mode,frequency_hz,damping_ratio,1,99\n1,60,0,1,2\n")
    path = bench.write(make_config(changes={"measurement": {"modal_model": given}}))
    status, _, error = command(verb, path, "--out", bench.folder / "out")
    assert status == 2
    assert error.count("\n") == 1
    assert all(word in error for word in [str(path), *words]), error


def test_a_table_beside_a_modal_model_is_refused(bench, make_config, command):
    (bench.folder / "modes.csv").write_text("mode,frequency_hz,damping_ratio,1,2\n1,60,0,1,2\n")
    given = {"modal_model": {"file": "modes.csv"}, "natural_frequencies": {4: 60.0}}
    status, _, error = command("run", bench.write(make_config(changes={"measurement": given})))
    assert status == 2
    assert "got both" in error


def frfs(bench) -> None:
    """A hammer that roves over all nodes of the true plate."""
    model = load_model(bench.folder / "truth.yaml")
    frequency = torch.arange(20.0, 400.0, 0.5, dtype=torch.float64)
    frf = model.frf(model.known.new_zeros(0), frequency, [4], NODES, "accelerance")
    ends = (Channel(4),), tuple(Channel(node) for node in NODES)
    every = torch.ones(1, len(NODES), dtype=torch.bool)
    Measurement(frequency, frf, every, *ends, "accelerance", "m/(N s²)").to_npz(bench.folder / "rove.npz")


@pytest.mark.parametrize("suffix", ["csv", "uff"])
def test_modes_writes_what_a_config_takes(bench, command, suffix):
    pytest.importorskip("sdypy.EMA", reason="sdypy-EMA is an extra: pip install 'torchplate-fem[modal]'")
    frfs(bench)
    out = bench.folder / "new" / f"modes.{suffix}"
    status, text, error = command("modes", bench.folder / "rove.npz", "--lowest", 30, "--out", out)
    assert (status, error) == (0, "")
    assert "MAC of the modes with each other" in text
    assert f"modal_model: {{file: modes.{suffix}}}" in text
    found = read_modal_model(out)
    model = load_model(bench.folder / "truth.yaml")
    true = model.natural_frequencies(model.known.new_zeros(0), 12)
    nearest = (found.frequency[:, None] - true).abs().amin(-1) / found.frequency
    assert len(found.frequency) >= 4
    assert float(nearest.max()) < 1e-3
    assert len(found.point) == len(NODES)


def test_modes_without_the_package_is_one_sentence(bench, command, monkeypatch):
    frfs(bench)
    monkeypatch.setitem(__import__("sys").modules, "sdypy.EMA", None)
    status, _, error = command("modes", bench.folder / "rove.npz")
    assert status == 2
    assert error.count("\n") == 1
    assert "pip install 'torchplate-fem[modal]'" in error


def test_modes_refuses_another_format(bench, command):
    status, _, error = command("modes", bench.folder / "plate.npz", "--out", bench.folder / "modes.txt")
    assert status == 2
    assert "--out" in error


def test_inspect_points_at_the_modal_model(bench, modes_file, command):
    modes_file("modes.uff")
    status, text, _ = command("inspect", bench.folder / "modes.uff")
    assert status == 0
    # In columns, which break lines.
    assert "{modal_model: {file:" in text
    assert "modes.uff}}" in text
