"""Natural frequencies against exact solutions, converged values of the literature and an independent solver.

The element is not conforming: its frequencies may lie above or below the exact ones, and their error falls as h². Where
one order is tested it is that of the mode with the largest error, since a mode whose error changes sign on the way has
none. The order on coarse meshes is a little below two, because the next term of the error still counts.
"""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.optimize
import scipy.sparse.linalg
import skfem
from skfem.assembly import BilinearForm

from torchplate.bench.published import CANTILEVER, NAFEMS, SQUARES, SUPPORTED
from torchplate.plate import Mesh


def elastic(frequency: np.ndarray, edges: dict[str, str]) -> np.ndarray:
    return frequency if edges else frequency[3:]


def extrapolated(coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """What two meshes, one twice as fine, say together if the error falls as h²."""
    return (4 * fine - coarse) / 3


@pytest.mark.parametrize("name", list(SQUARES))
def test_a_square_converges_on_the_values_of_the_literature_as_h_squared(
    angular_frequencies, isotropic, name: str
) -> None:
    edges, converged, own, _ = SQUARES[name]
    n_mode = len(converged) + (0 if edges else 3)
    found = {
        n: elastic(angular_frequencies(Mesh(1.0, 1.0, n, n, edges=edges), isotropic(1.0, 0.3), 1.0, n_mode), edges)
        for n in (8, 12, 16, 24)
    }
    error = {n: np.abs(value / converged - 1).max() for n, value in found.items()}
    # Measured 8 → 16 and 12 → 24: free 1.90 and 1.95, cantilever 1.91 and 1.85, clamped 1.80 and 1.91.
    assert 1.75 < np.log2(error[8] / error[16]) < 2.05
    assert 1.75 < np.log2(error[12] / error[24]) < 2.05
    # Measured 0.05 %, 0.09 % and 0.55 % at 24 × 24.
    assert error[24] < {"free": 6e-4, "cantilever": 1.1e-3, "clamped": 7e-3}[name]
    # Without the h² term what is left is of a higher order: measured 2.6e-5, 1.1e-4 (the corner's) and 4.4e-4.
    np.testing.assert_allclose(extrapolated(found[12], found[24]), converged, rtol=0.1 * error[24] + own)


def test_a_free_square_has_three_rigid_motions_and_repeated_modes(angular_frequencies, isotropic) -> None:
    found = angular_frequencies(Mesh(1.0, 1.0, 8, 8), isotropic(1.0, 0.3), 1.0, 8)
    # The square root of rounding of ω² at the scale of the shift and of the first modes.
    assert found[:3].max() < 1e-4
    assert found[6] == pytest.approx(found[7], rel=1e-9)


@pytest.mark.parametrize("name", list(NAFEMS))
def test_the_nafems_plates_vibrate_at_their_frequencies(angular_frequencies, isotropic, name: str) -> None:
    # 10 × 10 × 0.05 m, E 200 GPa, ν 0.3, ρ 8000: NAFEMS, Selected Benchmarks for Natural Frequency Analysis (1987).
    edges, converged, at_sixteen, _ = NAFEMS[name]
    flexural = 200e9 * 0.05**3 / (12 * (1 - 0.3**2))
    n_mode = len(converged) + (0 if edges else 3)
    coarse, fine = (
        elastic(
            angular_frequencies(Mesh(10.0, 10.0, n, n, edges=edges), isotropic(flexural, 0.3), 8000 * 0.05, n_mode),
            edges,
        )
        / (2 * np.pi)
        for n in (8, 16)
    )
    # 16 × 16 is off by the h² of the highest of these modes: measured 0.13 %, 1.1 % and 0.18 %.
    np.testing.assert_allclose(fine, converged, rtol=at_sixteen)
    # Extrapolated, a sixth to a tenth of that is left: measured 1.1e-4, 1.8e-3 and 1.4e-4.
    np.testing.assert_allclose(extrapolated(coarse, fine), converged, rtol=2.5e-3 if name == "FV13" else 3e-4)


@pytest.mark.parametrize(
    ("length_x", "length_y", "cells"), [(0.9, 0.5, (3, 2)), (0.6, 0.6, (3, 3))], ids=["rectangle", "square"]
)
def test_a_simply_supported_plate_has_naviers_frequencies(
    angular_frequencies, isotropic, length_x: float, length_y: float, cells: tuple[int, int]
) -> None:
    flexural, areal_mass, n_mode = 350.0, 21.0, 6
    m, n = np.meshgrid(np.arange(1, 9), np.arange(1, 9))
    # ω = π² (m²/Lx² + n²/Ly²) √(D/ρh); Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells (1959).
    exact = np.pi**2 * ((m / length_x) ** 2 + (n / length_y) ** 2) * np.sqrt(flexural / areal_mass)
    exact = np.sort(exact.flatten())[:n_mode]
    coarse, fine = (
        angular_frequencies(
            Mesh(length_x, length_y, cells[0] * k, cells[1] * k, edges=SUPPORTED),
            isotropic(flexural, 0.3),
            areal_mass,
            n_mode,
        )
        for k in (4, 8)
    )
    # Smooth modes without a corner's singularity: every mode has the order. Measured 1.84 to 1.99.
    order = np.log2((coarse - exact) / (fine - exact))
    assert order.min() > 1.8
    assert order.max() < 2.05
    # Measured at most 0.5 % on the finer mesh and 0.05 % extrapolated.
    np.testing.assert_allclose(fine, exact, rtol=8e-3)
    np.testing.assert_allclose(extrapolated(coarse, fine), exact, rtol=8e-4)


def test_an_orthotropic_plate_has_the_frequencies_of_its_navier_series(angular_frequencies) -> None:
    length_x, length_y, areal_mass, n_mode = 0.9, 0.5, 12.0, 6
    along_x, along_y, cross, twist = 400.0, 90.0, 45.0, 60.0
    rigidity = np.array([[along_x, cross, 0], [cross, along_y, 0], [0, 0, twist]])
    m, n = np.meshgrid(np.arange(1, 9), np.arange(1, 9))
    # ρh ω² = π⁴ (D_x (m/Lx)⁴ + 2 (D_1 + 2 D_k) (m/Lx)² (n/Ly)² + D_y (n/Ly)⁴); Lekhnitskii, Anisotropic Plates (1968).
    p, q = (m / length_x) ** 2, (n / length_y) ** 2
    exact = np.pi**2 * np.sqrt((along_x * p**2 + 2 * (cross + 2 * twist) * p * q + along_y * q**2) / areal_mass)
    exact = np.sort(exact.flatten())[:n_mode]
    coarse, fine = (
        angular_frequencies(Mesh(length_x, length_y, 3 * k, 2 * k, edges=SUPPORTED), rigidity, areal_mass, n_mode)
        for k in (4, 8)
    )
    # Measured: order 1.88 to 1.98, at most 0.8 % on the finer mesh and 0.09 % extrapolated.
    order = np.log2((coarse - exact) / (fine - exact))
    assert order.min() > 1.8
    assert order.max() < 2.05
    np.testing.assert_allclose(fine, exact, rtol=1.2e-2)
    np.testing.assert_allclose(extrapolated(coarse, fine), exact, rtol=1.4e-3)


def levy_frequencies(length_x: float, length_y: float, poisson: float, n_half_wave: int, highest: float) -> list[float]:
    """ω √(ρh/D) of a plate with x0, x1 simply supported, y0 clamped and y1 free, for one number of half waves in x.

    w = Y(y) sin(mπx/Lx), Y of cosh and sinh λ₁y, cos and sin λ₂y, λ₁² = k² + p², λ₂² = k² − p², p = mπ/Lx, k² the
    wanted value (Leissa 1969, section 4.2). At y = 0 Y = Y' = 0; at y = Ly Y'' = ν p² Y and Y''' = (2 − ν) p² Y'.
    """
    p = n_half_wave * np.pi / length_x

    def determinant(square: float) -> float:
        one, two = np.sqrt(square + p**2), np.sqrt(square - p**2)
        ch, sh = np.cosh(one * length_y), np.sinh(one * length_y)
        c, s = np.cos(two * length_y), np.sin(two * length_y)
        free, shear = poisson * p**2, (2 - poisson) * p**2
        # Columns: cosh λ₁y − cos λ₂y and sinh λ₁y / λ₁ − sin λ₂y / λ₂, which meet the clamped edge.
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
    return [
        scipy.optimize.brentq(determinant, grid[i], grid[i + 1])
        for i in range(len(grid) - 1)
        if value[i] * value[i + 1] < 0
    ]


def test_a_plate_with_three_kinds_of_edges_has_levys_frequencies(angular_frequencies, isotropic) -> None:
    length_x, length_y, poisson = 0.9, 0.6, 0.25
    edges = {"x0": "simply_supported", "x1": "simply_supported", "y0": "clamped", "y1": "free"}
    exact = np.sort([w for m in range(1, 6) for w in levy_frequencies(length_x, length_y, poisson, m, 250.0)])[:5]
    coarse, fine = (
        angular_frequencies(Mesh(length_x, length_y, 3 * k, 2 * k, edges=edges), isotropic(1.0, poisson), 1.0, 5)
        for k in (4, 8)
    )
    # Measured at most 0.3 % on the finer mesh and 0.02 % extrapolated.
    np.testing.assert_allclose(fine, exact, rtol=5e-3)
    np.testing.assert_allclose(extrapolated(coarse, fine), exact, rtol=4e-4)


@pytest.mark.parametrize(
    ("edges", "exact"),
    [({}, [22.37329, 61.67282, 120.90339]), ({"x0": "clamped"}, [3.516015, 22.03449, 61.69721])],
    ids=["free", "cantilever"],
)
def test_a_strip_without_poissons_ratio_is_a_beam(
    angular_frequencies, isotropic, edges: dict[str, str], exact: list[float]
) -> None:
    # Euler–Bernoulli, (βl)²; Blevins, Formulas for Natural Frequency and Mode Shape (1979). So narrow, it twists later.
    found = elastic(
        angular_frequencies(Mesh(1.0, 0.02, 16, 1, edges=edges), isotropic(1.0, 0.0), 1.0, 3 + len(exact)), edges
    )
    # Along x the element is the cubic beam element: its ω is (βh)⁴/1440 too high, and the next term is (βh)² of that,
    # 0.5 at the third mode with a small factor. The exact values are printed to 2e-7.
    excess = found[:3] / exact - 1
    np.testing.assert_allclose(excess, np.square(exact) / 16**4 / 1440, rtol=0.1, atol=3e-7)


@pytest.fixture(scope="module")
def conforming() -> Callable[[tuple[int, int], tuple[float, float], float, bool, int], np.ndarray]:
    """ω √(ρh/D) by scikit-fem with the Bogner–Fox–Schmit rectangle: conforming, so it converges from above, as h⁴."""

    def solve(
        cells: tuple[int, int], sides: tuple[float, float], poisson: float, clamped: bool, n_mode: int
    ) -> np.ndarray:
        mesh = skfem.MeshQuad.init_tensor(*(np.linspace(0, side, n + 1) for n, side in zip(cells, sides, strict=True)))
        basis = skfem.Basis(mesh, skfem.ElementQuadBFS(), intorder=8)

        @BilinearForm
        def bending(u, v, _):
            (uxx, uxy), (_, uyy) = u.hess
            (vxx, vxy), (_, vyy) = v.hess
            return uxx * vxx + uyy * vyy + poisson * (uxx * vyy + uyy * vxx) + 2 * (1 - poisson) * uxy * vxy

        @BilinearForm
        def inertia(u, v, _):
            return u * v

        held = basis.get_dofs(lambda x: x[0] < 1e-12).all() if clamped else np.array([], dtype=int)
        free = np.setdiff1d(np.arange(basis.N), held)
        stiffness, mass = (form.assemble(basis)[free][:, free].tocsc() for form in (bending, inertia))
        value = scipy.sparse.linalg.eigsh(
            stiffness, k=n_mode, M=mass, sigma=-1.0, v0=np.linspace(1, 2, len(free)), return_eigenvectors=False
        )
        return np.sqrt(np.clip(np.sort(value), 0, None))

    return solve


@pytest.mark.parametrize("poisson", [0.3, 0.15])
@pytest.mark.parametrize("clamped", [False, True], ids=["free", "cantilever"])
def test_a_rectangle_vibrates_as_an_independent_conforming_element_says(
    angular_frequencies, isotropic, conforming, clamped: bool, poisson: float
) -> None:
    sides, n_mode, edges = (1.0, 0.7), 8, CANTILEVER if clamped else {}
    expected = elastic(conforming((16, 12), sides, poisson, clamped, n_mode), edges)
    coarse, fine = (
        elastic(
            angular_frequencies(Mesh(*sides, n, 3 * n // 4, edges=edges), isotropic(1.0, poisson), 1.0, n_mode),
            edges,
        )
        for n in (8, 16)
    )
    # Measured: at most 0.11 % apart on the free plate and 0.32 % on the cantilever, from this element's h²; its order,
    # from the mode that is furthest apart, 1.80 to 1.89.
    order = np.log2(np.abs(coarse / expected - 1).max() / np.abs(fine / expected - 1).max())
    assert 1.7 < order < 2.05
    np.testing.assert_allclose(fine, expected, rtol=4.5e-3 if clamped else 1.5e-3)
    # Extrapolated, 1.4e-4 and 4.1e-4 are left: this element's h⁴, and the other's own, from clamped corners.
    np.testing.assert_allclose(extrapolated(coarse, fine), expected, rtol=6e-4 if clamped else 2e-4)
