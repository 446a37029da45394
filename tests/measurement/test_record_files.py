"""Time records come back alike from every format, and a file that is none is refused in one sentence."""

import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat, wavfile

from torchplate.measurement import Layout, MeasurementError, read_frf_table, read_recordings

_spec = importlib.util.spec_from_file_location("hits", Path(__file__).with_name("hits.py"))
assert _spec
assert _spec.loader
made = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(made)
CHANNELS = made.hit(12, n=1024)
STEP = 1 / made.RATE
FULL = 1.05 * np.abs(CHANNELS).max(axis=1)


def wav(path: Path) -> Path:
    samples = np.round(CHANNELS / FULL.max() * 2**31).astype(np.int32)
    wavfile.write(path.with_suffix(".wav"), int(made.RATE), samples.T)
    return path.with_suffix(".wav")


def mat(path: Path) -> Path:
    savemat(
        path.with_suffix(".mat"),
        {"hammer_force": CHANNELS[0], "acc": CHANNELS[1:].T, "fs": made.RATE, "comment": "of a test"},
    )
    return path.with_suffix(".mat")


def npz(path: Path) -> Path:
    np.savez(path.with_suffix(".npz"), force=CHANNELS[:1], response=CHANNELS[None, 1:], dt=STEP)
    return path.with_suffix(".npz")


def csv(path: Path) -> Path:
    time = np.arange(1024) * STEP
    rows = np.column_stack([time, CHANNELS[1], CHANNELS[0], CHANNELS[2]])
    lines = ["time [s],acc 1,force [N],acc 2", *(",".join(f"{x:.12g}" for x in row) for row in rows)]
    path.with_suffix(".csv").write_text("\n".join(lines))
    return path.with_suffix(".csv")


def german(path: Path) -> Path:
    rows = np.column_stack([np.arange(1024) * STEP, CHANNELS.T])
    lines = ["Zeit;Kraft;a1;a2", *(";".join(f"{x:.12g}".replace(".", ",") for x in row) for row in rows)]
    path.with_suffix(".txt").write_text("\n".join(lines))
    return path.with_suffix(".txt")


def lvm(path: Path, x_columns: str = "No") -> Path:
    """As LabVIEW writes it: without times, with one column of them, or with one before each channel."""
    pytest.importorskip("lvm_read", reason="lvm-read is an extra")
    each = x_columns == "Multi"
    told = {
        "Channels": ["3", "", ""],
        "Samples": ["1024"] * 3,
        "Y_Unit_Label": ["N", "m/s^2", "m/s^2"],
        "X_Dimension": ["Time"] * 3,
        "X0": ["0"] * 3,
        "Delta_X": [f"{STEP}"] * 3,
    }
    blank = "\t" if each else ""
    lines = ["\t".join([key, *(f"{cell}{blank}" for cell in cells), ""]) for key, cells in told.items()]
    names = ["X_Value", "Force", *(["X_Value"] if each else []), "A1", *(["X_Value"] if each else []), "A2"]
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        f"Multi_Headings\tNo\nX_Columns\t{x_columns}\nTime_Pref\tRelative\n***End_of_Header***\t\n\t\n"
        + "\n".join([*lines, "***End_of_Header***\t\t\t\t", "\t".join([*names, "Comment"])])
        + "\n"
    )
    rows = []
    for turn, row in enumerate(CHANNELS.T):
        time = "" if x_columns == "No" else f"{turn * STEP:.6f}"
        cells = [cell for x in row for cell in (time, f"{x:.12g}")]
        rows.append("\t".join(cells if each else [time, *cells[1::2], *([""] if x_columns == "No" else [])]))
    path.with_suffix(".lvm").write_text(head + "\n".join(rows) + "\n")
    return path.with_suffix(".lvm")


# 24 bits and more in WAV, twelve digits elsewhere.
@pytest.mark.parametrize("write", [mat, npz, csv, german, lvm, wav], ids=lambda f: f.__name__)
def test_every_format_gives_the_same_records(write: Callable[[Path], Path], tmp_path):
    scale = FULL.max() if write is wav else 1.0
    layout = Layout(responses=(7, 2), reference=12, scale=(scale, scale))
    (found,) = read_recordings(write(tmp_path / "hit"), layout)
    assert found.rate == pytest.approx(made.RATE, rel=1e-6)
    np.testing.assert_allclose(found.force, CHANNELS[0], atol=1e-7 * FULL.max())
    np.testing.assert_allclose(found.response, CHANNELS[1:], atol=1e-7 * FULL.max())
    assert (found.reference, found.responses) == (12, (7, 2))


