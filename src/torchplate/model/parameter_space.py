"""What is searched: names, units and intervals, and the way between the unit cube and SI units."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from torchplate.effects import Searched


class ParameterSpace(nn.Module):
    """The box of the searched parameters.

    Args:
        names: one for each parameter, in theta's order.
        units: likewise.
        intervals: likewise.
    """

    low: Tensor
    high: Tensor
    logarithmic: Tensor

    def __init__(self, names: Sequence[str], units: Sequence[str], intervals: Sequence[Searched]) -> None:
        super().__init__()
        self.names, self.units = tuple(names), tuple(units)
        self.register_buffer("low", torch.tensor([interval.low for interval in intervals], dtype=torch.float64))
        self.register_buffer("high", torch.tensor([interval.high for interval in intervals], dtype=torch.float64))
        self.register_buffer("logarithmic", torch.tensor([i.logarithmic for i in intervals], dtype=torch.bool))
        # To ask the tensor inside a transform of torch.func makes torch import its compiler: seconds of a run.
        self._some_logarithmic = any(interval.logarithmic for interval in intervals)

    def __len__(self) -> int:
        return len(self.names)

    def to_si(self, position: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n_parameter"]:
        """From the unit cube to theta in SI units: low + u (high − low), or low (high/low)^u on the log scale."""
        linear = self.low + position * (self.high - self.low)
        if not self._some_logarithmic:
            return linear
        low, high = (torch.where(self.logarithmic, end, 1.0) for end in (self.low, self.high))
        return torch.where(self.logarithmic, low * (high / low) ** position, linear)

    def to_cube(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n_parameter"]:
        """From theta in SI units to the unit cube; the inverse of `to_si`."""
        linear = (theta - self.low) / (self.high - self.low)
        if not self._some_logarithmic:
            return linear
        low, high = (torch.where(self.logarithmic, end, 1.0) for end in (self.low, self.high))
        inner = torch.where(self.logarithmic, theta / low, 1.0)
        return torch.where(self.logarithmic, inner.log() / torch.where(self.logarithmic, high / low, 2.0).log(), linear)

    def at_bound(
        self, theta: Float[Tensor, "*batch n_parameter"], tolerance: float = 1e-3
    ) -> Bool[Tensor, "*batch n_parameter"]:
        """Whether a value sits on the edge of its interval, to a fraction of the interval's width."""
        position = self.to_cube(theta)
        return (position <= tolerance) | (position >= 1 - tolerance)
