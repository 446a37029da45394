"""A page says what it is told and nothing else: its text stays text, its tables, figures and sections have names."""

import importlib.util
import io
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from torchplate.report.blocks.channel_names import explained
from torchplate.report.blocks.document import (
    Command,
    Document,
    Heading,
    Listing,
    Panel,
    Paragraph,
    Picture,
    Table,
)
from torchplate.report.figures.drawing import VARIABLES, lay_out, pdf, png, svg
from torchplate.report.figures.style import BEFORE, INK, NARROW, ON_DARK, TITLE, dress
from torchplate.report.forms.markdown import markdown
from torchplate.report.forms.page import page
from torchplate.report.forms.page_style import style

_spec = importlib.util.spec_from_file_location("samples", Path(__file__).with_name("samples.py"))
assert _spec is not None
assert _spec.loader is not None
samples = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(samples)
HOSTILE = '<script>alert("1")</script> <img src=x onerror=y> ![a](http://b/c.png) `<b>` $\\frac{ a & b </style>'
TAGS = {"script", "img", "b", "link"}


def drawn(text: str = "a") -> Figure:
    figure = Figure(figsize=(2, 1))
    axis = figure.subplots()
    axis.plot([1, 2, 3], [1, 3, 2], color=INK)
    axis.set_title(text, parse_math=False)
    return figure


def hostile() -> Document:
    return Document(
        HOSTILE,
        HOSTILE,
        HOSTILE,
        [
            Heading(HOSTILE),
            Paragraph(HOSTILE),
            Listing([HOSTILE]),
            Table(HOSTILE, (f"{HOSTILE}.", f"{HOSTILE}>"), [(HOSTILE, HOSTILE)]),
            Picture("one", HOSTILE, (Panel(partial(drawn, HOSTILE), HOSTILE),)),
            Command(HOSTILE),
        ],
        HOSTILE,
    )


class TestTextStaysText:
    def test_no_text_becomes_a_tag_of_the_page(self):
        text = page(hostile())
        seen = samples.Page(text)
        assert not TAGS & set(seen.tags)
        # Of the page's own style.
        assert seen.tags.count("style") == text.count("</style>") == 1
        assert seen.images == [HOSTILE]
        shown = HOSTILE.replace("`", "")
        assert seen.words.count(shown) >= 6
        assert seen.tables == [[[f"{shown}.", shown], [shown, shown]]]

    def test_no_text_becomes_a_tag_or_a_picture_of_the_markdown(self):
        text = re.sub(r"`[^`]*`", "", markdown(hostile()).partition("```")[0])
        assert not re.search(r"<(?!br>)", text)
        # The figure alone is a picture.
        assert re.findall(r"(?<!\\)\]\((.*?)\)", text) == ["one.png"]

    @pytest.mark.check
    def test_a_unit_and_a_label_from_a_file_are_drawn_as_they_are(self, tmp_path):
        found = samples.diagnosis((4,), (1,), n_line=12)
        measured = replace(found.overlay.measured, unit="<b> $\\frac{ $")
        effect = replace(samples.NAMED, label=HOSTILE, evidence=HOSTILE)
        steps = (replace(found.steps[0], label=HOSTILE),)
        remarks = (HOSTILE,)
        found = replace(
            found, overlay=replace(found.overlay, measured=measured), effects=(effect,), steps=steps, remarks=remarks
        )
        samples.write_diagnosis(HOSTILE.replace("/", ""), found, tmp_path)
        seen = samples.Page((tmp_path / "report.html").read_text())
        assert not TAGS & set(seen.tags)
        assert seen.tags.count("style") == 1
        assert HOSTILE.replace("`", "") in seen.words


