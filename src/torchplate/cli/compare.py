"""`torchplate compare`: searches laid over each other, by evaluations and by generations."""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from torchplate.cli.config import InputError
from torchplate.cli.log import read_history
from torchplate.cli.writing import write_bytes, write_text
from torchplate.report import Convergence, convergence, png

# A search counts as arrived when its best objective is within this part of the best that any run found.
WITHIN = 0.01


class Compared(NamedTuple):
    """Searches of one kind, put together over runs and seeds.

    Attributes:
        history: best objective over evaluations and generations, a row for each search.
        parameters: names of the searched parameters.
        theta: where each search ended, in SI units [n_search, n_parameter].
        objective: the objective there [n_search].
        evaluations: evaluations until within 1 % of the best of all runs; NaN where a search never was.
    """

    history: Convergence
    parameters: list[str]
    theta: np.ndarray
    objective: np.ndarray
    evaluations: np.ndarray


def compare(folders: Sequence[Path], out: Path | None = None, console: Console | None = None) -> dict[str, Compared]:
    """Print and write the comparison of finished runs; searches of the same settings but the seed are one line.

    Args:
        folders: of runs, each with result.json and history.csv.
        out: where comparison.md and comparison.png go; the folder above the runs if left out.
        console: where the tables go.

    Raises:
        InputError: if a folder holds no finished search, or the runs differ in what they minimise.
    """
    console = console or Console()
    results = [read_result(folder) for folder in folders]
    kinds = {result["objective_kind"] for result in results}
    if len(kinds) > 1:
        raise InputError(
            f"compare: Expected runs of one objective, got {' and '.join(sorted(kinds))}. Compare them apart."
        )
    searched = {", ".join(result["parameters"]) or "none" for result in results}
    if len(searched) > 1:
        raise InputError(
            f"compare: Expected runs that search the same parameters, got {' against '.join(sorted(searched))}. "
            "Compare them apart."
        )
    groups = gathered(folders)
    out = out or Path(os.path.commonpath([folder.resolve().parent for folder in folders]))
    figure = out / "comparison.png"
    drawn = convergence({label: group.history for label, group in groups.items()}, kinds.pop())
    figure.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(figure, png(drawn, 90, 64))
    summary, parameters = _tables(groups)
    for table in (summary, parameters):
        console.print(_rich(table))
    text = "\n\n".join(
        ["# Searches compared", _markdown(summary), _markdown(parameters), f"![convergence]({figure.name})"]
    )
    write_text(out / "comparison.md", text + "\n")
    console.print(f"Comparison: {out / 'comparison.md'}", markup=False, soft_wrap=True)
    return groups


def read_result(folder: Path) -> dict[str, Any]:
    """`result.json` of a finished run.

    Raises:
        InputError: if there is none.
    """
    path = Path(folder) / "result.json"
    if not path.exists():
        raise InputError(
            f"{folder}: Expected a finished run with result.json, found none. Run it, or correct the path."
        )
    try:
        result: dict[str, Any] = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: Expected JSON, got a file that is not ({error}). Run it again.") from None
    return result


def histories(folders: Sequence[Path]) -> dict[str, Convergence]:
    """Histories by the searches' settings; shorter ones keep their last value."""
    rows: dict[str, list[tuple[list[float], list[float]]]] = {}
    for folder, name in zip(folders, _labels(folders), strict=True):
        found: dict[str, tuple[list[float], list[float]]] = {}
        for row in read_history(folder):
            steps, values = found.setdefault(row["search"], ([], []))
            steps.append(float(row["n_evaluation"]))
            values.append(float(row["best_objective"]))
        if not found:
            raise InputError(
                f"{folder}: Expected a run with a history of its search, found none. Compare searches only."
            )
        rows.setdefault(name, []).extend(found.values())
    return {
        name: Convergence(*(_filled([row[part] for row in table]) for part in (0, 1))) for name, table in rows.items()
    }


