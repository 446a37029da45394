"""An orthotropic plate whose grain is turned, against turned plates, beams and a Ritz solution."""

import math

import numpy as np
import pytest
import scipy.linalg
import torch

from torchplate.effects import GrainAngle, Orthotropy, Plate
from torchplate.model import PlateModel
from torchplate.plate import Mesh

NONE = torch.zeros(0, dtype=torch.float64)
WOOD = {
    "plate.youngs_modulus": 3.2e9, "plate.poisson_ratio": 0.2, "plate.density": 440.0, "plate.thickness": 0.004,
    "wood.young_ratio": 0.08, "wood.shear_factor": 0.8,
}  # fmt: skip
MESH = Mesh(0.4, 0.3, 8, 6)
LINES = torch.linspace(10.0, 300.0, 60, dtype=torch.float64)


def build(angle: float, mesh: Mesh = MESH, known: dict | None = None, **more) -> PlateModel:
    effects = {"plate": Plate(), "wood": Orthotropy(), "grain": GrainAngle()}
    return PlateModel(mesh, effects, WOOD | {"grain.angle": angle} | (known or {}), **more)


def test_a_quarter_turn_exchanges_the_sides() -> None:
    turned = build(math.pi / 2, response=[(0.2, 0.7)], reference=[(0.9, 0.3)])
    straight = build(0.0, Mesh(0.3, 0.4, 6, 8), response=[(0.7, 0.2)], reference=[(0.3, 0.9)])
    torch.testing.assert_close(turned.frf(NONE, LINES), straight.frf(NONE, LINES), rtol=1e-7, atol=0)


def test_the_opposite_angle_is_the_mirrored_plate_and_its_diagonals_differ() -> None:
    corner, mirrored = [(0.0, 0.0)], [(0.0, 1.0)]
    one = build(0.4, response=corner, reference=corner).frf(NONE, LINES)
    other = build(-0.4, response=mirrored, reference=mirrored).frf(NONE, LINES)
    torch.testing.assert_close(one, other, rtol=1e-7, atol=0)
    across = build(0.4, response=mirrored, reference=mirrored).frf(NONE, LINES)
    assert float((one - across).norm() / one.norm()) > 0.1


def test_an_isotropic_plate_has_no_grain() -> None:
    plain = {"wood.young_ratio": 1.0, "wood.shear_factor": 1.0}
    found = build(0.7, known=plain, response=[1], reference=[9]).frf(NONE, LINES)
    expected = build(0.0, known=plain, response=[1], reference=[9]).frf(NONE, LINES)
    torch.testing.assert_close(found, expected, rtol=1e-7, atol=0)


def test_it_may_be_missing_only_where_there_is_a_grain() -> None:
    plain = {"wood.young_ratio": 1.0, "wood.shear_factor": 1.0}
    assert not GrainAngle.may_be_missing(build(0.0, known=plain).plan(NONE).section)
    assert GrainAngle.may_be_missing(build(0.0, known=plain | {"wood.shear_factor": 1.1}).plan(NONE).section)


def test_two_angles_add() -> None:
    effects = {"plate": Plate(), "wood": Orthotropy(), "one": GrainAngle(), "two": GrainAngle()}
    both = PlateModel(MESH, effects, WOOD | {"one.angle": 0.3, "two.angle": 0.2})
    torch.testing.assert_close(both.natural_frequencies(NONE, 9), build(0.5).natural_frequencies(NONE, 9))


@pytest.mark.parametrize("angle", [0.5, -1.1])
def test_bent_to_a_cylinder_along_the_grain_it_has_the_modulus_along_it(angle: float) -> None:
    section = build(angle).plan(NONE).section
    c, s = math.cos(angle), math.sin(angle)
    # w = ξ² / 2, ξ along the grain: curvatures −(c², s², 2cs).
    curvature = -torch.tensor([c * c, s * s, 2 * c * s], dtype=torch.float64)
    energy = curvature @ section.rigidity[0] @ curvature
    along = 3.2e9 / math.sqrt(0.08) * 0.004**3 / 12 / (1 - 0.2**2)
    assert float(energy) == pytest.approx(along, rel=1e-12)


def ritz(sides: tuple[float, float], angle: float, n: int, order: int = 13) -> np.ndarray:
    """Natural frequencies [Hz] over products of Legendre polynomials, strains taken in the grain's own axes."""
    point, weight = np.polynomial.legendre.leggauss(order + 2)
    basis = [np.polynomial.legendre.Legendre.basis(k) for k in range(order)]
    one = {d: np.array([b.deriv(d)(point) if d else b(point) for b in basis]) for d in (0, 1, 2)}

    def field(dx: int, dy: int) -> np.ndarray:
        scale = (2 / sides[0]) ** dx * (2 / sides[1]) ** dy
        return scale * np.einsum("ia,jb->ijab", one[dx], one[dy]).reshape(order**2, -1)

    area = np.outer(weight, weight).ravel() * sides[0] * sides[1] / 4
    xx, yy, xy, w = field(2, 0), field(0, 2), field(1, 1), field(0, 0)
    c, s = np.cos(angle), np.sin(angle)
    along, across = c * c * xx + s * s * yy + 2 * c * s * xy, s * s * xx + c * c * yy - 2 * c * s * xy
    twist = c * s * (yy - xx) + (c * c - s * s) * xy
    mean = 3.2e9 * 0.004**3 / 12
    plane, root, shear = mean / (1 - 0.2**2), math.sqrt(0.08), 0.8 * mean / (2 * 1.2)
    stiffness = plane / root * (along * area) @ along.T + plane * root * (across * area) @ across.T
    cross = 0.2 * plane * (along * area) @ across.T
    stiffness += cross + cross.T + 4 * shear * (twist * area) @ twist.T
    mass = 440.0 * 0.004 * (w * area) @ w.T
    return np.sqrt(scipy.linalg.eigvalsh(stiffness, mass)[3 : 3 + n]) / (2 * np.pi)


@pytest.mark.parametrize("sides", [(0.4, 0.3), (0.35, 0.35)], ids=["rectangle", "square"])
def test_natural_frequencies_are_those_of_a_ritz_solution(sides: tuple[float, float]) -> None:
    expected = ritz(sides, 0.43, 8)
    # Of polynomials two degrees lower the frequencies are the same: they have converged.
    np.testing.assert_allclose(ritz(sides, 0.43, 8, 11), expected, rtol=3e-4)
    coarse, fine = (build(0.43, Mesh(*sides, n, n)).natural_frequencies(NONE, 11)[3:].numpy() for n in (8, 16))
    # The mesh's h² extrapolated; wood is five times as stiff along as across the elements.
    np.testing.assert_allclose((4 * fine - coarse) / 3, expected, rtol=2e-3)
