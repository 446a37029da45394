"""The report of a diagnosis says what the object says, in Markdown, in one HTML file, in figures and in TensorBoard."""

import base64
import html
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.patches import Ellipse
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchplate.cli.assurance_figure import caption
from torchplate.cli.diagnosis_figures import AFTER, BEFORE, MEASURED, N_PANEL, figure_digits, figures, png, shown
from torchplate.cli.diagnosis_report import N_CHANNEL, verdict_sentence, write_diagnosis
from torchplate.cli.log import log_diagnosis
from torchplate.diagnosis.assurance import csac_by_line, csf_by_line, fdac, fdac_frequency
from torchplate.diagnosis.result import (
    Band,
    ChannelGap,
    Diagnosis,
    Estimate,
    ForceMap,
    Gap,
    Location,
    Named,
    Overlay,
    Scored,
    Step,
)
from torchplate.effects import HystereticDamping, Plate, PointMass, SupportSpring
from torchplate.measurement import SI_UNIT, Channel, Measurement
from torchplate.model import PlateModel
from torchplate.plate import Mesh

PNG = b"\x89PNG\r\n\x1a\n"
SIDES = 0.5, 0.32
PLATE = {
    "plate.youngs_modulus": 6.6e10,
    "plate.poisson_ratio": 0.33,
    "plate.density": 2750.0,
    "plate.thickness": 0.004,
    "wires.stiffness": 2100.0,
    "wires.viscous_damping": 0.7,
    "loss.stiffness_loss_factor": 8.0e-3,
}
MASS = {"x": Estimate(0.213, 0.011, "-"), "y": Estimate(0.64, 0.023, "-"), "mass": Estimate(0.0512, 0.00037, "kg")}
NAMED = Named(
    "point_mass",
    "point_mass_1",
    {},
    ("density",),
    0.976,
    MASS,
    "It shows from 60 to 80 Hz & grows with ω²; a ground_spring leaves <b>half</b> of it | and density a third.",
    0.4567,
    0.01234,
)
SCORES = (
    Scored("density", {}, 0.713, {"value": 2901.5}, ("point_mass",), 0.0456, "equivalent"),
    Scored("point_mass", {}, 0.934, {"x": 0.2, "mass": 0.05}, ("density",), 0.0123, "named"),
    Scored("time_delay", {}, 0.0421, {"delay": 3.1e-5}, (), None, "rejected: |H| is right, the phase too"),
    Scored("edge_spring", {"edge": "x1"}, 0.318, {"stiffness": 1.5e4}, (), 0.391, "rejected: 60 Hz stays"),
)
LATER = (
    Scored("sensor_gain", {}, 0.0213, {"gain": 1.01}, (), 0.0121, "rejected: less than the noise"),
    Scored("thickness", {}, 0.011, {"value": 0.0041}),
)


def model(response: Sequence[int], reference: Sequence[int], mass: bool) -> PlateModel:
    effects = {"plate": Plate(), "wires": SupportSpring(nodes=(2, 5, 11)), "loss": HystereticDamping()}
    known = dict(PLATE)
    if mass:
        effects["point_mass_1"] = PointMass()
        known |= {f"point_mass_1.{name}": one.value for name, one in MASS.items()}
    return PlateModel(Mesh(*SIDES, 3, 2), effects, known, {}, list(response), list(reference), "accelerance")


