"""Searches laid over each other."""

from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from torchplate.cli.compare import compare


def compared(folders, out):
    return compare(folders, out, Console(file=StringIO(), width=200))


def test_de_and_abc_are_laid_over_each_other(finished, tmp_path):
    folders = [found.folder for found in finished.found.values()]
    groups = compared(folders, tmp_path)
    assert list(groups) == ["differential_evolution best/1/bin", "artificial_bee_colony"]
    for group, found in zip(groups.values(), finished.found.values(), strict=True):
        assert group.objective.tolist() == [found.result["objective"]]
        assert group.theta[0].tolist() == [entry["value"] for entry in found.result["parameters"].values()]
        assert group.history.n_evaluation[0, -1] == found.result["n_evaluation"]
    text = (tmp_path / "comparison.md").read_text()
    for words in (*groups, *finished.searched, "evaluations to within 1 % of the best", "](comparison.png)"):
        assert words in text
    assert (tmp_path / "comparison.png").stat().st_size > 5000


def test_the_comparison_goes_into_the_folder_above_the_runs(finished, command):
    folders = [found.folder for found in finished.found.values()]
    status, out, _ = command("compare", *folders)
    assert status == 0
    assert (folders[0].parent / "comparison.md").is_file()
    assert "comparison.md" in out


@pytest.fixture
def seeds(bench, monkeypatch):
    """Two seeds of one DE, two repeats of the same in one run, and a DE with another weight."""
    monkeypatch.setattr("torchplate.cli.compare.png", lambda *_: b"")
    runs = {"a": {}, "b": {"search.seed": 8}, "c": {"search.n_repeat": 2}, "d": {"search.differential_weight": 0.4}}
    return [
        bench.run(["plate.youngs_modulus"], {"search.n_generation": 4} | changes, name).folder
        for name, changes in runs.items()
    ]


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
