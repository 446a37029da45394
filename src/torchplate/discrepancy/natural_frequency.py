"""The gap between natural frequencies, and how each of them weighs."""

from jaxtyping import Float
from torch import Tensor

from torchplate.measurement import NaturalFrequencies, with_std


def mode_weight(table: NaturalFrequencies) -> Float[Tensor, " n_mode"]:
    """Weights w = (1/s) / √(mean of 1/s²) [-], s = std / f_measured, of `with_std` where none is given; mean w² = 1."""
    whole = with_std(table)
    assert whole.std is not None
    relative = whole.std / whole.frequency
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
