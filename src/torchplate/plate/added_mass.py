"""The mass of the fluid that a plate drags along: doublets on the plate, incompressible, around all four edges.

A jump μ of the velocity potential across a thin plate makes the normal velocity w = −(1/4π) ⨍ μ / r³ dA on it, and
the fluid of density ρ has the kinetic energy ½ ρ ∫ μ w dA. With a constant μ on each panel and w at its control point,
G μ = w, the energy is ½ ρ wᵀ S G⁻¹ w, S the areas of the panels. Edges of panels and control points interlace as zeros
of Chebyshev polynomials do, which is exact for a strip of infinite length and finds the pull at the edges unasked
(Lan, J. Aircraft 11 (1974) 518). The integral over a rectangle is in closed form at its corners.

The velocity that drives the flow is that at the control points, the one that its pressure works on is the mean over
each panel. A deflection counts with the mean of both: the matrix is then symmetric, and the errors of either take each
other off.

Source: Katz and Plotkin, Low-Speed Aerodynamics (2001), section 10.4, for constant doublets on flat panels.
"""

import functools
import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.plate.mesh import Mesh
from torchplate.plate.transforms import REMEMBERED

# Panels along the sides of a square; along the short side of a strip at least so many.
N_PANEL, FEWEST = 20, 8
# Of the control point of a panel and of its four Gauss points.
POINT_WEIGHT = (0.5, 0.125, 0.125, 0.125, 0.125)


class AddedMass(NamedTuple):
    """A mass c Rᵀ C R that moves with the plate as a whole: no place has it for itself.

    Attributes:
        coefficient: c.
        rows: R, deflection at some places over the dofs of the mesh; the same tensor whenever it is meant.
        coupling: C, of the motion of one place for that of another, symmetric and positive definite; likewise.
    """

    coefficient: Float[Tensor, "*batch"]
    rows: Float[Tensor, "n_place n_dof"]
    coupling: Float[Tensor, "n_place n_place"]


def influence(
    edge_x: Float[Tensor, " n_edge_x"],
    control_x: Float[Tensor, " n_x"],
    edge_y: Float[Tensor, " n_edge_y"],
    control_y: Float[Tensor, " n_y"],
) -> Float[Tensor, "n_panel n_panel"]:
    """Normal velocity [1/m] at each control point from a unit doublet on each panel; panels count along x first.

    Args:
        edge_x: ends of the panels along x [m].
        control_x: control points [m], one between two ends each.
        edge_y: likewise along y.
        control_y: likewise.
    """
    x, y = edge_x - control_x[:, None], edge_y - control_y[:, None]
    x, y = x[None, :, None, :], y[:, None, :, None]
    corner = (x**2 + y**2).sqrt() / (x * y)
    whole = corner.diff(dim=-1).diff(dim=-2) / (4 * math.pi)
    return whole.reshape(len(control_x) * len(control_y), -1)


def interlaced(length: float, n_panel: int) -> tuple[Float[Tensor, " n_edge"], Float[Tensor, " n_panel"]]:
    """Ends of panels and their control points along a side from 0 to its length [m]."""
    order = torch.arange(n_panel + 1, dtype=torch.float64)
    edge = 0.5 - 0.5 * torch.cos((order + 0.5) * math.pi / (n_panel + 1))
    return length * edge, length * (0.5 - 0.5 * torch.cos(order[1:] * math.pi / (n_panel + 1)))


def panels(length_x: float, length_y: float, n_panel: int) -> tuple[int, int]:
    """Panels along x and y of a rectangle, as many in all as of a square with `n_panel` along each side."""
    slender = math.sqrt(length_x / length_y)
    return max(FEWEST, round(n_panel * slender)), max(FEWEST, round(n_panel / slender))


def lattice(
    length_x: float, length_y: float, n_panel: int = N_PANEL
) -> tuple[Float[Tensor, "n_place 5 2"], Float[Tensor, "n_place n_place"]]:
    """Relative places of each panel's points and S G⁻¹, the added mass between panels for a fluid of 1 kg/m³ [m³].

    Args:
        length_x: side along x [m].
        length_y: side along y [m].
        n_panel: panels along the sides of a square of the same area.
    """
    sides = zip((length_x, length_y), panels(length_x, length_y, n_panel), strict=True)
    (edge_x, x), (edge_y, y) = (interlaced(length, n) for length, n in sides)
    area = torch.outer(edge_y.diff(), edge_x.diff()).flatten()
    whole = area[:, None] * torch.linalg.inv(influence(edge_x, x, edge_y, y))
    along_x, along_y = (_points(edge, control) for edge, control in ((edge_x, x), (edge_y, y)))
    points = [(0, 0), (1, 1), (1, 2), (2, 1), (2, 2)]
    place = torch.stack(
        [torch.cartesian_prod(along_y[k] / length_y, along_x[m] / length_x).flip(-1) for k, m in points], dim=1
    )
    # Of points and panels only nearly symmetric: by 1e-3 of itself.
    return place, 0.5 * (whole + whole.mT)


def _points(edge: Float[Tensor, " n_edge"], control: Float[Tensor, " n"]) -> tuple[Tensor, Tensor, Tensor]:
    """Of each panel along a side: the control point and two Gauss points."""
    middle, away = 0.5 * (edge[1:] + edge[:-1]), edge.diff() / math.sqrt(12)
    return control, middle - away, middle + away


def dragged(mesh: Mesh) -> tuple[Float[Tensor, "n_place n_dof"], Float[Tensor, "n_place n_place"]]:
    """R and C of the fluid around a plate with the mesh's sides, for 1 kg/m³ [m³]; made once for each mesh."""
    return _dragged(mesh.length_x, mesh.length_y, mesh.cells)


@functools.lru_cache(REMEMBERED)
def _dragged(length_x: float, length_y: float, cells: tuple[int, int]) -> tuple[Tensor, Tensor]:
    place, coupling = lattice(length_x, length_y)
    mesh = Mesh(length_x, length_y, *cells)
    parts = zip(POINT_WEIGHT, place.unbind(1), strict=True)
    rows = functools.reduce(torch.add, (weight * mesh.deflection_at(points) for weight, points in parts))
    return rows, coupling
