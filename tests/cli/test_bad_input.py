"""Whatever the user got wrong: exit status 2, one line on stderr that names file and key and says what to do."""

import json
import sys
from pathlib import Path

import pytest
import torch

from torchplate.cli.main import main
from torchplate.measurement import Measurement
from torchplate.search import OPTIMIZERS

SIMULATE = {"measurement": {}}

# name: what is wrong → (changes to a config that works, words that the sentence must hold).
BAD_CONFIGS = {
    "unknown section": ({"serch": {"seed": 1}}, ["serch", "Did you mean 'search'?"]),
    "unknown key": ({"mesh.lenght_x": 0.4}, ["mesh.lenght_x", "Did you mean 'length_x'?"]),
    "missing key": ({"mesh.n_x": ...}, ["mesh.n_x", "Add it"]),
    "no mesh": ({"mesh": ...}, ["mesh:", "Add it"]),
    "text for a number": ({"mesh.length_x": "long"}, ["mesh.length_x", "'long'"]),
    "interval for a side": ({"mesh.length_x": [0.4, 0.5]}, ["mesh.length_x", "not searched"]),
    "reversed interval for a side": ({"mesh.length_x": [0.5, 0.4]}, ["mesh.length_x"]),
    "wrong key in a side": ({"mesh.length_x": {"value": 0.41, "sdt": 1e-4}}, ["mesh.length_x", "'std'"]),
    "negative side": ({"mesh.length_x": -0.41}, ["mesh", "length_x", "above 0"]),
    "no elements": ({"mesh.n_x": 0}, ["mesh.n_x", "greater than 0"]),
    "half an element": ({"mesh.n_x": 2.5}, ["mesh.n_x", "whole number"]),
    "unknown edge": ({"mesh.edges": {"z0": "clamped"}}, ["mesh", "z0", "x0, x1, y0, y1"]),
    "unknown edge condition": ({"mesh.edges": {"x0": "glued"}}, ["mesh.edges.x0", "clamped", "glued"]),
    "unknown effect": ({"effects.wires.effect": "support_sprin"}, ["effects.wires.effect", "'support_spring'?"]),
    "no effect named": ({"effects.wires.effect": ...}, ["effects.wires.effect", "Add"]),
    "effect that is a number": ({"effects.wires": 7}, ["effects.wires", "7"]),
    "no plate": ({"effects.plate": ...}, ["effects", "plate"]),
    "unknown parameter": ({"effects.plate.young": 2e11}, ["effects.plate.young", "'youngs_modulus'?"]),
    "missing parameter": ({"effects.plate.density": ...}, ["effects", "plate.density", "kg/m³", "Add it"]),
    "interval reversed": ({"effects.plate.thickness": [0.004, 0.003]}, ["effects.plate.thickness", "Swap the ends"]),
    "interval of three": ({"effects.plate.thickness": [1, 2, 3]}, ["effects.plate.thickness", "[low, high]"]),
    "a long list for an interval": (
        {"effects.plate.thickness": 400 * [0.003, {"a": None}]},
        ["effects.plate.thickness", "an interval [low, high]", "…"],
    ),
    "text in an interval": ({"effects.plate.thickness": [0.003, "thick"]}, ["effects.plate.thickness", "'thick'"]),
    "interval with a wrong key": (
        {"effects.plate.thickness": {"low": 0.002, "high": 0.004, "skale": "log"}},
        ["effects.plate.thickness", "'scale'?"],
    ),
    "unknown scale": (
        {"effects.plate.thickness": {"low": 0.002, "high": 0.004, "scale": "cubic"}},
        ["effects.plate.thickness", "'log'"],
    ),
    "negative tolerance": ({"effects.plate.thickness": {"value": 0.003, "std": -1}}, ["effects.plate.thickness"]),
    "nothing for a parameter": ({"effects.plate.thickness": None}, ["effects.plate.thickness", "got nothing"]),
    "yes for a parameter": ({"effects.plate.thickness": True}, ["effects.plate.thickness", "True"]),
    "a tolerance without end": ({"search.tolerance": float("inf")}, ["search.tolerance", "finite"]),
    "a rigid support of 1e20": ({"effects.wires.stiffness": 1e20}, ["wires.stiffness", "at most", "rigid", "write"]),
    "a loss beyond all": ({"effects.loss.stiffness_loss_factor": 1e308}, ["loss.stiffness_loss_factor", "1e+30"]),
    "a density from nothing to all": ({"effects.plate.density": [1e-308, 1e308]}, ["plate.density", "1e-30"]),
    "negative thickness": ({"effects.plate.thickness": -0.003}, ["effects", "plate.thickness", "above 0", "-0.003"]),
    "interval through zero thickness": ({"effects.plate.thickness": [-0.1, 0.1]}, ["plate.thickness", "above 0"]),
    "logarithmic interval from zero": (
        {"effects.loss.stiffness_loss_factor": {"low": 0.0, "high": 0.1, "scale": "log"}},
        ["effects.loss.stiffness_loss_factor", "log", "linear"],
    ),
    "node off the grid": ({"effects.wires.nodes": [2, 13]}, ["effects.wires.nodes", "13", "12"]),
    "node zero": ({"effects.wires.nodes": [0]}, ["effects.wires.nodes", "0", "12"]),
    "one node without a list": ({"effects.wires.nodes": 5}, ["effects.wires.nodes", "5", "list"]),
    "text for a node": ({"effects.wires.nodes": ["two"]}, ["effects.wires.nodes", "two"]),
    "place off the plate": (
        {"effects.wires": {"effect": "support_spring", "at": [[0.2, 1.3]], "stiffness": 1000.0}},
        ["effects.wires.at", "1.3"],
    ),
    "both nodes and places": ({"effects.wires.at": [[0.1, 0.0]]}, ["effects.wires", "both", "Give one of them"]),
    "neither nodes nor places": ({"effects.wires.nodes": ...}, ["effects.wires", "neither", "Give one of them"]),
    "unknown objective": ({"objective": {"kind": "relative_frf_nrm"}}, ["objective.kind", "'relative_frf_norm'?"]),
    "unknown optimizer": ({"search.optimizer": "diferential"}, ["search.optimizer", "'differential_evolution'?"]),
    "unknown strategy": ({"search.strategy": "rand/1/bon"}, ["search", "rand/1/bin"]),
    "unknown setting": ({"search.crossover": 0.9}, ["search.crossover", "'crossover_rate'?"]),
    "another optimizer's setting": (
        {"search": {"optimizer": "artificial_bee_colony", "strategy": "rand/1/bin"}},
        ["search.strategy", "limit"],
    ),
    "two members": ({"search.n_member": 2}, ["search", "n_member", "2"]),
    "text for a setting": ({"search.n_member": "many"}, ["search", "n_member", "many"]),
    "half a member": ({"search.n_member": 8.5}, ["search", "n_member", "8.5"]),
    "interval for a setting": ({"search.differential_weight": [0.2, 0.8]}, ["search", "differential_weight"]),
    "no generation": ({"search.n_generation": 0}, ["search.n_generation", "greater than 0"]),
    "fewer evaluations than members": ({"search.n_evaluation": 4}, ["search", "n_evaluation", "10"]),
    "negative seed": ({"search.seed": -1}, ["search.seed"]),
    "seed beyond the generator": ({"search.seed": 2**70}, ["search.seed"]),
    "measurement not there": ({"measurement.file": "absent.uff"}, ["measurement.file", "absent.uff", "path"]),
    "measurement of another format": ({"measurement.file": "plate.yaml"}, ["measurement.file", ".uff"]),
    "measurement that is a folder": ({"measurement.file": "."}, ["measurement.file", ".uff"]),
    "measurement without UFF in it": ({"measurement.file": "text.uff"}, ["measurement.file", "text.uff"]),
    "band outside": ({"measurement.band": [500.0, 600.0]}, ["measurement.band", "2 to 400 Hz"]),
    "band reversed": ({"measurement.band": [300.0, 20.0]}, ["measurement.band", "300"]),
    "band of one number": ({"measurement.band": [300.0]}, ["measurement.band"]),
    "unknown kind": ({"measurement.kind": "inertance"}, ["measurement.kind", "accelerance", "inertance"]),
    "unknown gain": ({"measurement.gain": "fitted"}, ["measurement.gain", "unknown", "fitted"]),
    "no measurement": ({"measurement": {}}, ["measurement", "natural_frequencies"]),
    "natural frequencies that fall": (
        {"measurement": {"natural_frequencies": {4: 80.0, 5: 70.0}}},
        ["measurement.natural_frequencies", "80", "70"],
    ),
    "mode zero": ({"measurement": {"natural_frequencies": {0: 80.0}}}, ["measurement.natural_frequencies", "from 1"]),
    "frequency zero": ({"measurement": {"natural_frequencies": {1: 0.0}}}, ["measurement.natural_frequencies"]),
    "mode that is no number": (
        {"measurement": {"natural_frequencies": {"first": 4.0}}},
        ["measurement.natural_frequencies", "first"],
    ),
    "mode beyond the mesh": (
        {"measurement": {"natural_frequencies": {4: 80.0, 37: 90.0}}},
        ["measurement.natural_frequencies", "36", "37"],
    ),
    "channels off the grid": ({"mesh.n_y": 1, "effects.wires.nodes": [2]}, ["measurement.file", "mesh.n_y"]),
}
BAD_SIMULATIONS = {
    "an interval": ({"effects.plate.density": [7000, 8000]}, ["effects.plate.density", "interval", "--set"]),
    "unknown analyser": ({"modal_test.analyser": "sr758"}, ["modal_test.analyser", "'sr785'?"]),
    "unknown setting of the analyser": (
        {"modal_test.analyser": {"like": "sr785", "n_lines": 100}},
        ["modal_test.analyser", "'n_line'?"],
    ),
    "setting of the analyser out of range": (
        {"modal_test.analyser": {"like": "sr785", "n_line": 30}},
        ["modal_test.analyser", "multiple of 25"],
    ),
    "text for a setting of the analyser": (
        {"modal_test.analyser": {"like": "sr785", "span": "wide"}},
        ["modal_test.analyser", "span", "wide"],
    ),
    "unknown setting of the hammer": ({"modal_test.hammer": {"peak": 30}}, ["modal_test.hammer", "'peak_force'?"]),
    "setting of the hammer out of range": ({"modal_test.hammer": {"peak_force": -30}}, ["modal_test.hammer", "-30"]),
    "response off the plate": ({"modal_test.response": [[0.5, 1.2]]}, ["modal_test.response", "1.2"]),
    "response off the grid": ({"modal_test.response": [99]}, ["modal_test.response", "99", "12"]),
    "reference off the grid": ({"modal_test.reference": [99]}, ["modal_test.reference", "99", "12"]),
    "measured response off the grid": ({"measurement.response": [99]}, ["measurement.response", "99", "12"]),
    "unknown kind": ({"modal_test.kind": "transmissibility"}, ["modal_test.kind", "accelerance"]),
    "hits that never trigger": (
        {"modal_test.analyser": {"like": "sr785", "n_line": 25, "full_scale": [1e9, 1.0]}},
        ["modal_test", "trigger_level"],
    ),
}
BAD_OVERRIDES = {
    "no value": ("search.seed", ["--set search.seed", "search.seed=3"]),
    "no key": ("=3", ["--set =3", "search.seed=3"]),
    "key through a number": ("search.seed.more=3", ["--set search.seed.more=3", "seed"]),
    "not YAML": ("search.seed=[1", ["--set search.seed=[1", "YAML"]),
    "unknown key": ("mesh.refin=2", ["mesh.refin", "Did you mean 'refine'?"]),
    "wrong kind": ("search.seed=early", ["search.seed", "early"]),
}
BAD_FILES = {
    "not YAML": ("mesh: {length_x: [0.4\neffects:", ["YAML"]),
    "a tab": ("mesh:\n\tlength_x: 0.4\n", ["YAML"]),
    "a list": ("- 1\n- 2\n", ["mesh", "list"]),
    "nothing": ("", ["mesh", "an empty file"]),
    "a picture": (b"\x89PNG\r\n\x1a\n\x00\xff", ["YAML"]),
}


