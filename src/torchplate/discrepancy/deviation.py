"""Residuals: what a least-squares fit makes small, line by line, for each way to measure the gap."""

from typing import Final

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.discrepancy.measure import Deviation, Measured


def complex_residual(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch n_frequency n_response n_reference 2"]:
    """(H_model − H_measured) / ‖H_measured,r‖ of each FRF r, real and imaginary part [-]."""
    return _parts((model - measured.frf) * relative_slope(measured))


def amplitude_residual(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch n_frequency n_response n_reference 1"]:
    """(|H_model| − |H_measured|) / ‖H_measured,r‖ of each FRF r [-]."""
    return ((model.abs() - measured.frf.abs()) * relative_slope(measured))[..., None]


def log_residual(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch n_frequency n_response n_reference 1"]:
    """(ln |H_model| − ln |H_measured|) / √n over the n lines of all FRFs [Np]; zero where either is exactly zero."""
    seen = measured.pairs & (measured.frf != 0)
    kept = seen & (model != 0)
    # Where nothing is kept the logarithm must have a slope too, or its derivative is NaN.
    ratio = torch.where(kept, model, 1.0) / torch.where(seen, measured.frf, 1.0)
    return torch.where(kept, ratio.abs().log(), 0.0)[..., None] / _root(seen.sum())


def precision_residual(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch n_frequency n_response n_reference 2"]:
    """√w (H_model − H_measured) / √Σ w |H_measured|², w the coherence's weight, real and imaginary part [-]."""
    return _parts((model - measured.frf) * precision_slope(measured))


def relative_slope(measured: Measured) -> Float[Tensor, "n_frequency n_response n_reference"]:
    """1 / ‖H_measured,r‖, the same for all lines of an FRF."""
    norm = torch.view_as_real(measured.frf.resolve_conj()).square().sum((-1, 0)).sqrt()
    return torch.where(measured.pairs, 1 / torch.where(measured.pairs, norm, 1.0), 0.0).expand(measured.frf.shape)


def log_slope(measured: Measured) -> Float[Tensor, "n_frequency n_response n_reference"]:
    """1 / (|H_measured| √n)."""
    seen = measured.pairs & (measured.frf != 0)
    return torch.where(seen, 1 / torch.where(seen, measured.frf, 1.0).abs(), 0.0) / _root(seen.sum())


def precision_slope(measured: Measured) -> Float[Tensor, "n_frequency n_response n_reference"]:
    """√w / √Σ w |H_measured|²."""
    assert measured.precision is not None
    return (measured.precision / (measured.precision * measured.frf.abs().square()).sum()).sqrt()


def _root(count: Tensor) -> Tensor:
    # The root of an integer tensor is single precision.
    return count.to(torch.float64).sqrt()


def _parts(deviation: Tensor) -> Tensor:
    # view_as_real has no rule for vmap over jvp in every release; a stack has.
    return torch.stack((deviation.real, deviation.imag), dim=-1)


COMPLEX: Final = Deviation(complex_residual, relative_slope)
AMPLITUDE: Final = Deviation(amplitude_residual, relative_slope)
LOGARITHM: Final = Deviation(log_residual, log_slope)
PRECISION: Final = Deviation(precision_residual, precision_slope)
