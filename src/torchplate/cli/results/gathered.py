"""Searches put together over runs and seeds: those of the same settings but the seed are one."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchplate.cli.config import InputError
from torchplate.cli.progress.log import read_history
from torchplate.cli.results.finished import Finished, read_finished
from torchplate.report import WITHIN, Compared, Convergence


def histories(folders: Sequence[Path]) -> dict[str, Convergence]:
    """Histories by the searches' settings; shorter ones keep their last value."""
    return _histories([read_finished(folder) for folder in folders])


def _histories(runs: Sequence[Finished]) -> dict[str, Convergence]:
    rows: dict[str, list[tuple[list[float], list[float]]]] = {}
    for run, name in zip(runs, _labels(runs), strict=True):
        found: dict[str, tuple[list[float], list[float]]] = {}
        for row in read_history(run.folder):
            steps, values = found.setdefault(row["search"], ([], []))
            steps.append(float(row["n_evaluation"]))
            values.append(float(row["best_objective"]))
        if not found:
            raise InputError(
                f"{run.folder}: Expected a run with a history of its search, found none. Compare searches only."
            )
        # The best first, as a result lists its repeats.
        rows.setdefault(name, []).extend(sorted(found.values(), key=lambda curve: curve[1][-1]))
    return {
        name: Convergence(*(_filled([row[part] for row in table]) for part in (0, 1))) for name, table in rows.items()
    }


def gathered(runs: Sequence[Finished]) -> dict[str, Compared]:
    """All that is compared, by the searches' settings."""
    curves, labels = _histories(runs), _labels(runs)
    best = min(float(np.nanmin(curve.best)) for curve in curves.values())
    groups = {}
    for name, curve in curves.items():
        own = [run for run, label in zip(runs, labels, strict=True) if label == name]
        arrived = curve.best <= best * (1 + WITHIN)
        first = np.take_along_axis(curve.n_evaluation, arrived.argmax(axis=1)[:, None], axis=1)[:, 0]
        objectives = [_objectives(run.result) for run in own]
        groups[name] = Compared(
            curve,
            {parameter: entry["unit"] for parameter, entry in own[0].result["parameters"].items()},
            np.concatenate([_theta(run.result) for run in own]),
            np.concatenate(objectives),
            np.where(arrived.any(axis=1), first, np.nan),
            tuple(str(run.folder) for run, ends in zip(own, objectives, strict=True) for _ in ends),
        )
    return groups


def label(result: Mapping[str, Any]) -> str:
    """What names a search: its optimiser, and its strategy where it has one."""
    return " ".join([result["optimizer"], *([result["search"]["strategy"]] if "strategy" in result["search"] else [])])


def _labels(runs: Sequence[Finished]) -> list[str]:
    """What names each run's search, with the settings by which searches of that name differ; a seed is no setting."""
    names, settings = [label(run.result) for run in runs], [_settings(run) for run in runs]
    full = []
    for name, mine in zip(names, settings, strict=True):
        alike = [other for own, other in zip(names, settings, strict=True) if own == name]
        keys = {key: None for others in alike for key in others if key not in ("seed", "n_repeat")}
        differing = [key for key in keys if any(others.get(key) != alike[0].get(key) for others in alike)]
        own = ", ".join(f"{key} {mine.get(key, 'left out')}" for key in differing)
        full.append(f"{name} ({own})" if own else name)
    return full


def _settings(run: Finished) -> dict[str, Any]:
    """Those of the search, and the intervals it had."""
    return run.result["search"] | {f"{name} in": interval for name, interval in run.intervals.items()}


def _theta(result: Mapping[str, Any]) -> np.ndarray:
    if "repeats" in result:
        return np.array(result["repeats"]["theta"])
    return np.array([[entry["value"] for entry in result["parameters"].values()]])


def _objectives(result: Mapping[str, Any]) -> np.ndarray:
    return np.array(result["repeats"]["objective"] if "repeats" in result else [result["objective"]])


def _filled(rows: Sequence[Sequence[float]]) -> np.ndarray:
    longest = max(len(row) for row in rows)
    return np.array([[*row, *[row[-1]] * (longest - len(row))] for row in rows])