def assert_refused(outcome: tuple[int, str, str], *words: str) -> None:
    status, _, stderr = outcome
    assert status == 2
    assert stderr.endswith("\n")
    assert len(stderr.splitlines()) == 1, stderr
    for word in words:
        assert word in stderr
    assert "Error" not in stderr


# Every third; `make check` tries them all.
@pytest.mark.parametrize(
    "case", [one if k % 3 == 0 else pytest.param(one, marks=pytest.mark.check) for k, one in enumerate(BAD_CONFIGS)]
)
def test_a_bad_config_is_refused_in_one_sentence(bench, make_config, command, case):
    changes, words = BAD_CONFIGS[case]
    (bench.folder / "text.uff").write_text("no universal file\n")
    path = bench.write(make_config(["plate.youngs_modulus"], changes))
    out = bench.folder / "out"
    assert_refused(command("run", path, "--out", out), "plate.yaml", *words)
    assert not out.exists()


@pytest.mark.parametrize("case", BAD_SIMULATIONS)
def test_a_bad_simulation_is_refused_in_one_sentence(bench, make_config, command, case):
    changes, words = BAD_SIMULATIONS[case]
    path = bench.write(make_config(changes=SIMULATE | changes))
    out = bench.folder / "out.uff"
    assert_refused(command("simulate", path, "--out", out), "plate.yaml", *words)
    assert not out.exists()


