"""What the first order leaves out where modes move by more than their width."""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class SecondOrder(NamedTuple):
    """What the first order leaves out where modes move by more than their width.

    Attributes:
        moving: standard deviation of each mode's eigenvalue by each group [rad²/s²].
        damped: that of each mode's damping, relative [-].
        scales: whether it does with the size of its group.
        kappa: what λ is times in the denominator, its absolute value.
        damping: the part of the denominator that damps, likewise.
        width: the denominator itself, likewise.
        pairs: squared products of deflections at responses and references.
        places: what places off by one standard deviation add to the mean square of receptances.
        factor: from receptances to readings, squared.
        reading: which pair is read under each label; None for its own.
        moves: change of each mode's eigenvalue by each term of a wandering section [rad²/s²].
    """

    moving: Mapping[str, Float[Tensor, " n_mode"]]
    damped: Float[Tensor, " n_mode"]
    scales: bool
    kappa: Float[Tensor, "n_frequency n_mode"]
    damping: Float[Tensor, "n_frequency n_mode"]
    width: Float[Tensor, "n_frequency n_mode"]
    pairs: Float[Tensor, "n_pair n_mode"]
    places: Float[Tensor, "n_frequency n_response n_reference"]
    factor: Float[Tensor, "n_frequency n_response n_reference"]
    reading: Tensor | None = None
    moves: Float[Tensor, "n_mode n_wander"] | None = None

    def widths(self, shift: Float[Tensor, " n_off"]) -> float:
        """How far a wandering section moves the mode that it moves farthest, in widths of that mode's peak [-].

        Args:
            shift: of its terms, in standard deviations, and of what else a specimen has of its own.
        """
        if self.moves is None or not self.moves.numel():
            return 0.0
        moved = self.moves @ shift[: self.moves.shape[-1]]
        return float((moved.abs() * (self.kappa / self.width).amax(0)).max())

    def variance(self, scale: Mapping[str, float]) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Variance of the real and of the imaginary part.

        Args:
            scale: what each group is times what was said of it; 1 where it is left out.
        """
        square = sum((scale.get(name, 1.0) * part).square() for name, part in self.moving.items())
        q = torch.as_tensor(square).to(self.width).sqrt() * self.kappa / self.width
        size = scale.get("damping_scatter", 1.0) if self.scales else 1.0
        d = size * self.damped * self.damping / self.width
        share = (q.square() / (1 + q)).square() + (d.square() / (1 + d)).square()
        found = ((0.5 * share / self.width.square()) @ self.pairs.mT).unflatten(-1, self.factor.shape[1:])
        found = (found + 0.5 * scale.get("position_std", 1.0) ** 4 * self.places) * self.factor
        return found if self.reading is None else found.flatten(-2)[..., self.reading]
