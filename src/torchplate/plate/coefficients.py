"""What the matrices of every element are times: the section on the unit square, and the sides as powers."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.plate import element
from torchplate.plate.section import Geometry, Section

# Of the six entries of a rigidity, D₁₁, D₂₂, D₁₂ and D₃₃: the others are zero where the grain is not turned.
STRAIGHT = [0, 1, 3, 2]


def stiffness_coefficient(
    rigidity: Float[Tensor, "*#batch n_element 3 3"], geometry: Geometry
) -> Float[Tensor, "*batch n_element 6"]:
    """What each stiffness pattern is times: the rigidity's six entries, on the unit square."""
    return rigidity[..., element.RIGIDITY_ROW, element.RIGIDITY_COLUMN] * _weight(geometry)[..., None, :]


def _weight(geometry: Geometry) -> Float[Tensor, "*batch 6"]:
    """What the rigidity's six entries are times on the unit square."""
    x, y = geometry.length_x, geometry.length_y
    area = x * y
    turn = torch.stack([x.square(), y.square(), area], dim=-1).reciprocal()
    return turn[..., element.RIGIDITY_ROW] * turn[..., element.RIGIDITY_COLUMN] * area[..., None]


def mass_coefficient(
    areal_mass: Float[Tensor, "*#batch n_element"], geometry: Geometry
) -> Float[Tensor, "*batch n_element 1"]:
    """What the mass pattern is times: the mass of the elements over that of the unit square's."""
    return (areal_mass * (geometry.length_x * geometry.length_y)[..., None])[..., None]


def uneven_coefficient(
    section: Section, uneven: Float[Tensor, "*#batch n_element 4 n_power"] | None, geometry: Geometry
) -> Float[Tensor, "*batch n_element n_pattern"] | None:
    """What each pattern of elements that are not the same all over is times; see `Section.uneven`."""
    if uneven is None:
        return None
    if section.grain_angle is None:
        coefficient = section.sound_entries * _weight(geometry)[..., None, STRAIGHT]
        return (coefficient[..., None] * uneven).flatten(-2)
    coefficient = stiffness_coefficient(section.sound_parts, geometry)
    return torch.einsum("k...ep,...ekm->...epm", coefficient, uneven).flatten(-2)


def uneven_mass_coefficient(section: Section, geometry: Geometry) -> Float[Tensor, "*batch n_element 49"] | None:
    """The same of the mass."""
    if section.uneven_density is None:
        return None
    area = (geometry.length_x * geometry.length_y)[..., None]
    return section.uneven_density * (section.thickness * area)[..., None]
