"""The three chairs: their files are what a user would bring, and their steps are timed until one fails."""

import os
import signal
import subprocess
import sys
import time
from io import StringIO

import pytest
import torch
from rich.console import Console

from torchplate.cli.main import main as torchplate
from torchplate.cli.main import parser
from torchplate.cli.verbs.frf import Conversion, frf
from torchplate.effects import HystereticDamping, Plate
from torchplate.measurement import Layout, read_measurement
from torchplate.model import PlateModel, extrapolate
from torchplate.plate import Mesh
from torchplate.studies import chairs


@pytest.mark.parametrize("words", [step for chair in chairs.CHAIRS.values() for step in chair.steps])
def test_each_step_is_a_command_that_can_be_given(words):
    assert parser(words[0]).parse_args(list(words)).verb == words[0]


def test_every_chair_ends_in_a_fit_and_a_diagnosis():
    for chair in chairs.CHAIRS.values():
        assert [words[0] for words in chair.steps[-2:]] == ["run", "diagnose"]


@pytest.mark.check
def test_the_roving_hammer_s_file_is_in_mm_and_new_takes_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert chairs.roving(tmp_path, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["roving.uff"]
    found = read_measurement(tmp_path / "roving.uff")
    assert len(found.reference) == 15
    # The corner over from the first hit, read as metres.
    assert max(channel.coordinate[0] for channel in found.reference) == pytest.approx(420.0)
    assert torchplate(list(chairs.CHAIRS["roving"].steps[0])) == 0
    assert "0.42 × 0.3 m" in capsys.readouterr().out


@pytest.mark.check
def test_the_wav_files_hold_the_plate_s_own_frfs(tmp_path):
    assert chairs.hits(tmp_path, tmp_path)
    told = Conversion(layout=Layout(responses=(chairs.SENSOR,), scale=chairs.FULL_SCALE, motion="acceleration"))
    node = 3
    path = tmp_path / f"hit_{node}.wav"
    found = frf([path], tmp_path / "hits.npz", told, Console(file=StringIO()))
    known = {f"plate.{name}": value for name, value in chairs.STEEL.items()}
    known["loss.stiffness_loss_factor"] = chairs.LOSS
    given = PlateModel(Mesh(*chairs.SIDES, 24, 18), {"plate": Plate(), "loss": HystereticDamping()}, known, {})
    model = extrapolate(given, 400.0).model
    band = (found.frequency > 40) & (found.frequency < 400)
    line = found.frequency[band]
    places = [
        [(x / chairs.SIDES[0], y / chairs.SIDES[1])] for x, y in (chairs.PLACES[chairs.SENSOR], chairs.PLACES[node])
    ]
    true = model.frf(model.known[:0], line, *places, "accelerance")[:, 0, 0]
    measured = found.frf[band, 0, 0]
    # Noise of the recorder's last bits, and what a record of four seconds leaves of the ringing.
    assert float((measured - true).norm() / true.norm()) < 0.03
    assert torch.isfinite(found.coherence[band]).all()


@pytest.mark.check
def test_a_step_that_fails_ends_its_chair_and_is_told(tmp_path):
    said = StringIO()
    chair = chairs.Chair("nobody", lambda *_: True, (("inspect", "nowhere.uff"), ("run", "plate.yaml")))
    steps = chairs.timed(chair, tmp_path, Console(file=said, width=300))
    assert [step.status for step in steps] == [2]
    assert "nowhere.uff" in said.getvalue()
    assert steps[0].seconds > 0


def test_a_chair_without_its_file_is_left_out_and_an_unknown_one_is_refused(tmp_path, capsys):
    assert chairs.main(["spruce"], tmp_path / "out", tmp_path) == 0
    assert "left out" in capsys.readouterr().out
    assert chairs.main(["stool"], tmp_path / "out", tmp_path) == 2
    assert "spruce, roving, hits" in capsys.readouterr().err


@pytest.mark.check
def test_what_stops_the_stopwatch_stops_the_command_it_times(tmp_path):
    """Run apart: the signal is for the whole process."""
    program = (
        "import sys; from pathlib import Path; from torchplate.studies import chairs\n"
        f"folder = Path({str(tmp_path)!r})\n"
        "words = [sys.executable, '-c', 'import os, time; print(os.getpid(), flush=True); time.sleep(600)']\n"
        "with (folder / 'log').open('w') as log: chairs._run(words, folder, log)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program]) as parent:
        while not (log := tmp_path / "log").exists() or not log.read_text().endswith("\n"):
            assert parent.poll() is None
            time.sleep(0.05)
        parent.terminate()
        assert parent.wait(timeout=60) == 128 + signal.SIGTERM
    with pytest.raises(ProcessLookupError):
        os.kill(int(log.read_text()), 0)
