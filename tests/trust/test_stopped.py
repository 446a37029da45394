"""Signals, a full disk, a closed pipe, spent memory: one sentence each, and what was computed is there."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import torch

from torchplate.cli.folder import writing
from torchplate.cli.main import main

ONE = ["plate.youngs_modulus"]
CHANGES = {"search.n_generation": 5, "search.tolerance": None}


def said(outcome: tuple[int, str, str], status: int, *words: str) -> None:
    assert outcome[0] == status, outcome
    assert outcome[2].count("\n") == 1
    for word in words:
        assert word in outcome[2]


@pytest.fixture
def during(monkeypatch):
    """Does something in the middle of a search, when the checkpoint of generation 2 has been written."""

    def arrange(deed) -> None:
        own = writing.write_bytes

        def write_bytes(path, content) -> None:
            own(path, content)
            if path.name == "checkpoint.pt" and int(torch.load(path, weights_only=True)["generation"]) == 2:
                deed()

        monkeypatch.setattr("torchplate.cli.progress.log.write_bytes", write_bytes)

    return arrange


@pytest.fixture
def interruptible():
    """A shell that starts the tests in the background has them ignore an interrupt."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_in_a_sentence_and_the_run_goes_on_to_the_same_result(
    bench, make_config, command, during, monkeypatch, number, status
):
    whole = bench.run(ONE, CHANGES, out="whole").result
    path, out = bench.write(make_config(ONE, CHANGES)), bench.folder / "out"
    before = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context():
        during(lambda: os.kill(os.getpid(), number))
        said(command("run", path, "--out", out), status, "--resume")
    assert signal.getsignal(signal.SIGTERM) == before
    monkeypatch.setattr("torchplate.cli.progress.log.write_bytes", writing.write_bytes)
    assert command("run", path, "--out", out, "--resume")[0] == 0
    assert json.loads((out / "result.json").read_text()) == whole


def full() -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.check
def test_a_disk_that_fills_up_without_a_name_is_said_and_the_run_goes_on_to_the_same_result(
    bench, make_config, command, during, monkeypatch
):
    whole = bench.run(ONE, CHANGES, out="whole").result
    path, out = bench.write(make_config(ONE, CHANGES)), bench.folder / "out"
    during(full)
    said(command("run", path, "--out", out), 2, "No space left", "Make room", "--resume")
    monkeypatch.setattr("torchplate.cli.progress.log.write_bytes", writing.write_bytes)
    assert command("run", path, "--out", out, "--resume")[0] == 0
    assert json.loads((out / "result.json").read_text()) == whole


@pytest.mark.parametrize("room", [1, 20, 60])
def test_a_small_disk_is_said_and_what_is_on_it_is_whole(bench, make_config, command, tmp_path, room):
    small = tmp_path / "small"
    small.mkdir()
    if os.geteuid() or os.system(f"mount -t tmpfs -o size={room}k tmpfs {small} 2>/dev/null"):
        pytest.skip("only root may mount a small disk")
    try:
        outcome = command("run", bench.write(make_config(ONE, {"search.n_generation": 400})), "--out", small / "out")
        said(outcome, 2, "No space left on device")
        assert not list(small.rglob("*.partial"))
        if (small / "out" / "checkpoint.pt").exists():
            torch.load(small / "out" / "checkpoint.pt", weights_only=True)
    finally:
        os.system(f"umount {small}")


def test_a_thread_that_finds_the_disk_full_prints_no_traceback(capsys, monkeypatch):
    def effects(_: object) -> None:
        for deed in (full, lambda: 1 / 0):
            thread = threading.Thread(target=deed)
            thread.start()
            thread.join()

    monkeypatch.setattr("torchplate.cli.verbs.effects.effects", effects)
    shown: list[type[BaseException]] = []
    monkeypatch.setattr(threading, "excepthook", lambda told: shown.append(told.exc_type))
    assert main(["effects"]) == 0
    assert shown == [ZeroDivisionError]


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (BrokenPipeError(errno.EPIPE, "Broken pipe"), 128 + signal.SIGPIPE, []),
        (OSError(errno.ENOSPC, "No space left on device"), 2, ["What is printed", "Make room"]),
        (MemoryError(), 2, ["memory", "Lower mesh.n_x"]),
        (
            RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: 8"),
            2,
            ["memory", "search.n_member"],
        ),
    ],
)
def test_what_the_machine_refuses_is_said(monkeypatch, capfd, error, status, words):
    def effects(_: object) -> None:
        raise error

    monkeypatch.setattr("torchplate.cli.verbs.effects.effects", effects)
    with monkeypatch.context() as patch:
        patch.setattr("torchplate.cli.main.os.dup2", lambda *_: None)
        assert main(["effects"]) == status
    stderr = capfd.readouterr().err
    assert stderr.count("\n") == (1 if words else 0)
    assert all(word in stderr for word in words)


def ended(*words: str, into: int) -> tuple[int, str]:
    """Exit status and what was said of a command that prints into a file's descriptor, as users have it: buffered."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    command = [sys.executable, "-m", "torchplate", *words]
    done = subprocess.run(command, stdout=into, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    return done.returncode, done.stderr


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["effects", "point_mass"]], ids=" ".join)
@pytest.mark.check
def test_a_reader_that_has_gone_ends_a_command_without_a_word(words):
    """As `| head -1` is gone; rich prints the last, the parser the others."""
    read, write = os.pipe()
    os.close(read)
    try:
        assert ended(*words, into=write) == (128 + signal.SIGPIPE, "")
    finally:
        os.close(write)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a disk that is always full is Linux's")
@pytest.mark.parametrize("words", [["--version"], ["effects", "point_mass"]], ids=" ".join)
@pytest.mark.check
def test_an_output_that_has_no_room_is_said_in_one_sentence(words):
    with Path("/dev/full").open("w") as full_disk:
        status, said = ended(*words, into=full_disk.fileno())
    assert (status, said.count("\n")) == (2, 1)
    assert "What is printed" in said


def test_another_runtime_error_is_a_defect(monkeypatch):
    def effects(_: object) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr("torchplate.cli.verbs.effects.effects", effects)
    with pytest.raises(RuntimeError, match="a defect"):
        main(["effects"])
