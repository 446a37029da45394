"""What each nuisance, one standard deviation large, makes of the FRFs: products with these columns, J.

A channel's own nuisances touch no other channel of its side: their columns are kept for each channel alone.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy.nuisance import Nuisances

# Numbers that are weighed at a time: 8 MiB of them.
AT_ONCE = 2**20


class Columns:
    """J, which stays as it is whatever the noise is: each product with it is weighed.

    Args:
        nuisances: whose columns these are; None for none.
        like: numbers of the FRFs, for where there are none.
    """

    def __init__(self, nuisances: Nuisances | None, like: Float[Tensor, "n_frequency n_response n_reference"]) -> None:
        nothing = like.new_zeros(*like.shape, 2, 0)
        common, own, other = (nothing,) * 3 if nuisances is None else nuisances[:3]
        n_line, self.n_response, self.n_reference = like.shape
        self._shape = (n_line, self.n_response, self.n_reference, 2)
        self._common = common.flatten(0, 3)  # [n, k]
        # By channel: [n_channel, lines and the other channels, k].
        self._own = own.movedim(1, 0).flatten(1, 3)
        self._other = other.movedim(2, 0).flatten(1, 3)
        self.n_common, self.n_own, self.n_other = common.shape[-1], own.shape[-1], other.shape[-1]

    def gram(self, weight: Float[Tensor, "n_frequency n_response n_reference"]) -> Float[Tensor, "n n"]:
        """JᵀD⁻¹J, block by block.

        Args:
            weight: 1 / √D; 0 where an FRF does not count.
        """
        first = self.n_common + self.n_response * self.n_own
        size = first + self.n_reference * self.n_other
        found = weight.new_zeros(size, size)
        width = weight[:1].numel() * 2 * max(1, self.n_common + self.n_own + self.n_other)
        n_at_once = max(1, AT_ONCE // width)
        for begin in range(0, len(weight), n_at_once):
            self._add(found, slice(begin, begin + n_at_once), weight[begin : begin + n_at_once, ..., None, None])
        return torch.triu(found) + torch.triu(found, 1).mT

    def _add(self, gram: Tensor, lines: slice, over: Float[Tensor, "n_line n_response n_reference 1 1"]) -> None:
        """To the blocks on and above the diagonal what some lines make of them."""
        k, first = self.n_common, self.n_common + self.n_response * self.n_own
        whole = self._common.unflatten(0, self._shape)[lines] * over
        own = self._own.unflatten(1, (-1, self.n_reference, 2))[:, lines] * over.movedim(1, 0)
        other = self._other.unflatten(1, (-1, self.n_response, 2))[:, lines] * over.movedim(2, 0)
        common, of_response, of_reference = whole.flatten(0, 3), own.flatten(1, 3), other.flatten(1, 3)
        gram[:k, :k] += common.mT @ common
        if self.n_own:
            by_response = whole.movedim(1, 0).flatten(1, 3)
            gram[:k, k:first] += (by_response.mT @ of_response).movedim(1, 0).flatten(1)
            gram[k:first, k:first] += torch.block_diag(*(of_response.mT @ of_response))
        if self.n_other:
            by_reference = whole.movedim(2, 0).flatten(1, 3)
            gram[:k, first:] += (by_reference.mT @ of_reference).movedim(1, 0).flatten(1)
            gram[first:, first:] += torch.block_diag(*(of_reference.mT @ of_reference))
        if self.n_own and self.n_other:
            gram[k:first, first:] += torch.einsum("jfrpa,rfjpb->jarb", own, other).flatten(2).flatten(0, 1)

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
        common, own, other = (torch.linalg.vector_norm(one, dim=-1).square() for one in self._parts)
        whole = common.reshape(self._shape) + own.reshape(n_response, n_line, n_reference, 2).movedim(0, 1)
        return (whole + other.reshape(n_reference, n_line, n_response, 2).movedim(0, 2)).sum(-1)

    @property
    def nbytes(self) -> int:
        """What they take of memory."""
        return sum(one.nbytes for one in self._parts)

    @property
    def _parts(self) -> tuple[Tensor, Tensor, Tensor]:
        return self._common, self._own, self._other
