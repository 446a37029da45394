"""`search: {optimizer: least_squares}`: many starts in one batch, written down like any other search."""

import csv
import json
import math
from dataclasses import replace

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchplate.cli.config.build import load_run
from torchplate.cli.config.searches import SEARCHES
from torchplate.cli.verbs.compare import compare
from torchplate.measurement import Measurement
from torchplate.search import OPTIMIZERS, LeastSquaresStatus

SEARCHED = ["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"]
SEARCH = {"optimizer": "least_squares", "n_member": 6, "n_generation": 40, "seed": 1, "basis": "full"}


def search(**settings):
    return {"search": SEARCH | settings}


def rows(folder):
    with (folder / "history.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.check
def test_finds_the_truth_of_exact_data(bench, truth):
    found = bench.run(SEARCHED, search())
    for name in SEARCHED:
        # Residuals vanish at the truth, where convergence is quadratic: to rounding over the condition number.
        assert found.result["parameters"][name]["value"] == pytest.approx(truth[name], rel=1e-6)
    assert found.result["status"] in {status.value for status in LeastSquaresStatus if status.settled}
    assert found.result["n_generation"] <= 40


@pytest.mark.check
def test_its_folder_is_that_of_any_search_but_for_the_checkpoint(bench):
    found = bench.run(SEARCHED, search(n_generation=3))
    other = bench.run(SEARCHED, {"search.n_generation": 3}, out="other")
    names, others = (
        {path.name for path in run.folder.iterdir() if "tfevents" not in path.name} for run in (found, other)
    )
    assert names == others - {"checkpoint.pt"}
    assert set(found.result) == set(other.result)
    assert [type(value) for value in found.result.values()] == [type(found.result[key]) for key in found.result]
    tags = []
    for run in (found, other):
        events = EventAccumulator(str(run.folder))
        events.Reload()
        tags.append(set(events.Tags()["scalars"]))
    assert tags[0] == tags[1]
    history = rows(found.folder)
    assert [int(row["generation"]) for row in history] == [0, 1, 2, 3]
    assert found.result["n_evaluation"] == int(history[-1]["n_evaluation"])


@pytest.mark.parametrize(("jacobian", "price"), [("autograd", 3), ("central", 6), ("forward", 3)])
@pytest.mark.check
def test_a_jacobian_counts_what_it_costs(bench, jacobian, price):
    history = rows(bench.run(SEARCHED, search(jacobian=jacobian, n_generation=1)).folder)
    # At each start a residual, a Jacobian and an objective; then a residual, and where it moves the other two again.
    assert int(history[0]["n_evaluation"]) == 6 * (2 + price)
    added = int(history[1]["n_evaluation"]) - int(history[0]["n_evaluation"])
    assert 6 <= added <= 6 * (2 + price)
    assert (added - 6) % (1 + price) == 0


@pytest.mark.parametrize("jacobian", ["autograd", "central"])
@pytest.mark.check
def test_a_budget_of_evaluations_is_never_exceeded(bench, jacobian):
    budget = 6 * 8 * 3 + 5
    found = bench.run(SEARCHED, search(jacobian=jacobian, n_evaluation=budget, n_repeat=2))
    for row in rows(found.folder)[-2:]:
        # A start that cannot pay for one more place stops: at most one place of 8 each is left.
        assert budget - 6 * 16 < int(row["n_evaluation"]) <= budget
    assert found.result["status"] == LeastSquaresStatus.budget.value


@pytest.mark.check
def test_repeats_are_searches_of_their_own(bench):
    found = bench.run(SEARCHED, search(n_repeat=3, n_generation=2))
    assert len(found.result["repeats"]["objective"]) == 3
    assert len(set(found.result["repeats"]["objective"])) == 3
    assert found.result["objective"] == min(found.result["repeats"]["objective"])
    assert {row["search"] for row in rows(found.folder)} == {"0", "1", "2"}


@pytest.mark.check
def test_the_seed_repeats_it_and_another_does_not(bench):
    one, two, other = (
        bench.run(SEARCHED, search(n_generation=2, seed=seed), out=out) for out, seed in [("a", 3), ("b", 3), ("c", 4)]
    )
    assert one.result == two.result
    assert rows(one.folder)[0] == rows(two.folder)[0] != rows(other.folder)[0]


@pytest.mark.check
def test_compare_lays_it_over_a_population_search(bench, tmp_path, monkeypatch):
    for kind in ("png", "pdf"):
        monkeypatch.setattr(f"torchplate.report.comparison.{kind}", lambda *_: b"")
    folders = [bench.run(SEARCHED, search(n_generation=5), out="a").folder]
    folders.append(bench.run(SEARCHED, {"search.n_generation": 5}, out="b").folder)
    (groups,) = compare(folders, tmp_path)
    assert list(groups) == ["least_squares", "differential_evolution best/1/bin"]
    assert groups["least_squares"].history.best.shape == (1, 6)


@pytest.mark.check
def test_polish_adds_nothing_to_it(bench):
    plain, polished = (
        bench.run(SEARCHED, search(n_generation=2, polish=polish), out=str(polish)) for polish in (False, True)
    )
    assert plain.result | {"search": 0} == polished.result | {"search": 0}


@pytest.mark.check
def test_a_measure_without_residuals_of_its_own_is_lowered_too(bench, truth):
    found = bench.run(SEARCHED, search() | {"objective": {"kind": "frac"}})
    assert found.result["objective"] < 1e-9
    assert found.result["parameters"][SEARCHED[0]]["value"] == pytest.approx(truth[SEARCHED[0]], rel=1e-6)


def test_resuming_it_is_refused_in_one_sentence(bench, make_config, command):
    bench.run(SEARCHED, search(n_generation=1))
    path = bench.write(make_config(SEARCHED, search(n_generation=2)))
    status, _, stderr = command("run", path, "--resume", "--out", bench.folder / "out")
    assert status == 2
    assert len(stderr.splitlines()) == 1
    assert "--resume" in stderr
    assert "least_squares, which keeps none. Leave --resume out" in stderr
    assert len(rows(bench.folder / "out")) == 2


@pytest.mark.parametrize("name", SEARCHES)
def test_an_unknown_search_is_told_all_that_there_are(bench, make_config, command, name):
    path = bench.write(make_config(SEARCHED, {"search": {"optimizer": "least_sqares"}}))
    status, _, stderr = command("run", path, "--out", bench.folder / "out")
    assert status == 2
    assert "Did you mean 'least_squares'?" in stderr
    assert name in stderr


def test_every_search_of_the_registry_can_be_named():
    assert set(SEARCHES) == {*OPTIMIZERS, "least_squares"}


BAD = {
    "target": ({"target": 0.1}, ["search.target", "0.1", "Take it out"]),
    "tolerance": ({"tolerance": 1e-8}, ["search.tolerance", "Take it out"]),
    "stagnation": ({"stagnation": 5}, ["search.stagnation", "5"]),
    "strategy of DE": ({"strategy": "rand/1/bin"}, ["search.strategy", "jacobian"]),
    "unknown jacobian": ({"jacobian": "exact"}, ["search.jacobian", "'autograd', 'central' or 'forward'", "exact"]),
    "no start": ({"n_member": 0}, ["n_member", "0"]),
    "no damping": ({"damping": 0.0}, ["damping", "0"]),
    "budget below the starts": ({"n_evaluation": 29}, ["search.n_evaluation", "30", "29", "search.n_member"]),
}


@pytest.mark.parametrize("case", BAD)
def test_a_setting_that_means_nothing_is_refused_in_one_sentence(bench, make_config, command, case):
    settings, words = BAD[case]
    path = bench.write(make_config(SEARCHED, search(**settings)))
    status, _, stderr = command("run", path, "--out", bench.folder / "out")
    assert status == 2
    assert len(stderr.splitlines()) == 1
    for word in words:
        assert word in stderr
    assert not (bench.folder / "out").exists()


def test_a_config_that_names_it_is_read(bench, make_config):
    optimizer = load_run(bench.write(make_config(SEARCHED, search(jacobian="central")))).optimizer()
    assert (optimizer.n_member, optimizer.jacobian) == (6, "central")


class TestWhatAResultSaysOfItsErrors:
    @pytest.mark.check
    def test_correlations_stand_beside_the_standard_errors(self, bench):
        # A plate too thin by 3 %, so that there is something to be uncertain about.
        found = bench.run(SEARCHED, search(n_generation=8) | {"effects.plate.thickness": 0.003})
        table = json.loads((found.folder / "result.json").read_text())["correlation"]
        assert table["names"] == SEARCHED
        assert [row[k] for k, row in enumerate(table["matrix"])] == pytest.approx([1.0] * 3, rel=1e-12)
        assert all(abs(number) <= 1 + 1e-12 for row in table["matrix"] for number in row)

    @pytest.mark.check
    def test_a_strong_correlation_is_said_in_the_report(self, bench):
        # Peaks fix E h² / ρ; the level, which is less exact, the rest.
        changes = search(n_generation=8) | {
            "effects.plate.density": [7000.0, 8400.0],
            "effects.wires.stiffness": 1300.0,
        }
        found = bench.run(["plate.youngs_modulus"], changes)
        value = found.result["correlation"]["matrix"][0][1]
        assert abs(value) > 0.9
        report = (found.folder / "report.md").read_text()
        assert f"| plate.youngs_modulus | plate.density | {value:+.3f} |" in report
        assert "go together" in report

    @pytest.mark.check
    def test_where_nothing_is_correlated_nothing_is_said(self, bench):
        searched = ["plate.youngs_modulus", "loss.stiffness_loss_factor"]
        found = bench.run(searched, search(n_generation=15) | {"effects.plate.thickness": 0.003})
        assert 0 < abs(found.result["correlation"]["matrix"][0][1]) < 0.9
        assert "go together" not in (found.folder / "report.md").read_text()

    def test_what_has_no_standard_error_has_no_correlation(self, bench):
        changes = {"measurement": {"natural_frequencies": {4: 104.0, 6: 230.0}}} | search(n_generation=2)
        found = bench.run(["plate.youngs_modulus", "wires.viscous_damping"], changes)
        (own, cross), _ = found.result["correlation"]["matrix"]
        assert own == pytest.approx(1.0)
        assert cross is None


class TestTheMeasuredNoise:
    def test_a_standard_deviation_of_a_natural_frequency_is_its_weight_and_its_noise(self, bench):
        table = {4: {"value": 104.0, "std": 0.1}, 6: {"value": 230.0, "std": 0.1}, 7: {"value": 262.0, "std": 0.1}}
        changes = {"measurement": {"natural_frequencies": table}} | search()
        one = bench.run(["plate.youngs_modulus"], changes, out="one")
        doubled = {mode: entry | {"std": 0.2} for mode, entry in table.items()}
        two = bench.run(
            ["plate.youngs_modulus"], changes | {"measurement": {"natural_frequencies": doubled}}, out="two"
        )
        (first,), (second,) = (run.result["parameters"].values() for run in (one, two))
        assert first["value"] == pytest.approx(second["value"], rel=1e-9)
        assert second["std"] == pytest.approx(2 * first["std"], rel=1e-6)
        # f ∝ √E with one f known to s: E is known to 2 s; three of them help by √3 at most.
        assert 2 * 0.1 / 262 / math.sqrt(3) < first["std"] / first["value"] < 2 * 0.1 / 104

    @pytest.mark.parametrize("kind", ["relative_frf_norm", "coherence_weighted"])
    @pytest.mark.check
    def test_a_coherence_of_more_averages_is_a_smaller_standard_error(self, bench, kind):
        frfs = Measurement.from_npz(bench.folder / "plate.npz")
        coherence = torch.full(frfs.frf.shape, 0.9, dtype=torch.float64)
        replace(frfs, coherence=coherence).to_npz(bench.folder / "plate.npz")
        changes = search(n_generation=2) | {"objective": {"kind": kind}}
        few, many = (
            bench.run(["plate.youngs_modulus"], changes | {"measurement.n_average": n}, out=str(n)).result["parameters"]
            for n in (8, 32)
        )
        # Variances go as 1 / (n − 1), and as 1 / (n − 3) where the same coherence also weighs the lines.
        expected = 31 / 7 if kind == "relative_frf_norm" else 29 / 5
        key = "plate.youngs_modulus"
        assert (few[key]["std"] / many[key]["std"]) ** 2 == pytest.approx(expected, rel=1e-9)

    def test_a_weight_scales_the_part_of_the_natural_frequencies(self, bench):
        changes = {"measurement": {"natural_frequencies": {4: 104.0, 6: 230.0}}}
        plain = bench.run(changes=changes, out="plain").result
        heavy = bench.run(changes=changes | {"objective.natural_frequency_weight": 3.0}, out="heavy").result
        assert heavy["objective"] == pytest.approx(3 * plain["objective"], rel=1e-12)
        assert heavy["gap"] == pytest.approx(plain["gap"], rel=1e-12)

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"objective": {"kind": "coherence_weighted"}}, ["objective.kind", "coherence", "relative_frf_norm"]),
            ({"objective": {"natural_frequency_weight": -1}}, ["objective.natural_frequency_weight", "greater than 0"]),
            ({"measurement.n_average": 1}, ["measurement.n_average", "greater than or equal to 2"]),
            ({"measurement.natural_frequencies": {4: {"value": 104.0, "sdt": 1}}}, ["natural_frequencies", "'std'"]),
            ({"measurement.natural_frequencies": {4: {"value": 104.0, "std": -1}}}, ["natural_frequencies", "-1"]),
        ],
    )
    def test_what_cannot_be_used_is_refused_in_one_sentence(self, bench, make_config, command, changes, words):
        path = bench.write(make_config(SEARCHED, changes))
        status, _, stderr = command("run", path, "--out", bench.folder / "out")
        assert status == 2
        assert len(stderr.splitlines()) == 1
        for word in words:
            assert word in stderr
