"""The air on both sides of a plate: its added mass, by equal panels of constant doublets.

The lattice ends a quarter of a panel within each edge (James, Nucl. Eng. Des. 1972; Katz and Plotkin, Low-Speed
Aerodynamics, 2001, section 12.3), and a panel pulls at the control points as four straight vortices do. What two
lattices say goes with the square of their panels, and is taken to the limit: one alone lacked one per cent of what the
lowest modes drag.
"""

from functools import lru_cache
from math import sqrt

import numpy as np
from scipy.linalg import block_diag

# Panels along the sides of a square, of the coarser lattice.
N_PANEL = 20


@lru_cache(16)
def added_mass(sides: tuple[float, float], n_panel: int = N_PANEL) -> tuple[np.ndarray, np.ndarray]:
    """Relative places, and the mass between them of a fluid of 1 kg/m³ [m³], by Richardson's extrapolation.

    Args:
        sides: of the plate [m].
        n_panel: of the coarser of two lattices, along the sides of a square of that area.
    """
    places, masses = zip(*(lattice(sides, n) for n in (n_panel, 2 * n_panel)), strict=True)
    return np.concatenate(places), block_diag(-masses[0] / 3, 4 * masses[1] / 3)


def lattice(sides: tuple[float, float], n_panel: int) -> tuple[np.ndarray, np.ndarray]:
    """Relative places, and the mass between them, of one lattice [m³].

    Args:
        sides: of the plate [m].
        n_panel: along the sides of a square of that area.
    """
    slender = sqrt(sides[0] / sides[1])
    count = [max(8, round(n_panel * part)) for part in (slender, 1 / slender)]
    size = [side / (n + 0.5) for side, n in zip(sides, count, strict=True)]
    middle = [h * (np.arange(n) + 0.75) for h, n in zip(size, count, strict=True)]
    at_x, at_y = (axis.ravel() for axis in np.meshgrid(*middle, indexing="ij"))
    x, y = at_x[:, None] - at_x, at_y[:, None] - at_y
    a, b = size[0] / 2, size[1] / 2
    # Of the vortex along each side: 1/(4π d) times the sum of the cosines of its ends, seen from the point.
    down = np.zeros_like(x)
    for sign in (1.0, -1.0):
        for d, along, half in ((a - sign * x, y, b), (b - sign * y, x, a)):
            ends = (half - along) / np.hypot(d, half - along) + (half + along) / np.hypot(d, half + along)
            down += ends / (4 * np.pi * d)
    return np.stack([at_x / sides[0], at_y / sides[1]], axis=1), size[0] * size[1] * np.linalg.inv(down)