@pytest.mark.parametrize("case", BAD_OVERRIDES)
def test_a_bad_override_is_refused_in_one_sentence(bench, make_config, command, case):
    override, words = BAD_OVERRIDES[case]
    path = bench.write(make_config())
    assert_refused(command("run", path, "--set", override, "--out", bench.folder / "out"), *words)


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_file_that_is_no_config_is_refused_in_one_sentence(tmp_path, command, case):
    content, words = BAD_FILES[case]
    path = tmp_path / "strange.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert_refused(command("run", path), "strange.yaml", *words)


def test_a_config_that_is_not_there_is_refused_with_the_nearest_name(bench, command):
    bench.write({}, "steel_plate.yaml")
    assert_refused(command("run", bench.folder / "stel_plate.yaml"), "stel_plate.yaml", "steel_plate.yaml?")
    assert_refused(command("run", bench.folder / "none" / "plate.yaml"), "plate.yaml", "Give the path")


@pytest.mark.parametrize("suffix", [".txt", ".mat", ""])
def test_a_simulation_into_another_format_is_refused(bench, make_config, command, suffix):
    path = bench.write(make_config(changes=SIMULATE))
    assert_refused(command("simulate", path, "--out", bench.folder / f"out{suffix}"), "--out", ".uff", "Rename it")


