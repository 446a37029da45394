"""Searches laid over each other."""

import csv
import json
import shutil
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from torchplate.cli.results.finished import by_plate, differences, read_finished
from torchplate.cli.verbs.compare import compare
from torchplate.report.forms.latex import escaped


def said(folders, out=None):
    """The comparisons, and what was printed."""
    printed = StringIO()
    return compare(folders, out, Console(file=printed, width=200)), printed.getvalue()


def compared(folders, out):
    """The comparison of one plate's runs."""
    (groups,), _ = said(folders, out)
    return groups


ABC = {"optimizer": "artificial_bee_colony", "n_member": 6, "n_generation": 4, "seed": 3, "basis": "full"}
RUNS = {"a": {}, "b": {"search.seed": 8}, "c": {"search.n_repeat": 2}, "d": {"search.differential_weight": 0.4}}
RUNS |= {"abc": {"search": ABC}}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Where the first test that needs the runs leaves them for the others."""
    return tmp_path_factory.mktemp("kept") / "runs"


@pytest.fixture
def runs(bench, kept):
    """The folder of all runs, each test's own copy."""
    if kept.exists():
        shutil.copytree(kept, bench.folder, dirs_exist_ok=True)
    else:
        for name, changes in RUNS.items():
            bench.run(["plate.youngs_modulus"], {"search.n_generation": 4} | changes, name)
        shutil.copytree(bench.folder, kept)
    return bench.folder


@pytest.fixture
def unrendered(monkeypatch):
    """Rendering takes most of the time of a comparison."""
    for kind in ("png", "pdf"):
        monkeypatch.setattr(f"torchplate.report.comparison.{kind}", lambda *_: b"")


@pytest.fixture
def seeds(runs, unrendered):
    """Two seeds of one DE, two repeats of the same in one run, and a DE with another weight."""
    shutil.rmtree(runs / "abc")
    return [runs / name for name in ("a", "b", "c", "d")]


@pytest.fixture
def two(runs):
    """One search by DE and one by ABC."""
    return [runs / "a", runs / "abc"]


def test_de_and_abc_are_laid_over_each_other(two, tmp_path):
    groups = compared(two, tmp_path / "compared")
    assert list(groups) == ["differential_evolution best/1/bin", "artificial_bee_colony"]
    for group, folder in zip(groups.values(), two, strict=True):
        result = json.loads((folder / "result.json").read_text())
        assert group.objective.tolist() == [result["objective"]]
        assert group.theta[0].tolist() == [entry["value"] for entry in result["parameters"].values()]
        assert group.history.n_evaluation[0, -1] == result["n_evaluation"]
    text = (tmp_path / "compared" / "comparison.md").read_text()
    for words in (*groups, "plate.youngs_modulus", "evaluations to within 1 % of the best", "](comparison.png)"):
        assert words in text
    assert (tmp_path / "compared" / "comparison.png").stat().st_size > 5000


@pytest.mark.usefixtures("unrendered")
def test_the_comparison_goes_into_the_folder_above_the_runs(two, command):
    status, out, _ = command("compare", *two)
    assert status == 0
    assert (two[0].parent / "comparison.md").is_file()
    assert "comparison.md" in out


def test_seeds_of_one_search_are_one_line(seeds, tmp_path):
    (group,) = compared(seeds[:3], tmp_path).values()
    assert group.objective.shape == (4,)
    assert group.theta.shape == (4, 1)
    assert group.history.best.shape == (4, 5)


def test_searches_of_other_settings_are_lines_of_their_own(seeds, tmp_path):
    groups = compared(seeds, tmp_path)
    assert [(name, len(group.objective)) for name, group in groups.items()] == [
        ("differential_evolution best/1/bin (differential_weight 0.6)", 4),
        ("differential_evolution best/1/bin (differential_weight 0.4)", 1),
    ]


def test_evaluations_to_the_best_count_up_to_the_first_row_within_a_hundredth(seeds, tmp_path):
    groups = compared(seeds, tmp_path)
    best = min(group.history.best.min() for group in groups.values())
    for group in groups.values():
        for row, steps, found in zip(group.history.best, group.history.n_evaluation, group.evaluations, strict=True):
            arrived = [step for value, step in zip(row, steps, strict=True) if value <= 1.01 * best]
            assert found == arrived[0] if arrived else np.isnan(found)
    assert any(np.isfinite(group.evaluations).any() for group in groups.values())


def test_the_rows_of_the_searches_go_together_over_repeats(seeds, tmp_path):
    compared(seeds[2:3], tmp_path)
    rows = table(tmp_path / "searches.csv")
    result = json.loads((seeds[2] / "result.json").read_text())
    assert [float(row["objective"]) for row in rows] == pytest.approx(result["repeats"]["objective"], rel=1e-9)
    ends = {}
    with (seeds[2] / "history.csv").open() as file:
        for row in csv.DictReader(file):
            ends[row["search"]] = row
    for row in rows:
        # The history has ten digits.
        (end,) = (
            one for one in ends.values() if float(one["best_objective"]) == pytest.approx(float(row["objective"]))
        )
        assert float(row["plate.youngs_modulus [Pa]"]) == pytest.approx(float(end["plate.youngs_modulus"]), rel=1e-8)


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_tables_hold_the_quartiles_over_the_seeds(seeds, tmp_path):
    (group,) = compared(seeds[:3], tmp_path).values()
    rows = {row["quantity"]: row for row in table(tmp_path / "comparison.csv")}
    for name, values in {"objective": group.objective, "plate.youngs_modulus": group.theta[:, 0]}.items():
        assert rows[name]["n"] == "4"
        for quantile, part in {"minimum": 0, "lower quartile": 0.25, "median": 0.5, "upper quartile": 0.75}.items():
            assert float(rows[name][quantile]) == pytest.approx(np.quantile(values, part), rel=1e-9)
    assert rows["plate.youngs_modulus"]["unit"] == "Pa"
    assert [row["run"] for row in table(tmp_path / "searches.csv")] == [str(seeds[place]) for place in (0, 1, 2, 2)]
    lower, middle, upper = np.quantile(group.theta[:, 0], [0.25, 0.5, 0.75])
    written = (tmp_path / "comparison.tex").read_text()
    assert rf"differential\_evolution best/1/bin & {middle:.6g} ({lower:.6g} to {upper:.6g}) \\" in written
    assert r"plate.youngs\_modulus [Pa]" in written


