"""Universal files written by hand or by pyuff, never by our own writer, are read as their format says."""

import re
from pathlib import Path

import numpy as np
import pytest
import pyuff

from torchplate.measurement import MeasurementError, read_measurement

LINES = np.array([5.0, 5.5, 6.0, 6.5, 7.0])
UNEVEN = np.array([5.0, 5.5, 6.25, 8.0, 11.5])
VALUES = np.array([1.5 - 2.25j, -0.125 + 8.0j, 3.0 + 0.5j, 1e-3 - 4e-4j, -7.75 - 1.0j])
# Single-precision text holds six digits.
SIX_DIGITS = 5e-6


def text_lines(columns: list[np.ndarray], formats: list[str], per_line: int) -> list[str]:
    cells = [f.format(x) for row in np.stack(columns, axis=1) for f, x in zip(formats, row, strict=True)]
    n = per_line * len(formats)
    return ["".join(cells[i : i + n]) for i in range(0, len(cells), n)]


SINGLE, DOUBLE = "{:13.5E}", "{:20.12E}"
CASES = {
    # name: (ordinate type, even, formats of one point, points per line)
    "1 real single even": (2, True, [SINGLE], 6),
    "2 real single uneven": (2, False, [SINGLE, SINGLE], 3),
    "3 complex single even": (5, True, [SINGLE, SINGLE], 3),
    "4 complex single uneven": (5, False, [SINGLE] * 3, 2),
    "5 real double even": (4, True, [DOUBLE], 4),
    "6 real double uneven": (4, False, [SINGLE, DOUBLE], 2),
    "7 complex double even": (6, True, [DOUBLE] * 2, 2),
    "8 complex double uneven": (6, False, [SINGLE, DOUBLE, DOUBLE], 1),
}


@pytest.mark.parametrize("case", CASES)
def test_every_ascii_case_of_the_format_is_read(case, record_58, tmp_path):
    ordinate_type, even, formats, per_line = CASES[case]
    parts = [VALUES.real, VALUES.imag] if ordinate_type in (5, 6) else [VALUES.real]
    columns = parts if even else [UNEVEN, *parts]
    path = tmp_path / "case.uff"
    lines = text_lines(columns, formats, per_line)
    path.write_bytes(record_58(lines, n_point=5, ordinate_type=ordinate_type, even=even))
    measurement = read_measurement(path)
    np.testing.assert_allclose(measurement.frequency.numpy(), LINES if even else UNEVEN, rtol=SIX_DIGITS)
    expected = VALUES if ordinate_type in (5, 6) else VALUES.real
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), expected, rtol=SIX_DIGITS)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("ordinate_type", "number", "abscissa"),
    [
        *[(t, number, None) for t, number in ((2, "f4"), (4, "f8"), (5, "f4"), (6, "f8"))],
        *[(t, number, "f4") for t, number in ((2, "f4"), (4, "f8"), (5, "f4"), (6, "f8"))],
        *[(t, "f8", "f8") for t in (4, 6)],
    ],
)
def test_binary_is_read_in_both_byte_orders_and_with_either_abscissa(
    order, abscissa, ordinate_type, number, record_58, tmp_path
):
    parts = [VALUES.real, VALUES.imag] if ordinate_type in (5, 6) else [VALUES.real]
    fields = [(str(i), order + number) for i in range(len(parts))]
    if abscissa:
        fields = [("x", order + abscissa), *fields]
    table = np.zeros(5, dtype=fields)
    for (name, _), column in zip(fields, ([UNEVEN] if abscissa else []) + parts, strict=True):
        table[name] = column
    body = table.tobytes()
    identity = f"    58b{1 if order == '<' else 2:6d}{2:6d}{11:12d}{len(body):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    path = tmp_path / "binary.unv"
    record = record_58([], n_point=5, ordinate_type=ordinate_type, even=not abscissa, identity=identity, body=body)
    path.write_bytes(record)
    measurement = read_measurement(path)
    expected = VALUES if ordinate_type in (5, 6) else VALUES.real
    np.testing.assert_allclose(measurement.frequency.numpy(), UNEVEN if abscissa else LINES, rtol=1e-7)
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), expected, rtol=1e-7)


