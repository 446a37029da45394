"""A run from its YAML file to its folder."""

import csv
import json
import math
from io import StringIO
from pathlib import Path

import pytest
import torch
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchplate.cli.config import InputError
from torchplate.cli.config.build import load_model
from torchplate.cli.verbs.run import run

PNG = b"\x89PNG\r\n\x1a\n"
SEARCHES = ("de", "abc")
# result.json as the contract writes it.
RESULT = {
    "schema": str,
    "objective": float,
    "parameters": dict,
    "natural_frequencies_hz": list,
    "n_evaluation": int,
    "n_generation": int,
    "status": str,
    "seed": int,
    "optimizer": str,
}
PARAMETER = {"value": float, "std": float, "unit": str, "at_bound": bool}


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "history.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def events(folder: Path) -> EventAccumulator:
    accumulator = EventAccumulator(str(folder), size_guidance={"images": 0, "scalars": 0})
    accumulator.Reload()
    return accumulator


@pytest.mark.parametrize("search", SEARCHES)
class TestAFinishedRun:
    def test_its_folder_holds_every_file_and_no_other_folder(self, finished, search):
        assert finished.simulate_status == 0
        folder = finished.found[search].folder
        assert not [path for path in folder.iterdir() if path.is_dir()]
        names = {path.name for path in folder.iterdir()}
        event_files = {name for name in names if name.startswith("events.out.tfevents.")}
        assert len(event_files) == 1
        assert names - event_files == {
            "config.yaml",
            "versions.json",
            "history.csv",
            "checkpoint.pt",
            "result.json",
            "report.md",
            "report.html",
            "frf.png",
            "convergence.png",
        }

    def test_result_json_has_the_keys_and_types_of_the_contract(self, finished, search):
        result = json.loads((finished.found[search].folder / "result.json").read_text())
        assert {key: type(result[key]) for key in RESULT} == RESULT
        assert result["schema"] == "torchplate.result/1"
        assert set(result["parameters"]) == set(finished.searched)
        for entry in result["parameters"].values():
            assert {key: type(value) for key, value in entry.items()} == PARAMETER
        assert [entry["unit"] for entry in result["parameters"].values()] == ["Pa", "N s/m"]
        assert len(result["natural_frequencies_hz"]) == 20
        assert result["natural_frequencies_hz"] == sorted(result["natural_frequencies_hz"])

    def test_the_truth_is_found_where_both_meshes_are_one(self, finished, search, truth):
        # What is left is the analyser: 1 s of record, after which the slowest mode still rings at exp(-10), and the
        # anti-alias filter's ringing before the record begins. It moves E by 1e-4 and c by 1e-2 at most.
        for name, tolerance in (("plate.youngs_modulus", 1e-3), ("wires.viscous_damping", 2e-2)):
            assert finished.found[search].result["parameters"][name]["value"] == pytest.approx(
                truth[name], rel=tolerance
            )

    def test_its_history_and_its_result_agree(self, finished, search):
        found = finished.found[search]
        history = rows(found.folder)
        assert [int(row["generation"]) for row in history] == list(range(found.result["n_generation"] + 1))
        assert int(history[-1]["n_evaluation"]) == found.result["n_evaluation"]
        best = [float(row["best_objective"]) for row in history]
        assert best == sorted(best, reverse=True)
        for name, entry in found.result["parameters"].items():
            # Ten digits are written.
            assert float(history[-1][name]) == pytest.approx(entry["value"], rel=1e-9)

    def test_tensorboard_has_the_tags_of_the_contract_over_evaluations(self, finished, search):
        found = finished.found[search]
        read = events(found.folder)
        tags = set(read.Tags()["scalars"])
        expected = {"best_objective", "mean_objective", "spread", "generation"}
        assert {f"search/{tag}" for tag in expected} | {f"parameter/{n}" for n in finished.searched} <= tags
        assert "gap/baseline" in tags
        history = rows(found.folder)
        steps = [int(row["n_evaluation"]) for row in history]
        for tag, column in (
            ("search/best_objective", "best_objective"),
            ("search/mean_objective", "mean_objective"),
            ("search/spread", "spread"),
            ("search/generation", "generation"),
            ("parameter/plate.youngs_modulus", "plate.youngs_modulus"),
        ):
            scalars = read.Scalars(tag)
            assert [scalar.step for scalar in scalars] == steps
            # The event file holds single precision.
            assert [s.value for s in scalars] == pytest.approx([float(row[column]) for row in history], rel=1e-6)
        assert read.Scalars("gap/baseline")[-1].value == pytest.approx(found.result["gap"], rel=1e-6)

    def test_tensorboard_has_a_figure_of_every_frf_at_the_end(self, finished, search):
        found = finished.found[search]
        read = events(found.folder)
        assert set(read.Tags()["images"]) == {"frf/4w_1w", "frf/4w_6w", "frf/4w_10w"}
        assert read.Images("frf/4w_6w")[-1].step == found.result["n_evaluation"]

    def test_its_report_shows_the_figures_and_the_parameters(self, finished, search):
        found = finished.found[search]
        report = (found.folder / "report.md").read_text()
        for words in ("](frf.png)", "](convergence.png)", "plate.youngs_modulus", "Pa", found.result["status"], "4w"):
            assert words in report
        for name in ("frf.png", "convergence.png"):
            assert (found.folder / name).read_bytes().startswith(PNG)

    def test_its_config_says_what_was_run_and_can_be_read_from_anywhere(self, finished, search, monkeypatch, tmp_path):
        monkeypatch.chdir(tmp_path)
        found = finished.found[search]
        saved = (found.folder / "config.yaml").read_text()
        assert "stagnation: 25" in saved
        model = load_model(found.folder / "config.yaml")
        assert model.names == finished.searched
        assert model.kind == "accelerance"

    def test_the_checkpoint_holds_tensors_only(self, finished, search):
        content = torch.load(finished.found[search].folder / "checkpoint.pt", weights_only=True)
        assert all(isinstance(value, torch.Tensor) for value in content.values())

    def test_versions_name_the_packages_and_the_machine(self, finished, search):
        versions = json.loads((finished.found[search].folder / "versions.json").read_text())
        assert versions["torch"] == torch.__version__
        assert {"python", "platform", "device", "n_thread", "torchplate-fem", "numpy"} <= set(versions)


