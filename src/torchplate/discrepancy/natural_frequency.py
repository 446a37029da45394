"""The gap between natural frequencies, and how each of them weighs."""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.measurement import NaturalFrequencies

# A frequency without a standard deviation weighs as one known to this part of itself.
ASSUMED: Final = 0.01


def mode_weight(table: NaturalFrequencies) -> Float[Tensor, " n_mode"]:
    """Weights w = (1/s) / √(mean of 1/s²) [-], s = std / f_measured, or 1 % where no std is given; mean w² = 1."""
    relative = torch.full_like(table.frequency, ASSUMED)
    if table.std is not None:
        relative = torch.where(table.std.isnan(), relative, table.std / table.frequency)
    return 1 / relative / relative.reciprocal().square().mean().sqrt()


def natural_frequency_error(
    model: Float[Tensor, "*batch n_mode"],
    measured: Float[Tensor, " n_mode"],
    weight: Float[Tensor, " n_mode"],
) -> Float[Tensor, "*batch"]:
    """√(mean over modes of (w (f_model − f_measured) / f_measured)²) [-], mean w² = 1.

    With w from `mode_weight` it is √(Σ (Δf/std)² / Σ (f/std)²). Source: Friswell and Mottershead, Finite Element Model
    Updating in Structural Dynamics (1995).
    """
    return (weight * (model / measured - 1)).square().mean(-1).sqrt()
