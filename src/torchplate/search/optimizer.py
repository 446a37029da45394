"""What every optimiser is: frozen settings, a state that is returned, randomness that is passed in.

An optimiser asks for candidates and is told their fitness. Positions live on the unit cube [0, 1]^n_dimension
and the fitness is minimised. Leading dimensions of a population are independent searches: twenty seeds are
one more dimension, and nothing that one search sees changes the others. All draws come from one generator, in
shapes that depend on no value, so that search k of a batch has its own part of one random stream (it is not
the search that a batch of one would have made with the same seed).

Source: the ask / tell form is that of Collette, Hansen, Pujol, Salazar Aponte and Le Riche (2010), "On
object-oriented programming of optimizers", and of evosax (Lange 2022).
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchplate.nearest import did_you_mean

OPTIMIZERS: dict[str, "type[Optimizer[Any]]"] = {}
"""Every optimiser by the name it has in a config; a subclass enters itself when it is defined."""


class Candidates(NamedTuple):
    """Places where the objective is wanted.

    Attributes:
        position: Places on the unit cube, each in [0, 1].
        active: False where a search has no use for the place: its fitness is ignored and not counted.
    """

    position: Float[Tensor, "*batch n_candidate n_dimension"]
    active: Bool[Tensor, "*batch n_candidate"]


@runtime_checkable
class State(Protocol):
    """What every state shows.

    Each optimiser returns its own NamedTuple of tensors and nothing else, so that `torch.save` can hold it.
    Every tensor leads with the batch of searches, except a phase or a counter that all searches share.
    """

    @property
    def population(self) -> Float[Tensor, "*batch n_member n_dimension"]:
        """The members, on the unit cube."""

    @property
    def fitness(self) -> Float[Tensor, "*batch n_member"]:
        """The members' objective; +inf where it was no number."""

    @property
    def best_position(self) -> Float[Tensor, "*batch n_dimension"]:
        """The best place seen so far."""

    @property
    def best_objective(self) -> Float[Tensor, "*batch"]:
        """The objective at the best place."""


S = TypeVar("S", bound=State)


class Optimizer(ABC, Generic[S]):
    """Settings of one way to search. Subclasses are frozen dataclasses with a field `n_member`.

    Defining `class MySearch(Optimizer[MyState], name="my_search")` enters the class in `OPTIMIZERS`.

    Attributes:
        name: The name in a config.
        state_type: The NamedTuple that this optimiser returns.
        n_phase: How many times ask and tell take turns in one generation.
    """

    name: ClassVar[str]
    state_type: ClassVar[type[Any]]
    n_phase: ClassVar[int] = 1
    n_member: int

    def __init_subclass__(cls, *, name: str | None = None, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        if name is not None:
            cls.name = name
            OPTIMIZERS[name] = cls

    @abstractmethod
    def init(
        self,
        population: Float[Tensor, "*batch n_member n_dimension"],
        fitness: Float[Tensor, "*batch n_member"],
    ) -> S:
        """Start from a population whose fitness is known."""

    @abstractmethod
    def ask(self, state: S, generator: torch.Generator) -> tuple[Candidates, S]:
        """Propose candidates. The returned state, not the given one, goes to `tell`."""

    @abstractmethod
    def tell(self, state: S, candidates: Candidates, fitness: Float[Tensor, "*batch n_candidate"]) -> S:
        """Take the candidates' fitness in.

        NaN counts as +inf (as it does by itself in `fitness <= old`, which is then false). An inactive candidate
        changes neither members nor fitness nor the best: a search that has stopped has only such candidates.
        """

    def planned(self, n_evaluation: int | None, n_generation: int | None) -> "Optimizer[S]":  # noqa: ARG002
        """The same settings, told the budget; for an optimiser that spends it by a plan."""
        return self


def optimizer_named(name: str) -> "type[Optimizer[Any]]":
    """The optimiser class with this name.

    Raises:
        ValueError: No optimiser has this name.
    """
    if name not in OPTIMIZERS:
        raise ValueError(unknown_name("optimizer", name, OPTIMIZERS))
    return OPTIMIZERS[name]


def unknown_name(kind: str, name: str, known: "dict[str, Any]") -> str:
    """The sentence for a name that nothing answers to: what came, the nearest name, all that there are."""
    return f"No {kind} named {name!r}.{did_you_mean(name, known)} Choose one of: {', '.join(sorted(known))}."


def without_nan(fitness: Float[Tensor, "*batch n_member"]) -> Float[Tensor, "*batch n_member"]:
    """NaN becomes +inf, the worst fitness there is: an evaluation that failed never wins."""
    return torch.where(fitness.isnan(), torch.inf, fitness)


def best_member(
    population: Float[Tensor, "*batch n_member n_dimension"], fitness: Float[Tensor, "*batch n_member"]
) -> Float[Tensor, "*batch n_dimension"]:
    """The member with the lowest fitness."""
    best = fitness.argmin(dim=-1, keepdim=True)
    return members(population, best).squeeze(-2)


def members(
    population: Float[Tensor, "*batch n_member n_dimension"], index: "Tensor"
) -> Float[Tensor, "*batch n_index n_dimension"]:
    """Rows of each search's own population, by an index of shape [*batch, n_index]."""
    return torch.take_along_dim(population, index.unsqueeze(-1), dim=-2)
