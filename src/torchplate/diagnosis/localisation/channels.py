"""What a model leaves of each FRF."""

import math

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.diagnosis.result import ChannelGap
from torchplate.measurement import Measurement


def channel_gaps(
    measurement: Measurement,
    noise_std: Float[Tensor, "n_frequency n_response n_reference"],
    before: Complex[Tensor, "n_frequency n_response n_reference"],
    after: Complex[Tensor, "n_frequency n_response n_reference"],
    heldout: Bool[Tensor, "n_response n_reference"],
) -> tuple[ChannelGap, ...]:
    """‖measured − model‖ / ‖measured‖ of every FRF, and what noise alone makes of it, the worst first."""
    norm = measurement.frf.norm(dim=0)
    safe = torch.where(norm > 0, norm, 1.0)
    gaps = [(measurement.frf - model).norm(dim=0) / safe for model in (before, after)]
    floor = math.sqrt(2) * noise_std.norm(dim=0) / safe
    found = [
        ChannelGap(
            measurement.response[j].label,
            measurement.reference[k].label,
            float(gaps[0][j, k]),
            float(gaps[1][j, k]),
            float(floor[j, k]),
            bool(heldout[j, k]),
        )
        for j, k in measurement.pairs
    ]
    return tuple(sorted(found, key=lambda one: -one.before))