def gathered(folders: Sequence[Path]) -> dict[str, Compared]:
    """All that is compared, by the searches' settings."""
    curves, labels = histories(folders), _labels(folders)
    best = min(float(np.nanmin(curve.best)) for curve in curves.values())
    groups = {}
    for name, curve in curves.items():
        results = [read_result(folder) for folder, own in zip(folders, labels, strict=True) if own == name]
        parameters = list(results[0]["parameters"])
        arrived = curve.best <= best * (1 + WITHIN)
        first = np.take_along_axis(curve.n_evaluation, arrived.argmax(axis=1)[:, None], axis=1)[:, 0]
        groups[name] = Compared(
            curve,
            parameters,
            np.concatenate([_theta(result) for result in results]),
            np.concatenate([_objectives(result) for result in results]),
            np.where(arrived.any(axis=1), first, np.nan),
        )
    return groups


def label(result: Mapping[str, Any]) -> str:
    """What names a search: its optimiser, and its strategy where it has one."""
    return " ".join([result["optimizer"], *([result["search"]["strategy"]] if "strategy" in result["search"] else [])])


def _labels(folders: Sequence[Path]) -> list[str]:
    """What names each run's search, with the settings by which searches of that name differ; a seed is no setting."""
    results = [read_result(folder) for folder in folders]
    names = [label(result) for result in results]
    full = []
    for name, result in zip(names, results, strict=True):
        alike = [other["search"] for own, other in zip(names, results, strict=True) if own == name]
        keys = {key: None for settings in alike for key in settings if key not in ("seed", "n_repeat")}
        differing = [key for key in keys if any(settings.get(key) != alike[0].get(key) for settings in alike)]
        own = ", ".join(f"{key} {result['search'].get(key, 'left out')}" for key in differing)
        full.append(f"{name} ({own})" if own else name)
    return full


def _theta(result: Mapping[str, Any]) -> np.ndarray:
    if "repeats" in result:
        return np.array(result["repeats"]["theta"])
    return np.array([[entry["value"] for entry in result["parameters"].values()]])


def _objectives(result: Mapping[str, Any]) -> np.ndarray:
    return np.array(result["repeats"]["objective"] if "repeats" in result else [result["objective"]])


def _filled(rows: Sequence[Sequence[float]]) -> np.ndarray:
    longest = max(len(row) for row in rows)
    return np.array([[*row, *[row[-1]] * (longest - len(row))] for row in rows])


def _tables(groups: Mapping[str, Compared]) -> tuple[list[list[str]], list[list[str]]]:
    """Header and rows of the two tables, a column for each search: how they went, and where they ended."""
    columns: list[list[str]] = [["", "searches", "best objective", "median", "quartiles", "evaluations"]]
    columns[0] += [f"evaluations to within {100 * WITHIN:g} % of the best", "searches that came there"]
    found: list[list[str]] = [["", *next(iter(groups.values())).parameters]]
    for name, group in groups.items():
        lower, middle, upper = np.quantile(group.objective, [0.25, 0.5, 0.75])
        arrived = np.isfinite(group.evaluations)
        columns.append(
            [
                name,
                str(len(group.objective)),
                f"{group.objective.min():.6g}",
                f"{middle:.6g}",
                f"{lower:.6g} to {upper:.6g}",
                f"{np.median(group.history.n_evaluation[:, -1]):.0f}",
                f"{np.median(group.evaluations[arrived]):.0f}" if arrived.any() else "never",
                f"{arrived.sum()} of {len(arrived)}",
            ]
        )
        spread = np.quantile(group.theta, [0.25, 0.5, 0.75], axis=0).T
        single = len(group.theta) == 1
        found.append(
            [name, *(f"{m:.6g}" if single else f"{m:.6g} ({low:.6g} to {high:.6g})" for low, m, high in spread)]
        )
    return [list(row) for row in zip(*columns, strict=True)], [list(row) for row in zip(*found, strict=True)]


def _rich(table: list[list[str]]) -> Table:
    drawn = Table(*map(escape, table[0]), box=None, padding=(0, 2))
    for row in table[1:]:
        drawn.add_row(*map(escape, row))
    return drawn


def _markdown(table: list[list[str]]) -> str:
    rows = [table[0], ["---"] * len(table[0]), *table[1:]]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