@pytest.mark.parametrize("device", ["abacus", "cuda:999"])
def test_a_device_that_is_not_there_is_refused(bench, make_config, command, device):
    path = bench.write(make_config())
    assert_refused(command("run", path, "--device", device), f"--device {device}", "Use cpu")


class TestResume:
    def test_with_nothing_to_resume_is_refused(self, bench, make_config, command, monkeypatch):
        monkeypatch.chdir(bench.folder)
        path = bench.write(make_config(["plate.youngs_modulus"]))
        for arguments in ([], ["--out", "out"]):
            assert_refused(command("run", path, "--resume", *arguments), "plate.yaml", "--resume", "Leave --resume out")
        assert not (bench.folder / "out").exists()

    @pytest.mark.parametrize(
        "changes",
        [
            {"search": {"optimizer": "artificial_bee_colony", "n_member": 10}},
            {"search.n_repeat": 2},
            {"search.n_member": 12},
            {"effects.wires.stiffness": [700, 2000]},
        ],
    )
    @pytest.mark.check
    def test_of_another_search_is_refused(self, bench, make_config, command, changes):
        bench.run(["plate.youngs_modulus"], {"search.n_generation": 1})
        saved = (bench.folder / "out" / "config.yaml").read_text()
        path = bench.write(make_config(["plate.youngs_modulus"], changes))
        outcome = command("run", path, "--resume", "--out", bench.folder / "out")
        assert_refused(outcome, "plate.yaml", "--resume", "checkpoint")
        assert (bench.folder / "out" / "config.yaml").read_text() == saved

    def test_from_a_broken_checkpoint_is_refused(self, bench, make_config, command):
        path = bench.write(make_config(["plate.youngs_modulus"]))
        (bench.folder / "out").mkdir()
        (bench.folder / "out" / "checkpoint.pt").write_bytes(b"half a file")
        outcome = command("run", path, "--resume", "--out", bench.folder / "out")
        assert_refused(outcome, "plate.yaml", "--resume", "checkpoint.pt")

    @pytest.mark.check
    def test_from_another_kind_of_device_is_refused(self, bench, make_config, command):
        bench.run(["plate.youngs_modulus"], {"search.n_generation": 1})
        stored = bench.folder / "out" / "checkpoint.pt"
        # A CUDA generator's state is 16 bytes.
        torch.save(torch.load(stored) | {"generator": torch.zeros(16, dtype=torch.uint8)}, stored)
        path = bench.write(make_config(["plate.youngs_modulus"]))
        outcome = command("run", path, "--resume", "--out", bench.folder / "out")
        assert_refused(outcome, "plate.yaml", "--resume", "--device")