# pyuff leaves a file open when it writes binary records.
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("spacing", [0, 1])
def test_files_that_pyuff_writes_are_read(binary, spacing, tmp_path):
    path = tmp_path / "pyuff.uff"
    frequency = LINES if spacing else UNEVEN
    node = pyuff.prepare_15(
        node_nums=[4, 9], def_cs=[0, 0], disp_cs=[0, 0], color=[0, 0], x=[0.1, 0.25], y=[0.0, 0.35], z=[0.0, 0.0]
    )
    shared = {
        "binary": binary,
        "rsp_node": 4,
        "rsp_dir": 3,
        "ref_dir": 3,
        "x": frequency,
        "abscissa_spacing": spacing,
        "abscissa_spec_data_type": 18,
    }
    sets = [node]
    for reference in (9, 4):
        sets.append(
            pyuff.prepare_58(
                func_type=4,
                ref_node=reference,
                data=VALUES * reference,
                ordinate_spec_data_type=11,
                orddenom_spec_data_type=13,
                **shared,
            )
        )
    sets.append(pyuff.prepare_58(func_type=6, ref_node=9, data=np.linspace(0.5, 0.9, 5), **shared))
    for dataset in sets[1:]:
        dataset.setdefault("orddenom_spec_data_type", 0)
    pyuff.UFF(str(path)).write_sets(sets, mode="overwrite")
    measurement = read_measurement(path)
    assert measurement.kind == "mobility"
    assert [c.label for c in measurement.reference] == ["4w", "9w"]
    assert measurement.reference[1].coordinate == (0.25, 0.35, 0.0)
    np.testing.assert_allclose(measurement.frequency.numpy(), frequency, rtol=1e-12)
    np.testing.assert_allclose(measurement.frf[:, 0, 1].numpy(), VALUES * 9, rtol=1e-10)
    assert measurement.coherence is not None
    np.testing.assert_allclose(measurement.coherence[:, 0, 1].numpy(), np.linspace(0.5, 0.9, 5), rtol=1e-10)
    assert bool(measurement.coherence[:, 0, 0].isnan().all())


def good(record_58, **changes) -> bytes:
    lines = text_lines([VALUES.real, VALUES.imag], [DOUBLE] * 2, 2)
    return record_58(lines, **({"n_point": 5} | changes))


def test_fortran_d_exponents_and_padding_after_the_last_value_are_read(record_58, tmp_path):
    lines = text_lines([VALUES.real, VALUES.imag], [DOUBLE] * 2, 2)
    lines[-1] += "".join(DOUBLE.format(0.0) for _ in range(2))
    path = tmp_path / "fortran.uff"
    path.write_bytes(record_58([line.replace("E", "D") for line in lines], n_point=5))
    np.testing.assert_allclose(read_measurement(path).frf[:, 0, 0].numpy(), VALUES, rtol=1e-11)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_d_exponents_of_headers_and_of_nodes_are_read(end, record_58, tmp_path):
    """Fortran writes every number of a file so, those of headers and of dataset 15 among them."""
    places = ((4, 0.3, -0.125), (9, 0.0, 0.04))
    nodes = [f"{n:10d}{0:10d}{0:10d}{8:10d}{x:13.5E}{y:13.5E}{0.0:13.5E}" for n, x, y in places]
    text = "\n".join(["    -1", "    15", *nodes, "    -1", ""]) + good(record_58, start=5.25).decode()
    text = re.sub(r"(\d)E([+-]\d\d)", r"\1D\2", text)
    assert "5.25000D+00" in text
    path = tmp_path / "fortran.uff"
    path.write_bytes(text.replace("\n", end).encode())
    measurement = read_measurement(path)
    np.testing.assert_allclose(measurement.frequency.numpy(), LINES + 0.25, rtol=1e-12)
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), VALUES, rtol=1e-11)
    assert measurement.response[0].coordinate == (0.3, -0.125, 0.0)


