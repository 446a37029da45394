"""`torchplate bench`: one generation of the paper's problem, by this package and by SciPy one candidate at a time.

All in one run, the median of repeats: only the ratios mean something, since machines are noisy.
"""

import json
import statistics
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.model import PlateModel, Searched, reduce
from torchplate.model.modes import solve_modes
from torchplate.plate import Mesh

N_MEMBER = 32
LINES = torch.arange(1, 801, dtype=torch.float64) * 0.5
RESPONSE, REFERENCE = [3], [28, 102, 104, 33, 61, 118]
# Lines at which every way is compared with a direct solve of the dynamic stiffness.
N_CHECKED = 25


def bench(out: Path | None = None, n_repeat: int = 5, console: Console | None = None) -> dict[str, Any]:
    """Time, print and write `bench.json`.

    Args:
        out: the folder for bench.json; `runs/bench` if left out.
        n_repeat: repeats, of which the median counts.
        console: where the table goes.
    """
    console = console or Console()
    model = paper_model()
    generator = torch.Generator().manual_seed(0)
    theta = model.space.to_si(torch.rand(N_MEMBER, len(model.names), dtype=torch.float64, generator=generator))
    small = reduce(model, LINES)
    assert small is not None, "the paper's problem has a reduced basis"
    with torch.no_grad():
        system = model.system(theta)
        ways: dict[str, Callable[[], Any]] = {
            "SciPy, one candidate at a time": lambda: scipy_generation(model, theta),
            "torchplate, all modes, one eigh": lambda: model.frf(theta, LINES),
            "torchplate, reduced basis, one eigh": lambda: small[0].frf(theta, LINES),
            "modes alone: scipy.linalg.eigh one by one": lambda: scipy_modes(system.stiffness, system.mass),
            "modes alone: one torch.linalg.eigh": lambda: solve_modes(system.stiffness, system.mass),
        }
        seconds = _interleaved(ways, n_repeat)
        checked = LINES[:: len(LINES) // N_CHECKED]
        direct = model.frf_direct(theta, checked)
        errors = {}
        for name, way in list(ways.items())[:3]:
            frf = way()[:, :: len(LINES) // N_CHECKED]
            errors[name] = float(((frf - direct).norm(dim=1) / direct.norm(dim=1)).max())
    names = list(ways)
    ratio = {name: seconds[names[0 if index < 3 else 3]] / seconds[name] for index, name in enumerate(names)}
    result = {
        "schema": "torchplate.bench/1",
        "problem": f"{N_MEMBER} members, {len(REFERENCE)} FRFs, {len(LINES)} lines, {model.assembly.size} dofs",
        "n_thread": torch.get_num_threads(),
        "versions": {name: version(name) for name in ("torch", "scipy", "numpy")},
        "rows": [
            {"name": name, "seconds": seconds[name], "ratio": ratio[name], "error": errors.get(name)} for name in names
        ],
    }
    table = Table("one generation", "seconds", "times as fast", "error against direct solves", box=None, padding=(0, 2))
    for name in names:
        error = f"{errors[name]:.0e}" if name in errors else ""
        table.add_row(name, f"{seconds[name]:.3f}", f"{ratio[name]:.1f}", error)
    console.print(f"{result['problem']}; {result['n_thread']} threads, median of {n_repeat}")
    console.print(table)
    out = out or Path("runs/bench")
    out.mkdir(parents=True, exist_ok=True)
    (out / "bench.json").write_text(json.dumps(result, indent=1) + "\n")
    console.print(f"Written: {out / 'bench.json'}", soft_wrap=True)
    return result


def paper_model() -> PlateModel:
    """Tables 1 and 3 of the paper."""
    known = {"plate.poisson_ratio": 0.3, "plate.density": 7860.0, "plate.thickness": 0.0027}
    searched = {
        "plate.youngs_modulus": Searched(150e9, 260e9),
        "wires.stiffness": Searched(700.0, 2000.0),
        "wires.viscous_damping": Searched(0.2, 1.5),
        "loss.stiffness_loss_factor": Searched(9e-8, 9e-3),
    }
    effects = {"plate": Plate(), "wires": SupportSpring(nodes=(2, 10, 112, 120)), "loss": HystereticDamping()}
    return PlateModel(Mesh(0.48, 0.48, 10, 10), effects, known, searched, RESPONSE, REFERENCE, "accelerance")


def scipy_modes(stiffness: Tensor, mass: Tensor) -> list[tuple[np.ndarray, np.ndarray]]:
    """Modes of every candidate, one after the other."""
    shared = mass.numpy()
    return [scipy.linalg.eigh(matrix, shared) for matrix in stiffness.numpy()]


def scipy_generation(model: PlateModel, theta: Tensor) -> Tensor:
    """The same accelerances as a script with NumPy and SciPy would make them: candidate by candidate, in complex."""
    rows = model.assembly.rows(model.mesh.deflection_at(model.mesh.places([*RESPONSE, *REFERENCE]))).numpy()
    omega = 2 * np.pi * LINES.numpy()
    found = []
    for member in theta:
        system = model.system(member)
        value, shape = scipy.linalg.eigh(system.stiffness.numpy(), system.mass.numpy())
        beta = float(system.proportional.stiffness_loss_factor)
        inverse = 1 / (value * (1 + 1j * beta) - omega[:, None] ** 2)
        read, hit, tied = rows[:1] @ shape, rows[1:] @ shape, system.dashpot.numpy() @ shape
        left, right = np.vstack([read, tied]), np.vstack([hit, tied])
        whole = (left[None] * inverse[:, None, :]) @ right.T
        gain = 1j * omega[:, None, None] * system.viscous.numpy()[:, None]
        coupled = np.eye(len(tied)) + gain * whole[:, 1:, len(hit) :]
        correction = np.linalg.solve(coupled, gain * whole[:, 1:, : len(hit)])
        receptance = whole[:, :1, : len(hit)] - whole[:, :1, len(hit) :] @ correction
        found.append(-(omega[:, None, None] ** 2) * receptance)
    return torch.from_numpy(np.stack(found))


def _interleaved(ways: dict[str, Callable[[], Any]], n_repeat: int) -> dict[str, float]:
    """Median seconds of each way; they take turns, so that a slow spell of the machine hits all alike."""
    times: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(n_repeat + 1):
        for name, way in ways.items():
            began = time.perf_counter()
            way()
            # The first turn warms up.
            if turn:
                times[name].append(time.perf_counter() - began)
    return {name: statistics.median(values) for name, values in times.items()}
