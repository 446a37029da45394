"""Which coordinates of a trial come from the donor.

Source: Storn and Price (1997), J. Global Optimization 11, 341-359; seed paper, Eq. 4 (binomial).
"""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchplate.search.draws import Draw


def binomial(
    uniform: Float[Tensor, "*batch n_member n_dimension"],
    start: Int[Tensor, "*batch n_member 1"],
    rate: Float[Tensor, "*#batch #n_member 1"],
) -> Bool[Tensor, "*batch n_member n_dimension"]:
    """Each coordinate by itself: j from the donor where u_j < CR or j = j_rand.

    Args:
        uniform: u, a uniform number per coordinate.
        start: j_rand, the coordinate that comes from the donor whatever CR is.
        rate: CR, in [0, 1].
    """
    return (uniform < rate) | (_axis(uniform) == start)


def exponential(
    uniform: Float[Tensor, "*batch n_member n_dimension"],
    start: Int[Tensor, "*batch n_member 1"],
    rate: Float[Tensor, "*#batch #n_member 1"],
) -> Bool[Tensor, "*batch n_member n_dimension"]:
    """A cyclic run: from j_rand onwards, one coordinate more for as long as u < CR.

    Args:
        uniform: u; the k-th decides whether the run grows past its k-th coordinate, the last one is not used.
        start: j_rand, where the run starts.
        rate: CR, in [0, 1].
    """
    n_dimension = uniform.shape[-1]
    grows = (uniform[..., : n_dimension - 1] < rate).to(torch.int64)
    length = 1 + grows.cumprod(dim=-1).sum(dim=-1, keepdim=True)
    return (_axis(uniform) - start) % n_dimension < length


def _axis(uniform: Tensor) -> Tensor:
    return torch.arange(uniform.shape[-1], device=uniform.device)


Crossover = Callable[[Tensor, Tensor, Tensor], Tensor]
CROSSOVERS: dict[str, Crossover] = {"bin": binomial, "exp": exponential}
"""The two classic crossovers by the names the field gives them."""


def crossed(
    crossover: Crossover,
    target: Float[Tensor, "*batch n_member n_dimension"],
    donor: Float[Tensor, "*batch n_member n_dimension"],
    rate: Float[Tensor, "*#batch #n_member 1"],
    generator: torch.Generator,
) -> Float[Tensor, "*batch n_member n_dimension"]:
    """Trials: the donor's coordinates where the crossover says so, the target's elsewhere."""
    shape: Sequence[int] = target.shape
    draw = Draw(generator, target)
    start = draw.below(shape[-1], (*shape[:-1], 1))
    uniform = draw.uniform(shape)
    return torch.where(crossover(uniform, start, rate), donor, target)
