"""What `--out` names is written over with something else only where that is asked for: one rule for all verbs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.io import wavfile

from torchplate.cli.arguments import VERBS
from torchplate.cli.main import parser
from torchplate.cli.verbs import bench as timing
from torchplate.measurement import Measurement

ANALYSER = {"like": "sr785", "n_line": 50, "n_average": 1, "exponential_window": None}
STEEL = ["--length", 0.41, 0.29, "--nodes", "nodes.csv", "--material", "steel"]
# Of each verb a command, and what is added to it so that it makes something else.
COMMANDS = {
    "simulate": (["virtual.yaml", "--out", "made.uff"], ["--set", "modal_test.seed=9"]),
    "frf": (["hit_3.wav", "--response", 7, "--out", "made.uff"], ["--scale", 50, 100]),
    "modes": (["plate.npz", "--nodes", "nodes.csv", "--out", "made.csv"], ["--highest", 250]),
    "new": (["plate.npz", *STEEL, "--thickness", 0.0031, "--out", "made.yaml"], ["--mass", 2.9]),
    "compare": (["--out", "made", "runs/one"], ["runs/two"]),
}


@pytest.fixture
def folder(bench, make_config, monkeypatch) -> Path:
    """What the commands take."""
    monkeypatch.chdir(bench.folder)
    virtual = {"measurement": {}, "modal_test.analyser": ANALYSER, "modal_test.reference": [1, 6]}
    bench.write(make_config(changes=virtual | {"modal_test.refine": 1}), "virtual.yaml")
    evenly = 6.5 * torch.arange(1, 62, dtype=torch.float64)
    replace(Measurement.from_npz(bench.folder / "plate.npz"), frequency=evenly).to_npz(bench.folder / "plate.npz")
    places = [f"{k + 1},{0.41 * (k % 4) / 3},{0.29 * (k // 4) / 2}" for k in range(12)]
    Path("nodes.csv").write_text("\n".join(["node,x,y", *places]) + "\n")
    time = np.arange(2048) / 2048
    force = np.where((time > 0.05) & (time < 0.053), 20 * np.sin(np.pi * (time - 0.05) / 0.003), 0.0)
    rings = np.where(time > 0.05, np.exp(-9 * time) * np.sin(2 * np.pi * 83 * (time - 0.05)), 0.0)
    wavfile.write("hit_3.wav", 2048, np.stack([force, rings], axis=1).astype(np.float32))
    return bench.folder


def made(folder: Path) -> dict[str, bytes]:
    """All that lies under the name that the commands give."""
    found = [path for one in folder.glob("made*") for path in (one, *one.rglob("*"))]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found if path.is_file()}


@pytest.mark.parametrize("verb", COMMANDS)
@pytest.mark.check
def test_a_command_that_is_repeated_may_and_another_one_asks(verb, folder, bench, command, monkeypatch):
    if verb == "compare":
        for kind in ("png", "pdf"):
            monkeypatch.setattr(f"torchplate.report.comparison.{kind}", lambda *_: b"")
        for name, seed in (("one", 1), ("two", 2)):
            bench.run(["plate.youngs_modulus"], {"search.n_generation": 1, "search.seed": seed}, f"runs/{name}")
    words, other = COMMANDS[verb]
    option = "--overwrite" if verb == "frf" else "--force"
    # As README's commands are given a second time.
    assert [command(verb, *words)[::2] for _ in range(2)] == [(0, "")] * 2
    first = made(folder)
    assert first
    status, _, said = command(verb, *words, *other)
    assert (status, said.count("\n")) == (2, 1)
    assert "--out made" in said
    assert "one that exists and holds something else" in said
    assert option in said
    assert made(folder) == first
    for word in {option, "--overwrite"}:
        assert command(verb, *words, *other, word)[0] == 0
        assert made(folder) != first
        assert made(folder).keys() == first.keys()


@pytest.mark.check
def test_a_figure_of_another_file_is_kept_where_its_folder_was_named(folder, bench, make_config, command):
    other = folder / "other"
    other.mkdir()
    found = Measurement.from_npz(folder / "plate.npz")
    replace(found, frf=2 * found.frf).to_npz(other / "plate.npz")
    assert command("inspect", "plate.npz", "--out", "made")[0] == 0
    first = made(folder)
    status, _, said = command("inspect", other / "plate.npz", "--out", "made")
    assert (status, said.count("\n")) == (2, 1)
    assert "--force" in said
    assert made(folder) == first
    assert command("inspect", other / "plate.npz", "--out", "made", "--force")[0] == 0
    assert made(folder) != first
    # In its own folder a name's figure is that of the last look.
    assert [command("inspect", one)[0] for one in ("plate.npz", other / "plate.npz")] == [0, 0]
    assert (folder / "runs" / "inspect" / "plate.png").read_bytes() == made(folder)["made/plate.png"]


def test_a_quarter_of_an_hour_of_timing_is_kept(tmp_path, command, monkeypatch):
    sizes = iter([1.0, 2.0, 3.0, 4.0])
    taken = lambda *_: {"n_member": 4, "before_gib": 0.1, "peak_gib": next(sizes), "result_gib": 0.2}  # noqa: E731
    monkeypatch.setattr(timing, "_in_own_process", taken)
    monkeypatch.chdir(tmp_path)
    words = ["bench", "--part", "memory", "--out", "made"]
    assert command(*words)[0] == 0
    first = made(tmp_path)
    status, _, said = command(*words)
    assert (status, said.count("\n")) == (2, 1)
    assert "made/bench.json" in said
    assert made(tmp_path) == first
    assert command(*words, "--force")[0] == 0
    assert made(tmp_path) != first
    # What it times in its own folder is timed anew.
    assert [command(*words[:3])[0] for _ in range(2)] == [0, 0]
    (tmp_path / "made" / "bench.json").write_text("mine")
    assert "JSON of an earlier bench" in command(*words)[2]


@pytest.mark.parametrize("verb", VERBS)
def test_each_verb_that_writes_can_be_told_to_write_over(verb):
    shown = parser(verb)._subparsers._group_actions[0].choices[verb].format_help()  # type: ignore[union-attr]
    assert ("--out" in shown) == ("--overwrite" in shown)
