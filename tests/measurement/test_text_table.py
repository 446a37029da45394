"""Tables are read as spreadsheets and people write them, and no decimal comma becomes a column."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from torchplate.measurement import Layout, MeasurementError, read_modal_table, read_nodes, read_recordings
from torchplate.measurement.formats.text_table import cells_of, complex_of, lines_of, number_of, unit_in

_spec = importlib.util.spec_from_file_location("hits", Path(__file__).with_name("hits.py"))
assert _spec
assert _spec.loader
made = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(made)
FORCE, LEFT, RIGHT = made.hit(12, n=1024)
TIME = np.arange(1024) / made.RATE
G = 9.80665


@pytest.mark.parametrize(
    ("line", "cells"),
    [
        ("1,0D+03;2,5d-02", ["1.0D+03", "2.5d-02"]),
        ("7;0,25;-1,5e-3", ["7", "0.25", "-1.5e-3"]),
        ("7\t0,25\t3", ["7", "0.25", "3"]),
        ("7 0,25  3,5", ["7", "0.25", "3.5"]),
        ("7, 0.25,3.5", ["7", "0.25", "3.5"]),
        ("7,0.25,3.5,", ["7", "0.25", "3.5"]),
        ("7 0.25 3.5", ["7", "0.25", "3.5"]),
        ('"7","0,25","3,5"', ["7", "0.25", "3.5"]),
        ('"1,000",0.25,-3.5', ["1000", "0.25", "-3.5"]),
        ('"1,234.5","0,25",1e-3', ["1234.5", "0.25", "1e-3"]),
        ('"1,000";0.25', ["1.000", "0.25"]),
        ('"time","acc, left",force', ["time", "acc, left", "force"]),
    ],
)
def test_a_row_parts_at_its_separator(line, cells):
    assert cells_of(line) == cells


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_a_text_is_read_in_its_encoding(encoding, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes("Beschl. [m/s²]\r\n1\n".encode(encoding))
    assert lines_of(path) == ["Beschl. [m/s²]", "1"]


def test_the_unit_stands_in_brackets_at_the_end_of_a_head():
    heads = ("Force [kN]", "a (m/s^2)", "Acc", "left (1) [g]")
    assert [unit_in(head) for head in heads] == ["kN", "m/s^2", "", "g"]


def test_nodes_with_decimal_commas_keep_their_places(tmp_path):
    path = tmp_path / "nodes.csv"
    path.write_text("node;x;y\n1;0;0,1\n8;0,42;0,3\n")
    assert read_nodes(path) == {1: (0.0, 0.1, 0.0), 8: (0.42, 0.3, 0.0)}


@pytest.mark.parametrize(
    ("cell", "value"), [("1.0D+03", 1e3), ("-2.5d-02", -2.5e-2), (".5D1", 5.0), ("1D3", 1e3), ("7.", 7.0)]
)
def test_an_exponent_of_fortran_is_that_of_ten(cell, value):
    assert number_of(cell) == value
    assert complex_of(cell) == value
    assert complex_of(f"{cell}+{cell.lstrip('-')} I") == complex(value, abs(value))


@pytest.mark.parametrize("cell", ["D+03", "1.0D", "node", "1.0DD2", ""])
def test_what_only_looks_like_an_exponent_is_no_number(cell):
    for read in (number_of, complex_of):
        with pytest.raises(ValueError, match=r"could not convert|malformed"):
            read(cell)


def test_tables_of_nodes_modes_and_records_may_have_exponents_of_fortran(tmp_path):
    path = tmp_path / "nodes.csv"
    path.write_text("node,x,y\n1,0.0D+00,1.0D-01\n8,4.2D-01,3.0D-01\n")
    assert read_nodes(path) == {1: (0.0, 0.1, 0.0), 8: (0.42, 0.3, 0.0)}
    path.write_text("mode,frequency_hz,damping_ratio,1,7\n1,6.841D+01,3.1D-03,1.0D+00,-5.2D-01\n")
    found = read_modal_table(path)
    assert (float(found.frequency[0]), float(found.damping_ratio[0])) == (68.41, 0.0031)
    assert found.shape[0].tolist() == [1.0, -0.52]
    rows = [",".join(f"{x:.12E}".replace("E", "D") for x in row) for row in np.stack([TIME, FORCE, LEFT], axis=1)]
    (tmp_path / "12.csv").write_text("\n".join(["time,force,acc", *rows]))
    (record,) = read_recordings(tmp_path / "12.csv")
    np.testing.assert_allclose(record.force, FORCE, atol=1e-8)


def test_modes_with_decimal_commas_are_read(tmp_path):
    path = tmp_path / "modes.csv"
    path.write_text("mode;frequency_hz;damping_ratio;1;7\n1;68,41;0,0031;1,0;-0,52\n")
    found = read_modal_table(path)
    assert (float(found.frequency[0]), float(found.damping_ratio[0])) == (68.41, 0.0031)
    assert found.shape[0].tolist() == [1.0, -0.52]


def written(path: Path, heads: list[str], columns: list[np.ndarray], separator: str = ",", point: str = ".") -> Path:
    rows = [separator.join(f"{x:.12g}".replace(".", point) for x in row) for row in np.stack(columns, axis=1)]
    path.write_text("\n".join([*heads, *rows]))
    return path


TABLES = {
    # name: (heads, columns, separator, decimal point, whether the units are known)
    "units in heads": (["t [ms],Force [kN],a (g),b (g)"], [1e3 * TIME, FORCE / 1e3, LEFT / G, RIGHT / G], ",", ".", 1),
    "a row of units": (["Zeit;K1;K2;K3", "s;m/s²;m/s²;N"], [TIME, LEFT, RIGHT, FORCE], ";", ",", 1),
    "rows counted": (["index,time,force,a,b"], [np.arange(1024.0), TIME, FORCE, LEFT, RIGHT], ",", ".", 0),
    "decimal commas between blanks": (["time force a b"], [TIME, FORCE, LEFT, RIGHT], " ", ",", 0),
    "a preamble": (["made by hand", "", "time\tforce\ta\tb"], [TIME, FORCE, LEFT, RIGHT], "\t", ".", 0),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLES)
def test_a_table_of_time_records_is_read_in_si_units(case, tmp_path):
    heads, columns, separator, point, known = TABLES[case]
    (found,) = read_recordings(written(tmp_path / "12.csv", heads, columns, separator, point))
    assert found.rate == pytest.approx(made.RATE, rel=1e-6)
    # Twelve digits are written.
    np.testing.assert_allclose(found.force, FORCE, atol=1e-8)
    np.testing.assert_allclose(found.response, [LEFT, RIGHT], atol=1e-8)
    assert (found.has_unit, found.motion, found.notes) == (bool(known), "acceleration" if known else None, ())


def test_factors_that_are_told_win_over_units(tmp_path):
    path = written(tmp_path / "12.csv", ["t [s],F [kN],a [g],b [g]"], [TIME, FORCE, LEFT, RIGHT])
    (found,) = read_recordings(path, Layout(scale=(2.0, 3.0)))
    np.testing.assert_allclose(found.force, 2 * FORCE, atol=1e-8)
    np.testing.assert_allclose(found.response[0], 3 * LEFT, atol=1e-8)


def test_a_force_that_nothing_names_is_found_by_its_pulses_and_said(tmp_path):
    path = written(tmp_path / "12.csv", ["time,one,two,three"], [TIME, LEFT, RIGHT, FORCE])
    (found,) = read_recordings(path)
    np.testing.assert_allclose(found.force, FORCE, atol=1e-8)
    (note,) = found.notes
    assert "'three', of 3, has the shortest pulses and was taken; --force names another: --force 1, say." in note
    assert "The first number of --scale is the force's" in note


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("time [days],force,a,b", "times in s, ms or µs, got a column in 'days'"),
        ("time [s],force [N],a [m/s²],b [mm/s]", "units of acceleration and velocity"),
    ],
)
def test_units_that_cannot_be_are_refused(head, words, tmp_path):
    path = written(tmp_path / "12.csv", [head], [TIME, FORCE, LEFT, RIGHT])
    with pytest.raises(MeasurementError, match=r"12\.csv") as caught:
        read_recordings(path)
    assert words in str(caught.value)
