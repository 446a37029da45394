"""The figures of a diagnosis draw what the object holds, where it is."""

import importlib.util
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.patches import Ellipse

from torchplate.diagnosis.assurance import csac_by_line, csf_by_line, fdac, fdac_frequency
from torchplate.diagnosis.result import Diagnosis, Estimate, Step
from torchplate.report import png
from torchplate.report.diagnosis_figures import N_PANEL, figures, panels
from torchplate.report.figures.frf import shown
from torchplate.report.figures.mode_shapes import composite, mode_shapes, modes_of
from torchplate.report.figures.plate_map import plate_map
from torchplate.report.figures.style import AFTER, BEFORE, MEASURED

_spec = importlib.util.spec_from_file_location("samples", Path(__file__).with_name("samples.py"))
assert _spec is not None
assert _spec.loader is not None
samples = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(samples)
CASES, MASS, NAMED, PNG, SIDES = samples.CASES, samples.MASS, samples.NAMED, samples.PNG, samples.SIDES
diagnosis = samples.diagnosis


def _assurance(found: Diagnosis) -> tuple[list[Axes], list[Axes]]:
    """The squares and the curves of the figure of the assurance criteria."""
    axes = figures(found)["assurance"].axes
    return [one for one in axes if one.get_title("left")], [one for one in axes if one.get_ylabel().endswith("[-]")]


class TestFigures:
    @pytest.mark.check
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

    @pytest.mark.check
    def test_a_gap_that_hardly_falls_has_a_linear_axis_from_zero(self):
        found = diagnosis()
        near = replace(found, gap=replace(found.gap, noise_floor=0.2), steps=(Step("baseline", 0.3, None, 2.0),))
        axis = figures(near)["gap"].axes[0]
        assert axis.get_xscale() == "linear"
        assert axis.get_xlim()[0] == 0

    def test_without_steps_the_bars_are_baseline_and_final(self):
        axis = figures(replace(diagnosis((4,), (1,)), steps=()))["gap"].axes[0]
        assert [bar.get_width() for container in axis.containers for bar in container] == [0.4567, 0.01256]

    @pytest.mark.check
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

    @pytest.mark.check
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

    @pytest.mark.check
    def test_a_model_that_did_not_change_is_drawn_once(self):
        drawn = figures(diagnosis(mass=False))
        assert [line.get_label() for line in drawn["frf"].axes[0].lines] == ["measured", "model"]
        assert [line.get_label() for line in drawn["bands"].axes[1].lines] == ["model", "noise alone"]
        squares, curves = _assurance(diagnosis(mass=False))
        assert [axis.get_title("left") for axis in squares] == ["FDAC, model"]
        assert [line.get_label() for axis in curves for line in axis.lines] == ["model", "model"]

    @pytest.mark.check
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

    @pytest.mark.check
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

    @pytest.mark.check
    def test_the_legend_of_the_map_stays_within_its_picture(self):
        wide = {"x": Estimate(0.33351, 0.00658, "-"), "y": Estimate(0.52284, 0.0305, "-")}
        # With four of them each column of two would hold a long one.
        effects = tuple(replace(NAMED, name="ground_dashpot", parameters=MASS | wide) for _ in range(4))
        figure = figures(replace(diagnosis(), effects=effects))["map"]
        figure.draw_without_rendering()
        box = figure.legends[0].get_window_extent()
        assert figure.bbox.x0 <= box.x0
        assert box.x1 <= figure.bbox.x1
        texts = [text.get_text() for text in figure.legends[0].get_texts()]
        assert "ground_dashpot: x 0.3335 ± 0.0066, y 0.523 ± 0.03 of the sides" in texts

    @pytest.mark.check
    def test_a_place_whose_error_is_not_seen_has_no_ellipse(self):
        unseen = MASS | {"y": Estimate(0.64, None, "-")}
        axis = figures(replace(diagnosis(), effects=(replace(NAMED, parameters=unseen),)))["map"].axes[0]
        assert not [patch for patch in axis.patches if isinstance(patch, Ellipse)]

    @pytest.mark.check
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

    @pytest.mark.parametrize("sides", [(0.6, 0.03), pytest.param((0.05, 0.7), marks=pytest.mark.check)])
    def test_a_thin_plate_leaves_room_for_its_axes(self, sides, monkeypatch):
        monkeypatch.setattr(samples, "SIDES", sides)
        found = diagnosis(tuple(range(1, 13)), (1, 6), n_line=60)
        whole = figures(found)
        parts = panels(found, whole)["map"]
        modes = modes_of(found.model, found.model.known[:0], found.overlay.measured)
        for drawn in (*(part.draw() for part in parts), mode_shapes(modes, sides)[0].draw(), composite(modes, sides)):
            # A layout that collapses warns, and a warning is an error here.
            assert png(drawn).startswith(PNG)

    @pytest.mark.check
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

    @pytest.mark.check
    @pytest.mark.parametrize("narrow", [False, True])
    def test_labels_of_channels_at_the_edges_lie_on_no_number_of_an_axis(self, narrow):
        figure = plate_map(diagnosis((1, 5, 9, 4), (12, 8, 10, 2), n_line=12), narrow)
        figure.draw_without_rendering()
        axis = figure.axes[0]
        assert {"1w", "9w", "12w"} <= {text.get_text() for text in axis.texts}
        numbers = [one for one in (*axis.get_xticklabels(), *axis.get_yticklabels()) if one.get_text()]
        for text in axis.texts:
            box = text.get_window_extent()
            assert not [one.get_text() for one in numbers if box.overlaps(one.get_window_extent())], text.get_text()
