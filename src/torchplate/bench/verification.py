"""`python -m torchplate.bench.verification`: what is published or follows from theory, beside what comes out here.

It prints the tables of docs/verification.md; `--write` puts them there. Blind sets (an hour) and times (a quarter of an
hour) are those that `make blind` and `torchplate bench` wrote last. `--searches` adds the comparison with other
packages' searches, which takes minutes: SciPy is always there, pymoo, pygmo (pagmo) and evosax where they are
installed.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
import torch
from torch import Tensor

from torchplate.bench.marked_page import PAGE, put
from torchplate.bench.published import NAFEMS, SQUARES, SUPPORTED
from torchplate.bench.recorded import Count, Limit, Time, air, blind, speed
from torchplate.effects import HystereticDamping, Plate
from torchplate.measurement import Analyser, Spectra
from torchplate.model import PlateModel, Searched
from torchplate.notation import percent
from torchplate.plate import N_PANEL, Mesh, influence, lattice

COARSE, FINE = 8, 16
NOTHING = torch.zeros(0, dtype=torch.float64)
# Below this a difference is rounding, which is another one on another processor.
ROUNDING = 1e-8
# Added mass of rectangles, three decimals, over that of a cylinder on the short side.
DNV = "DNV-RP-H103, Table A-2"
RECTANGLES = {1.0: 0.579, 2.0: 0.757, 10.0: 0.947}


class Row(NamedTuple):
    """One line of a table.

    Attributes:
        case: what is computed.
        source: where the value is from.
        value: what it should be.
        ours: what it is.
    """

    case: str
    source: str
    value: float
    ours: float

    def cells(self) -> str:
        """The line in Markdown."""
        off = self.ours / self.value - 1
        told = f"below {ROUNDING:.0e}" if abs(off) < ROUNDING else percent(off, 2, signed=True)
        return f"| {self.case} | {self.source} | {self.value:.6g} | {self.ours:.6g} | {told} |".replace("| -", "| −")


def plate(sides: tuple[float, float], cells: tuple[int, int], edges: Mapping[str, str], **numbers: float) -> PlateModel:
    """A plate without anything on it: E 200 GPa, ν 0.3, ρ 8000, 10 mm unless told otherwise."""
    known = {"youngs_modulus": 200e9, "poisson_ratio": 0.3, "density": 8000.0, "thickness": 0.01} | numbers
    mesh = Mesh(*sides, *cells, edges=dict(edges))
    return PlateModel(mesh, {"plate": Plate()}, {f"plate.{name}": value for name, value in known.items()})


def elastic(model: PlateModel, n_mode: int) -> Tensor:
    """The lowest natural frequencies beyond those of a rigid body [Hz]."""
    found = model.natural_frequencies(NOTHING, n_mode + 3)
    return found[found > 0][:n_mode]


def extrapolated(sides: tuple[float, float], edges: Mapping[str, str], n_mode: int, **numbers: float) -> Tensor:
    """From two meshes, the mesh error taken off as `mesh.extrapolate` does [Hz]."""
    squares = [elastic(plate(sides, (n, n), edges, **numbers), n_mode).square() for n in (COARSE, FINE)]
    return ((4 * squares[1] - squares[0]) / 3).sqrt()


def natural_frequencies() -> Iterator[Row]:
    """Published squares, NAFEMS's benchmarks, and the series of Navier and Lévy."""
    unit = 2 * math.pi / math.sqrt(200e9 * 0.01**2 / (12 * (1 - 0.3**2)) / 8000)
    for name, (edges, values, _, source) in SQUARES.items():
        found = unit * extrapolated((1.0, 1.0), edges, len(values))
        for mode, (value, ours) in enumerate(zip(values, found.tolist(), strict=True), 1):
            yield Row(f"square, {name}, λ of mode {mode}", source, value, ours)
    for name, (edges, values, _, source) in NAFEMS.items():
        found = extrapolated((10.0, 10.0), edges, len(values), thickness=0.05)
        for mode, (value, ours) in enumerate(zip(values, found.tolist(), strict=True), 1):
            yield Row(f"{name}, mode {mode} [Hz]", source, value, ours)
    sides = (0.9, 0.5)
    speed = math.pi / 2 * math.sqrt(200e9 * 0.01**2 / (12 * (1 - 0.3**2)) / 8000)
    series = sorted(speed * ((m / sides[0]) ** 2 + (n / sides[1]) ** 2) for m in range(1, 6) for n in range(1, 6))
    for mode, ours in enumerate(extrapolated(sides, SUPPORTED, 4).tolist(), 1):
        yield Row(f"0.9 × 0.5 m, simply supported, mode {mode} [Hz]", "Navier's series", series[mode - 1], ours)
    edges = {"x0": "simply_supported", "x1": "simply_supported", "y0": "clamped", "y1": "free"}
    exact = sorted(w for m in range(1, 5) for w in levy((0.9, 0.6), 0.3, m, 250.0))
    found = unit * extrapolated((0.9, 0.6), edges, 4)
    for mode, ours in enumerate(found.tolist(), 1):
        yield Row(f"0.9 × 0.6 m, SS-SS-C-F, ω√(ρh/D) of mode {mode} [1/m²]", "Lévy's solution", exact[mode - 1], ours)