def diagnosis(
    response: Sequence[int] = (4, 7), reference: Sequence[int] = (1, 6), mass: bool = True, n_line: int = 60
) -> Diagnosis:
    """A mass is missing on a plate of twelve nodes; without `mass` the baseline is all there is."""
    frequency = torch.linspace(6.0, 330.0, n_line, dtype=torch.float64)
    last = model(response, reference, mass)
    before, after = (one.frf(one.known[:0], frequency) for one in (model(response, reference, False), last))
    generator = torch.Generator().manual_seed(3)
    noise = (0.01 * after.abs().square().mean(0).sqrt()).expand(after.shape).clone()
    white = torch.complex(*torch.randn(2, *after.shape, generator=generator, dtype=torch.float64))
    measured = Measurement(
        frequency=frequency,
        frf=after + noise * white,
        measured=torch.ones(after.shape[1:], dtype=torch.bool),
        response=tuple(map(Channel, response)),
        reference=tuple(map(Channel, reference)),
        kind="accelerance",
        unit=SI_UNIT["accelerance"],
    )
    heldout = torch.zeros(after.shape[1:], dtype=torch.bool)
    several = heldout.numel() > 1
    heldout[-1, 0] = several
    gaps = [(frf - measured.frf).norm(dim=0) / measured.frf.norm(dim=0) for frf in (before, after)]
    channels = [
        ChannelGap(
            measured.response[j].label,
            measured.reference[k].label,
            float(gaps[0][j, k]),
            float(gaps[1][j, k]),
            0.01,
            bool(heldout[j, k]),
        )
        for j, k in measured.pairs
    ]
    x, y = torch.linspace(0, 1, 9, dtype=torch.float64), torch.linspace(0, 1, 7, dtype=torch.float64)
    index = 0.87 * torch.exp(-((x - 0.2) ** 2 + (y[:, None] - 0.6) ** 2) / 0.05)
    steps = (Step("baseline", 0.4567, 0.4812, 2345.0),)
    if mass:
        steps += (Step("+ sensor_gain", 0.3111, 0.3222, 1111.0), Step("+ point_mass", 0.01234, 0.01345, 1.04))
        steps += (Step("- sensor_gain", 0.01256, 0.01367, 1.05),)
    final = (0.01256, 0.01367) if mass else (0.4567, 0.4812)
    return Diagnosis(
        verdict="explained" if mass else "unexplained",
        effects=(NAMED,) if mass else (),
        gap=Gap(0.4567, final[0], 0.4812 if several else None, final[1] if several else None, 0.0111),
        location=Location(
            bands=(Band(60.0, 80.0, 0.61), Band(200.0, 230.0, 0.22)),
            channels=tuple(sorted(channels, key=lambda one: -one.before)),
            kind={"stiffness": 0.317, "damping": 0.0231, "mass": 0.912},
            map=ForceMap(x, y, index) if several else None,
            sentences=("61 % of the misfit sits at 60 to 80 Hz.",),
        ),
        scores=(SCORES, LATER) if mass else (SCORES,),
        steps=steps if several else tuple(replace(step, heldout=None) for step in steps),
        missing=() if mass else ("Near x 0.2, y 0.6 at 60 to 80 Hz a force like a mass is missing.",),
        remarks=("plate.thickness is at the edge of its tolerance.",),
        next_measurements=("Weigh the plate.", "Move the sensor to node 6."),
        parameters={
            "plate.youngs_modulus": Estimate(6.6123e10, 1.4e7, "Pa"),
            "wires.viscous_damping": Estimate(0.70123, None, "N s/m"),
        },
        model=last,
        overlay=Overlay(measured, noise, before, after, heldout),
        n_evaluation=4321,
        seconds=12.5,
    )


class Page(HTMLParser):
    """What a browser would see: words, tables as rows of cells, pictures, and what it would fetch."""

    blocks = ("td", "th", "li", "p", "h1", "h2", "pre", "figcaption", "footer")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words, self.tables, self.lists, self.images, self.fetched = "", [], [], [], []
        self.tags, self.marked, self.block = [], [], None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append(tag)
        self.fetched += [found[key] for key in ("src", "href", "srcset", "data", "action") if key in found]
        if tag == "img":
            self.images.append(found["src"])
        elif tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
            self.marked.append(found.get("class") == "marked")
        elif tag in ("ol", "ul"):
            self.lists.append((tag, []))
        elif tag == "br":
            self.handle_data("\n")
        elif tag in self.blocks:
            self.block = tag
            if tag in ("td", "th"):
                self.tables[-1][-1].append("")
            elif tag == "li":
                self.lists[-1][1].append("")

    def handle_endtag(self, tag):
        if tag == self.block:
            self.block = None
            self.words += "\n"

    def handle_data(self, data):
        if self.block is None:
            return
        self.words += data
        if self.block in ("td", "th"):
            self.tables[-1][-1][-1] += data
        elif self.block == "li":
            self.lists[-1][1][-1] += data

    def table(self, head: str) -> list[dict[str, str]]:
        """The rows of the one table whose first column is called so, by column."""
        (found,) = [table for table in self.tables if table[0][0] == head]
        return [dict(zip(found[0], row, strict=True)) for row in found[1:]]


@dataclass
class Written:
    found: Diagnosis
    folder: Path

    @property
    def markdown(self) -> str:
        return (self.folder / "report.md").read_text()

    @property
    def html(self) -> str:
        return (self.folder / "report.html").read_text()

    @property
    def page(self) -> Page:
        return Page(self.html)


CASES = {
    "explained": lambda: diagnosis(),
    "consistent": lambda: replace(diagnosis(mass=False), verdict="consistent", missing=(), scores=()),
    "unexplained": lambda: diagnosis(mass=False),
    "single": lambda: replace(
        diagnosis((4,), (1,)),
        effects=(
            replace(NAMED, name="time_delay", label="time_delay", parameters={"delay": Estimate(3e-5, None, "s")}),
        ),
    ),
}


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> dict[str, Written]:
    folder = tmp_path_factory.mktemp("my plates")
    cases = {}
    for name, make in CASES.items():
        cases[name] = Written(make(), folder / name)
        write_diagnosis(name, cases[name].found, cases[name].folder, "torchplate diagnose plate.yaml")
    return cases


