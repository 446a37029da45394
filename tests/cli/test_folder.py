"""A run's folder: what it refuses, what it never writes over, and what is written whole or not at all."""

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from torchplate.cli.folder import writing
from torchplate.cli.folder.occupied import occupied
from torchplate.measurement import Measurement

ONE = ["plate.youngs_modulus"]
NOBODY = 65534


@pytest.fixture
def open_to_all(bench) -> Iterator[Path]:
    """A copy of the bench that others than its owner can enter."""
    folder = Path(tempfile.mkdtemp(dir="/tmp"))
    shutil.copytree(bench.folder, folder, dirs_exist_ok=True)
    folder.chmod(0o755)
    yield folder
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o755)
    shutil.rmtree(folder)


@contextlib.contextmanager
def without_rights() -> Iterator[None]:
    """Root reads and writes everything; nobody does not."""
    if os.geteuid() != 0:
        yield
        return
    b"x".decode("cp437")  # what zipfile looks up, and nobody may not find where Python lies in root's home
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


def said_in_one_sentence(outcome: tuple[int, str, str], *words: str) -> None:
    status, _, stderr = outcome
    assert status == 2
    assert stderr.count("\n") == 1
    assert "Expected" in stderr
    for word in words:
        assert word in stderr


@pytest.mark.parametrize("verb", ["run", "diagnose"])
class TestAPlaceWithoutRights:
    def test_a_config_in_a_folder_that_cannot_be_entered_is_said(self, open_to_all, make_config, command, verb):
        closed = open_to_all / "closed"
        closed.mkdir()
        (closed / "plate.yaml").write_text(json.dumps(make_config(ONE)))
        closed.chmod(0o000)
        with without_rights():
            said_in_one_sentence(command(verb, closed / "plate.yaml"), "closed/plate.yaml", "rights")

    def test_a_measurement_in_a_folder_that_cannot_be_entered_is_said(self, open_to_all, make_config, command, verb):
        closed = open_to_all / "closed"
        closed.mkdir()
        (open_to_all / "plate.npz").rename(closed / "plate.npz")
        path = open_to_all / "plate.yaml"
        path.write_text(json.dumps(make_config(ONE, {"measurement.file": "closed/plate.npz"})))
        closed.chmod(0o000)
        with without_rights():
            said_in_one_sentence(command(verb, path, "--out", open_to_all / "out"), "closed/plate.npz", "rights")

    def test_an_out_that_cannot_be_written_is_said_before_any_search(
        self, open_to_all, make_config, command, monkeypatch, verb
    ):
        monkeypatch.setattr("torchplate.identification.job.minimize", None)
        monkeypatch.setattr("torchplate.cli.verbs.diagnose.find_missing", None)
        path = open_to_all / "plate.yaml"
        path.write_text(json.dumps(make_config(ONE)))
        (open_to_all / "sealed").mkdir()
        (open_to_all / "sealed").chmod(0o555)
        for out in ("sealed", "sealed/deeper"):
            with without_rights():
                said_in_one_sentence(
                    command(verb, path, "--out", open_to_all / out), f"--out {open_to_all / out}", "rights"
                )

    def test_an_out_without_read_right_is_said(self, open_to_all, make_config, command, verb):
        path = open_to_all / "plate.yaml"
        path.write_text(json.dumps(make_config(ONE)))
        (open_to_all / "out").mkdir()
        (open_to_all / "out").chmod(0o000)
        with without_rights():
            said_in_one_sentence(command(verb, path, "--out", open_to_all / "out"), "out", "rights")


NODES = ["--nodes", "nodes.csv"]
STEEL = ["--length", 0.41, 0.29, "--thickness", 0.0031, "--material", "steel"]


