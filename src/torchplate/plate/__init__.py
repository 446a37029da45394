"""Geometry in, matrices out: the Kirchhoff–Love plate as batched tensors.

- `mesh`: nodes, elements and dofs of a rectangular grid; shape functions anywhere on the plate.
- `prolongation`: motions of a mesh as those of one twice as fine.
- `element`: the 12-dof rectangle of the seed paper (Eq. 6–16).
- `section`: what each element is made of (Section), how long the plate is (Geometry), what is added at a place
  (Local), damping in proportion to the whole model (Proportional), and all of these for one batch (Plan).
- `correction`: what an assembly has beside its mesh (Correction, Unevenness).
- `added_mass`: of a fluid around the plate, which couples the motion of all its parts (AddedMass).
- `laminate`: elements that the edges of a patch cut, each as a whole; `patch`: how the bending goes over them, and over
  those that the edges of a hole cut.
- `rows`: deflections at places as rows over the dofs, of which few see anything.
- `coefficients`: what the matrices of every element are times.
- `assemble`: Section and Local to mass, stiffness and damping, in every dof or in a reduced basis.
- `material`: what plates are usually made of; `wavelength`: bending waves, and the elements they need.
- `power_law`: a loss factor that goes with a power of the frequency, and its modulus.
- `transforms`: what of all this may be remembered, and what belongs to a derivative.
"""

from torchplate.plate.added_mass import N_PANEL, AddedMass, dragged, influence, lattice
from torchplate.plate.assemble import Assembly
from torchplate.plate.coefficients import (
    mass_coefficient,
    stiffness_coefficient,
    uneven_coefficient,
    uneven_mass_coefficient,
)
from torchplate.plate.correction import Correction, Unevenness
from torchplate.plate.laminate import laminate
from torchplate.plate.material import MATERIALS, Material, find_material
from torchplate.plate.mesh import EDGES, Mesh
from torchplate.plate.patch import patched, uneven_bending, with_hole
from torchplate.plate.power_law import LOWEST_FREQUENCY, REFERENCE_FREQUENCY
from torchplate.plate.prolongation import prolongation
from torchplate.plate.section import (
    STIFFEST,
    Geometry,
    Local,
    Plan,
    Proportional,
    Section,
    Sprung,
    System,
    common_shape,
    concatenate,
)
from torchplate.plate.transforms import REMEMBERED, is_vmapped, transformed
from torchplate.plate.wavelength import (
    ELEMENTS_PER_WAVELENGTH,
    THIN,
    bending_wavelength,
    elements_for,
    frequency_of_wavelength,
    thickness_of,
)

__all__ = [
    "EDGES",
    "ELEMENTS_PER_WAVELENGTH",
    "LOWEST_FREQUENCY",
    "MATERIALS",
    "N_PANEL",
    "REFERENCE_FREQUENCY",
    "REMEMBERED",
    "STIFFEST",
    "THIN",
    "AddedMass",
    "Assembly",
    "Correction",
    "Geometry",
    "Local",
    "Material",
    "Mesh",
    "Plan",
    "Proportional",
    "Section",
    "Sprung",
    "System",
    "Unevenness",
    "bending_wavelength",
    "common_shape",
    "concatenate",
    "dragged",
    "elements_for",
    "find_material",
    "frequency_of_wavelength",
    "influence",
    "is_vmapped",
    "laminate",
    "lattice",
    "mass_coefficient",
    "patched",
    "prolongation",
    "stiffness_coefficient",
    "thickness_of",
    "transformed",
    "uneven_bending",
    "uneven_coefficient",
    "uneven_mass_coefficient",
    "with_hole",
]
