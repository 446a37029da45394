"""`torchrun -m torchplate run`: the numbers of one process, one voice, and a way on when a process is lost."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import torch

from torchplate.cli.machine.ranks import Ended, Ranks, join
from torchplate.search import RankLost, ShardedObjective

SEARCHED = ["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"]
# Two independent searches of 10: shares of 8 and 12 for two processes, of 4, 8 and 8 for three.
CHANGES: dict[str, Any] = {"search.n_repeat": 2, "search.n_generation": 6, "search.tolerance": None}
ENDLESS = 10**6


class Launched:
    """`torchplate run` on several processes, as torchrun starts them or (its numbers set by hand) without it."""

    def __init__(self, size: int, folder: Path, *words: object, torchrun: bool = False) -> None:
        command = [sys.executable, "-m", "torchplate", "run", *map(str, words)]
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        if torchrun:
            launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={size}"]
            self.commands, environments = [[*launcher, *command[1:]]], [environment]
        else:
            meet = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": free_port()}
            numbers = [meet | {"RANK": str(rank), "WORLD_SIZE": str(size)} for rank in range(size)]
            self.commands, environments = [command] * size, [environment | number for number in numbers]
        self.processes = [
            subprocess.Popen(words, env=each, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            for words, each in zip(self.commands, environments, strict=True)
        ]

    def end(self) -> tuple[list[int], list[str], list[str]]:
        """Exit status, stdout and stderr of each process that was started here."""
        said = [process.communicate(timeout=240) for process in self.processes]
        return [process.returncode for process in self.processes], [out for out, _ in said], [err for _, err in said]


Launch = Callable[..., Launched]


@pytest.fixture
def launch(bench) -> Iterator[Launch]:
    started: list[Launched] = []

    def call(size: int, *words: object, torchrun: bool = False) -> Launched:
        started.append(Launched(size, bench.folder, *words, torchrun=torchrun))
        return started[-1]

    yield call
    for launched in started:
        for process in launched.processes:
            if process.poll() is None:
                process.terminate()
                process.wait(timeout=40)


def wait_for(path: Path, launched: Launched) -> None:
    deadline = time.monotonic() + 60
    while not path.exists():
        assert time.monotonic() < deadline
        assert launched.processes[0].poll() is None, launched.end()
        time.sleep(0.02)


def assert_same(found: Path, expected: Path) -> None:
    """Both folders hold the same search."""
    one, two = (torch.load(folder / "checkpoint.pt", weights_only=True) for folder in (found, expected))
    assert one.keys() == two.keys()
    for key in one:
        # Shares are cut at the grain, so that the bits are those of one process where the library's kernels go by
        # blocks of candidates; the promise is 1e-12.
        torch.testing.assert_close(one[key], two[key], rtol=1e-12, atol=0.0)
    results = [json.loads((folder / "result.json").read_text()) for folder in (found, expected)]
    for name, entry in results[1]["parameters"].items():
        assert results[0]["parameters"][name]["value"] == pytest.approx(entry["value"], rel=1e-12)
    for key in ("n_evaluation", "n_generation", "status", "seed"):
        assert results[0][key] == results[1][key]
    histories = [(folder / "history.csv").read_text().splitlines() for folder in (found, expected)]
    assert len(histories[0]) == len(histories[1])


@pytest.mark.check
def test_two_processes_go_on_where_one_has_stopped_to_what_one_finds(bench, make_config, launch):
    alone = bench.run(SEARCHED, CHANGES, "alone")
    bench.run(SEARCHED, CHANGES | {"search.n_generation": 2}, "shared")
    path = bench.write(make_config(SEARCHED, CHANGES))
    status, out, err = launch(2, path, "--out", "shared", "--resume", torchrun=True).end()
    assert status == [0], err
    assert_same(bench.folder / "shared", alone.folder)
    # One of them speaks, and nothing is amiss.
    assert out[0].count("2 processes share each generation") == 1
    assert out[0].count("Results:") == 1
    assert "Traceback" not in err[0]
    assert "Warning" not in err[0]
    assert json.loads((bench.folder / "shared" / "versions.json").read_text())["n_process"] == 2


def free_port() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return str(free.getsockname()[1])


@pytest.fixture
def alone(monkeypatch) -> Iterator[None]:
    """A process that torchrun would have started as the only one."""
    meet = {"RANK": "0", "WORLD_SIZE": "1", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": free_port()}
    for name, value in meet.items():
        monkeypatch.setenv(name, value)
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def threads_of_groups() -> list[str]:
    names = [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]
    return [name for name in names if "gloo" in name]


def failing(ranks: Ranks, error: type[BaseException]) -> None:
    """A search that ends with an error, whose frames hold the group in several ways."""
    group, objective = ranks.group, ShardedObjective(lambda position: position.sum(-1), ranks.group)
    objective(torch.rand(5, 2, dtype=torch.float64))
    try:
        raise RuntimeError(f"of {group}")
    except RuntimeError as reason:
        raise error("Expected all ranks to answer.") from reason


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="counts the threads in /proc")
@pytest.mark.parametrize(
    ("error", "ends"), [(RankLost, Ended), (KeyboardInterrupt, KeyboardInterrupt), (ValueError, ValueError)]
)
@pytest.mark.usefixtures("alone")
def test_no_thread_of_the_processes_lives_on_to_abort_the_interpreter_as_it_ends(error, ends):
    with pytest.raises(ends, match="Expected all ranks to answer") as caught, join() as ranks:  # noqa: PT012
        assert ranks is not None
        assert threads_of_groups()
        failing(ranks, error)
    assert threads_of_groups() == []
    assert caught.value.__traceback__ is not None


def ranks_of(torchrun: int) -> Mapping[int, int]:
    """Rank → process id of what a torchrun has started."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = (entry / "stat").read_text().rpartition(")")[2].split()[1]
            if int(parent) == torchrun:
                words = (entry / "environ").read_bytes().split(b"\0")
                found |= {int(word[5:]): int(entry.name) for word in words if word.startswith(b"RANK=")}
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