def levy(sides: tuple[float, float], poisson: float, n_half_wave: int, highest: float) -> list[float]:
    """ω √(ρh/D) with x0 and x1 simply supported, y0 clamped, y1 free, for one number of half waves in x [1/m²].

    w = Y(y) sin(mπx/Lx), Y of cosh and sinh λ₁y, cos and sin λ₂y, λ₁² = k² + p², λ₂² = k² − p², p = mπ/Lx, k² what
    is wanted. At y = 0 Y = Y' = 0; at y = Ly Y'' = ν p² Y and Y''' = (2 − ν) p² Y'. Source: Leissa (1969), section 4.2.
    """
    p, length = n_half_wave * math.pi / sides[0], sides[1]

    def determinant(square: float) -> float:
        one, two = math.sqrt(square + p**2), math.sqrt(square - p**2)
        ch, sh, c, s = math.cosh(one * length), math.sinh(one * length), math.cos(two * length), math.sin(two * length)
        free, shear = poisson * p**2, (2 - poisson) * p**2
        moment = (one**2 - free) * ch + (two**2 + free) * c, (one - free / one) * sh + (two + free / two) * s
        third = (
            (one**3 - shear * one) * sh - (two**3 + shear * two) * s,
            (one**2 - shear) * ch + (two**2 + shear) * c,
        )
        return (moment[0] * third[1] - moment[1] * third[0]) / ch

    if p**2 >= highest:
        return []
    grid = np.linspace(p**2 * (1 + 1e-9), highest, 400)
    value = [determinant(point) for point in grid]
    pairs = zip(grid[:-1], grid[1:], value[:-1], value[1:], strict=True)
    return [scipy.optimize.brentq(determinant, a, b) for a, b, at_a, at_b in pairs if at_a * at_b < 0]


def orders() -> Iterator[Row]:
    """By which power of the element's side natural frequencies converge: two."""
    for name, (edges, values, _, _) in SQUARES.items():
        unit = 2 * math.pi / math.sqrt(200e9 * 0.01**2 / (12 * (1 - 0.3**2)) / 8000)
        exact = torch.tensor(values, dtype=torch.float64)
        error = [
            float((unit * elastic(plate((1.0, 1.0), (n, n), edges), len(values)) / exact - 1).abs().max())
            for n in (COARSE, FINE)
        ]
        yield Row(f"order from {COARSE} to {FINE} elements, {name}", "theory, h²", 2.0, math.log2(error[0] / error[1]))


def beside_scikit_fem() -> Iterator[Row]:
    """A rectangle by scikit-fem's conforming Bogner–Fox–Schmit element; no row where it is not installed."""
    try:
        import skfem
        from skfem.assembly import BilinearForm
    except ModuleNotFoundError:
        return
    sides, poisson = (1.0, 0.7), 0.3
    axes = (np.linspace(0, side, n + 1) for n, side in zip((16, 12), sides, strict=True))
    basis = skfem.Basis(skfem.MeshQuad.init_tensor(*axes), skfem.ElementQuadBFS(), intorder=8)

    @BilinearForm
    def bending(u, v, _):  # type: ignore[no-untyped-def]
        (uxx, uxy), (_, uyy) = u.hess
        (vxx, vxy), (_, vyy) = v.hess
        return uxx * vxx + uyy * vyy + poisson * (uxx * vyy + uyy * vxx) + 2 * (1 - poisson) * uxy * vxy

    @BilinearForm
    def inertia(u, v, _):  # type: ignore[no-untyped-def]
        return u * v

    stiffness, mass = (form.assemble(basis).toarray() for form in (bending, inertia))
    value = scipy.linalg.eigh(stiffness, mass, eigvals_only=True, subset_by_index=[3, 7])
    unit = 2 * math.pi / math.sqrt(200e9 * 0.01**2 / (12 * (1 - poisson**2)) / 8000)
    found = unit * extrapolated(sides, {}, 5)
    for mode, (square, ours) in enumerate(zip(value, found.tolist(), strict=True), 1):
        yield Row(
            f"1 × 0.7 m, free, ω√(ρh/D) of mode {mode} [1/m²]", "scikit-fem, BFS 16 × 12", math.sqrt(square), ours
        )


