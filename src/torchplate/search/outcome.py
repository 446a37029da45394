"""What a search returns, and what it shows while it runs."""

from enum import Enum
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchplate.search.least_squares_outcome import LeastSquaresStatus

Checkpoint = dict[str, Tensor]
"""All that a search needs to go on: tensors only, so that `torch.load(..., weights_only=True)` reads it."""


class Status(Enum):
    """Why a search stopped; the value is the sentence for the user and ends in what to do.

    It speaks of the search alone: whether the model fits is for the gap to say.
    """

    budget = (
        "The budget is spent before the search has settled. "
        "Raise n_generation or n_evaluation (in a config search.n_generation, search.n_evaluation), or narrow the "
        "intervals."
    )
    tolerance = (
        "The members agree on the objective to within the tolerance. "
        "Repeat with another seed to see that this minimum is found again."
    )
    stagnation = (
        "The best objective has not improved for as many generations as stagnation (in a config search.stagnation) "
        "allows. "
        "Repeat with another seed or more members to see that this minimum is found again."
    )
    target = "The target (in a config search.target) is reached. Lower it to go on."
    no_number = (
        "The objective has given no finite number anywhere. "
        "Evaluate it by hand at the middle of the unit cube and mend what makes it NaN or infinite."
    )


class Outcome(NamedTuple):
    """The end of a minimisation.

    Attributes:
        best_position: The best place of each search, on the unit cube.
        best_objective: The objective there; +inf where it never was a number.
        n_evaluation: Evaluations that each search spent, the initial population included.
        n_generation: Generations that each search finished.
        status: Why each search stopped, in row-major order of the batch; one entry where there is no batch.
        population: The final members.
        fitness: The objective of the final members.
    """

    best_position: Float[Tensor, "*batch n_dimension"]
    best_objective: Float[Tensor, "*batch"]
    n_evaluation: Int[Tensor, "*batch"]
    n_generation: Int[Tensor, "*batch"]
    status: tuple[Status | LeastSquaresStatus, ...]
    population: Float[Tensor, "*batch n_member n_dimension"]
    fitness: Float[Tensor, "*batch n_member"]

    def to(self, device: torch.device | str) -> "Outcome":
        """Move every tensor to `device`."""
        moved = {key: part.to(device) for key, part in self._asdict().items() if isinstance(part, Tensor)}
        return Outcome(status=self.status, **moved)


class Progress(NamedTuple):
    """Where a search stands after a generation; generation 0 is the initial population.

    Attributes:
        generation: Generations done.
        n_evaluation: Evaluations spent by each search so far.
        best_position: The best place seen so far.
        best_objective: The objective there.
        mean_objective: Mean over the members whose objective is finite; NaN where none is.
        spread: Standard deviation of the members' positions, mean over the dimensions [-].
        snapshot: What `checkpoint` returns.
    """

    generation: int
    n_evaluation: Int[Tensor, "*batch"]
    best_position: Float[Tensor, "*batch n_dimension"]
    best_objective: Float[Tensor, "*batch"]
    mean_objective: Float[Tensor, "*batch"]
    spread: Float[Tensor, "*batch"]
    snapshot: Checkpoint

    def to(self, device: torch.device | str) -> "Progress":
        """Move every tensor to `device`."""
        moved = {key: part.to(device) for key, part in self._asdict().items() if isinstance(part, Tensor)}
        snapshot = {key: part.to(device) for key, part in self.snapshot.items()}
        return Progress(generation=self.generation, snapshot=snapshot, **moved)

    def checkpoint(self) -> Checkpoint:
        """A plain dict of tensors; `minimize(..., resume=...)` goes on from it to the identical result."""
        return dict(self.snapshot)
