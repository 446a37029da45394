"""`make chairs`: from a file to an answer with a stopwatch, as three users come to it who have not read a line of code.

- `spruce`: a measured file of a wooden plate, taken by `torchplate new` alone.
- `roving`: a roving-hammer test at 3 × 5 points, its coordinates in mm; made here, with a magnet nobody wrote down.
- `hits`: raw hits as WAV files and a table of nodes; made here.

Each is new or frf, run, diagnose, in processes of their own and in an empty folder; the seconds of each step, the load
of the machine before it, and the answer are printed. Everything goes to `runs/chairs`.
"""

import argparse
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from scipy.io import wavfile

from torchplate.cli.verbs.simulate import simulate
from torchplate.effects import HystereticDamping, Plate
from torchplate.measurement import Channel, read_measurement, write_uff
from torchplate.model import PlateModel, extrapolate
from torchplate.notation import percent
from torchplate.plate import Mesh

OUT = Path("runs/chairs")
DATA = Path("../shared/data")
# A record of 4 s, in which the lowest mode, at 78 Hz with a loss of 0.008, falls by 68 dB: no window is needed.
ROVED: Final[dict[str, Any]] = {
    "mesh": {"length_x": 0.42, "length_y": 0.3, "n_x": 4, "n_y": 2},
    "effects": {
        "plate": {
            "effect": "plate", "youngs_modulus": 70.5e9, "poisson_ratio": 0.33, "density": 2700.0, "thickness": 0.003,
        },
        "loss": {"effect": "hysteretic_damping", "stiffness_loss_factor": 0.008},
        "magnet": {"effect": "point_mass", "x": 0.31, "y": 0.62, "mass": 0.02},
    },
    "modal_test": {
        "analyser": {
            "like": "sr785", "span": 400.0, "n_line": 1600, "force_window": None, "exponential_window": None,
            "n_pre_trigger": 32, "n_average": 2,
        },
        "response": [1],
        # 32 × 16 elements: a coarser mesh gives too little under the magnet, and a diagnosis names what it lacks.
        "refine": 8,
        "seed": 3,
    },
}  # fmt: skip
# The plate of the WAV files: steel, hit five times at each of six places, one accelerometer.
STEEL = {"youngs_modulus": 206e9, "poisson_ratio": 0.3, "density": 7850.0, "thickness": 0.002}
SIDES, LOSS = (0.4, 0.3), 0.01
PLACES = {1: (0.0, 0.0), 2: (0.4, 0.0), 3: (0.24, 0.06), 4: (0.1, 0.15), 5: (0.3, 0.21), 6: (0.4, 0.3), 7: (0.0, 0.3)}
SENSOR, N_HIT = 1, 5
RATE, SECONDS = 4096, 4.0
"""Of a hit's record [1/s], [s]: in it the lowest mode, at 65 Hz with a loss of a hundredth, falls by 70 dB."""
PULSE = 1.2e-3
"""Duration of a hit [s], a half sine: its spectrum is level to 400 Hz within 3 dB."""
FULL_SCALE = (50.0, 4000.0)
"""Force and acceleration that the recorder's full scale stands for [N], [m/s²]."""


@dataclass(frozen=True)
class Chair:
    """One user.

    Attributes:
        title: who comes with what.
        prepare: makes the file in an empty folder; False where it cannot.
        steps: words of the commands, which are run in that folder.
    """

    title: str
    prepare: Callable[[Path, Path], bool]
    steps: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Step:
    """One command that was run.

    Attributes:
        words: it.
        seconds: on the wall.
        load: of the machine before it, over one minute.
        status: what it ended with.
    """

    words: tuple[str, ...]
    seconds: float
    load: float
    status: int


def spruce(folder: Path, data: Path) -> bool:
    """The measured file, where it is."""
    file = data / "spruce_5L.uff"
    if file.is_file():
        shutil.copy(file, folder)
    return file.is_file()


