"""What is written comes back, and others can read it."""

from dataclasses import replace

import numpy as np
import pytest
import pyuff
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchplate.measurement import SI_UNIT, Channel, Measurement, MeasurementError, read_uff, write_uff

EVEN = np.arange(40.0390625, 60.0, 0.48828125)
UNEVEN = np.geomspace(3.3, 1234.5, 37)


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance", "transmissibility"])
@pytest.mark.parametrize("lines", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("binary", [False, True], ids=["ascii", "binary"])
def test_everything_written_is_read_back(binary, lines, kind, make_measurement, tmp_path):
    path = tmp_path / "again.uff"
    wrote = make_measurement(lines, kind=kind, references=(3, 8, 17), coherence=True, missing=((0, 1),))
    write_uff(wrote, path, binary)
    read = read_uff(path)
    assert read.kind == kind
    assert read.unit == SI_UNIT[kind]
    assert read.response == wrote.response
    assert read.reference == wrote.reference
    assert torch.equal(read.measured, wrote.measured)
    np.testing.assert_allclose(read.frequency.numpy(), lines, rtol=1e-9)
    np.testing.assert_allclose(read.frf.numpy(), wrote.frf.numpy(), rtol=1e-11)
    mask = wrote.measured.expand(wrote.frf.shape)
    assert read.coherence is not None
    assert wrote.coherence is not None
    np.testing.assert_allclose(read.coherence[mask].numpy(), wrote.coherence[mask].numpy(), rtol=1e-11)
    assert read.notes == ()


numbers = st.floats(-1e12, 1e12, allow_subnormal=False)


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(st.tuples(numbers, numbers), min_size=1, max_size=9),
    start=st.floats(0.0, 5e4),
    steps=st.lists(st.floats(1e-2, 30.0), min_size=9, max_size=9),
    node=st.integers(3, 10**8),  # node 2 is the reference, at a place of its own
    binary=st.booleans(),
    even=st.booleans(),
)
def test_any_values_on_any_lines_round_trip_to_1e_6(values, start, steps, node, binary, even, tmp_path_factory):
    n = len(values)
    gaps = [steps[0]] * n if even else steps
    frequency = start + np.cumsum([0.0, *gaps])[:n]
    frf = np.array([complex(*v) for v in values])[:, None, None]
    wrote = Measurement(
        frequency=torch.from_numpy(frequency),
        frf=torch.from_numpy(frf),
        measured=torch.ones(1, 1, dtype=torch.bool),
        response=(Channel(node, "w", (0.1, -2.0 / 3.0, 1e-9)),),
        reference=(Channel(2, "w", (1.0 / 3.0, 0.0, 12345.678)),),
        kind="mobility",
        unit=SI_UNIT["mobility"],
    )
    path = tmp_path_factory.mktemp("uff") / "any.uff"
    write_uff(wrote, path, binary)
    read = read_uff(path)
    np.testing.assert_allclose(read.frequency.numpy(), frequency, rtol=1e-6, atol=1e-6 * steps[0])
    np.testing.assert_allclose(read.frf.real.numpy(), frf.real, rtol=1e-6)
    np.testing.assert_allclose(read.frf.imag.numpy(), frf.imag, rtol=1e-6)
    assert read.response == wrote.response
    assert read.reference == wrote.reference


@pytest.mark.parametrize("lines", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("binary", [False, True], ids=["ascii", "binary"])
def test_pyuff_reads_what_is_written(binary, lines, make_measurement, tmp_path):
    path = tmp_path / "theirs.uff"
    wrote = make_measurement(lines, references=(8,), responses=(17,), coherence=True)
    write_uff(wrote, path, binary)
    sets = pyuff.UFF(str(path)).read_sets()
    assert [s["type"] for s in sets] == [164, 2411, 58, 58]
    units, nodes, frf, coherence = sets
    assert (units["units_code"], units["length"], units["force"]) == (1, 1.0, 1.0)
    assert nodes["node_nums"].tolist() == [8, 17]
    assert nodes["x"].tolist() == [0.233, 0.11]
    header = [(s["func_type"], s["rsp_node"], s["rsp_dir"], s["ref_node"], s["ref_dir"]) for s in (frf, coherence)]
    assert header == [(4, 17, 3, 8, 3), (6, 17, 3, 8, 3)]
    assert (frf["ordinate_spec_data_type"], frf["orddenom_spec_data_type"]) == (12, 13)
    assert (frf["ordinate_axis_units_lab"], frf["orddenom_axis_units_lab"]) == ("m/s2", "N")
    np.testing.assert_allclose(frf["x"], lines, rtol=1e-9)
    np.testing.assert_allclose(frf["data"], wrote.frf[:, 0, 0].numpy(), rtol=1e-11)
    assert wrote.coherence is not None
    np.testing.assert_allclose(coherence["data"], wrote.coherence[:, 0, 0].numpy(), rtol=1e-11)
    if binary:
        columns = 2 if lines is EVEN else 3
        assert frf["n_bytes"] == 8 * columns * len(lines)


def test_no_line_is_longer_than_the_formats_80_columns(make_measurement, tmp_path):
    path = tmp_path / "columns.uff"
    write_uff(make_measurement(UNEVEN, coherence=True), path)
    assert max(len(line) for line in path.read_text().splitlines()) <= 80


def test_an_existing_file_is_replaced(make_measurement, tmp_path):
    path = tmp_path / "twice.uff"
    for _ in range(2):
        write_uff(make_measurement(), path)
    assert len(read_uff(path).pairs) == 6


def test_a_node_at_two_places_cannot_be_written(make_measurement, tmp_path):
    wrong = replace(make_measurement(responses=(3,), references=(3,)), reference=(Channel(3, "w", (0.4, 0.0, 0.0)),))
    with pytest.raises(MeasurementError, match="one place for node 3"):
        write_uff(wrong, tmp_path / "never.uff")


def test_every_number_of_the_abscissa_has_a_decimal_point(make_measurement, tmp_path):
    # Fortran's E13.5 reads a 5 without a point as 0.00005.
    for lines in (np.arange(5.0, 9.0), np.array([5.0, 6.0, 8.0])):
        path = tmp_path / "point.uff"
        write_uff(make_measurement(lines, responses=(3,), references=(8,)), path)
        text = path.read_text().splitlines()
        start = text.index(next(line for line in text if line.startswith("accelerance")))
        header = text[start + 6]
        fields = [header[30 + 13 * i : 43 + 13 * i] for i in range(3)]
        if int(header[20:30]) == 0:
            fields += [line[:13] for line in text[start + 11 : start + 14]]
        assert all("." in field for field in fields)
        assert float(fields[3] if len(fields) > 3 else fields[0]) == 5.0


def test_a_pair_without_coherence_gets_no_coherence_record(make_measurement, tmp_path):
    wrote = make_measurement(responses=(3,), references=(3, 8), coherence=True)
    assert wrote.coherence is not None
    coherence = wrote.coherence.clone()
    coherence[:, 0, 0] = torch.nan
    path = tmp_path / "one.uff"
    write_uff(replace(wrote, coherence=coherence), path)
    types = [s["func_type"] for s in pyuff.UFF(str(path)).read_sets() if s["type"] == 58]
    assert types == [4, 4, 6]
