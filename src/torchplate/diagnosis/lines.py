"""Which lines of a large test are looked at: all of them would say no more."""

from dataclasses import replace

import torch
from jaxtyping import Int
from torch import Tensor

from torchplate.diagnosis.target import FrfTarget


def about_peaks(target: FrfTarget, n_mode: int) -> FrfTarget:
    """The same at fewer lines, where all of them say no more: evenly over the band, and about the peaks.

    Args:
        target: at all lines.
        n_mode: modes of the model in the band: ten lines are kept for each, or for each resonance that was found,
            which drifts from record to record may have doubled.
    """
    lines, n, resonances = target.settings.lines, len(target.frequency), target.noise.resonances
    seen = 0 if resonances is None else int(resonances.resonates.sum())
    least = lines.per_mode * min(seen, n_mode) or lines.least
    wanted = max(least, lines.most_numbers // (2 * len(target.measurement.pairs)))
    if wanted >= n:
        return target
    if resonances is None or not seen:
        return every_nth(target, n // wanted)
    return at_lines(target, resonances.spread(target.frequency, wanted))


def every_nth(target: FrfTarget, step: int) -> FrfTarget:
    """The same at every `step`-th line, the first among them."""
    return target if step == 1 else at_lines(target, torch.arange(0, len(target.frequency), step))


def at_lines(target: FrfTarget, index: Int[Tensor, " n_kept"]) -> FrfTarget:
    """The same at some of the lines, each of which stands for those that are nearer to it than to another."""
    if len(index) == len(target.frequency):
        return target
    shift, variance = (None if one is None else one[index] for one in (target.mesh_shift, target.model_variance))
    between = 0.5 * (target.frequency[index[1:]] + target.frequency[index[:-1]])
    share = torch.zeros(len(index)).to(target.frequency)
    share.index_add_(0, torch.searchsorted(between, target.frequency), target.share)
    return replace(
        target,
        measurement=target.measurement.at_lines(index),
        noise=target.noise.at_lines(index),
        mesh_shift=shift,
        model_variance=variance,
        stands_for=share,
        whole=target.whole or target,
    )