def percent(text: str) -> float:
    return float(text.removesuffix(" %")) / 100


def close(value: float):
    """As printed, with three digits."""
    return pytest.approx(value, rel=5e-3)


@pytest.mark.parametrize("case", CASES)
class TestEveryReport:
    def test_the_html_fetches_nothing_and_holds_the_figures_that_lie_beside_the_markdown(self, written, case):
        text, page, folder = written[case].html, written[case].page, written[case].folder
        assert not re.search(r"https?://|@import|url\(", text)
        assert not {"script", "link", "iframe", "object"} & set(page.tags)
        assert page.fetched == page.images
        held = [
            base64.b64decode(source.removeprefix("data:image/png;base64,"), validate=True) for source in page.images
        ]
        beside = {path.name: path.read_bytes() for path in (folder / "figures").iterdir()}
        assert sorted(held) == sorted(beside.values())
        assert all(content.startswith(PNG) and len(content) > 3000 for content in held)
        shown_in_markdown = re.findall(r"!\[[^\]]+\]\(figures/([a-z]+\.png)\)", written[case].markdown)
        assert sorted(shown_in_markdown) == sorted(beside)
        assert {path.name for path in folder.iterdir()} == {"report.md", "report.html", "figures"}

    def test_the_verdict_comes_first(self, written, case):
        sentence = verdict_sentence(written[case].found)
        title, first = written[case].markdown.split("\n\n")[:2]
        assert title == f"# Diagnosis of {case}"
        assert first == f"**{sentence}**"
        body = written[case].html.partition("</h1>")[2]
        assert body.lstrip().startswith(f'<p class="verdict {written[case].found.verdict}">')
        assert sentence.replace("`", "") in written[case].page.words

    def test_both_forms_have_the_same_words(self, written, case):
        plain = re.sub(
            r"!\[[^\]]*\]\([^)]*\)|```sh|^#+ |^- |^\d\. |---:?|<br>", "\n", written[case].markdown, flags=re.M
        )
        plain = html.unescape(re.sub(r"[`*]", "", plain).replace("\\|", " ").replace("|", " "))
        words = written[case].page.words.replace("|", " ").split()
        assert len(words) > 200
        assert sorted(words) == sorted(plain.split())

    def test_the_gaps_are_those_of_the_object(self, written, case):
        gap, page = written[case].found.gap, written[case].page
        table = page.table("gap, mean of ‖measured − model‖ / ‖measured‖")
        assert percent(table[0]["before"]) == close(gap.baseline)
        assert percent(table[0]["after"]) == close(gap.final)
        assert percent(table[0]["noise alone"]) == close(gap.noise_floor)
        if gap.heldout_baseline is None:
            assert len(table) == 1
            assert "held out" not in page.words
        else:
            assert percent(table[1]["before"]) == close(gap.heldout_baseline)
            assert percent(table[1]["after"]) == close(gap.heldout_final)
        steps = page.table("step")
        assert [row["step"] for row in steps] == [step.label for step in written[case].found.steps]
        for row, step in zip(steps, written[case].found.steps, strict=True):
            assert percent(row["gap, fitted"]) == close(step.gap)
            assert float(row["misfit"]) == close(step.misfit)
            assert ("gap, held out" in row) == (step.heldout is not None)
            assert step.heldout is None or percent(row["gap, held out"]) == close(step.heldout)

    def test_where_it_disagrees_is_that_of_the_object(self, written, case):
        location, page = written[case].found.location, written[case].page
        bands = page.table("band [Hz]")
        assert [row["band [Hz]"] for row in bands] == ["60 to 80", "200 to 230"]
        assert [percent(row["share of the squared misfit"]) for row in bands] == [0.61, 0.22]
        kinds = {
            row["of what kind"]: percent(row["part of the misfit it explains"]) for row in page.table("of what kind")
        }
        assert kinds == {kind: close(part) for kind, part in location.kind.items()}
        assert list(kinds) == ["mass", "stiffness", "damping"]
        for row, one in zip(page.table("FRF, response/reference"), location.channels, strict=True):
            assert row["FRF, response/reference"] == f"{one.response}/{one.reference}"
            assert (percent(row["gap before"]), percent(row["gap after"])) == (close(one.before), close(one.after))
            assert row[""] == ("held out" if one.heldout else "fitted")
        assert location.sentences[0] in page.words

    def test_the_courses_of_the_frfs_are_compared_by_their_frac(self, written, case):
        overlay = written[case].found.overlay
        rows = {row["FRF, response/reference"]: row for row in written[case].page.table("FRF, response/reference")}
        assert len(rows) == len(overlay.measured.pairs)
        for j, k in overlay.measured.pairs:
            row, true = rows[overlay.measured.pair_label(j, k)], overlay.measured.frf[:, j, k].numpy()
            for column, frf in (("FRAC before", overlay.before), ("FRAC after", overlay.after)):
                said = frf[:, j, k].numpy()
                expected = abs(np.vdot(true, said)) ** 2 / (np.vdot(true, true) * np.vdot(said, said)).real
                # Printed with three decimals.
                assert float(row[column]) == pytest.approx(expected, abs=5.1e-4)

    def test_the_assurance_criteria_are_explained_below_their_figure(self, written, case):
        said = caption(written[case].found.overlay)
        assert said in written[case].page.words
        assert f"](figures/assurance.png)\n\n*{said}*" in written[case].markdown
        assert ("with a single one they are always 1, and left out" in said) == (case == "single")
        assert ("dashed diagonal" in said) == (case != "single")

    def test_what_to_know_and_to_do_is_there(self, written, case):
        found, page = written[case].found, written[case].page
        assert ("ol", list(found.next_measurements)) in page.lists
        assert "1. Weigh the plate.\n2. Move the sensor to node 6." in written[case].markdown
        assert ("ul", list(found.remarks)) in page.lists
        assert ("What is missing and has no name" in page.words) == bool(found.missing)
        assert not found.missing or ("ul", list(found.missing)) in page.lists
        # The folder's name has a blank.
        line = f"torchplate run '{written[case].folder}/model.yaml'"
        assert line in page.words
        assert line in written[case].markdown
        assert "4321 evaluations in 12.5 s. Made by torchplate diagnose plate.yaml" in page.words

    def test_the_parameters_are_those_of_the_object(self, written, case):
        modulus, damping = written[case].page.table("parameter")
        assert (modulus["parameter"], modulus["unit"]) == ("plate.youngs_modulus", "Pa")
        assert float(modulus["value"]) == pytest.approx(6.6123e10, rel=1e-5)
        assert float(modulus["standard error"]) == 1.4e7
        assert (damping["parameter"], damping["standard error"]) == ("wires.viscous_damping", "not seen")


