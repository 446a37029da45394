"""A search that shows how far it is: a bar or lines on the screen, curves and figures in the log."""

import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from torchplate.cli.config.build import Run
from torchplate.cli.machine.ranks import Ranks, Shared
from torchplate.cli.progress.heartbeat import Heartbeat
from torchplate.cli.progress.log import RunLog
from torchplate.report import frf_figures
from torchplate.search import Outcome
from torchplate.search import Progress as SearchProgress

# Points of the gap's curve, each an evaluation of one member: of a few, TensorBoard takes the ends for outliers.
N_GAP = 20


def shown(
    recipe: Run, shared: Shared, log: RunLog, console: Console, ranks: Ranks | None, figures: bool = True
) -> Outcome:
    """The search, with its progress on the screen and in the log."""
    settings, job = recipe.config.search, shared.job
    searched, checkpoint = job.objective, job.checkpoint
    model = searched.model
    if ranks is not None:
        who = "1 process takes" if ranks.size == 1 else f"{ranks.size} processes share"
        console.print(f"  {who} each generation")
        ranks.tell(shared)
    columns = (
        TextColumn("  {task.description}"),
        BarColumn(),
        TextColumn("generation {task.completed}/{task.total}  best {task.fields[best]:.6g}  {task.fields[rate]:.0f}/s"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    n_figure, n_panel = recipe.config.log.n_figure, recipe.config.log.n_panel
    drawn_at = {settings.n_generation * turn // n_figure for turn in range(1, n_figure)} if figures else set()
    told_at = drawn_at | {settings.n_generation * turn // N_GAP for turn in range(N_GAP)}
    bar = Progress(*columns, console=console, disable=not console.is_terminal)
    with bar, Heartbeat(console, settings.n_generation) as line:
        task = bar.add_task(settings.optimizer, total=settings.n_generation, best=float("inf"), rate=0.0)
        began, before = time.monotonic(), 0 if checkpoint is None else int(checkpoint["ledger.n_evaluation"].sum())

        def report(progress: SearchProgress) -> None:
            theta = model.space.to_si(progress.best_position)
            log.generation(progress, theta)
            rate = (int(progress.n_evaluation.sum()) - before) / max(time.monotonic() - began, 1e-9)
            best = int(progress.best_objective.argmin())
            bar.update(task, completed=progress.generation, best=float(progress.best_objective[best]), rate=rate)
            line.beat(progress.generation, float(progress.best_objective[best]), rate)
            step = int(progress.n_evaluation[best])
            if progress.generation in told_at:
                log.gap(float(searched.gap(theta[best])), step)
            if progress.generation in drawn_at:
                for tag, figure in frf_figures(searched, theta[best], n_panel).items():
                    log.figure(tag, figure, step)

        return job.search(report, None if ranks is None else ranks.group)
