"""The verification page holds what its command prints."""

import re
import subprocess

import pytest

from torchplate.bench.marked_page import PAGE, between, commit, put
from torchplate.bench.published import NAFEMS, SQUARES
from torchplate.bench.verification import LONG, QUICK, TABLES, Row, page


def written() -> str:
    return between(PAGE.read_text(), QUICK)


@pytest.mark.check
@pytest.mark.parametrize("title", ["The virtual analyser", "Gradients where modes repeat", "Air around a plate"])
def test_the_page_has_what_the_command_prints(title: str) -> None:
    for row in TABLES[title]():
        assert row.cells() in written()


@pytest.mark.check
def test_the_whole_page_is_what_the_command_prints() -> None:
    assert page() == written()


def test_every_published_value_stands_on_the_page() -> None:
    text = written()
    for name, published in (*SQUARES.items(), *NAFEMS.items()):
        for value in published.values:
            assert f"| {published.source} | {value:.6g} |" in text, name


def test_no_figure_of_the_page_is_far_off() -> None:
    lines = [line for line in written().splitlines() if line.endswith("% |")]
    assert len(lines) > 50
    for line in lines:
        cell = line.split("|")[-2]
        off = float(re.sub(r"under|below|%|\s", "", cell).replace("−", "-"))
        # The order of convergence is 2 only in the end; all else is within a quarter of a percent.
        # A lattice of doublets, and tables of three decimals, are within one.
        assert abs(off) < (12 if "order" in line else 1.0 if "added mass" in line else 0.25), line


def test_a_difference_that_is_rounding_is_called_so() -> None:
    assert "below 1e-08" in Row("a", "b", 3.0, 3.0 * (1 + 1e-12)).cells()
    assert "−0.1 %" in Row("a", "b", 3.0, 3.0 * 0.999).cells()


def test_what_is_put_between_marks_changes_nothing_else() -> None:
    text = PAGE.read_text()
    assert put(text, QUICK, written()) == text
    changed = put(put(text, QUICK, "."), LONG, ".")
    assert put(put(changed, QUICK, written()), LONG, between(text, LONG)) == text


def test_a_page_without_its_marks_is_said() -> None:
    with pytest.raises(ValueError, match="Put them there"):
        between("no marks", QUICK)


def test_a_figure_is_of_a_commit_unless_other_files_than_the_documentation_differ(tmp_path):
    assert commit(tmp_path) == ""

    def git(*words):
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b", *words], cwd=tmp_path, check=True)

    for folder in ("docs", "src"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a").write_text("1")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "one")
    clean = commit(tmp_path / "src")
    assert re.fullmatch("[0-9a-f]{7,}", clean)
    (tmp_path / "docs" / "a").write_text("2")
    (tmp_path / "untracked").write_text("3")
    assert commit(tmp_path / "src") == clean
    (tmp_path / "src" / "a").write_text("2")
    assert commit(tmp_path / "src") == f"{clean}-dirty"
