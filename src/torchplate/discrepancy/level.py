"""Levels: the one factor on all FRFs of the model that suits a measure, where the readings carry no unit."""

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.discrepancy.measure import Measured


def complex_gain(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """The real level g that minimises Σ_r ‖H_measured,r − g H_model,r‖² / ‖H_measured,r‖², not below 0."""
    return _projected((model.conj() * measured.frf).real, model, _one_over_power(measured)).clamp(min=0.0)


def amplitude_gain(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """The level g that minimises Σ_r ‖|H_measured,r| − g |H_model,r|‖² / ‖H_measured,r‖²."""
    return _projected(model.abs() * measured.frf.abs(), model, _one_over_power(measured))


def log_gain(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """The level g that minimises Σ (ln |H_measured| − ln g |H_model|)²: the geometric mean of the ratios."""
    kept = measured.pairs & (measured.frf != 0) & (model != 0)
    ratio = torch.where(kept, (measured.frf / torch.where(kept, model, 1.0)).abs(), 1.0)
    return (ratio.log().sum((-3, -2, -1)) / kept.sum((-3, -2, -1))).exp()


def precision_gain(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """The real level g that minimises Σ w |H_measured − g H_model|², w the coherence's weight, not below 0."""
    assert measured.precision is not None
    return _projected((model.conj() * measured.frf).real, model, measured.precision).clamp(min=0.0)


def line_gain(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """The level g that minimises Σ_lines c (ln g + ln ‖H_model‖ − ln ‖H_measured‖)², norms over the FRFs of a line.

    c is the root of the line's CSAC. It is what 1 − mean CSF is to second order, for 2 |HᴴH'| / (‖H‖² + ‖H'‖²) is
    c / cosh of that logarithm.
    """
    kept = torch.where(measured.pairs, model, 0.0)
    own, other = kept.abs().square().sum((-2, -1)), measured.frf.abs().square().sum((-2, -1))
    seen = (own > 0) & (other > 0)
    own, other = torch.where(seen, own, 1.0), torch.where(seen, other, 1.0)
    cosine = torch.where(seen, (kept.conj() * measured.frf).sum((-2, -1)).abs() / (own * other).sqrt(), 0.0)
    return (0.5 * (cosine * (other / own).log()).sum(-1) / cosine.sum(-1)).exp()


def _one_over_power(measured: Measured) -> Float[Tensor, "1 n_response n_reference"]:
    return torch.where(measured.pairs, 1 / measured.frf.abs().square().sum(0), 0.0)[None]


def _projected(cross: Tensor, model: Tensor, weight: Tensor) -> Tensor:
    """Σ w cross / Σ w |model|²."""
    return (cross * weight).sum((-3, -2, -1)) / (model.abs().square() * weight).sum((-3, -2, -1))
