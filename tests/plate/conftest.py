"""A second plate element, written apart from the first: monomials in metres, Gauss points, loops."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
import torch

from torchplate.plate import Assembly, Geometry, Mesh

POWERS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (3, 1), (1, 3)]


def _row(x: float, y: float, order_x: int = 0, order_y: int = 0) -> np.ndarray:
    """A derivative of the twelve monomials, by numpy's polynomials."""
    row = []
    for p, q in POWERS:
        along_x = np.polynomial.Polynomial.basis(p).deriv(order_x) if order_x else np.polynomial.Polynomial.basis(p)
        along_y = np.polynomial.Polynomial.basis(q).deriv(order_y) if order_y else np.polynomial.Polynomial.basis(q)
        row.append(along_x(x) * along_y(y))
    return np.array(row)


def _inverse(a: float, b: float) -> np.ndarray:
    rows = []
    for x, y in ((0, 0), (a, 0), (a, b), (0, b)):
        rows += [_row(x, y), _row(x, y, 0, 1), -_row(x, y, 1, 0)]
    return np.linalg.inv(np.array(rows))


def gauss_element(rigidity: np.ndarray, areal_mass: float, a: float, b: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness ∫ Bᵀ D B and mass ∫ m Nᵀ N at 4 × 4 Gauss points: exact to degree 7 a side, and x³y squared has 6."""
    point, weight = np.polynomial.legendre.leggauss(4)
    inverse = _inverse(a, b)
    stiffness, mass = np.zeros((12, 12)), np.zeros((12, 12))
    for xi, weight_x in zip(point, weight, strict=True):
        for eta, weight_y in zip(point, weight, strict=True):
            x, y = a * (1 + xi) / 2, b * (1 + eta) / 2
            strain = np.array([-_row(x, y, 2, 0), -_row(x, y, 0, 2), -2 * _row(x, y, 1, 1)]) @ inverse
            shape = _row(x, y) @ inverse
            stiffness += weight_x * weight_y * a * b / 4 * strain.T @ rigidity @ strain
            mass += weight_x * weight_y * a * b / 4 * areal_mass * np.outer(shape, shape)
    return stiffness, mass


def loop_assembly(
    mesh: Mesh, length_x: float, length_y: float, rigidity: np.ndarray, areal_mass: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """K and M of the free dofs, element by element; rotations turned into the mesh's, per relative length."""
    n_x, n_y = mesh.cells
    stiffness, mass = np.zeros((2, mesh.n_dof, mesh.n_dof))
    for row in range(n_y):
        for column in range(n_x):
            number = row * n_x + column
            corner = row * (n_x + 1) + column
            nodes = (corner, corner + 1, corner + n_x + 2, corner + n_x + 1)
            dof = [3 * node + part for node in nodes for part in range(3)]
            part = gauss_element(rigidity[number], areal_mass[number], length_x / n_x, length_y / n_y)
            stiffness[np.ix_(dof, dof)] += part[0]
            mass[np.ix_(dof, dof)] += part[1]
    scale = np.tile([1, 1 / length_y, 1 / length_x], mesh.n_node)
    free = mesh.free_dof.numpy()
    return tuple((scale[:, None] * matrix * scale)[np.ix_(free, free)] for matrix in (stiffness, mass))


@pytest.fixture(scope="session")
def reference() -> SimpleNamespace:
    return SimpleNamespace(element=gauss_element, assembly=loop_assembly)


@pytest.fixture(scope="session")
def angular_frequencies() -> Callable[..., np.ndarray]:
    """Lowest ω of a uniform plate [rad/s], from the assembled matrices and SciPy's sparse Lanczos solver."""

    def solve(mesh: Mesh, rigidity: list[list[float]] | np.ndarray, areal_mass: float, n_mode: int) -> np.ndarray:
        geometry = Geometry(*(torch.tensor(side, dtype=torch.float64) for side in (mesh.length_x, mesh.length_y)))
        assembly = Assembly(mesh)
        stiffness = assembly.stiffness(torch.as_tensor(np.array(rigidity))[None], geometry).numpy()
        mass = assembly.mass(torch.tensor([areal_mass], dtype=torch.float64), geometry).numpy()
        # A shift below zero by the order of the first eigenvalue makes K regular with rigid-body modes too.
        shift = -np.array(rigidity)[0][0] / (areal_mass * mesh.length_x**2 * mesh.length_y**2)
        value = scipy.sparse.linalg.eigsh(
            scipy.sparse.csc_matrix(stiffness),
            k=n_mode,
            M=scipy.sparse.csc_matrix(mass),
            sigma=shift,
            v0=np.linspace(1, 2, len(mass)),
            return_eigenvectors=False,
        )
        return np.sqrt(np.clip(np.sort(value), 0, None))

    return solve


@pytest.fixture(scope="session")
def isotropic() -> Callable[[float, float], np.ndarray]:
    """Rigidity matrix of an isotropic plate from D and Poisson's ratio."""

    def rigidity(flexural: float, poisson: float) -> np.ndarray:
        return flexural * np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]])

    return rigidity