@pytest.mark.parametrize(("response", "reference", "sign"), [(3, 3, 1), (-3, 3, -1), (3, -3, -1), (-3, -3, 1)])
def test_a_channel_along_minus_z_turns_the_sign(response, reference, sign, record_58, tmp_path):
    path = tmp_path / "down.uff"
    path.write_bytes(good(record_58, response=(4, response), reference=(9, reference)))
    measurement = read_measurement(path)
    assert measurement.response[0].label == "4w"
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), sign * VALUES, rtol=1e-11)


def test_nodes_of_dataset_2411_are_read_in_the_units_of_dataset_164(record_58, tmp_path):
    units = ["    -1", "   164", f"{5:10d}{'mm, milli newton':20s}{2:10d}"]
    units += ["    1.0000000000000000D+03   1.0000000000000000D+03   1.0000000000000000D+00"]
    units += ["    2.7314999999999998D+02", "    -1"]
    nodes = ["    -1", "  2411"]
    for label, x, y in (
        (9, "1.2500000000000000D+02", "4.0000000000000000D+01"),
        (4, "0.0000000000000000D+00", "-3.0D-01"),
    ):
        nodes += [f"{label:10d}{0:10d}{0:10d}{11:10d}", f"{x:>25s}{y:>25s}{'0.0000000000000000D+00':>25s}"]
    nodes += ["    -1"]
    text = "".join(f"{line}\n" for line in units + nodes).encode()
    path = tmp_path / "millimetres.unv"
    # No labels: the level, mm/s² per mN, is m/(N s²) as it stands; mm/mN is as well.
    path.write_bytes(text + good(record_58, numerator=(12, "NONE"), denominator=(13, "NONE")))
    measurement = read_measurement(path)
    assert measurement.reference[0].coordinate == pytest.approx((0.125, 0.04, 0.0))
    assert measurement.response[0].coordinate == pytest.approx((0.0, -0.0003, 0.0))
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), VALUES, rtol=1e-11)


def test_places_are_in_the_units_that_stand_before_them_where_a_file_states_several(record_58, tmp_path):
    """Two files that were put together: the last units are not those of the first one's places."""

    def units(factor: str) -> list[str]:
        head = ["    -1", "   164", f"{9:10d}{'its own':20s}{2:10d}"]
        return [*head, f"    {factor}   1.0000000000000000D+00   1.0000000000000000D+00", "    2.73D+02", "    -1"]

    nodes = ["    -1", "  2411"]
    for label, x in ((9, "1.2500000000000000D+02"), (4, "0.0000000000000000D+00")):
        nodes += [f"{label:10d}{0:10d}{0:10d}{11:10d}", f"{x:>25s}{x:>25s}{'0.0000000000000000D+00':>25s}"]
    text = [*units("1.0000000000000000D+03"), *nodes, "    -1", *units("1.0000000000000000D+00")]
    path = tmp_path / "two.unv"
    path.write_bytes("".join(f"{line}\n" for line in text).encode() + good(record_58))
    measurement = read_measurement(path)
    assert measurement.reference[0].coordinate == pytest.approx((0.125, 0.125, 0.0))
    assert any("different units (dataset 164)" in note for note in measurement.notes)


def test_dataset_164_scales_the_length_and_the_force_of_the_level(record_58, tmp_path):
    units = ["    -1", "   164", f"{8:10d}{'mm, kilogram f':20s}{2:10d}"]
    units += ["    1.0000000000000000D+03   1.0197162129779283D-01   1.0000000000000000D+00"]
    units += ["    2.7314999999999998D+02", "    -1"]
    path = tmp_path / "kilogram.unv"
    record = good(record_58, numerator=(8, "NONE"), denominator=(13, "NONE"))
    path.write_bytes("".join(f"{line}\n" for line in units).encode() + record)
    measurement = read_measurement(path)
    assert measurement.kind == "receptance"
    # 1 mm per kgf is 1e-3 m over 9.80665 N.
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), VALUES * 1e-3 / 9.80665, rtol=1e-9)