@pytest.mark.check
def test_the_saved_config_gives_the_same_result_again(bench):
    first = bench.run(["plate.youngs_modulus", "wires.stiffness"], overrides=["search.n_generation=3"])
    again = run(first.folder / "config.yaml", bench.folder / "again")
    assert again.result == first.result
    assert rows(again.folder) == rows(first.folder)


@pytest.mark.check
def test_an_override_changes_the_run_and_is_in_the_saved_config(bench):
    plain = bench.run(["plate.youngs_modulus"], out="plain")
    other = bench.run(["plate.youngs_modulus"], overrides=["search.seed=9", "mesh.refine=2", "search.n_generation=2"])
    assert (plain.result["seed"], other.result["seed"], other.result["n_generation"]) == (4, 9, 2)
    saved = (other.folder / "config.yaml").read_text()
    assert "seed: 9" in saved
    assert "refine: 2" in saved
    assert other.result["natural_frequencies_hz"] != plain.result["natural_frequencies_hz"]


def test_an_override_may_add_a_section_that_the_file_leaves_out(bench):
    changes = {"log": ...}
    found = bench.run(changes=changes, overrides=["log.n_figure=0", "objective.kind=log_amplitude"])
    assert found.result["objective_kind"] == "log_amplitude"


@pytest.mark.usefixtures("drawn")
def test_a_config_of_numbers_only_is_evaluated(bench):
    found = bench.run()
    result = json.loads((found.folder / "result.json").read_text())
    assert {key: type(result[key]) for key in RESULT} == RESULT
    assert result["parameters"] == {}
    assert (result["n_evaluation"], result["n_generation"]) == (1, 0)
    # The measurement is that of this very model.
    assert result["objective"] < 1e-12
    assert result["status"].startswith("The model was evaluated")
    assert {path.name for path in found.folder.iterdir()} == {
        "config.yaml",
        "versions.json",
        "result.json",
        "report.md",
        "report.html",
        "frf.png",
    }


def test_a_number_known_with_a_tolerance_counts_as_its_value(bench):
    changes = {"effects.plate.thickness": {"value": 0.0031, "std": 1e-5}, "mesh.length_x": {"value": 0.41, "std": 5e-4}}
    assert bench.run(changes=changes).result["objective"] < 1e-12


