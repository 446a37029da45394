"""Finished runs: where they lie below a folder, which plate each is of, and in what two plates differ."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from torchplate.cli.config import InputError, read_config

RESULT, HISTORY = "result.json", "history.csv"
# What makes two runs comparable: with another of these the same objective would be another number.
SECTIONS = ("mesh", "measurement", "effects", "objective")
NEEDED = {"parameters", "objective", "objective_kind", "optimizer", "search"}
MOST_SHOWN = 8
"""Differences that are said; of two strangers there are many."""


class Finished(NamedTuple):
    """One finished run.

    Attributes:
        folder: where it lies.
        result: the content of its result.json.
        config: the config it was made from; empty where none lies beside the result.
    """

    folder: Path
    result: dict[str, Any]
    config: dict[str, Any]

    @property
    def intervals(self) -> dict[str, Any]:
        """What was searched, by name: its interval."""
        effects = self.config.get("effects", {})
        searched = (name.partition(".") for name in self.result["parameters"])
        return {f"{label}.{key}": effects[label][key] for label, _, key in searched if key in effects.get(label, {})}

    @property
    def plate(self) -> dict[str, str]:
        """Every setting of mesh, measurement, effects and objective, by its key; an interval is "searched"."""
        flat: dict[str, str] = {}
        for section in SECTIONS:
            self._flatten(flat, section, self.config.get(section))
        flat |= {f"effects.{name}": "searched" for name in self.result["parameters"]}
        return flat | {"objective.kind": str(self.result["objective_kind"])}

    def _flatten(self, flat: dict[str, str], key: str, value: Any) -> None:
        if key.removeprefix("effects.") in self.result["parameters"]:
            return
        if isinstance(value, dict):
            for name, inner in value.items():
                self._flatten(flat, f"{key}.{name}", inner)
        elif isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
            for place, inner in enumerate(value):
                self._flatten(flat, f"{key}.{place}", inner)
        elif value is not None:
            is_file = key.startswith("measurement.") and key.endswith(".file")
            flat[key] = str((self.folder / str(value)).resolve() if is_file else value)


def read_finished(folder: Path) -> Finished:
    """One finished run.

    Raises:
        InputError: if there is none, or its files are broken.
    """
    path = Path(folder) / RESULT
    if not path.exists():
        raise InputError(f"{folder}: Expected a finished run with {RESULT}, found none. Run it, or correct the path.")
    try:
        result: dict[str, Any] = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: Expected JSON, got a file that is not ({error}). Run it again.") from None
    if not isinstance(result, dict) or not result.keys() >= NEEDED:
        raise InputError(f"{path}: Expected the result of a run, got another file. Run it again.")
    config = path.with_name("config.yaml")
    return Finished(Path(folder), result, read_config(config)[0] if config.exists() else {})


def finished_below(folder: Path) -> tuple[list[Finished], list[str]]:
    """The searches below a folder, and what is left out there, a sentence each.

    Raises:
        InputError: if there is none.
    """
    found, left = [], []
    for home in sorted({path.parent for name in (RESULT, HISTORY) for path in folder.rglob(name)}):
        if not (home / RESULT).exists():
            left.append(f"{home} is left out: its search has not ended.")
        elif not (home / HISTORY).exists():
            left.append(f"{home} is left out: nothing was searched there.")
        else:
            found.append(read_finished(home))
    if not found:
        raise InputError(
            f"{folder}: Expected a finished run with {RESULT}, or a folder of such runs, found none. Run one, or "
            "correct the path."
        )
    return found, left


def by_plate(runs: Sequence[Finished]) -> list[list[Finished]]:
    """Runs of one plate together, in the order in which each plate is met first."""
    found: list[tuple[dict[str, str], list[Finished]]] = []
    for run in runs:
        plate = run.plate
        same = next((group for known, group in found if known == plate), None)
        if same is None:
            found.append((plate, [run]))
        else:
            same.append(run)
    return [group for _, group in found]


def differences(plates: Sequence[Mapping[str, str]]) -> list[str]:
    """The keys in which plates differ, each with its values: "mesh.n_x: 10 against 20"."""
    keys = dict.fromkeys(key for plate in plates for key in plate)
    told = []
    for key in keys:
        values = list(dict.fromkeys(plate.get(key, "left out") for plate in plates))
        if len(values) > 1:
            told.append(f"{key}: {' against '.join(values)}")
    more = len(told) - MOST_SHOWN
    return [*told[:MOST_SHOWN], *([f"and {more} more"] if more > 0 else [])]
