"""Which channels may be exchanged or turned: all pairs and all signs, scored from one matrix of products.

With m_a what was measured under a label and p_b what the model says of another, D_ab = Σ |m_a − p_b|² / σ_a² over the
lines and the other side's channels; exchanging a and b takes D_aa + D_bb − D_ab − D_ba from the sum of squares, turning
a takes Σ (|m_a − p_a|² − |m_a + p_a|²) / σ_a². So 121 references, which have 7,260 pairs, cost one product.
"""

from typing import Any, NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.settings import SETTINGS


class Channels(NamedTuple):
    """Labels of what was measured, as effects name them.

    Attributes:
        response: node labels or relative places.
        reference: likewise; empty where the base moves.
    """

    response: tuple[Any, ...]
    reference: tuple[Any, ...]


class Rearrangements(NamedTuple):
    """Exchanges and turns of channels that promise most.

    Attributes:
        swap: options of `channel_swap`, the best first.
        polarity: of `channel_polarity`.
        n_swap: how many there are in all.
        n_polarity: likewise.
    """

    swap: tuple[dict[str, Any], ...]
    polarity: tuple[dict[str, Any], ...]
    n_swap: int
    n_polarity: int


def rearrangements(
    channels: Channels,
    measured: Complex[Tensor, "n_frequency n_response n_reference"],
    predicted: Complex[Tensor, "n_frequency n_response n_reference"],
    weight: Float[Tensor, "n_frequency n_response n_reference"],
) -> Rearrangements:
    """The most promising of all exchanges of two channels, and of all turns.

    Args:
        channels: labels.
        measured: FRFs.
        predicted: the model's.
        weight: 1/σ²; 0 where an FRF was not measured.
    """
    references = channels.reference or (None,)
    n = SETTINGS.screening.n_rearranged
    found: list[tuple[float, tuple[Any, Any]]] = []
    n_swap = 0
    for side, labels in ((1, channels.response), (2, channels.reference)):
        fall = _exchanged(*(part.movedim(side, 0).flatten(1) for part in (measured, predicted, weight)))
        rows, columns = torch.triu_indices(len(labels), len(labels), 1)
        n_swap += len(rows)
        for a, b, taken in zip(rows.tolist(), columns.tolist(), fall[rows, columns].tolist(), strict=True):
            pair = (labels[a], labels[b])
            named = tuple((one, None) if side == 1 else (None, one) for one in pair)
            found.append((taken, named))  # type: ignore[arg-type]
    found.sort(key=lambda one: -one[0])
    swap = tuple({"channels": pair} for _, pair in found[:n])

    each = -4 * (weight * (measured.conj() * predicted).real).sum(0)
    turns: list[tuple[float, tuple[Any, ...]]] = [(float(each.sum()), tuple((one, None) for one in channels.response))]
    if len(channels.response) > 1:
        turns += [(float(each[j].sum()), ((one, None),)) for j, one in enumerate(channels.response)]
    if len(references) > 1:
        turns += [(float(each[:, k].sum()), ((None, one),)) for k, one in enumerate(references)]
    if min(len(channels.response), len(references)) > 1:
        turns += [
            (float(each[j, k]), ((a, b),)) for j, a in enumerate(channels.response) for k, b in enumerate(references)
        ]
    n_polarity = len(turns)
    turns.sort(key=lambda one: -one[0])
    return Rearrangements(swap, tuple({"channels": one} for _, one in turns[:n]), n_swap, n_polarity)


def _exchanged(
    measured: Complex[Tensor, "n_channel n"],
    predicted: Complex[Tensor, "n_channel n"],
    weight: Float[Tensor, "n_channel n"],
) -> Float[Tensor, "n_channel n_channel"]:
    """What each exchange takes from the sum of squares."""
    own = (weight * measured.abs().square()).sum(-1)[:, None]
    other = weight @ predicted.abs().square().mT
    product = ((weight * measured.conj()) @ predicted.mT).real
    apart = own + other - 2 * product
    straight = apart.diagonal()
    return straight[:, None] + straight - apart - apart.mT
