"""The two types that hold what was measured, and their archive."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from torchplate.measurement import Channel, Measurement, MeasurementError, NaturalFrequencies, read_measurement
from torchplate.measurement.formats.archive import arrays_of


def test_band_keeps_the_lines_at_both_of_its_edges(make_measurement):
    cut = make_measurement(coherence=True).band(30.5, 42.25)
    assert (float(cut.frequency[0]), float(cut.frequency[-1])) == (30.5, 42.25)
    assert len(cut.frequency) == 48
    whole = make_measurement(coherence=True)
    assert torch.equal(cut.frf, whole.frf[42:90])
    assert cut.coherence is not None
    assert torch.equal(cut.coherence, whole.coherence[42:90])


def test_it_is_shown_in_a_line_and_not_value_by_value(make_measurement):
    shown = repr(make_measurement(coherence=True, missing=((1, 2),)))
    assert shown == (
        "Measurement(5 of 2 × 3 FRFs, accelerance [m/(N s²)], 521 lines, 20 to 150 Hz, coherence; 'chain')"
    )


def test_band_forgives_the_rounding_of_a_header(make_measurement):
    lines = np.array([100.0, 249.9999, 399.9998])
    assert len(make_measurement(lines).band(100.0, 399.99975).frequency) == 3


def test_every_third_line_keeps_its_frf_and_coherence(make_measurement):
    whole = make_measurement(coherence=True)
    thinned = whole.every(3)
    assert thinned.frequency.is_contiguous()
    assert torch.equal(thinned.frequency, whole.frequency[::3])
    assert torch.equal(thinned.frf[4], whole.frf[12])
    assert torch.equal(thinned.coherence[4], whole.coherence[12])


def test_a_band_without_lines_names_what_there_is(make_measurement):
    with pytest.raises(MeasurementError, match=r"20 to 150 Hz, got 200 to 300 Hz.*measurement\.band"):
        make_measurement().band(200.0, 300.0)


def test_select_drops_pairs_and_the_channels_left_without_any(make_measurement):
    whole = make_measurement(coherence=True, missing=((1, 2),))
    keep = torch.tensor([[False, True, True], [False, False, True]])
    part = whole.select(keep)
    # Pair (1, 2) is asked for but was never measured, so response 17 goes with it.
    assert [c.label for c in part.response] == ["3w"]
    assert [c.label for c in part.reference] == ["3w", "8w"]
    assert torch.equal(part.frf[:, 0], whole.frf[:, 0, 1:])
    assert part.coherence is not None
    assert torch.equal(part.coherence[:, 0], whole.coherence[:, 0, 1:])
    with pytest.raises(MeasurementError, match="keeps none"):
        whole.select(torch.zeros(2, 3, dtype=torch.bool))


def test_a_dropped_pair_between_kept_ones_is_zero_and_marked(make_measurement):
    keep = torch.tensor([[True, False, True], [True, True, True]])
    part = make_measurement().select(keep)
    assert part.measured.tolist() == keep.tolist()
    assert bool((part.frf[:, 0, 1] == 0).all())


def test_unmeasured_entries_are_zero_whatever_was_given(make_measurement):
    whole = make_measurement()
    frf = whole.frf.clone()
    frf[:, 1, 0] = torch.nan
    measured = whole.measured.clone()
    measured[1, 0] = False
    assert bool((replace(whole, frf=frf, measured=measured).frf[:, 1, 0] == 0).all())
    with pytest.raises(MeasurementError, match="17w/17w"):
        replace(whole, frf=frf)


def test_step_is_the_spacing_where_it_is_even(make_measurement):
    assert make_measurement().step == pytest.approx(0.25)
    assert make_measurement(np.array([20.0, 21.0, 23.0])).step is None
    assert make_measurement(np.array([20.0])).step is None


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda m: {"frequency": m.frequency.flip(0)}, "rises"),
        (lambda m: {"frequency": m.frequency - 30.0}, "starts at 0"),
        (lambda m: {"frequency": torch.cat([m.frequency[:-1], m.frequency[-1:] * 1e300])}, "a line at 1.5e+302 Hz"),
        (lambda m: {"frequency": m.frequency * 1e78}, "nothing vibrates"),
        (lambda m: {"frequency": m.frequency[:-1]}, "column"),
        (lambda m: {"response": m.response[:1]}, "column"),
        (lambda m: {"coherence": m.frf.real[1:]}, "coherence of shape"),
        (lambda m: {"measured": torch.zeros_like(m.measured)}, "at least one"),
    ],
)
def test_fields_that_do_not_fit_are_refused(change, word, make_measurement):
    whole = make_measurement()
    # jaxtyping may be the first to notice a shape, where it runs.
    with pytest.raises((MeasurementError, TypeError)) as caught:
        replace(whole, **change(whole))
    assert word in str(caught.value) or "jaxtyping" in str(type(caught.value)).lower() + str(caught.value)


@pytest.mark.parametrize("coordinates", [True, False])
@pytest.mark.parametrize("coherence", [True, False])
def test_an_archive_gives_everything_back_exactly(coordinates, coherence, make_measurement, tmp_path):
    path = tmp_path / "archive.npz"
    wrote = make_measurement(kind="mobility", coordinates=coordinates, coherence=coherence, missing=((0, 2),))
    wrote = replace(wrote, notes=("taken as SI",))
    wrote.to_npz(path)
    read = read_measurement(path)
    for name in ("frequency", "frf", "measured"):
        assert torch.equal(getattr(read, name), getattr(wrote, name))
    for name in ("response", "reference", "kind", "unit", "notes"):
        assert getattr(read, name) == getattr(wrote, name)
    assert (read.coherence is None) == (wrote.coherence is None)
    if wrote.coherence is not None:
        assert torch.equal(read.coherence, wrote.coherence)
    assert read.source == str(path)


def test_an_archive_needs_no_more_than_four_arrays_and_a_kind(tmp_path):
    path = tmp_path / "plain.npz"
    frf = np.array([[[1 + 2j, np.nan]], [[3 - 1j, np.nan]], [[0.5j, np.nan]]])
    np.savez(path, frequency=[1.0, 2.0, 4.0], frf=frf, response=[7], reference=[5, 2])
    with pytest.raises(MeasurementError, match=r"Set measurement\.kind"):
        read_measurement(path)
    read = read_measurement(path, "receptance")
    assert read.reference == (Channel(5), Channel(2))
    assert read.measured.tolist() == [[True, False]]
    assert read.unit == "m/N"


@pytest.mark.parametrize(
    ("arrays", "word"),
    [
        ({"frequency": [1.0]}, "Add frf, response, reference"),
        ({"frequency": [1.0], "frf": [1.0 + 1j], "response": [1], "reference": [1]}, "n_frequency, n_response"),
        (
            {"frequency": [1.0], "frf": [[[1.0 + 1j]]], "response": [1], "reference": [1], "kind": "stiffness"},
            "'stiffness'",
        ),
        (
            {"frequency": [1.0], "frf": [[[1j]]], "response": [1], "reference": [1], "response_coordinate": [[0, 0]]},
            "response_coordinate",
        ),
    ],
)
def test_an_archive_that_does_not_fit_is_refused(arrays, word, tmp_path):
    path = tmp_path / "wrong.npz"
    np.savez(path, **({"kind": "mobility"} | arrays))
    with pytest.raises(MeasurementError, match=r"wrong\.npz") as caught:
        Measurement.from_npz(path)
    assert word in str(caught.value)


@pytest.mark.parametrize(("first", "last"), [(5, 6), (40, 41), (10, 200)])
def test_an_archive_that_lacks_bytes_is_refused_in_a_sentence(make_measurement, tmp_path, first, last):
    """An array is then said to lie before the beginning of the file."""
    path = tmp_path / "short.npz"
    make_measurement().to_npz(path)
    whole = path.read_bytes()
    path.write_bytes(whole[:first] + whole[last:])
    with pytest.raises(MeasurementError, match=r"short\.npz"):
        Measurement.from_npz(path)
    # Whoever else reads it is told by the same error that every other damage makes.
    with pytest.raises(ValueError, match="not where the archive says"):
        arrays_of(path)


def test_a_file_that_is_no_archive_is_refused(tmp_path):
    path = tmp_path / "text.npz"
    path.write_text("frequency")
    with pytest.raises(MeasurementError, match=r"NumPy \.npz archive"):
        read_measurement(path)


def test_natural_frequencies_are_sorted_by_mode():
    table = NaturalFrequencies.from_mapping({6: 70.5, 1: 4.5, 2: 7})
    assert table.mode.tolist() == [1, 2, 6]
    assert table.frequency.tolist() == [4.5, 7.0, 70.5]
    repeated = NaturalFrequencies.from_mapping({4: 24.0, 5: 24.0})
    assert repeated.frequency.tolist() == [24.0, 24.0]


@pytest.mark.parametrize(
    ("table", "word"),
    [
        ({}, "0 modes"),
        ({0: 4.5}, "counted from 1"),
        ({1: -4.5}, "-4.5 for mode 1"),
        ({1: 4.5, 2: float("nan")}, "nan for mode 2"),
        ({1: 4.5, 6: 70.5, 7: 68.0}, "70.5 Hz for mode 6 and 68 Hz for mode 7"),
    ],
)
def test_a_table_that_cannot_be_is_refused(table, word):
    with pytest.raises(MeasurementError, match="natural_frequencies") as caught:
        NaturalFrequencies.from_mapping(table)
    assert word in str(caught.value)


def test_a_mode_named_twice_is_refused():
    with pytest.raises(MeasurementError, match="each mode once"):
        NaturalFrequencies(torch.tensor([2, 2]), torch.tensor([5.0, 6.0]))
