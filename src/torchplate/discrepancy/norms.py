"""Measures of the gap that are norms of a deviation: relative, logarithmic, weighed by the coherence."""

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.discrepancy.deviation import (
    AMPLITUDE,
    COMPLEX,
    LOGARITHM,
    PRECISION,
    amplitude_residual,
    precision_residual,
    relative_slope,
)
from torchplate.discrepancy.level import amplitude_gain, complex_gain, log_gain, precision_gain
from torchplate.discrepancy.measure import Measured, register


@register(complex_gain, COMPLEX, "each")
def relative_frf_norm(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """Σ_r ‖H_measured,r − H_model,r‖ / ‖H_measured,r‖ over the FRFs r, complex [-]. Source: seed paper, Eq. 22."""
    # As `complex_residual` has it, but each FRF is divided by its norm after the sum over its lines: half the work.
    difference = model - measured.frf.to(model.dtype)
    square = torch.view_as_real(difference).square().sum((-1, -4))
    return (square.sqrt() * relative_slope(measured)[0]).sum((-2, -1))


@register(amplitude_gain, AMPLITUDE, "each")
def relative_amplitude_norm(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """Σ_r ‖|H_measured,r| − |H_model,r|‖ / ‖H_measured,r‖ [-]. Source: seed paper, Eq. 22 on amplitudes."""
    return _sum_of_norms(amplitude_residual(model, measured))


@register(log_gain, LOGARITHM, "joint")
def log_amplitude(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """Root mean square of ln |H_model| − ln |H_measured| over lines and FRFs [Np]; peaks and valleys weigh alike.

    Lines at which either is exactly zero (an accelerance at 0 Hz) say nothing and are left out. Source: Balmès,
    "Frequency domain identification of structural dynamics using the pole/residue parametrization", IMAC (1996),
    logarithmic cost.
    """
    kept = measured.pairs & (measured.frf != 0) & (model != 0)
    reference = torch.where(kept, measured.frf, 1.0)
    difference = torch.where(kept, (model / reference).abs(), 1.0).log()
    return (difference.square().sum((-3, -2, -1)) / kept.sum((-3, -2, -1))).sqrt()


@register(precision_gain, PRECISION, "joint", needs_coherence=True)
def coherence_weighted(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """√(Σ w |H_measured − H_model|² / Σ w |H_measured|²) over lines and FRFs [-], w = γ² / ((1 − γ²) |H_measured|²).

    Each line weighs by one over the variance that its coherence γ² gives it, var |H| / |H|² = (1 − γ²) / (2 n_average
    γ²); n_average drops out. It is the root mean square of the relative deviation, weighed by the ratio γ² / (1 − γ²)
    of signal to noise. A coherence above 0.9999 counts as 0.9999; a line without one is left out. Source: Bendat and
    Piersol, Random Data (2010), Table 9.6.
    """
    return precision_residual(model, measured).square().sum((-4, -3, -2, -1)).sqrt()


def _sum_of_norms(residual: Tensor) -> Tensor:
    """One norm for each FRF, over its lines and parts."""
    return residual.square().sum((-4, -1)).sqrt().sum((-2, -1))