@pytest.mark.check
@pytest.mark.parametrize(
    "search", ["search.optimizer=differential_evolution", "search.optimizer=artificial_bee_colony"]
)
def test_an_interrupted_run_goes_on_to_the_identical_result(bench, search):
    searched = ["plate.youngs_modulus", "wires.stiffness"]
    changes = {"search": {"n_member": 6, "n_generation": 8, "seed": 2, "n_repeat": 2, "basis": "full"}}
    whole = bench.run(searched, changes, "whole", [search])
    bench.run(searched, changes, "parts", [search, "search.n_generation=3"])
    parts = bench.run(searched, changes, "parts", [search, "search.n_generation=8"], resume=True)
    assert parts.result == whole.result
    assert rows(parts.folder) == rows(whole.folder)
    assert parts.caveats == whole.caveats
    one, two = (events(found.folder).Scalars("search/best_objective") for found in (whole, parts))
    assert [(s.step, s.value) for s in one] == [(s.step, s.value) for s in two]


@pytest.mark.check
def test_a_row_beyond_the_checkpoint_is_written_once(bench):
    searched = ["plate.youngs_modulus"]
    bench.run(searched, overrides=["search.n_generation=2"])
    # The machine stopped after the history's row and before the checkpoint, in the middle of one more row.
    history = bench.folder / "out" / "history.csv"
    history.write_text(history.read_text() + "0,3,40,1.5,1.6,0.2,2e11\n0,4,5")
    bench.run(searched, overrides=["search.n_generation=4"], resume=True)
    assert [int(row["generation"]) for row in rows(bench.folder / "out")] == [0, 1, 2, 3, 4]
    assert float(rows(bench.folder / "out")[3]["best_objective"]) != 1.5


@pytest.mark.parametrize("kept", [0, 20])
@pytest.mark.check
def test_a_search_that_had_ended_is_reported_without_a_curve_where_its_rows_are_gone(bench, kept):
    whole = bench.run(["plate.youngs_modulus"], overrides=["search.n_generation=2"])
    (whole.folder / "report.md").unlink()
    history = whole.folder / "history.csv"
    history.write_text(history.read_text()[:kept])
    again = bench.run(["plate.youngs_modulus"], overrides=["search.n_generation=2"], resume=True)
    assert again.result == whole.result
    assert (again.folder / "report.md").is_file()


@pytest.mark.check
def test_resume_without_out_takes_the_latest_folder(bench, monkeypatch, command):
    monkeypatch.chdir(bench.folder)
    for name, n_generation in (("2020-01-01_00-00-00", 1), ("2021-01-01_00-00-00", 2)):
        bench.run(["plate.youngs_modulus"], out=f"runs/plate/{name}", overrides=[f"search.n_generation={n_generation}"])
    status, out, _ = command("run", "plate.yaml", "--resume", "--set", "search.n_generation=3")
    assert status == 0
    assert "2021-01-01_00-00-00" in out
    counts = [len(rows(bench.folder / "runs" / "plate" / f"{year}-01-01_00-00-00")) for year in (2020, 2021)]
    assert counts == [2, 4]


def test_without_out_the_folder_is_named_by_config_and_time(bench, make_config, monkeypatch, command):
    monkeypatch.chdir(bench.folder)
    bench.write(make_config(), "strange name.yaml")
    assert command("run", "strange name.yaml")[0] == 0
    (folder,) = (bench.folder / "runs" / "strange name").iterdir()
    assert (folder / "result.json").is_file()


@pytest.mark.check
def test_a_folder_that_is_run_anew_shows_one_search_in_tensorboard(bench):
    for seed in (1, 2):
        found = bench.run(["plate.youngs_modulus"], overrides=[f"search.seed={seed}", "search.n_generation=3"])
    values = [scalar.value for scalar in events(found.folder).Scalars("search/best_objective")]
    assert values == pytest.approx([float(row["best_objective"]) for row in rows(found.folder)], rel=1e-6)