def test_samples_of_eight_bits_have_their_zero_in_the_middle(tmp_path):
    """The only ones of WAV without a sign: silence is 128."""
    samples = np.round(CHANNELS / FULL.max() * 127 + 128).astype(np.uint8)
    wavfile.write(tmp_path / "12.wav", int(made.RATE), samples.T)
    (found,) = read_recordings(tmp_path / "12.wav", Layout(scale=(FULL.max(), FULL.max())))
    # Half a step, and full scale is 128 steps, of which 127 are used.
    np.testing.assert_allclose(found.force, CHANNELS[0], atol=1.6 / 128 * FULL.max())
    np.testing.assert_allclose(found.response, CHANNELS[1:], atol=1.6 / 128 * FULL.max())


def test_a_file_without_a_sample_is_refused_without_a_warning(tmp_path, recwarn):
    wavfile.write(tmp_path / "12.wav", 2048, CHANNELS.T[:0].astype(np.float32))
    with pytest.raises(MeasurementError, match=r"12\.wav: expected samples, got none"):
        read_recordings(tmp_path / "12.wav")
    assert not recwarn.list


@pytest.mark.parametrize("x_columns", ["One", "Multi"])
def test_times_that_labview_has_written_are_no_channel(x_columns, tmp_path):
    """The largest of all columns, and the only one that rises: they were taken for the force."""
    (found,) = read_recordings(lvm(tmp_path / "hit", x_columns), Layout(responses=(7, 2), reference=12))
    assert found.has_unit
    np.testing.assert_allclose(found.force, CHANNELS[0], atol=1e-7 * FULL.max())
    np.testing.assert_allclose(found.response, CHANNELS[1:], atol=1e-7 * FULL.max())


def test_several_hits_of_an_archive_come_apart(tmp_path):
    hits = np.stack([made.hit(12, n=512, peak=20.0 + i) for i in range(3)])
    np.savez(tmp_path / "hits.npz", force=hits[:, 0], response=hits[:, 1:], fs=made.RATE)
    found = read_recordings(tmp_path / "hits.npz")
    assert len(found) == 3
    np.testing.assert_allclose(found[2].response, hits[2, 1:])


def test_samples_may_come_before_channels(tmp_path):
    hits = np.stack([made.hit(12, n=512, peak=20.0 + i) for i in range(2)])
    np.savez(tmp_path / "hits.npz", force=hits[:, 0], response=hits[:, 1:].transpose(0, 2, 1), fs=made.RATE)
    np.testing.assert_allclose(read_recordings(tmp_path / "hits.npz")[1].response, hits[1, 1:])


def uff_records(record_58: Callable[..., bytes], channels: np.ndarray, unit: str = "N") -> bytes:
    parts = []
    for row, node, direction, quantity in zip(
        channels, (12, 7, 2), (-3, 3, -3), ((13, unit), (12, "m/s2"), (12, "g")), strict=False
    ):
        factor = 9.80665 if quantity[1] == "g" else 1.0
        sign = -1 if direction < 0 else 1
        texts = [f"{sign * x / factor:20.11E}" for x in row]
        lines = ["".join(texts[i : i + 4]) for i in range(0, len(texts), 4)]
        parts.append(
            record_58(
                lines, n_point=len(row), ordinate_type=4, start=0.0, step=STEP, function_type=1,
                response=(node, direction), reference=(0, 0), numerator=quantity, denominator=(0, "NONE"),
            )
        )  # fmt: skip
    return b"".join(parts)


def test_a_universal_file_gives_nodes_signs_and_units(tmp_path, record_58):
    path = tmp_path / "hits.uff"
    second = made.hit(12, n=1024, peak=31.0)
    path.write_bytes(uff_records(record_58, CHANNELS) + uff_records(record_58, second))
    found = read_recordings(path)
    assert len(found) == 2
    assert (found[0].reference, found[0].responses, found[0].motion, found[0].has_unit) == (
        12,
        (7, 2),
        "acceleration",
        True,
    )
    # The header's step has six digits.
    assert found[0].rate == pytest.approx(made.RATE, rel=1e-5)
    for one, channels in zip(found, (CHANNELS, second), strict=True):
        np.testing.assert_allclose(one.force, channels[0], atol=1e-9)
        np.testing.assert_allclose(one.response, channels[1:], atol=1e-7)


def test_a_universal_files_own_rate_is_said_where_another_was_told(tmp_path, record_58):
    path = tmp_path / "hits.uff"
    path.write_bytes(uff_records(record_58, CHANNELS))
    (found,) = read_recordings(path, Layout(rate=3 * made.RATE))
    assert found.rate == 3 * made.RATE
    assert [note for note in found.notes if f"own rate is {made.RATE:.6g} Hz" in note]
    (found,) = read_recordings(path, Layout(rate=made.RATE))
    assert not [note for note in found.notes if "own rate" in note]


