"""L-SHADE: success-history adaptive Differential Evolution with linear population size reduction.

Source: Tanabe and Fukunaga (2014), "Improving the search performance of SHADE using linear population size
reduction", IEEE CEC, 1658-1665; mutation and archive: Zhang and Sanderson (2009), "JADE", IEEE Trans.
Evolutionary Computation 13, 945-958.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchplate.search.bounds import BOUNDS
from torchplate.search.crossover import binomial, crossed
from torchplate.search.draws import Draw
from torchplate.search.mutation import distinct_indices
from torchplate.search.optimizer import (
    Candidates,
    Optimizer,
    best_member,
    members,
    unknown_name,
    without_nan,
)

TERMINAL = -1.0
"""Marks a memory of CR that has ended: once only CR = 0 succeeded, CR stays 0 there.

As a mean it lies ten deviations below 0, so that every CR drawn around it is cut to 0.
"""


class LShadeState(NamedTuple):
    """Members, archive and the memory of what succeeded.

    Attributes:
        population: The members; fewer as the budget is spent.
        fitness: Their objective.
        archive: Members that were beaten lately; filled from the front.
        n_archived: Places of the archive in use.
        memory_weight: Means of F that succeeded.
        memory_rate: Means of CR that succeeded, or TERMINAL.
        slot: The place in memory that is written next.
        trial_weight: F under trial between ask and tell.
        trial_rate: CR under trial.
        n_evaluation: Evaluations of a search that is still running; shared by all searches.
    """

    population: Float[Tensor, "*batch n_member n_dimension"]
    fitness: Float[Tensor, "*batch n_member"]
    archive: Float[Tensor, "*batch n_place n_dimension"]
    n_archived: Int[Tensor, "*batch"]
    memory_weight: Float[Tensor, "*batch n_memory"]
    memory_rate: Float[Tensor, "*batch n_memory"]
    slot: Int[Tensor, "*batch"]
    trial_weight: Float[Tensor, "*batch n_member"]
    trial_rate: Float[Tensor, "*batch n_member"]
    n_evaluation: Int[Tensor, ""]

    @property
    def best_position(self) -> Float[Tensor, "*batch n_dimension"]:
        """The best place seen so far; neither selection nor reduction loses it."""
        return best_member(self.population, self.fitness)

    @property
    def best_objective(self) -> Float[Tensor, "*batch"]:
        """The objective at the best place."""
        return self.fitness.amin(dim=-1)


@dataclass(frozen=True)
class LShade(Optimizer[LShadeState], name="l_shade"):
    """current-to-pbest/1/bin with an archive; F and CR from a memory of successes; the population shrinks.

    v_i = x_i + F_i (x_pbest − x_i) + F_i (x_r1 − x_r2), pbest one of the best `best_share` of the members, r1
    a member, r2 a member or an archived one. F_i ~ Cauchy(M_F, 0.1), drawn again while ≤ 0 and cut to 1; CR_i
    ~ N(M_CR, 0.1) cut to [0, 1]; M from a random place of the memory. A place is rewritten each generation
    that has successes, with Σ w S² / Σ w S, w in proportion to the improvement. After e of E evaluations the
    best round(n_member + (n_least − n_member) e / E) members stay. All searches of a batch shrink alike,
    those that have stopped too (they keep their best members).

    Args:
        n_member: Initial size of the population; the paper has 18 per dimension (the default: four
            dimensions).
        n_least: Final size, at least 4.
        n_memory: Places in the memory H.
        best_share: p, the share of the members that counts as best, in (0, 1].
        archive_ratio: Size of the archive over that of the population.
        shrink_over: E, the evaluations over which the population shrinks; `minimize` fills in its budget if
            left out, and without either the population keeps its size.
        bound: One of `BOUNDS`; the default is the paper's.

    Raises:
        ValueError: A setting is outside its range.
    """

    n_member: int = 72
    n_least: int = 4
    n_memory: int = 6
    best_share: float = 0.11
    archive_ratio: float = 2.6
    shrink_over: int | None = None
    bound: str = "midpoint"

    state_type: ClassVar = LShadeState

    def __post_init__(self) -> None:
        if self.bound not in BOUNDS:
            raise ValueError(unknown_name("bound", self.bound, BOUNDS))
        if self.n_least < 4:
            raise ValueError(
                f"n_least must be at least 4, got {self.n_least}. Raise it: the mutation needs three others."
            )
        if self.n_member < self.n_least:
            raise ValueError(
                f"l_shade needs n_member of at least n_least = {self.n_least}, got {self.n_member}. "
                f"Raise it: 18 per dimension is usual."
            )
        if self.n_memory < 1:
            raise ValueError(f"n_memory must be at least 1, got {self.n_memory}. The paper has 6.")
        if not 0.0 < self.best_share <= 1.0:
            raise ValueError(f"best_share must lie in (0, 1], got {self.best_share}. The paper has 0.11.")
        if self.archive_ratio < 1.0:
            raise ValueError(f"archive_ratio must be at least 1, got {self.archive_ratio}. The paper has 2.6.")

    def planned(self, n_evaluation: int | None, n_generation: int | None) -> "LShade":
        """Shrink over the budget, whichever ends first.

        A population that shrinks by dN/dg = −(N_0 − N_min) N / E reaches N_min after G generations with
        E = G (N_0 − N_min) / ln(N_0 / N_min).
        """
        if self.shrink_over is not None:
            return self
        ends = [] if n_evaluation is None else [n_evaluation]
        if n_generation is not None and self.n_member > self.n_least:
            mean_size = (self.n_member - self.n_least) / math.log(self.n_member / self.n_least)
            ends.append(self.n_member + round(n_generation * mean_size))
        return replace(self, shrink_over=min(ends)) if ends else self

    def init(
        self,
        population: Float[Tensor, "*batch n_member n_dimension"],
        fitness: Float[Tensor, "*batch n_member"],
    ) -> LShadeState:
        """Start from a population whose fitness is known, with all memories at 0.5."""
        fitness = without_nan(fitness)
        *batch_shape, n_member, n_dimension = population.shape
        memory = fitness.new_full((*batch_shape, self.n_memory), 0.5)
        none = torch.zeros(tuple(batch_shape), dtype=torch.int64, device=fitness.device)
        return LShadeState(
            population=population,
            fitness=fitness,
            archive=population.new_zeros((*batch_shape, self._n_place(n_member), n_dimension)),
            n_archived=none,
            memory_weight=memory,
            memory_rate=memory,
            slot=none,
            trial_weight=torch.zeros_like(fitness),
            trial_rate=torch.zeros_like(fitness),
            n_evaluation=torch.tensor(n_member, device=fitness.device),
        )

    def ask(self, state: LShadeState, generator: torch.Generator) -> tuple[Candidates, LShadeState]:
        """One trial for each member. The archive is shuffled, so that `tell` drops its members at random."""
        target = state.population
        *batch_shape, n_member, _ = target.shape
        draw = Draw(generator, target)
        state = _shuffled(state, draw.uniform(state.archive.shape[:-1]))

        place_in_memory = draw.below(self.n_memory, state.fitness.shape)
        weight = positive_cauchy(
            torch.take_along_dim(state.memory_weight, place_in_memory, dim=-1),
            draw.uniform(state.fitness.shape),
        )
        rate_mean = torch.take_along_dim(state.memory_rate, place_in_memory, dim=-1)
        rate = (rate_mean + 0.1 * draw.normal(state.fitness.shape)).clamp(0.0, 1.0)

        n_best = max(2, round(self.best_share * n_member))
        rank = draw.below(n_best, state.fitness.shape)
        best = members(target, torch.take_along_dim(state.fitness.argsort(dim=-1, stable=True), rank, dim=-1))
        r1 = distinct_indices(batch_shape, n_member, 1, generator)[0]
        r2 = _in_union(r1, n_member + state.n_archived, draw.uniform(state.fitness.shape))
        union = torch.cat((target, state.archive), dim=-2)

        step = weight.unsqueeze(-1)
        donor = target + step * (best - target) + step * (members(target, r1) - members(union, r2))
        trial = crossed(binomial, target, donor, rate.unsqueeze(-1), generator)
        trial = BOUNDS[self.bound](trial, target, generator)
        active = torch.ones_like(state.fitness, dtype=torch.bool)
        return Candidates(trial, active), state._replace(trial_weight=weight, trial_rate=rate)

    def tell(
        self, state: LShadeState, candidates: Candidates, fitness: Float[Tensor, "*batch n_member"]
    ) -> LShadeState:
        """Select, archive the beaten, learn from the successes, shrink."""
        wins = candidates.active & (fitness <= state.fitness)
        better = candidates.active & (fitness < state.fitness)
        state = _learned(state, better, state.fitness - fitness)
        state = _archived(state, better)
        state = state._replace(
            population=torch.where(wins.unsqueeze(-1), candidates.position, state.population),
            fitness=torch.where(wins, fitness, state.fitness),
            n_evaluation=state.n_evaluation + fitness.shape[-1],
        )
        return self._shrunk(state, self._size(int(state.n_evaluation), fitness.shape[-1]))

    def _size(self, n_evaluation: int, now: int) -> int:
        if self.shrink_over is None:
            return now
        share = min(1.0, n_evaluation / self.shrink_over)
        return min(now, round(self.n_member + (self.n_least - self.n_member) * share))

    def _n_place(self, n_member: int) -> int:
        return round(self.archive_ratio * n_member)

    def _shrunk(self, state: LShadeState, n_member: int) -> LShadeState:
        if n_member == state.fitness.shape[-1]:
            return state
        stay = state.fitness.argsort(dim=-1, stable=True)[..., :n_member]
        n_place = self._n_place(n_member)
        return state._replace(
            population=members(state.population, stay),
            fitness=torch.take_along_dim(state.fitness, stay, dim=-1),
            trial_weight=torch.take_along_dim(state.trial_weight, stay, dim=-1),
            trial_rate=torch.take_along_dim(state.trial_rate, stay, dim=-1),
            archive=state.archive[..., :n_place, :].clone(),
            n_archived=state.n_archived.clamp(max=n_place),
        )


def positive_cauchy(centre: Float[Tensor, "*shape"], uniform: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """A Cauchy number of scale 0.1 drawn again while ≤ 0, then cut to 1, in one draw.

    It is the inverse of the distribution on the positive side.
    """
    low = 0.5 - torch.atan(centre / 0.1) / math.pi
    return (centre + 0.1 * torch.tan(math.pi * (low + uniform * (1.0 - low) - 0.5))).clamp(0.0, 1.0)


def _in_union(r1: Tensor, n_union: Tensor, uniform: Tensor) -> Tensor:
    """An index below n_union that is neither the member itself nor r1."""
    n_free = (n_union - 2).unsqueeze(-1)
    index = torch.minimum((uniform * n_free).long(), n_free - 1)
    own = torch.arange(r1.shape[-1], device=r1.device).expand(r1.shape)
    for taken in torch.stack((own, r1)).sort(dim=0).values:
        index = index + (index >= taken).to(index.dtype)
    return index


def _shuffled(state: LShadeState, key: Tensor) -> LShadeState:
    place = torch.arange(key.shape[-1], device=key.device)
    order = torch.where(place < state.n_archived.unsqueeze(-1), key, torch.inf).argsort(dim=-1, stable=True)
    return state._replace(archive=members(state.archive, order))


def _archived(state: LShadeState, better: Bool[Tensor, "*batch n_member"]) -> LShadeState:
    """The beaten targets go to the front; what no longer fits falls off the (shuffled) end."""
    n_place = state.archive.shape[-2]
    place = torch.arange(n_place, device=better.device)
    filled = torch.cat((better, place < state.n_archived.unsqueeze(-1)), dim=-1)
    order = (~filled).to(torch.int8).argsort(dim=-1, stable=True)[..., :n_place]
    union = torch.cat((state.population, state.archive), dim=-2)
    return state._replace(archive=members(union, order), n_archived=filled.sum(dim=-1).clamp(max=n_place))


def _learned(
    state: LShadeState, better: Bool[Tensor, "*batch n_member"], improvement: Float[Tensor, "*batch n_member"]
) -> LShadeState:
    """Write the weighted Lehmer means of the successful F and CR into the next place of the memory."""
    top = torch.finfo(improvement.dtype).max / improvement.shape[-1]
    weight = torch.where(better, improvement, 0.0).clamp(max=top)
    weight = weight / weight.sum(dim=-1, keepdim=True)

    def mean(value: Tensor) -> Tensor:
        return (weight * value.square()).sum(dim=-1) / (weight * value).sum(dim=-1)

    any_better = better.any(dim=-1, keepdim=True)
    here = torch.arange(state.memory_rate.shape[-1], device=better.device) == state.slot.unsqueeze(-1)
    ended = (torch.where(better, state.trial_rate, 0.0).amax(dim=-1, keepdim=True) == 0.0) | (
        state.memory_rate == TERMINAL
    )
    rate = torch.where(ended, TERMINAL, mean(state.trial_rate).unsqueeze(-1))
    return state._replace(
        memory_weight=torch.where(here & any_better, mean(state.trial_weight).unsqueeze(-1), state.memory_weight),
        memory_rate=torch.where(here & any_better, rate, state.memory_rate),
        slot=(state.slot + any_better.squeeze(-1)) % state.memory_rate.shape[-1],
    )