@pytest.mark.check
class TestCaveats:
    @pytest.mark.check
    def test_natural_frequencies_alone_see_no_damping(self, bench, monkeypatch):
        monkeypatch.undo()  # its figures are rendered
        model = load_model(bench.folder / "truth.yaml")
        table = model.natural_frequencies(model.known.new_zeros(0), 9).tolist()
        measured = {"natural_frequencies": {mode: table[mode - 1] for mode in (1, 2, 4, 6, 7, 9)}}
        names = ["plate.youngs_modulus", "wires.stiffness", "wires.viscous_damping", "loss.stiffness_loss_factor"]
        changes = {"measurement": measured, "search.n_generation": 40, "search.n_member": 14}
        found = bench.run(names, changes)
        unseen = [sentence for sentence in found.caveats if sentence.startswith("The data cannot see")]
        # Beside them, what is assumed of a table without standard deviations.
        assert len(unseen) == len(found.caveats) - 1 == 2
        for name, sentence in zip(names[2:], unseen, strict=True):
            assert name in sentence
            assert found.result["parameters"][name]["std"] is None
        for name, value in (("plate.youngs_modulus", 2.04e11), ("wires.stiffness", 1310.0)):
            # 40 generations bring the error of a noise-free fit below a thousandth.
            assert found.result["parameters"][name]["value"] == pytest.approx(value, rel=1e-3)
        assert found.result["objective_kind"] == "natural_frequencies"
        report = (found.folder / "report.md").read_text()
        assert all(sentence in report for sentence in found.caveats)
        assert "| 4 | " in report
        assert (found.folder / "natural_frequencies.png").read_bytes().startswith(PNG)
        assert not (found.folder / "frf.png").exists()

    @pytest.mark.parametrize(("interval", "end"), [([1.5e11, 1.9e11], "upper"), ([2.2e11, 2.6e11], "lower")])
    def test_a_truth_outside_the_interval_ends_on_its_bound(self, bench, interval, end):
        # By natural frequencies, which rise with E everywhere; FRFs may fit best where other peaks meet.
        model = load_model(bench.folder / "truth.yaml")
        fourth = float(model.natural_frequencies(model.known.new_zeros(0), 4)[3])
        changes = {"effects.plate.youngs_modulus": interval, "measurement": {"natural_frequencies": {4: fourth}}}
        found = bench.run(["plate.youngs_modulus"], changes | {"search.n_generation": 12})
        entry = found.result["parameters"]["plate.youngs_modulus"]
        assert entry["at_bound"] is True
        # On the edge to a thousandth of the interval, as `at_bound` means it.
        assert entry["value"] == pytest.approx(interval[end == "upper"], abs=1e-3 * (interval[1] - interval[0]))
        assert any(f"ended on the {end} bound" in sentence for sentence in found.caveats)
        assert "on its bound" in (found.folder / "report.md").read_text()

    def test_a_truth_inside_the_interval_needs_no_caveat(self, bench, truth):
        found = bench.run(["plate.youngs_modulus"], {"search.n_generation": 20})
        assert found.caveats == []
        entry = found.result["parameters"]["plate.youngs_modulus"]
        assert entry["at_bound"] is False
        # 20 generations of 10 members narrow one dimension by far more than a thousandth.
        assert entry["value"] == pytest.approx(truth["plate.youngs_modulus"], rel=1e-3)

    def test_a_product_is_seen_and_its_factors_are_not(self, bench):
        model = load_model(bench.folder / "truth.yaml", ["effects.wires.stiffness=0"])
        table = model.natural_frequencies(model.known.new_zeros(0), 9).tolist()
        changes = {
            "measurement": {"natural_frequencies": {mode: table[mode - 1] for mode in (4, 5, 7, 9)}},
            "effects.wires": ...,
            "effects.plate.density": [7000.0, 8400.0],
            "search.n_generation": 10,
        }
        found = bench.run(["plate.youngs_modulus"], changes)
        sentence, assumed = found.caveats
        assert "0.1 %" in assumed
        assert "plate.youngs_modulus and plate.density only together" in sentence
        assert [entry["std"] for entry in found.result["parameters"].values()] == [None, None]


@pytest.mark.parametrize("objective", ["relative_frf_norm", "relative_amplitude_norm", "log_amplitude"])
@pytest.mark.check
def test_a_level_without_a_unit_is_fitted(bench, truth, objective):
    bench.measure(gain=3.7)
    changes = {"measurement.gain": "unknown", "objective": {"kind": objective}, "search.n_generation": 15}
    found = bench.run(["plate.youngs_modulus"], changes)
    value = found.result["parameters"]["plate.youngs_modulus"]["value"]
    # The search's own error: see the case without a gain.
    assert value == pytest.approx(truth["plate.youngs_modulus"], rel=1e-3)
    assert found.result["gain"] == pytest.approx(3.7, rel=1e-2)
    assert f"Level of the measurement, fitted: {found.result['gain']:.6g}" in (found.folder / "report.md").read_text()


