"""What chance alone would let the best of all effects take: a parametric bootstrap on the null.

Where nothing is missing, what is left is noise and nuisances, which are drawn many times. For each draw every effect is
scored at all its places, with the fitted parameters projected out, and the best of them counts. A name has to take more
than the limit of its effect, and of a hundred draws one has an effect beyond its limit. All limits stand at one
p-value: an effect with one number has a lower one than an effect that may sit anywhere.

Sources: Davison and Hinkley, Bootstrap Methods and their Application (1997), ch. 4, on tests by simulation from the
fitted null; Westfall and Young, Resampling-Based Multiple Testing (1993), ch. 2, on the least p-value of many tests;
Gross and Vitells, European Physical Journal C 70 (2010) 525, on the best of many places.
"""

from collections.abc import Iterator

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.settings import SETTINGS

# A direction shorter than this part of the longest says nothing that it does not: rounding.
PARALLEL = 1e-6


class Draws:
    """Residuals at the sharp level as chance makes them where nothing is missing: noise and nuisances whitened.

    They are made a few at a time, the same ones each time: of many FRFs all at once would be hundreds of megabytes.

    Args:
        n_residual: how many there are.
        n_told: parameters that something is known of beforehand, each off by as much as that says.
        seed: of the draws.
        n_draw: how many; left out, those of the settings.
    """

    def __init__(self, n_residual: int, n_told: int = 0, seed: int = 0, n_draw: int | None = None) -> None:
        self._n, self._seed = n_residual + n_told, seed
        self._n_draw = SETTINGS.screening.n_draw if n_draw is None else n_draw

    def __len__(self) -> int:
        return self._n_draw

    def split(self, at_once: int) -> Iterator[Float[Tensor, "n_some n_all"]]:
        """So many at a time, in their order."""
        generator = torch.Generator().manual_seed(self._seed)
        for begin in range(0, len(self), at_once):
            n_some = min(at_once, len(self) - begin)
            yield torch.randn(n_some, self._n, generator=generator, dtype=torch.float64)


def falls(
    change: Float[Tensor, "n_member n_residual"], drawn: Float[Tensor, "n_member n_draw"]
) -> Float[Tensor, " n_draw"]:
    """What one effect, whose members add up as parameters do, would take from the sum of squares of each draw.

    With D the changes of unit length and D = V S Lᵀ, that is |Lᵀ z|² of a draw z, and Lᵀ z = S⁻¹ Vᵀ (D z): the draws
    themselves are not asked for.

    Args:
        change: of each member, freed of what the fitted parameters can do.
        drawn: inner product of each with each draw.
    """
    size = change.norm(dim=-1)
    which = size > PARALLEL * size.max().clamp(min=1e-300)
    if not bool(which.any()):
        return drawn.new_zeros(drawn.shape[-1])
    left, singular, _ = torch.linalg.svd(change[which] / size[which, None], full_matrices=False)
    kept = singular > PARALLEL * singular[0]
    along = left[:, kept].mT @ (drawn[which] / size[which, None])
    return (along / singular[kept, None]).square().sum(0)


def once_in_a_hundred(best: Float[Tensor, "n_effect n_draw"]) -> float:
    """The fall that the best of all effects exceeds in one of a hundred draws; 0 where none was scored."""
    return float(best.amax(0).quantile(1 - SETTINGS.screening.level)) if best.numel() else 0.0


def limits(every: Float[Tensor, "n_effect n_draw"]) -> Float[Tensor, " n_effect"]:
    """The fall of each effect at one p-value, so low that one draw of a hundred has an effect below it.

    The p-values are those of χ² with as many degrees of freedom as an effect takes on average: exact where its numbers
    add up; where it is the best of many places, the draws say how low the p-value has to be all the same.
    """
    if not every.numel():
        return every.new_zeros(len(every))
    n_number = every.mean(1).clamp(min=1e-6).numpy()
    p_value = scipy.stats.chi2.sf(every.numpy(), n_number[:, None])
    least = torch.from_numpy(p_value).amin(0).quantile(SETTINGS.screening.level)
    return torch.from_numpy(scipy.stats.chi2.isf(float(least), n_number)).to(every)
