"""Differential Evolution, the ten classic variants.

Source: Storn and Price (1997), "Differential Evolution: a simple and efficient heuristic for global
optimization over continuous spaces", J. Global Optimization 11, 341-359; seed paper, Eq. 2-5 and Algorithm 1.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.search.bounds import BOUNDS
from torchplate.search.crossover import CROSSOVERS, Crossover, crossed
from torchplate.search.mutation import MUTATIONS, Mutation, donors
from torchplate.search.optimizer import Candidates, Optimizer, best_member, unknown_name, without_nan

STRATEGIES: dict[str, tuple[Mutation, Crossover]] = {
    f"{mutation}/{crossover}": (MUTATIONS[mutation], CROSSOVERS[crossover])
    for crossover in CROSSOVERS
    for mutation in MUTATIONS
}
"""The ten variants: "rand/1/bin", "best/1/exp" and so on → their mutation and crossover."""


class DifferentialEvolutionState(NamedTuple):
    """The members and their fitness; nothing else is remembered."""

    population: Float[Tensor, "*batch n_member n_dimension"]
    fitness: Float[Tensor, "*batch n_member"]

    @property
    def best_position(self) -> Float[Tensor, "*batch n_dimension"]:
        """The best place seen so far; selection never loses it."""
        return best_member(self.population, self.fitness)

    @property
    def best_objective(self) -> Float[Tensor, "*batch"]:
        """The objective at the best place."""
        return self.fitness.amin(dim=-1)


@dataclass(frozen=True)
class DifferentialEvolution(Optimizer[DifferentialEvolutionState], name="differential_evolution"):
    """Donors from scaled differences of members, crossed with the target; the better one stays.

    u_i = cross(x_i, v_i), for rand/1: v_i = x_r1 + F (x_r2 − x_r3); x_i ← u_i where f(u_i) ≤ f(x_i): a trial
    that is not worse wins, so that plateaus are crossed. The generation is synchronous: all trials are made
    from the old population and evaluated in one call.

    Rule of thumb (seed paper): n_member 3 to 8 per dimension, F 0.4 to 0.95, CR 0.8 to 1 where parameters
    depend on each other.

    Args:
        strategy: One of `STRATEGIES`.
        n_member: Size of the population NP.
        differential_weight: F, in (0, 2].
        crossover_rate: CR, in [0, 1].
        bound: One of `BOUNDS`. The default reflects: nothing piles up on an edge, and what happens near it
            depends on where the trial came from. "redraw" is SciPy's rule.

    Raises:
        ValueError: A setting is outside its range.
    """

    strategy: str = "rand/1/bin"
    n_member: int = 32
    differential_weight: float = 0.8
    crossover_rate: float = 0.8
    bound: str = "reflect"

    state_type: ClassVar = DifferentialEvolutionState

    def __post_init__(self) -> None:
        if self.strategy not in STRATEGIES:
            raise ValueError(unknown_name("strategy", self.strategy, STRATEGIES))
        if self.bound not in BOUNDS:
            raise ValueError(unknown_name("bound", self.bound, BOUNDS))
        if not 0.0 < self.differential_weight <= 2.0:
            raise ValueError(
                f"differential_weight must lie in (0, 2], got {self.differential_weight}. Try 0.4 to 0.95."
            )
        if not 0.0 <= self.crossover_rate <= 1.0:
            raise ValueError(f"crossover_rate must lie in [0, 1], got {self.crossover_rate}. Try 0.8 to 1.")
        least = STRATEGIES[self.strategy][0].n_index + 1
        if self.n_member < least:
            raise ValueError(
                f"{self.strategy} needs n_member of at least {least}, got {self.n_member}. "
                f"Raise it: 3 to 8 per dimension is usual."
            )

    def init(
        self,
        population: Float[Tensor, "*batch n_member n_dimension"],
        fitness: Float[Tensor, "*batch n_member"],
    ) -> DifferentialEvolutionState:
        """Start from a population whose fitness is known."""
        return DifferentialEvolutionState(population, without_nan(fitness))

    def ask(
        self, state: DifferentialEvolutionState, generator: torch.Generator
    ) -> tuple[Candidates, DifferentialEvolutionState]:
        """One trial for each member."""
        mutation, crossover = STRATEGIES[self.strategy]
        target = state.population
        weight = target.new_full((1, 1), self.differential_weight)
        rate = target.new_full((1, 1), self.crossover_rate)
        donor = donors(mutation, target, state.best_position, weight, generator)
        trial = crossed(crossover, target, donor, rate, generator)
        trial = BOUNDS[self.bound](trial, target, generator)
        return Candidates(trial, torch.ones_like(state.fitness, dtype=torch.bool)), state

    def tell(
        self,
        state: DifferentialEvolutionState,
        candidates: Candidates,
        fitness: Float[Tensor, "*batch n_member"],
    ) -> DifferentialEvolutionState:
        """A trial replaces its target where it is not worse (Eq. 5)."""
        wins = candidates.active & (fitness <= state.fitness)
        return DifferentialEvolutionState(
            population=torch.where(wins.unsqueeze(-1), candidates.position, state.population),
            fitness=torch.where(wins, fitness, state.fitness),
        )
