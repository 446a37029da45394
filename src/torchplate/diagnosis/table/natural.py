"""Natural frequencies of many members of a reduced model, and how they change: no FRF, no damping."""

import functools
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.model import PlateModel, natural_frequencies, whiten

# Step of the differences of K and M on the unit cube [-]: their rounding is then 1e-10, their curvature 1e-6.
STEP = 1e-6
# Members whose matrices are made at once: memory, no result hangs on it.
AT_ONCE = 96


@dataclass(frozen=True, eq=False)
class Natural:
    """Natural frequencies of a reduced model.

    Attributes:
        model: in a basis.
        mode: those that are wanted, from 0.
    """

    model: PlateModel
    mode: Tensor

    @property
    def n_parameter(self) -> int:
        """Number of searched parameters."""
        return len(self.model.names)

    def frequency(self, position: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_mode"]:
        """[Hz], at places on the unit cube."""
        theta, count = self.model.space.to_si(position), int(self.mode.max()) + 1
        flat = theta.reshape(theta.shape[:-1].numel(), self.n_parameter)
        found = torch.cat([self.model.natural_frequencies(some, count)[:, self.mode] for some in flat.split(AT_ONCE)])
        return found.reshape(*position.shape[:-1], len(self.mode))

    @functools.cached_property
    def seen(self) -> tuple[int, ...]:
        """Parameters that stiffness or mass depend on; damping and the sensor chain they do not."""
        if not self.n_parameter:
            return ()
        # No two alike: a rectangle whose corners meet is none, whichever of its numbers moves.
        middle = torch.linspace(0.31, 0.51, self.n_parameter).to(self.model.known)[None]
        stiffness, mass = self._matrices(torch.cat([middle, middle + 0.17 * torch.eye(self.n_parameter).to(middle)]))
        same = (stiffness == stiffness[0]).flatten(1).all(-1) & (mass == mass[0]).flatten(1).all(-1)
        return tuple(k for k, still in enumerate(same[1:].tolist()) if not still)

    def slope(self, position: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_mode n"]:
        """df/du [Hz]: d(ω²) = φᵀ (dK − ω² dM) φ, dK and dM by a step that stays on the cube."""
        flat = position.reshape(position.shape[:-1].numel(), self.n_parameter)
        found = position.new_zeros(len(flat), len(self.mode), self.n_parameter)
        if self.seen:
            at_once = max(1, AT_ONCE // (1 + len(self.seen)))
            found[..., list(self.seen)] = torch.cat([self._slope(part) for part in flat.split(at_once)])
        return found.reshape(*position.shape[:-1], len(self.mode), self.n_parameter)

    def _slope(self, position: Tensor) -> Float[Tensor, "n_member n_mode n_seen"]:
        step = torch.where(position > 0.5, -STEP, STEP)[:, list(self.seen)]
        moved = position.repeat(1 + len(self.seen), 1, 1)
        for row, index in enumerate(self.seen):
            moved[1 + row, :, index] += step[:, row]
        stiffness, mass = (part.unflatten(0, moved.shape[:2]) for part in self._matrices(moved.flatten(0, 1)))
        white, inverse = whiten(stiffness[0], mass[0])
        value, vector = torch.linalg.eigh(white)
        shape, value = (inverse.mT @ vector)[..., self.mode], value[..., self.mode]
        # dK and dM before they meet the shapes: their difference is small against each.
        change = ((stiffness[1:] - stiffness[0]) @ shape - ((mass[1:] - mass[0]) @ shape) * value[:, None]) * shape
        frequency = natural_frequencies(value).clamp(min=1e-6)
        slope = change.sum(-2) / step.mT[..., None] / (8 * torch.pi**2 * frequency)
        return slope.movedim(0, -1)

    def _matrices(self, position: Tensor) -> tuple[Tensor, Tensor]:
        # With what hangs on springs: its motion is among the modes.
        stiffness, mass = self.model.system(self.model.space.to_si(position)).undamped()
        shape = (len(position), *stiffness.shape[-2:])
        return stiffness.expand(shape), mass.expand(shape)
