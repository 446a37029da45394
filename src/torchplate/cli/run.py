"""`torchplate run`: search the intervals of a config, and write down everything."""

import json
import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from torchplate.cli.build import SEARCHES, Run, load_run
from torchplate.cli.config import InputError
from torchplate.cli.folder import check_free, open_folder, read_checkpoint, run_folder
from torchplate.cli.gathered import histories
from torchplate.cli.heartbeat import Heartbeat
from torchplate.cli.layout import problem_named
from torchplate.cli.log import RunLog
from torchplate.cli.memory import without_basis
from torchplate.cli.occupied import occupied
from torchplate.cli.ranks import Ranks, Shared
from torchplate.cli.run_states import run_states
from torchplate.cli.writing import write_files, write_text
from torchplate.discrepancy import Objective
from torchplate.identification import Identified, Job, Result, Settings, evaluated, identified
from torchplate.model import PlateModel
from torchplate.report import frf_figures, model_report, run_report
from torchplate.search import Checkpoint, LeastSquares, Optimizer, Outcome
from torchplate.search import Progress as SearchProgress


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
    force: bool = False,
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
        force: write over what an earlier run has left in `out`.

    Raises:
        InputError: if the config, the measurement, the device or the folder cannot be used, or there is nothing to
            resume.
    """
    console = console or Console()
    recipe = load_run(path, overrides)
    optimizer = recipe.optimizer()  # so that a wrong setting is said before anything is written
    folder = run_folder(recipe, out, resume)
    if recipe.states:
        return _run_states(recipe, folder, optimizer, device, resume, console, ranks, force)
    check_free(folder, "run", force=force, resume=resume)
    model = recipe.model().to(device_named(device if ranks is None else ranks.device))
    measured = recipe.config.measurement
    given = (measured.file, measured.natural_frequencies, measured.modal_model)
    alone = not model.names and all(one is None for one in given)
    objective = None if alone else recipe.objective(model)
    if ranks is not None and isinstance(optimizer, LeastSquares):
        raise recipe.error(
            "search.optimizer",
            "Expected a population search for processes to share, got least_squares. Run it without torchrun.",
        )
    checkpoint = read_checkpoint(recipe, folder, model.known.device, len(model.names)) if resume else None
    with occupied(folder):
        open_folder(recipe, folder, device, "run", force=force, resume=resume)
        remarks = recipe.remarks(model)
        for note in remarks:
            console.print(f"  Note: {note}", markup=False, highlight=False, soft_wrap=True)
        if objective is None:
            return replace(_evaluated(recipe, model, folder, console), remarks=remarks)
        console.print(f"[bold]{escape(recipe.path.stem)}[/]: {escape(_described(objective))}")
        if resume and checkpoint is None:
            console.print(
                f"  No generation was finished in {folder}: the search begins anew.", markup=False, soft_wrap=True
            )
        command = _command(path, folder, overrides, device)
        here = Place(folder, command, console, ranks, problem_named(recipe.path.stem, overrides))
        found = _identified(recipe, objective, optimizer, checkpoint, here)
        return replace(found, remarks=remarks)


def _run_states(
    recipe: Run,
    folder: Path,
    optimizer: Optimizer[Any] | LeastSquares,
    device: str,
    resume: bool,
    console: Console,
    ranks: Ranks | None,
    force: bool,
) -> Found:
    """The same of several states."""
    if resume or ranks is not None:
        raise recipe.error(
            "measurement",
            f"Expected one measurement with {'--resume' if resume else 'torchrun'}, got several states. Leave it out.",
        )
    log: RunLog | None = None

    def search(job: Job) -> Outcome:
        nonlocal log
        log = RunLog(folder, job.objective.model.names)
        return _search(recipe, Shared(job, folder, ""), log, console, None, figures=False)

    try:
        found, remarks = run_states(
            recipe, folder, device_named(device), optimizer, settings_of(recipe), console, search, force
        )
    finally:
        if log is not None:
            log.close()
    result = json.loads((folder / "result.json").read_text())
    _say(console, folder, result, found.result.caveats)
    return Found(folder, result, found.result.caveats, remarks)


class Place(NamedTuple):
    """Where a run writes and speaks.

    Attributes:
        folder: the run's.
        command: what goes on with this run.
        console: where progress goes.
        ranks: the processes that share the search, if any.
        problem: what is solved, for TensorBoard.
    """

    folder: Path
    command: str
    console: Console
    ranks: Ranks | None
    problem: str


def _identified(
    recipe: Run,
    objective: Objective,
    optimizer: Optimizer[Any] | LeastSquares,
    checkpoint: Checkpoint | None,
    place: Place,
) -> Found:
    """Search, and write and log what was found."""
    folder, command, console, ranks, problem = place
    names = objective.model.names
    log: RunLog | None = None

    def search(job: Job) -> Outcome:
        nonlocal log
        log = RunLog(folder, names, None if checkpoint is None else int(checkpoint["generation"]), problem)
        return _search(recipe, Shared(job, folder, command), log, console, ranks)

    def check(searched: Objective) -> None:
        if (told := without_basis(searched.model.assembly.size)) is not None:
            raise recipe.error("mesh", told)

    try:
        end = identified(
            objective,
            optimizer,
            settings_of(recipe),
            search,
            resume=checkpoint,
            say=lambda text: console.print(f"  {text}", markup=False),
            prepared=check,
        )
        found = _written(recipe, end, folder, console)
        if log is not None and end.outcome is not None:
            _logged(recipe, log, end, int(end.outcome.n_evaluation.max()))
    finally:
        if log is not None:
            log.close()
    return found


def settings_of(recipe: Run) -> Settings:
    """The part of a config's search that is not the optimiser's own."""
    return Settings(**{field.name: getattr(recipe.config.search, field.name) for field in fields(Settings)})


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


def _search(
    recipe: Run, shared: Shared, log: RunLog, console: Console, ranks: Ranks | None, figures: bool = True
) -> Outcome:
    """The search, with its progress on the screen and in the log."""
    settings, job = recipe.config.search, shared.job
    searched, checkpoint = job.objective, job.checkpoint
    model = searched.model
    if ranks is not None:
        console.print(f"  {ranks.size} processes share each generation")
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
            if progress.generation in {0, *drawn_at}:
                log.gap(float(searched.gap(theta[best])), step)
            if progress.generation in drawn_at:
                for tag, figure in frf_figures(searched, theta[best], n_panel).items():
                    log.figure(tag, figure, step)

        return job.search(report, None if ranks is None else ranks.group)


def _written(recipe: Run, end: Identified, folder: Path, console: Console) -> Found:
    """Write the result, the report and its figures, and print them."""
    result = content(recipe, end.result)
    write_text(folder / "result.json", json.dumps(result, indent=1, allow_nan=False) + "\n")
    measurement = end.searched.evidence.measurement
    told = run_report(
        recipe.path.stem,
        end.searched,
        end.result,
        recipe.config.log.n_panel,
        None if end.outcome is None else histories([folder]),
        None if measurement is None else recipe.placement(measurement),
        f"torchplate run {shlex.quote(str(recipe.path))}",
    )
    write_files(folder, told)
    _say(console, folder, result, end.result.caveats)
    return Found(folder, result, end.result.caveats)


def _logged(recipe: Run, log: RunLog, end: Identified, step: int) -> None:
    """The last figures, the gap, and the settings beside what they led to."""
    result, settings = end.result, recipe.config.search
    n_figure, n_panel = recipe.config.log.n_figure, recipe.config.log.n_panel
    for tag, figure in frf_figures(end.searched, result.theta, n_panel).items() if n_figure else ():
        log.figure(tag, figure, step)
    assert result.gap is not None
    assert result.objective is not None
    log.gap(result.gap, step)
    log.end(result.objective, step)
    own = {
        "problem": log.problem,
        "optimizer": settings.optimizer,
        "seed": settings.seed,
        "n_repeat": settings.n_repeat,
    }
    results = {"search/best_objective": result.objective, "gap/baseline": result.gap}
    log.settings(own | vars(recipe.optimizer()), results, all_settings())


def _evaluated(recipe: Run, model: PlateModel, folder: Path, console: Console) -> Found:
    """A config of numbers alone, without a measurement: the model's natural frequencies."""
    found = evaluated(model, model.known.new_zeros(0), recipe.optimizer(), settings_of(recipe))
    result = content(recipe, found)
    write_text(folder / "result.json", json.dumps(result, indent=1, allow_nan=False) + "\n")
    listed = ", ".join(f"{hertz:.2f}" for hertz in found.natural_frequencies_hz)
    text = f"Natural frequencies [Hz], undamped, rigid-body modes first: {listed}."
    write_files(folder, model_report(recipe.path.stem, model, found, f"torchplate run {shlex.quote(str(recipe.path))}"))
    console.print(f"[bold]{escape(recipe.path.stem)}[/]: {text}\n  Results: {escape(str(folder))}", soft_wrap=True)
    return Found(folder, result, [])


