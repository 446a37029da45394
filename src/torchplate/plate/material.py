"""Materials of plates: what they usually are made of, and how far that scatters."""

from dataclasses import dataclass
from typing import Final

from torchplate.nearest import did_you_mean


@dataclass(frozen=True)
class Material:
    """Usual values of a material; the ends are those of ordinary grades, rounded outward, not of every one.

    Args:
        name: As it is asked for.
        youngs_modulus: Low, usual, high [Pa]; of an orthotropic material √(E_x E_y).
        poisson_ratio: Usual value [-]; of an orthotropic material √(ν_x ν_y).
        poisson_std: How far it scatters [-].
        density: Low, usual, high [kg/m³].
        loss_factor: Low and high loss factor of a mounted plate [-], the material's own and that of its suspension.
        source: Where the values are from.
        young_ratio: Usual E along the stiff direction over E across it [-]; 1 for an isotropic material.
    """

    name: str
    youngs_modulus: tuple[float, float, float]
    poisson_ratio: float
    poisson_std: float
    density: tuple[float, float, float]
    loss_factor: tuple[float, float]
    source: str
    young_ratio: float = 1.0


_ASHBY = "after Ashby, Materials Selection in Mechanical Design (4th ed., 2011), appendix A"
_WOOD = "after Forest Products Laboratory, Wood Handbook (FPL-GTR-190, 2010), tables 5-1 and 5-3a"
_METAL_LOSS = (1e-4, 5e-2)
_POLYMER_LOSS = (5e-3, 0.3)
_WOOD_LOSS = (2e-3, 5e-2)

MATERIALS: Final = {
    entry.name: entry
    for entry in (
        Material("steel", (185e9, 205e9, 215e9), 0.29, 0.01, (7750.0, 7850.0, 7900.0), _METAL_LOSS, _ASHBY),
        Material("stainless_steel", (185e9, 195e9, 205e9), 0.28, 0.015, (7600.0, 7900.0, 8100.0), _METAL_LOSS, _ASHBY),
        Material("aluminium", (67e9, 70e9, 75e9), 0.33, 0.01, (2600.0, 2700.0, 2850.0), _METAL_LOSS, _ASHBY),
        Material("brass", (90e9, 105e9, 120e9), 0.34, 0.015, (8300.0, 8500.0, 8700.0), _METAL_LOSS, _ASHBY),
        Material("copper", (112e9, 122e9, 148e9), 0.345, 0.01, (8930.0, 8940.0, 8950.0), _METAL_LOSS, _ASHBY),
        Material("titanium", (90e9, 112e9, 120e9), 0.36, 0.02, (4400.0, 4500.0, 4800.0), _METAL_LOSS, _ASHBY),
        Material("magnesium", (42e9, 45e9, 47e9), 0.3, 0.02, (1740.0, 1800.0, 1950.0), _METAL_LOSS, _ASHBY),
        Material("glass", (68e9, 70e9, 72e9), 0.225, 0.015, (2440.0, 2480.0, 2500.0), _METAL_LOSS, _ASHBY),
        Material("acrylic", (2.2e9, 3.2e9, 3.8e9), 0.39, 0.02, (1160.0, 1190.0, 1220.0), _POLYMER_LOSS, _ASHBY),
        Material("polycarbonate", (2.0e9, 2.3e9, 2.5e9), 0.40, 0.02, (1140.0, 1200.0, 1210.0), _POLYMER_LOSS, _ASHBY),
        Material("spruce", (1.2e9, 2.8e9, 5.5e9), 0.1, 0.04, (350.0, 430.0, 500.0), _WOOD_LOSS, _WOOD, 14.0),
        Material("wood", (0.8e9, 3.0e9, 8.0e9), 0.1, 0.05, (300.0, 500.0, 800.0), _WOOD_LOSS, _WOOD, 12.0),
        Material("plywood", (3.0e9, 5.5e9, 9.0e9), 0.1, 0.05, (450.0, 600.0, 750.0), _WOOD_LOSS, _WOOD, 2.5),
    )
}
ALIASES: Final = {"aluminum": "aluminium", "pmma": "acrylic", "plexiglass": "acrylic", "stainless": "stainless_steel"}


def find_material(name: str) -> Material:
    """The material of that name, however it is spelt.

    Raises:
        KeyError: None is called so; the message lists them.
    """
    key = name.strip().lower().replace(" ", "_").replace("-", "_")
    key = ALIASES.get(key, key)
    if key not in MATERIALS:
        guess = did_you_mean(key, MATERIALS)
        raise KeyError(f"No material named '{name}'.{guess} There are: {', '.join(MATERIALS)}; or leave it out.")
    return MATERIALS[key]