class TestAFileWhereAFolderIsNeeded:
    """A path that goes on behind a file, or an --out that is one."""

    @pytest.mark.parametrize(
        ("verb", "given", "out"),
        [
            ("run", ["plate.yaml"], "notes"),
            ("simulate", ["truth.yaml"], "notes/plate.uff"),
            *(
                pytest.param(*case, marks=pytest.mark.check)
                for case in (
                    ("run", ["plate.yaml"], "notes/out"),
                    ("diagnose", ["plate.yaml"], "notes/out"),
                    ("inspect", ["plate.npz"], "notes"),
                    ("modes", ["plate.npz", *NODES], "notes/modes.csv"),
                    ("new", ["plate.npz", *NODES, *STEEL], "notes/a.yaml"),
                    ("new", ["plate.npz", *NODES, *STEEL, "--force"], "folder.yaml"),
                    ("bench", ["--part", "air"], "notes"),
                )
            ),
        ],
    )
    def test_is_said(self, bench, make_config, command, monkeypatch, verb, given, out):
        monkeypatch.chdir(bench.folder)
        bench.write(make_config(ONE))
        bench.measure()
        evenly = replace(
            Measurement.from_npz(bench.folder / "plate.npz"), frequency=6.5 * torch.arange(1, 62, dtype=torch.float64)
        )
        evenly.to_npz(bench.folder / "plate.npz")
        places = [f"{k + 1},{0.41 * (k % 4) / 3},{0.29 * (k // 4) / 2}" for k in range(12)]
        Path("nodes.csv").write_text("\n".join(["node,x,y", *places]) + "\n")
        Path("notes").write_text("kept")
        Path("folder.yaml").mkdir()
        said_in_one_sentence(command(verb, *given, "--out", out), out.partition("/")[0])
        assert Path("notes").read_text() == "kept"

    @pytest.mark.check
    def test_is_said_of_a_comparison(self, bench, command):
        bench.run(ONE, {"search.n_generation": 1})
        (bench.folder / "notes").write_text("kept")
        said_in_one_sentence(command("compare", bench.folder / "out", "--out", bench.folder / "notes"), "notes")


