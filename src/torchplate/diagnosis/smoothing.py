"""Spectra smoothed along the frequency axis by the kernel of one mode, so that peaks that do not overlap attract.

    (F r)_i = Σ_j r_j Δω_j / (σ_i + i (ω_i − ω_j)),    σ_i = width · ω_i:

what it makes small is what model and measurement would both show at s = iω + σ.
"""

import functools
from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.settings import WideLevels


@dataclass(frozen=True, eq=False)
class Smoothing:
    """What smooths the FRFs of one measurement; it hangs on their size alone.

    Attributes:
        frequency: lines [Hz].
        power: |H|² of the measured FRFs.
        settings: of the wide levels.
    """

    frequency: Float[Tensor, " n_frequency"]
    power: Float[Tensor, "n_frequency n_response n_reference"]
    settings: WideLevels

    @functools.cached_property
    def every(self) -> int:
        """Of how many lines one is smoothed."""
        return max(1, len(self.frequency) // self.settings.least)

    @functools.cached_property
    def filters(self) -> tuple[Complex[Tensor, "n_smooth n_kept"], ...]:
        """One for each width, on the lines that are smoothed."""
        kept = self.frequency[:: self.every]
        # As large as with all lines: a signal that is smoothed grows by the root of their number.
        more = self.every**0.5
        return tuple(more * _kernel(kept, self._centres(kept, width), width) for width in self.settings.widths)

    @functools.cached_property
    def scales(self) -> tuple[Float[Tensor, "n_kept n_response n_reference"], ...]:
        """One over the smoothed size of each FRF for each width: so that every band weighs alike."""
        return tuple(self._scale(width) for width in self.settings.widths)

    def _scale(self, width: float) -> Float[Tensor, "n_kept n_response n_reference"]:
        kernel = _kernel(self.frequency, self.frequency, width)
        power = (kernel.abs().square() @ self.power.flatten(1)).unflatten(1, self.power.shape[1:])
        floor = 1e-3 * power.mean(0)
        return (1 / (power + floor).sqrt().clamp(min=1e-300))[:: self.every]

    @functools.cached_property
    def around(self) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Mean square of each FRF around each line."""
        step = self.frequency.diff().median() if len(self.frequency) > 1 else self.frequency.new_ones(())
        width = self.settings.around * self.frequency[:, None] + float(step)
        away = (self.frequency[:, None] - self.frequency) / width
        weight = torch.exp(-0.5 * away.square())
        mean = (weight / weight.sum(-1, keepdim=True)) @ self.power.flatten(1)
        return mean.unflatten(1, self.power.shape[1:])

    def _centres(self, frequency: Float[Tensor, " n_frequency"], width: float) -> Float[Tensor, " n_smooth"]:
        """Lines of a smoothed spectrum [Hz]."""
        least = float(frequency.diff().min()) if len(frequency) > 1 else 1.0
        centres, at = [], max(float(frequency[0]), least)
        while at <= float(frequency[-1]):
            centres.append(at)
            at += max(width * at / self.settings.per_width, least)
        return torch.tensor(centres).to(frequency)


def _kernel(
    frequency: Float[Tensor, " n_frequency"], centre: Float[Tensor, " n_smooth"], width: float
) -> Complex[Tensor, "n_smooth n_frequency"]:
    """The smoothing of one level."""
    step = torch.gradient(frequency)[0] if len(frequency) > 1 else torch.ones_like(frequency)
    half = torch.maximum(width * centre, step.median())
    kernel = step / torch.complex(half[:, None].expand(-1, len(frequency)), centre[:, None] - frequency)
    return kernel / kernel.abs().square().sum(-1, keepdim=True).sqrt()
