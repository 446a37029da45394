"""The two numbers of a noise, regressed on squares whose expectation they make.

A residual's square is exponential about σ² = a + b |H|², a ≥ 0 of the sensor and b ≥ 0 in proportion to the signal;
far squares are clipped, for a line that no pole explains is no noise.

Sources: Rocke and Lorenzato, Technometrics 37 (1995), for the two components.
"""

import math
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

# Squares above this many times their expectation count as this: a line that no pole explains is no noise.
CLIP: Final = 6.0
# What a second number must lower twice the negative log-likelihood by to weigh as much as the first alone.
PRICE: Final = 2.0
# Scoring steps of a noise level.
N_SCORE: Final = 12


def likelihood_cost(
    square: Float[Tensor, "n_line n_frf"], design: Float[Tensor, "n_line n_frf 2"], level: Float[Tensor, "n_frf 2"]
) -> Float[Tensor, " n_frf"]:
    """Twice the negative log-likelihood of exponential squares, far ones clipped."""
    expected = expected_square(design, level)
    return 2 * (expected.log() + (square / expected).clamp(max=CLIP)).sum(0)


def regressed(
    square: Float[Tensor, "n_line n_frf"], design: Float[Tensor, "n_line n_frf 2"]
) -> tuple[Float[Tensor, "n_frf 2"], Float[Tensor, " n_frf"]]:
    """a, b ≥ 0 of each FRF, by the likelihood of exponential squares, and its cost.

    a alone, b alone and both are averaged, each with the weight exp(−cost / 2), where both pay for the second number
    (Akaike), because what is not negative is biased upward: to choose would be to claim that there is no b where a few
    lines on a peak cannot tell (Buckland, Burnham and Augustin, Biometrics 53, 1997).
    """
    levels, costs = [], []
    for parts, price in (((True, False), 0.0), ((False, True), 0.0), ((True, True), PRICE)):
        levels.append(likeliest(square, design, parts))
        costs.append(likelihood_cost(square, design, levels[-1]) + price)
    weight = (-0.5 * torch.stack(costs)).softmax(0)
    level = (weight[..., None] * torch.stack(levels)).sum(0)
    return level, likelihood_cost(square, design, level)


def likeliest(square: Tensor, design: Tensor, parts: tuple[bool, bool]) -> Tensor:
    """Σ level · design = E[square], level ≥ 0: the scoring steps of the exponential likelihood, regressions over μ²."""
    first, second = design[..., 0], design[..., 1]
    start = square.median(0).values / math.log(2)
    level = torch.stack([start / first.median(0).values.clamp(min=1e-30), torch.zeros_like(start)], dim=-1)
    if not parts[0]:
        ratio = (square / second.clamp(min=1e-30)).median(0).values / math.log(2)
        level = torch.stack([torch.zeros_like(ratio), ratio], dim=-1)
    for _ in range(N_SCORE):
        expected = expected_square(design, level)
        clipped = torch.minimum(square, CLIP * expected) / ((1 - math.exp(-CLIP)) * expected)
        one, two = first / expected, second / expected
        both, left, right = (one * two).sum(0), one.square().sum(0), two.square().sum(0)
        to_one, to_two = (one * clipped).sum(0), (two * clipped).sum(0)
        alone = torch.stack([to_one / left.clamp(min=1e-300), to_two / right.clamp(min=1e-300)], dim=-1)
        if parts[0] and parts[1]:
            determinant = (left * right - both.square()).clamp(min=1e-12 * left * right)
            joint = torch.stack([right * to_one - both * to_two, left * to_two - both * to_one], dim=-1)
            better = alone[:, 0] * to_one >= alone[:, 1] * to_two
            single = alone * torch.stack([better, ~better], dim=-1)
            level = torch.where((joint >= 0).all(-1, keepdim=True), joint / determinant[:, None], single)
        else:
            level = alone * alone.new_tensor(parts)
    return level


def times_expected(
    square: Float[Tensor, "n_line n_frf"], expected: Float[Tensor, "n_line n_frf"]
) -> Float[Tensor, " n_frf"]:
    """The factor on the expectation that is the likeliest, far squares clipped."""
    ratio = square / expected
    factor = ratio.median(0).values / math.log(2)
    for _ in range(N_SCORE):
        factor = torch.minimum(ratio, CLIP * factor).mean(0) / (1 - math.exp(-CLIP))
    return factor


def expected_square(design: Tensor, level: Tensor) -> Tensor:
    """A of each line's first column and b of its second."""
    return (design[..., 0] * level[:, 0] + design[..., 1] * level[:, 1]).clamp(min=1e-30)