SMALL = Analyser(span=250.0, n_line=100)


def _spectra(analyser: Analyser, force: Tensor, response: Tensor) -> Spectra:
    empty = Spectra.zeros(analyser, 1, 1, torch.device("cpu"))
    return empty.add(analyser, torch.zeros(len(force), dtype=torch.int64), force, response[:, None])


def _decaying(analyser: Analyser, decay: float, line: int) -> tuple[Tensor, Tensor]:
    """A hit of one sample, and the response of a mode whose frequency is that of a line."""
    time = torch.arange(analyser.n_sample, dtype=torch.float64) * analyser.record / analyser.n_sample
    force = torch.zeros(1, analyser.n_sample, dtype=torch.float64)
    force[:, 0] = 1.0
    pulse = 2 * math.pi * line / analyser.record
    return force, (torch.exp(-decay * time) * torch.sin(pulse * time))[None]


def decay_of(frf: Tensor, line: int, analyser: Analyser) -> float:
    """Of the mode near a line, from the pole of the sampled response: H = (a + b z) / (1 + c z + d z²) [1/s]."""
    step = analyser.record / analyser.n_sample
    near = slice(max(1, line - 8), line + 9)
    z = torch.exp(-2j * math.pi * analyser.frequency[near] * step)
    h = frf[near]
    # a and b are real, c and d too.
    rows = torch.stack([torch.ones_like(z), z, -h * z, -h * z**2], dim=1)
    rows, right = torch.cat([rows.real, rows.imag]), torch.cat([h.real, h.imag])
    d = float(torch.linalg.lstsq(rows, right[:, None], driver="gelsd").solution[3, 0])
    return -math.log(d) / (2 * step)


def analyser() -> Iterator[Row]:
    """What windows, noise and a record that ends too soon do to an FRF, in theory and by the virtual analyser."""
    line, own, tau = 40, 60.0, 0.05
    windowed = Analyser(span=250.0, n_line=100, exponential_window=tau)
    found = decay_of(_spectra(windowed, *_decaying(windowed, own, line)).frf("H1")[0, 0], line, windowed)
    yield Row("decay of a mode under an exponential window [1/s]", "theory, σ + 1/τ", own + 1 / tau, found)
    generator = torch.Generator().manual_seed(1)
    force, noise = torch.randn(2, 4000, SMALL.n_sample, generator=generator, dtype=torch.float64)
    for ratio in (0.1, 1.0):
        seen = _spectra(SMALL, force + math.sqrt(ratio) * noise, 3 * force)
        level = float(seen.frf("H1").abs().mean()) / 3
        yield Row(
            f"H1 over H, noise on the force of {ratio:g} of its power", "theory, 1/(1 + N/S)", 1 / (1 + ratio), level
        )
    for decay in (2.0, 8.0):
        cut = _spectra(SMALL, *_decaying(SMALL, decay, line)).frf("H1")[0, 0, line]
        long = Analyser(span=250.0, n_line=3200)
        whole = _spectra(long, *_decaying(long, decay, line * 32)).frf("H1")[0, 0, line * 32]
        left = 1 - math.exp(-decay * SMALL.record)
        name = f"peak over the true one, record ends at exp(−{decay * SMALL.record:g})"
        yield Row(name, "theory, 1 − exp(−σT)", left, float((cut / whole).abs()) * (1 - math.exp(-decay * long.record)))


