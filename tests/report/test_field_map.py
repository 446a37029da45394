"""The map of a field without a name, and its section of the report."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from torchplate.diagnosis.result import ONE_FORCE, FoundField
from torchplate.report.blocks.document import Heading, Listing, Picture
from torchplate.report.diagnosis import _blocks
from torchplate.report.diagnosis_figures import figures
from torchplate.report.figures.field_map import field_map, field_told

_spec = importlib.util.spec_from_file_location("samples", Path(__file__).with_name("samples.py"))
assert _spec is not None
assert _spec.loader is not None
samples = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(samples)
diagnosis = samples.diagnosis

FIELD = FoundField(
    "mass", (0.3, 0.6), (0.1, 0.2), ((0.7, 0.6),), 0.05, "kg", 3, 2, (0.0, 0.1, 0.0, 0.0, 0.4, -0.2), "sparse", 0.3,
    {"mass": 0.9, "stiffness": 0.1}, 0.4, 0.1, 0.42, 0.12, ("What is missing acts as mass.",),
)  # fmt: skip


def test_the_map_has_the_centre_and_its_images_in_millimetres() -> None:
    axis = field_map(diagnosis(), FIELD).axes[0]
    marked = {line.get_label(): np.transpose(line.get_data()) for line in axis.lines if line.get_marker() == "P"}
    places = sorted(tuple(point) for points in marked.values() for point in points.tolist())
    assert np.allclose(places, [(150.0, 192.0), (350.0, 192.0)])
    assert axis.get_xlim()[1] > 500


def test_a_stiffness_has_a_map_for_each_direction() -> None:
    values = (*FIELD.values, *(0.0,) * 6, *(0.0, -0.9, *(0.0,) * 4))
    field = replace(FIELD, kind="stiffness", values=values, directions=("along x", "along y", "in twist"))
    for narrow in (False, True):
        maps = [axis for axis in field_map(diagnosis(), field, narrow).axes if axis.get_title()]
        assert [axis.get_title() for axis in maps] == list(field.directions)
        assert all(any(line.get_marker() == "P" for line in axis.lines) for axis in maps)
    assert "largest value, -90 (in twist), is at x 0.50, y 0.00" in field_told(field)


def test_one_force_has_a_map_of_what_it_would_explain() -> None:
    force = replace(FIELD, kind="support", form=ONE_FORCE, unit="N/N", values=(0.0, 0.1, 0.0, 0.0, 0.96, 0.2))
    assert "explain of the misfit [%]: the largest value, 96, is at x 0.50, y 1.00" in field_told(force)
    assert any("explain" in axis.get_ylabel() + axis.get_xlabel() for axis in field_map(diagnosis(), force).axes)


def test_the_largest_value_is_told_at_its_node() -> None:
    assert "largest value, 40, is at x 0.50, y 1.00" in field_told(FIELD)


@pytest.mark.check
def test_the_report_has_a_field_where_one_was_found_and_nothing_where_none_was() -> None:
    found = replace(diagnosis(), field=FIELD)
    drawn = figures(found)
    assert "field" in drawn
    assert "field" not in figures(diagnosis())
    shown = dict.fromkeys(drawn, ())
    blocks = list(_blocks(found, Path(), shown, ""))
    at = blocks.index(Heading("What is missing, as a field over the plate"))
    assert isinstance(blocks[at + 1], Listing)
    assert blocks[at + 1].items == FIELD.sentences
    assert isinstance(blocks[at + 2], Picture)