def test_a_level_taken_as_known_is_not_fitted(bench):
    bench.measure(gain=3.7)
    found = bench.run()
    assert "gain" not in found.result
    # ‖3.7 H − H‖ / ‖3.7 H‖ for each FRF.
    assert found.result["gap"] == pytest.approx(2.7 / 3.7, rel=1e-12)


def test_natural_frequencies_beside_frfs_add_their_error(bench):
    model = load_model(bench.folder / "truth.yaml")
    fourth = float(model.natural_frequencies(model.known.new_zeros(0), 4)[3])
    found = bench.run(changes={"measurement.natural_frequencies": {4: fourth / 1.02}})
    # The FRFs fit exactly; one frequency is 2 % off.
    assert found.result["objective"] == pytest.approx(0.02, rel=1e-6)


@pytest.mark.check
def test_repeated_searches_report_the_best_of_them(bench):
    found = bench.run(["plate.youngs_modulus", "wires.stiffness"], {"search.n_repeat": 3, "search.n_generation": 3})
    repeats = found.result["repeats"]
    assert len(repeats["objective"]) == 3
    assert repeats["objective"] == sorted(repeats["objective"])
    assert found.result["objective"] == repeats["objective"][0]
    values = [entry["value"] for entry in found.result["parameters"].values()]
    assert values == repeats["theta"][0]
    assert {row["search"] for row in rows(found.folder)} == {"0", "1", "2"}
    last = [float(row["best_objective"]) for row in rows(found.folder)[-3:]]
    assert sorted(last) == pytest.approx(repeats["objective"], rel=1e-9)
    assert found.result["n_evaluation"] == sum(int(row["n_evaluation"]) for row in rows(found.folder)[-3:])


@pytest.mark.check
def test_a_clamped_plate_on_a_moving_base_is_found_by_its_transmissibility(bench, truth):
    held = {"mesh.edges": {"x0": "clamped"}, "effects.wires": ...}
    bench.measure(held, kind="transmissibility")
    changes = held | {"search.n_generation": 15}
    found = bench.run(["plate.youngs_modulus"], changes)
    value = found.result["parameters"]["plate.youngs_modulus"]["value"]
    # The search's own error: see the case of a free plate.
    assert value == pytest.approx(truth["plate.youngs_modulus"], rel=1e-3)
    # A cantilever has no rigid-body mode; the first one bends at about 3.52 √(D/ρh) / (2π L²) = 16 Hz.
    assert found.result["natural_frequencies_hz"][0] == pytest.approx(16.0, rel=0.05)


@pytest.mark.check
def test_a_logarithmic_interval_is_searched_by_ratios(bench, truth):
    interval = {"low": 1e-4, "high": 1.0, "scale": "log"}
    changes = {"effects.loss.stiffness_loss_factor": interval, "search.n_generation": 15}
    found = bench.run(changes=changes)
    value = found.result["parameters"]["loss.stiffness_loss_factor"]["value"]
    # 15 generations bring the logarithm to a thousandth of its interval of ln 1e4 = 9.2.
    assert value == pytest.approx(truth["loss.stiffness_loss_factor"], rel=1e-2)
    first = next(row["loss.stiffness_loss_factor"] for row in rows(found.folder))
    assert math.log10(float(first)) < -1


def test_powers_of_ten_are_numbers_however_they_are_written(bench):
    text = """
mesh: {length_x: 41e-2, length_y: 0.29, n_x: 3, n_y: 2}
measurement: {file: plate.npz, band: [8, 4e2]}
effects:
  plate: {effect: plate, youngs_modulus: 2.04e11, poisson_ratio: 0.31, density: 7.7E+3, thickness: 3.1e-3}
  wires: {effect: support_spring, nodes: [2, 5, 11], stiffness: 1310, viscous_damping: {value: 83e-2, std: 1e-3}}
  loss: {effect: hysteretic_damping, stiffness_loss_factor: 6.2e-3}
search: {n_generation: 1e2}
"""
    found = run(bench.write(text), bench.folder / "out")
    assert found.result["objective"] < 1e-12
    assert found.result["search"]["n_generation"] == 100
    saved = run(found.folder / "config.yaml", bench.folder / "again")
    assert saved.result == found.result


