"""What a sensor would read: mesh and effects in, natural frequencies and frequency response functions out.

- `parameter_space`: what is searched; the unit cube against SI units.
- `declared`: what its effects declare, sorted into known and searched.
- `receptance`: modes, the sum over them, what is attached at places, and the derivatives of all of it.
- `discretisation`: a finer mesh, the error of the given one taken off, a small basis, and what each leaves.
- `usual_ranges`: sizes and moduli that no plate has, that few have, and the unit that was meant; `would_fit`: which of
  them would bring the plate to a test, and of what material.
- `arguments`: theta, lines and places as callers give them, checked.
- `off_marks`: sensors, hits and supports that are not where the sheet has them, and what moves with a sensor.
- `declared_plate`: effects, numbers and channels of a plate as a torch module; `plate_variants`: the same with others,
  in a basis, or with sensors off their marks; `plate_model`: its modes and FRFs.
"""

from torchplate.effects import Searched
from torchplate.model.arguments import Point
from torchplate.model.discretisation.error_estimate import basis_error, estimated_error
from torchplate.model.discretisation.extrapolation import Extrapolated, extrapolate, on_mesh
from torchplate.model.discretisation.fine_mesh import DENSE, SparseModel
from torchplate.model.discretisation.reduced_basis import reduce, ritz_basis, shares_basis, sharing_modes
from torchplate.model.discretisation.retaken import retaken
from torchplate.model.off_marks import support_marks
from torchplate.model.parameter_space import ParameterSpace
from torchplate.model.plate_model import PlateModel
from torchplate.model.plate_variants import SINGLE_TOLERANCE
from torchplate.model.receptance.attach import attach_
from torchplate.model.receptance.frf import DERIVATIVE, as_kind, laplace_lines, sensor_chain
from torchplate.model.receptance.gradient import modal_impedance
from torchplate.model.receptance.impedance import Impedance, own_damping
from torchplate.model.receptance.modal_receptance import modal_denominator
from torchplate.model.receptance.modal_sum import CLOSE, LINES_AT_ONCE, Disc, Stretch, modal_sum, reciprocal
from torchplate.model.receptance.modes import Modes, natural_frequencies, solve_eigenvalues, solve_modes, whiten
from torchplate.model.receptance.modes_at import ModesAt, modes_at
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
    "support_marks",
    "unusual",
    "whiten",
]
