"""jDE: Differential Evolution whose members carry their own F and CR.

Source: Brest, Greiner, Bošković, Mernik and Žumer (2006), "Self-adapting control parameters in differential
evolution", IEEE Trans. Evolutionary Computation 10, 646-657.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.search.bounds import BOUNDS
from torchplate.search.crossover import binomial, crossed
from torchplate.search.draws import Draw
from torchplate.search.mutation import MUTATIONS, donors
from torchplate.search.optimizer import Candidates, Optimizer, best_member, unknown_name, without_nan


class JdeState(NamedTuple):
    """Members, the F and CR each carries, and those under trial between ask and tell."""

    population: Float[Tensor, "*batch n_member n_dimension"]
    fitness: Float[Tensor, "*batch n_member"]
    weight: Float[Tensor, "*batch n_member"]
    rate: Float[Tensor, "*batch n_member"]
    trial_weight: Float[Tensor, "*batch n_member"]
    trial_rate: Float[Tensor, "*batch n_member"]

    @property
    def best_position(self) -> Float[Tensor, "*batch n_dimension"]:
        """The best place seen so far; selection never loses it."""
        return best_member(self.population, self.fitness)

    @property
    def best_objective(self) -> Float[Tensor, "*batch"]:
        """The objective at the best place."""
        return self.fitness.amin(dim=-1)


@dataclass(frozen=True)
class Jde(Optimizer[JdeState], name="jde"):
    """rand/1/bin in which each member brings its own F and CR, now and then drawn anew.

    F_i = 0.1 + 0.9 u with probability τ1, CR_i = u with probability τ2; else as before.
    The new values make the trial and stay only if the trial does. They start at F = 0.5, CR = 0.9.

    Args:
        n_member: Size of the population NP, at least 4.
        renew_weight: τ1, the probability that a member tries a new F.
        renew_rate: τ2, the probability that a member tries a new CR.
        bound: One of `BOUNDS`.

    Raises:
        ValueError: A setting is outside its range.
    """

    n_member: int = 32
    renew_weight: float = 0.1
    renew_rate: float = 0.1
    bound: str = "reflect"

    state_type: ClassVar = JdeState

    def __post_init__(self) -> None:
        if self.bound not in BOUNDS:
            raise ValueError(unknown_name("bound", self.bound, BOUNDS))
        if self.n_member < 4:
            raise ValueError(
                f"jde needs n_member of at least 4, got {self.n_member}. Raise it: 3 to 8 per dimension is usual."
            )
        for name in ("renew_weight", "renew_rate"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], got {getattr(self, name)}. The paper has 0.1.")

    def init(
        self,
        population: Float[Tensor, "*batch n_member n_dimension"],
        fitness: Float[Tensor, "*batch n_member"],
    ) -> JdeState:
        """Start from a population whose fitness is known."""
        fitness = without_nan(fitness)
        weight, rate = torch.full_like(fitness, 0.5), torch.full_like(fitness, 0.9)
        return JdeState(population, fitness, weight, rate, weight, rate)

    def ask(self, state: JdeState, generator: torch.Generator) -> tuple[Candidates, JdeState]:
        """One trial for each member, made with the F and CR under trial."""
        target = state.population
        shape = (4, *state.fitness.shape)
        u1, u2, u3, u4 = Draw(generator, target).uniform(shape)
        weight = torch.where(u2 < self.renew_weight, 0.1 + 0.9 * u1, state.weight)
        rate = torch.where(u4 < self.renew_rate, u3, state.rate)
        donor = donors(MUTATIONS["rand/1"], target, state.best_position, weight.unsqueeze(-1), generator)
        trial = crossed(binomial, target, donor, rate.unsqueeze(-1), generator)
        trial = BOUNDS[self.bound](trial, target, generator)
        active = torch.ones_like(state.fitness, dtype=torch.bool)
        return Candidates(trial, active), state._replace(trial_weight=weight, trial_rate=rate)

    def tell(self, state: JdeState, candidates: Candidates, fitness: Float[Tensor, "*batch n_member"]) -> JdeState:
        """A trial that is not worse replaces its target, and its F and CR stay with it."""
        wins = candidates.active & (fitness <= state.fitness)
        return state._replace(
            population=torch.where(wins.unsqueeze(-1), candidates.position, state.population),
            fitness=torch.where(wins, fitness, state.fitness),
            weight=torch.where(wins, state.trial_weight, state.weight),
            rate=torch.where(wins, state.trial_rate, state.rate),
        )