def test_a_run_into_a_file_is_refused(bench, make_config, command):
    path = bench.write(make_config())
    assert_refused(command("run", path, "--out", bench.folder / "plate.npz"), "--out", "plate.npz", "folder")


class TestCompare:
    def test_a_folder_without_a_run_is_refused(self, bench, command):
        assert_refused(command("compare", bench.folder), str(bench.folder), "result.json")

    def test_a_run_without_a_search_is_refused(self, bench, command):
        found = bench.run()
        assert_refused(command("compare", found.folder), str(found.folder), "Compare searches only")

    @pytest.mark.check
    def test_runs_of_other_objectives_are_refused(self, bench, command):
        folders = [
            bench.run(["plate.youngs_modulus"], {"search.n_generation": 1, "objective": {"kind": kind}}, kind).folder
            for kind in ("relative_frf_norm", "log_amplitude")
        ]
        assert_refused(command("compare", *folders), "relative_frf_norm", "log_amplitude", "apart")

    @pytest.mark.check
    def test_runs_of_other_parameters_are_refused(self, bench, command):
        folders = [
            bench.run(searched, {"search.n_generation": 1}, searched[-1]).folder
            for searched in (["plate.youngs_modulus"], ["plate.youngs_modulus", "wires.stiffness"])
        ]
        assert_refused(command("compare", *folders), "parameters", "wires.stiffness", "apart")

    def test_a_cut_result_is_refused(self, bench, command):
        (bench.folder / "result.json").write_text('{"schema": "torch')
        assert_refused(command("compare", bench.folder), "result.json")


def test_inspect_of_no_measurement_is_refused(bench, command):
    assert_refused(command("inspect", bench.folder / "plate.yaml"), "plate.yaml", ".uff")


@pytest.mark.parametrize(
    "arguments", [[], ["fly"], ["run"], ["run", "plate.yaml", "--fast"], ["simulate", "plate.yaml"], ["compare"]]
)
def test_a_wrong_command_line_ends_with_status_2_and_the_usage(capsys, arguments):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert "usage: torchplate" in capsys.readouterr().err


def test_a_defect_is_not_taken_for_bad_input(bench, make_config, monkeypatch):
    def broken(*_: object) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr("torchplate.cli.results.found.run_report", broken)
    with pytest.raises(RuntimeError, match="a defect"):
        main(["run", str(bench.write(make_config())), "--out", str(bench.folder / "out")])


def test_a_value_error_inside_the_search_is_a_defect(bench, make_config, monkeypatch):
    def broken(*_: object) -> torch.Tensor:
        raise ValueError("a defect")

    monkeypatch.setattr("torchplate.discrepancy.Objective.__call__", broken)
    path = bench.write(make_config(["plate.youngs_modulus"]))
    with pytest.raises(ValueError, match="a defect"):
        main(["run", str(path), "--out", str(bench.folder / "out")])


