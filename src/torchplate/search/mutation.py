"""Donor vectors of Differential Evolution, one formula per name, and the distinct indices they need.

Source: Storn and Price (1997), "Differential Evolution", J. Global Optimization 11, 341-359; Price, Storn and
Lampinen (2005), "Differential Evolution: A Practical Approach to Global Optimization"; seed paper, Eq. 2-3.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor


class Mutation(NamedTuple):
    """A donor formula of the target x, the best member b, distinct members r and the weight F.

    Attributes:
        n_index: How many distinct members the formula needs.
        formula: (x, b, r, F) → donors, x of shape [*batch, n_member, n_dimension].
    """

    n_index: int
    formula: Callable[[Tensor, Tensor, Sequence[Tensor], Tensor], Tensor]


MUTATIONS: dict[str, Mutation] = {
    "rand/1": Mutation(3, lambda _x, _b, r, F: r[0] + F * (r[1] - r[2])),
    "best/1": Mutation(2, lambda _x, b, r, F: b + F * (r[0] - r[1])),
    "rand/2": Mutation(5, lambda _x, _b, r, F: r[0] + F * (r[1] - r[2]) + F * (r[3] - r[4])),
    "best/2": Mutation(4, lambda _x, b, r, F: b + F * (r[0] - r[1]) + F * (r[2] - r[3])),
    "current-to-best/1": Mutation(2, lambda x, b, r, F: x + F * (b - x) + F * (r[0] - r[1])),
}
"""The five classic schemes. r[0] is the paper's x_r1, and so on; all differ from each other and from the
target."""


def distinct_indices(
    batch_shape: Sequence[int],
    n_member: int,
    n_index: int,
    generator: torch.Generator,
) -> Int[Tensor, "n_index *batch n_member"]:
    """For each member i, `n_index` members drawn evenly from those that are neither i nor drawn already.

    The j-th draw is a number below n_member − 1 − j, moved up once past every index that is taken, in
    ascending order: exact without rejection, so that the amount of randomness used depends on no value.

    Args:
        batch_shape: Shape of the searches.
        n_member: Size of the population, at least n_index + 1.
        n_index: Indices wanted for each member.
        generator: Source of randomness; its device is that of the result.
    """
    shape = (*batch_shape, n_member)
    taken = torch.arange(n_member, device=generator.device).expand(shape).unsqueeze(0)
    drawn = []
    for j in range(n_index):
        index = torch.randint(n_member - 1 - j, shape, generator=generator, device=generator.device)
        for other in taken.sort(dim=0).values:
            index = index + (index >= other).to(index.dtype)
        drawn.append(index)
        taken = torch.cat((taken, index.unsqueeze(0)))
    return torch.stack(drawn)


def donors(
    mutation: Mutation,
    population: Float[Tensor, "*batch n_member n_dimension"],
    best: Float[Tensor, "*batch n_dimension"],
    weight: Float[Tensor, "*#batch #n_member 1"],
    generator: torch.Generator,
) -> Float[Tensor, "*batch n_member n_dimension"]:
    """One donor for each member by the given formula.

    Args:
        mutation: The formula.
        population: The members.
        best: The best member of each search.
        weight: Differential weight F of each member.
        generator: Source of randomness.
    """
    *batch_shape, n_member, _ = population.shape
    index = distinct_indices(batch_shape, n_member, mutation.n_index, generator)
    chosen = [torch.take_along_dim(population, one.unsqueeze(-1), dim=-2) for one in index]
    return mutation.formula(population, best.unsqueeze(-2), chosen, weight)
