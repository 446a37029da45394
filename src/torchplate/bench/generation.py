"""One generation of the paper's problem: 32 members, 6 FRFs, 800 lines, 10 × 10 elements."""

from typing import Any

import torch
from torch import Tensor

from torchplate.bench.peer import Peer
from torchplate.bench.problem import LINES, N_MEMBER, REFERENCE, members, paper_model
from torchplate.bench.timing import interleaved, peak_memory, rates, seconds
from torchplate.model import CLOSE, LINES_AT_ONCE, Disc, PlateModel, Stretch, attach_, modal_sum, reduce, solve_modes

# Lines at which every way is compared with a direct solve of the dynamic stiffness.
N_CHECKED = 25
N_MANY = 4096


@torch.no_grad()
def generation(n_repeat: int = 7) -> dict[str, Any]:
    """Every way to one generation: seconds, times as fast as the peer, and error against direct solves."""
    model, bent = paper_model(), paper_model(bent=True)
    theta, bent_theta = members(model), members(bent)
    peer, shared, small = Peer(model), _reduced(model), _reduced(bent)
    ways = {
        "SciPy, one candidate at a time": lambda: peer.generation(theta),
        "torchplate, all modes, one eigh": lambda: model.frf(theta, LINES),
        "torchplate, shared modes": lambda: shared.frf(theta, LINES),
        "torchplate, shared modes, single precision": lambda: shared.in_single_precision().frf(theta, LINES),
        "torchplate, reduced basis (ν searched too)": lambda: small.frf(bent_theta, LINES),
    }
    taken = interleaved(ways, n_repeat)
    first = next(iter(taken.values()))
    rows = []
    for name, way in ways.items():
        owner, given = (bent, bent_theta) if "ν" in name else (model, theta)
        rows.append(
            {"name": name, "seconds": taken[name], "ratio": first / taken[name], "error": _error(way(), owner, given)}
        )
    system = model.system(theta)
    modes = interleaved(
        {
            "scipy.linalg.eigh, one by one": lambda: [peer.modes(member) for member in theta.numpy()],
            "one torch.linalg.eigh": lambda: solve_modes(system.stiffness, system.mass),
        },
        3,
    )
    return {
        "problem": f"{N_MEMBER} members, {len(REFERENCE)} FRFs, {len(LINES)} lines, {model.assembly.size} dofs",
        "n_thread": torch.get_num_threads(),
        "rows": rows,
        "modes_alone_s": modes,
        "where_the_time_goes_s": _parts(shared, small, theta, bent_theta, n_repeat),
        "machine": rates(),
    }


@torch.no_grad()
def memory() -> dict[str, Any]:
    """The most memory that many members need, the whole process counted."""
    model = paper_model()
    shared, theta = _reduced(model), members(model, N_MANY)
    before = peak_memory()
    frf = shared.frf(theta, LINES)
    return {"n_member": N_MANY, "before_gib": before, "peak_gib": peak_memory(), "result_gib": frf.nbytes / 2**30}


def _reduced(model: PlateModel) -> PlateModel:
    found = reduce(model, LINES)
    assert found is not None, "the paper's problem has a reduced basis"
    return found[0]


def _error(frf: Tensor, model: PlateModel, theta: Tensor) -> float:
    """Greatest relative norm of the difference from direct solves, over members and FRFs."""
    step = len(LINES) // N_CHECKED
    direct = model.frf_direct(theta, LINES[::step])
    return float(((frf[:, ::step] - direct).norm(dim=1) / direct.norm(dim=1)).max())


def _parts(shared: PlateModel, small: PlateModel, theta: Tensor, bent: Tensor, n_repeat: int) -> dict[str, float]:
    """Seconds of what an evaluation is made of, each part alone on arrays of the same size."""
    assert shared.shared_modes is not None
    eigenvalue, system = shared.shared_modes.eigenvalue, small.system(bent)
    rows = torch.rand(10, len(eigenvalue), dtype=torch.float64)
    omega = 2 * torch.pi * LINES[:LINES_AT_ONCE].expand(N_MEMBER, -1)
    z = torch.complex(omega**2, -0.004 * omega**2)
    blocks = len(LINES) / z.shape[-1]
    disc = Disc.around(z, eigenvalue)
    assert disc is not None
    stretch = Stretch.around(disc, eigenvalue, CLOSE)
    found = modal_sum(eigenvalue, rows[:5], rows, z, stretch).flatten(2)
    force = torch.rand(4, z.numel(), dtype=torch.complex128)
    return {
        "shared modes: what the effects say": seconds(lambda: shared.plan(theta), n_repeat),
        "shared modes: modal sum": blocks
        * seconds(lambda: modal_sum(eigenvalue, rows[:5], rows, z, stretch), n_repeat),
        "shared modes: wires attached": blocks * seconds(lambda: attach_(found, force), n_repeat),
        "reduced basis: matrices": seconds(lambda: small.system(bent), n_repeat),
        "reduced basis: eigh": seconds(lambda: solve_modes(system.stiffness, system.mass), n_repeat),
    }