def test_ctrl_c_says_how_to_go_on(bench, make_config, command, monkeypatch):
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("torchplate.identification.job.minimize", lambda *_, **__: stopped())
    status, _, stderr = command("run", bench.write(make_config(["plate.youngs_modulus"])), "--out", bench.folder / "o")
    assert status == 130
    assert "--resume" in stderr


@pytest.mark.check
@pytest.mark.parametrize("optimizer", sorted(OPTIMIZERS))
def test_every_optimizer_runs_with_its_own_settings_left_out(bench, optimizer):
    changes = {"search": {"optimizer": optimizer, "n_generation": 1, "basis": "full"}}
    found = bench.run(["plate.youngs_modulus"], changes)
    assert found.result["optimizer"] == optimizer
    assert sys.float_info.max > found.result["objective"] > 0
    assert Path(found.folder / "result.json").is_file()


class TestADeadChannel:
    @staticmethod
    def silence(bench, response: object = slice(None), reference: object = slice(None)) -> None:
        whole = Measurement.from_npz(bench.folder / "plate.npz")
        whole.frf[:, response, reference] = 0
        whole.to_npz(bench.folder / "plate.npz")

    @pytest.mark.parametrize("optimizer", ["differential_evolution", "least_squares"])
    @pytest.mark.check
    def test_is_left_out_and_named_and_the_rest_is_searched(self, bench, make_config, command, optimizer):
        self.silence(bench, reference=1)
        search = {"optimizer": optimizer, "n_member": 6, "n_generation": 2}
        path = bench.write(make_config(["plate.youngs_modulus"], {"search": search}))
        status, stdout, _ = command("run", path, "--out", bench.folder / "out")
        assert status == 0
        assert "Left out 2 of 6 FRFs" in stdout
        assert "4w/6w" in stdout
        assert json.loads((bench.folder / "out" / "result.json").read_text())["parameters"]["plate.youngs_modulus"][
            "std"
        ]

    def test_of_numbers_whose_squares_are_none_counts_as_dead_or_as_infinite(self, bench, make_config, command):
        path, out = bench.write(make_config(["plate.youngs_modulus"], {"search.n_generation": 1})), bench.folder / "out"
        whole = Measurement.from_npz(bench.folder / "plate.npz")
        whole.frf[:, :, 1] = 1e-320
        whole.to_npz(bench.folder / "plate.npz")
        status, stdout, _ = command("run", path, "--out", out)
        assert status == 0
        assert "Left out 2 of 6 FRFs" in stdout
        whole.frf[:, :, 1] = 1e200
        whole.to_npz(bench.folder / "plate.npz")
        assert_refused(command("run", path, "--out", out, "--force"), "plate.npz", "NaN or infinity", "4w/6w")

    @pytest.mark.parametrize("verb", ["run", "diagnose"])
    def test_among_dead_ones_alone_is_refused(self, bench, make_config, command, verb):
        self.silence(bench)
        path = bench.write(make_config(["plate.youngs_modulus"]))
        assert_refused(command(verb, path, "--out", bench.folder / "out"), "plate.npz", "4w/1w", "zero at every line")

    def test_counts_in_the_band_alone(self, bench, make_config, command):
        whole = Measurement.from_npz(bench.folder / "plate.npz")
        whole.frf[whole.frequency > 100.0, 0] = 0
        whole.to_npz(bench.folder / "plate.npz")
        changes = {"measurement.band": [120.0, 400.0], "search.n_generation": 1}
        status, stdout, _ = command(
            "run", bench.write(make_config(["plate.youngs_modulus"], changes)), "--out", bench.folder / "o"
        )
        assert status == 0
        assert "Left out 3 of 6 FRFs" in stdout


def test_a_config_of_many_megabytes_is_not_read(bench, make_config, command):
    path = bench.write("# " + "c" * 9_000_000 + "\n" + json.dumps(make_config()))
    status, _, stderr = command("run", path, "--out", bench.folder / "out")
    assert (status, stderr.count("\n")) == (2, 1)
    for words in ("plate.yaml", "8 MB at most", "got 9 MB", "files of their own"):
        assert words in stderr