def test_a_named_effect_is_told_whole(written):
    page = written["explained"].page
    (row,) = _named(page)
    assert row["effect"] == "point_mass\nas point_mass_1"
    assert row["cannot be told from"] == "density"
    assert row["confidence"] == "97.6 %"
    assert row["found, ± standard error"].split("\n") == [
        "x 0.213 ± 0.011",
        "y 0.64 ± 0.023",
        "mass 0.0512 ± 0.00037 kg",
        "(at 106.5 mm, 204.8 mm)",
    ]
    assert (percent(row["gap before"]), percent(row["gap after"])) == (close(0.4567), close(0.01234))
    # Marks of HTML and of tables are text here.
    assert f"point_mass_1: {NAMED.evidence}" in page.words
    assert "b" not in page.tags
    assert "&lt;b>half&lt;/b>" in written["explained"].markdown


def _named(page: Page) -> list[dict[str, str]]:
    (table,) = [table for table in page.tables if "confidence" in table[0]]
    return [dict(zip(table[0], row, strict=True)) for row in table[1:]]


def test_every_score_is_listed_by_its_drop_and_what_later_steps_rejected_too(written):
    page = written["explained"].page
    (table,) = [table for table in page.tables if "it would be" in table[0]]
    rows = [dict(zip(table[0], row, strict=True)) for row in table[1:]]
    ranked = sorted(SCORES, key=lambda row: -row.expected_drop)
    assert [row["effect"].partition(",")[0] for row in rows] == ["point_mass", "density", "edge_spring", "time_delay"]
    for row, one in zip(rows, ranked, strict=True):
        assert percent(row["expected drop"]) == close(one.expected_drop)
        assert row["what became of it"] == one.remark
        assert row["parallel to"] == "\n".join(one.twins)
        assert (
            row["gap after a refit"] == "" if one.gap is None else percent(row["gap after a refit"]) == close(one.gap)
        )
    assert rows[0]["it would be"] == "x 0.2\nmass 0.05 kg"
    assert rows[2]["effect"] == "edge_spring, edge x1"
    assert rows[2]["it would be"] == "stiffness 1.5e+04 N/m²"
    assert sum(page.marked) == 1
    (later,) = [table for table in page.tables if "step" in table[0][1:]]
    assert later[1:] == [["sensor_gain", "2", "2.13 %", "1.21 %", "rejected: less than the noise"]]
    for one in SCORES:
        said = one.remark.replace("|", "\\|")
        line = rf"^\| \**`{one.name}`.*{re.escape(said)} \|$"
        assert re.search(line, written["explained"].markdown, re.MULTILINE)