@pytest.mark.check
def test_figures_for_paper_are_pdf(two, tmp_path):
    compared(two, tmp_path)
    for name in ("convergence.pdf", "values.pdf"):
        assert (tmp_path / name).read_bytes().startswith(b"%PDF-")


@pytest.mark.check
def test_a_folder_of_runs_is_taken_apart_by_plate(seeds, bench, tmp_path):
    bench.run(["plate.youngs_modulus"], {"search.n_generation": 2, "mesh.refine": 2}, "e")
    bench.run(out="evaluated")
    (bench.folder / "stopped").mkdir()
    (bench.folder / "stopped" / "history.csv").write_text("")
    found, printed = said([bench.folder], tmp_path / "compared")
    assert sorted(sum(len(group.objective) for group in groups.values()) for groups in found) == [1, 5]
    assert "mesh.refine: left out against 2" in printed
    assert "stopped is left out" in printed
    assert "evaluated is left out" in printed
    assert {path.name for path in (tmp_path / "compared").iterdir()} == {"plate_1", "plate_2"}


@pytest.mark.check
def test_runs_that_are_named_and_of_two_meshes_are_refused(seeds, bench, command):
    fine = bench.run(["plate.youngs_modulus"], {"search.n_generation": 2, "mesh.refine": 2}, "e").folder
    status, _, error = command("compare", seeds[0], fine)
    assert status == 2
    assert "mesh.refine: left out against 2" in error
    assert "apart" in error


@pytest.mark.check
def test_runs_of_other_measurements_are_of_other_plates_and_copied_configs_of_the_same(seeds, bench):
    (bench.folder / "other.npz").write_bytes((bench.folder / "plate.npz").read_bytes())
    other = bench.run(
        ["plate.youngs_modulus"], {"search.n_generation": 2, "measurement.file": "other.npz"}, "deep/e"
    ).folder
    same = bench.run(["plate.youngs_modulus"], {"search.n_generation": 2, "search.seed": 9}, "deep/f").folder
    plates = by_plate([read_finished(folder) for folder in (seeds[0], other, same)])
    assert [[run.folder for run in group] for group in plates] == [[seeds[0], same], [other]]
    assert differences([group[0].plate for group in plates]) == [
        f"measurement.file: {bench.folder / 'plate.npz'} against {bench.folder / 'other.npz'}"
    ]


@pytest.mark.check
def test_searches_in_another_interval_are_a_line_of_their_own(seeds, bench, tmp_path):
    changes = {"search.n_generation": 4, "effects.plate.youngs_modulus": [1.9e11, 2.2e11]}
    narrow = bench.run(["plate.youngs_modulus"], changes, "narrow").folder
    groups = compared([seeds[0], narrow], tmp_path)
    assert [len(group.objective) for group in groups.values()] == [1, 1]
    assert any("plate.youngs_modulus in [190000000000.0, 220000000000.0]" in name for name in groups)


@pytest.mark.usefixtures("unrendered")
@pytest.mark.check
def test_comparisons_of_plates_in_folders_of_their_own_go_beside_their_runs(bench):
    for refine, home in ((1, "coarse"), (2, "fine")):
        bench.run(["plate.youngs_modulus"], {"search.n_generation": 1, "mesh.refine": refine}, f"runs/{home}/de")
    said([bench.folder / "runs"])
    assert (bench.folder / "runs" / "coarse" / "comparison.csv").is_file()
    assert (bench.folder / "runs" / "fine" / "comparison.csv").is_file()


@pytest.mark.usefixtures("unrendered")
@pytest.mark.check
def test_no_name_is_broken_on_a_screen_of_80_letters(bench, tmp_path):
    names = ["plate.youngs_modulus", "wires.stiffness", "wires.viscous_damping", "loss.stiffness_loss_factor"]
    bench.run(names, {"search.n_generation": 2}, "de")
    bench.run(names, {"search": ABC | {"n_generation": 2}}, "abc")
    printed = StringIO()
    compare([bench.folder / "de", bench.folder / "abc"], tmp_path / "out", Console(file=printed, width=80))
    words = printed.getvalue().split()
    assert {*names, "differential_evolution", "artificial_bee_colony"} <= set(words)
    assert max(len(line) for line in printed.getvalue().splitlines() if "Comparison" not in line) <= 80


def test_latex_sets_a_table_as_it_is_written():
    assert escaped("50 % of a_b & {c} \\ N/m²") == r"50 \% of a\_b \& \{c\} \textbackslash{} N/m\textsuperscript{2}"
