"""What chance alone would let the best of all effects take: a parametric bootstrap on the null.

Where nothing is missing, what is left is noise and nuisances, which are drawn many times. For each draw every effect is
scored at all its places, with the fitted parameters projected out, and the best of them counts. A name has to take more
than that does once in a hundred.

Sources: Davison and Hinkley, Bootstrap Methods and their Application (1997), ch. 4, on tests by simulation from the
fitted null; Gross and Vitells, European Physical Journal C 70 (2010) 525, on the best of many places.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.settings import SETTINGS

# A direction shorter than this part of the longest says nothing that it does not: rounding.
PARALLEL = 1e-6


def drawn(n_residual: int, n_told: int = 0, seed: int = 0) -> Float[Tensor, "n_draw n_all"]:
    """Residuals at the sharp level as chance makes them where nothing is missing: noise and nuisances whitened.

    Args:
        n_residual: how many there are.
        n_told: parameters that something is known of beforehand, each off by as much as that says.
        seed: of the draws.
    """
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(SETTINGS.screening.n_draw, n_residual + n_told, generator=generator, dtype=torch.float64)


def falls(
    change: Float[Tensor, "n_member n_residual"], draws: Float[Tensor, "n_draw n_residual"]
) -> Float[Tensor, " n_draw"]:
    """What one effect, whose members add up as parameters do, would take from the sum of squares of each draw.

    Args:
        change: of each member, freed of what the fitted parameters can do.
        draws: residuals.
    """
    size = change.norm(dim=-1)
    kept = change[size > PARALLEL * size.max().clamp(min=1e-300)]
    if not len(kept):
        return draws.new_zeros(len(draws))
    direction = kept / kept.norm(dim=-1, keepdim=True)
    left, singular, _ = torch.linalg.svd(direction.mT, full_matrices=False)
    return (draws @ left[:, singular > PARALLEL * singular[0]]).square().sum(-1)


def once_in_a_hundred(best: Float[Tensor, "n_effect n_draw"]) -> float:
    """The fall that the best of all effects exceeds in one of a hundred draws; 0 where none was scored."""
    return float(best.amax(0).quantile(1 - SETTINGS.screening.level)) if best.numel() else 0.0
