"""Random tensors from the one generator that a search is given."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Draw:
    """Draws of the dtype and on the device of a given tensor; shapes never depend on values.

    Args:
        generator: Source of randomness.
        like: A tensor whose dtype and device the draws have.
    """

    generator: torch.Generator
    like: Tensor

    def uniform(self, shape: Sequence[int]) -> Tensor:
        """Even over [0, 1)."""
        return torch.rand(tuple(shape), generator=self.generator, dtype=self.like.dtype, device=self.like.device)

    def normal(self, shape: Sequence[int]) -> Tensor:
        """Standard normal."""
        return torch.randn(tuple(shape), generator=self.generator, dtype=self.like.dtype, device=self.like.device)

    def below(self, high: int, shape: Sequence[int]) -> Tensor:
        """Whole numbers, even over 0 to high − 1."""
        return torch.randint(high, tuple(shape), generator=self.generator, device=self.like.device)
