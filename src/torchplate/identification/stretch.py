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
YOUNG_RATIOS: Final = (0.05, 0.07, 0.1, 0.14, 0.2)
"""E_y/E_x of wood with its grain along x that are tried; their inverses, with its grain along y [-]. Wood Handbook
(FPL-GTR-190, 2010), table 5-1: softwoods 8 to 25 times as stiff along the grain as across."""
SHEAR_FACTORS: Final = (0.5, 0.7, 1.0, 1.4)
GRAINS: Final = tuple((ratio**way, shear) for way in (1, -1) for ratio in YOUNG_RATIOS for shear in SHEAR_FACTORS)
"""E_y/E_x and G over its isotropic value [-] of plates of wood that a test is held against."""
N_ELEMENT: Final = 80
"""Of a mesh that tells the order of the modes, and no more."""
MOST_FRFS: Final = 16
N_MODE: Final = 40
POWER: Final = {"receptance": 0, "mobility": 1, "accelerance": 2}


class Stretch(NamedTuple):
    """What the models make of a test.

    Attributes:
        factor: On all natural frequencies of each model, where it is nearest to the test [-].
        left: Variance of the FRFs' decibels that it leaves then, as a part of what one level for all leaves [-].
        n_peak: Peaks of the test in the band that was looked at.
        level: The test's level over each model's there, both in SI units [-].
        tried: All factors that each model was held against the test with [-], and `left_by` what each leaves [-].
    """

    factor: Float[Tensor, " n_model"]
    left: Float[Tensor, " n_model"]
    n_peak: int
    level: Float[Tensor, " n_model"]
    tried: Float[Tensor, "n_model n_tried"]
    left_by: Float[Tensor, "n_model n_tried"]

    def left_within(self, low: float, high: float) -> Float[Tensor, " n_model"]:
        """The least that factors from `low` to `high` leave [-]; infinite where none was tried."""
        inside = (self.tried >= low) & (self.tried <= high)
        return torch.where(inside, self.left_by, torch.inf).amin(-1)


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
    factors, variances, levels = [], [], []
    for hertz, parts in zip(frequency, residue, strict=True):
        # The first mode at the first peak is where the factor counts from.
        begin = seen[0] / float(hertz[n_rigid])
        pole = (begin * hertz).square() * complex(1, LOSS)
        frf = (1 / (pole - lines.square()[:, None])) @ parts.to(pole.dtype)
        level = 20 * frf.abs().clamp(min=1e-300).log10() + 20 * POWER[cut.kind] * lines.log10()[:, None]
        variance = _variance_apart(measured, level)
        variances.append(variance / max(total, 1e-300))
        factors.append(begin * (STEP * (shift - torch.arange(len(variance), dtype=torch.float64))).exp())
        nearest = int(variance.argmin())
        levels.append(float((measured - level[nearest : nearest + len(grid)]).median()))
    tried, left_by = torch.stack(factors), torch.stack(variances)
    best = left_by.argmin(-1, keepdim=True)
    # Poles are in Hz² and the lines of a kind in Hz to its power, where the FRFs have rad/s.
    scale = (2 * math.pi) ** (2 - POWER[cut.kind])
    return Stretch(
        factor=tried.gather(-1, best)[:, 0],
        left=left_by.gather(-1, best)[:, 0],
        n_peak=sum(peak <= top for peak in seen),
        level=scale * 10 ** (torch.tensor(levels, dtype=torch.float64) / 20),
        tried=tried,
        left_by=left_by,
    )


def _variance_apart(
    measured: Float[Tensor, "n_grid n_pair"], level: Float[Tensor, "n_line n_pair"]
) -> Float[Tensor, " n_tried"]:
    """Variance of `measured` − `level` over all lines and pairs, wherever the former fits into the latter.

    Its squares are written out: those of each are sums over a window that moves on, their products a correlation. Both
    are taken from their means, so that squares of levels do not hide those of what parts them.
    """
    n_grid, n_line = len(measured), len(level)
    moved, other = measured - measured.mean(), level - level.mean()
    product = torch.fft.irfft(
        (torch.fft.rfft(other, dim=0) * torch.fft.rfft(moved, n=n_line, dim=0).conj()).sum(1), n=n_line
    )
    sums = torch.nn.functional.pad(torch.stack([other.sum(1), other.square().sum(1)]).cumsum(1), (1, 0))
    first, second = sums[:, n_grid:] - sums[:, :-n_grid]
    square = moved.square().sum() - 2 * product[: len(first)] + second
    return (square / moved.numel() - (first / moved.numel()).square()).clamp(min=0)


def coarse_cells(length_x: float, length_y: float) -> tuple[int, int]:
    """Elements along each side of a mesh that is good enough to be held against a test."""
    n_x = min(max(round(math.sqrt(N_ELEMENT * length_x / length_y)), 6), N_ELEMENT // 6)
    return n_x, N_ELEMENT // n_x


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
