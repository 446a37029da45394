"""A rational fit without the poles that stand for a line or two alone.

A line of heavy noise is worth a pole to the fit, so that it does not bend the others. It is no resonance: it moves with
no drift of a record, and no line need be looked at for it. Such poles are less round than resonances, and other lines
show no more of them than of noise; those that show least go first, for of two at one place each says what the other
does. The residues of the rest are fitted again, the lines of those that went weighing the less the more is left there.

Sources: Cook, Detection of influential observation in linear regression, Technometrics 19 (1977) 15, for a fit without
some of its lines; backward elimination as in Draper and Smith, Applied Regression Analysis (1998), chapter 15.
"""

import copy
import math
from typing import Final

import torch
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor

from torchplate.measurement.assessment.rational_fit import EXCESS, N_ROUND, RationalFit

# Lines that the fraction of an outlier stands out at: its own, or those on either side of it.
N_ALONE: Final = 2
# Line spacings within which one pole may stand for another.
NEAR: Final = 3.0
# Chance that an outlier passes for a resonance anywhere in a test.
CHANCE: Final = 0.05
# Part of the middle one of the resonances' loss factors from which on a pole may be one [-]: few modes are damped less.
ROUND: Final = 0.5
# Fits in which lines that stand out come to weigh less.
N_WEIGHED: Final = 3


def without_outliers(fit: RationalFit, variance: Float[Tensor, "n_line n_frf"]) -> RationalFit:
    """The fit of the resonances, their poles where they are.

    Args:
        fit: with all poles that the lines show.
        variance: of the real and of the imaginary part of the FRFs of the fit.
    """
    found, usual, place = copy.copy(fit), fit.weight, fit.pole.real.clamp(min=0.0).sqrt()
    n_line, n_frf = variance.shape
    kept = torch.ones_like(place, dtype=torch.bool)
    highest = _highest(fit.pole, fit.frequency)
    left = _fitted(found, fit.pole, kept, usual, highest, variance)
    sure = _rounded(fit, beyond(found, variance) > _by_chance(n_line, n_frf))
    # Where lines stand out, as where one is worth a pole: upper tail of the mean of n exponentials.
    bound = math.log(n_line / CHANCE) / n_frf
    high = 1 + math.sqrt(2 * bound) + bound + EXCESS
    near = (place[:, None] - place).abs() <= NEAR * fit.step
    about = (place[:, None] - fit.frequency).abs() <= NEAR * fit.step
    for _ in range(N_ROUND):
        shown = torch.full_like(place, math.inf)
        shown[kept] = beyond(found, variance)
        fails = (shown <= _by_chance(n_line, n_frf)) & ~sure
        if not bool(fails.any()):
            break
        drop = fails & (shown <= torch.where(near & fails, shown, math.inf).amin(1))
        after = _fitted(found, fit.pole, kept & ~drop, usual, highest, variance)
        stands = (after > high) & (left <= high)
        stands[highest[~kept | drop].flatten()] = False
        # One without which others of the lines about it stand out is none.
        sure = sure | (drop & (about & stands).any(1))
        kept = kept & ~(drop & ~sure)
        left = _fitted(found, fit.pole, kept, usual, highest, variance)
    return found


def lone_lines(fit: RationalFit, sound: RationalFit) -> Bool[Tensor, " n_line"]:
    """The lines at which poles are highest that are no resonances, but for the ends: the next may lie beyond.

    Args:
        fit: with all poles.
        sound: without them.
    """
    found = torch.zeros(len(fit.frequency), dtype=torch.bool)
    found[_highest(fit.pole[(fit.pole[:, None] != sound.pole).all(dim=1)], fit.frequency).flatten()] = True
    found[[0, -1]] = False
    return found


def _by_chance(n_line: int, n_frf: int) -> float:
    """What other lines show of an outlier at most, wherever it stands: χ² of 2 n_frf degrees of freedom, halved."""
    from scipy.special import gammainccinv  # here: half of what importing this package takes

    return float(gammainccinv(n_frf, CHANCE / n_line))


def _rounded(fit: RationalFit, shown: Bool[Tensor, " n_pole"]) -> Bool[Tensor, " n_pole"]:
    """Poles that are as round as resonances, or that more lines show than one or two.

    Records that drift from each other have a resonance each: one alone hardly shows beside the others.

    Args:
        fit: with all poles.
        shown: those that other lines show.
    """
    place, loss = fit.pole.real.clamp(min=0.0).sqrt(), fit.pole.imag / fit.pole.real.clamp(min=1e-300)
    inside = (place >= fit.frequency[0]) & (place <= fit.frequency[-1]) & shown
    usual = float(loss[inside].median()) if bool(inside.any()) else math.inf
    return (loss >= ROUND * usual) | (fit.pole.imag >= 2 * place * fit.step)


def _highest(pole: Complex[Tensor, " n_pole"], line: Float[Tensor, " n_line"]) -> Int[Tensor, "n_pole n_alone"]:
    """The lines at which each pole is highest."""
    height = 1 / (pole[:, None] - line.square()).abs()
    return height.topk(min(N_ALONE, len(line)), dim=1).indices


def _fitted(
    found: RationalFit, poles: Tensor, kept: Tensor, usual: Tensor, highest: Tensor, variance: Tensor
) -> Float[Tensor, " n_line"]:
    """Fit the residues of the poles that are kept; mean squares of what is left over their variances.

    Lines at which the others are highest weigh as if their noise were as large as what is left there.
    """
    out = torch.zeros_like(usual, dtype=torch.bool)
    out[highest[~kept].flatten()] = True
    left = torch.ones_like(usual)
    found.pole = poles[kept]
    for _ in range(N_WEIGHED):
        found.weight = torch.where(out, usual / left.clamp(min=1.0).sqrt(), usual)
        found.target = found.frf * found.weight[:, None]
        found.settle(0)
        off = found.residual / found.weight[:, None]
        left = (off.abs().square() / (2 * variance).clamp(min=1e-300)).mean(1)
    return left


def beyond(fit: RationalFit, variance: Float[Tensor, "n_line n_frf"]) -> Float[Tensor, " n_pole"]:
    """How much of each pole other lines show than those where it is highest: 1 for each FRF where they show none.

    Without these lines, and the other poles where they are, residues are fitted again: the squares of the pole's over
    their variances, summed over the FRFs.

    Args:
        fit: of FRFs.
        variance: of their real and of their imaginary part.
    """
    basis, n_pole = fit.final, len(fit.pole)
    back = torch.linalg.inv(basis.upper)[:n_pole]
    spread, found = 2 * fit.weight.square()[:, None] * variance, variance.new_zeros(n_pole)
    for k, lines in enumerate(_highest(fit.pole, fit.frequency)):
        rows = basis.q[lines]
        # (QᴴQ)⁻¹ without these rows of Q, by Woodbury.
        left = torch.linalg.pinv(torch.eye(len(rows)).to(rows) - rows @ rows.mH, hermitian=True)
        pull = (back[k] + (back[k] @ rows.mH) @ left @ rows) @ basis.q.mH
        pull[lines] = 0.0
        expected = (pull.abs().square() @ spread).clamp(min=1e-300)
        found[k] = ((pull @ fit.target).abs().square() / expected).sum()
    return found
