"""A report in a browser: nothing is wider than the screen but tables in their own box, and every figure is there."""

import importlib.util
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from torchplate.report.figures.style import ON_DARK, PAPER


def _beside(name: str):
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


browser, samples = _beside("browser"), _beside("samples")
pytestmark = [
    pytest.mark.check,
    pytest.mark.skipif(browser.found() is None, reason="this machine has no Chromium"),
]
WIDTHS = (360, 768, 1440)
# A name that cannot be broken, and a sentence for each cell of a table.
LONG = "stiffness_of_the_left_" * 8
LOOK = """
JSON.stringify({
  body: document.documentElement.scrollWidth, screen: innerWidth,
  tables: [...document.querySelectorAll('.table')].map(box => [box.scrollWidth > box.clientWidth,
    getComputedStyle(box).overflowX, Math.ceil(box.getBoundingClientRect().right)]),
  captions: [...document.querySelectorAll('caption span')].map(one => Math.ceil(one.getBoundingClientRect().right)),
  cells: [...document.querySelectorAll('.table td, .table tbody th')].filter(cell => cell.textContent)
    .map(cell => Math.ceil(cell.getBoundingClientRect().right)),
  columns: [...document.querySelectorAll('.folded td')].filter(cell => cell.textContent)
    .map(cell => [getComputedStyle(cell, '::before').content, cell.dataset.column]),
  figures: [...document.querySelectorAll('svg[role=img]')].map(one => one.getBoundingClientRect())
    .filter(box => box.width > 0).map(box => [box.width, box.height, box.right]),
  hidden: [...document.querySelectorAll('svg[role=img]')].filter(one => !one.getBoundingClientRect().width).length,
  letters: [...document.querySelectorAll('svg[role=img]')].filter(one => one.getBoundingClientRect().width > 0).flatMap(
    one => [...one.querySelectorAll('text')].map(text => parseFloat(getComputedStyle(text).fontSize)
      * one.getBoundingClientRect().width / one.viewBox.baseVal.width)),
  images: [...document.querySelectorAll('svg image')].map(one => one.getBoundingClientRect().width > 0),
})
"""


