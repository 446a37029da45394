"""The report of a run says the fit in words, what was found with its unit and interval, and draws the FRFs."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from torchplate.discrepancy import Evidence, Objective
from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.identification import Result, nominal
from torchplate.identification.result import Value
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh
from torchplate.report import Convergence, convergence, model_report, run_report
from torchplate.report.figures.style import MEASURED, NARROW, NOMINAL, UPDATED
from torchplate.report.run_figures import frf_figure, overlay, shown

_spec = importlib.util.spec_from_file_location("samples", Path(__file__).with_name("samples.py"))
assert _spec is not None
assert _spec.loader is not None
samples = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(samples)
BOX = {"plate.youngs_modulus": (6.6e10, (5.0e10, 9.0e10)), "wires.stiffness": (2100.0, (1000.0, 4000.0))}
STATUS = "The budget is spent. Raise search.n_generation."
HISTORY = {"differential_evolution rand/1/bin": Convergence(np.array([[10.0, 20, 30]]), np.array([[3.0, 2.5, 2.0]]))}


@pytest.fixture(scope="module")
def objective() -> Objective:
    """Two numbers of a plate are searched; it was measured with a hundredth of noise."""
    measured = samples.diagnosis((4, 7), (1, 6), mass=False, n_line=40).overlay.measured
    effects = {"plate": Plate(), "wires": SupportSpring(nodes=(2, 5, 11)), "loss": HystereticDamping()}
    known = {name: value for name, value in samples.PLATE.items() if name not in BOX}
    boxes = {name: Searched(*ends) for name, (_, ends) in BOX.items()}
    model = PlateModel(Mesh(*samples.SIDES, 3, 2), effects, known, boxes, [4, 7], [1, 6], "accelerance")
    table = NaturalFrequencies(torch.tensor([4, 6]), torch.tensor([79.3, 181.0], dtype=torch.float64))
    return Objective(model, Evidence(measured, table))


def result(objective: Objective, gap: float = 0.0123) -> Result:
    theta = torch.tensor([truth for truth, _ in BOX.values()], dtype=torch.float64)
    values = {
        "plate.youngs_modulus": Value(float(theta[0]), 3.1e7, "Pa", False),
        "wires.stiffness": Value(float(theta[1]), None, "N/m", True),
    }
    return Result(
        values,
        2.0,
        "relative_frf_norm",
        gap,
        [11.5, 79.25],
        310,
        30,
        STATUS,
        3,
        "differential_evolution",
        {},
        theta,
        caveats=["wires.stiffness ended on <b>its</b> bound."],
        correlation=[[1.0, 0.97], [0.97, 1.0]],
    )


@pytest.fixture(scope="module")
def files(objective) -> dict[str, bytes]:
    return run_report("plate", objective, result(objective), 3, HISTORY, None, "torchplate run plate.yaml")


@pytest.fixture(scope="module")
def page(files):
    return samples.Page(files["report.html"].decode())


@pytest.mark.check
def test_the_figures_lie_beside_the_text_and_the_page_needs_none_of_them(files, page):
    assert set(files) == {"report.md", "report.html", "frf.png", "convergence.png", "natural_frequencies.png"}
    text = files["report.md"].decode()
    assert sorted(re.findall(r"\]\((\w+\.png)\)", text)) == sorted(name for name in files if name.endswith(".png"))
    assert not re.search(r"https?://|url\((?!#)|<img", files["report.html"].decode())
    assert all(one.startswith(("#", "data:image/png")) for one in page.fetched)


def test_the_fit_comes_first_in_words(objective, monkeypatch):
    # What is drawn is not asked for here.
    monkeypatch.setattr("torchplate.report.forms.page.svg", lambda *_: "")
    monkeypatch.setattr("torchplate.report.run.png", lambda *_: b"")
    for gap, mood in ((0.0123, "close"), (0.2, "partial"), (0.7, "poor"), (1.2, "poor")):
        found = result(objective, gap)
        text = run_report("plate", objective, found, 1)["report.html"].decode()
        assert f'</h1>\n<p class="verdict {mood}">' in text
        assert found.fit in re.sub("<[^>]*>", "", text).replace("\u00a0", " ")


def test_what_looks_wrong_with_the_frfs_stands_before_the_fit_that_it_explains(objective, monkeypatch):
    monkeypatch.setattr("torchplate.report.forms.page.svg", lambda *_: "")
    monkeypatch.setattr("torchplate.report.run.png", lambda *_: b"")
    sign, other = "With the sign of all FRFs turned the gap is 3 %.", "wires.stiffness ended on its bound."
    found = replace(result(objective, 1.81), misread=[sign], caveats=[sign, other])
    text = run_report("plate", objective, found, 1)["report.md"].decode()
    assert f"**{sign} {found.fit}**" in text
    assert text.count(sign) == 1
    assert f"**Note**: {other}" in text


def test_parameters_have_their_unit_their_error_and_the_interval_that_was_searched(page):
    (table,) = [table for table in page.tables if "unit" in table[0]]
    modulus, spring = (dict(zip(table[0], row, strict=True)) for row in table[1:])
    assert float(modulus["value"]) == pytest.approx(6.6e10, rel=1e-4)
    assert (modulus["standard error"], modulus["unit"]) == ("3.1e+07", "Pa")
    assert modulus["searched interval"] == "5e+10 to 9e+10"
    assert (spring["standard error"], spring["remark"]) == ("not seen", "on its bound")
    assert modulus["remark"] == ""
    assert "+0.970" in [cell for table in page.tables for row in table for cell in row]


def test_what_must_be_known_is_there_in_both_forms(files, page):
    for words in (
        STATUS,
        "gap 1.23 %",
        "310 evaluations in 30 generations",
        "11.50, 79.25",
        "torchplate run plate.yaml",
    ):
        assert words in page.words
        assert words in files["report.md"].decode().replace("**", "").replace("`", "")
    assert "ended on <b>its</b> bound" in page.words
    assert "b" not in page.tags
    modes = page.table("mode")
    assert [(row["mode"], row["measured [Hz]"]) for row in modes] == [("4", "79.3"), ("6", "181")]
    assert all(row["difference"].endswith(" %") for row in modes)


def test_the_figures_state_their_results(page):
    told = " ".join(page.images)
    assert "differential_evolution rand/1/bin: from 3 to 2 in 30 evaluations" in told
    assert "FRF 4w/1w: its gap is" in told
    assert "Mode 4 of the model at 7" in told
    assert "updated at most" in told


@pytest.mark.check
def test_a_model_of_numbers_alone_is_reported_without_a_search(objective, page):
    model = PlateModel(objective.model.mesh, objective.model.effects, samples.PLATE, {}, [4, 7], [1, 6], "accelerance")
    evidence = Evidence(objective.evidence.measurement)
    found = replace(result(objective), parameters={}, correlation=None, theta=model.known[:0])
    text = run_report("plate", Objective(model, evidence), found, 2)["report.html"].decode()
    seen = samples.Page(text)
    assert "Measured and modelled FRFs" in seen.words
    assert "Convergence" not in seen.words
    assert "evaluations in" not in seen.words
    alone = model_report("plate", model, replace(found, gap=None))
    assert set(alone) == {"report.md", "report.html"}
    assert alone["report.md"].decode().startswith("# plate\n\n**Natural frequencies [Hz], undamped")
    assert "Mode 4 of the model" in alone["report.html"].decode()


class TestFigures:
    def test_an_overlay_draws_the_measured_the_nominal_and_the_updated_frf(self, objective):
        theta = result(objective).theta
        drawn, pairs = overlay(objective, theta), shown(objective, 2)
        assert [pair.title for pair in pairs] == ["4w/1w", "7w/6w"]
        frfs = {
            MEASURED: objective.evidence.measurement.frf,
            NOMINAL: objective.frf(nominal(objective)),
            UPDATED: objective.frf(theta),
        }
        for axis, (j, k, title) in zip(frf_figure(drawn, pairs).axes, pairs, strict=True):
            assert axis.get_title("left") == title
            lines = {line.get_color(): line.get_ydata() for line in axis.lines}
            for colour, frf in frfs.items():
                np.testing.assert_allclose(lines[colour], frf[:, j, k].abs().numpy(), rtol=1e-12)
            gap = (frfs[UPDATED] - frfs[MEASURED])[:, j, k].norm() / frfs[MEASURED][:, j, k].norm()
            assert axis.get_title("right").endswith(f"→ {100 * float(gap):.3g} %")

    def test_a_narrow_figure_is_no_wider_than_a_narrow_screen(self, objective):
        drawn, pairs = overlay(objective, result(objective).theta), shown(objective, 1)
        for figure in (frf_figure(drawn, pairs, narrow=True), convergence(HISTORY, "x", narrow=True)):
            assert figure.get_figwidth() <= NARROW

    @pytest.mark.parametrize(("best", "scale"), [([8.31e-3, 8.08e-3, 8.07e-3], "linear"), ([0.4, 0.02, 0.013], "log")])
    def test_the_ticks_of_the_convergence_are_told_apart(self, best, scale):
        figure = convergence({"a": Convergence(np.array([[5.0, 10.0, 15.0]]), np.array([best]))}, "gap")
        figure.draw_without_rendering()
        axis = figure.axes[0]
        assert axis.get_yscale() == scale
        labels = [text.get_text() for text in axis.get_yticklabels() if text.get_text()]
        assert len(labels) > 1
        assert len(set(labels)) == len(labels)

    def test_convergence_is_the_median_with_quartiles_where_seeds_repeat(self):
        best = np.array([[9.0, 4.0], [8.0, 2.0], [7.0, 1.0]])
        left, right = convergence({"a": Convergence(np.array(3 * [[5.0, 10.0]]), best)}, "gap").axes
        np.testing.assert_array_equal(left.lines[0].get_xydata(), [[5, 8], [10, 2]])
        np.testing.assert_array_equal(right.lines[0].get_xdata(), [0, 1])
        assert len(left.collections) == 1
        assert len(convergence(HISTORY, "gap").axes[0].collections) == 0