class TestARerun:
    def test_writes_over_nothing_unasked(self, bench, command):
        bench.run(ONE, {"search.n_generation": 1})
        path, kept = bench.folder / "plate.yaml", bench.folder / "out" / "result.json"
        before = kept.read_text()
        outcome = command("run", path, "--out", bench.folder / "out", "--set", "search.seed=9")
        said_in_one_sentence(outcome, "result.json", "--force", "--resume")
        assert kept.read_text() == before
        assert command("run", path, "--out", bench.folder / "out", "--force", "--set", "search.seed=9")[0] == 0
        assert json.loads(kept.read_text())["seed"] == 9

    @pytest.mark.parametrize("name", ["report.md", "checkpoint.pt"])
    def test_keeps_a_report_and_the_checkpoint_of_a_search_that_has_not_ended(self, bench, make_config, command, name):
        path = bench.write(make_config(ONE))
        (bench.folder / "out").mkdir()
        (bench.folder / "out" / name).write_text("hours of work")
        said_in_one_sentence(command("run", path, "--out", bench.folder / "out"), name, "--force")
        assert (bench.folder / "out" / name).read_text() == "hours of work"

    def test_of_a_diagnosis_writes_over_nothing_unasked(self, bench, make_config, command, monkeypatch):
        monkeypatch.setattr("torchplate.cli.verbs.diagnose.find_missing", None)
        path = bench.write(make_config(ONE))
        (bench.folder / "out").mkdir()
        for name in ("diagnosis.json", "report.md"):
            (bench.folder / "out" / name).write_text("{}")
            said_in_one_sentence(command("diagnose", path, "--out", bench.folder / "out"), name, "--force")
            (bench.folder / "out" / name).unlink()

    def test_by_force_that_is_stopped_leaves_no_old_result_beside_the_new_config(self, bench, command, monkeypatch):
        def stopped(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        bench.run(ONE, {"search.n_generation": 1})
        monkeypatch.setattr("torchplate.identification.job.minimize", stopped)
        assert command("run", bench.folder / "plate.yaml", "--out", bench.folder / "out", "--force")[0] == 130
        assert not (bench.folder / "out" / "result.json").exists()

    def test_in_the_same_second_takes_a_folder_of_its_own(self, bench, make_config, command, monkeypatch):
        monkeypatch.chdir(bench.folder)
        monkeypatch.setattr("torchplate.cli.folder.opening.time.strftime", lambda _: "2026-01-02_03-04-05")
        bench.write(make_config())
        assert [command("run", "plate.yaml")[0] for _ in range(2)] == [0, 0]
        assert len(list((bench.folder / "runs" / "plate").iterdir())) == 2


class TestTwoAtOnce:
    @pytest.mark.parametrize("verb", ["run", "diagnose"])
    def test_the_second_command_in_a_folder_is_refused(self, bench, make_config, command, verb):
        path, out = bench.write(make_config(ONE)), bench.folder / "out"
        with occupied(out):
            before = {name.name for name in out.iterdir()}
            said_in_one_sentence(command(verb, path, "--out", out), f"--out {out}", "in use")
            assert {name.name for name in out.iterdir()} == before

    def test_a_lock_that_a_killed_process_left_keeps_nobody_out(self, bench, make_config, command):
        (bench.folder / "out").mkdir()
        (bench.folder / "out" / ".lock").touch()
        assert command("run", bench.write(make_config()), "--out", bench.folder / "out")[0] == 0

    def test_the_lock_goes_with_the_command(self, bench):
        assert not (bench.run().folder / ".lock").exists()


class TestBeforeTheFirstCheckpoint:
    """A run that was killed when its folder was opened, and no generation finished."""

    @pytest.fixture
    def killed(self, bench, make_config, command, monkeypatch) -> Path:
        def kill(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.chdir(bench.folder)
        with monkeypatch.context() as patch:
            patch.setattr("torchplate.identification.job.minimize", kill)
            assert command("run", bench.write(make_config(ONE)))[0] == 130
        (folder,) = (bench.folder / "runs" / "plate").iterdir()
        return folder

    def test_resume_begins_anew_and_says_so(self, killed, command):
        status, stdout, _ = command("run", "plate.yaml", "--out", killed, "--resume")
        assert status == 0
        assert "begins anew" in stdout
        assert json.loads((killed / "result.json").read_text())["n_generation"] == 5

    def test_resume_without_out_finds_it(self, killed, command):
        status, stdout, _ = command("run", "plate.yaml", "--resume")
        assert status == 0
        assert "begins anew" in stdout
        assert (killed / "result.json").exists()

    def test_a_killed_diagnosis_is_none_of_it(self, killed, command):
        (killed / "versions.json").write_text('{"verb": "diagnose"}')
        said_in_one_sentence(command("run", "plate.yaml", "--resume"), "--resume", "Leave --resume out")


class TestWholeOrNotAtAll:
    def test_an_error_on_the_way_leaves_what_was_there(self, tmp_path):
        path = tmp_path / "result.json"
        writing.write_text(path, "old")
        with contextlib.suppress(ZeroDivisionError), writing.whole(path) as partial:
            partial.write_text("ne")
            _ = 1 / 0
        assert path.read_text() == "old"
        assert list(tmp_path.iterdir()) == [path]

    def test_a_kill_on_the_way_leaves_what_was_there(self, tmp_path):
        path = tmp_path / "result.json"
        writing.write_text(path, "old")
        child = os.fork()
        if child == 0:
            with writing.whole(path) as partial:
                partial.write_text("ne")
                os._exit(9)
        os.waitpid(child, 0)
        assert path.read_text() == "old"
        writing.write_text(path, "new")
        assert path.read_text() == "new"
        assert list(tmp_path.iterdir()) == [path]

    def test_a_full_disk_is_said_with_the_files_name(self, bench, make_config, command, monkeypatch):
        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("torchplate.cli.folder.writing.os.fsync", full)
        outcome = command("run", bench.write(make_config()), "--out", bench.folder / "out")
        said_in_one_sentence(outcome, "config.yaml", "No space left", "Make room")
        assert not (bench.folder / "out" / "config.yaml").exists()

    @pytest.mark.check
    def test_everything_in_a_runs_folder_is_written_that_way(self, bench, monkeypatch):
        monkeypatch.undo()
        written, own = [], writing.whole
        for name in ("folder.writing", "progress.log"):
            monkeypatch.setattr(f"torchplate.cli.{name}.whole", lambda path: written.append(path.name) or own(path))
        folder = bench.run(ONE, {"search.n_generation": 1}).folder
        there = {path.name for path in folder.iterdir() if not path.name.startswith("events.out.tfevents.")}
        assert there == set(written)
