"""Plates with holes, missing corners and ribs against conforming elements of an independent solver.

Holes: the Bogner–Fox–Schmit rectangle; ribs: the Argyris triangle, the rib along its edges. Both from scikit-fem, on
meshes of their own, each twice as fine as the last. At a corner that points into the plate, and at an end of a rib,
moments are singular, and every element converges more slowly than h².
"""

from typing import NamedTuple

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
import skfem
import torch
from scipy.spatial import Delaunay
from skfem.assembly import BilinearForm

from torchplate.effects import Plate, Rib
from torchplate.model import PlateModel, SparseModel
from torchplate.plate import Mesh

SIDES, CELLS = (0.5, 0.4), 10
METAL = {"youngs_modulus": 70e9, "poisson_ratio": 0.33, "density": 2700.0, "thickness": 0.003}
RIGIDITY = 70e9 * 0.003**3 / 12 / (1 - 0.33**2)
AREAL_MASS = 2700.0 * 0.003
N_MODE, N_RIGID = 12, 3


class Shape(NamedTuple):
    cut: tuple[tuple[float, float, float, float], ...] = ()
    # x0, y0, x1, y1, EI, GJ, mass per length.
    rib: tuple[float, ...] = ()


SHAPES = {
    "square hole": Shape(((0.4, 0.4, 0.6, 0.6),)),
    "hole off the centre": Shape(((0.2, 0.5, 0.4, 0.8),)),
    "L": Shape(((0.5, 0.5, 1.0, 1.0),)),
    "corner cut off": Shape(((0.8, 0.0, 1.0, 0.3),)),
    "slot": Shape(((0.3, 0.5, 0.8, 0.6),)),
    "two holes": Shape(((0.1, 0.2, 0.3, 0.4), (0.6, 0.5, 0.8, 0.8))),
    "rib along an edge": Shape(rib=(0.0, 0.0, 1.0, 0.0, 30.0, 12.0, 0.2)),
    "rib at an angle": Shape(rib=(0.13, 0.21, 0.87, 0.72, 20.0, 8.0, 0.2)),
}


@BilinearForm
def bending(u, v, _):
    (uxx, uxy), (_, uyy) = u.hess
    (vxx, vxy), (_, vyy) = v.hess
    return RIGIDITY * (uxx * vxx + uyy * vyy + 0.33 * (uxx * vyy + uyy * vxx) + 2 * 0.67 * uxy * vxy)


@BilinearForm
def inertia(u, v, _):
    return AREAL_MASS * u * v


def lowest(stiffness: scipy.sparse.csr_matrix, mass: scipy.sparse.csr_matrix) -> np.ndarray:
    """Natural frequencies that bend the plate [Hz]; dofs of different units are scaled alike first."""
    used = np.nonzero(mass.diagonal())[0]
    scale = scipy.sparse.diags(1 / np.sqrt(mass.diagonal()[used]))
    stiffness, mass = ((scale @ part[used][:, used] @ scale).tocsc() for part in (stiffness, mass))
    value = scipy.sparse.linalg.eigsh(
        stiffness, k=N_MODE, M=mass, sigma=-1e3, v0=np.linspace(1, 2, len(used)), return_eigenvectors=False
    )
    return np.sqrt(np.sort(value)[N_RIGID:]) / (2 * np.pi)


def with_holes(shape: Shape, refine: int) -> np.ndarray:
    n = CELLS * refine
    mesh = skfem.MeshQuad.init_tensor(*(np.linspace(0, side, n + 1) for side in SIDES))
    x, y = mesh.p[:, mesh.t].mean(1) / np.array(SIDES)[:, None]
    gone = [(x > x0) & (x < x1) & (y > y0) & (y < y1) for x0, y0, x1, y1 in shape.cut]
    basis = skfem.Basis(mesh.remove_elements(np.nonzero(np.any(gone, axis=0))[0]), skfem.ElementQuadBFS(), intorder=8)
    return lowest(bending.assemble(basis), inertia.assemble(basis))


