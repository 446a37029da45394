"""What a model leaves of a measurement, in standard deviations of its noise, and in which bands."""

from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.result import Band
from torchplate.diagnosis.settings import SETTINGS
from torchplate.measurement import Measurement


class Misfit(NamedTuple):
    """What is left, in standard deviations of its noise.

    Attributes:
        measured: over the noise; 0 where not measured.
        predicted: likewise.
        residual: their difference.
        inverse: one over the noise.
        total: Σ|residual|².
        noise: what noise alone would make of it: 2 for each line of each FRF.
    """

    measured: Complex[Tensor, "n_frequency n_response n_reference"]
    predicted: Complex[Tensor, "n_frequency n_response n_reference"]
    residual: Complex[Tensor, "n_frequency n_response n_reference"]
    inverse: Float[Tensor, "n_frequency n_response n_reference"]
    total: float
    noise: float

    @classmethod
    def of(cls, measurement: Measurement, std: Tensor, predicted: Tensor) -> "Misfit":
        """A line without noise weighs as much as one with a millionth of its FRF's root mean square."""
        least = 1e-6 * measurement.frf.abs().square().mean(0).sqrt()
        std = torch.maximum(std, least.expand_as(std))
        kept = measurement.measured & (std > 0)
        inverse = torch.where(kept, 1 / torch.where(kept, std, 1.0), 0.0)
        residual = (measurement.frf - predicted) * inverse
        total = float(residual.abs().square().sum())
        return cls(measurement.frf * inverse, predicted * inverse, residual, inverse, total, 2.0 * float(kept.sum()))

    @property
    def excess(self) -> float:
        """The misfit beyond noise."""
        return self.total - self.noise

    @property
    def n_frf(self) -> int:
        """Measured FRFs."""
        return int((self.inverse > 0).any(0).sum())

    def part(self, left: float) -> float:
        """Part of the excess that is gone where so much of the misfit is left."""
        return min(1.0, max(0.0, 1 - (left - self.noise) / self.excess))

    def bands(self, frequency: Float[Tensor, " n_frequency"]) -> tuple[Band, ...]:
        """The fewest lines that hold most of the misfit, neighbours joined, the worst first."""
        line = (self.residual.abs().square() - 2 * (self.inverse > 0)).sum((-2, -1)).clamp(min=0.0)
        n = SETTINGS.localising.n_line
        window = line.new_ones(1, 1, n) / n
        smooth = torch.nn.functional.conv1d(line[None, None], window, padding=n // 2)[0, 0]
        order = smooth.argsort(descending=True)
        needed = int((smooth[order].cumsum(0) < SETTINGS.localising.in_bands * smooth.sum()).sum()) + 1
        chosen = order[:needed].sort().values.tolist()
        runs = [[chosen[0], chosen[0]]]
        for index in chosen[1:]:
            if index - runs[-1][1] > SETTINGS.localising.n_line:
                runs.append([index, index])
            runs[-1][1] = index
        total = float(line.sum())
        # One line alone is a band as far as its neighbours.
        runs = [run if run[0] < run[1] else [max(0, run[0] - 1), min(len(line) - 1, run[1] + 1)] for run in runs]
        found = [
            Band(float(frequency[low]), float(frequency[high]), float(line[low : high + 1].sum()) / total)
            for low, high in runs
        ]
        return tuple(sorted(found, key=lambda band: -band.share)[: SETTINGS.localising.n_band])
