"""`torchplate run`: search the intervals of a config, and write down everything."""

import json
import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from torch import Tensor

from torchplate.cli.basis import TOLERANCE, confirmed, estimated, in_reduced_basis, wanted
from torchplate.cli.build import Run, load_run
from torchplate.cli.compare import histories
from torchplate.cli.config import InputError
from torchplate.cli.figures import convergence
from torchplate.cli.folder import open_folder, read_checkpoint, run_folder
from torchplate.cli.log import RunLog
from torchplate.cli.population import Job, polished
from torchplate.cli.ranks import Ranks
from torchplate.cli.report import figures, frf_figures, write_report
from torchplate.cli.result import caveats, evaluated, summarise
from torchplate.discrepancy import Objective, sensitivity
from torchplate.model import DENSE, PlateModel, SparseModel, basis_error
from torchplate.search import LeastSquares, Outcome
from torchplate.search import Progress as SearchProgress

N_FREQUENCY_LISTED = 20


@dataclass(frozen=True)
class Found:
    """What a run ended with.

    Attributes:
        folder: the run's folder.
        result: the content of result.json.
        caveats: what a user must know before trusting the values, one sentence each.
        remarks: what was said before the search: of the file, of units, of what cannot belong together.
    """

    folder: Path
    result: dict[str, Any]
    caveats: list[str]
    remarks: tuple[str, ...] = ()


def run(
    path: Path | str,
    out: Path | None = None,
    overrides: Sequence[str] = (),
    device: str = "cpu",
    resume: bool = False,
    console: Console | None = None,
    ranks: Ranks | None = None,
) -> Found:
    """Search the intervals of a config, or evaluate the model where it has none, and write the run's folder.

    Args:
        path: the YAML file.
        out: the run's folder; `runs/<config name>/<time>` if left out.
        overrides: "key.key=value" each.
        device: where the tensors live.
        resume: go on from the checkpoint in `out`, or in the config's latest folder under runs/.
        console: where progress goes.
        ranks: the processes that share the search, of which this is the first; the others call `follow`.

    Raises:
        InputError: if the config, the measurement or the device cannot be used, or there is nothing to resume.
    """
    console = console or Console()
    recipe = load_run(path, overrides)
    model = recipe.model().to(device_named(device if ranks is None else ranks.device))
    measured = recipe.config.measurement
    alone = not model.names and measured.file is None and measured.natural_frequencies is None
    objective = None if alone else recipe.objective(model)
    optimizer = recipe.optimizer()  # so that a wrong setting is said before anything is written
    if ranks is not None and isinstance(optimizer, LeastSquares):
        raise recipe.error(
            "search.optimizer",
            "Expected a population search for processes to share, got least_squares. Run it without torchrun.",
        )
    folder = run_folder(recipe, out, resume)
    checkpoint = read_checkpoint(recipe, folder, model.known.device) if resume else None
    open_folder(recipe, folder, device)
    remarks = recipe.remarks(model)
    for remark in remarks:
        console.print(f"  Note: {remark}", markup=False, highlight=False, soft_wrap=True)
    if objective is None:
        return replace(_evaluated(recipe, model, folder, console), remarks=remarks)
    console.print(f"[bold]{recipe.path.stem}[/]: {_described(objective)}")
    searched = in_reduced_basis(recipe, objective, console)
    if not model.names:
        found = _finished(recipe, objective, searched, folder, model.known.new_zeros(1, 0), None, console)
        return replace(found, remarks=remarks)
    log = RunLog(folder, model.names, None if checkpoint is None else int(checkpoint["generation"]))
    try:
        command = _command(path, folder, overrides, device)
        job = Job(searched, optimizer, recipe.config.search, checkpoint, folder, command)
        outcome = _search(recipe, job, log, console, ranks)
        if recipe.config.search.polish and not isinstance(job.optimizer, LeastSquares):
            outcome = polished(searched, outcome, console)
        if searched is not objective:
            searched, outcome = confirmed(objective, searched, outcome, console)
        order = outcome.best_objective.argsort()
        theta = model.space.to_si(outcome.best_position[order])
        found = _finished(recipe, objective, searched, folder, theta, outcome, console)
        step = int(outcome.n_evaluation.max())
        n_figure, n_panel = recipe.config.log.n_figure, recipe.config.log.n_panel
        for tag, figure in frf_figures(searched, theta[0], n_panel).items() if n_figure else ():
            log.figure(tag, figure, step)
        log.scalar("gap/baseline", found.result["gap"], step)
        settings = {"optimizer": recipe.config.search.optimizer, "seed": recipe.config.search.seed}
        results = {"hparam/objective": found.result["objective"], "hparam/gap": found.result["gap"]}
        log.settings(settings | (recipe.config.search.model_extra or {}), results)
    finally:
        log.close()
    return replace(found, remarks=remarks)


def follow(ranks: Ranks) -> None:
    """What every process but the first does: its share of the search, and nothing else."""
    ranks.hear().search(group=ranks.group)


def _command(path: Path | str, folder: Path, overrides: Sequence[str], device: str) -> str:
    """What goes on with this run."""
    words = ["torchplate", "run", str(path), "--out", str(folder)]
    for override in overrides:
        words += ["--set", override]
    if device != "cpu":
        words += ["--device", device]
    return shlex.join([*words, "--resume"])


