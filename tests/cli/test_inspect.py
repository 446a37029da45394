"""The report says what the file holds and what looks wrong, and the figure is written where it says."""

import os
import re
import shlex
import signal
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
import pyuff
import torch
from rich.console import Console

from torchplate.cli.verbs.inspect import inspect
from torchplate.measurement import SI_UNIT, Channel, Measurement, MeasurementError, write_uff

PNG = b"\x89PNG\r\n\x1a\n"


def three_channels(coherence: bool = True) -> Measurement:
    """One mode at 61 Hz, seen by two sensors and two forces; sensor 5 carries the wrong sign."""
    frequency = torch.arange(30.0, 121.0, 0.5, dtype=torch.float64)
    omega = 2 * torch.pi * frequency
    mode = -(omega**2) / ((2 * torch.pi * 61.0) ** 2 * (1 + 0.03j) - omega**2)
    frf = mode[:, None, None] * torch.tensor([[0.9, 0.4], [-0.4, -0.7]], dtype=torch.float64)
    return Measurement(
        frequency=frequency,
        frf=frf,
        measured=torch.ones(2, 2, dtype=torch.bool),
        response=(Channel(2, "w", (0.1, 0.0, 0.0)), Channel(5, "w", (0.3, 0.2, 0.0))),
        reference=(Channel(2, "w", (0.1, 0.0, 0.0)), Channel(5, "w", (0.3, 0.2, 0.0))),
        kind="accelerance",
        unit=SI_UNIT["accelerance"],
        coherence=torch.full_like(frf.real, 0.93) if coherence else None,
    )


@pytest.mark.parametrize("name", ["plate.npz", "plate.uff", "plate.mat", "plate.wav", "plate.csv", "plate.lvm"])
def test_an_empty_file_is_refused_in_one_sentence(tmp_path, command, name):
    (tmp_path / name).touch()
    status, _, stderr = command("inspect", tmp_path / name)
    assert (status, stderr.count("\n")) == (2, 1)
    assert name in stderr


def report(measurement: Measurement, folder, name="plate.uff") -> tuple[str, bytes]:
    path = folder / name
    write_uff(measurement, path) if name.endswith("uff") else measurement.to_npz(path)
    screen = StringIO()
    figure = inspect(path, folder / "seen", Console(file=screen, width=200))
    assert figure == folder / "seen" / "plate.png"
    return screen.getvalue(), figure.read_bytes()


def test_the_report_names_what_is_in_the_file_and_what_looks_wrong(tmp_path):
    text, figure = report(three_channels(), tmp_path)
    for words in (
        "4 of 2 × 2",
        "2w 5w",
        "accelerance, m/(N s²)",
        "30 to 120.5 Hz, step 0.5 Hz, 182 lines",
        "2 of 2 nodes, x 0.1 to 0.3 m, y 0 to 0.2 m, z 0 m",
        "2w/2w (Re mobility < 0 on 0 % of the lines",
        "5w/5w (Re mobility < 0 on 100 % of the lines",
        "2w/5w against 5w/2w: 200 % apart",
        "mean 0.9300",
        "61 Hz",
        "5w/5w: wrong sign?",
        "rms level [m/(N s²)]",
        str(tmp_path / "seen" / "plate.png"),
    ):
        assert words in text
    assert figure.startswith(PNG)


