"""What the pages show works as it stands there: Python runs, configs are configs, commands can be given."""

import re
import shlex
from pathlib import Path

import pytest
import yaml

from torchplate.cli.arguments import VERBS
from torchplate.cli.main import parser
from torchplate.cli.schema import Config
from torchplate.effects import CATALOGUE, find_effect, options

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.rglob("*.md")), ROOT / "README.md"]
NAMES = {path: path.relative_to(ROOT).as_posix() for path in PAGES}


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(), re.DOTALL | re.MULTILINE)


def commands(path: Path) -> list[str]:
    lines = [line for block in blocks(path, "sh") for line in block.splitlines()]
    told = re.findall(r"`(torchplate [a-z][^`]*)`", path.read_text())
    return [line for line in [*lines, *told] if line.startswith("torchplate ")]


def of(what: str) -> list[Path]:
    return [path for path in DOCS.rglob("*.md") if blocks(path, what)]


@pytest.fixture
def clean_catalogue():
    kept = dict(CATALOGUE)
    yield
    CATALOGUE.clear()
    CATALOGUE.update(kept)


@pytest.mark.check
@pytest.mark.parametrize("path", of("python"), ids=NAMES.get)
def test_the_python_of_a_page_runs_from_top_to_bottom(path, monkeypatch, clean_catalogue):
    monkeypatch.chdir(ROOT)
    scope: dict[str, object] = {"__name__": "page"}
    for block in blocks(path, "python"):
        exec(compile(block, NAMES[path], "exec", dont_inherit=True), scope)


@pytest.mark.parametrize("path", of("yaml"), ids=NAMES.get)
def test_the_yaml_of_a_page_is_part_of_a_config(path):
    for block in blocks(path, "yaml"):
        said = yaml.safe_load(block)
        whole = {"mesh": {"length_x": 0.4, "length_y": 0.3, "n_x": 4, "n_y": 3}, "effects": {}} | said
        config = Config.model_validate(whole)
        for body in config.effects.values():
            kind = find_effect(body["effect"])
            assert set(body) - {"effect"} <= {*kind.parameters, *options(kind)}


@pytest.mark.parametrize("path", [path for path in PAGES if commands(path)], ids=NAMES.get)
def test_each_command_of_a_page_can_be_given(path):
    for line in commands(path):
        words = shlex.split(line, comments=True)[1:]
        if any(word.isupper() or word.endswith("...") for word in words) or len(words) == 1:
            # A pattern such as `torchplate run CONFIG`, or the bare name of a verb.
            assert words[0] in VERBS or words[0] == "VERB", line
        else:
            assert parser(words[0]).parse_args(words).verb == words[0], line


def test_every_verb_is_shown_on_some_page():
    shown = {line.split()[1] for path in PAGES for line in commands(path)}
    assert set(VERBS) <= shown


def test_every_chair_has_a_tutorial_that_shows_commands_or_code():
    tutorials = sorted((DOCS / "tutorials").glob("*.md"))
    assert len(tutorials) >= 3
    assert all(blocks(path, "sh") or blocks(path, "python") for path in tutorials)


def test_each_test_that_verification_names_is_there():
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", (DOCS / "verification.md").read_text())
    assert len(named) > 30
    for file, test in named:
        assert (ROOT / file).is_file(), file
        assert not test or f"def {test}(" in (ROOT / file).read_text(), test


def test_the_citation_is_one_and_of_this_version():
    told = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = (ROOT / "pyproject.toml").read_text()
    assert {"cff-version", "message", "title", "authors", "version"} <= set(told)
    assert told["cff-version"] == "1.2.0"
    assert f'version = "{told["version"]}"' in project
    assert all({"type", "title", "authors"} <= set(entry) for entry in told["references"])