def all_settings() -> dict[str, Any]:
    """Every setting that some search has, at its default."""
    return {name: value for kind in SEARCHES.values() for name, value in vars(kind()).items()}


def content(recipe: Run, result: Result) -> dict[str, Any]:
    """`result.json`, with the search as the config has it."""
    return result.to_dict() | {"search": recipe.config.search.model_dump(mode="json")}


def _say(console: Console, folder: Path, result: dict[str, Any], sentences: Sequence[str]) -> None:
    if result["parameters"]:
        table = Table("parameter", "value", "standard error", "unit", "", box=None, padding=(0, 2))
        for name, entry in result["parameters"].items():
            std = "not seen" if entry["std"] is None else f"{entry['std']:.2g}"
            table.add_row(
                escape(name), f"{entry['value']:.6g}", std, entry["unit"], "on its bound" if entry["at_bound"] else ""
            )
        console.print(table)
    if "modes" in result:
        table = Table("mode", "measured [Hz]", "model [Hz]", "MAC", box=None, padding=(0, 2))
        for pair in result["modes"]:
            hertzs = f"{pair['measured_hz']:.2f}", f"{pair['model_hz']:.2f}"
            table.add_row(str(pair["mode"]), *hertzs, f"{pair['mac']:.3f}")
        console.print(table)
    console.print(f"  {result['objective_kind']} {result['objective']:.6g}. {result['fit']}")
    console.print(f"  {result['optimizer']}: {result['status']}" if result["parameters"] else f"  {result['status']}")
    for sentence in sentences:
        console.print(f"  [yellow]Note:[/] {escape(sentence)}")
    console.print(f"  Results: {folder}", markup=False, soft_wrap=True)


def _described(objective: Objective) -> str:
    evidence, parts = objective.evidence, []
    if (frfs := evidence.measurement) is not None:
        first, last = float(frfs.frequency[0]), float(frfs.frequency[-1])
        parts.append(f"{len(frfs.pairs)} FRFs ({frfs.kind}), {len(frfs.frequency)} lines, {first:g} to {last:g} Hz")
    if evidence.natural_frequencies is not None:
        parts.append(f"{len(evidence.natural_frequencies.mode)} natural frequencies")
    if (modal := evidence.modal_model) is not None:
        parts.append(f"{len(modal.modal.frequency)} modes with shapes at {len(modal.place)} points")
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
