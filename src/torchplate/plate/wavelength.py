"""Bending waves of a thin plate: how long they are, how many elements they need, how far thin-plate theory holds."""

import math
from typing import Final

ELEMENTS_PER_WAVELENGTH: Final = 8.0
"""Elements along a bending wave [-]. The 12-dof rectangle's natural frequencies are off in proportion to (h/λ)²: by
0.7 % at the 6.2 elements per wave of the seed's plate at 290 Hz, so by 0.4 % at 8, at the top of the band."""
THIN: Final = 30.0
"""Wavelength over thickness down to which Kirchhoff's plate holds [-]: shear and rotary inertia lower a natural
frequency by about (π h/λ)² (1 + 2 (1 + ν) / (κ (1 − ν²)) ) / 6, 0.8 % at 30 for a metal. Source: Mindlin, Influence of
rotatory inertia and shear on flexural motions of isotropic, elastic plates, J. Appl. Mech. 18 (1951)."""


def bending_wavelength(
    frequency: float, youngs_modulus: float, poisson_ratio: float, density: float, thickness: float
) -> float:
    """Length of a bending wave: λ = 2π (D / (ρ h ω²))^(1/4) [m], D = E h³ / (12 (1 − ν²)).

    Args:
        frequency: [Hz], > 0.
        youngs_modulus: Along the wave [Pa].
        poisson_ratio: [-].
        density: [kg/m³].
        thickness: h [m].
    """
    squared = youngs_modulus * thickness**2 / (12 * (1 - poisson_ratio**2) * density)
    return 2 * math.pi * math.sqrt(math.sqrt(squared) / (2 * math.pi * frequency))


def frequency_of_wavelength(
    wavelength: float, youngs_modulus: float, poisson_ratio: float, density: float, thickness: float
) -> float:
    """The frequency [Hz] at which a bending wave is this long [m]: the inverse of `bending_wavelength`."""
    return (bending_wavelength(1.0, youngs_modulus, poisson_ratio, density, thickness) / wavelength) ** 2


def elements_for(side: float, wavelength: float) -> int:
    """Elements along a side, so that a wave has `ELEMENTS_PER_WAVELENGTH` of them; at least 4, and even."""
    return max(4, 2 * math.ceil(side * ELEMENTS_PER_WAVELENGTH / wavelength / 2))


def thickness_of(
    area: float, mode_density: float, youngs_modulus: float, poisson_ratio: float, density: float
) -> float:
    """Thickness [m] of a plate with so many modes per hertz: n = (A/2) √(ρ h/D), whatever its edges.

    Source: Cremer, Heckl, Petersson, Structure-Borne Sound (3rd ed., 2005), section 5.4.

    Args:
        area: [m²].
        mode_density: Modes per hertz [1/Hz].
        youngs_modulus: [Pa].
        poisson_ratio: [-].
        density: [kg/m³].
    """
    return area * math.sqrt(12 * (1 - poisson_ratio**2) * density / youngs_modulus) / (2 * mode_density)
