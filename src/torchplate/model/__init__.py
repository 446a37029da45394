"""What a sensor would read: mesh and effects in, natural frequencies and frequency response functions out.

- `parameter_space`: what is searched; the unit cube against SI units.
- `declared`: what its effects declare, sorted into known and searched.
- `modes`: batched natural frequencies and mode shapes.
- `modes_at`: both at places of the plate, differentiable.
- `modal_receptance`: a plate in modal coordinates, and its receptances by modal sum, exact for local dashpots;
  `complex_modes`: where a part of it has a loss of its own.
- `frf`: what a sensor chain makes of receptances, and the direct solve that referees them; `batched`: below both.
- `modal_solution`: the solve of one batch by the modes of each member.
- `rearranged`: FRFs that an effect only exchanges or turns.
- `gradient`: their derivatives, exact where natural frequencies repeat too; `impedance`, `loewner`: below them.
- `fine_mesh`: one member in sparse matrices, where dense ones would be too large.
- `extrapolation`: the mesh error taken off, from a mesh twice as fine; `retaken`: off another plate of the box.
- `reduced_basis`: a small basis for the whole box of the searched parameters.
- `error_estimate`: how wrong it is, measured or estimated, member by member.
- `modal_sum`: the sum over modes for many lines at once; `attach`: springs, dashpots and masses attached to it.
- `shared_modes`: plates that differ by a factor have the same modes, and need no eigenproblem at all; `attached_sum`:
  their modal sums, values in place and gradients by the adjoint.
- `usual_ranges`: sizes and moduli that no plate has, that few have, and the unit that was meant; `would_fit`: which of
  them would bring the plate to a test, and of what material.
- `arguments`: theta, lines and places as callers give them, checked.
- `off_marks`: sensors and hits that are not where the sheet has them, and what moves with a sensor.
- `declared_plate`: effects, numbers and channels of a plate as a torch module; `plate_variants`: the same with others,
  in a basis, or with sensors off their marks; `plate_model`: its modes and FRFs.
"""

from torchplate.effects import Searched
from torchplate.model.arguments import Point
from torchplate.model.attach import attach_
from torchplate.model.error_estimate import basis_error, estimated_error
from torchplate.model.extrapolation import Extrapolated, extrapolate, on_mesh
from torchplate.model.fine_mesh import DENSE, SparseModel
from torchplate.model.frf import DERIVATIVE, as_kind, laplace_lines, sensor_chain
from torchplate.model.gradient import modal_impedance
from torchplate.model.impedance import Impedance, own_damping
from torchplate.model.modal_receptance import modal_denominator
from torchplate.model.modal_sum import CLOSE, LINES_AT_ONCE, Disc, Stretch, modal_sum, reciprocal
from torchplate.model.modes import Modes, natural_frequencies, solve_eigenvalues, solve_modes, whiten
from torchplate.model.modes_at import ModesAt, modes_at
from torchplate.model.parameter_space import ParameterSpace
from torchplate.model.plate_model import PlateModel
from torchplate.model.plate_variants import SINGLE_TOLERANCE
from torchplate.model.reduced_basis import reduce, ritz_basis, shares_basis, sharing_modes
from torchplate.model.retaken import retaken
from torchplate.model.usual_ranges import Span, coarse, impossible, plate_mass, sizes, unusual
from torchplate.model.would_fit import SectionNumbers, section_numbers

__all__ = [
    "CLOSE",
    "DENSE",
    "DERIVATIVE",
    "LINES_AT_ONCE",
    "SINGLE_TOLERANCE",
    "Disc",
    "Extrapolated",
    "Impedance",
    "Modes",
    "ModesAt",
    "ParameterSpace",
    "PlateModel",
    "Point",
    "Searched",
    "SectionNumbers",
    "Span",
    "SparseModel",
    "Stretch",
    "as_kind",
    "attach_",
    "basis_error",
    "coarse",
    "estimated_error",
    "extrapolate",
    "impossible",
    "laplace_lines",
    "modal_denominator",
    "modal_impedance",
    "modal_sum",
    "modes_at",
    "natural_frequencies",
    "on_mesh",
    "own_damping",
    "plate_mass",
    "reciprocal",
    "reduce",
    "retaken",
    "ritz_basis",
    "section_numbers",
    "sensor_chain",
    "shares_basis",
    "sharing_modes",
    "sizes",
    "solve_eigenvalues",
    "solve_modes",
    "unusual",
    "whiten",
]
