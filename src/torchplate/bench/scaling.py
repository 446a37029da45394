"""`python -m torchplate.bench.scaling`: how much faster two processes evaluate a population than one.

The paper's plate, on all its dofs and in a reduced basis. Each measurement is a torchrun of its own with one thread to
each process; one and two processes take turns, so that a slow spell of the machine hits both, and the median counts.
Timed is what a search does in a generation: a call of the sharded objective, positions in and the whole fitness out.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from rich.console import Console
from rich.table import Table
from torch import Tensor

from torchplate.bench.problem import paper_model
from torchplate.model import PlateModel, reduce
from torchplate.notation import percent
from torchplate.search import DifferentialEvolution, ShardedObjective, minimize

N_PROCESS = (1, 2)
N_MEMBER = 64
LINES = torch.arange(1, 81, dtype=torch.float64) * 5.0
# Timed calls in each torchrun, after one that warms up; and generations without an evaluation, to time the rest.
N_CALL, N_GENERATION = {"all dofs": 2, "reduced basis": 20}, 100
# A worker writes its times where this says.
WORKER = "TORCHPLATE_SCALING"


def scaling(out: Path | None = None, n_repeat: int = 5, console: Console | None = None) -> dict[str, Any]:
    """Time, print and write `scaling.json`.

    Args:
        out: the folder for scaling.json; `runs/bench` if left out.
        n_repeat: torchruns for each number of processes, of which the median counts.
        console: where the table goes.
    """
    console = console or Console()
    times: dict[int, list[dict[str, Any]]] = {n_process: [] for n_process in N_PROCESS}
    load = [os.getloadavg()[0]]
    for _ in range(n_repeat):
        for n_process in N_PROCESS:
            times[n_process].append(_torchrun(n_process))
        load.append(os.getloadavg()[0])
    rows = []
    for problem in N_CALL:
        alone = [found[problem]["seconds"] for found in times[1]]
        for n_process in N_PROCESS:
            found = [measured[problem] for measured in times[n_process]]
            row = {key: statistics.median(one[key] for one in found) for key in found[0] if key != "fitness"}
            ratios = sorted(one / each["seconds"] for one, each in zip(alone, found, strict=True))
            rows.append(
                {"problem": problem, "n_process": n_process, **row}
                | {"members_per_second": N_MEMBER / row["seconds"], "ratio": statistics.median(alone) / row["seconds"]}
                | {"ratio_from": ratios[0], "ratio_to": ratios[-1]}
                | {"difference": max(_difference(times[1][0][problem], one) for one in found)}
            )
    result = {
        "schema": "torchplate.scaling/1",
        "problem": f"{N_MEMBER} members, {len(LINES)} lines, {paper_model().assembly.size} dofs",
        "n_repeat": n_repeat,
        "load": load,
        "versions": {name: version(name) for name in ("torch", "numpy")},
        "rows": rows,
    }
    _print(console, result)
    out = out or Path("runs/bench")
    out.mkdir(parents=True, exist_ok=True)
    (out / "scaling.json").write_text(json.dumps(result, indent=1) + "\n")
    console.print(f"Written: {out / 'scaling.json'}", soft_wrap=True)
    return result


def _print(console: Console, result: dict[str, Any]) -> None:
    console.print(
        f"{result['problem']}; one thread for each process, median of {result['n_repeat']} in turns, load before and "
        f"after {result['load'][0]:.1f} and {result['load'][-1]:.1f}"
    )
    heads = ("", "P", "members/s", "ratio", "waiting", "exchange", "search", "differs by")
    table = Table(*heads, box=None, padding=(0, 2, 0, 0))
    for row in result["rows"]:
        table.add_row(
            row["problem"],
            str(row["n_process"]),
            f"{row['members_per_second']:.0f}",
            f"{row['ratio']:.2f}",
            percent(row["waiting"], 2),
            f"{1e3 * row['exchange_seconds']:.2f} ms {percent(row['exchange'], 2)}",
            f"{1e3 * row['search_seconds']:.2f} ms",
            f"{row['difference']:.0e}",
        )
    console.print(table)
    for row in result["rows"]:
        if row["n_process"] > 1:
            console.print(f"{row['problem']}: the ratio was {row['ratio_from']:.2f} to {row['ratio_to']:.2f}")


def _difference(one: dict[str, Any], other: dict[str, Any]) -> float:
    """Greatest relative difference of a fitness."""
    return max(abs(a - b) / abs(a) for a, b in zip(one["fitness"], other["fitness"], strict=True))


def _torchrun(n_process: int) -> dict[str, Any]:
    """One measurement with so many processes."""
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "times.json"
        launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={n_process}"]
        subprocess.run(
            [*launch, "-m", "torchplate.bench.scaling"],
            env=os.environ | {WORKER: str(found), "OMP_NUM_THREADS": "1"},
            check=True,
            timeout=600,
        )
        content: dict[str, Any] = json.loads(found.read_text())
        return content


def work(path: Path) -> None:
    """What each process of a measurement does; the first writes the times."""
    dist.init_process_group("gloo", timeout=timedelta(minutes=2))
    model = paper_model()
    small = reduce(model, LINES)
    assert small is not None, "the paper's problem has a reduced basis"
    position = torch.rand(N_MEMBER, len(model.names), dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    search_seconds = _generation_seconds(len(model.names))
    times = {}
    for problem, plate in (("all dofs", model), ("reduced basis", small[0])):
        times[problem] = _timed(_objective(plate), position, N_CALL[problem]) | {"search_seconds": search_seconds}
    if dist.get_rank() == 0:
        path.write_text(json.dumps(times))
    dist.destroy_process_group()


def _objective(model: PlateModel) -> Callable[[Tensor], Tensor]:
    truth = model.frf(model.space.to_si(torch.full((1, len(model.names)), 0.41, dtype=torch.float64)), LINES)

    def objective(position: Tensor) -> Tensor:
        difference = model.frf(model.space.to_si(position), LINES) - truth
        return difference.abs().square().sum((-3, -2, -1)).sqrt()

    return objective


@torch.no_grad()
def _timed(objective: Callable[[Tensor], Tensor], position: Tensor, n_call: int) -> dict[str, Any]:
    """Seconds of a call, and the parts of it: fitness exchanged, slower ranks waited for."""
    own: list[float] = []

    def clocked(share: Tensor) -> Tensor:
        began = time.perf_counter()
        fitness = objective(share)
        own.append(time.perf_counter() - began)
        return fitness

    sharded = ShardedObjective(clocked)
    whole = []
    for _ in range(n_call + 1):
        dist.barrier()
        began = time.perf_counter()
        fitness = sharded(position)
        whole.append(time.perf_counter() - began)
    everyone: list[Any] = [None] * dist.get_world_size()
    dist.all_gather_object(everyone, own)
    parts = []
    for seconds, *shares in list(zip(whole, *everyone, strict=True))[1:]:
        exchange = seconds - max(shares)
        parts.append((seconds, (max(shares) - statistics.mean(shares)) / seconds, exchange, exchange / seconds))
    names = ("seconds", "waiting", "exchange_seconds", "exchange")
    medians = {name: statistics.median(part) for name, part in zip(names, zip(*parts, strict=True), strict=True)}
    return medians | {"fitness": fitness.tolist()}


def _generation_seconds(n_dimension: int) -> float:
    """What every process repeats in each generation: ask, tell and the loop, with an objective that costs nothing."""
    began = time.perf_counter()
    minimize(
        lambda position: position[..., 0],
        DifferentialEvolution(n_member=N_MEMBER),
        n_dimension=n_dimension,
        n_generation=N_GENERATION,
        tolerance=None,
        generator=torch.Generator().manual_seed(0),
    )
    return (time.perf_counter() - began) / N_GENERATION


if __name__ == "__main__":
    if WORKER in os.environ:
        work(Path(os.environ[WORKER]))
    else:
        scaling()