def _search(recipe: Run, job: Job, log: RunLog, console: Console, ranks: Ranks | None) -> Outcome:
    """The search, with its progress on the screen and in the log."""
    settings, searched, checkpoint = recipe.config.search, job.objective, job.checkpoint
    model = searched.model
    if ranks is not None:
        console.print(f"  {ranks.size} processes share each generation")
        ranks.tell(job)
    columns = (
        TextColumn("  {task.description}"),
        BarColumn(),
        TextColumn("generation {task.completed}/{task.total}  best {task.fields[best]:.6g}  {task.fields[rate]:.0f}/s"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    n_figure, n_panel = recipe.config.log.n_figure, recipe.config.log.n_panel
    drawn_at = {settings.n_generation * turn // n_figure for turn in range(1, n_figure)}
    with Progress(*columns, console=console, transient=not console.is_terminal) as bar:
        task = bar.add_task(settings.optimizer, total=settings.n_generation, best=float("inf"), rate=0.0)
        began, before = time.monotonic(), 0 if checkpoint is None else int(checkpoint["ledger.n_evaluation"].sum())

        def report(progress: SearchProgress) -> None:
            theta = model.space.to_si(progress.best_position)
            log.generation(progress, theta)
            rate = (int(progress.n_evaluation.sum()) - before) / max(time.monotonic() - began, 1e-9)
            best = int(progress.best_objective.argmin())
            bar.update(task, completed=progress.generation, best=float(progress.best_objective[best]), rate=rate)
            if progress.generation in drawn_at:
                for tag, figure in frf_figures(searched, theta[best], n_panel).items():
                    log.figure(tag, figure, int(progress.n_evaluation[best]))

        return job.search(report, None if ranks is None else ranks.group)


@torch.no_grad()
def _finished(
    recipe: Run,
    objective: Objective,
    searched: Objective,
    folder: Path,
    theta: Tensor,
    outcome: Outcome | None,
    console: Console,
) -> Found:
    """Confirm the best on the full model, then write the result, the report and its figures."""
    best = theta[0]
    by_squares = recipe.config.search.optimizer == LeastSquares.name
    seen = sensitivity(searched, best, least_squares=by_squares) if objective.model.names else None
    sentences = [] if seen is None else caveats(searched, best, seen)
    listed = _lowest(objective.model, best)
    result = summarise(searched, theta, searched(theta), seen, outcome, recipe.config.search, listed)
    if searched is not objective:
        result["basis_error"] = basis_error(objective.model, searched.model, best[None], *wanted(objective))
        result["basis_error_of_population"] = estimated(objective, searched, outcome)
        if result["basis_error"] > TOLERANCE:
            sentences.append(
                f"On the full model the best member differs by {result['basis_error']:.1e} from what the reduced basis "
                "says. Run again with --set search.basis=full."
            )
    (folder / "result.json").write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")
    drawn = figures(searched, best, recipe.config.log.n_panel)
    if outcome is not None:
        drawn["convergence"] = convergence(histories([folder]), result["objective_kind"])
    write_report(recipe, searched, best, result, sentences, drawn, folder)
    _say(console, folder, result, sentences)
    return Found(folder, result, sentences)


@torch.no_grad()
def _evaluated(recipe: Run, model: PlateModel, folder: Path, console: Console) -> Found:
    """A config of numbers alone, without a measurement: the model's natural frequencies."""
    listed = _lowest(model, model.known.new_zeros(0))
    result = evaluated(recipe.config.search, listed)
    (folder / "result.json").write_text(json.dumps(result, indent=1) + "\n")
    text = (
        f"Natural frequencies [Hz], undamped, rigid-body modes first: {', '.join(f'{hertz:.2f}' for hertz in listed)}."
    )
    (folder / "report.md").write_text(f"# {recipe.path.stem}\n\n{text}\n")
    console.print(f"[bold]{recipe.path.stem}[/]: {text}\n  Results: {folder}", soft_wrap=True)
    return Found(folder, result, [])


def _lowest(model: PlateModel, theta: Tensor) -> list[float]:
    """The lowest natural frequencies of the full model [Hz]."""
    modes = SparseModel(model, theta).modes(N_FREQUENCY_LISTED, dense=model.assembly.size <= DENSE)
    listed: list[float] = modes.frequency[:N_FREQUENCY_LISTED].tolist()
    return listed


def _say(console: Console, folder: Path, result: dict[str, Any], sentences: Sequence[str]) -> None:
    if result["parameters"]:
        table = Table("parameter", "value", "standard error", "unit", "", box=None, padding=(0, 2))
        for name, entry in result["parameters"].items():
            std = "not seen" if entry["std"] is None else f"{entry['std']:.2g}"
            table.add_row(
                name, f"{entry['value']:.6g}", std, entry["unit"], "on its bound" if entry["at_bound"] else ""
            )
        console.print(table)
    console.print(
        f"  {result['objective_kind']} {result['objective']:.6g}, gap {100 * result['gap']:.3g} %. {result['status']}"
    )
    for sentence in sentences:
        console.print(f"  [yellow]Note:[/] {sentence}")
    console.print(f"  Results: {folder}", soft_wrap=True)


def _described(objective: Objective) -> str:
    evidence, parts = objective.evidence, []
    if (frfs := evidence.measurement) is not None:
        first, last = float(frfs.frequency[0]), float(frfs.frequency[-1])
        parts.append(f"{len(frfs.pairs)} FRFs ({frfs.kind}), {len(frfs.frequency)} lines, {first:g} to {last:g} Hz")
    if evidence.natural_frequencies is not None:
        parts.append(f"{len(evidence.natural_frequencies.mode)} natural frequencies")
    names = ", ".join(objective.model.names) or "nothing"
    return f"{' and '.join(parts)}; searching {names}"


def device_named(name: str) -> torch.device:
    """The device of that name.

    Raises:
        InputError: if torch cannot use it.
    """
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"--device {name}: Expected a device that torch can use, got none ({reason}). Use cpu."
        ) from None
    return device
