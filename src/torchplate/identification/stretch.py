"""By which factor a model's natural frequencies meet those of a test: a guess before any search, level and loss open.

All natural frequencies of a plate go with h√(E/ρ), so its FRF in decibel over log f is moved along and else stays as it
is. So one eigenproblem tells a model at every h√(E/ρ), and models whose modes lie in another order leave more.
"""

import math
from typing import Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.measurement import Measurement, Placement, peaks
from torchplate.model import PlateModel, modes_at

STEP: Final = 0.01
"""Of log f [-]: a coarse mesh moves natural frequencies by as much."""
LOSS: Final = 0.03
"""Loss factor that all modes are drawn with [-]: peaks as broad as three steps are met by one."""
REACH: Final = 8.0
"""The first mode is looked for within this factor of the first peak, up and down [-]."""
MOST_PEAKS: Final = 12
"""The band ends behind so many peaks: above, modes lie too close to be told apart."""
LEAST_PEAKS: Final = 3
"""Fewer tell no order."""
SWING: Final = 4.0
"""A free plate's modes lie nearer to each other than by this factor [-]: a strip's first two, which are the farthest
apart, by 2.76. So what lies below such a gap is the plate on its cords."""
N_SWING: Final = 6
"""Rigid-body modes of a plate on cords, at most."""
MOST_FRFS: Final = 16
N_MODE: Final = 40
POWER: Final = {"receptance": 0, "mobility": 1, "accelerance": 2}


class Stretch(NamedTuple):
    """What the models make of a test.

    Attributes:
        factor: On all natural frequencies of each model, where it is nearest to the test [-].
        left: Variance of the FRFs' decibels that it leaves then, as a part of what one level for all leaves [-].
        n_peak: Peaks of the test in the band that was looked at.
    """

    factor: Float[Tensor, " n_model"]
    left: Float[Tensor, " n_model"]
    n_peak: int


@torch.no_grad()
def stretched(
    model: PlateModel, theta: Float[Tensor, "n_model n_parameter"], measurement: Measurement, places: Placement
) -> Stretch | None:
    """Hold models of one plate against a test; None where the test has too few peaks, or no force.

    Args:
        model: Whose natural frequencies scale together: without springs.
        theta: Of each model, in SI units.
        measurement: Whose FRFs are looked at.
        places: Where its channels are.
    """
    bottom, seen = float(measurement.frequency[measurement.frequency > 0][0]), list(peaks(measurement))
    if all(condition == "free" for condition in model.mesh.edges.values()):
        bottom, seen = _above_swinging(bottom, seen)
    if len(seen) < LEAST_PEAKS or measurement.kind not in POWER:
        return None
    top = 1.1 * seen[min(len(seen), MOST_PEAKS) - 1]
    cut = measurement.band(bottom, top)
    pairs = [(j, k) for j, k in cut.pairs if bool((cut.frf[:, j, k].abs() > 0).all())]
    pairs = pairs[:: -(-len(pairs) // MOST_FRFS)] if pairs else []
    low, high = math.log(float(cut.frequency[0])), math.log(float(cut.frequency[-1]))
    if not pairs or high - low < 10 * STEP:
        return None
    grid = torch.arange(low, high, STEP, dtype=torch.float64)
    measured = _decibel(cut, pairs, grid)
    ends = [*places.response, *places.reference]
    frequency, shape = modes_at(model, theta, torch.tensor([end.place for end in ends], dtype=torch.float64), N_MODE)
    n_rigid = int((frequency[0] < 1e-3 * frequency[0, -1]).sum())
    response = shape[..., [j for j, _ in pairs]]
    residue = response * shape[..., [len(places.response) + k for _, k in pairs]]
    shift = round(math.log(REACH) / STEP)
    lines = (low + STEP * torch.arange(-shift, len(grid) + shift, dtype=torch.float64)).exp()
    total = float((measured - measured.mean()).square().mean())
    factor, left = [], []
    for hertz, parts in zip(frequency, residue, strict=True):
        # The first mode at the first peak is where the factor counts from.
        begin = seen[0] / float(hertz[n_rigid])
        pole = (begin * hertz).square() * complex(1, LOSS)
        frf = (1 / (pole - lines.square()[:, None])) @ parts.to(pole.dtype)
        level = 20 * frf.abs().clamp(min=1e-300).log10() + 20 * POWER[cut.kind] * lines.log10()[:, None]
        apart = measured.mT - level.unfold(0, len(grid), 1)
        variance = (apart - apart.mean((1, 2), keepdim=True)).square().mean((1, 2))
        best = int(variance.argmin())
        factor.append(begin * math.exp(STEP * (shift - best)))
        left.append(float(variance[best]) / max(total, 1e-300))
    n_peak = sum(peak <= top for peak in seen)
    return Stretch(torch.tensor(factor, dtype=torch.float64), torch.tensor(left, dtype=torch.float64), n_peak)


def _above_swinging(bottom: float, seen: list[float]) -> tuple[float, list[float]]:
    """From where on a plate on cords bends [Hz], and its peaks from there on."""
    for turn in range(min(N_SWING, len(seen) - 1), 0, -1):
        if seen[turn] > SWING * seen[turn - 1]:
            return math.sqrt(seen[turn] * seen[turn - 1]), seen[turn:]
    return bottom, seen


def _decibel(cut: Measurement, pairs: list[tuple[int, int]], grid: Tensor) -> Float[Tensor, "n_grid n_pair"]:
    """Mean decibels of each FRF between the middles of the grid's steps."""
    lines = cut.frequency.numpy()
    level = np.stack([20 * np.log10(np.abs(cut.frf[:, j, k].numpy())) for j, k in pairs], axis=1)
    area = np.concatenate(
        [np.zeros((1, len(pairs))), np.cumsum(np.diff(lines)[:, None] * (level[1:] + level[:-1]) / 2, 0)]
    )
    ends = [np.clip(np.exp(grid.numpy() + half), lines[0], lines[-1]) for half in (-STEP / 2, STEP / 2)]
    under, over = (np.stack([np.interp(end, lines, one) for one in area.T], axis=1) for end in ends)
    return torch.from_numpy((over - under) / (ends[1] - ends[0])[:, None])