@pytest.mark.parametrize(
    ("numerator", "denominator", "kind", "factor"),
    [
        ((8, "m"), (13, "N"), "receptance", 1.0),
        ((8, "mm"), (13, "kN"), "receptance", 1e-6),
        ((11, "m/s"), (13, "mN"), "mobility", 1e3),
        ((12, "g"), (13, "N"), "accelerance", 9.80665),
        ((12, "m/s^2"), (9, "lbf"), "accelerance", 1 / 4.4482216152605),
        ((12, "g"), (12, "g"), "transmissibility", 1.0),
        ((8, "m"), (8, "mm"), "transmissibility", 1.0),
    ],
)
def test_kind_and_level_follow_the_specifiers_and_labels(numerator, denominator, kind, factor, record_58, tmp_path):
    path = tmp_path / "level.uff"
    path.write_bytes(good(record_58, numerator=numerator, denominator=denominator))
    measurement = read_measurement(path)
    assert measurement.kind == kind
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), factor * VALUES, rtol=1e-11)
    assert not any("not known" in note for note in measurement.notes)


def test_a_given_kind_overrides_the_file_and_says_so(record_58, tmp_path):
    path = tmp_path / "told.uff"
    path.write_bytes(good(record_58, text="transmissibility: response over base"))
    read = read_measurement(path)
    assert read.kind == "accelerance"
    assert any("set measurement.kind: transmissibility" in note for note in read.notes)
    told = read_measurement(path, kind="transmissibility")
    assert told.kind == "transmissibility"
    assert told.unit == "-"
    assert any("as told" in note for note in told.notes)


@pytest.mark.parametrize(
    ("labels", "said"), [((4, 9), ""), ((4, 12), "1 of the FRFs' 2 nodes: 9."), ((1, 2), ": 4, 9.")]
)
def test_nodes_that_the_geometry_has_not_are_named_in_a_note(labels, said, record_58, tmp_path):
    path = tmp_path / "plate.uff"
    points = "".join(f"{node:10d}{0:10d}{0:10d}{0:10d}{0.1 * node:13.5e}{0.2:13.5e}{0:13.5e}\n" for node in labels)
    geometry = f"    -1\n    15\n{points}    -1\n".encode()
    path.write_bytes(geometry + good(record_58))
    notes = [note for note in read_measurement(path).notes if "has no place for" in note]
    assert len(notes) == bool(said)
    assert all(said in note and "measurement.nodes" in note for note in notes)


def test_an_unknown_unit_label_is_named_in_a_note(record_58, tmp_path):
    path = tmp_path / "volt.uff"
    path.write_bytes(good(record_58, numerator=(12, "mV")))
    assert any("'mV'" in note for note in read_measurement(path).notes)


def test_in_plane_channels_are_left_out_with_a_note(record_58, tmp_path):
    path = tmp_path / "triaxial.uff"
    path.write_bytes(good(record_58) + good(record_58, response=(4, 1)))
    measurement = read_measurement(path)
    assert [c.label for c in measurement.response] == ["4w"]
    assert any("4u/9w" in note for note in measurement.notes)


@pytest.mark.parametrize(
    ("function_type", "words"),
    [(0, ["function type 0 (unknown)", "record 2 (4w/9w)", "type 4"]), (2, ["function type 2 (auto spectrum)"])],
)
def test_records_that_are_no_frf_are_left_out_with_a_note(function_type, words, record_58, tmp_path):
    path = tmp_path / "mixed.uff"
    path.write_bytes(good(record_58) + good(record_58, function_type=function_type))
    measurement = read_measurement(path)
    assert len(measurement.pairs) == 1
    (note,) = measurement.notes
    assert all(word in note for word in ["Left out 1 record", *words]), note


