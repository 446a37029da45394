"""`torchplate compare`: searches laid over each other, by evaluations and by generations; plate by plate."""

import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from torchplate.cli.config import InputError
from torchplate.cli.folder.writing import check_kept, write_files
from torchplate.cli.progress.console import speaking
from torchplate.cli.results.finished import RESULT, Finished, by_plate, differences, finished_below, read_finished
from torchplate.cli.results.gathered import gathered
from torchplate.cli.results.table import plain_table
from torchplate.report import Compared, comparison_report, comparison_tables
from torchplate.report import Table as Block


def compare(
    folders: Sequence[Path], out: Path | None = None, console: Console | None = None, *, force: bool = False
) -> list[dict[str, Compared]]:
    """Print and write the comparison of finished runs; searches of the same settings but the seed are one line.

    Runs that are named must be of one plate, which is one mesh, measurement, model and objective. Those found below a
    folder are taken apart: a comparison for each plate.

    Args:
        folders: of runs, each with result.json and history.csv, or folders of such runs.
        out: where comparison.md and the files beside it go; the folder above the runs if left out. Of several plates
            each has a folder of its own in it.
        console: where the tables go.
        force: write over a comparison of other runs.

    Returns:
        Of each plate, what was compared by the settings of the searches.

    Raises:
        InputError: if a folder holds no finished search, runs that are named are of different plates, or another
            comparison is where this one goes.
    """
    console = console or speaking()
    runs: dict[Path, Finished] = {}
    is_swept = False
    for folder in map(Path, folders):
        if (folder / RESULT).exists() or not folder.is_dir():
            found = [read_finished(folder)]
        else:
            is_swept = True
            found, left = finished_below(folder)
            for sentence in left:
                console.print(f"  {sentence}", markup=False, highlight=False, soft_wrap=True)
        runs |= {run.folder.resolve(): run for run in found}
    plates = by_plate(list(runs.values()))
    told = differences([group[0].plate for group in plates])
    if told and not is_swept:
        _refuse([group[0] for group in plates], told)
    if told:
        console.print(f"{len(plates)} plates, each compared apart. They differ in", markup=False)
        for line in told:
            console.print(f"  {line}", markup=False, highlight=False, soft_wrap=True)
    homes = _homes(plates, out)
    return [_one_plate(group, home, console, force) for group, home in zip(plates, homes, strict=True)]


def _refuse(runs: Sequence[Finished], told: Sequence[str]) -> None:
    """Say why runs of different plates are not compared."""
    kinds = {run.result["objective_kind"] for run in runs}
    if len(kinds) > 1:
        raise InputError(
            f"compare: Expected runs of one objective, got {' and '.join(sorted(kinds))}. Compare them apart."
        )
    searched = {", ".join(run.result["parameters"]) or "none" for run in runs}
    if len(searched) > 1:
        raise InputError(
            f"compare: Expected runs that search the same parameters, got {' against '.join(sorted(searched))}. "
            "Compare them apart."
        )
    raise InputError(
        f"compare: Expected runs of one plate, got runs that differ in {'; '.join(told)}. Compare them apart, or give "
        "the folder above them, in which each plate is compared by itself."
    )


def _homes(plates: Sequence[Sequence[Finished]], out: Path | None) -> list[Path]:
    """Where each plate's comparison goes: beside its runs, or by the name of the folder that they share."""
    shared = [Path(os.path.commonpath([run.folder.resolve().parent for run in group])) for group in plates]
    whole = Path(os.path.commonpath(shared))
    if len(plates) == 1:
        return [out or whole]
    are_apart = len(set(shared)) == len(shared) and whole not in shared
    names = [home.relative_to(whole) if are_apart else Path(f"plate_{turn}") for turn, home in enumerate(shared, 1)]
    return [(out or whole) / name for name in names]


def _one_plate(runs: Sequence[Finished], out: Path, console: Console, force: bool) -> dict[str, Compared]:
    """Print and write the comparison of one plate's runs."""
    groups = gathered(runs)
    files = comparison_report(groups, runs[0].result["objective_kind"])
    check_kept({out / name: content for name, content in files.items()}, force=force)
    write_files(out, files)
    for table in comparison_tables(groups):
        console.print(_rich(table, console.width))
    console.print(f"Comparison: {out / 'comparison.md'}", markup=False, soft_wrap=True)
    return groups


def _rich(table: Block, width: int) -> Table:
    """A table of a report; where names would be broken it is laid on its side, if so it is narrower."""
    rows = [[name.removesuffix(">") for name in table.head], *([*row] for row in table.rows)]
    turned = [list(column) for column in zip(*rows, strict=True)]
    aside = _narrowest(rows) > max(width, _narrowest(turned))
    if aside:
        rows = turned
    drawn = plain_table(*rows[0], whole=aside)
    for row in rows[1:]:
        drawn.add_row(*map(escape, row))
    return drawn


def _narrowest(rows: Sequence[Sequence[str]]) -> int:
    """Letters in a line of the table whose cells wrap at blanks alone, with the room between columns."""
    columns = zip(*rows, strict=True)
    return sum(4 + max((len(word) for cell in column for word in cell.split()), default=0) for column in columns)