@pytest.mark.check
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds the processes of torchrun in /proc")
def test_a_lost_process_ends_the_run_with_one_sentence_and_one_goes_on_alone(bench, make_config, launch):
    path = bench.write(make_config(SEARCHED, CHANGES | {"search.n_generation": ENDLESS}))
    checkpoint = bench.folder / "lost" / "checkpoint.pt"
    launched = launch(2, path.name, "--out", "lost", torchrun=True)
    wait_for(checkpoint, launched)
    os.kill(ranks_of(launched.processes[0].pid)[1], signal.SIGKILL)
    status, _, err = launched.end()
    assert status != [0]
    lines = [line for line in err[0].splitlines() if "lost" in line]
    assert len(lines) == 1, err[0]
    generation = int(torch.load(checkpoint, weights_only=True)["generation"])
    assert f"This was in generation {generation + 1};" in lines[0]
    assert f"the checkpoint of generation {generation} is {Path('lost') / 'checkpoint.pt'}" in lines[0]
    assert lines[0].endswith("torchplate run plate.yaml --out lost --resume")
    # The launcher's own traceback ends in ChildFailedError; ours says nothing more than the sentence.
    assert "RankLost" not in err[0]
    whole = bench.run(SEARCHED, CHANGES | {"search.n_generation": generation + 3}, "whole")
    one = bench.run(SEARCHED, CHANGES | {"search.n_generation": generation + 3}, "lost", resume=True)
    assert_same(one.folder, whole.folder)


@pytest.mark.check
def test_another_speaks_for_a_first_process_that_is_lost(bench, make_config, launch):
    path = bench.write(make_config(SEARCHED, CHANGES | {"search.n_generation": ENDLESS}))
    launched = launch(2, path.name, "--out", "lost", "--set", "search.seed=5")
    wait_for(bench.folder / "lost" / "checkpoint.pt", launched)
    launched.processes[0].kill()
    status, _, err = launched.end()
    assert status == [-signal.SIGKILL, 1]
    assert "lost or silent" in err[1]
    assert "torchplate run plate.yaml --out lost --set search.seed=5 --resume" in err[1]
    assert "Traceback" not in err[1]


@pytest.mark.check
def test_sigterm_ends_the_run_with_its_checkpoint(bench, make_config, launch):
    path = bench.write(make_config(SEARCHED, CHANGES | {"search.n_generation": ENDLESS}))
    launched = launch(1, path.name, "--out", "ended")
    wait_for(bench.folder / "ended" / "checkpoint.pt", launched)
    launched.processes[0].terminate()
    status, _, err = launched.end()
    assert status == [1]
    assert err[0].startswith("SIGTERM came")
    assert err[0].rstrip().endswith("--resume")


@pytest.mark.check
def test_what_is_wrong_with_the_input_is_said_once_and_all_leave_with_2(bench, make_config, launch):
    path = bench.write(make_config(SEARCHED, {"mesh.n_x": 0}))
    status, out, err = launch(2, path, "--out", "out").end()
    assert status == [2, 2]
    assert err[1] == ""
    assert err[0].splitlines() == [f"{path}: mesh.n_x: Expected greater than 0, got 0. Correct it."]
    assert out == ["", ""]


@pytest.mark.check
def test_a_run_without_a_search_lets_the_others_go(bench, make_config, launch):
    path = bench.write(make_config())
    status, out, _ = launch(2, path, "--out", "out").end()
    assert status == [0, 0]
    assert "Results:" in out[0]
    assert out[1] == ""
