"""What a mesh takes of the machine's memory, told before it is taken."""

import math
import resource
from pathlib import Path

from torchplate.cli.schema import MeshConfig

BYTES_PER_DOF, BYTES_PER_DOUBLING = 10e3, 400.0
"""Of a run on a mesh whose matrices are sparse: per dof, and per dof for each doubling of their number.

Matrices and their assembly about 3 kB, a basis of 250 vectors and its copies 7 kB, and the factors of the dynamic
stiffness, complex, which fill the more the finer the mesh: 105 numbers for each dof at 2,000 dofs, 129 at 5,000.
Measured: 13 kB for each dof at 44,000 dofs (two natural frequencies, no FRFs), where this says 16 kB; 13.7 kB at
482,000 (a plate on wires in 400 × 400 elements, no search), where this says 17.6 kB.
"""
MATRICES = 8
"""Dense matrices of each member, its modes among them; see `PlateModel._chunks`."""
LEAST = 1e9
"""Below so much the estimate is not held against the machine: dense matrices are bounded otherwise."""


def needed(cells: tuple[int, int]) -> float:
    """About how many bytes a run takes on a mesh of so many elements along x and y."""
    n_dof = 3.0 * (cells[0] + 1) * (cells[1] + 1)
    return n_dof * (BYTES_PER_DOF + BYTES_PER_DOUBLING * math.log2(n_dof))


def finest(cells: tuple[int, int], memory: float) -> tuple[int, int]:
    """The finest mesh in the same proportion that fits a memory [bytes]; one element at least."""
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(_scaled(cells, middle)) <= memory else (low, middle)
    return _scaled(cells, low)


def _scaled(cells: tuple[int, int], part: float) -> tuple[int, int]:
    return max(1, int(part * cells[0])), max(1, int(part * cells[1]))


def complaint(settings: MeshConfig, refine: int = 1, finer: int = 1) -> str | None:
    """What is wrong with a mesh that does not fit the machine; None where it fits, or nobody can tell.

    Args:
        settings: the config's mesh.
        refine: each of its elements is split once more.
        finer: the mesh is compared with one so much finer, which must fit too.
    """
    memory = available()
    split = settings.refine * refine
    cells = split * settings.n_x, split * settings.n_y
    need = needed((finer * cells[0], finer * cells[1]))
    if memory is None or need <= max(memory, LEAST):
        return None
    best = finest((finer * cells[0], finer * cells[1]), memory)
    beside = "" if finer == 1 else f" with the {finer} times finer mesh that tells its error"
    return (
        f"Expected a mesh that fits the {memory / 1e9:.3g} GB of memory that are free, got {cells[0]} × {cells[1]} "
        f"elements, which take about {need / 1e9:.3g} GB{beside}. The finest that fits has about "
        f"{max(1, best[0] // finer)} × {max(1, best[1] // finer)}: lower mesh.n_x and mesh.n_y, or mesh.refine."
    )


def without_basis(n_dof: int) -> str | None:
    """What is wrong with a model in so many dofs, all of them dense; None where one member fits the machine."""
    memory, need = available(), MATRICES * 8.0 * n_dof**2
    if memory is None or need <= max(memory, LEAST):
        return None
    return (
        f"Expected a model that fits the {memory / 1e9:.3g} GB of memory that are free, got one in {n_dof} dofs for "
        f"which no small basis is good enough, which takes about {need / 1e9:.3g} GB. Lower mesh.n_x and mesh.n_y, or "
        "mesh.refine."
    )


def available() -> float | None:
    """Bytes that this process may still take: the machine's, its container's, and its own limit; None if unknown."""
    found = []
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        found += [1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    except OSError:
        pass
    try:
        group = Path("/sys/fs/cgroup")
        limit = (group / "memory.max").read_text().strip()
        if limit.isdigit():
            found.append(float(limit) - float((group / "memory.current").read_text()))
    except (OSError, ValueError):
        pass
    own = resource.getrlimit(resource.RLIMIT_AS)[0]
    if own != resource.RLIM_INFINITY:
        found.append(float(own))
    return min(found, default=None)
