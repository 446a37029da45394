"""Which FRFs no fit is to see.

A fifth of them, spread over the responses and references so that each keeps some that are fitted. A single FRF, or two,
cannot spare one.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchplate.diagnosis.settings import SETTINGS


def held_out(measured: Bool[Tensor, "n_response n_reference"], seed: int = 0) -> Bool[Tensor, "n_response n_reference"]:
    """A choice of held-out FRFs; none where there are fewer than three.

    Args:
        measured: which FRFs there are.
        seed: of the choice.
    """
    heldout = torch.zeros_like(measured)
    pairs = measured.nonzero()
    if len(pairs) < SETTINGS.holding_out.few:
        return heldout
    wanted = max(1, math.floor(SETTINGS.holding_out.part * len(pairs)))
    generator = torch.Generator().manual_seed(seed)
    for j, k in pairs[torch.randperm(len(pairs), generator=generator)].tolist():
        if int(heldout.sum()) == wanted:
            break
        left = measured & ~heldout
        heldout[j, k] = _can_spare(measured, left, j, k)
    return heldout


def _can_spare(measured: Tensor, left: Tensor, j: int, k: int) -> bool:
    """Whether a fit keeps an FRF of response j and of reference k; where there is only one, it may go."""
    return bool((left[j].sum() > 1 or measured[j].sum() == 1) and (left[:, k].sum() > 1 or measured[:, k].sum() == 1))


def exchanged(
    heldout: Bool[Tensor, "n_response n_reference"],
    measured: Bool[Tensor, "n_response n_reference"],
    misfit: Float[Tensor, "n_response n_reference"],
) -> Bool[Tensor, "n_response n_reference"]:
    """The choice with outliers given back to the fit, and ordinary FRFs held out in their place.

    Args:
        heldout: the choice.
        measured: which FRFs there are.
        misfit: mean square of the residuals of each over what is expected of them, at the baseline.
    """
    middle = float(misfit[measured].median())
    odd = heldout & (misfit > SETTINGS.holding_out.outlier * max(1.0, middle))
    if not bool(odd.any()):
        return heldout
    chosen = heldout & ~odd
    spare = (measured & ~heldout).nonzero().tolist()
    order = sorted(spare, key=lambda pair: abs(float(misfit[pair[0], pair[1]]) - middle))
    for j, k in order:
        if int(chosen.sum()) == int(heldout.sum()):
            break
        chosen[j, k] = _can_spare(measured, measured & ~chosen, j, k)
    return chosen


def outliers(
    measured: Bool[Tensor, "n_response n_reference"], misfit: Float[Tensor, "n_response n_reference"]
) -> Bool[Tensor, "n_response n_reference"]:
    """FRFs that disagree with all others: so far above the median, and few.

    Args:
        measured: which FRFs there are.
        misfit: mean square of the residuals of each over what is expected of them, at the baseline.
    """
    if int(measured.sum()) < SETTINGS.holding_out.few:
        return torch.zeros_like(measured)
    odd = measured & (misfit > SETTINGS.holding_out.outlier * misfit[measured].median().clamp(min=1.0))
    return odd if int(odd.sum()) <= int(measured.sum()) / SETTINGS.holding_out.one_in else torch.zeros_like(measured)
