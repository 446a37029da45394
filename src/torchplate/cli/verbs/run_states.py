"""`torchplate run` where `measurement` is a list: one plate in several states, fitted at once."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from torchplate.cli.config import InputError
from torchplate.cli.config.build import Run
from torchplate.cli.folder.occupied import occupied
from torchplate.cli.folder.opening import check_free, open_folder
from torchplate.cli.folder.writing import write_files, write_text
from torchplate.cli.machine.device import on_cpu_alone
from torchplate.identification import Job, PlateState, Settings, States, StatesFound, identify_states
from torchplate.report import run_report
from torchplate.search import LeastSquares, Optimizer, Outcome


def states_of(recipe: Run) -> States:
    """The joint objective of a config's states.

    Raises:
        InputError: if a state, or the states together, cannot be used.
    """
    found = []
    for state in recipe.states:
        try:
            model = state.run.model()
            found.append(PlateState(state.name, state.run.objective(model), state.own))
        except InputError as error:
            text = str(error).replace("measurement.", f"measurement.{state.name}.", 1)
            raise InputError(text) from error
    return recipe.told("measurement", lambda: States(found))


def run_states(
    recipe: Run,
    folder: Path,
    device: str,
    optimizer: Optimizer[Any] | LeastSquares,
    settings: Settings,
    console: Console,
    search: Callable[[Job], Outcome],
    force: bool,
) -> tuple[StatesFound, tuple[str, ...]]:
    """Search all states at once, and write result.json and a report for each state.

    Args:
        recipe: the config.
        folder: of the run.
        device: what was asked for; all is done on the CPU.
        optimizer: how.
        settings: its budget.
        console: where progress goes.
        search: does the search, and shows its progress.
        force: write over what an earlier run has left.

    Returns:
        What was found, and what was said before the search.

    Raises:
        InputError: if a state or the folder cannot be used.
    """
    check_free(folder, "run", force=force)
    states = states_of(recipe)
    with occupied(folder):
        open_folder(recipe, folder, "cpu", "run", force=force)
        on_cpu_alone(device, "A run of several states", console)
        remarks = tuple(
            f"{state.name}: {note}"
            for state, one in zip(recipe.states, states.states, strict=True)
            for note in state.run.remarks(one.objective.model)
        )
        for note in remarks:
            console.print(f"  Note: {note}", markup=False, highlight=False, soft_wrap=True)
        names = ", ".join(state.name for state in recipe.states)
        searched = ", ".join(states.model.names) or "nothing"
        console.print(f"[bold]{escape(recipe.path.stem)}[/]: states {escape(names)}; searching {escape(searched)}")
        found = identify_states(
            states, optimizer, settings, search, lambda text: console.print(f"  {text}", markup=False)
        )
        for state in recipe.states:
            frfs = state.run.measurement()
            placement = None if frfs is None else state.run.placement(frfs)
            command = f"torchplate run {shlex.quote(str(recipe.path))}"
            title = f"{recipe.path.stem}, {state.name}"
            report = run_report(
                title,
                found.objectives[state.name],
                found.by_state[state.name],
                recipe.config.log.n_panel,
                None,
                placement,
                command,
            )
            (folder / state.name).mkdir(exist_ok=True)
            write_files(folder / state.name, report)
        content = found.to_dict() | {"search": recipe.config.search.model_dump(mode="json")}
        write_text(folder / "result.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    return found, remarks
