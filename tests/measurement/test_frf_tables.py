"""FRFs that MATLAB, NumPy, spreadsheets and analysers write without nodes are read, named and go on."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from torchplate.measurement import (
    Layout,
    Measurement,
    MeasurementError,
    frfs_of_tables,
    read_frf_table,
    read_measurement,
)

LINES = np.linspace(2.0, 402.0, 161)
RESPONSE, REFERENCE = (3, 7), (28, 102, 104)


def _frfs() -> np.ndarray:
    """[line, response, reference]: six modes of a plate that could be."""
    rng = np.random.default_rng(5)
    centre, shape = np.array([31.0, 77.0, 120.0, 201.0, 290.0, 377.0]), rng.normal(size=(6, 2, 3))
    square = LINES[:, None, None, None] ** 2
    return (shape * -square / (centre[:, None, None] ** 2 * (1 + 0.01j) - square)).sum(1)


FRF = _frfs()
ONE = FRF[:, 0]


def table(columns: dict[str, np.ndarray], mark: str = ",", point: str = ".", below: str = "", above: str = "") -> str:
    rows = zip(*columns.values(), strict=True)
    lines = [mark.join(f"{value:.17g}".replace(".", point) for value in row) for row in rows]
    return above + "\n".join([mark.join(columns), *([below] if below else []), *lines]) + "\n"


def as_fortran(text: str) -> str:
    """A table as Fortran writes numbers: 0.30000000000000000D+01."""
    head, *rows = text.splitlines()
    cells = ([f"{float(cell):.17E}".replace("E", "D") for cell in row.split(",")] for row in rows)
    return "\n".join([head, *map(",".join, cells)]) + "\n"


def halves(first: str, second: str) -> dict[str, np.ndarray]:
    found = {"Frequency [Hz]": LINES}
    for k in range(3):
        found |= {f"{first} {k + 1}": ONE[:, k].real, f"{second} {k + 1}": ONE[:, k].imag}
    return found


POLAR = {"Freq": LINES, "Magnitude": np.abs(ONE[:, 0]), "Phase": np.degrees(np.angle(ONE[:, 0]))}
DECIBEL = {"f (Hz)": LINES, "Betrag [dB]": 20 * np.log10(np.abs(ONE[:, 0])), "Phase [rad]": np.angle(ONE[:, 0])}

# What other programs write → (name of the file, how it is written), three FRFs of one response each.
THREE: dict[str, tuple[str, Callable[[Path], object]]] = {
    "columns of MATLAB": ("frf.mat", lambda p: scipy.io.savemat(p, {"freq": LINES[:, None], "H": ONE})),
    "rows in a struct": ("frf.mat", lambda p: scipy.io.savemat(p, {"FRF": {"f": LINES, "H": ONE.T, "unit": "m/s2"}})),
    "MATLAB 4": ("frf.mat", lambda p: scipy.io.savemat(p, {"frequency": LINES, "txy": ONE}, format="4")),
    "parts of MATLAB": (
        "frf.mat",
        lambda p: scipy.io.savemat(p, {"f": LINES, "H_real": ONE.real, "H_imag": ONE.imag}),
    ),
    "outputs, inputs": ("frf.mat", lambda p: scipy.io.savemat(p, {"f": LINES, "frf": ONE[:, None]})),
    "rad/s": ("frf.mat", lambda p: scipy.io.savemat(p, {"omega": 2 * np.pi * LINES, "H": ONE})),
    "NumPy": ("frf.npz", lambda p: np.savez(p, f=LINES, H=ONE)),
    "NumPy without nodes": ("frf.npz", lambda p: np.savez(p, frequency=LINES, frf=ONE[:, None])),
    "spreadsheet": ("frf.csv", lambda p: p.write_text(table(halves("Re H [m/s²/N]", "Im H [m/s²/N]")))),
    "Fortran": ("frf.csv", lambda p: p.write_text(as_fortran(table(halves("re", "im"))))),
    "spreadsheet of Germany": (
        "frf.csv",
        lambda p: p.write_bytes(table(halves("Realteil", "Imaginärteil"), ";", ",").encode("cp1252")),
    ),
    "spreadsheet under a title and over units": (
        "frf.txt",
        lambda p: p.write_bytes(
            table(halves("real", "imag"), "\t", below="\t".join(["Hz", *["m/s2/N"] * 6]), above="Plate 3\nHits: 5\n")
            .replace("\n", "\r\n")
            .encode()
        ),
    ),
}
SINGLE: dict[str, tuple[str, Callable[[Path], object]]] = {
    "degrees": ("frf.csv", lambda p: p.write_text(table(POLAR))),
    "decibel": ("frf.csv", lambda p: p.write_text(table(DECIBEL, ";", ","))),
    "decibel over a value": (
        "frf.csv",
        lambda p: p.write_text(
            table({"f [Hz]": LINES, "Mag (dB re 1e-6 m/s2/N)": DECIBEL["Betrag [dB]"] + 120, "H1 °": POLAR["Phase"]})
        ),
    ),
    "from high to low": (
        "frf.csv",
        lambda p: p.write_text(table({name: value[::-1] for name, value in POLAR.items()})),
    ),
    "parts of π": (
        "frf.csv",
        lambda p: p.write_text(table({**POLAR, "Phase": POLAR["Phase"] / 180}).replace("Phase", "Phase [pi]")),
    ),
    "decibel and degrees in a line of units": (
        "frf.csv",
        lambda p: p.write_text(table({**POLAR, "Magnitude": DECIBEL["Betrag [dB]"]}, below="Hz,dB,deg")),
    ),
    "parts of π in a line of units": (
        "frf.csv",
        lambda p: p.write_text(table({**POLAR, "Phase": POLAR["Phase"] / 180}, below="Hz,m/s2/N,π rad")),
    ),
    "complex cells of Fortran's": (
        "frf.csv",
        lambda p: p.write_text(
            "f,H\n"
            + "".join(f"{f},{h.real:.17E}{h.imag:+.17E}i\n" for f, h in zip(LINES, ONE[:, 0], strict=True)).replace(
                "E", "D"
            )
        ),
    ),
    "complex cells": (
        "frf.csv",
        lambda p: p.write_text(
            "f,H\n" + "".join(f"{f},{h.real}{h.imag:+}i\n" for f, h in zip(LINES, ONE[:, 0], strict=True))
        ),
    ),
    "a table of pandas": (
        "frf.csv",
        lambda p: p.write_text(
            ",freq,H\n" + "".join(f"{i},{f},{h}\n" for i, (f, h) in enumerate(zip(LINES, ONE[:, 0], strict=True)))
        ),
    ),
}


def named(path: Path, responses: tuple[int, ...], references: tuple[int, ...], **settings: object) -> Measurement:
    found = read_frf_table(path)
    assert found is not None
    return frfs_of_tables([path], [found], Layout(responses=responses, **settings), references)


@pytest.mark.parametrize("case", [*THREE, *SINGLE])
def test_frfs_are_read_as_they_were_written(case, tmp_path):
    name, write = (THREE | SINGLE)[case]
    write(tmp_path / name)
    n = 3 if case in THREE else 1
    found = named(tmp_path / name, RESPONSE[:1], REFERENCE[:n])
    assert (found.kind, found.unit) == ("accelerance", "m/(N s²)")
    # Seventeen digits, through decibel and radians.
    np.testing.assert_allclose(found.frequency.numpy(), LINES, rtol=1e-12)
    np.testing.assert_allclose(found.frf[:, 0].numpy(), ONE[:, :n], rtol=1e-11)
    assert [one.node for one in found.reference] == list(REFERENCE[:n])


@pytest.mark.parametrize("turned", [False, True])
def test_an_array_of_responses_and_references_goes_by_its_shape(turned, tmp_path):
    np.savez(tmp_path / "frf.npz", freq=LINES, G=FRF.transpose(0, 2, 1) if turned else FRF)
    np.testing.assert_array_equal(named(tmp_path / "frf.npz", RESPONSE, REFERENCE).frf.numpy(), FRF)


def test_phases_in_parts_of_pi_that_no_head_names_are_said_and_those_that_one_names_are_read(tmp_path):
    parts = POLAR | {"Phase": POLAR["Phase"] / 180}
    (tmp_path / "frf.csv").write_text(table(parts))
    found = read_frf_table(tmp_path / "frf.csv")
    assert found is not None
    (note,) = found.notes
    assert "they look like parts of π, and were taken in rad" in note
    assert "'Phase [pi]'" in note
    np.testing.assert_allclose(np.angle(found.frf[:, 0]), parts["Phase"], atol=1e-12)
    for head, words in (("Phase [rad]", None), ("Phase [pi]", "parts of π, by its head"), ("Phase/π", "by its head")):
        (tmp_path / "frf.csv").write_text(table(parts).replace("Phase", head))
        found = read_frf_table(tmp_path / "frf.csv")
        assert found is not None
        assert (words in found.notes[0]) if words else not found.notes
    (tmp_path / "frf.csv").write_text(table(POLAR | {"Phase": np.radians(POLAR["Phase"])}))
    found = read_frf_table(tmp_path / "frf.csv")
    assert found is not None
    assert not found.notes


def test_lines_that_are_turned_round_are_said(tmp_path):
    (tmp_path / "frf.csv").write_text(table({name: value[::-1] for name, value in POLAR.items()}))
    found = read_frf_table(tmp_path / "frf.csv")
    assert found is not None
    assert found.notes == ("The lines go from high to low frequencies, and were turned round.",)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        # Decibel that no head names: a level of −3 is an amplitude of 3, half a turn off.
        (POLAR | {"Magnitude": DECIBEL["Betrag [dB]"]}, r"0 and above in 'Magnitude', got -.*'Magnitude \[dB\]'"),
        ({"Freq": np.sort(np.r_[LINES, 40.0, 40.0])[:161]} | dict(list(POLAR.items())[1:]), "rise from line to line"),
        ({"x [Hz]": np.roll(LINES, 7)} | dict(list(POLAR.items())[1:]), r"'x \[Hz\]', which repeats some or goes back"),
    ],
)
def test_a_table_that_would_be_read_wrong_is_refused(columns, words, tmp_path):
    (tmp_path / "frf.csv").write_text(table(columns))
    with pytest.raises(MeasurementError, match=words):
        read_frf_table(tmp_path / "frf.csv")


def test_files_of_one_hit_each_go_together(tmp_path):
    paths = [tmp_path / f"hit_{node}.mat" for node in REFERENCE]
    for k, path in enumerate(paths):
        scipy.io.savemat(path, {"f": LINES, "H": FRF[:, :, k], "coh": 0.5 + 0.1 * k * np.ones(FRF.shape[:2])})
    tables = [found for path in paths if (found := read_frf_table(path)) is not None]
    found = frfs_of_tables(paths, tables, Layout(responses=RESPONSE), REFERENCE)
    np.testing.assert_array_equal(found.frf.numpy(), FRF)
    assert found.coherence is not None
    np.testing.assert_allclose(found.coherence[0].numpy(), [[0.5, 0.6, 0.7]] * 2)


def test_the_unit_of_a_head_gives_kind_and_level(tmp_path):
    columns = {"Frequency (kHz)": LINES / 1e3, "Re [mm/s/N]": 1e3 * ONE[:, 0].real, "Im [mm/s/N]": 1e3 * ONE[:, 0].imag}
    (tmp_path / "frf.csv").write_text(table(columns))
    found = named(tmp_path / "frf.csv", (3,), (28,))
    assert found.kind == "mobility"
    np.testing.assert_allclose(found.frequency.numpy(), LINES, rtol=1e-12)
    np.testing.assert_allclose(found.frf[:, 0, 0].numpy(), ONE[:, 0], rtol=1e-12)
    assert found.notes == ()


def test_what_nobody_said_is_told_and_what_is_told_counts(tmp_path):
    np.savez(tmp_path / "frf.npz", f=LINES, H=ONE[:, 0])
    kind, level = named(tmp_path / "frf.npz", (3,), (28,)).notes
    assert "taken as accelerance. --motion" in kind
    assert "--scale" in level
    found = named(tmp_path / "frf.npz", (3,), (28,), motion="velocity", scale=(50.0, 100.0))
    assert found.notes == ()
    assert found.kind == "mobility"
    np.testing.assert_allclose(found.frf[:, 0, 0].numpy(), 2 * ONE[:, 0])


def test_time_records_are_none(tmp_path):
    time = np.arange(512) / 2048.0
    hit, answer = np.exp(-(((time - 0.01) / 1e-3) ** 2)), np.sin(300 * time)
    (tmp_path / "hit.csv").write_text(table({"Time [s]": time, "Force [N]": hit, "Acc [m/s²]": answer}))
    (tmp_path / "short.csv").write_text(table({"t": time, "F": hit, "a": answer}))
    scipy.io.savemat(tmp_path / "hit.mat", {"fs": 2048.0, "force": hit, "acc": answer})
    np.savez(tmp_path / "hit.npz", fs=2048.0, f=hit, response=answer)
    (tmp_path / "frequencies.csv").write_text("mode;frequency\n1;41,3\n2;77,9\n")
    (tmp_path / "hit.wav").write_bytes(b"RIFF")
    for name in ("hit.csv", "short.csv", "hit.mat", "hit.npz", "hit.wav", "frequencies.csv", "absent.mat"):
        assert read_frf_table(tmp_path / name) is None, name


# What cannot be used → (columns or arrays, words of the sentence).
REFUSED = {
    "amplitudes": (
        {"f": LINES, "Magnitude": np.abs(ONE[:, 0])},
        ["phase part beside 'Magnitude'", "real and imaginary"],
    ),
    "one part": ({"f": LINES, "real": ONE[:, 0].real}, ["imaginary part beside 'real'"]),
    "other names": ({"f": LINES, "one": ONE[:, 0].real, "two": ONE[:, 0].imag}, ["got one, two", "real and imaginary"]),
    "another axis": ({"f [m]": LINES, "re": LINES, "im": LINES}, ["frequencies in Hz", "'m'"]),
    "units alone": ({"[Hz]": LINES, "[g/N]": ONE[:, 0].real}, ["got [g/N]", "magnitude and phase"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_used_is_said_with_the_way_on(case, tmp_path):
    columns, words = REFUSED[case]
    (tmp_path / "frf.csv").write_text(table(columns))
    with pytest.raises(MeasurementError) as said:
        read_frf_table(tmp_path / "frf.csv")
    assert all(word in str(said.value) for word in ["frf.csv", *words]), said.value


def test_a_line_at_zero_that_is_no_number_is_left_out_and_said_and_any_other_is_refused(tmp_path):
    """MATLAB divides by nothing there."""
    columns = {"f": np.r_[0.0, LINES], "re": np.r_[np.nan, ONE[:, 0].real], "im": np.r_[np.inf, ONE[:, 0].imag]}
    (tmp_path / "frf.csv").write_text(table(columns))
    found = read_frf_table(tmp_path / "frf.csv")
    assert found is not None
    assert found.notes == ("The line at 0 Hz holds no finite number, and was left out.",)
    np.testing.assert_array_equal(found.frequency, LINES)
    np.testing.assert_allclose(found.frf[:, 0], ONE[:, 0], rtol=1e-12)
    (tmp_path / "frf.csv").write_text(table(columns | {"f": np.r_[0.0, LINES] + 3.5}))
    with pytest.raises(MeasurementError, match=r"frf\.csv: expected finite FRFs, got NaN or infinity at 3\.5 Hz"):
        read_frf_table(tmp_path / "frf.csv")


@pytest.mark.parametrize(
    ("responses", "references", "words"),
    [
        ((3,), (28,), ["nodes of its 3 FRFs", "1 response and 1 reference", "--response 3 --reference 28 102"]),
        ((3, 7), (28, 102), ["2 responses and 2 references"]),
    ],
)
def test_another_number_of_nodes_is_said(responses, references, words, tmp_path):
    np.savez(tmp_path / "frf.npz", f=LINES, H=ONE)
    with pytest.raises(MeasurementError) as said:
        named(tmp_path / "frf.npz", responses, references)
    assert all(word in str(said.value) for word in words), said.value


def test_columns_of_several_responses_and_references_have_no_order_of_their_own(tmp_path):
    np.savez(tmp_path / "frf.npz", f=LINES, H=FRF.reshape(len(LINES), -1))
    with pytest.raises(MeasurementError, match=r"array \[line, response, reference\] of 2 × 3"):
        named(tmp_path / "frf.npz", RESPONSE, REFERENCE)


def test_files_of_other_lines_are_refused(tmp_path):
    paths = [tmp_path / f"hit_{node}.npz" for node in REFERENCE[:2]]
    for path, lines in zip(paths, (LINES, 1.01 * LINES), strict=True):
        np.savez(path, f=lines, H=ONE[:, 0])
    tables = [found for path in paths if (found := read_frf_table(path)) is not None]
    with pytest.raises(MeasurementError, match="expected the lines of"):
        frfs_of_tables(paths, tables, Layout(responses=(3,)), REFERENCE[:2])


def test_a_file_of_an_unknown_suffix_that_is_a_universal_file_is_to_be_renamed(tmp_path):
    (tmp_path / "plate.dat").write_bytes(b"    -1\r\n   151\r\n")
    with pytest.raises(MeasurementError, match=r"Rename it\."):
        read_measurement(tmp_path / "plate.dat")
    (tmp_path / "other.dat").write_bytes(b"    -10\n")
    with pytest.raises(MeasurementError, match="Export it as UFF 58"):
        read_measurement(tmp_path / "other.dat")
