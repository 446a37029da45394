"""What a run ends with: its files, its figures in the log, and what is printed."""

import json
import shlex
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from torchplate.cli.config.build import Run
from torchplate.cli.config.searches import SEARCHES
from torchplate.cli.folder.writing import write_files, write_text
from torchplate.cli.progress.log import RunLog, read_history
from torchplate.cli.results.gathered import histories
from torchplate.cli.results.table import plain_table
from torchplate.discrepancy import Objective
from torchplate.identification import Identified, Result, Settings, evaluated
from torchplate.model import PlateModel
from torchplate.notation import counted
from torchplate.report import frf_figures, model_report, run_report


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


def written(recipe: Run, end: Identified, folder: Path, console: Console) -> Found:
    """Write the result, the report and its figures, and print them."""
    result = content(recipe, end.result)
    write_text(folder / "result.json", json.dumps(result, indent=1, allow_nan=False) + "\n")
    measurement = end.searched.evidence.measurement
    told = run_report(
        recipe.path.stem,
        end.searched,
        end.result,
        recipe.config.log.n_panel,
        # Of a search that had ended, and whose rows someone took away, there is no curve.
        None if end.outcome is None or not read_history(folder) else histories([folder]),
        None if measurement is None else recipe.placement(measurement),
        f"torchplate run {shlex.quote(str(recipe.path))}",
    )
    write_files(folder, told)
    say(console, folder, result, end.result)
    return Found(folder, result, end.result.caveats)


def written_of_numbers(recipe: Run, model: PlateModel, folder: Path, console: Console) -> Found:
    """A config of numbers alone, without a measurement: the model's natural frequencies."""
    found = evaluated(model, model.known.new_zeros(0), recipe.optimizer(), settings_of(recipe))
    result = content(recipe, found)
    write_text(folder / "result.json", json.dumps(result, indent=1, allow_nan=False) + "\n")
    listed = ", ".join(f"{hertz:.2f}" for hertz in found.natural_frequencies_hz)
    text = f"Natural frequencies [Hz], undamped, rigid-body modes first: {listed}."
    write_files(folder, model_report(recipe.path.stem, model, found, f"torchplate run {shlex.quote(str(recipe.path))}"))
    console.print(f"[bold]{escape(recipe.path.stem)}[/]: {text}\n  Results: {escape(str(folder))}", soft_wrap=True)
    return Found(folder, result, [])


def logged(recipe: Run, log: RunLog, end: Identified, step: int) -> None:
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


def all_settings() -> dict[str, Any]:
    """Every setting that some search has, at its default."""
    return {name: value for kind in SEARCHES.values() for name, value in vars(kind()).items()}


def content(recipe: Run, result: Result) -> dict[str, Any]:
    """`result.json`, with the search as the config has it."""
    return result.to_dict() | {"search": recipe.config.search.model_dump(mode="json")}


def say(console: Console, folder: Path, result: dict[str, Any], found: Result) -> None:
    """Print what result.json holds, what must be known of it, and where it lies."""
    if result["parameters"]:
        table = plain_table("parameter", "value", "standard error", "unit", "")
        for name, entry in result["parameters"].items():
            std = "not seen" if entry["std"] is None else f"{entry['std']:.2g}"
            table.add_row(
                escape(name), f"{entry['value']:.6g}", std, entry["unit"], "on its bound" if entry["at_bound"] else ""
            )
        console.print(table)
    if "modes" in result:
        table = plain_table("mode", "measured [Hz]", "model [Hz]", "MAC")
        for pair in result["modes"]:
            hertzs = f"{pair['measured_hz']:.2f}", f"{pair['model_hz']:.2f}"
            table.add_row(str(pair["mode"]), *hertzs, f"{pair['mac']:.3f}")
        console.print(table)
    for sentence in found.misread:  # before a fit that they explain
        console.print(f"  [yellow]Note:[/] {escape(sentence)}")
    console.print(f"  {result['objective_kind']} {result['objective']:.6g}. {result['fit']}")
    console.print(f"  {result['optimizer']}: {result['status']}" if result["parameters"] else f"  {result['status']}")
    for sentence in found.caveats[len(found.misread) :]:
        console.print(f"  [yellow]Note:[/] {escape(sentence)}")
    console.print(f"  Results: {folder}", markup=False, soft_wrap=True)


def described(objective: Objective) -> str:
    """What is compared, and what is searched, in a line."""
    evidence, parts = objective.evidence, []
    if (frfs := evidence.measurement) is not None:
        first, last = float(frfs.frequency[0]), float(frfs.frequency[-1])
        lines = f"{counted(len(frfs.frequency), 'line')}, {first:g} to {last:g} Hz"
        parts.append(f"{counted(len(frfs.pairs), 'FRF')} ({frfs.kind}), {lines}")
    if evidence.natural_frequencies is not None:
        parts.append(counted(len(evidence.natural_frequencies.mode), "natural frequency", "natural frequencies"))
    if (modal := evidence.modal_model) is not None:
        points = counted(len(modal.place), "point")
        parts.append(f"{counted(len(modal.modal.frequency), 'mode')} with shapes at {points}")
    names = ", ".join(objective.model.names) or "nothing"
    return f"{' and '.join(parts)}; searching {names}"


def settings_of(recipe: Run) -> Settings:
    """The part of a config's search that is not the optimiser's own."""
    return Settings(**{field.name: getattr(recipe.config.search, field.name) for field in fields(Settings)})
