"""The air of the blind truths."""

import numpy as np
import pytest

from blind.air import added_mass
from torchplate.plate.added_mass import POINT_WEIGHT, lattice

MOTIONS = {
    "translation": lambda x, y: np.ones_like(x + y),
    "twist": lambda x, y: (x - 0.5) * (y - 0.5),
    "saddle": lambda x, y: (x - 0.5) ** 2 - (y - 0.5) ** 2,
    "ring": lambda x, y: (x - 0.5) ** 2 + (y - 0.5) ** 2 - 1 / 6,
    "three half waves": lambda x, y: np.cos(3 * np.pi * x) + 0 * y,
}


def energies(place: np.ndarray, mass: np.ndarray) -> np.ndarray:
    return np.array([motion(*place.T) @ mass @ motion(*place.T) for motion in MOTIONS.values()])


@pytest.mark.check
@pytest.mark.parametrize("sides", [(0.48, 0.48), (0.6, 0.36)])
def test_what_modes_drag_is_right_to_a_thousandth(sides: tuple[float, float]):
    found = energies(*added_mass(sides))
    np.testing.assert_allclose(found, energies(*added_mass(sides, 28)), rtol=5e-4)
    # By doublets on panels that crowd at the edges, of another rule: an independent lattice.
    place, mass = (part.numpy() for part in lattice(*sides, 56))
    means = [
        sum(weight * motion(*place[:, k].T) for k, weight in enumerate(POINT_WEIGHT)) for motion in MOTIONS.values()
    ]
    np.testing.assert_allclose(found, [mean @ mass @ mean for mean in means], rtol=1e-3)