def test_the_verdict_says_what_it_means():
    found = diagnosis()
    said = verdict_sentence(found)
    assert said.startswith("Explained: `point_mass` (or `density`, which these data cannot tell from it) was missing")
    assert "from 45.7 % to 1.26 %, where noise alone makes 1.11 %" in said
    two = replace(found, verdict="partly_explained", effects=(NAMED, replace(NAMED, name="orthotropy", equivalent=())))
    said = verdict_sentence(two)
    assert said.startswith("Partly explained: `point_mass` (or")
    assert "and `orthotropy` were missing" in said
    assert "still missing" in said
    bare = diagnosis(mass=False)
    assert verdict_sentence(bare).startswith("Unexplained:")
    assert "do not take the fitted values for those of the plate" in verdict_sentence(bare)
    said = verdict_sentence(replace(bare, verdict="consistent"))
    assert said.startswith("Consistent: the model as it is explains")
    finer = replace(bare, verdict="consistent", effects=(replace(NAMED, name="mesh_discretisation", equivalent=()),))
    assert "the model with `mesh_discretisation` added explains" in verdict_sentence(finer)


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.213, 0.011, "0.213 ± 0.011"),
        (6.6123456e10, 1.4e7, "6.6123e+10 ± 1.4e+07"),
        (0.003, 0.2, "0.003 ± 0.2"),
        (0.0, 0.2, "0 ± 0.2"),
        (1234.5678, None, "1235"),
        (2.5, 0.0, "2.5"),
    ],
)
def test_numbers_have_the_digits_that_their_error_leaves(value, std, text):
    assert figure_digits(value, std) == text


def test_a_probability_close_to_one_is_not_rounded_to_certainty(tmp_path):
    write_diagnosis("sure", replace(diagnosis(), effects=(replace(NAMED, confidence=0.99996),)), tmp_path)
    (row,) = _named(Page((tmp_path / "report.html").read_text()))
    assert row["confidence"] == "over 99.9 %"


def test_natural_frequencies_alone_have_a_report_without_frfs(tmp_path):
    nowhere = Location((), (), {}, None)
    found = replace(diagnosis(), overlay=None, location=nowhere)
    write_diagnosis("table", found, tmp_path)
    log_diagnosis(tmp_path, found)
    page = Page((tmp_path / "report.html").read_text())
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"gap.png", "map.png"}
    assert "Natural frequencies; 4321 evaluations" in page.words
    assert "Measured and modelled FRFs" not in page.words
    write_diagnosis("table", replace(found, effects=()), tmp_path / "bare")
    assert "Where model and measurement disagree" not in (tmp_path / "bare" / "report.md").read_text()
    assert {path.name for path in (tmp_path / "bare" / "figures").iterdir()} == {"gap.png"}


def test_many_frfs_are_listed_up_to_a_number(tmp_path, monkeypatch):
    monkeypatch.setattr("torchplate.cli.diagnosis_report.png", lambda _: PNG + bytes(8) + b"\0\0\4\0")
    write_diagnosis("many", diagnosis((4, 7, 9, 3), (1, 6, 8, 12, 2, 5, 10), n_line=12), tmp_path)
    page = Page((tmp_path / "report.html").read_text())
    assert len(page.table("FRF, response/reference")) == N_CHANNEL
    assert f"And {28 - N_CHANNEL} FRFs that were nearer" in page.words


def _assurance(found: Diagnosis) -> tuple[list[Axes], list[Axes]]:
    """The squares and the curves of the figure of the assurance criteria."""
    axes = figures(found)["assurance"].axes
    return [one for one in axes if one.get_title("left")], [one for one in axes if one.get_ylabel().endswith("[-]")]


