"""The pages that are made from the code: whole, true to it, the same each time, and light."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import torch

import torchplate
from torchplate.cli.arguments import VERBS
from torchplate.cli.verbs.keys import sections
from torchplate.effects import CATALOGUE

ROOT = Path(__file__).parents[2]
# Of one picture [bytes]: a photograph of the same size takes ten times that.
LIGHT = 9000


def test_every_section_and_key_of_a_config_is_on_its_page(pages):
    page = pages.configuration()
    for name, section in sections().items():
        assert f"{{#{name.replace('.', '-')}}}" in page
        for key in section.keys:
            assert f"| `{key.name}` |" in page
    # A cell that held a bar would end the row before its time.
    rows = [re.sub(r"\\\|", "", line) for line in page.splitlines() if line.startswith("| `")]
    assert {row.count("|") for row in rows} == {3, 7}


@pytest.mark.parametrize(
    "name", [name if name == "point_mass" else pytest.param(name, marks=pytest.mark.check) for name in CATALOGUE]
)
def test_every_effect_is_on_its_page_with_its_picture(pages, name):
    page = pages.effects([name])
    effect = CATALOGUE[name]
    assert f"{{#{name}}}" in page
    for told in (effect.shows, effect.source, *(one.meaning for one in effect.parameters.values())):
        assert told in page
    (drawn,) = re.findall(r"<div class=\"signature\".*?</div>", page)
    assert len(drawn.encode()) < LIGHT
    picture = ET.fromstring(drawn)
    assert picture.get("role") == "img"
    assert re.search(r"\d", picture.get("aria-label"))
    numbers = [float(number) for path in picture.iter() for number in re.findall(r"-?\d+\.\d", path.get("d") or "")]
    assert numbers
    assert all(0 <= number <= 400 for number in numbers)


def test_effects_that_pass_for_each_other_point_at_each_other(pages):
    assert "aspect_ratio" in dict(pages.twins("orthotropy"))
    assert "orthotropy" in dict(pages.twins("aspect_ratio"))
    assert {other for name in CATALOGUE for other, _ in pages.twins(name)} <= set(CATALOGUE)
    assert "**Passes for** [`aspect_ratio`](#aspect_ratio)" in pages.effects(["orthotropy"])


@pytest.mark.check
@pytest.mark.parametrize("name", ["orthotropy", "time_delay"])
def test_a_picture_is_the_same_each_time(pages, signature, name):
    example = pages.examples()[name]
    first, second = (
        signature.draw(signature.signature(CATALOGUE[name], example.options, example.value)) for _ in range(2)
    )
    assert first == second


@pytest.mark.check
def test_a_picture_shows_what_the_effect_does(pages, signature):
    def found(name):
        example = pages.examples()[name]
        return signature.signature(CATALOGUE[name], example.options, example.value)

    assert max(change for _, change in found("point_mass").shift) <= 1e-9
    assert min(change for _, change in found("ground_spring").shift) >= -1e-9
    # ω ∝ ρ^(−1/2) of the free plate; its springs are soft.
    changes = [change for _, change in found("density").shift]
    assert changes == pytest.approx([100 * ((2700 / 2480) ** 0.5 - 1)] * len(changes), rel=0.02)
    delay = found("time_delay")
    assert not delay.moves
    expected = -360 * 3e-4 * delay.frequency
    torch.testing.assert_close(delay.phase, expected, rtol=1e-6, atol=1e-6)
    assert bool((found("channel_polarity").phase == 180).all())


def test_a_line_is_thinned_to_what_the_eye_sees(signature):
    straight = [(float(x), 2.0 * x) for x in range(50)]
    assert signature.thinned(straight, 0.2) == [straight[0], straight[-1]]
    peak = [(0.0, 0.0), (1.0, 0.1), (2.0, 9.0), (3.0, 0.1), (4.0, 0.0)]
    assert peak[2] in signature.thinned(peak, 0.2)
    assert len(signature.thinned(peak, 20.0)) == 2


def test_every_verb_and_every_option_is_on_its_page(pages):
    page = pages.commands()
    for name, verb in VERBS.items():
        assert f"{{#{name}}}" in page
        assert all(line in page for line in verb.examples)
    assert "| `--out OUT` (required) |" in page
    # A page would take it for a tag, and leave it out.
    assert "runs/&lt;config name&gt;/&lt;time&gt;" in page


def test_every_public_name_is_on_its_page(pages):
    page = pages.python()
    assert all(f"`tp.{name}`" in page for name in torchplate.__all__ if not name.startswith("_"))


@pytest.mark.check
def test_claims_are_the_names_of_the_tests(pages):
    page = pages.claims()
    assert "- Claims are the names of the tests" in page
    assert "- A strip without poissons ratio is a beam" in page


@pytest.mark.check
def test_published_values_are_met_once_the_mesh_error_is_taken_off(pages):
    page = pages.benchmarks()
    last = [
        float(row.split("|")[6].strip(" %").replace("−", "-")) for row in page.splitlines() if re.match(r"\| \d", row)
    ]
    assert len(last) == 40
    # What `tests/plate/test_convergence.py` allows the extrapolated values: 0.25 %, most of it FV13's.
    assert max(abs(difference) for difference in last) < 0.25