def with_rib(shape: Shape, refine: int) -> np.ndarray:
    x0, y0, x1, y1, stiff, torsional, heavy = shape.rib
    first, last = np.array([x0, y0]) * SIDES, np.array([x1, y1]) * SIDES
    length = np.linalg.norm(last - first)
    (c, s), n = (last - first) / length, 6
    across = np.array([-s, c])
    step = length / n
    grid = np.array([(x, y) for x in np.linspace(0, SIDES[0], 8) for y in np.linspace(0, SIDES[1], 7)])
    along = np.clip((grid - first) @ (c, s), 0, length)
    far = np.linalg.norm(grid - first - along[:, None] * (c, s), axis=1) > 0.55 * step
    point = np.vstack([first + np.linspace(0, 1, n + 1)[:, None] * (last - first), grid[far]])
    mesh = skfem.MeshTri(point.T, Delaunay(point).simplices.T)
    for _ in range(refine.bit_length() - 1):
        mesh = mesh.refined()

    def on(end: np.ndarray) -> np.ndarray:
        there = (end - first) @ (c, s)
        return (abs((end - first) @ across) < 1e-9) & (there > -1e-9) & (there < length + 1e-9)

    ends = [mesh.p[:, node].T for node in mesh.facets]
    facets = np.nonzero(on(ends[0]) & on(ends[1]))[0]
    assert np.linalg.norm(ends[0][facets] - ends[1][facets], axis=1).sum() == pytest.approx(length)
    basis = skfem.Basis(mesh, skfem.ElementTriArgyris(), intorder=8)
    on_edge = np.isin(facets, mesh.boundary_facets()).all()
    kind = skfem.FacetBasis if on_edge else skfem.InteriorFacetBasis
    line = kind(mesh, skfem.ElementTriArgyris(), facets=facets, intorder=8)

    def strains(u):
        (xx, xy), (_, yy) = u.hess
        return c * c * xx + s * s * yy + 2 * c * s * xy, c * s * (yy - xx) + (c * c - s * s) * xy

    @BilinearForm
    def stiffened(u, v, _):
        pairs = zip((stiff, torsional), strains(u), strains(v), strict=True)
        return sum(k * one * other for k, one, other in pairs)

    @BilinearForm
    def loaded(u, v, _):
        return heavy * u * v

    return lowest(bending.assemble(basis) + stiffened.assemble(line), inertia.assemble(basis) + loaded.assemble(line))


def converged(shape: Shape, finest: int) -> np.ndarray:
    """From three meshes, each twice as fine: what is left falls by the same factor again, from mesh to mesh."""
    solve = with_rib if shape.rib else with_holes
    coarse, middle, fine = (solve(shape, finest // part) for part in (4, 2, 1))
    factor = np.clip((fine - middle) / (middle - coarse), 0.0, 0.75)
    return fine + (fine - middle) * factor / (1 - factor)


def ours(shape: Shape, refine: int) -> np.ndarray:
    effects, known = {"plate": Plate()}, {f"plate.{name}": value for name, value in METAL.items()}
    if shape.rib:
        effects["rib"] = Rib()
        known |= {f"rib.{name}": value for name, value in zip(Rib.parameters, shape.rib, strict=True)}
    model = PlateModel(Mesh(*SIDES, CELLS, CELLS, refine=refine, cut=shape.cut), effects, known)
    found = SparseModel(model, torch.zeros(0, dtype=torch.float64)).modes(N_MODE).frequency[:N_MODE]
    assert float(found[N_RIGID - 1]) < 0.01
    return found[N_RIGID:].numpy()


def extrapolated(shape: Shape, refine: int) -> np.ndarray:
    coarse, fine = ours(shape, refine // 2), ours(shape, refine)
    return (4 * fine - coarse) / 3


@pytest.mark.check
@pytest.mark.parametrize("name", list(SHAPES))
def test_every_shape_vibrates_as_conforming_elements_say(name: str) -> None:
    off = extrapolated(SHAPES[name], 8) / converged(SHAPES[name], 8) - 1
    print(f"{name}: at most {100 * np.abs(off).max():.3f} %")
    assert np.abs(off).max() < 2e-3


@pytest.mark.parametrize("name", ["corner cut off", pytest.param("rib at an angle", marks=pytest.mark.check)])
def test_a_shape_on_coarse_meshes_vibrates_as_conforming_elements_say(name: str) -> None:
    off = extrapolated(SHAPES[name], 2) / converged(SHAPES[name], 4) - 1
    # Twice the 0.2 % of finer meshes.
    assert np.abs(off).max() < 4e-3
