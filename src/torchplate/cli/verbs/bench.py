"""`torchplate bench`: every figure of speed in one run; a table, `bench.json` and the figure of the slopes.

Only ratios mean something, since machines are noisy. Each part runs in a process of its own with the threads it names;
what SciPy takes is the better of one thread and all.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import matplotlib
import torch
from matplotlib.figure import Figure
from rich.console import Console

from torchplate.bench import air, generation, gradient, identification, memory, slopes
from torchplate.cli.config import InputError
from torchplate.cli.folder.writing import whole, would_be_lost, write_text
from torchplate.cli.progress.console import speaking
from torchplate.cli.results.table import plain_table
from torchplate.notation import percent

PARTS: dict[str, Callable[[], Any]] = {
    "generation": generation,
    "identification": identification,
    "gradient": gradient,
    "slopes": slopes,
    "memory": memory,
    "air": air,
}


def bench(
    out: Path | None = None, parts: Sequence[str] = (), console: Console | None = None, *, force: bool = False
) -> dict[str, Any]:
    """Time, print and write `bench.json` and `slopes.png`.

    Args:
        out: the folder; `runs/bench` if left out.
        parts: of PARTS, which take the place of what `bench.json` there holds of them; all if left out.
        console: where the tables go.
        force: time parts anew that `bench.json` in `out` holds; in `runs/bench` they always are.

    Raises:
        InputError: if it holds one of them.
    """
    console, named, out = console or speaking(), out is not None, out or Path("runs/bench")
    out.mkdir(parents=True, exist_ok=True)
    n_core = os.cpu_count() or 1
    path = out / "bench.json"
    earlier = _earlier(path)
    if named and not force and not earlier.keys().isdisjoint(parts or PARTS):
        raise would_be_lost(path)
    result = earlier if parts else {}
    result |= {
        "schema": "torchplate.bench/2",
        "versions": {name: version(name) for name in ("torch", "scipy", "numpy")},
        "n_core": n_core,
    }
    for part in parts or PARTS:
        for n_thread in sorted({1, n_core}) if part in ("generation", "identification") else [1]:
            console.print(f"[bold]{part}[/], {n_thread} thread{'s' * (n_thread > 1)}")
            found = _in_own_process(part, n_thread)
            result.setdefault(part, {})[str(n_thread)] = found
            SHOWN[part](found, console)
            # A part that fails takes nothing with it.
            write_text(path, json.dumps(result, indent=1) + "\n")
    _say_best(result, console)
    if "slopes" in result:
        with whole(out / "slopes.png") as partial:
            slopes_figure(result["slopes"]["1"]).savefig(partial, format="png", dpi=110)
    console.print(f"Written: {path}", soft_wrap=True)
    return result


def _earlier(path: Path) -> dict[str, Any]:
    """What an earlier bench has written; nothing where none has.

    Raises:
        InputError: if it is another file.
    """
    try:
        found = json.loads(path.read_text()) if path.exists() else {}
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise InputError(f"--out {path}: Expected the JSON of an earlier bench, got another file. Name another folder.")
    return found


def slopes_figure(found: Mapping[str, Any]) -> Figure:
    """Seconds of one evaluation against mesh, members, lines and FRFs, four panels."""
    figure = Figure(figsize=(11, 3), layout="constrained")
    for axes, (axis, key) in zip(
        figure.subplots(1, 4, sharey=True),
        (("mesh", "dofs"), ("members", "members"), ("lines", "lines"), ("FRFs", "FRFs")),
        strict=True,
    ):
        for name, marker in (("SciPy", "s"), ("reduced basis", "^"), ("shared modes", "o")):
            rows = [row for row in found[axis] if name in row]
            axes.loglog([row[key] for row in rows], [row[name] for row in rows], marker=marker, label=name)
        axes.set_xlabel({"mesh": "dofs of the mesh"}.get(axis, axis))
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("seconds for one evaluation")
    figure.axes[0].legend(frameon=False)
    return figure


def _in_own_process(part: str, n_thread: int) -> Any:
    environment = os.environ | dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), str(n_thread)
    )
    command = [sys.executable, "-m", "torchplate.cli.verbs.bench", part]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"Expected the bench's part '{part}' to end, got:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def _say_best(result: Mapping[str, Any], console: Console) -> None:
    """The ratios that compare with the faster of the peers."""
    for part, ours in (("generation", "torchplate, shared modes"), ("identification", "torchplate, DE")):
        runs = result.get(part, {})
        peers = [row["seconds"] for run in runs.values() for row in run["rows"] if row["name"].startswith("SciPy")]
        for n_thread, run in runs.items():
            for row in run["rows"]:
                if row["name"] in (ours, f"{ours}, single precision"):
                    ratio = min(peers) / row["seconds"]
                    console.print(
                        f"{part}: {row['name']}, {n_thread} thread(s), against SciPy at its best: {ratio:.0f} x",
                        soft_wrap=True,
                    )


def _show_generation(found: Mapping[str, Any], console: Console) -> None:
    console.print(f"  {found['problem']}")
    table = plain_table("", "seconds", "times as fast", "error against direct solves")
    for row in found["rows"]:
        table.add_row(row["name"], f"{row['seconds']:.4f}", f"{row['ratio']:.1f}", f"{row['error']:.0e}")
    for name, taken in found["modes_alone_s"].items():
        table.add_row(f"modes alone: {name}", f"{taken:.4f}", "", "")
    for name, taken in found["where_the_time_goes_s"].items():
        table.add_row(name, f"{taken:.4f}", "", "")
    console.print(table)
    for name, rate in found["machine"].items():
        console.print(f"  this machine: {name} {rate:.0f}")


def _show_identification(found: Mapping[str, Any], console: Console) -> None:
    table = plain_table("", "seconds", "times as fast", "evaluations", "over the best")
    for row in found["rows"]:
        numbers = (
            f"{row['seconds']:.2f}",
            f"{row['ratio']:.0f}",
            str(row["n_evaluation"]),
            percent(row["over_best"]),
        )
        table.add_row(row["name"], *numbers)
    console.print(table)


def _show_gradient(found: Sequence[Mapping[str, Any]], console: Console) -> None:
    table = plain_table("", "members", "FRFs", "evaluation [s]", "backward, in evaluations")
    for row in found:
        numbers = f"{row['forward_s']:.4f}", f"{row['backward_over_forward']:.2f}"
        table.add_row(row["way"], str(row["n_member"]), row["frfs"], *numbers)
    console.print(table)


def _show_slopes(found: Mapping[str, Any], console: Console) -> None:
    for axis in ("mesh", "members", "lines", "FRFs"):
        for row in found[axis]:
            console.print("  " + ", ".join(f"{name} {value:.3g}" for name, value in row.items()), soft_wrap=True)


def _show_memory(found: Mapping[str, Any], console: Console) -> None:
    console.print(
        f"  {found['n_member']} members: at most {found['peak_gib']:.2f} GiB in the whole process, "
        f"{found['before_gib']:.2f} GiB before, {found['result_gib']:.2f} GiB the FRFs themselves"
    )


def _show_air(found: Mapping[str, Any], console: Console) -> None:
    for sides, seconds in found["prepared_s"].items():
        console.print(f"  sides {sides}: prepared in {seconds:.3f} s of CPU")
    for way, ratio in found["search"].items():
        console.print(f"  {way}: one generation with air takes {percent(ratio - 1, 1, signed=True)} of CPU more")


SHOWN: dict[str, Callable[[Any, Console], None]] = {
    "generation": _show_generation,
    "identification": _show_identification,
    "gradient": _show_gradient,
    "slopes": _show_slopes,
    "memory": _show_memory,
    "air": _show_air,
}


if __name__ == "__main__":
    matplotlib.use("Agg")
    torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))
    print(json.dumps(PARTS[sys.argv[1]]()))
