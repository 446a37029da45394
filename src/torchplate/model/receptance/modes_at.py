"""Natural frequencies and mode shapes at places of the plate, differentiable where natural frequencies repeat, too.

The modes Φ are solved for as constants, and a change of K and M is taken to first order:

    dλᵢ = kᵢᵢ − λᵢ mᵢᵢ,    dφᵢ = Σ_j≠i φ_j (k_jᵢ − λᵢ m_jᵢ) / (λᵢ − λ_j) − φᵢ (mᵢᵢ − 1) / 2,    k = ΦᵀKΦ, m = ΦᵀMΦ

(Fox and Kapoor, AIAA J. 6 (1968) 2426, with all modes). Where two natural frequencies agree to `BLUNT`, the quotient
1/g is blunted to g / (g² + w²): a shape within such a pair is any mixture of the two, and has no derivative.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.model.plate_model import PlateModel
from torchplate.model.receptance.gradient import frozen_modes
from torchplate.model.receptance.modes import natural_frequencies
from torchplate.plate import transformed

# Relative distance of eigenvalues below which modes count as a pair: 0.0005 % of frequency.
BLUNT = 1e-5
# Members whose matrices and modes are held at once.
AT_ONCE = 32


class ModesAt(NamedTuple):
    """The lowest modes, rigid-body modes first."""

    frequency: Float[Tensor, "*batch n_mode"]  # [Hz]
    shape: Float[Tensor, "*batch n_mode n_point"]  # [1/√kg]


def modes_at(
    model: PlateModel,
    theta: Float[Tensor, "*batch n_parameter"],
    place: Float[Tensor, "n_point 2"],
    n_mode: int,
) -> ModesAt:
    """The lowest modes of each member at relative places (x, y) of the plate.

    Args:
        model: full or in a reduced basis.
        theta: in SI units.
        place: relative [-].
        n_mode: how many; all the model has if it has fewer.
    """
    rows = model.assembly.rows(model.mesh.deflection_at(place.to(model.known)))
    flat = theta.reshape(theta.shape[:-1].numel(), theta.shape[-1])
    parts = [_modes(model, members, rows, min(n_mode, model.assembly.size)) for members in flat.split(AT_ONCE)]
    frequency, shape = (torch.cat(part) for part in zip(*parts, strict=True))
    return ModesAt(*(part.reshape(*theta.shape[:-1], *part.shape[1:]) for part in (frequency, shape)))


def _modes(model: PlateModel, theta: Tensor, rows: Tensor, n_mode: int) -> tuple[Tensor, Tensor]:
    system = model.system(theta)
    whole = system.undamped()
    value, vector = frozen_modes(*whole)
    low = vector[..., :n_mode]
    eigenvalue = value[..., :n_mode]
    if torch.is_grad_enabled() or transformed():
        stiffness, mass = (vector.mT @ matrix @ low for matrix in whole)
        change = stiffness - mass * eigenvalue[..., None, :]
        gap = eigenvalue[..., None, :] - value[..., :, None]
        width = BLUNT * torch.maximum(eigenvalue[..., None, :].abs(), value[..., :, None].abs())
        own = torch.eye(value.shape[-1], n_mode).to(value)
        # What is left of the products at Φ itself is rounding.
        mixing = (1 - own) * (change - change.detach()) * gap / (gap.square() + width.square()).clamp(min=1e-300)
        mixing = mixing - 0.5 * own * (mass - mass.detach())
        low = low + vector @ mixing
        eigenvalue = eigenvalue + (own * (change - change.detach())).sum(-2)
    frequency = natural_frequencies(eigenvalue)
    shape = (rows @ low[..., : rows.shape[-1], :]).mT
    return frequency.expand(len(theta), n_mode), shape.expand(len(theta), *shape.shape[-2:])