def roving(folder: Path, data: Path) -> bool:  # noqa: ARG001
    """A virtual test, its coordinates in mm, as most modal software has them."""
    truth = folder / "truth.yaml"
    truth.write_text(json.dumps(ROVED))
    simulate(truth, folder / "roving.uff", console=Console(quiet=True))
    found = read_measurement(folder / "roving.uff")

    def in_mm(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        places = [channel.coordinate or (0.0, 0.0, 0.0) for channel in channels]
        return tuple(
            replace(channel, coordinate=(1e3 * x, 1e3 * y, 1e3 * z))
            for channel, (x, y, z) in zip(channels, places, strict=True)
        )

    write_uff(replace(found, response=in_mm(found.response), reference=in_mm(found.reference)), folder / "roving.uff")
    truth.unlink()
    return True


def hits(folder: Path, data: Path) -> bool:  # noqa: ARG001
    """A WAV file for each place that is hit: force and acceleration in 16 bits, several hits one after the other."""
    known = {f"plate.{name}": value for name, value in STEEL.items()} | {"loss.stiffness_loss_factor": LOSS}
    given = PlateModel(Mesh(*SIDES, 16, 12), {"plate": Plate(), "loss": HystereticDamping()}, known, {})
    # A plate has no mesh: a diagnosis would have to name what these elements leave.
    model = extrapolate(given, RATE / 2).model
    places = [(x / SIDES[0], y / SIDES[1]) for x, y in PLACES.values()]
    n_sample = int(RATE * SECONDS)
    line = torch.fft.rfftfreq(n_sample, 1 / RATE, dtype=torch.float64)
    # A free plate's accelerance is that of its mass as the frequency goes to zero, where the model has none.
    sensor = [places[list(PLACES).index(SENSOR)]]
    with torch.no_grad():
        frf = model.frf(model.known[:0], line.clamp(min=1.0), sensor, places, "accelerance")[:, 0].numpy()
    random = np.random.default_rng(5)
    for column, node in enumerate(PLACES):
        records = [_hit(frf[:, column], n_sample, random) for _ in range(N_HIT)]
        wavfile.write(folder / f"hit_{node}.wav", RATE, np.concatenate(records))
    rows = "\n".join(f"{node},{x},{y}" for node, (x, y) in PLACES.items())
    (folder / "nodes.csv").write_text(f"node,x,y\n{rows}\n")
    return True


def _hit(frf: np.ndarray, n_sample: int, random: np.random.Generator) -> np.ndarray:
    """Force and acceleration of one hit as the recorder's whole numbers [n_sample, 2], with noise of its last bits."""
    n_pulse, begin = max(round(PULSE * RATE), 2), RATE // 20
    force = np.zeros(n_sample)
    force[begin : begin + n_pulse] = random.uniform(15, 30) * np.sin(np.pi * (np.arange(n_pulse) + 0.5) / n_pulse)
    motion = np.fft.irfft(np.fft.rfft(force) * frf, n_sample)
    both = np.stack([force, motion], axis=1) / FULL_SCALE
    noisy = np.clip(both, -1, 1) * 32767 + random.normal(0, 1.5, both.shape)
    return np.clip(np.round(noisy), -32768, 32767).astype(np.int16)


HIT = tuple(f"hit_{node}.wav" for node in PLACES)
CHAIRS = {
    "spruce": Chair(
        "a measured wooden plate, by `new` alone",
        spruce,
        (
            ("new", "spruce_5L.uff", "--out", "plate.yaml"),
            ("run", "plate.yaml", "--out", "run"),
            ("diagnose", "plate.yaml", "--out", "diagnosis"),
        ),
    ),
    "roving": Chair(
        "a roving hammer at 3 × 5 points, in mm",
        roving,
        (
            ("new", "roving.uff", "--thickness", "0.003", "--material", "aluminium", "--out", "plate.yaml"),
            ("run", "plate.yaml", "--out", "run"),
            ("diagnose", "plate.yaml", "--out", "diagnosis"),
        ),
    ),
    "hits": Chair(
        "raw hits as WAV",
        hits,
        (
            (
                "frf", *HIT, "--response", str(SENSOR), "--scale", *map(str, FULL_SCALE), "--motion", "acceleration",
                "--nodes", "nodes.csv", "--out", "hits.uff",
            ),
            (
                "new", "hits.uff", "--length", *map(str, SIDES), "--thickness", "0.002", "--material", "steel",
                "--out", "plate.yaml",
            ),
            ("run", "plate.yaml", "--out", "run"),
            ("diagnose", "plate.yaml", "--out", "diagnosis"),
        ),
    ),
}  # fmt: skip


def main(names: Sequence[str] = (), out: Path = OUT, data: Path = DATA) -> int:
    """Time the chairs of these names, or all; returns the exit status, 1 where a step has failed.

    Args:
        names: of CHAIRS.
        out: its folders are emptied first.
        data: where measured files lie.
    """
    console = Console(width=120)
    if unknown := [name for name in names if name not in CHAIRS]:
        print(f"Expected names of chairs ({', '.join(CHAIRS)}), got {', '.join(unknown)}. Correct it.", file=sys.stderr)
        return 2
    failed = False
    for name in names or CHAIRS:
        chair, folder = CHAIRS[name], out / name
        console.rule(f"{name}: {chair.title}")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        if not chair.prepare(folder, data):
            console.print(f"left out: the measurement is no part of the project, and none is in {data}")
            continue
        steps = timed(chair, folder, console)
        failed |= any(step.status for step in steps)
        console.print(_table(steps))
        console.print(answer(folder), highlight=False, markup=False)
    return int(failed)


def timed(chair: Chair, folder: Path, console: Console) -> list[Step]:
    """Run the steps of a chair one after the other; one that fails ends them."""
    found: list[Step] = []
    for words in chair.steps:
        load, began = os.getloadavg()[0], time.monotonic()
        with (folder / f"{words[0]}.log").open("w") as log:
            command = [sys.executable, "-m", "torchplate", *words]
            status = _run(command, folder, log)
        found.append(Step(words, time.monotonic() - began, load, status))
        if status:
            said = (folder / f"{words[0]}.log").read_text().splitlines()[-1:]
            console.print(f"`torchplate {shlex.join(words)}` ended with {status}: {''.join(said)}", markup=False)
            break
    return found


def _run(command: Sequence[str], folder: Path, log: IO[str]) -> int:
    """Run a command to its end; what stops this process stops the command, too."""
    with subprocess.Popen(command, cwd=folder, stdout=log, stderr=subprocess.STDOUT) as child:
        before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
        try:
            return child.wait()
        finally:
            signal.signal(signal.SIGTERM, before)
            if child.poll() is None:
                child.terminate()


def _table(steps: Sequence[Step]) -> Table:
    table = Table("step", "seconds", "load before it", title=f"{os.cpu_count()} cores")
    for step in steps:
        table.add_row(step.words[0], f"{step.seconds:.0f}", f"{step.load:.1f}")
    table.add_row("all", f"{sum(step.seconds for step in steps):.0f}", "")
    return table


def answer(folder: Path) -> str:
    """What the user reads at the end: the fit of the run, and the verdict of the diagnosis."""
    parts = []
    if (result := folder / "run" / "result.json").exists():
        parts.append(f"run: {json.loads(result.read_text())['fit']}")
    if (diagnosis := folder / "diagnosis" / "diagnosis.json").exists():
        content = json.loads(diagnosis.read_text())
        named = [f"{one['name']} (confidence {one['confidence']:.2f})" for one in content["effects"]]
        gap = content["gap"]
        parts.append(
            f"diagnose: {content['verdict']}; {', '.join(named) or 'nothing named'}; gap {percent(gap['baseline'])} to "
            f"{percent(gap['final'])}"
        )
    return "\n".join(parts) or "no answer"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Time three users from a file to an answer.")
    parser.add_argument("names", nargs="*", metavar="CHAIR", help=", ".join(CHAIRS))
    parser.add_argument("--data", type=Path, default=DATA, help=f"folder of measured files (default: {DATA})")
    parser.add_argument("--out", type=Path, default=OUT, help=f"(default: {OUT})")
    given = parser.parse_args()
    sys.exit(main(given.names, given.out, given.data))
