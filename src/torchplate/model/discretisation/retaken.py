"""The mesh error of another plate of the box than the one it was taken off of.

What a stiffness lacks on a mesh is found for one plate, and taken for the same part of every other's: see
`extrapolation`. So it is where all are multiples of that one, as with Young's modulus, thickness and density. With
Poisson's ratio, a grain, the ratio of the sides or a patch the modes change, and what they lack with them.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.model.discretisation.extrapolation import N_MODE, extrapolate
from torchplate.model.discretisation.fine_mesh import SparseModel
from torchplate.model.discretisation.reduced_basis import two_level_design
from torchplate.model.plate_model import PlateModel
from torchplate.model.receptance.shared_modes import multiples

# Below this part of the highest, an eigenvalue is that of a plate on its supports, which no mesh has wrong.
RIGID = 1e-3


@torch.no_grad()
def retaken(
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    frequency: float | None = None,
    n_mode: int = 0,
) -> tuple[PlateModel, float] | None:
    """The model with its mesh error taken off at theta, and how far it was off there before.

    Args:
        model: in all dofs, its mesh error taken off at any plate of the box.
        theta: the plate it is to be taken off at, in SI units.
        frequency: up to where it is to be right [Hz]; as `extrapolate` takes it.
        n_mode: natural frequencies that are to be right.

    Returns:
        The model, and the greatest relative change of a natural frequency in the band, or of those that are to be
        right [-]; None where no mesh error was taken off, or it is that of every plate of the box.
    """
    if model.assembly.correction is None or not model.names or _all_alike(model, theta):
        return None
    again = extrapolate(model, frequency, theta).model
    count = max(n_mode, 0 if frequency else N_MODE)
    before, after = (
        SparseModel(one, theta).modes(count, frequency or 0.0, bare=True).eigenvalue for one in (model, again)
    )
    wanted = max(n_mode, int((after <= (2 * torch.pi * frequency) ** 2).sum())) if frequency else count
    bends = (after > RIGID * after[-1])[:wanted]
    off = (before[:wanted] / after[:wanted]).clamp(min=0.0).sqrt() - 1
    return again, float(off[bends].abs().amax()) if bool(bends.any()) else 0.0


def _all_alike(model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> bool:
    """Whether the bare plates of the box are multiples of one another."""
    n = len(model.names)
    position = torch.cat([torch.full((1, n), 0.5, dtype=torch.float64), two_level_design(n)]).to(model.known)
    members = torch.cat([model.space.to_si(position), theta[None]])
    return multiples(model.plan(members[0]), model.plan(members)) is not None
