"""The report of a diagnosis says what the object says, in Markdown, in one HTML file and in TensorBoard."""

import html
import importlib.util
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchplate.cli.progress.log import log_diagnosis
from torchplate.diagnosis.result import Location, Step
from torchplate.report import verdict_sentence
from torchplate.report.diagnosis_tables import N_CHANNEL
from torchplate.report.figures.assurance import caption

_spec = importlib.util.spec_from_file_location("samples", Path(__file__).with_name("samples.py"))
assert _spec is not None
assert _spec.loader is not None
samples = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(samples)
CASES, NAMED, PNG, SCORES = samples.CASES, samples.NAMED, samples.PNG, samples.SCORES
# Rendering takes most of the time: `make check` renders two; tests/report/test_page.py draws one.
RENDERED = ("explained", "single") if "CHECKED_CALLS" in os.environ else ()
diagnosis, write_diagnosis, Page = samples.diagnosis, samples.write_diagnosis, samples.Page


@pytest.fixture
def unrendered(monkeypatch):
    """Rendering takes most of the time."""
    monkeypatch.setattr("torchplate.report.diagnosis.png", lambda _: PNG)
    monkeypatch.setattr("torchplate.report.forms.page.svg", lambda *_: "")


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> dict[str, samples.Written]:
    folder = tmp_path_factory.mktemp("my plates")
    cases = {}
    for name, make in CASES.items():
        cases[name] = samples.Written(make(), folder / name)
        with pytest.MonkeyPatch.context() as patch:
            if name not in RENDERED:
                patch.setattr("torchplate.report.diagnosis.png", lambda _: PNG)
                patch.setattr("torchplate.report.forms.page.svg", lambda *_: "")
            write_diagnosis(name, cases[name].found, cases[name].folder, "torchplate diagnose plate.yaml")
    return cases


def percent(text: str) -> float:
    return float(text.removesuffix(" %")) / 100


def close(value: float):
    """As printed, with three digits."""
    return pytest.approx(value, rel=5e-3)


@pytest.mark.parametrize("case", CASES)
class TestEveryReport:
    @pytest.mark.check
    def test_the_html_fetches_nothing_and_holds_the_figures_that_lie_beside_the_markdown(self, written, case):
        text, page, folder = written[case].html, written[case].page, written[case].folder
        assert not re.search(r"https?://|@import|url\((?!#)", text)
        assert not {"script", "link", "iframe", "object", "img"} & set(page.tags)
        # Links within the page, and shades of the FDAC as a picture within a figure.
        local = [one for one in page.fetched if not one.startswith("data:image/png;base64,")]
        assert all(one.startswith("#") and one.removeprefix("#") in page.ids for one in local)
        beside = {path.name: path.read_bytes() for path in (folder / "figures").iterdir()}
        assert all(content.startswith(PNG) for content in beside.values())
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
        plain = html.unescape(re.sub(r"[`*]|\\(?=\[)", "", plain).replace("\\|", " ").replace("|", " "))
        words = written[case].page.words.replace("|", " ").split()
        assert len(words) > 200
        assert sorted(words) == sorted(plain.split())

    def test_the_gaps_are_those_of_the_object(self, written, case):
        gap, page = written[case].found.gap, written[case].page
        table = page.table("FRFs")
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
        assert [percent(row["share of misfit"]) for row in bands] == [0.61, 0.22]
        kinds = {row["of what kind"]: percent(row["explains"]) for row in page.table("of what kind")}
        assert kinds == {kind: close(part) for kind, part in location.kind.items()}
        assert list(kinds) == ["mass", "stiffness", "damping"]
        for row, one in zip(page.table("FRF, response/reference"), location.channels, strict=True):
            assert row["FRF, response/reference"] == f"{one.response}/{one.reference}"
            assert (percent(row["gap before"]), percent(row["gap after"])) == (close(one.before), close(one.after))
            assert row["role in the fit"] == ("held out" if one.heldout else "fitted")
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
            row["gap at first refit"] == "" if one.gap is None else percent(row["gap at first refit"]) == close(one.gap)
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


@pytest.mark.check
def test_a_probability_close_to_one_is_not_rounded_to_certainty(tmp_path, unrendered):
    write_diagnosis("sure", replace(diagnosis(), effects=(replace(NAMED, confidence=0.99996),)), tmp_path)
    (row,) = _named(Page((tmp_path / "report.html").read_text()))
    assert row["confidence"] == "over 99.9 %"


@pytest.mark.check
def test_natural_frequencies_alone_have_a_report_without_frfs(tmp_path, unrendered):
    nowhere = Location((), (), {}, None)
    found = replace(diagnosis(), overlay=None, location=nowhere)
    write_diagnosis("table", found, tmp_path)
    log_diagnosis(tmp_path, found)
    page = Page((tmp_path / "report.html").read_text())
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"gap.png", "map.png", "modes.png"}
    assert "Natural frequencies; 4321 evaluations" in page.words
    assert "Measured and modelled FRFs" not in page.words
    write_diagnosis("table", replace(found, effects=()), tmp_path / "bare")
    assert "Where model and measurement disagree" not in (tmp_path / "bare" / "report.md").read_text()
    assert {path.name for path in (tmp_path / "bare" / "figures").iterdir()} == {"gap.png", "modes.png"}


@pytest.mark.check
def test_many_frfs_are_listed_up_to_a_number(tmp_path, unrendered):
    write_diagnosis("many", diagnosis((4, 7, 9, 3), (1, 6, 8, 12, 2, 5, 10), n_line=12), tmp_path)
    page = Page((tmp_path / "report.html").read_text())
    assert len(page.table("FRF, response/reference")) == N_CHANNEL
    assert f"And {28 - N_CHANNEL} FRFs that were nearer" in page.words


@pytest.mark.check
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
                assert [one.value for one in logged[tag]] == pytest.approx([value] * 2, rel=1e-6)
                assert [one.step for one in logged[tag]] == [0, 4321]
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
        assert [one.step for one in events.Scalars("gap/baseline")] == [0, 4321]
        assert [events.Scalars(tag)[0].value for tag in ("gap/point_mass", "gap/point_mass_2")] == pytest.approx(
            [0.3, 0.2]
        )


@pytest.mark.check
def test_the_places_of_a_candidate_have_three_digits(tmp_path, unrendered):
    place = 0.9656002751977983, 0.9080882352941176
    turned = samples.Scored("channel_polarity", {"channels": ((place, None),)}, 0.0, {}, (), None, "rejected")
    samples.write_diagnosis("plate", replace(samples.diagnosis(n_line=12), scores=((turned,),)), tmp_path)
    written = (tmp_path / "report.html").read_text()
    assert "[[[0.966, 0.908], any]]" in written
    assert "0.96560" not in written


def test_a_gap_in_the_table_of_scores_is_told_from_that_of_the_last_model(written):
    """53 % stood in the table beside 25 % in a sentence: a first refit of the effect, and where it ended."""
    page = written["explained"].page
    scored = [one for one in page.captions if "before any refit" in one or "later steps, beside" in one]
    assert len(scored) == 2
    for told in scored:
        assert "Gap at first refit: what the model with this effect leaves" in told
        assert "fitted to their end, stands above" in told