def test_many_coherences_without_their_frfs_are_one_note(record_58, tmp_path):
    path = tmp_path / "orphans.uff"
    path.write_bytes(
        good(record_58)
        + good(record_58, function_type=6, reference=(2, 3))
        + good(record_58, function_type=6, reference=(3, 3))
    )
    (note,) = read_measurement(path).notes
    assert "Left out 2 coherences" in note


def test_mode_shapes_beside_the_frfs_are_left_out_with_a_note(record_58, tmp_path):
    path = tmp_path / "shapes.uff"
    path.write_bytes(good(record_58) + b"    -1\n    55\nNONE\n    -1\n")
    (note,) = read_measurement(path).notes
    assert "1 dataset 55" in note


def test_pairs_that_the_file_does_not_hold_are_marked_and_zero(record_58, tmp_path):
    path = tmp_path / "sparse.uff"
    path.write_bytes(good(record_58, response=(4, 3)) + good(record_58, response=(2, 3), reference=(7, 3)))
    measurement = read_measurement(path)
    assert measurement.measured.tolist() == [[True, False], [False, True]]
    assert measurement.pairs == ((0, 0), (1, 1))
    assert bool((measurement.frf[:, 0, 1] == 0).all())


FAULTS = {
    "empty": (lambda _: b"", ["an empty file", "Export"]),
    "text": (lambda _: b"frequency,real,imag\n1,2,3\n", ["universal file", "-1", "Export"]),
    "cut short": (lambda r: good(r) + good(r, response=(2, 3))[:-200], ["ends within a dataset", "copy or export"]),
    "values missing": (lambda r: good(r, n_point=9), ["10 numbers", "promises 18", "Export"]),
    "not a number": (lambda r: good(r).replace(b"000000E+00", b"000000E+XX"), ["where a number belongs", "record 1"]),
    "no FRF": (lambda r: good(r, function_type=2), ["2 (auto spectrum)", "function type 4"]),
    "in-plane only": (lambda r: good(r, response=(4, 2)), ["4v/9w", "export the z direction"]),
    "pair twice": (lambda r: good(r) + good(r), ["record 1 (4w/9w)", "record 2 (4w/9w)", "Keep one"]),
    "pair twice, upside down": (lambda r: good(r) + good(r, response=(4, -3)), ["record 2 (4w/9w)", "Keep one"]),
    "other lines": (lambda r: good(r) + good(r, response=(2, 3), step=0.25), ["same frequency lines", "5 to 6 Hz"]),
    "no kind": (lambda r: good(r, denominator=(0, "NONE")), ["12 over 0", "Set measurement.kind"]),
    "two kinds": (lambda r: good(r) + good(r, response=(2, 3), numerator=(8, "m")), ["one kind", "that differ"]),
    "VAX floats": (
        lambda r: good(r, identity="    58b     1     1          11          80", body=bytes(80)),
        ["IEEE 754", "Export it as ASCII"],
    ),
    "binary cut": (
        lambda r: good(r, identity="    58b     1     2          11          80", body=bytes(40)),
        ["40 bytes", "at least 80"],
    ),
    "broken header": (lambda r: good(r).replace(b"    4         0    0", b"    X         0    0"), ["does not parse"]),
    "unknown type": (lambda r: good(r, ordinate_type=3), ["ordinate data type 3"]),
    "falling lines": (lambda r: good(r, step=-0.5), ["rises from line to line"]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_cannot_be_used_is_said_with_the_file_the_fault_and_the_remedy(fault, record_58, tmp_path):
    content, words = FAULTS[fault]
    path = tmp_path / "faulty.uff"
    path.write_bytes(content(record_58))
    with pytest.raises(MeasurementError) as caught:
        read_measurement(path)
    message = str(caught.value)
    for word in ["faulty.uff", "expected", *words]:
        assert word in message


@pytest.mark.parametrize(("name", "word"), [("plate.csv", "suffix '.csv'"), ("absent.uff", "none there")])
def test_a_wrong_suffix_and_an_absent_file_are_told_apart(name, word, tmp_path):
    with pytest.raises(MeasurementError, match=word):
        read_measurement(Path(tmp_path / name))


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_a_line_break_after_binary_values_is_forgiven(end, record_58, tmp_path):
    body = np.stack([VALUES.real, VALUES.imag], axis=1).astype("<f8").tobytes()
    identity = f"    58b{1:6d}{2:6d}{11:12d}{len(body):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    path = tmp_path / "break.uff"
    path.write_bytes(record_58([], n_point=5, identity=identity, body=body + end))
    np.testing.assert_array_equal(read_measurement(path).frf[:, 0, 0].numpy(), VALUES)


def test_si_by_its_code_stays_si_beside_factors_of_feet(record_58, tmp_path):
    units = ["    -1", "   164", f"{1:10d}{'SI units':20s}{1:10d}"]
    units += ["    3.2808398950131233D+00   2.2480894309971048D-01   1.8000000000000000D+00"]
    units += ["    4.5967000000000002D+02", "    -1"]
    path = tmp_path / "feet.uff"
    record = good(record_58, numerator=(8, "NONE"), denominator=(13, "NONE"))
    path.write_bytes("".join(f"{line}\n" for line in units).encode() + record)
    measurement = read_measurement(path)
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), VALUES, rtol=1e-11)
    assert any("SI was taken" in note for note in measurement.notes)