class TestFigures:
    def test_there_is_a_map_where_there_is_a_place_to_show(self):
        whole = diagnosis()
        elsewhere = replace(NAMED, parameters={"value": Estimate(2900.0, 12.0, "kg/m³")})
        nowhere = replace(whole.location, map=None)
        assert set(figures(whole)) == {"gap", "bands", "frf", "assurance", "map"}
        assert "map" in figures(replace(whole, effects=(elsewhere,)))
        assert "map" in figures(replace(whole, location=nowhere))
        assert "map" not in figures(replace(whole, location=nowhere, effects=(elsewhere,)))
        assert set(figures(CASES["single"]())) == {"gap", "bands", "frf", "assurance"}

    def test_the_bars_are_the_steps_and_the_line_is_the_noise(self):
        found = diagnosis()
        axis = figures(found)["gap"].axes[0]
        widths = [bar.get_width() for container in axis.containers for bar in container]
        assert widths == [value for step in found.steps for value in (step.gap, step.heldout)]
        assert axis.get_xscale() == "log"
        assert axis.get_xlim()[0] < found.gap.noise_floor
        assert list(axis.lines[0].get_xdata()) == [found.gap.noise_floor] * 2
        colours = [to_hex(container[0].get_facecolor()).upper() for container in axis.containers]
        assert (colours[0], colours[-2]) == (BEFORE, AFTER)
        assert [text.get_text() for text in axis.texts] == [f"{100 * width:.3g} %" for width in widths]

    def test_a_gap_that_hardly_falls_has_a_linear_axis_from_zero(self):
        found = diagnosis()
        near = replace(found, gap=replace(found.gap, noise_floor=0.2), steps=(Step("baseline", 0.3, None, 2.0),))
        axis = figures(near)["gap"].axes[0]
        assert axis.get_xscale() == "linear"
        assert axis.get_xlim()[0] == 0

    def test_without_steps_the_bars_are_baseline_and_final(self):
        axis = figures(replace(diagnosis((4,), (1,)), steps=()))["gap"].axes[0]
        assert [bar.get_width() for container in axis.containers for bar in container] == [0.4567, 0.01256]

    def test_the_misfit_of_each_line_is_over_its_noise_and_leaves_unmeasured_pairs_out(self):
        found = diagnosis()
        overlay = found.overlay
        keep = torch.tensor([[True, False], [True, True]])
        measured = replace(overlay.measured, measured=keep)
        axis = figures(replace(found, overlay=replace(overlay, measured=measured)))["bands"].axes[1]
        curves = {line.get_label(): line.get_ydata() for line in axis.lines}
        for label, frf in (("before", overlay.before), ("after", overlay.after)):
            squares = ((overlay.measured.frf - frf).abs() / overlay.noise).square()
            expected = squares[:, keep].sum(-1) / (2 * 3)
            np.testing.assert_allclose(curves[label], expected.numpy(), rtol=1e-10)
        # The truth leaves noise alone, whose mean square is one.
        assert 0.85 < np.mean(curves["after"]) < 1.15
        spans = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in axis.patches]
        assert spans == [(60.0, 80.0), (200.0, 230.0)]
        texts = [text.get_text() for text in axis.figure.axes[0].texts]
        assert texts == ["61 %", "22 %"]

    def test_a_line_without_noise_is_left_out_and_not_infinite(self):
        found = diagnosis()
        noise = found.overlay.noise.clone()
        noise[7] = 0
        drawn = figures(replace(found, overlay=replace(found.overlay, noise=noise)))["bands"]
        values = drawn.axes[1].lines[0].get_ydata()
        assert np.isnan(values[7])
        assert np.isfinite(np.delete(values, 7)).all()
        assert png(drawn).startswith(PNG)

    def test_curves_are_decibels_and_degrees_of_the_frfs(self):
        found = diagnosis()
        overlay, pairs = found.overlay, shown(found, N_PANEL)
        axes = figures(found)["frf"].axes
        assert len(pairs) == 4
        for index, (j, k) in enumerate(pairs):
            amplitude, phase = axes[4 * (index // 2) + index % 2], axes[4 * (index // 2) + index % 2 + 2]
            assert amplitude.get_title("left") == overlay.measured.pair_label(j, k)
            frfs = (overlay.measured.frf, overlay.before, overlay.after)
            for drawn, turned, frf, colour in zip(
                amplitude.lines, phase.lines, frfs, (MEASURED, BEFORE, AFTER), strict=True
            ):
                np.testing.assert_allclose(drawn.get_ydata(), 20 * frf[:, j, k].abs().log10().numpy(), rtol=1e-9)
                seen = turned.get_ydata()
                np.testing.assert_allclose(
                    seen[np.isfinite(seen)], np.degrees(frf[:, j, k].angle().numpy())[np.isfinite(seen)], rtol=1e-9
                )
                assert np.abs(np.diff(seen))[np.isfinite(np.diff(seen))].max() <= 180
                assert drawn.get_color() == turned.get_color() == colour
            unseen = bool(overlay.heldout[j, k])
            assert (
                ("held out" in amplitude.get_title("right"))
                == unseen
                == (to_hex(amplitude.get_facecolor()) != "#ffffff")
            )

    def test_frfs_that_no_fit_saw_come_first_then_the_worst(self):
        found = diagnosis((4, 7, 9), (1, 6, 8), n_line=12)
        measured = found.overlay.measured
        gap = {(one.response, one.reference): one.before for one in found.location.channels}

        def before(pair):
            return gap[measured.response[pair[0]].label, measured.reference[pair[1]].label]

        heldout = torch.zeros(3, 3, dtype=torch.bool)
        heldout[0, 1] = heldout[2, 2] = True
        pairs = shown(replace(found, overlay=replace(found.overlay, heldout=heldout)), 6)
        assert set(pairs[:2]) == {(0, 1), (2, 2)}
        assert before(pairs[0]) >= before(pairs[1])
        fitted = sorted(set(measured.pairs) - {(0, 1), (2, 2)}, key=before, reverse=True)
        assert pairs[2:] == fitted[:4]
        # Where more are held out than there are panels, the worst of the fitted keeps one.
        crowded = ~torch.eye(3, dtype=torch.bool)
        pairs = shown(replace(found, overlay=replace(found.overlay, heldout=crowded)), 4)
        assert [bool(crowded[pair]) for pair in pairs] == [True, True, True, False]
        assert pairs[3] == max([(0, 0), (1, 1), (2, 2)], key=before)

    def test_a_model_that_did_not_change_is_drawn_once(self):
        drawn = figures(diagnosis(mass=False))
        assert [line.get_label() for line in drawn["frf"].axes[0].lines] == ["measured", "model"]
        assert [line.get_label() for line in drawn["bands"].axes[1].lines] == ["model", "noise alone"]
        squares, curves = _assurance(diagnosis(mass=False))
        assert [axis.get_title("left") for axis in squares] == ["FDAC, model"]
        assert [line.get_label() for axis in curves for line in axis.lines] == ["model", "model"]

    def test_the_assurance_criteria_are_drawn_before_and_after(self):
        overlay = diagnosis().overlay
        squares, curves = _assurance(diagnosis())
        models = (overlay.before, overlay.after)
        for axis, criterion in zip(curves, (csac_by_line, csf_by_line), strict=True):
            assert axis.get_ylabel() == f"{criterion.__name__[:-8].upper()} [-]"
            assert [line.get_label() for line in axis.lines] == ["before", "after"]
            for drawn, frf, colour in zip(axis.lines, models, (BEFORE, AFTER), strict=True):
                np.testing.assert_array_equal(drawn.get_xdata(), overlay.measured.frequency)
                np.testing.assert_array_equal(drawn.get_ydata(), criterion(overlay.measured, frf))
                assert drawn.get_color() == colour
        line = fdac_frequency(overlay.measured).numpy()
        assert [axis.get_title("left") for axis in squares] == ["FDAC, before", "FDAC, after"]
        for axis, frf in zip(squares, models, strict=True):
            (mesh,) = axis.collections
            # The model's lines upwards.
            np.testing.assert_array_equal(mesh.get_array(), fdac(overlay.measured, frf))
            assert mesh.get_clim() == (0.0, 1.0)
            assert axis.get_box_aspect() == 1
            assert ("measured" in axis.get_xlabel(), "model" in squares[0].get_ylabel()) == (True, True)
            (diagonal,) = axis.lines
            assert list(diagonal.get_xdata()) == list(diagonal.get_ydata()) == [line[0], line[-1]]

    def test_a_single_frf_has_no_shapes_to_compare(self):
        squares, curves = _assurance(CASES["single"]())
        assert squares == []
        assert [axis.get_ylabel() for axis in curves] == ["CSF [-]"]
        assert np.ptp(curves[0].lines[0].get_ydata()) > 0.1

    def test_a_line_at_which_a_model_is_zero_has_no_criterion(self):
        found = diagnosis()
        before = found.overlay.before.clone()
        before[5] = 0
        _, curves = _assurance(replace(found, overlay=replace(found.overlay, before=before)))
        for axis in curves:
            assert list(np.isnan(axis.lines[0].get_ydata()).nonzero()[0]) == [5]
            assert np.isfinite(axis.lines[1].get_ydata()).all()

    def test_the_map_has_everything_at_its_place_in_millimetres(self):
        found = diagnosis()
        axis = figures(found)["map"].axes[0]
        marks = {line.get_marker(): np.column_stack(line.get_data()) for line in axis.lines}
        mesh, sides = found.model.mesh, 1e3 * np.array(SIDES)
        for marker, nodes in (("s", [2, 5, 11]), ("^", [4, 7]), ("o", [1, 6])):
            np.testing.assert_allclose(marks[marker], sides * mesh.places(nodes).numpy(), atol=1e-9)
        np.testing.assert_allclose(marks["P"], [[0.213 * 500, 0.64 * 320]])
        (ellipse,) = [patch for patch in axis.patches if isinstance(patch, Ellipse)]
        # 95 % of chi-square with two degrees of freedom lie below 5.991.
        axes = 2 * math.sqrt(5.991464547) * sides * [0.011, 0.023]
        np.testing.assert_allclose([ellipse.width, ellipse.height], axes, rtol=1e-9)
        np.testing.assert_allclose(ellipse.center, [106.5, 204.8])
        assert {text.get_text() for text in axis.texts} == {"4w", "7w", "1w", "6w"}
        assert axis.get_aspect() == 1.0
        assert "x 0.213 ± 0.011, y 0.64 ± 0.023" in axis.figure.legends[0].get_texts()[3].get_text()

    def test_a_place_whose_error_is_not_seen_has_no_ellipse(self):
        unseen = MASS | {"y": Estimate(0.64, None, "-")}
        axis = figures(replace(diagnosis(), effects=(replace(NAMED, parameters=unseen),)))["map"].axes[0]
        assert not [patch for patch in axis.patches if isinstance(patch, Ellipse)]

    def test_a_patch_is_square_and_a_moved_sensor_has_an_arrow(self):
        patch = MASS | {"size": Estimate(0.2, 0.01, "-")}
        moved = {"dx": Estimate(0.03, 0.001, "m"), "dy": Estimate(-0.02, 0.001, "m")}
        effects = (
            replace(NAMED, name="stiffness_loss", parameters=patch),
            replace(NAMED, name="sensor_position", options={"response": 7}, parameters=moved),
        )
        axis = figures(replace(diagnosis(), effects=effects))["map"].axes[0]
        (square,) = [one for one in axis.patches if one.get_linestyle() not in ("-", "solid")]
        assert square.get_width() == pytest.approx(200 * math.sqrt(0.5 * 0.32))
        assert square.get_height() == square.get_width()
        (arrow,) = [text for text in axis.texts if text.get_text() == ""]
        start = 1e3 * np.array(SIDES) * diagnosis().model.mesh.places([7])[0].numpy()
        np.testing.assert_allclose(arrow.xyann, start)
        np.testing.assert_allclose(arrow.xy, [start[0] + 30, start[1] - 20])

    def test_labels_on_the_map_lie_on_no_marker_and_on_no_other_label(self):
        # The mass lies where the label of node 6, at a third of x and half of y, would be.
        beside = replace(NAMED, parameters=MASS | {"x": Estimate(0.37, None, "-"), "y": Estimate(0.5, None, "-")})
        figure = figures(replace(diagnosis((4, 7, 1), (1, 6, 2, 5), n_line=12), effects=(beside,)))["map"]
        figure.draw_without_rendering()
        texts = figure.axes[0].texts
        assert {text.get_text() for text in texts} == {"4w", "7w", "1w", "6w", "2w", "5w"}
        boxes = [text.get_window_extent() for text in texts]
        assert not any(one.overlaps(other) for n, one in enumerate(boxes) for other in boxes[:n])
        for line in figure.axes[0].lines:
            for centre in figure.axes[0].transData.transform(np.column_stack(line.get_data())):
                assert not any(box.contains(*centre) for box in boxes)


class TestTensorBoard:
    @staticmethod
    def read(folder: Path) -> EventAccumulator:
        events = EventAccumulator(str(folder), size_guidance={"images": 0, "scalars": 0})
        events.Reload()
        return events

    def test_the_gaps_and_figures_are_logged_at_the_evaluations(self, tmp_path):
        found = diagnosis()
        log_diagnosis(tmp_path, found)
        events = self.read(tmp_path)
        names = ("baseline", "sensor_gain", "point_mass", "removed_sensor_gain")
        logged = {tag: events.Scalars(tag) for tag in events.Tags()["scalars"]}
        assert set(logged) == {f"gap/{part}{name}" for part in ("", "heldout/") for name in names}
        for name, step in zip(names, found.steps, strict=True):
            for tag, value in ((f"gap/{name}", step.gap), (f"gap/heldout/{name}", step.heldout)):
                (one,) = logged[tag]
                assert one.value == pytest.approx(value, rel=1e-6)
                assert one.step == 4321
        images = {f"frf/{response}w_{reference}w" for response in (4, 7) for reference in (1, 6)}
        images |= {"assurance", "map"}
        assert set(events.Tags()["images"]) == images
        assert all(events.Images(tag)[0].encoded_image_string.startswith(PNG) for tag in images)

    def test_a_second_diagnosis_replaces_the_first_and_leaves_what_a_search_wrote(self, tmp_path):
        search = tmp_path / "events.out.tfevents.1.here.2.0"
        search.write_bytes(b"")
        # Two effects of one kind keep apart.
        steps = (
            Step("baseline", 0.4, None, 9.0),
            Step("+ point_mass", 0.3, None, 5.0),
            Step("+ point_mass", 0.2, None, 1.0),
        )
        found = diagnosis((4,), (1,), n_line=12)
        log_diagnosis(tmp_path, replace(found, n_evaluation=7))
        log_diagnosis(tmp_path, replace(found, steps=steps))
        assert search.exists()
        events = self.read(tmp_path)
        assert set(events.Tags()["scalars"]) == {"gap/baseline", "gap/point_mass", "gap/point_mass_2"}
        assert [one.step for one in events.Scalars("gap/baseline")] == [4321]
        assert [events.Scalars(tag)[0].value for tag in ("gap/point_mass", "gap/point_mass_2")] == pytest.approx(
            [0.3, 0.2]
        )