class TestNames:
    BLOCKS = (
        Heading("What was missing?"),
        Table("Rows, named.", ("what", "how many>"), [("a", "1"), ("b", "2")], frozenset({1})),
        Heading("What was missing?"),
        Picture("gap", "How to read it.", (Panel(drawn, "It falls to 2 %."),)),
        Heading("Third"),
        Heading("Fourth"),
    )

    def test_every_section_has_an_anchor_of_its_own_and_a_link_to_it(self):
        seen = samples.Page(page(Document("T", "F", "told", self.BLOCKS)))
        sections = ["what-was-missing", "what-was-missing-2", "third", "fourth"]
        assert [one for one in seen.ids if one in sections] == sections
        # Once from the top, once from the heading itself.
        assert sorted(one for one in seen.fetched if one[1:] in sections) == sorted(
            2 * [f"#{name}" for name in sections]
        )

    def test_a_short_report_begins_with_its_text(self):
        assert "<nav" not in page(Document("T", "F", "told", self.BLOCKS[:2]))

    def test_tables_have_a_caption_and_say_what_their_heads_are_heads_of(self):
        seen = samples.Page(page(Document("T", "F", "told", self.BLOCKS)))
        assert seen.captions == ["Rows, named."]
        assert seen.scopes == [[["col", "col"], ["row", None], ["row", None]]]
        assert seen.tables == [[["what", "how many"], ["a", "1"], ["b", "2"]]]
        assert seen.marked == [False, False, True]

    def test_a_figure_says_what_it_shows_to_who_does_not_see_it(self):
        text = page(Document("T", "F", "told", self.BLOCKS))
        assert samples.Page(text).images == ["It falls to 2 %."]
        assert text.count('<svg role="img"') == 1
        assert "![It falls to 2 %.](figures/gap.png)" in markdown(Document("T", "F", "told", self.BLOCKS), "figures/")


class TestFigures:
    def test_colours_are_those_of_the_page_and_each_has_one_on_dark_ground(self):
        text = svg(drawn(), "one", "a line")
        assert f"stroke: var({VARIABLES[INK]})" in text
        assert not set(re.findall(r"#[0-9a-f]{6}\b", text)) & set(VARIABLES)
        light, _, dark = style().partition("prefers-color-scheme: dark")
        for colour, name in VARIABLES.items():
            assert f"{name}: {colour};" in light
            assert f"{name}: " in dark
        assert f"{VARIABLES[BEFORE.lower()]}: {ON_DARK[BEFORE]};" in dark

    def test_no_two_figures_share_a_name_of_a_part(self):
        parts = [re.findall(r'id="([^"]+)"', svg(drawn(), name, "")) for name in ("one", "two")]
        assert parts[0]
        assert not set(parts[0]) & set(parts[1])

    def test_text_keeps_its_digits(self):
        assert "0.123456 and 3.14159265" in svg(drawn("0.123456 and 3.14159265"), "one", "")

    def test_nothing_points_outside_of_the_page(self):
        assert not re.search(r"https?:|xmlns|xlink|url\((?!#)", svg(drawn(), "one", ""))


@pytest.mark.check
def test_a_figure_that_is_laid_out_is_drawn_once_for_each_picture(monkeypatch):
    figure, draws, draw = drawn(), [], Figure.draw
    figure.set_layout_engine("constrained")
    before = figure.axes[0].get_position().bounds
    monkeypatch.setattr(Figure, "draw", lambda own, renderer: draws.append(own) or draw(own, renderer))
    for make in (png, partial(svg, name="one", told="a line"), pdf):
        make(figure)
        assert draws == [figure]
        draws.clear()
    # It was laid out.
    assert figure.axes[0].get_position().bounds != before


@pytest.mark.check
def test_ticks_are_laid_out_for_labels_that_are_there_alone_and_the_picture_is_the_same(monkeypatch):
    def drawn() -> Figure:
        figure = Figure(figsize=(4, 3), layout="constrained")
        for axes, label in zip(figure.subplots(2, 1, sharex=True), ("amplitude", ""), strict=True):
            axes.semilogy([3.0, 7.0, 11.0], [1e-3, 40.0, 0.2])
            axes.set_title("3w/28w", loc="left", y=TITLE)
            axes.set_ylabel(label)
            dress(axes)
        return figure

    plain, once = io.BytesIO(), drawn()
    once.get_layout_engine().execute(once)
    once.set_layout_engine(None)
    once.savefig(plain, format="png", dpi=80)
    sought = []
    labelled = Axis._get_tick_boxes_siblings
    monkeypatch.setattr(
        Axis, "_get_tick_boxes_siblings", lambda axis, renderer: sought.append(axis) or labelled(axis, renderer)
    )
    laid_out, figure = io.BytesIO(), drawn()
    lay_out(figure)
    figure.savefig(laid_out, format="png", dpi=80)
    assert laid_out.getvalue() == plain.getvalue()
    assert {axis.label.get_text() for axis in sought} == {"amplitude"}