def test_a_coherence_without_its_frf_is_left_out_with_a_note(record_58, tmp_path):
    path = tmp_path / "orphan.uff"
    path.write_bytes(good(record_58) + good(record_58, function_type=6, reference=(2, 3)))
    measurement = read_measurement(path)
    assert measurement.coherence is None
    assert any("record 2 (4w/2w)" in note for note in measurement.notes)


def test_a_channel_without_direction_counts_as_out_of_the_plate_and_says_so(record_58, tmp_path):
    path = tmp_path / "scalar.uff"
    path.write_bytes(good(record_58, response=(4, 0)))
    measurement = read_measurement(path)
    assert measurement.response[0].label == "4w"
    assert any("direction 0" in note for note in measurement.notes)


@pytest.mark.parametrize(
    ("label", "factor"),
    [("Hz", 1.0), ("", 1.0), ("kHz", 1e3), ("rad/s", 1 / (2 * np.pi)), ("rpm", 1 / 60), ("RPM", 1 / 60)],
)
def test_lines_come_in_hertz_whatever_the_axis_counts(label, factor, record_58, tmp_path):
    path = tmp_path / "axis.uff"
    values = text_lines([VALUES.real, VALUES.imag], [SINGLE, SINGLE], 3)
    path.write_bytes(
        record_58(values, n_point=5, ordinate_type=5).replace(f"{'Hz':20s}".encode(), f"{label:20s}".encode())
    )
    measurement = read_measurement(path)
    np.testing.assert_allclose(measurement.frequency.numpy(), factor * LINES, rtol=1e-12)
    assert measurement.notes == ()


def test_an_axis_of_unknown_unit_is_named(record_58, tmp_path):
    path = tmp_path / "axis.uff"
    values = text_lines([VALUES.real, VALUES.imag], [SINGLE, SINGLE], 3)
    path.write_bytes(
        record_58(values, n_point=5, ordinate_type=5).replace(f"{'Hz':20s}".encode(), f"{'order':20s}".encode())
    )
    assert "'order' of the frequency axis is not known; taken as Hz" in read_measurement(path).notes[0]


