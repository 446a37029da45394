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