def test_the_name_of_a_channel_is_explained_once_before_it_is_first_used():
    measured = samples.diagnosis((4, 7), (1, 6), n_line=4).overlay.measured
    blocks = [Paragraph("At 14w and 4wx nothing."), Listing(["x", "near 7w."]), Table("t", ("4w",), [])]
    first, told, *rest = explained(blocks, measured)
    assert [first, *rest] == blocks
    assert told.text == (
        "A channel is named by its node and direction: `4w` is the deflection w, out of the plate, at node 4 of the "
        "test sheet; `4w/1w` is the response at node 4 over the force at node 1."
    )
    assert list(explained(blocks[:1], measured)) == blocks[:1]


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """A page and a text of which each part is there."""
    found, folder = samples.diagnosis(n_line=30), tmp_path_factory.mktemp("whole")
    drops = {"density": -3.58e-283, "time_delay": -7.82}
    scores = tuple(replace(one, expected_drop=drops.get(one.name, one.expected_drop)) for one in samples.SCORES)
    with pytest.MonkeyPatch.context() as patch:
        # The page holds its figures itself.
        patch.setattr("torchplate.report.diagnosis.png", lambda _: b"")
        samples.write_diagnosis("whole", replace(found, scores=(scores,)), folder)
    return samples.Page((folder / "report.html").read_text()), (folder / "report.md").read_text()


@pytest.mark.check
def test_the_figures_of_a_diagnosis_state_their_results(shown):
    seen, text = shown
    told = " ".join(seen.images)
    for words in (
        "baseline 45.7 % (48.1 % on FRFs held out); + sensor_gain 31.1 %",
        "Noise alone makes 1.11 %",
        "The worst band, 60 to 80 Hz, holds 61 % of it",
        "FRF 7w/1w, which no fit saw: gap",
        "Mean over the lines: CSAC before",
        "FDAC of the model after: on the diagonal",
        "Found: point_mass at x 0.213 ± 0.011, y 0.64 ± 0.023 of the sides",
        "Marked: sensors at 4w, 7w; forces at 1w, 6w",
        "Mode 4 of the model at",
    ):
        assert words in told
        assert words in text
    assert not [one for one in seen.images if len(one) < 20]


@pytest.mark.check
def test_channels_are_explained_before_the_first_figure_that_names_them(shown):
    words = shown[0].words
    assert words.count("A channel is named by its node") == 1
    assert words.index("A channel is named by its node") < words.index("Where on the plate.")
    assert shown[1].index("A channel is named by its node") < shown[1].index("figures/map.png")


def test_no_percentage_has_an_exponent(shown):
    for text in (shown[0].words, " ".join(shown[0].images), shown[1]):
        assert not re.search(r"\de[-+]?\d+ %", text)
    assert "| `density` | 0 % |" in shown[1]


def test_what_would_add_to_the_misfit_is_said_to_take_none_of_it(shown):
    assert "| `time_delay` | none |" in shown[1]
    assert "none where it would add to it" in shown[1]


@pytest.mark.check
def test_every_figure_is_one_that_a_narrow_screen_holds_or_has_one_beside_it():
    from torchplate.report.diagnosis_figures import figures, panels

    found = samples.diagnosis(n_line=12)
    for name, parts in panels(found, figures(found)).items():
        narrow = [part for part in parts if part.screen != "wide"]
        assert narrow, name
        assert all(part.draw().get_figwidth() <= NARROW for part in narrow)


def test_no_line_breaks_between_a_number_and_its_sign_or_its_error():
    told = "0.3 %, −12.5 %, over 100 000 %, 0.0512 ± 0.00037 kg"
    kept = "0.3\u00a0%, −12.5\u00a0%, over 100\u00a0000\u00a0%, 0.0512\u00a0±\u00a00.00037 kg"
    blocks = [Table(told, ("a", "b>"), [(told, told)]), Paragraph(told), Listing([told])]
    document = Document("t", told, "good", blocks, "")
    found = page(document)
    assert found.count(kept) == 6
    assert "0.3 %" not in found.replace('aria-label="0.3 %', "")
    assert "\u00a0" not in markdown(document)
