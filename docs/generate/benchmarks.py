"""Natural frequencies of plates with published values, computed when the page is made."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from of_tests import module_of_tests

from torchplate.effects import Plate
from torchplate.model import PlateModel
from torchplate.plate import Mesh

COARSE, FINE = 8, 16
NONE = torch.zeros(0, dtype=torch.float64)
ABOUT = f"""\
Natural frequencies on {FINE} × {FINE} elements, and with the mesh error taken off by Richardson's extrapolation from
{COARSE} × {COARSE} and {FINE} × {FINE}, which is what `mesh.extrapolate` does; computed when this page was made. The
tests of `tests/plate/test_convergence.py` hold the same values and the orders of convergence."""
SOURCES = {
    "free": "Leissa, NASA SP-160 (1969), converged to four decimals",
    "cantilever": "likewise; Barton (1951)",
    "clamped": "likewise",
    "FV12": "NAFEMS, Selected Benchmarks for Natural Frequency Analysis (1987), converged: free",
    "FV13": "likewise: simply supported, which Navier gives exactly",
    "FV16": "likewise: cantilever",
}


def benchmarks() -> str:
    """The page: source, value, ours, difference."""
    published = module_of_tests("plate/test_convergence.py")
    lines = [
        "# Against published values",
        "",
        ABOUT,
        "",
    ]
    for name, (edges, values, _, _) in published.SQUARES.items():
        factor = 2 * math.pi / math.sqrt(1e9 * 1e-6 / (12 * (1 - 0.09)) / 10.0)
        made = [factor * found for found in _frequencies(1.0, 1e9, 1000.0, 0.01, edges, len(values))]
        lines += _table(f"Square, {name}, ν 0.3", "λ = ω a² √(ρh/D)", SOURCES[name], values, *made)
    for name, (edges, values, _, _) in published.NAFEMS.items():
        made = _frequencies(10.0, 200e9, 8000.0, 0.05, edges, len(values))
        lines += _table(f"NAFEMS {name}, 10 × 10 × 0.05 m", "Hz", SOURCES[name], values, *made)
    return "\n".join(lines)


def _frequencies(
    side: float, young: float, density: float, thickness: float, edges: Mapping[str, Any], n_mode: int
) -> list[torch.Tensor]:
    """The lowest elastic natural frequencies [Hz]: on the finer mesh, and extrapolated."""
    known = {"youngs_modulus": young, "poisson_ratio": 0.3, "density": density, "thickness": thickness}
    n_rigid = 0 if edges else 3
    squares = []
    for n in (COARSE, FINE):
        model = PlateModel(
            Mesh(side, side, n, n, edges=dict(edges)),
            {"plate": Plate()},
            {f"plate.{key}": value for key, value in known.items()},
        )
        squares.append(model.natural_frequencies(NONE, n_mode + n_rigid)[n_rigid:].square())
    return [squares[1].sqrt(), ((4 * squares[1] - squares[0]) / 3).sqrt()]


def _table(
    title: str, unit: str, source: str, values: list[float], fine: torch.Tensor, extrapolated: torch.Tensor
) -> list[str]:
    lines = [
        f"## {title}",
        "",
        f"{source[0].upper()}{source[1:]}; {unit}.",
        "",
        f"| mode | published | {FINE} × {FINE} | difference | extrapolated | difference |",
        "|---|---|---|---|---|---|",
    ]
    for mode, (value, one, other) in enumerate(zip(values, fine, extrapolated, strict=True), 1):
        cells = [f"{float(found):.4f} | {100 * (float(found) / value - 1):+.3f} %" for found in (one, other)]
        lines.append(f"| {mode} | {value} | {' | '.join(cells)} |".replace("| -", "| −"))
    return [*lines, ""]