def test_a_finer_mesh_keeps_the_node_labels(bench):
    coarse = load_model(bench.folder / "truth.yaml")
    fine = load_model(bench.folder / "truth.yaml", ["mesh.refine=3"])
    nodes = list(range(1, 13))
    assert torch.equal(coarse.mesh.places(nodes), fine.mesh.places(nodes))
    frequency = torch.tensor([3.0, 5.0], dtype=torch.float64)
    nothing = coarse.known.new_zeros(0)
    # Rigid-body motion on the wires, which no mesh changes: bending begins at 100 Hz, so that it enters by (5/100)².
    one, two = (model.frf(nothing, frequency, nodes, [1, 8]) for model in (coarse, fine))
    assert float((one - two).norm() / two.norm()) < 2e-3


@pytest.mark.parametrize("edges", [{"x0": "clamped"}, {"y1": "simply_supported", "x1": "clamped"}])
def test_held_edges_take_their_dofs_out(bench, edges):
    free = load_model(bench.folder / "truth.yaml")
    held = load_model(bench.write(json.loads((bench.folder / "truth.yaml").read_text()) | {"mesh": mesh(edges)}))
    # Two clamped edges of 3 nodes: 9 dofs; a simply supported edge of 4 holds w and the slope along it.
    gone = {1: 9, 2: 9 + 2 * 4 - 2}[len(edges)]
    assert held.assembly.size == free.assembly.size - gone


def mesh(edges):
    return {"length_x": 0.41, "length_y": 0.29, "n_x": 3, "n_y": 2, "edges": edges}


@pytest.mark.usefixtures("drawn")
@pytest.mark.check
def test_a_run_on_any_device_finds_the_truth_and_goes_on(bench, make_config, truth, device):
    path = bench.write(make_config(["plate.youngs_modulus"], {"search.basis": "auto", "search.polish": True}))
    for n_generation in (3, 15):
        overrides = [f"search.n_generation={n_generation}"]
        found = run(path, bench.folder / "out", overrides, device=str(device), resume=n_generation > 3)
    value = found.result["parameters"]["plate.youngs_modulus"]["value"]
    # The search's own error: see the case of a free plate.
    assert value == pytest.approx(truth["plate.youngs_modulus"], rel=1e-3)
    assert (found.folder / "frf.png").is_file()


def test_a_run_on_an_impossible_device_is_refused(bench):
    with pytest.raises(InputError, match="--device"):
        run(bench.folder / "truth.yaml", bench.folder / "out", device="abacus")
    # torch answers with all that it knows, twenty names.
    with pytest.raises(InputError, match=r"--device gpu: .* Use cpu, or cuda for a GPU\.$"):
        run(bench.folder / "truth.yaml", bench.folder / "out", device="gpu")


def test_a_config_of_numbers_without_a_measurement_gives_natural_frequencies(bench):
    found = bench.run(changes={"measurement": ...})
    result = json.loads((found.folder / "result.json").read_text())
    model = load_model(bench.folder / "truth.yaml")
    expected = model.natural_frequencies(model.known.new_zeros(0), 20).tolist()
    # Two eigensolvers; the lowest, on soft springs, are small beside the largest eigenvalue.
    assert result["natural_frequencies_hz"] == pytest.approx(expected, rel=1e-5)
    assert set(result) >= set(RESULT)
    assert (result["objective"], result["parameters"]) == (None, {})


def test_a_sign_that_is_turned_is_printed_before_the_fit_that_it_explains(bench, make_config):
    bench.measure(gain=-1.0)
    path = bench.write(make_config())
    said = StringIO()
    found = run(path, bench.folder / "turned", console=Console(file=said, width=300))
    text = said.getvalue()
    assert text.count("With the sign of all FRFs turned") == 1
    assert (
        0
        <= text.index("With the sign of all FRFs turned")
        < text.index("As the FRFs stand, the model explains nothing")
    )
    assert found.caveats[0].startswith("With the sign")