@pytest.mark.parametrize(
    ("parts", "ordinate_type", "label", "words"),
    [
        ([np.abs(VALUES)], 2, "m/s2", "amplitudes without a phase"),
        ([20 * np.log10(np.abs(VALUES))], 4, "dB", "levels in dB"),
    ],
)
def test_a_part_of_an_frf_is_refused(parts, ordinate_type, label, words, record_58, tmp_path):
    path = tmp_path / "part.uff"
    form, per_line = (DOUBLE, 4) if ordinate_type == 4 else (SINGLE, 6 // len(parts))
    lines = text_lines(parts, [form] * len(parts), per_line)
    path.write_bytes(record_58(lines, n_point=5, ordinate_type=ordinate_type, numerator=(12, label)))
    with pytest.raises(MeasurementError, match=words):
        read_measurement(path)


@pytest.mark.parametrize(
    ("parts", "ordinate_type", "missing"),
    [
        ([VALUES.real], 2, "imaginary"),
        ([np.abs(VALUES), 0 * VALUES.real], 5, "imaginary"),
        ([0 * VALUES.real, VALUES.imag], 5, "real"),
    ],
)
def test_an_frf_of_one_part_is_named(parts, ordinate_type, missing, record_58, tmp_path):
    path = tmp_path / "real.uff"
    lines = text_lines(parts, [SINGLE] * len(parts), 6 // len(parts))
    path.write_bytes(record_58(lines, n_point=5, ordinate_type=ordinate_type))
    assert f"Of 1 FRFs 1 have no {missing} part, the first record 1 (4w/9w)" in read_measurement(path).notes[0]


@pytest.mark.parametrize(
    ("numerator", "denominator", "factor"),
    [
        ("g/N", "", 9.80665),
        ("(m/s^2)/N", "NONE", 1.0),
        ("mm/s2/lbf", "", 1e-3 / 4.4482216152605),
        ("g's", "N", 9.80665),
    ],
)
def test_one_label_may_hold_motion_and_force(numerator, denominator, factor, record_58, tmp_path):
    path = tmp_path / "label.uff"
    values = text_lines([VALUES.real, VALUES.imag], [SINGLE, SINGLE], 3)
    path.write_bytes(
        record_58(values, n_point=5, ordinate_type=5, numerator=(12, numerator), denominator=(13, denominator))
    )
    measurement = read_measurement(path)
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), factor * VALUES, rtol=SIX_DIGITS)
    assert measurement.notes == ()


@pytest.mark.parametrize("encoding", ["latin-1", "cp1252", "utf-8"])
@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize(
    ("numerator", "denominator", "factor"),
    [((12, "mm/s²"), (13, "N"), 1e-3), ((8, "µm"), (13, "mN"), 1e-3), ((12, "m/s²/N"), (13, ""), 1.0)],
)
def test_units_read_right_in_whatever_encoding_the_header_is(
    numerator, denominator, factor, binary, encoding, record_58, tmp_path
):
    """A byte that is no UTF-8 was a sign of an unknown label, and the level taken as SI."""
    more = {}
    if binary:
        body = VALUES.astype("<c16").tobytes()
        more = {"identity": f"    58b{1:6d}{2:6d}{11:12d}{len(body):12d}{0:6d}{0:6d}{0:12d}{0:12d}", "body": body}
    values = [] if binary else text_lines([VALUES.real, VALUES.imag], [DOUBLE] * 2, 2)
    words = {"numerator": numerator, "denominator": denominator, "text": "Prüfstand 3"}
    content = record_58(values, n_point=5, **words, **more)
    head, end, tail = content.partition(b"NONE                \n" * (not binary) or more["body"])
    path = tmp_path / "words.uff"
    path.write_bytes(head.decode().encode(encoding) + end + tail)
    measurement = read_measurement(path)
    np.testing.assert_allclose(measurement.frf[:, 0, 0].numpy(), factor * VALUES, rtol=1e-11)
    assert not any("not known" in note for note in measurement.notes)