def test_a_universal_file_without_a_force_says_what_is_missing(tmp_path, record_58):
    path = tmp_path / "hits.uff"
    path.write_bytes(uff_records(record_58, CHANNELS)[len(uff_records(record_58, CHANNELS[:1])) :])
    with pytest.raises(MeasurementError, match="no force"):
        read_recordings(path)


def refused(name: str, content: bytes | None, folder: Path, layout: Layout | None = None) -> str:
    path = folder / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(MeasurementError) as caught:
        read_recordings(path, layout)
    text = str(caught.value)
    assert "\n" not in text
    assert name in text
    return text


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("absent.wav", None, "none there"),
        ("hits.xlsx", b"PK", "suffix '.xlsx'"),
        ("hits.wav", b"RIFF nothing", "WAV"),
        ("hits.mat", b"not a mat file at all", "MAT"),
        ("hits.mat", b"", "MAT"),
        ("hits.npz", b"PK\x03\x04broken", "NPZ"),
        ("hits.lvm", b"hello", "LVM"),
        ("hits.csv", b"", "got none"),
        ("hits.csv", b"time,force,acc\n0,1,2\n0.1,3\n", "rows of 2 and 3 numbers"),
        ("hits.csv", b"time,force,acc\n0,1,2\n0.1,3,x\n", "numbers in each row"),
        ("hits.csv", b"time,force\n0,1\n0.1,3\n0.2,2\n", "got 1 channel"),
        ("hits.csv", b"0,1,2\n0.1,1,2\n0.3,1,2\n0.4,1,1\n", "equal steps"),
        ("hits.csv", b"1,1,2\n0.5,1,2\n", "Give --rate"),
        ("hits.uff", b"    -1\n    15\n    -1\n", "function type 1"),
        ("hits.uff", b"nothing", "universal file"),
    ],
)
def test_a_file_that_is_none_is_refused_in_one_sentence(name, content, words, tmp_path):
    assert words in refused(name, content, tmp_path)


@pytest.mark.parametrize(
    "settings", [{"rate": 0.0}, {"rate": -48e3}, {"rate": np.nan}, {"rate": np.inf}, {"scale": (0.0, 1.0)}]
)
def test_a_rate_or_a_factor_that_is_none_is_refused(settings):
    with pytest.raises(ValueError, match=r"Expected (a rate above 0 Hz, got|factors other than 0 to N and SI, got)"):
        Layout(**settings)


@pytest.mark.parametrize("write", [wav, npz, csv], ids=lambda f: f.__name__)
def test_a_rate_that_is_told_counts_before_the_files_own_which_is_said(write, tmp_path):
    path = write(tmp_path / "12")
    (found,) = read_recordings(path, Layout(rate=1.25 * made.RATE))
    assert found.rate == 1.25 * made.RATE
    (note,) = [note for note in found.notes if "--rate" in note]
    assert f"own rate is {made.RATE:.6g} Hz, and {1.25 * made.RATE:.6g} Hz was taken" in note
    # As a column of times with few digits says it.
    for rate in (None, 1.0004 * made.RATE):
        (found,) = read_recordings(path, Layout(rate=rate))
        assert not [note for note in found.notes if "--rate" in note]


def test_arrays_without_a_force_name_what_there_is(tmp_path):
    np.savez(tmp_path / "hits.npz", left=np.zeros(64), right=np.zeros(64), fs=100.0)
    assert "left, right, fs" in refused("hits.npz", None, tmp_path)


def test_a_force_channel_that_is_not_there_is_named(tmp_path):
    csv(tmp_path / "hit")
    assert "acc 1, force [N], acc 2" in refused("hit.csv", None, tmp_path, Layout(force="hammer"))
    assert "each of 2 responses, got 1" in refused("hit.csv", None, tmp_path, Layout(responses=(3,)))


def test_names_that_are_no_text_are_quoted_in_short(tmp_path, monkeypatch):
    """A mutated file had the bytes of all its arrays for the name of one."""
    savemat(tmp_path / "hits.mat", {"other": np.zeros(3)})
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: {400 * "\x08\x9b \x00": np.zeros(3)})
    with pytest.raises(MeasurementError) as caught:
        read_recordings(tmp_path / "hits.mat")
    said = str(caught.value).removeprefix(str(tmp_path))
    assert said.isprintable()
    assert len(said) < 350


def test_a_mat_file_that_scipy_trips_over_is_refused_in_a_sentence(tmp_path, monkeypatch):
    savemat(tmp_path / "hits.mat", {"force": np.zeros(3)})

    def unbound(*_, **__):
        raise UnboundLocalError("local variable 'arr' referenced before assignment")

    monkeypatch.setattr("scipy.io.loadmat", unbound)
    with pytest.raises(MeasurementError, match=r"expected a MAT file, got a broken one\. Save it again\."):
        read_frf_table(tmp_path / "hits.mat")
