"""`torchplate run`: search the intervals of a config, and write down everything."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from rich.console import Console
from rich.markup import escape

from torchplate.cli.config.build import Run, load_run
from torchplate.cli.config.memory import without_basis
from torchplate.cli.folder.occupied import occupied
from torchplate.cli.folder.opening import check_free, open_folder, read_checkpoint, run_folder
from torchplate.cli.machine.allocator import keep_freed_memory
from torchplate.cli.machine.device import device_named
from torchplate.cli.machine.ranks import Ranks, Shared
from torchplate.cli.progress.bar import shown
from torchplate.cli.progress.console import speaking
from torchplate.cli.progress.layout import problem_named
from torchplate.cli.progress.log import RunLog
from torchplate.cli.results.found import Found, described, logged, say, settings_of, written, written_of_numbers
from torchplate.cli.verbs.run_states import run_states
from torchplate.discrepancy import Objective
from torchplate.identification import Job, identified
from torchplate.search import Checkpoint, LeastSquares, Optimizer, Outcome


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
        device: where the generations of a search are evaluated; all else, and several states, are done on the CPU.
        resume: go on from the checkpoint in `out`, or in the config's latest folder under runs/.
        console: where progress goes.
        ranks: the processes that share the search, of which this is the first; the others call `follow`.
        force: write over what an earlier run has left in `out`.

    Raises:
        InputError: if the config, the measurement, the device or the folder cannot be used, or there is nothing to
            resume.
    """
    console = console or speaking()
    keep_freed_memory()
    recipe = load_run(path, overrides)
    optimizer = recipe.optimizer()  # so that a wrong setting is said before anything is written
    folder = run_folder(recipe, out, resume)
    there = device_named(device if ranks is None else ranks.device)
    if recipe.states:
        return _run_states(recipe, folder, optimizer, device, resume, console, ranks, force)
    check_free(folder, "run", force=force, resume=resume)
    model = recipe.model()
    measured = recipe.config.measurement
    given = (measured.file, measured.natural_frequencies, measured.modal_model)
    alone = not model.names and all(one is None for one in given)
    objective = None if alone else recipe.objective(model)
    if ranks is not None and isinstance(optimizer, LeastSquares):
        raise recipe.error(
            "search.optimizer",
            "Expected a population search for processes to share, got least_squares. Run it without torchrun.",
        )
    checkpoint = read_checkpoint(recipe, folder, there, len(model.names)) if resume else None
    with occupied(folder):
        open_folder(recipe, folder, device, "run", force=force, resume=resume)
        remarks = recipe.remarks(model)
        for note in remarks:
            console.print(f"  Note: {note}", markup=False, highlight=False, soft_wrap=True)
        if objective is None:
            return replace(written_of_numbers(recipe, model, folder, console), remarks=remarks)
        console.print(f"[bold]{escape(recipe.path.stem)}[/]: {escape(described(objective))}")
        if resume and checkpoint is None:
            console.print(
                f"  No generation was finished in {folder}: the search begins anew.", markup=False, soft_wrap=True
            )
        command = _command(path, folder, overrides, device)
        here = Place(folder, command, console, ranks, problem_named(recipe.path.stem, overrides), there)
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
        return shown(recipe, Shared(job, folder, ""), log, console, None, figures=False)

    try:
        found, remarks = run_states(recipe, folder, device, optimizer, settings_of(recipe), console, search, force)
    finally:
        if log is not None:
            log.close()
    result = json.loads((folder / "result.json").read_text())
    say(console, folder, result, found.result)
    return Found(folder, result, found.result.caveats, remarks)


class Place(NamedTuple):
    """Where a run writes and speaks.

    Attributes:
        folder: the run's.
        command: what goes on with this run.
        console: where progress goes.
        ranks: the processes that share the search, if any.
        problem: what is solved, for TensorBoard.
        device: where the generations are evaluated.
    """

    folder: Path
    command: str
    console: Console
    ranks: Ranks | None
    problem: str
    device: torch.device


def _identified(
    recipe: Run,
    objective: Objective,
    optimizer: Optimizer[Any] | LeastSquares,
    checkpoint: Checkpoint | None,
    place: Place,
) -> Found:
    """Search, and write and log what was found."""
    folder, command, console, ranks, problem, device = place
    names = objective.model.names
    log: RunLog | None = None

    def search(job: Job) -> Outcome:
        nonlocal log
        log = RunLog(folder, names, None if checkpoint is None else int(checkpoint["generation"]), problem)
        return shown(recipe, Shared(job, folder, command), log, console, ranks)

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
            device=device,
        )
        found = written(recipe, end, folder, console)
        if log is not None and end.outcome is not None:
            logged(recipe, log, end, int(end.outcome.n_evaluation.max()))
    finally:
        if log is not None:
            log.close()
    return found


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
