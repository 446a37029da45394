"""Artificial Bee Colony.

Source: Karaboga and Basturk (2007), "A powerful and efficient algorithm for numerical function optimization:
artificial bee colony (ABC) algorithm", J. Global Optimization 39, 459-471. Two choices are ours: a source is
replaced by a strictly better one only, and a scout leaves when its counter has reached `limit`.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchplate.search.draws import Draw
from torchplate.search.optimizer import Candidates, Optimizer, best_member, members, without_nan

EMPLOYED, ONLOOKER, SCOUT = range(3)


class ArtificialBeeColonyState(NamedTuple):
    """The food sources and what the colony remembers.

    Attributes:
        population: Food sources, one per employed bee.
        fitness: The objective at each source (what is minimised, not the roulette's nectar).
        trials: Attempts since a source was last improved.
        best_position: The best place seen so far; a scout may have left it since.
        best_objective: The objective there.
        source: The source that each candidate starts from, between ask and tell; a scout uses the first
            entry.
        phase: Whose turn it is: EMPLOYED, ONLOOKER or SCOUT; shared by all searches.
    """

    population: Float[Tensor, "*batch n_member n_dimension"]
    fitness: Float[Tensor, "*batch n_member"]
    trials: Int[Tensor, "*batch n_member"]
    best_position: Float[Tensor, "*batch n_dimension"]
    best_objective: Float[Tensor, "*batch"]
    source: Int[Tensor, "*batch n_member"]
    phase: Int[Tensor, ""]


@dataclass(frozen=True)
class ArtificialBeeColony(Optimizer[ArtificialBeeColonyState], name="artificial_bee_colony"):
    """Employed bees, onlookers and at most one scout take turns.

    Three asks make one cycle, which is one generation.

    Employed: each source i tries v_ij = x_ij + φ (x_ij − x_kj) in one dimension j, with a partner k ≠ i and φ
    uniform in [−1, 1]. Onlooker: as many bees choose their source by roulette, p_i = fit_i / Σ fit, fit =
    1/(1 + f) for f ≥ 0 and 1 + |f| for f < 0, and try the same. A better place replaces the source and clears
    its counter, any other adds one to it. Scout: the source with the highest counter, once that has reached
    `limit`, is given up for a random place, however bad. A coordinate that leaves [0, 1] is set onto the
    edge, as in the paper.

    A cycle costs 2 n_member evaluations, and one more when a scout flies.

    Departure from the paper: the bees of one phase fly at the same moment, so that their places can be
    evaluated in one call. Partners are those of the start of the phase; where several onlookers choose the same
    source, each tries from the place where it was then, and they are compared in their order, one after the other,
    with the best so far. It costs about 2 % more evaluations to a target (three dimensions, ten sources; tested).

    Args:
        n_member: Food sources SN; there are as many employed bees, and as many onlookers.
        limit: Attempts after which a source is given up; n_member · n_dimension if left out, as in the paper.

    Raises:
        ValueError: A setting is outside its range.
    """

    n_member: int = 32
    limit: int | None = None

    state_type: ClassVar = ArtificialBeeColonyState
    n_phase: ClassVar = 3

    def __post_init__(self) -> None:
        if self.n_member < 2:
            raise ValueError(
                f"artificial_bee_colony needs n_member of at least 2, got {self.n_member}. "
                f"Raise it: a bee needs a partner."
            )
        if self.limit is not None and self.limit < 1:
            raise ValueError(f"limit must be at least 1, got {self.limit}. Leave it out for n_member · n_dimension.")

    def init(
        self,
        population: Float[Tensor, "*batch n_member n_dimension"],
        fitness: Float[Tensor, "*batch n_member"],
    ) -> ArtificialBeeColonyState:
        """Start from sources whose fitness is known."""
        fitness = without_nan(fitness)
        zero = torch.zeros_like(fitness, dtype=torch.int64)
        return ArtificialBeeColonyState(
            population=population,
            fitness=fitness,
            trials=zero,
            best_position=best_member(population, fitness),
            best_objective=fitness.amin(dim=-1),
            source=zero,
            phase=torch.tensor(EMPLOYED, device=fitness.device),
        )

    def ask(
        self, state: ArtificialBeeColonyState, generator: torch.Generator
    ) -> tuple[Candidates, ArtificialBeeColonyState]:
        """The places of the bees whose turn it is."""
        phase = int(state.phase)
        if phase == SCOUT:
            return self._scout(state, generator)
        if phase == EMPLOYED:
            source = torch.arange(self.n_member, device=state.fitness.device).expand(state.fitness.shape)
        else:
            source = roulette(state.fitness, generator)
        position = neighbours(state.population, source, generator)
        active = torch.ones_like(source, dtype=torch.bool)
        return Candidates(position, active), state._replace(source=source.contiguous())

    def _scout(
        self, state: ArtificialBeeColonyState, generator: torch.Generator
    ) -> tuple[Candidates, ArtificialBeeColonyState]:
        *batch_shape, n_member, n_dimension = state.population.shape
        limit = n_member * n_dimension if self.limit is None else self.limit
        position = Draw(generator, state.population).uniform((*batch_shape, 1, n_dimension))
        most, worn = state.trials.max(dim=-1, keepdim=True)
        return Candidates(position, most >= limit), state._replace(source=worn.expand_as(state.trials).contiguous())

    def tell(
        self,
        state: ArtificialBeeColonyState,
        candidates: Candidates,
        fitness: Float[Tensor, "*batch n_candidate"],
    ) -> ArtificialBeeColonyState:
        """Sources, counters and the best place after the phase; the turn passes on."""
        fitness = torch.where(candidates.active, without_nan(fitness), torch.inf)
        new = _after_scout if int(state.phase) == SCOUT else _after_flight
        population, source_fitness, trials = new(state, candidates, fitness)
        better = fitness.amin(dim=-1) < state.best_objective
        return state._replace(
            population=population,
            fitness=source_fitness,
            trials=trials,
            best_position=torch.where(
                better.unsqueeze(-1), best_member(candidates.position, fitness), state.best_position
            ),
            best_objective=torch.where(better, fitness.amin(dim=-1), state.best_objective),
            phase=(state.phase + 1) % self.n_phase,
        )


def roulette(fitness: Float[Tensor, "*batch n_member"], generator: torch.Generator) -> Int[Tensor, "*batch n_member"]:
    """One source per bee, drawn with probability fit_i / Σ fit; evenly where no source has any nectar."""
    top = torch.finfo(fitness.dtype).max / fitness.shape[-1]
    nectar = torch.where(fitness >= 0.0, 1.0 / (1.0 + fitness), (1.0 + fitness.abs()).clamp(max=top))
    total = nectar.cumsum(dim=-1)
    barren = total[..., -1:] <= 0.0
    total = torch.where(barren, torch.ones_like(nectar).cumsum(dim=-1), total)
    spin = Draw(generator, fitness).uniform(fitness.shape)
    return torch.searchsorted(total, spin * total[..., -1:], right=True).clamp(max=fitness.shape[-1] - 1)


def neighbours(
    population: Float[Tensor, "*batch n_member n_dimension"],
    source: Int[Tensor, "*batch n_member"],
    generator: torch.Generator,
) -> Float[Tensor, "*batch n_member n_dimension"]:
    """v_ij = x_ij + φ (x_ij − x_kj) in one random dimension j of each chosen source i, k ≠ i."""
    n_member, n_dimension = population.shape[-2:]
    draw = Draw(generator, population)
    partner = (source + 1 + draw.below(n_member - 1, source.shape)) % n_member
    dimension = draw.below(n_dimension, (*source.shape, 1))
    phi = 2.0 * draw.uniform((*source.shape, 1)) - 1.0
    base = members(population, source)
    moved = (base + phi * (base - members(population, partner))).clamp(0.0, 1.0)
    chosen = torch.arange(n_dimension, device=population.device) == dimension
    return torch.where(chosen, moved, base)


def _after_flight(
    state: ArtificialBeeColonyState, candidates: Candidates, fitness: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Greedy selection, source by source, the bees in their order."""
    n_member = state.fitness.shape[-1]
    own = torch.arange(n_member, device=fitness.device).unsqueeze(-1) == state.source.unsqueeze(-2)
    own = own & candidates.active.unsqueeze(-2)  # [*batch, n_member, n_candidate]
    offered = torch.where(own, fitness.unsqueeze(-2), torch.inf)
    best, winner = offered.min(dim=-1)
    improved = best < state.fitness
    order = torch.arange(fitness.shape[-1], device=fitness.device)
    later = own & (order > winner.unsqueeze(-1))
    trials = torch.where(improved, later.sum(dim=-1), state.trials + own.sum(dim=-1))
    return (
        torch.where(improved.unsqueeze(-1), members(candidates.position, winner), state.population),
        torch.where(improved, best, state.fitness),
        trials,
    )


def _after_scout(
    state: ArtificialBeeColonyState, candidates: Candidates, fitness: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The abandoned source is where the scout landed, better or not."""
    index = torch.arange(state.fitness.shape[-1], device=fitness.device)
    left = (index == state.source) & candidates.active
    return (
        torch.where(left.unsqueeze(-1), candidates.position, state.population),
        torch.where(left, fitness, state.fitness),
        torch.where(left, 0, state.trials),
    )
