"""Receptances of members by the modes of each: the solve that `PlateModel.frf` hands to its sensor chain."""

from collections.abc import Callable

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.model.receptance.batched import joined
from torchplate.model.receptance.gradient import differentiable_receptance, frozen_modes, modal_impedance
from torchplate.model.receptance.impedance import scattered
from torchplate.plate import System

# From s, response rows and reference rows to receptances.
Solution = Callable[
    [
        Complex[Tensor, "*batch n_frequency"],
        Float[Tensor, "*batch n_response n"],
        Float[Tensor, "*batch n_reference n"],
    ],
    Complex[Tensor, "*batch n_frequency n_response n_reference"],
]


def modal_solution(
    system: System,
    at_once: Callable[[Tensor, Tensor, System], int],
    damping_factor: Float[Tensor, " n_mode"] | None = None,
    couples_modes: bool = True,
) -> Solution:
    """How to solve for the receptances of a system, differentiable.

    Args:
        system: mass, stiffness and damping of the members.
        at_once: from response rows, reference rows and system to the lines that fit into memory together.
        damping_factor: of the lowest modes, what their damping is times what its law makes of it [-].
        couples_modes: whether a loss in a part of the plate couples modes.
    """
    modes = frozen_modes(system.stiffness, system.mass)

    def solve(s: Tensor, left: Tensor, right: Tensor) -> Tensor:
        impedance = modal_impedance(system, modes, s)
        if damping_factor is not None:
            impedance = scattered(impedance, damping_factor, system.force)
        if impedance.hysteretic is not None and not couples_modes:
            own_loss = impedance.hysteretic.diagonal(dim1=-2, dim2=-1)
            impedance = impedance._replace(hysteretic=torch.diag_embed(own_loss))
        rows = [row @ modes.shape for row in (left, right)]
        step = at_once(left, right, system)
        parts = [
            differentiable_receptance(impedance.at(slice(first, first + step)), rows[0], rows[1])
            for first in range(0, s.shape[-1], step)
        ]
        return joined(parts, -3)

    return solve