@pytest.fixture(scope="module")
def shown():
    with browser.Browser(browser.found()) as one:
        yield one


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    found = samples.diagnosis(tuple(range(1, 11)), (1, 6), n_line=60)
    effect = samples.replace(found.effects[0], label=LONG)
    remarks = (*found.remarks, LONG)
    with pytest.MonkeyPatch.context() as patch:
        # The page holds its figures itself.
        patch.setattr("torchplate.report.diagnosis.png", lambda _: b"")
        samples.write_diagnosis("plate", samples.replace(found, effects=(effect,), remarks=remarks), folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def seen(shown, report):
    """What the browser has laid out on each screen."""
    found = {}
    for width in WIDTHS:
        shown.look(width)
        shown.open(report)
        found[width] = json.loads(shown.value(LOOK))
    return found


@pytest.mark.parametrize("width", WIDTHS)
class TestEveryScreen:
    def test_nothing_is_wider_than_the_screen(self, seen, width):
        assert seen[width]["screen"] == width
        assert seen[width]["body"] <= width
        assert all(right <= width for _, _, right in seen[width]["figures"])

    def test_a_table_scrolls_in_its_own_box_and_its_caption_stays(self, seen, width):
        assert all((overflow, right <= width) == ("auto", True) for _, overflow, right in seen[width]["tables"])
        assert all(right <= width for right in seen[width]["captions"])
        if width < max(WIDTHS):
            # On a tablet cells wrap, as on paper: what has to be scrolled to is not seen.
            assert not any(scrolls for scrolls, _, _ in seen[width]["tables"])

    def test_on_a_telephone_every_cell_is_on_the_screen_below_its_column(self, seen, width):
        told = seen[width]["columns"]
        assert len(told) > 60
        if width == min(WIDTHS):
            assert max(seen[width]["cells"]) <= width
            assert all(shown == json.dumps(name, ensure_ascii=False) for shown, name in told)
            assert {"after", "gap after", "found, ± standard error", "what became of it"} <= {name for _, name in told}
        else:
            assert {shown for shown, _ in told} == {"none"}

    def test_every_figure_is_there_and_of_a_wide_and_a_narrow_one_either(self, seen, width):
        assert all(min(size) > 40 for *size, _ in seen[width]["figures"])
        # gap, bands and map.
        assert seen[width]["hidden"] == 3
        # The shades of the FDAC, before and after.
        assert seen[width]["images"] == [True, True]

    def test_letters_of_the_figures_can_be_read(self, seen, width):
        # 8 points are 10.7 px; a telephone's screen takes 4 % off.
        assert min(seen[width]["letters"]) > 10
        assert len(seen[width]["letters"]) > 200


BROKEN = r"""
JSON.stringify([...document.querySelectorAll('td, th, p, li, caption, figcaption')].flatMap(cell => {
  const walk = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT), found = [];
  while (walk.nextNode()) for (const seen of walk.currentNode.data.matchAll(/[−\d.]+\s(%|± [\d.]+)/g)) {
    const range = document.createRange();
    range.setStart(walk.currentNode, seen.index);
    range.setEnd(walk.currentNode, seen.index + seen[0].length);
    found.push(new Set([...range.getClientRects()].map(box => Math.round(box.top))).size);
  }
  return found;
}))
"""
PLACED = """
JSON.stringify([...document.querySelectorAll('.either')].flatMap(box => [...box.querySelectorAll('svg')]
  .map(one => one.getBoundingClientRect()).filter(one => one.width > 0).map(one => [one.left, innerWidth - one.right])))
"""
LETTERS = LOOK.replace("JSON.stringify(", "JSON.stringify((").replace("\n})\n", "\n}).letters)\n")


@pytest.mark.parametrize("width", [280, 360, 600, 768, 800, 832, 833])
def test_on_every_narrow_screen_numbers_stay_whole_and_figures_are_legible_and_in_the_middle(shown, report, width):
    """A wide figure on a screen a little wider than a tablet had letters of 9 px; a narrow one stood on the left."""
    shown.look(width)
    shown.open(report)
    lines = json.loads(shown.value(BROKEN))
    assert len(lines) > 60
    assert set(lines) == {1}
    placed = json.loads(shown.value(PLACED))
    assert len(placed) == 3
    if width <= 832:
        assert all(abs(left - right) < 2 for left, right in placed)
    if width >= 360:
        assert min(json.loads(shown.value(LETTERS))) > 10


@pytest.mark.parametrize("width", [801, 900, 1100, 1248])
def test_no_table_has_to_be_scrolled_where_the_page_takes_the_whole_screen(shown, report, width):
    """The last column of what was considered ended within its words on every screen from 801 px on."""
    shown.look(width)
    shown.open(report)
    assert not any(scrolls for scrolls, _, _ in json.loads(shown.value(LOOK))["tables"])


def test_the_ground_follows_the_colours_that_the_reader_likes(shown, report):
    for scheme, colour in (("light", PAPER), ("dark", ON_DARK[PAPER])):
        shown.look(360, scheme)
        shown.open(report)
        with Image.open(io.BytesIO(shown.picture(600))) as image:
            pixels = np.asarray(image.convert("RGB")).reshape(-1, 3)
        values, count = np.unique(pixels, axis=0, return_counts=True)
        assert tuple(values[count.argmax()]) == tuple(bytes.fromhex(colour[1:]))
    # On paper it is light again.
    shown.look(700, "dark", "print")
    assert shown.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_paper_is_as_wide_as_what_stands_on_it(shown, report):
    # A4 less its margins, at 96 px to the inch.
    shown.look(680, "light", "print")
    shown.open(report)
    assert shown.value("document.documentElement.scrollWidth") <= 680


# What a header of a file may hold: were it taken for more than text, it would leave a mark.
HOSTILE = "<script>window.owned = 1</script><img src=x onerror='window.owned = 1'><svg onload='window.owned = 1'>"


def test_a_header_with_a_script_is_text_in_a_browser(shown, tmp_path, monkeypatch):
    found = samples.diagnosis(tuple(range(1, 11)), (1, 6), n_line=60)
    effect = samples.replace(found.effects[0], label=HOSTILE, evidence=f"{HOSTILE}.")
    monkeypatch.setattr("torchplate.report.diagnosis.png", lambda _: b"")
    told = samples.replace(found, effects=(effect,), remarks=(HOSTILE,))
    samples.write_diagnosis(HOSTILE, told, tmp_path)
    shown.look(768)
    shown.open(tmp_path / "report.html")
    assert shown.value("window.owned") is None
    assert shown.value("document.querySelectorAll('script, main img, [onload], [onerror]').length") == 0
    # It is there to be read: in the title, and in the text.
    assert HOSTILE in shown.value("document.title")
    assert shown.value("document.body.innerText").count("<script>window.owned = 1</script>") >= 3
