"""Geometry in, matrices out: the Kirchhoff–Love plate as batched tensors.

- `mesh`: nodes, elements and dofs of a rectangular grid; shape functions anywhere on the plate.
- `element`: the 12-dof rectangle of the seed paper (Eq. 6–16).
- `section`: what each element is made of (Section), how long the plate is (Geometry), what is added at a place
  (Local), damping in proportion to the whole model (Proportional), and all of these for one batch (Plan).
- `laminate`: elements that the edges of a patch cut.
- `assemble`: Section and Local to mass, stiffness and damping, in every dof or in a reduced basis.
- `transforms`: what of all this may be remembered, and what belongs to a derivative.
"""

from torchplate.plate.assemble import Assembly, Correction
from torchplate.plate.mesh import Mesh
from torchplate.plate.section import Geometry, Local, Plan, Proportional, Section, System

__all__ = ["Assembly", "Correction", "Geometry", "Local", "Mesh", "Plan", "Proportional", "Section", "System"]