def gradients() -> Iterator[Row]:
    """Derivatives of an FRF at repeated natural frequencies, by the complex step on a solve at each line."""
    mesh, young = Mesh(0.4, 0.4, 6, 6), 7e10
    known = {"plate.poisson_ratio": 0.33, "plate.density": 2700.0, "plate.thickness": 0.003}
    effects = {"plate": Plate(), "loss": HystereticDamping()}
    model = PlateModel(mesh, effects, known, {"plate.youngs_modulus": Searched(5e10, 9e10)}, [3], [(0.3, 0.8)])
    theta = torch.tensor([young], dtype=torch.float64, requires_grad=True)
    system = model.system(theta.detach())
    pair = model.natural_frequencies(theta.detach(), 8)[6:]
    rows = [
        model.assembly.rows(mesh.deflection_at(mesh.places(points).to(model.known))) for points in ([3], [(0.3, 0.8)])
    ]
    for part, frequency in (("just below", 0.999 * pair[0]), ("just above", 1.001 * pair[1])):
        found = model.frf(theta, frequency, kind="receptance").real.sum()
        (ours,) = torch.autograd.grad(found, theta)
        step = 1e-30
        impedance = system.stiffness * (1 + 1j * step) - (2 * math.pi * frequency) ** 2 * system.mass
        solved = torch.linalg.solve(impedance, rows[1].mT.to(impedance))
        value = float((rows[0].to(impedance) @ solved).imag) / step / young
        # At E of 1e11 the derivative is small in SI: per E it is of the size of the receptance.
        yield Row(
            f"E dα/dE {part} a double mode [m/N]", "complex step of a direct solve", young * value, young * float(ours)
        )


def around() -> Iterator[Row]:
    """The mass of the air that plates drag along."""
    width, radius, short = 0.13, 0.21, 0.31
    # What the ends lack is the same for both lengths.
    middle = of_translation(20 * width, width) - of_translation(10 * width, width)
    strip = middle / (10 * width * width**2)
    yield Row("added mass of a long strip over ρ b² per length", "ρ π b²/4, Lamb", math.pi / 4, strip)
    # Equal panels up to a quarter of one within the rim: staircase, whose error changes sign from size to size.
    found = []
    for n in range(36, 50, 2):
        size = 2 * radius / n
        edge = size * torch.arange(n + 1, dtype=torch.float64) - radius
        middles = 0.5 * (edge[1:] + edge[:-1])
        kept = (middles[:, None] ** 2 + middles**2).sqrt().flatten() < radius - size / 4
        own = influence(edge, middles, edge, middles)[kept][:, kept]
        found.append(size**2 * float(torch.linalg.inv(own).sum()) / radius**3)
    yield Row("added mass of a disc over ρ a³", "8/3, Lamb", 8 / 3, sum(found) / len(found))
    for ratio, coefficient in RECTANGLES.items():
        ours = of_translation(ratio * short, short) / (math.pi / 4 * short**2 * ratio * short)
        yield Row(f"added mass of a rectangle of 1 to {ratio:g} over that of a strip", DNV, coefficient, ours)


def of_translation(length_x: float, length_y: float) -> float:
    """Added mass of a plate that moves as a whole, over the density [m³]."""
    return float(lattice(length_x, length_y, N_PANEL)[1].sum())


TABLES: dict[str, Callable[[], Iterator[Row | Count | Time | Limit]]] = {
    "Natural frequencies": natural_frequencies,
    "Convergence": orders,
    "Beside another finite element": beside_scikit_fem,
    "The virtual analyser": analyser,
    "Gradients where modes repeat": gradients,
    "Air around a plate": around,
    "What the air costs": air,
    "Plates with hidden effects": blind,
    "Speed, beside SciPy one candidate at a time": speed,
}
QUICK = ("<!-- numbers -->", "<!-- end of numbers -->")
LONG = ("<!-- searches -->", "<!-- end of searches -->")


def page() -> str:
    """The quick tables in Markdown."""
    lines = []
    for title, rows in TABLES.items():
        lines += [f"### {title}", "", "| case | source | value | ours | difference |", "|---|---|---|---|---|"]
        lines += [*(row.cells() for row in rows()), ""]
    return "\n".join(lines).strip()


def main(arguments: list[str] | None = None) -> None:
    """Print, and write where asked for."""
    words = argparse.ArgumentParser(prog="python -m torchplate.bench.verification", description=__doc__)
    words.add_argument("--write", action="store_true", help=f"put the tables into {PAGE.name}")
    words.add_argument("--searches", action="store_true", help="compare searches, too (minutes)")
    told = words.parse_args(arguments)
    parts = [(QUICK, page())]
    if told.searches:
        from torchplate.bench.searches import searches

        parts.append((LONG, searches()))
    for ends, text in parts:
        print(text, "\n")
        if told.write:
            PAGE.write_text(put(PAGE.read_text(), ends, text))


if __name__ == "__main__":
    main()
