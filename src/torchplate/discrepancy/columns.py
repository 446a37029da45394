"""What each nuisance, one standard deviation large, makes of the residuals: products with these columns, J.

A channel's own nuisances touch no other channel of its side: their columns are kept for each channel alone.
"""

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.discrepancy.nuisance import Nuisances


class Columns:
    """J, over √D.

    Args:
        nuisances: whose columns these are; None for none.
        weight: 1 / √D; 0 where an FRF does not count.
    """

    def __init__(
        self, nuisances: Nuisances | None, weight: Float[Tensor, "n_frequency n_response n_reference"]
    ) -> None:
        parts = (None, None, None) if nuisances is None else nuisances[:3]
        common, own, other = (_weighed(part, weight) for part in parts)
        n_line, self.n_response, self.n_reference = weight.shape
        self._shape = (n_line, self.n_response, self.n_reference, 2)
        self._common = common.flatten(0, 3)  # [n, k]
        # By channel: [n_channel, lines and the other channels, k].
        self._own = own.movedim(1, 0).flatten(1, 3)
        self._other = other.movedim(2, 0).flatten(1, 3)
        self.n_common, self.n_own, self.n_other = common.shape[-1], own.shape[-1], other.shape[-1]
        self.gram = self._gram(own, other)

    def _gram(self, own: Tensor, other: Tensor) -> Float[Tensor, "n_nuisance n_nuisance"]:
        """JᵀJ, block by block."""
        k, first, second = self.n_common, self.n_common, self.n_common + self.n_response * self.n_own
        size = second + self.n_reference * self.n_other
        gram = own.new_zeros(size, size)
        gram[:k, :k] = self._common.mT @ self._common
        whole = self._common.unflatten(0, self._shape)
        by_response, by_reference = whole.movedim(1, 0).flatten(1, 3), whole.movedim(2, 0).flatten(1, 3)
        gram[:k, first:second] = (by_response.mT @ self._own).movedim(1, 0).flatten(1)
        gram[:k, second:] = (by_reference.mT @ self._other).movedim(1, 0).flatten(1)
        if self.n_own:
            gram[first:second, first:second] = torch.block_diag(*(self._own.mT @ self._own))
        if self.n_other:
            gram[second:, second:] = torch.block_diag(*(self._other.mT @ self._other))
        if self.n_own and self.n_other:
            across = torch.einsum("fjrpa,fjrpb->jarb", own, other)
            gram[first:second, second:] = across.flatten(2).flatten(0, 1)
        return torch.triu(gram) + torch.triu(gram, 1).mT

    def along(self, residual: Float[Tensor, "*batch n_residual"]) -> Float[Tensor, "*batch n_nuisance"]:
        """Jᵀ r."""
        n_row = residual.shape[:-1].numel()
        whole, parts = residual.reshape(n_row, *self._shape), [residual @ self._common]
        # Channel by channel one product for all rows: each channel's columns are read once.
        for columns, side in ((self._own, 2), (self._other, 3)):
            if columns.shape[-1]:
                moved = whole.movedim(side, 0).flatten(2)
                felt = (moved @ columns).movedim(0, 1).flatten(1)
                parts.append(felt.reshape(*residual.shape[:-1], felt.shape[-1]))
        return torch.cat(parts, dim=-1)

    def across(self, value: Float[Tensor, "*batch n_nuisance"]) -> Float[Tensor, "*batch n_residual"]:
        """J ν."""
        n_line, n_response, n_reference, _ = self._shape
        split = [self.n_common, n_response * self.n_own, n_reference * self.n_other]
        common, own, other = value.split(split, dim=-1)
        n_row = value.shape[:-1].numel()
        found = (common @ self._common.mT).reshape(n_row, *self._shape)
        if self.n_own:
            moved = own.reshape(n_row, n_response, self.n_own).movedim(1, 0) @ self._own.mT
            found += moved.unflatten(-1, (n_line, n_reference, 2)).permute(1, 2, 0, 3, 4)
        if self.n_other:
            moved = other.reshape(n_row, n_reference, self.n_other).movedim(1, 0) @ self._other.mT
            found += moved.unflatten(-1, (n_line, n_response, 2)).permute(1, 2, 3, 0, 4)
        return found.reshape(*value.shape[:-1], -1)

    def power(self) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Sum of the squares of all columns, real and imaginary part."""
        n_line, n_response, n_reference, _ = self._shape
        whole = self._common.square().sum(-1).reshape(self._shape)
        own = self._own.square().sum(-1).reshape(n_response, n_line, n_reference, 2).movedim(0, 1)
        other = self._other.square().sum(-1).reshape(n_reference, n_line, n_response, 2).movedim(0, 2)
        return (whole + own + other).sum(-1)


def _weighed(columns: Complex[Tensor, "n_frequency n_response n_reference k"] | None, weight: Tensor) -> Tensor:
    if columns is None:
        return weight.new_zeros(*weight.shape, 2, 0)
    return torch.view_as_real((columns * weight[..., None]).resolve_conj()).movedim(-1, -2)
