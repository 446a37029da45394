"""The air on both sides of a plate: its added mass, by equal panels of constant doublets.

The lattice ends a quarter of a panel within each edge (James, Nucl. Eng. Des. 1972; Katz and Plotkin, Low-Speed
Aerodynamics, 2001, section 12.3), and a panel pulls at the control points as four straight vortices do.
"""

from functools import lru_cache
from math import sqrt

import numpy as np

# Panels along the sides of a square.
N_PANEL = 28


@lru_cache(16)
def added_mass(sides: tuple[float, float], n_panel: int = N_PANEL) -> tuple[np.ndarray, np.ndarray]:
    """Relative places, and the mass between them of a fluid of 1 kg/m³ [m³].

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
