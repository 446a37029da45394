"""FRFs beside the frequency axis, at s = iω + σ, σ = width · ω: peaks that do not overlap on it attract there.

A resonance is as broad there as with a loss factor larger by twice the width. What was measured is continued from its
resonances, which hold between the lines too; where there are too few lines to find any, by Poisson's integral,

    H(iω + σ) = (1/π) ∫ H(iω') σ / (σ² + (ω − ω')²) dω',

true of what is analytic and bounded on the right of the axis, and rough at the ends of the band.
"""

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.settings import WideLevels
from torchplate.measurement import Resonances


class Level(NamedTuple):
    """What one level looks at.

    Attributes:
        frequency: ω / 2π [Hz].
        decay: σ [1/s].
        measured: the FRFs there.
        stands_for: lines that were measured for each, 1 at most [-].
        scale: its root over the size of the FRFs around each line, so that every band weighs alike.
    """

    frequency: Float[Tensor, " n_line"]
    decay: Float[Tensor, " n_line"]
    measured: Complex[Tensor, "n_line n_response n_reference"]
    stands_for: Float[Tensor, " n_line"]
    scale: Float[Tensor, "n_line n_response n_reference"]


@dataclass(frozen=True, eq=False)
class Smoothing:
    """Measured FRFs from wide to narrow.

    Attributes:
        frequency: lines [Hz].
        measured: the FRFs.
        resonances: of them; None where none are known.
        settings: of the wide levels.
        share: lines that each line stands for [-].
    """

    frequency: Float[Tensor, " n_frequency"]
    measured: Complex[Tensor, "n_frequency n_response n_reference"]
    resonances: Resonances | None
    settings: WideLevels
    share: Float[Tensor, " n_frequency"]

    @functools.cached_property
    def levels(self) -> tuple[Level, ...]:
        """One for each width."""
        return tuple(self._level(width) for width in self.settings.widths)

    @functools.cached_property
    def around(self) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Mean square of each FRF around each line."""
        return self._around(self.frequency, self.measured, self.share)

    def _level(self, width: float) -> Level:
        frequency = self._centres(width)
        decay = 2 * torch.pi * width * frequency
        if self.resonances is None:
            kernel = _poisson(self.frequency, width * frequency, frequency)
            measured = (kernel.to(self.measured) @ self.measured.flatten(1)).unflatten(1, self.measured.shape[1:])
        else:
            measured = self.resonances.at(frequency, decay).to(self.measured)
        power = self._around(frequency, measured, torch.ones_like(frequency))
        size = (power + 1e-3 * power.mean(0)).sqrt().clamp(min=1e-300)
        stands_for = self._stands_for(frequency)
        return Level(frequency, decay, measured, stands_for, stands_for.sqrt()[:, None, None] / size)

    def _stands_for(self, frequency: Float[Tensor, " n_line"]) -> Float[Tensor, " n_line"]:
        """Lines that were measured for each of those that are looked at, 1 at most.

        These lie closer the lower they are. Below the first modes there may be twenty of them between two that were
        measured, and what resonances make of a peak there would count twenty times.
        """
        if len(frequency) < 2 or not self.settings.as_measured:
            return torch.ones_like(frequency)
        step = torch.gradient(self.frequency)[0]
        nearest = torch.searchsorted(self.frequency.contiguous(), frequency.contiguous()).clamp(max=len(step) - 1)
        return (torch.gradient(frequency)[0] / step[nearest].clamp(min=1e-300)).clamp(max=1.0)

    def _around(
        self,
        frequency: Float[Tensor, " n_line"],
        frf: Complex[Tensor, "n_line n_response n_reference"],
        share: Float[Tensor, " n_line"],
    ) -> Float[Tensor, "n_line n_response n_reference"]:
        step = frequency.diff().median() if len(frequency) > 1 else frequency.new_ones(())
        width = self.settings.around * frequency[:, None] + float(step)
        weight = share * torch.exp(-0.5 * ((frequency[:, None] - frequency) / width).square())
        mean = (weight / weight.sum(-1, keepdim=True)) @ frf.abs().square().flatten(1)
        return mean.unflatten(1, frf.shape[1:])

    def _centres(self, width: float) -> Float[Tensor, " n_line"]:
        """Frequencies a part of the width apart, no more of them than wanted [Hz]."""
        settings, last = self.settings, float(self.frequency[-1])
        first = max(float(self.frequency[0]), settings.lowest * last)
        n = math.ceil(math.log(last / first) / width * settings.per_width) + 1
        place = torch.linspace(math.log(first), math.log(last), min(n, settings.most), dtype=torch.float64)
        return place.exp().to(self.frequency)


def _poisson(
    frequency: Float[Tensor, " n_frequency"], half: Float[Tensor, " n_line"], centre: Float[Tensor, " n_line"]
) -> Float[Tensor, "n_line n_frequency"]:
    """Weights of the lines in Poisson's integral, which sum to one."""
    step = torch.gradient(frequency)[0] if len(frequency) > 1 else torch.ones_like(frequency)
    half = torch.maximum(half, step.median())[:, None]
    weight = step * half / (half.square() + (centre[:, None] - frequency).square())
    return weight / weight.sum(-1, keepdim=True)
