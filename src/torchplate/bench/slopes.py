"""Cost of one evaluation of a population against mesh, members, lines and FRFs."""

import time
from typing import Any

import torch

from torchplate.bench.peer import Peer
from torchplate.bench.problem import N_MEMBER, members, paper_model
from torchplate.bench.timing import interleaved, seconds
from torchplate.model import PlateModel, reduce

BAND = 400.0
ELEMENTS = (10, 20, 40)
FINEST = 100
MEMBERS = (1, 8, 32, 128, 512, 4096)
LINES = (50, 200, 800, 3200)
FRFS = (1, 2, 4, 6, 12, 24)
# The peer is timed on a few members, and its time for the rest is in proportion: it takes them one by one.
N_PEER = 4


@torch.no_grad()
def slopes(n_repeat: int = 3) -> dict[str, Any]:
    """Seconds for each value of each axis, the others as in the paper's problem; and what fine meshes cost."""
    lines = _lines(800)
    table: dict[str, Any] = {"mesh": _meshes(n_repeat)}
    model, bent = paper_model(), paper_model(bent=True)
    ways = {"shared modes": _reduced(model, lines), "reduced basis": _reduced(bent, lines)}
    table["members"] = [
        {"members": n}
        | {name: seconds(lambda way=way, n=n: way.frf(members(way, n), lines), n_repeat) for name, way in ways.items()}  # type: ignore[misc]
        | {"SciPy": _peer(model, lines, n)}
        for n in MEMBERS
    ]
    table["lines"] = []
    for n in LINES:
        given = _lines(n)
        own = {"shared modes": _reduced(model, given), "reduced basis": _reduced(bent, given)}
        table["lines"].append({"lines": n} | _timed(own, given, n_repeat) | {"SciPy": _peer(model, given, N_MEMBER)})
    table["FRFs"] = []
    for n in FRFS:
        models = [paper_model(n_reference=n), paper_model(bent=True, n_reference=n)]
        own = {name: _reduced(each, lines) for name, each in zip(ways, models, strict=True)}
        table["FRFs"].append({"FRFs": n} | _timed(own, lines, n_repeat) | {"SciPy": _peer(models[0], lines, N_MEMBER)})
    return table | {"n_thread": torch.get_num_threads()}


@torch.no_grad()
def _meshes(n_repeat: int) -> list[dict[str, Any]]:
    """Preparation by mesh, and one generation after it; the small meshes take turns."""
    lines, rows, ways = _lines(800), [], {}
    for n in (*ELEMENTS, FINEST):
        row: dict[str, Any] = {"elements": n}
        for name, bent in (("shared modes", False), ("reduced basis", True)):
            model = paper_model(n, bent)
            began = time.perf_counter()
            # A fine mesh is in a basis; on the paper's own all modes are there, and the same basis is forced on it.
            found = reduce(model, lines)
            assert found is not None, "the basis of a fine mesh is as small as that of a coarse one"
            row |= {"dofs": model.assembly.size, f"{name}: preparation": time.perf_counter() - began}
            row |= {f"{name}: error": found[1], f"{name}: vectors": found[0].assembly.size}
            ways[f"{name} {n}"] = (found[0], members(model))
        rows.append(row)
    taken = interleaved(
        {key: lambda model=model, theta=theta: model.frf(theta, lines) for key, (model, theta) in ways.items()},  # type: ignore[misc]
        n_repeat,
    )
    for row in rows:
        for name in ("shared modes", "reduced basis"):
            row[name] = taken[f"{name} {row['elements']}"]
    for n, row in zip(ELEMENTS[:2], rows, strict=False):
        row["SciPy"] = _peer(paper_model(n), lines, N_MEMBER)
    return rows


def _timed(ways: dict[str, PlateModel], lines: torch.Tensor, n_repeat: int) -> dict[str, float]:
    return interleaved(
        {name: lambda way=way: way.frf(members(way), lines) for name, way in ways.items()},  # type: ignore[misc]
        n_repeat,
    )


def _peer(model: PlateModel, lines: torch.Tensor, n_member: int) -> float:
    peer, theta = Peer(model, lines), members(model, min(n_member, N_PEER))
    return seconds(lambda: peer.generation(theta), 1) * n_member / len(theta)


def _reduced(model: PlateModel, lines: torch.Tensor) -> PlateModel:
    found = reduce(model, lines)
    assert found is not None
    return found[0]


def _lines(n: int) -> torch.Tensor:
    return torch.arange(1, n + 1, dtype=torch.float64) * (BAND / n)
