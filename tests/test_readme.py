"""What the README shows works as it stands there."""

import re
from pathlib import Path

import pytest
import torch
import yaml

from torchplate.cli.schema import Config

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.mark.check
def test_the_python_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    scope: dict[str, object] = {}
    for block in blocks("python"):
        exec(block, scope)
    assert scope["H"].shape == (2, 80, 1, 2)
    assert scope["H"].dtype == torch.complex128
    assert torch.isfinite(scope["gradient"]).all()
    assert float(scope["outcome"].best_objective) < 1e-3


def test_the_config_is_one():
    (block,) = blocks("yaml")
    config = Config.model_validate(yaml.safe_load(block))
    assert list(config.effects) == ["plate", "wires", "loss"]


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_config_is_one(path):
    from torchplate.cli.config.build import load_run

    recipe = load_run(path)
    recipe.optimizer()
    model = recipe.model()
    assert model.natural_frequencies(model.space.to_si(torch.full_like(model.space.low, 0.5)), 4)[3] > 0


def test_every_figure_and_page_it_links_to_is_there():
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", README) if not link.startswith("https://")]
    assert links
    for link in links:
        assert (ROOT / link).exists(), link


def test_it_is_short_and_its_lines_fit_a_screen():
    lines = README.splitlines()
    assert len(lines) <= 150
    assert not [line for line in lines if len(line) > 126]


def rate(table: str, what: str) -> tuple[int, int]:
    """How many of how many, of a row of a committed table of the benchmark."""
    row = next(line for line in (ROOT / "runs/blind" / table).read_text().splitlines() if line.startswith(f"| {what}"))
    n, of = (int(cell) for cell in row.split("|")[2:4])
    return n, of


def test_the_rates_are_those_of_the_tables_that_it_links_to():
    text = " ".join(README.split())
    right, false = "one effect, named right", "a false name, all but beyond"
    silent = "nothing hidden, called consistent"
    for table, cases in (("U/table.md", "clean cases"), ("workshop/T/table.md", "workshop plates")):
        (n, of), (kept, still), (both, pairs), (named, _) = (
            rate(table, what) for what in (right, silent, "two effects, both right", false)
        )
        every, _ = rate(table, "crashes")[::-1]
        assert (
            f"of [{every} {cases}](runs/blind/{table}) {n} of {of} single effects, {kept} of {still} with nothing "
            f"hidden, {both} of {pairs} pairs, and {named} false name{'s' * (named != 1)}" in text
        )
    (n, of), (named, every) = rate("tables/R/table.md", right), rate("tables/R/table.md", false)
    assert (
        f"of [{every} tables](runs/blind/tables/R/table.md) {n} of {of} detectable effects, and {named} false" in text
    )
    table = "states/F/table.md"
    (n, of), (named, still) = (rate(table, what) for what in ("named right, of those", "a false name on an unchanged"))
    every, _ = rate(table, "crashes")[::-1]
    assert (
        f"of [{every} pairs of tests](runs/blind/{table}) {n} of {of} changes, and {named} of {still} "
        "unchanged falsely" in text
    )


@pytest.mark.parametrize(
    "table", ["U", "V", "real/Q", "shapes/R", "shapes/U", "states/F", "tables/R", "workshop/S", "workshop/T"]
)
def test_the_map_of_runs_says_which_cases_the_committed_tables_are_of(table):
    head = (ROOT / "runs/blind" / table / "table.md").read_text().splitlines()[0]
    numbers = re.findall(r"\d+", re.match(r"Cases ([\d andto]+),", head)[1])
    which = rf"{numbers[0]} to {numbers[-1]} of (set )?{Path(table).name}\s"
    assert re.search(which, (ROOT / "runs/README.md").read_text())


LATER = ("V/74_to_89", "V/90_to_119", "workshop/T/59_to_87", "workshop/T/88_to_117", "tables/R/157_to_174")


@pytest.mark.parametrize("table", [f"{name}.md" for name in LATER])
def test_later_cases_of_a_set_lie_beside_its_table(table):
    name = Path(table).stem.replace("_", " ")
    assert (ROOT / "runs/blind" / table).read_text().startswith(f"Cases {name}, ")
    assert f"{name} of {Path(table).parent.name} (`{table}`)" in " ".join((ROOT / "runs/README.md").read_text().split())
