"""SaDE: Differential Evolution that learns which strategy and which crossover rate succeed.

Source: Qin, Huang and Suganthan (2009), "Differential evolution algorithm with strategy adaptation for global
numerical optimization", IEEE Trans. Evolutionary Computation 13, 398-417; first form: Qin and Suganthan
(2005), IEEE CEC.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float, Int
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

N_STRATEGY = 4
UNCROSSED = 3
"""The last strategy, current-to-rand/1, is not crossed with the target: it is itself rotation-invariant."""


class SadeState(NamedTuple):
    """Members and what the last `learning_period` generations taught.

    Attributes:
        population: The members.
        fitness: Their objective.
        used: The strategy of each trial in memory; a row per generation.
        success: Whether that trial won (1) or lost (0); −1 where the memory is still empty.
        rate: The crossover rate of that trial.
        trial_used: Strategies under trial between ask and tell.
        trial_rate: Crossover rates under trial.
        generation: Generations done; shared by all searches.
    """

    population: Float[Tensor, "*batch n_member n_dimension"]
    fitness: Float[Tensor, "*batch n_member"]
    used: Int[Tensor, "*batch n_memory n_member"]
    success: Int[Tensor, "*batch n_memory n_member"]
    rate: Float[Tensor, "*batch n_memory n_member"]
    trial_used: Int[Tensor, "*batch n_member"]
    trial_rate: Float[Tensor, "*batch n_member"]
    generation: Int[Tensor, ""]

    @property
    def best_position(self) -> Float[Tensor, "*batch n_dimension"]:
        """The best place seen so far; selection never loses it."""
        return best_member(self.population, self.fitness)

    @property
    def best_objective(self) -> Float[Tensor, "*batch"]:
        """The objective at the best place."""
        return self.fitness.amin(dim=-1)


@dataclass(frozen=True)
class Sade(Optimizer[SadeState], name="sade"):
    """Four strategies compete: rand/1/bin, rand-to-best/2/bin, rand/2/bin, current-to-rand/1.

    Strategy k is used with probability p_k ∝ wins_k / trials_k + 0.01 over the last `learning_period`
    generations, evenly until there are so many. F ~ N(0.5, 0.3) for each member; CR ~ N(m_k, 0.1) cut to [0,
    1], m_k the median of the rates with which strategy k has won (0.5 to begin with).

    Choice: of an even number of rates the lower of the two middle ones is the median.

    Args:
        n_member: Size of the population NP, at least 6 (rand/2 needs five others).
        learning_period: Generations that are remembered; 20 to 60 behave alike (the paper's section IV-C).
        bound: One of `BOUNDS`; the default is the paper's.

    Raises:
        ValueError: A setting is outside its range.
    """

    n_member: int = 32
    learning_period: int = 50
    bound: str = "redraw"

    state_type: ClassVar = SadeState

    def __post_init__(self) -> None:
        if self.bound not in BOUNDS:
            raise ValueError(unknown_name("bound", self.bound, BOUNDS))
        if self.n_member < 6:
            raise ValueError(
                f"sade needs n_member of at least 6, got {self.n_member}. Raise it: rand/2 needs five others."
            )
        if self.learning_period < 1:
            raise ValueError(f"learning_period must be at least 1, got {self.learning_period}. Try 20 to 60.")

    def init(
        self,
        population: Float[Tensor, "*batch n_member n_dimension"],
        fitness: Float[Tensor, "*batch n_member"],
    ) -> SadeState:
        """Start from a population whose fitness is known, with nothing learned."""
        fitness = without_nan(fitness)
        memory = fitness.new_zeros((*fitness.shape[:-1], self.learning_period, fitness.shape[-1]))
        none = memory.to(torch.int64)
        return SadeState(
            population=population,
            fitness=fitness,
            used=none,
            success=none - 1,
            rate=memory,
            trial_used=torch.zeros_like(fitness, dtype=torch.int64),
            trial_rate=torch.zeros_like(fitness),
            generation=torch.tensor(0, device=fitness.device),
        )

    def ask(self, state: SadeState, generator: torch.Generator) -> tuple[Candidates, SadeState]:
        """One trial for each member, by the strategy drawn for it."""
        target = state.population
        draw = Draw(generator, target)
        share, centre = self.learned(state)
        shuffle = draw.uniform(state.fitness.shape)
        used = _spun(share, shuffle, draw.uniform((*share.shape[:-1], 1)))
        weight = 0.5 + 0.3 * draw.normal((*state.fitness.shape, 1))
        uniform = draw.uniform(state.fitness.shape)
        rate = cut_normal(torch.take_along_dim(centre, used, dim=-1), 0.1, uniform)
        mix = draw.uniform((*state.fitness.shape, 1))

        best = state.best_position.unsqueeze(-2)
        index = distinct_indices(target.shape[:-2], self.n_member, 5, generator)
        a, b, c, d, e = (members(target, one) for one in index)
        donors = torch.stack(
            (
                a + weight * (b - c),
                target + weight * (best - target) + weight * (a - b) + weight * (c - d),
                a + weight * (b - c) + weight * (d - e),
                target + mix * (a - target) + weight * (b - c),
            )
        )
        donor = torch.take_along_dim(donors, used.unsqueeze(-1).unsqueeze(0), dim=0).squeeze(0)
        crossing = torch.where(used == UNCROSSED, 1.0, rate)
        trial = crossed(binomial, target, donor, crossing.unsqueeze(-1), generator)
        trial = BOUNDS[self.bound](trial, target, generator)
        active = torch.ones_like(state.fitness, dtype=torch.bool)
        return Candidates(trial, active), state._replace(trial_used=used, trial_rate=rate)

    def learned(
        self, state: SadeState
    ) -> tuple[Float[Tensor, "*batch n_strategy"], Float[Tensor, "*batch n_strategy"]]:
        """Each strategy's probability, and the median of the crossover rates with which it has won."""
        shape = (*state.fitness.shape[:-1], N_STRATEGY)
        centre = state.fitness.new_full(shape, 0.5)
        if int(state.generation) < self.learning_period:
            return state.fitness.new_full(shape, 1.0 / N_STRATEGY), centre
        used, success, rate = (memory.flatten(-2) for memory in (state.used, state.success, state.rate))
        n_tried = _counted(used, success >= 0)
        n_won = _counted(used, success == 1)
        score = n_won / n_tried.clamp(min=1) + 0.01
        share = (score / score.sum(dim=-1, keepdim=True)).to(rate.dtype)

        # One sort for all strategies: the winners of strategy k lie in [2k, 2k + 1], the rest behind them all.
        order = torch.where(success == 1, 2.0 * used + rate, torch.inf).argsort(dim=-1)
        middle = n_won.cumsum(dim=-1) - n_won + (n_won - 1).clamp(min=0) // 2
        middle = middle.clamp(max=rate.shape[-1] - 1)
        median = torch.take_along_dim(rate, torch.take_along_dim(order, middle, dim=-1), dim=-1)
        return share, torch.where(n_won > 0, median, centre)

    def tell(self, state: SadeState, candidates: Candidates, fitness: Float[Tensor, "*batch n_member"]) -> SadeState:
        """A trial that is not worse replaces its target; what was tried and how it went enters the memory."""
        wins = candidates.active & (fitness <= state.fitness)
        row = int(state.generation) % self.learning_period
        outcome = torch.where(candidates.active, wins.to(torch.int64), -1)
        return state._replace(
            population=torch.where(wins.unsqueeze(-1), candidates.position, state.population),
            fitness=torch.where(wins, fitness, state.fitness),
            used=_with_row(state.used, row, state.trial_used),
            success=_with_row(state.success, row, outcome),
            rate=_with_row(state.rate, row, state.trial_rate),
            generation=state.generation + 1,
        )


def _counted(used: Tensor, where: Tensor) -> Tensor:
    """How often each strategy occurs in the memory, where the mask holds."""
    count = used.new_zeros((*used.shape[:-1], N_STRATEGY))
    return count.scatter_add(-1, used, where.to(used.dtype))


def _with_row(memory: Tensor, row: int, value: Tensor) -> Tensor:
    memory = memory.clone()
    memory[..., row, :] = value
    return memory


def _spun(share: Tensor, shuffle: Tensor, offset: Tensor) -> Tensor:
    """Strategies by stochastic universal sampling: evenly spaced pointers on one wheel, then shuffled."""
    n_member = shuffle.shape[-1]
    pointer = (torch.arange(n_member, device=share.device) + offset) / n_member
    strategy = torch.searchsorted(share.cumsum(dim=-1), pointer, right=True).clamp(max=N_STRATEGY - 1)
    return torch.take_along_dim(strategy, shuffle.argsort(dim=-1), dim=-1)


def cut_normal(
    mean: Float[Tensor, "*shape"], deviation: float, uniform: Float[Tensor, "*shape"]
) -> Float[Tensor, "*shape"]:
    """A normal number drawn again until it lies in [0, 1], in one draw.

    It is the inverse of the normal distribution between 0 and 1.

    Args:
        mean: In [0, 1].
        deviation: Standard deviation before the cut.
        uniform: A uniform number in [0, 1).
    """
    low, high = torch.special.ndtr(-mean / deviation), torch.special.ndtr((1.0 - mean) / deviation)
    return (mean + deviation * torch.special.ndtri(low + uniform * (high - low))).clamp(0.0, 1.0)