def test_a_plate_that_stands_in_the_file_s_xz_plane_is_reported_on_as_new_reads_it(tmp_path):
    """It said that there are no out-of-plane FRFs, beside the command that reads them."""
    whole, path = three_channels(), tmp_path / "plate.uff"
    points = {2: (0.1, 0.0, 0.0), 5: (0.3, 0.0, 0.2)}
    file = pyuff.UFF(str(path))
    names, columns = ["node_nums", "x", "y", "z"], zip(*([node, *place] for node, place in points.items()), strict=True)
    zeros = np.zeros(2, dtype=int)
    geometry = {name: np.array(column) for name, column in zip(names, columns, strict=True)}
    file.write_sets(pyuff.prepare_15(**geometry, def_cs=zeros, disp_cs=zeros, color=zeros), "add")
    for j, k in whole.pairs:
        response, reference = (2, 5)[j], (2, 5)[k]
        ends = {"rsp_node": response, "rsp_dir": 2, "ref_node": reference, "ref_dir": -2, "func_type": 4}
        kind = {"ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13, "abscissa_spec_data_type": 18}
        data = {"x": whole.frequency.numpy(), "data": whole.frf[:, j, k].numpy(), "abscissa_spacing": 1, "binary": 0}
        texts = {**{f"id{n}": "" for n in range(1, 6)}, "rsp_ent_name": "NONE", "ref_ent_name": "NONE"}
        file.write_sets(pyuff.prepare_58(**ends, **kind, **data, **texts, ver_num=1, load_case_id=0), "add")
    screen = StringIO()
    assert inspect(path, tmp_path / "seen", Console(file=screen, width=200)) is not None
    for words in ("4 of 2 × 2", "accelerance, m/(N s²)", "Next: torchplate new"):
        assert words in screen.getvalue()


@pytest.mark.parametrize("name", ["plate.uff", "plate.npz"])
def test_a_measurement_without_coherence_or_places_is_reported_as_such(name, tmp_path):
    whole = three_channels(coherence=False)
    bare = replace(whole, response=(Channel(2), Channel(5)), reference=(Channel(2), Channel(5)))
    text, figure = report(bare, tmp_path, name)
    assert "none in the file" in text
    assert "matched to the plate by node number" in text
    assert figure.startswith(PNG)


@pytest.mark.check
@pytest.mark.parametrize("n", [1, 7, 70])
def test_one_and_many_channels_are_drawn(n, tmp_path):
    one = three_channels()
    gains = torch.linspace(0.5, 2.0, n, dtype=torch.float64)
    many = replace(
        one,
        frf=one.frf[:, :1, :1] * gains,
        coherence=None,
        measured=torch.ones(1, n, dtype=torch.bool),
        response=(Channel(2),),
        reference=tuple(Channel(i + 1) for i in range(n)),
    )
    text, figure = report(many, tmp_path)
    assert f"{n} of 1 × {n}" in text
    assert figure.startswith(PNG)
    # Wide enough to be read, and not an empty canvas: its width is 11 in at 150 dots.
    assert np.frombuffer(figure[16:20], dtype=">u4")[0] == 1650
    assert len(figure) > 20_000


@pytest.mark.check
def test_a_dead_channel_can_be_drawn(tmp_path):
    whole = three_channels()
    frf = whole.frf.clone()
    frf[:, 1, 0] = 0
    text, _ = report(replace(whole, frf=frf), tmp_path)
    assert "5w/2w: dead" in text


def test_the_command_stands_whole_in_a_line_of_its_own(tmp_path):
    path = tmp_path / "plate of march.uff"
    write_uff(three_channels(), path)
    screen = StringIO()
    inspect(path, tmp_path / "seen", Console(file=screen, width=60))
    lines = [line for line in screen.getvalue().splitlines() if line.startswith("Next:")]
    assert lines == [f"Next: torchplate new '{path}'"]


def test_the_default_folder_is_runs_inspect(tmp_path, monkeypatch):
    write_uff(three_channels(), tmp_path / "strip.uff")
    monkeypatch.chdir(tmp_path)
    figure = inspect(tmp_path / "strip.uff", console=Console(file=StringIO()))
    assert (tmp_path / figure).resolve() == (tmp_path / "runs" / "inspect" / "strip.png").resolve()
    assert figure.is_file()


def test_a_file_that_cannot_be_used_raises_the_users_error(tmp_path):
    path = tmp_path / "broken.uff"
    path.write_text("nothing")
    with pytest.raises(MeasurementError, match=r"broken\.uff"):
        inspect(path, tmp_path, Console(file=StringIO()))


def test_a_file_without_frfs_is_described_with_what_can_be_done(tmp_path):
    path = tmp_path / "geometry.uff"
    write_uff(three_channels(), path)
    geometry = path.read_bytes().split(b"    -1\n    58\n")[0]
    path.write_bytes(geometry)
    screen = StringIO()
    assert inspect(path, tmp_path, Console(file=screen, width=300)) is None
    assert "geometry: 2 nodes" in screen.getvalue()
    assert "torchplate new FRFS.uff --nodes geometry.uff" in screen.getvalue()


def test_frfs_that_cannot_be_used_are_described_all_the_same(tmp_path):
    path = tmp_path / "plate.uff"
    write_uff(three_channels(), path)
    path.write_bytes(path.read_bytes().replace(b"        13    0    0    0 Force", b"         0    0    0    0 Force"))
    screen = StringIO()
    assert inspect(path, tmp_path, Console(file=screen, width=300)) is None
    assert "4 × frequency response function" in screen.getvalue()
    assert "No report on the FRFs" in screen.getvalue()
    assert "measurement.kind" in screen.getvalue()


@pytest.mark.parametrize(
    ("numerator", "unit", "kind"),
    [
        (0, "m/s2", "accelerance"),
        (0, "(1/N)*(m/s²)", "accelerance"),
        (0, "g/N", "accelerance"),
        (0, "m/s", "mobility"),
        (0, "mm/N", "receptance"),
        (11, "NONE", "mobility"),
        (1, "NONE", "accelerance"),
    ],
)
@pytest.mark.parametrize("has_places", [True, False])
def test_the_command_that_is_proposed_runs_as_printed(
    tmp_path, command, monkeypatch, numerator, unit, kind, has_places
):
    monkeypatch.chdir(tmp_path)
    path, nodes = tmp_path / "my plate.uff", tmp_path / "nodes.csv"
    write_uff(three_channels(), path)
    text = path.read_bytes().replace(b"        13    0    0    0 Force", b"         0    0    0    0 Force")
    found = re.search(rb"\n        12    0    0    0 (\S+ +)m/s2 +\n", text)
    assert found
    row = b"\n%10d    0    0    0 %s%-20s\n" % (numerator, found[1], unit.encode("latin-1"))
    text = text.replace(found[0], row)
    if not has_places:
        text = b"    -1\n    58" + text.split(b"    -1\n    58", 1)[1]
        nodes.write_text("2,0.1,0\n5,0.3,0.2\n")
    path.write_bytes(text)
    screen = StringIO()
    assert inspect(path, tmp_path, Console(file=screen, width=500)) is None
    (line,) = (line for line in screen.getvalue().splitlines() if line.startswith("Next: torchplate "))
    assert screen.getvalue().count(f"new 'my plate.uff' --kind {kind}") == (2 if has_places else 1)
    assert f"--kind {kind}" in line
    assert ("--nodes nodes.csv" in line) is not has_places
    status, _, error = command(*shlex.split(line)[2:])
    assert (status, error) == (0, "")
    assert f"kind: {kind}" in (tmp_path / "my plate.yaml").read_text()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("name", ["plate.npz", "plate.uff", "plate.csv", "plate.wav"])
def test_a_pipe_that_nobody_writes_into_is_not_waited_for(tmp_path, command, name):
    def late(*_: object) -> None:
        pytest.fail("it waits")

    os.mkfifo(tmp_path / name)
    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(10)
    try:
        status, _, stderr = command("inspect", tmp_path / name, "--out", tmp_path)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert (status, stderr.count("\n")) == (2, 1)
    assert name in stderr


def test_time_records_of_other_formats_are_described(tmp_path):
    time = np.arange(400) / 1000.0
    force = np.where((time > 0.1) & (time < 0.105), 30.0, 0.0)
    rows = np.column_stack([time, force, np.exp(-5 * time) * np.sin(300 * time)])
    path = tmp_path / "hit_4.csv"
    path.write_text("time,force,acc\n" + "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows))
    screen = StringIO()
    assert inspect(path, tmp_path, Console(file=screen, width=300)) is None
    for words in ("1 recording", "400 samples", "1000 Hz", "force up to 30", "torchplate frf hit_4.csv --response"):
        assert words in screen.getvalue()


def test_a_table_of_modes_is_described(tmp_path):
    path = tmp_path / "modes.csv"
    path.write_text(
        'mode;frequency_hz;damping_ratio;1;7;"0.12,0.08"\n1;68.41;0.0031;1.0;-0.52;0.33\n2;97.13;;0.2;0.9;-0.4\n'
    )
    screen = StringIO()
    assert inspect(path, tmp_path, Console(file=screen, width=300)) is None
    for words in ("2 modes at 3 points: 68.41, 97.13 Hz", "measurement: {modal_model: {file: modes.csv}}"):
        assert words in screen.getvalue()


def test_no_name_and_no_command_is_cut_off_on_a_narrow_terminal(tmp_path):
    path = tmp_path / f"{'a_long_name_' * 8}.csv"
    path.write_text("mode,frequency_hz,damping_ratio,1\n1,68.41,0.0031,1.0\n")
    screen = StringIO()
    inspect(path, tmp_path, Console(file=screen, width=60))
    assert "…" not in screen.getvalue()
    assert path.name in "".join(screen.getvalue().split())
