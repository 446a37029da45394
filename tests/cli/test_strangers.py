"""Files as other programs write them, of a plate by Ritz's method, come to their answer by `new` and `run`.

Nothing here is torchplate's own: neither the FRFs nor the writer.
"""

import json
import re

import numpy as np
import pytest
from numpy.polynomial import legendre

pytestmark = pytest.mark.check
SIDES, THICKNESS, YOUNG, POISSON, DENSITY, LOSS = (0.42, 0.3), 0.003, 70.4e9, 0.33, 2700.0, 0.02
LINES = np.arange(40.0, 301.0, 2.0)
GRID = [(x, y) for y in np.linspace(0, SIDES[1], 3) for x in np.linspace(0, SIDES[0], 5)]
# Polynomials a side, at which the first six natural frequencies stand to 1e-5.
N_SHAPE = 10


def shapes(place: np.ndarray, derivative: int = 0) -> np.ndarray:
    """Legendre polynomials of unit mean square over a side from −1 to 1, or derivatives of them [shape, place]."""
    one = np.eye(N_SHAPE)
    rows = [legendre.legval(place, legendre.legder(np.sqrt(2 * k + 1) * one[k], derivative)) for k in range(N_SHAPE)]
    return np.array([np.broadcast_to(row, np.shape(place)) for row in rows])


def accelerance() -> np.ndarray:
    """[line, hit], read at the first place of the grid: (K (1 + iη) − ω² M) q = f, K of a free Kirchhoff plate."""
    at, weight = legendre.leggauss(N_SHAPE + 2)
    mean = lambda i, j: (shapes(at, i) * weight) @ shapes(at, j).T / 2  # noqa: E731
    a, b = (2 / side for side in SIDES)
    rigidity = YOUNG * THICKNESS**3 / (12 * (1 - POISSON**2)) * SIDES[0] * SIDES[1]
    mixed = np.kron(mean(2, 0), mean(0, 2)) + np.kron(mean(0, 2), mean(2, 0))
    stiffness = a**4 * np.kron(mean(2, 2), mean(0, 0)) + b**4 * np.kron(mean(0, 0), mean(2, 2))
    stiffness += (a * b) ** 2 * (POISSON * mixed + 2 * (1 - POISSON) * np.kron(mean(1, 1), mean(1, 1)))
    # The polynomials are orthonormal: the mass matrix is the plate's mass.
    square, mode = np.linalg.eigh(rigidity * stiffness / (DENSITY * THICKNESS * SIDES[0] * SIDES[1]))
    spots = np.array(
        [np.kron(shapes(np.array(2 * x / SIDES[0] - 1)), shapes(np.array(2 * y / SIDES[1] - 1))) for x, y in GRID]
    )
    seen = spots @ mode / np.sqrt(DENSITY * THICKNESS * SIDES[0] * SIDES[1])
    omega = 2 * np.pi * LINES[:, None]
    modal = -(omega**2) / (np.maximum(square, 0) * (1 + 1j * LOSS) - omega**2)
    return (modal * seen[0]) @ seen.T


def universal(frf: np.ndarray, places: list[tuple[float, ...]], first: int, axis: int, units: tuple[str, str]) -> str:
    """Datasets 15 and 58 by their columns, ASCII, double precision."""
    labels = range(first, first + len(places))
    lines = ["    -1", "    15"]
    lines += [
        f"{n:10d}{0:10d}{0:10d}{8:10d}" + "".join(f"{c:13.5E}" for c in p) for n, p in zip(labels, places, strict=True)
    ]
    lines.append("    -1")
    for node, column in zip(labels, frf.T, strict=True):
        values = np.stack([column.real, column.imag], axis=1).ravel()
        rows = ["".join(f"{one:20.12E}" for one in values[i : i + 4]) for i in range(0, len(values), 4)]
        lines += ["    -1", "    58", *["NONE"] * 5]
        lines.append(f"{4:5d}{1:10d}{0:5d}{0:10d} {'Plate':10s}{first:10d}{axis:4d} {'Hammer':10s}{node:10d}{axis:4d}")
        lines.append(f"{6:10d}{len(LINES):10d}{1:10d}{LINES[0]:13.5E}{LINES[1] - LINES[0]:13.5E}{0.0:13.5E}")
        lines.append(f"{18:10d}{0:5d}{0:5d}{0:5d} {'Frequency':20s} {'Hz':20s}")
        lines.append(f"{12:10d}{1:5d}{0:5d}{0:5d} {'Acceleration':20s} {units[0]:20s}")
        lines.append(f"{13:10d}{0:5d}{1:5d}{0:5d} {'Force':20s} {units[1]:20s}")
        lines += [f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {'NONE':20s}", *rows, "    -1"]
    return "\n".join(lines) + "\n"


def of_fortran() -> str:
    """Millimetres from the middle, along −Z, labels from 1001, every number with a D, lines as Windows ends them."""
    places = [(1e3 * (x - SIDES[0] / 2), 1e3 * (y - SIDES[1] / 2), 0.0) for x, y in GRID]
    text = universal(accelerance(), places, 1001, -3, ("m/s^2", "N"))
    return re.sub(r"(\d)E([+-]\d\d)", r"\1D\2", text).replace("\n", "\r\n")


def of_america() -> str:
    """Inches and pounds, the plate hung upright in x and z, a metre from the origin."""
    places = [((1 + x) / 0.0254, 0.0, y / 0.0254) for x, y in GRID]
    units = ["    -1", "   164", f"{7:10d}{'in (lbf)':20s}{2:10d}"]
    units += [
        "".join(f"{one:25.16E}" for one in (1 / 0.0254, 1 / 4.4482216152605, 1.8)),
        f"{460.0:25.16E}",
        "    -1",
        "",
    ]
    return "\n".join(units) + universal(accelerance() * 4.4482216152605 / 0.0254, places, 1, 2, ("in/s^2", "lbf"))


@pytest.mark.parametrize("write", [of_fortran, of_america])
def test_the_modulus_and_the_loss_are_found(write, command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "test.unv").write_bytes(write().encode())
    status, printed, error = command("inspect", "test.unv")
    assert status == 0, error
    assert "15 nodes" in printed
    assert "does not parse" not in printed
    status, printed, error = command("new", "test.unv", "--thickness", str(THICKNESS), "--material", "aluminium")
    assert status == 0, error
    assert "plate of 0.42 × 0.3 m" in printed
    status, printed, error = command("run", "test.yaml", "--out", "run")
    assert status == 0, error
    # What is left of six digits is no news.
    assert "off the plate" not in printed
    found = json.loads((tmp_path / "run" / "result.json").read_text())
    # What a mesh of 12 × 10 elements is off by, half a line of 2 Hz at 300 Hz.
    assert found["parameters"]["plate.youngs_modulus"]["value"] == pytest.approx(YOUNG, rel=7e-3)
    assert found["parameters"]["loss.stiffness_loss_factor"]["value"] == pytest.approx(LOSS, rel=0.1)
    assert found["gap"] < 0.1
