"""The specimen of a reference test: a section that wanders, and each mode with a damping and a stiffness of its own.

What a model leaves of each mode is the same in all tests of a plate. A mode φ, with φᵀ M φ = 1, that is off by b in
ln f has a stiffness more, of rank one:

    ΔK = 2 b ω² (M φ) (M φ)ᵀ.

In another basis, or beside an effect that came in, it is the same matrix.

Source: Baruch, Optimization procedure to correct stiffness and flexibility matrices using vibration tests, AIAA J. 16
(1978) 1208, for stiffness of rank one in the shape of a mode.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Specimens, Wandering
from torchplate.model import PlateModel, SparseModel, solve_modes


class OwnModes(NamedTuple):
    """Modes of a plate that may each be off by their own number.

    Attributes:
        eigenvalue: ω² [rad²/s²].
        load: M φ over the free dofs.
    """

    eigenvalue: Float[Tensor, " n_mode"]
    load: Float[Tensor, "n_free n_mode"]

    @classmethod
    @torch.no_grad()
    def of(
        cls, whole: PlateModel, reduced: PlateModel, theta: Float[Tensor, " n_parameter"], n_mode: int
    ) -> "OwnModes":
        """The lowest modes of a specimen.

        Args:
            whole: its model in all dofs.
            reduced: the same in a basis.
            theta: its searched parameters.
            n_mode: how many.
        """
        system = reduced.assembly.system(*reduced.plan(theta))
        eigenvalue, shape = solve_modes(system.stiffness, system.mass)
        basis = reduced.assembly.basis
        vector = shape[:, :n_mode] if basis is None else basis @ shape[:, :n_mode]
        load = SparseModel(whole, theta).times_mass(vector.double().cpu())
        return cls(eigenvalue[:n_mode], torch.as_tensor(load).to(vector))

    def stiffness(self, model: PlateModel, std: float) -> Float[Tensor, "n_mode n n"]:
        """What each mode's stiffness adds as it is off by a standard deviation, in a model's own coordinates."""
        basis = model.assembly.basis
        rows = self.load.mT if basis is None else self.load.mT @ basis
        return 2 * std * self.eigenvalue[:, None, None] * rows[:, :, None] * rows[:, None, :]


class ReferenceSpecimens(Specimens):
    """The specimens that a reference test may be of.

    Args:
        model: in a basis.
        theta: its searched parameters where the terms are meant.
        wandering: how far the section may wander.
        damping: standard deviation of each mode's ln damping [-].
        modes: those with a stiffness of their own.
        stiffness: standard deviation of ln f of each [-].
        place: standard deviation of the place of a sensor or a hit [m].
    """

    @torch.no_grad()
    def __init__(
        self,
        model: PlateModel,
        theta: Float[Tensor, " n_parameter"],
        wandering: Wandering,
        damping: float,
        modes: OwnModes,
        stiffness: float,
        place: float = 0.0,
    ) -> None:
        n_mode = len(modes.eigenvalue)
        super().__init__(model, theta, wandering, damping, n_mode, place)
        own = modes.stiffness(model, stiffness)
        self.n_section = self.n_term
        self.stiffness = torch.cat([self.stiffness, own])
        self.mass = torch.cat([self.mass, torch.zeros_like(own)])
        section = self.names[: self.n_section]
        self.n_term += n_mode
        self.names = (*section, *("mode_stiffness",) * n_mode, *("damping_scatter",) * n_mode)
