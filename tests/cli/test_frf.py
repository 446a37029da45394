"""`frf` turns time records of hits into a measurement that `new` takes, and says what it left out."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from torchplate.cli.config.build import load_run
from torchplate.measurement import read_measurement

_spec = importlib.util.spec_from_file_location("hits", Path(__file__).parents[1] / "measurement" / "hits.py")
assert _spec
assert _spec.loader
made = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(made)
FULL = 400.0


def wav(path: Path, *hits: np.ndarray) -> Path:
    """A recording of full scale 400 N and 400 m/s² with several hits in a row."""
    samples = np.concatenate(hits, axis=1) / FULL
    wavfile.write(path, int(made.RATE), np.round(samples * 2**31).astype(np.int32).T)
    return path


@pytest.fixture
def records(tmp_path) -> list[Path]:
    """Three hits at node 12, one of them double, and two at node 7, each node in a file of its own."""
    hits = [made.hit(12, noise=0.002, seed=i, bounce=0.5 * (i == 1), peak=30.0 + i) for i in range(3)]
    return [
        wav(tmp_path / "plate_12.wav", *hits),
        wav(tmp_path / "plate_7.wav", made.hit(7), made.hit(7, peak=28.0)),
    ]


def test_wav_recordings_become_frfs_with_coherence(records, tmp_path, command):
    out = tmp_path / "plate.uff"
    status, text, error = command("frf", *records, "--response", 7, 2, "--scale", FULL, FULL, "--out", out)
    assert (status, error) == (0, "")
    assert "4 FRFs (accelerance, H1) from 2 recordings" in text
    assert "last number in the files' names: 12 (plate_12.wav), 7 (plate_7.wav)" in text
    assert "'channel 1', of 3, has the shortest pulses and was taken; --force names another: --force 2, say.\n" in text
    assert "plate_12.wav, hit 2: the hammer hit twice" in text
    assert f"torchplate new {out} --nodes nodes.csv" in text
    measurement = read_measurement(out)
    assert [c.label for c in measurement.reference] == ["7w", "12w"]
    assert measurement.coherence is not None
    frequency = measurement.frequency.numpy()
    s = 2j * np.pi * frequency
    expected = np.zeros(len(s), dtype=complex)
    for (f, z), a, b in zip(made.MODES, made.SHAPES[2], made.SHAPES[7], strict=True):
        w = 2 * np.pi * f
        expected += a * b * s**2 / (w**2 + 2 * z * w * s + s**2)
    band = (frequency > 30) & (frequency < 200)
    found = measurement.frf[:, 0, 0].numpy()
    # The sampled impulse response is aliased, and the first hit still rings a little when the second falls.
    assert np.linalg.norm((found - expected)[band]) < 0.03 * np.linalg.norm(expected[band])


def test_the_written_frfs_are_within_a_thousandth_of_those_of_pyfrf(tmp_path, command):
    from pyFRF import FRF

    hits = [made.hit(12, n=4096, noise=0.004, seed=i, peak=30.0 + 4 * i) for i in range(4)]
    paths = []
    for number, hit in enumerate(hits):
        paths.append(tmp_path / f"hit_{number}.npz")
        np.savez(paths[-1], force=hit[0], response=hit[1:], fs=made.RATE)
    out = tmp_path / "plate.uff"
    options = ("--response", 7, 2, "--reference", 12, "--pre-trigger", 60 / made.RATE, "--keep-all", "--out", out)
    assert command("frf", *paths, *options)[0] == 0
    found = read_measurement(out)
    # The records are whole, from sample 0: pyFRF gets them as they are, and leaves spectra as they are for "d".
    force, response = np.stack([hit[0] for hit in hits])[:, None], np.stack([hit[1:] for hit in hits])
    theirs = FRF(int(made.RATE), force, response, resp_type="d", frf_estimator="H1")
    n_line = len(found.frequency)
    expected = theirs.get_FRF()[:, 0].T[:n_line]
    # Responses are sorted by node: 2 before 7.
    ours = found.frf[:, :, 0].numpy()[:, ::-1]
    strong = np.abs(expected) > 0.01 * np.abs(expected).max()
    # At 0 Hz pyFRF writes what it extrapolates.
    strong[0] = False
    np.testing.assert_allclose(ours[strong], expected[strong], rtol=1e-3)
    assert found.coherence is not None
    coherence = found.coherence[:, :, 0].numpy()[:, ::-1]
    np.testing.assert_allclose(coherence[strong], theirs.get_coherence().T[:n_line][strong], rtol=1e-3)


def test_an_archive_is_written_where_the_name_asks_for_one(records, tmp_path, command):
    out = tmp_path / "out" / "plate.npz"
    assert command("frf", records[1], "--response", 7, 2, "--estimator", "Hv", "--out", out)[0] == 0
    assert read_measurement(out).kind == "accelerance"


def test_the_motion_and_the_node_are_as_told(records, tmp_path, command):
    out = tmp_path / "plate.uff"
    options = ("--response", 7, 2, "--reference", 31, "--motion", "velocity", "--exponential-window", 0.5)
    status, text, _ = command("frf", records[1], *options, "--out", out)
    assert status == 0
    assert "{effect: exponential_window, rate: 2}" in text
    assert "state no unit" in text
    assert read_measurement(out).kind == "mobility"
    assert read_measurement(out).reference[0].node == 31


def test_places_come_from_a_table(records, tmp_path, command):
    (tmp_path / "nodes.csv").write_text("2,0.1,0\n7,0.2,0.1\n12,0.3,0.2\n")
    out = tmp_path / "plate.uff"
    options = ("--response", 7, 2, "--nodes", tmp_path / "nodes.csv")
    assert command("frf", *records, *options, "--out", out)[0] == 0
    assert read_measurement(out).reference[1].coordinate == pytest.approx((0.3, 0.2, 0.0))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--response", 7, 2, "--out", "plate.txt"), ".uff or .npz"),
        (("--out", "plate.uff"), "--response 3"),
        (("--response", 7, "--out", "plate.uff"), "each of 2 responses, got 1"),
        (("--response", 7, 2, "--reference", 1, 2, 3, "--out", "plate.uff"), "each of 2 files"),
        (("--response", 7, 2, "--trigger", 2, "--out", "plate.uff"), "trigger"),
        (("--response", 7, 2, "--force-window", -1, "--out", "plate.uff"), "force window above 0 s"),
        (("--response", 3, 3, "--out", "plate.uff"), "--response: Expected a node of its own for each response, got 3"),
        (("--response", 7, 2, "--force-window", 0.001, "--out", "plate.uff"), "--force-window 0.012"),
        (("--response", 7, 2, "--exponential-window", 1e-4, "--out", "plate.uff"), "more than one sample, 0.000488 s"),
        (("--response", 7, 2, "--force", 9, "--out", "plate.uff"), "1 to 3"),
        (("--response", 7, 2, "--duration", 60, "--out", "plate.uff"), "ends before the hit has"),
        (("--response", 7, 2, "--nodes", "absent.csv", "--out", "plate.uff"), "absent.csv"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(options, words, records, tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, _, error = command("frf", *(path.name for path in records), *options)
    assert status == 2
    assert words in error
    assert error.count("\n") == 1


def test_a_name_without_a_number_needs_the_node(tmp_path, command):
    path = wav(tmp_path / "hit.wav", made.hit(12))
    status, _, error = command("frf", path, "--response", 7, 2, "--out", tmp_path / "plate.uff")
    assert status == 2
    assert "--reference 12" in error


def test_a_last_number_that_may_count_the_hits_is_no_node_unasked(tmp_path, command):
    """Hits at different nodes were averaged to one FRF: hit_12_1 and hit_7_1 were both taken for node 1."""
    paths = [wav(tmp_path / f"hit_{node}_{turn}.wav", made.hit(node)) for node in (12, 7) for turn in (1, 2)]
    options = ("--response", 7, 2, "--scale", FULL, FULL, "--out", tmp_path / "plate.uff")
    status, _, error = command("frf", *paths, *options)
    assert (status, error.count("\n")) == (2, 1)
    assert "hit_12_1.wav: Expected the node that is hit as the last number" in error
    assert "got 1, 2 ... after each of 7, 12, which may count the hits" in error
    assert error.endswith("--reference 12 12 7 7, or --reference 1 2 1 2.\n")
    assert not (tmp_path / "plate.uff").exists()
    assert command("frf", *paths, *options, "--reference", 12, 12, 7, 7)[0] == 0
    assert [channel.node for channel in read_measurement(tmp_path / "plate.uff").reference] == [7, 12]


@pytest.mark.parametrize(
    "names",
    [
        # The same nodes in two tests; one file a node; a date before the node.
        ("test1_12", "test1_7", "test2_12", "test2_7"),
        ("plate2_1", "plate2_2", "plate2_3"),
        ("2026-11-25_12", "2026-11-25_7"),
        ("hit_12_1", "hit_7_1"),
    ],
)
def test_other_last_numbers_are_nodes(names, tmp_path, command):
    paths = [wav(tmp_path / f"{name}.wav", made.hit(12)) for name in names]
    status, text, _ = command("frf", *paths, "--response", 7, 2, "--out", tmp_path / "plate.uff")
    assert status == 0
    assert f"{names[0].rpartition('_')[2]} ({names[0]}.wav)" in text


def test_responses_that_are_cut_off_while_they_ring_are_said_to_leak(tmp_path, command):
    """The slower mode decays by exp(−7.7 t): in 0.25 s to 15 %, in 0.49 s to 2 %, in 2 s to nothing."""
    told = {}
    for n, more in ((512, ()), (512, ("--exponential-window", "0.033")), (1000, ()), (4096, ())):
        paths = [wav(tmp_path / f"hit_{node}.wav", made.hit(node, n=n, noise=0.004, seed=node)) for node in (12, 7)]
        options = ("--response", 7, 2, "--scale", FULL, FULL, "--out", tmp_path / "plate.uff", "--overwrite")
        status, told[n, bool(more)], _ = command("frf", *paths, *options, *more)
        assert status == 0
    short = told[512, False]
    assert "The responses still ring where their records end, after a hit at" in short
    assert "Record longer, or give --exponential-window 0.033" in short
    # At 6 % of the whole record's level, where it took 10 %.
    assert "The responses still ring" in told[1000, False]
    assert "ring" not in told[512, True]
    assert "ring" not in told[4096, False]


@pytest.mark.parametrize("suffix", [".uff", ".npz"])
@pytest.mark.check
def test_a_window_that_was_laid_over_the_hits_stands_in_the_config(suffix, tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    paths = [wav(tmp_path / f"hit_{node}.wav", made.hit(node, n=512, seed=node)) for node in (12, 7)]
    Path("nodes.csv").write_text("node,x,y\n12,0.05,0.04\n7,0.3,0.2\n2,0.1,0.18\n")
    options = ("--response", 7, 2, "--scale", FULL, FULL, "--nodes", "nodes.csv", "--exponential-window", 0.04)
    assert command("frf", *paths, *options, "--out", f"plate{suffix}")[0] == 0
    assert read_measurement(Path(f"plate{suffix}")).window == pytest.approx(25.0, rel=1e-9)
    told = ("--length", "0.4", "0.3", "--thickness", "0.002", "--material", "steel", "--out", "plate.yaml")
    assert command("new", f"plate{suffix}", *told)[0] == 0
    config = Path("plate.yaml").read_text()
    (line,) = [line for line in config.splitlines() if line.startswith("  window:")]
    assert "{effect: exponential_window, rate: 25}" in line
    recipe = load_run(Path("plate.yaml"))
    assert not any("windowed by" in one for one in recipe.remarks(recipe.model()))
    Path("plate.yaml").write_text(config.replace(f"{line}\n", ""))
    recipe = load_run(Path("plate.yaml"))
    (said,) = [one for one in recipe.remarks(recipe.model()) if "windowed by" in one]
    assert "Add window: {effect: exponential_window, rate: 25}" in said


@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_a_channel_that_does_not_stand_at_zero_does_not_ring_for_that(offset, tmp_path, command):
    """As of a sound card; a slow mode that rings on still does."""
    for n, rings in ((4096, False), (512, True)):
        paths = [wav(tmp_path / f"hit_{node}.wav", made.hit(node, n=n) + offset * FULL) for node in (12, 7)]
        words = ("--response", 7, 2, "--scale", FULL, FULL, "--out", tmp_path / "plate.uff", "--overwrite")
        assert ("still ring" in command("frf", *paths, *words)[1]) == rings


def test_a_file_that_is_named_twice_is_refused(records, tmp_path, command, monkeypatch):
    """It would be averaged with itself, and have a coherence of 1."""
    monkeypatch.chdir(tmp_path)
    status, _, error = command("frf", records[1], records[1].name, "--response", 7, 2, "--out", "plate.uff")
    assert (status, error.count("\n")) == (2, 1)
    assert f"{records[1]}: Expected each file once" in error
    assert not Path("plate.uff").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--response", 7, 0), "--response: Expected node labels, which count from 1, got 0"),
        (("--response", 7, 2, "--reference", 0, 12), "--reference: Expected node labels, which count from 1, got 0"),
        (("--response", -7, 2), "got -7"),
    ],
)
def test_a_node_below_one_is_refused(options, words, records, tmp_path, command):
    """A reference of 0 was taken for one that is not given."""
    status, _, error = command("frf", *records, *options, "--out", tmp_path / "plate.uff")
    assert (status, error.count("\n")) == (2, 1)
    assert words in error


def test_a_table_of_nodes_in_mm_gives_places_in_m(records, tmp_path, command):
    (tmp_path / "nodes.csv").write_text("node,x [mm],y [mm]\n2,10,20\n7,130,40\n12,260,90\n")
    words = (
        "--response",
        7,
        2,
        "--scale",
        FULL,
        FULL,
        "--nodes",
        tmp_path / "nodes.csv",
        "--out",
        tmp_path / "plate.uff",
    )
    status, text, _ = command("frf", *records, *words)
    assert status == 0
    assert f"places are taken in mm, as the head of {tmp_path / 'nodes.csv'} says." in text
    places = {c.node: c.coordinate for c in read_measurement(tmp_path / "plate.uff").reference}
    assert places[12] == pytest.approx((0.26, 0.09, 0.0), rel=1e-6)


@pytest.mark.parametrize("rate", ["0", "-48000", "nan"])
def test_a_rate_that_is_none_is_refused(rate, records, tmp_path, command, capsys):
    try:
        status, _, error = command("frf", *records, "--response", 7, 2, "--rate", rate, "--out", tmp_path / "plate.uff")
    except SystemExit as ended:  # of the parser, which takes no nan
        status, error = ended.code, capsys.readouterr().err
    assert status == 2
    assert "rate" in error
    assert f"got {rate}" in error.replace("'", "")
    assert not (tmp_path / "plate.uff").exists()


def test_another_rate_than_the_files_is_taken_and_said(records, tmp_path, command):
    out = tmp_path / "plate.uff"
    said = command("frf", *records, "--response", 7, 2, "--scale", FULL, FULL, "--rate", 4096, "--out", out)[1]
    assert "own rate is 2048 Hz, and 4096 Hz was taken" in said
    # All frequencies are twice as high then.
    level = read_measurement(out).frf[:, 0, 0].abs()
    frequency = read_measurement(out).frequency
    below = frequency < 200
    assert float(frequency[below][level[below].argmax()]) == pytest.approx(2 * made.MODES[0][0], rel=0.02)


def test_options_of_hits_are_said_to_be_left_aside_where_the_file_holds_frfs(tmp_path, command):
    (tmp_path / "frf.csv").write_text("f,re,im\n" + "".join(f"{f},{1 / f},{-f / 9}\n" for f in range(1, 40)))
    words = [
        "frf",
        tmp_path / "frf.csv",
        "--response",
        3,
        "--reference",
        28,
        "--out",
        tmp_path / "a.uff",
        "--overwrite",
    ]
    said = command(*words, "--rate", 800, "--exponential-window", 0.5, "--keep-all")[1]
    assert "--rate, --keep-all, --exponential-window: left aside, as the file holds FRFs" in said
    assert "left aside" not in command(*words, "--scale", 2, 3, "--motion", "velocity")[1]
