"""A frame and a table of nodes put channels where they are on the plate."""

import os
import signal
from dataclasses import replace

import pytest
import torch

from torchplate.measurement import (
    Channel,
    Frame,
    MeasurementError,
    in_frame,
    read_measurement,
    read_node_table,
    read_nodes,
    with_node_table,
    with_nodes,
    write_uff,
)

ENDS = ("response", "reference")


def test_a_frame_moves_and_turns_what_the_file_counts_in_millimetres():
    frame = Frame("mm", (100.0, 20.0, 5.0), (0.0, 2.0, 0.0), (-1.0, 0.0, 0.0))
    assert frame.on_plate((70.0, 60.0, 5.0)) == pytest.approx((0.04, 0.03, 0.0))
    assert frame.normal == 3


def test_the_normal_of_a_plate_that_stands_in_xz_is_y():
    assert Frame(x_axis=(1.0, 0.0, 0.0), y_axis=(0.0, 0.0, 1.0)).normal == 2


@pytest.mark.parametrize(("direction", "normal"), [("u", 1), ("v", 2), ("w", 3)])
def test_what_is_out_of_the_plane_follows_the_normal(direction, normal, tmp_path, make_measurement):
    measurement = make_measurement()
    turned = {end: tuple(replace(c, direction=direction) for c in getattr(measurement, end)) for end in ENDS}
    write_uff(replace(measurement, **turned), tmp_path / "standing.uff")
    found = read_measurement(tmp_path / "standing.uff", normal=normal)
    assert {c.direction for c in (*found.response, *found.reference)} == {"w"}
    torch.testing.assert_close(found.frf.sum(), measurement.frf.sum(), rtol=1e-6, atol=0)
    with pytest.raises(MeasurementError, match="out-of-plane"):
        read_measurement(tmp_path / "standing.uff", normal=normal % 3 + 1)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"unit": "furlong"}, "unit out of m, cm, mm, in"),
        ({"x_axis": (0.0, 0.0, 0.0)}, "some length"),
        ({"y_axis": (0.5, 1.0, 0.0)}, "right angle"),
    ],
)
def test_axes_that_make_no_plate_are_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        Frame(**settings)


def test_channels_without_a_place_keep_none(make_measurement):
    found = in_frame(make_measurement(coordinates=False), Frame("mm"))
    assert found.response[0].coordinate is None


@pytest.mark.parametrize(
    "text",
    [
        "node,x,y\n3,0.05,0.02\n17,0.11,0.19\n8,0.233,0.07\n",
        "3; 0.05; 0.02; 0\n17; 0.11; 0.19; 0\n8; 0.233; 0.07; 0\n",
        "# of the test sheet\n3 0.05 0.02\n\n17\t0.11\t0.19\n8 0.233 0.07  # the corner\n",
    ],
)
def test_a_table_of_nodes_places_the_channels(text, tmp_path, make_measurement):
    path = tmp_path / "nodes.csv"
    path.write_text(text)
    found = with_nodes(make_measurement(coordinates=False), read_nodes(path), "nodes.csv")
    assert found.reference[2].coordinate == (0.233, 0.07, 0.0)
    assert found.response[1].coordinate == (0.11, 0.19, 0.0)


def test_the_geometry_of_a_universal_file_is_a_table_of_nodes(tmp_path, make_measurement):
    write_uff(make_measurement(), tmp_path / "geometry.uff")
    assert read_nodes(tmp_path / "geometry.uff")[8] == pytest.approx((0.233, 0.07, 0.001))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("node,x\n3,0.05\n", "line 2"),
        ("3,0.05,0.02\n3,0.1,0.1\n", "3 again in line 2"),
        ("3,0.05,0.02\n17,here,0.1\n", "line 2"),
        ("3.5,0.05,0.02\n", "node label"),
        ("node,x,y\n", "got none"),
    ],
)
def test_a_table_that_is_none_is_refused_by_its_line(text, words, tmp_path):
    (tmp_path / "nodes.csv").write_text(text)
    with pytest.raises(MeasurementError, match=words):
        read_nodes(tmp_path / "nodes.csv")


@pytest.mark.parametrize(
    ("head", "unit"),
    [
        ("node,x [mm],y [mm]", "mm"),
        ("Node;X (mm);Y (mm)", "mm"),
        ("node\tx_mm\ty_mm", "mm"),
        ("node x [mm] y [mm]", "mm"),
        ("node x mm y mm", "mm"),
        ("point,x/cm,y/cm", "cm"),
        ("Punkt, Position X [mm], Position Y [mm]", "mm"),
        ("label,x in inches,y in inches", "in"),
        ("# node,x [Millimeter],y [Millimeter]", "mm"),
        ("node,x,y\n-,cm,cm", "cm"),
        ("node,x [m],y [m]", "m"),
        ("node,x,y", None),
        ("node,x_1,x_2", None),
        ("# a plate of 3 mm", None),
    ],
)
def test_the_head_of_a_table_states_the_unit_of_its_places(head, unit, tmp_path, make_measurement):
    path = tmp_path / "nodes.csv"
    rows = ["3,50,20", "17,110,190", "8,233,70"]
    path.write_text("\n".join([head, *rows]) + "\n")
    table = read_node_table(path)
    assert table.unit == unit
    # What states no unit is in the one that is asked for.
    factor = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "m": 1.0, None: 1.0}[unit]
    found = with_node_table(make_measurement(coordinates=False), table, "m")
    assert found.reference[2].coordinate == pytest.approx((233 * factor, 70 * factor, 0.0), rel=1e-12)
    assert [unit in note and "nodes.csv" in note for note in found.notes] == [True] * (unit is not None)
    in_cm = with_node_table(make_measurement(coordinates=False), table, "cm")
    shown = 100 * factor if unit else 1.0
    assert in_cm.reference[2].coordinate == pytest.approx((233 * shown, 70 * shown, 0.0), rel=1e-12)


@pytest.mark.parametrize(
    ("head", "word"),
    [
        ("node,x [furlong],y [furlong]", "'furlong'"),
        ("node,x_ft,y_ft", "'ft'"),
        ("node,x [mm],y [cm]", "'mm' and 'cm'"),
        ("node,x [-],y [-]", "'-'"),
        ("node,x (%),y (%)", "'%'"),
    ],
)
def test_a_unit_of_places_that_is_not_known_is_refused(head, word, tmp_path):
    path = tmp_path / "nodes.csv"
    path.write_text(f"{head}\n3,50,20\n")
    with pytest.raises(MeasurementError, match=f"one unit of length in the table's head.*got {word}. Write"):
        read_node_table(path)


def test_a_table_that_is_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "nodes.csv")
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it waits"))
    signal.alarm(5)
    try:
        with pytest.raises(MeasurementError, match="no file"):
            read_node_table(tmp_path / "nodes.csv")
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_a_table_that_lacks_a_node_names_it(make_measurement):
    with pytest.raises(MeasurementError, match="none of 8, 17"):
        with_nodes(make_measurement(coordinates=False), {3: (0.0, 0.0, 0.0)}, "nodes.csv")


def test_a_transmissibility_needs_no_place_of_its_base(make_measurement):
    measurement = make_measurement(kind="transmissibility", responses=(3,), references=(8,), coordinates=False)
    measurement = replace(measurement, reference=(Channel(99),))
    assert with_nodes(measurement, {3: (0.1, 0.0, 0.0)}, "nodes.csv").response[0].coordinate == (0.1, 0.0, 0.0)
