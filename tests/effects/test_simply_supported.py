"""Effects on geometry and section against Navier's solution of the simply supported orthotropic plate."""

import math

import pytest
import torch

from torchplate.effects import CATALOGUE, Plate
from torchplate.model import PlateModel
from torchplate.plate import Mesh

YOUNG, POISSON, DENSITY, THICKNESS = 70e9, 0.31, 2700.0, 0.003
NONE = torch.zeros(0, dtype=torch.float64)
EDGES = dict.fromkeys(("x0", "x1", "y0", "y1"), "simply_supported")
SHAPES = {"rectangle": (0.52, 0.37), "square": (0.41, 0.41)}


def navier(a, b, ratio=1.0, shear=1.0, poisson=POISSON, density=DENSITY, thickness=THICKNESS) -> list[float]:
    """f = π/2 √((D_x (m/a)⁴ + 2 (D_1 + 2 D_66) (m n/a b)² + D_y (n/b)⁴) / ρh), the lowest three [Hz]."""
    plane = YOUNG * thickness**3 / (12 * (1 - poisson**2))
    along_x, along_y = plane / math.sqrt(ratio), plane * math.sqrt(ratio)
    mixed = poisson * plane + 2 * shear * YOUNG * thickness**3 / (24 * (1 + poisson))
    found = []
    for m in range(1, 9):
        for n in range(1, 9):
            stiff = along_x * (m / a) ** 4 + 2 * mixed * (m * n / (a * b)) ** 2 + along_y * (n / b) ** 4
            found.append(math.pi / 2 * math.sqrt(stiff / (density * thickness)))
    return sorted(found)[:3]


def frequencies(sides, n: int, name: str, value: dict[str, float]) -> torch.Tensor:
    effects = {"plate": Plate()} | ({name: CATALOGUE[name]()} if name else {})
    known = dict(zip(Plate.parameters, (YOUNG, POISSON, DENSITY, THICKNESS), strict=True))
    known = {f"plate.{key}": number for key, number in known.items()}
    known |= {f"{name}.{key}": number for key, number in value.items()}
    return PlateModel(Mesh(*sides, n, n, edges=EDGES), effects, known).natural_frequencies(NONE, 3)


# Name of the effect, its values, and what they make of Navier's plate.
CASES = {
    "none": ("", {}, lambda a, b: navier(a, b)),
    "aspect ratio": ("aspect_ratio", {"ratio": 1.3}, lambda a, b: navier(a / math.sqrt(1.3), b * math.sqrt(1.3))),
    "orthotropy": (
        "orthotropy",
        {"young_ratio": 2.3, "shear_factor": 0.6},
        lambda a, b: navier(a, b, ratio=2.3, shear=0.6),
    ),
    "poisson ratio": ("poisson_ratio", {"value": 0.11}, lambda a, b: navier(a, b, poisson=0.11)),
    "density": ("density", {"value": 3900.0}, lambda a, b: navier(a, b, density=3900.0)),
    "thickness": ("thickness", {"value": 0.0047}, lambda a, b: navier(a, b, thickness=0.0047)),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("case", CASES)
def test_a_simply_supported_plate_has_naviers_frequencies(case, shape):
    name, value, expected = CASES[case]
    coarse, fine = (frequencies(SHAPES[shape], n, name, value) for n in (8, 16))
    # The element's error falls as h²; what is left of it after extrapolation falls as h⁴: (2/8)⁴ / 4 = 1e-3.
    found = fine + (fine - coarse) / 3
    assert found.tolist() == pytest.approx(expected(*SHAPES[shape]), rel=1e-3)


@pytest.mark.parametrize("shape", SHAPES)
def test_an_orthotropic_plate_without_its_own_shear_modulus_is_a_stretched_isotropic_one(shape):
    ratio = 1.7
    orthotropic = frequencies(SHAPES[shape], 6, "orthotropy", {"young_ratio": ratio, "shear_factor": 1.0})
    stretched = frequencies(SHAPES[shape], 6, "aspect_ratio", {"ratio": ratio**-0.25})
    # On the unit square the two are the same matrices.
    assert torch.allclose(orthotropic, stretched, rtol=1e-9)
