"""The search of a run: one job, the same on every process that shares it, and its finish by least squares."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from rich.console import Console

from torchplate.cli.config import SearchConfig
from torchplate.discrepancy import Objective
from torchplate.search import (
    Checkpoint,
    LeastSquares,
    Optimizer,
    Outcome,
    Progress,
    ShardedObjective,
    least_squares,
    least_squares_from_many_starts,
    minimize,
)


@dataclass(frozen=True)
class Job:
    """All that a search needs: enough for a process that has read no file.

    Args:
        objective: what is minimised, in the basis that it is searched in.
        optimizer: how.
        settings: its budget, seed and number of repeats.
        checkpoint: what it goes on from, if anything.
        folder: where the first process writes its checkpoints.
        command: what the user types to go on from there.
    """

    objective: Objective
    optimizer: Optimizer[Any] | LeastSquares
    settings: SearchConfig
    checkpoint: Checkpoint | None
    folder: Path
    command: str

    def search(
        self, on_generation: Callable[[Progress], object] | None = None, group: dist.ProcessGroup | None = None
    ) -> Outcome:
        """Search, alone or with a group of processes that do the same.

        Args:
            on_generation: see `minimize`.
            group: the processes that share each generation.
        """
        searched, settings = self.objective, self.settings
        space, known = searched.model.space, searched.model.known

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
                on_generation=on_generation,
            )
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
            on_generation=on_generation,
            resume=self.checkpoint,
        )
        if in_single is searched:
            return outcome
        with torch.no_grad():
            return outcome._replace(best_objective=objective(outcome.best_position))


@torch.no_grad()
def polished(searched: Objective, outcome: Outcome, console: Console) -> Outcome:
    """Every search's best, finished by least squares on the residuals, and kept where the objective is lower."""
    space = searched.model.space
    finish = least_squares(
        lambda position: searched.residual(space.to_si(position)), outcome.best_position, jacobian="autograd"
    )
    objective = searched(space.to_si(finish.position))
    lower = objective < outcome.best_objective
    console.print(
        f"  polished by least squares: objective {float(outcome.best_objective.min()):.6g} before, "
        f"{float(torch.where(lower, objective, outcome.best_objective).min()):.6g} after"
    )
    return outcome._replace(
        best_position=torch.where(lower[..., None], finish.position, outcome.best_position),
        best_objective=torch.where(lower, objective, outcome.best_objective),
        # A tangent of the exact Jacobian costs about as much as a residual, and the objective is evaluated once more.
        n_evaluation=outcome.n_evaluation + finish.n_evaluation + finish.n_jacobian * len(space) + 1,
    )
