"""Assurance criteria: correlations of mode shapes, and of FRFs, along the lines or across the channels.

Those of FRFs are measures of the gap. Where a measure is blind to the level or has no residuals of its own, a
least-squares finish makes the complex relative residuals small instead; a run keeps its result only where it lowers the
measure.
"""

import torch
from jaxtyping import Complex, Float, Num
from torch import Tensor

from torchplate.discrepancy.deviation import COMPLEX
from torchplate.discrepancy.level import amplitude_gain, line_gain
from torchplate.discrepancy.measure import Measured, register


@register(amplitude_gain, COMPLEX, "other", sees_level=False)
def frac(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """1 − mean over FRFs of the frequency response assurance criterion [-], 0 to 1.

    FRAC = |Σ H_measured* H_model|² / (Σ |H_measured|² Σ |H_model|²), sums over the lines of one FRF: the shape of each
    FRF counts, its level does not. Sources: Nefske and Sung, "Correlation of a coarse mesh finite element model using
    structural system identification and a frequency response criterion", IMAC (1996); Heylen and Lammens, "FRAC: a
    consistent way of comparing frequency response functions", Identification in Engineering Systems (1996).
    """
    criterion = _correlation(model, measured, -3)
    mean = torch.where(measured.pairs, criterion, 0.0).sum((-2, -1)) / measured.pairs.sum()
    # Rounding can leave the correlation of equal FRFs above 1.
    return (1 - mean).clamp(min=0.0)


@register(amplitude_gain, COMPLEX, "other", sees_level=False, least_frf=2)
def csac(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """1 − mean over lines of the cross signature assurance criterion [-], 0 to 1.

    CSAC = |Hᴴ_measured H_model|² / (‖H_measured‖² ‖H_model‖²), products over the FRFs at one line: the operating shape
    counts, its level does not. It takes two FRFs at least, for with one it is 1 at every line. Lines at which either is
    exactly zero are left out. Source: Dascotte and Strobbe, "Updating finite element models using FRF correlation
    functions", IMAC (1999).
    """
    return _mean_over_lines(_correlation(_kept(model, measured), measured, (-2, -1)), model, measured)


@register(line_gain, COMPLEX, "other")
def csf(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"], measured: Measured
) -> Float[Tensor, "*batch"]:
    """1 − mean over lines of the cross signature scale factor [-], 0 to 1.

    CSF = 2 |Hᴴ_measured H_model| / (‖H_measured‖² + ‖H_model‖²), products over the FRFs at one line: shape and level
    both count; with a single FRF, its amplitude alone. Lines at which either is exactly zero are left out. Source:
    Dascotte and Strobbe, "Updating finite element models using FRF correlation functions", IMAC (1999).
    """
    kept = _kept(model, measured)
    cross = (measured.frf.conj() * kept).sum((-2, -1)).abs()
    total = (kept.abs().square() + measured.frf.abs().square()).sum((-2, -1))
    criterion = 2 * cross / torch.where(total > 0, total, 1.0)
    return _mean_over_lines(criterion, model, measured)


def mac(
    one: Num[Tensor, "*#batch n_one n_point"], other: Num[Tensor, "*#batch n_other n_point"]
) -> Float[Tensor, "*batch n_one n_other"]:
    """Modal assurance criterion of each mode of one set with each of the other [-], 0 to 1.

    MAC = |φᴴψ|² / (φᴴφ ψᴴψ): 1 where two shapes are alike, whatever their scale and phase; 0 where they are orthogonal,
    or one is zero everywhere. Source: Allemang and Brown, "A correlation coefficient for modal vector analysis", IMAC I
    (1982).

    Args:
        one: deflections at the points, real or complex, a mode in each row.
        other: likewise.
    """
    if one.is_complex() != other.is_complex():
        kind = torch.promote_types(one.dtype, other.dtype)
        one, other = one.to(kind), other.to(kind)
    cross = (one.conj() @ other.mT).abs().square()
    both = _energy(one)[..., :, None] * _energy(other)[..., None, :]
    return torch.where(both > 0, cross / torch.where(both > 0, both, 1.0), 0.0).clamp(max=1.0)


def comac(
    one: Num[Tensor, "*#batch n_mode n_point"], other: Num[Tensor, "*#batch n_mode n_point"]
) -> Float[Tensor, "*batch n_point"]:
    """Coordinate modal assurance criterion of each point over pairs of modes [-], 0 to 1.

    COMAC = (Σ |φ ψ*|)² / (Σ |φ|² Σ |ψ|²), sums over the modes at one point: low where a sensor is misplaced or the
    model is wrong nearby. Each shape counts by its own norm, so that no scale is needed. Source: Lieven and Ewins,
    "Spatial correlation of mode shapes, the coordinate modal assurance criterion (COMAC)", IMAC VI (1988).

    Args:
        one: deflections at the points, real or complex, a mode in each row.
        other: the modes that they are paired with, row by row.
    """
    unit = [shape.abs() / _energy(shape).sqrt()[..., None].clamp(min=1e-300) for shape in (one, other)]
    cross = (unit[0] * unit[1]).sum(-2).square()
    both = unit[0].square().sum(-2) * unit[1].square().sum(-2)
    return torch.where(both > 0, cross / torch.where(both > 0, both, 1.0), 0.0).clamp(max=1.0)


def _energy(shape: Tensor) -> Tensor:
    return shape.abs().square().sum(-1)


def _kept(model: Tensor, measured: Measured) -> Tensor:
    return torch.where(measured.pairs, model, 0.0)


def _correlation(model: Tensor, measured: Measured, over: int | tuple[int, int]) -> Tensor:
    """|Σ H_measured* H_model|² / (Σ |H_measured|² Σ |H_model|²), 0 where either is all zero."""
    cross = (measured.frf.conj() * model).sum(over).abs().square()
    both = measured.frf.abs().square().sum(over) * model.abs().square().sum(over)
    return torch.where(both > 0, cross / torch.where(both > 0, both, 1.0), 0.0)


def _mean_over_lines(criterion: Tensor, model: Tensor, measured: Measured) -> Tensor:
    """1 − the mean over the lines at which neither is all zero; 1 where there is no such line."""
    seen = (_kept(model, measured) != 0).any(-1).any(-1) & (measured.frf != 0).any(-1).any(-1)
    mean = torch.where(seen, criterion, 0.0).sum(-1) / seen.sum(-1).clamp(min=1)
    return (1 - mean).clamp(min=0.0)
