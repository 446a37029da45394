"""The search as one job, the same on every process that shares it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import torch
import torch.distributed as dist

from torchplate.discrepancy import Objective
from torchplate.search import (
    Checkpoint,
    LeastSquares,
    Optimizer,
    Outcome,
    Progress,
    ShardedObjective,
    least_squares_from_many_starts,
    minimize,
)


@dataclass(frozen=True)
class Settings:
    """When a search ends, how often it is repeated, and what it is done in; the optimiser has its own.

    Args:
        n_generation: generations at most.
        n_evaluation: evaluations at most for each search, the first population included.
        tolerance: a search stops when its members agree on the objective to this part of it; None never does.
        stagnation: a search stops after as many generations without improvement; None never does.
        target: a search stops at or below this value of the objective.
        seed: of all randomness.
        n_repeat: independent searches; the best of them is the result.
        polish: finish a population search by least squares.
        basis: "auto" searches in a reduced basis where one is good enough, "full" in all dofs.
        precision: "single" puts the FRFs of a search together in single precision; what was found is in double.
    """

    n_generation: int = 100
    n_evaluation: int | None = None
    tolerance: float | None = 1e-8
    stagnation: int | None = None
    target: float | None = None
    seed: int = 0
    n_repeat: int = 1
    polish: bool = False
    basis: Literal["auto", "full"] = "auto"
    precision: Literal["double", "single"] = "double"


@dataclass(frozen=True)
class Job:
    """All that a search needs: enough for a process that has read no file.

    Args:
        objective: what is minimised, in the basis that it is searched in.
        optimizer: how.
        settings: its budget, seed and number of repeats.
        checkpoint: what it goes on from, if anything.
        device: where the generations are evaluated; what comes before and after is done on the CPU.
    """

    objective: Objective
    optimizer: Optimizer[Any] | LeastSquares
    settings: Settings
    checkpoint: Checkpoint | None = None
    device: torch.device | str = "cpu"

    def search(
        self, on_generation: Callable[[Progress], object] | None = None, group: dist.ProcessGroup | None = None
    ) -> Outcome:
        """Search, alone or with a group of processes that do the same; what it tells and finds is on the CPU.

        Args:
            on_generation: see `minimize`.
            group: the processes that share each generation.
        """
        settings, searched = self.settings, self.objective
        if torch.device(self.device).type != "cpu":
            searched = searched.on(self.device)
        space, known = searched.model.space, searched.model.known

        def report(progress: Progress) -> None:
            if on_generation is not None:
                on_generation(progress.to("cpu"))

        def objective(position: torch.Tensor) -> torch.Tensor:
            return searched(space.to_si(position))

        in_single = searched.of(searched.model.in_single_precision()) if settings.precision == "single" else searched

        @torch.no_grad()
        def fitness(position: torch.Tensor) -> torch.Tensor:
            return in_single(space.to_si(position))

        if isinstance(self.optimizer, LeastSquares):
            return least_squares_from_many_starts(
                lambda position: searched.residual(space.to_si(position)),
                objective,
                self.optimizer,
                n_dimension=len(searched.model.names),
                generator=torch.Generator(known.device).manual_seed(settings.seed),
                n_search=settings.n_repeat,
                n_generation=settings.n_generation,
                n_evaluation=settings.n_evaluation,
                dtype=known.dtype,
                on_generation=None if on_generation is None else report,
            ).to("cpu")
        outcome = minimize(
            fitness if group is None else ShardedObjective(fitness, group),
            self.optimizer,
            n_dimension=len(searched.model.names),
            generator=torch.Generator(known.device).manual_seed(settings.seed),
            batch_shape=(settings.n_repeat,),
            n_generation=settings.n_generation,
            n_evaluation=settings.n_evaluation,
            target=settings.target,
            tolerance=settings.tolerance,
            stagnation=settings.stagnation,
            dtype=known.dtype,
            on_generation=None if on_generation is None else report,
            resume=self.checkpoint,
        )
        if in_single is searched:
            return outcome.to("cpu")
        with torch.no_grad():
            return outcome._replace(best_objective=objective(outcome.best_position)).to("cpu")
