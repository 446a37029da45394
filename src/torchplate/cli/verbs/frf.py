"""`torchplate frf RECORDS... --out FILE.uff`: from the time records of hits to FRFs, or from FRFs without nodes."""

import re
import shlex
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from torchplate.cli.config import InputError
from torchplate.cli.folder.writing import asked_for
from torchplate.cli.progress.console import speaking
from torchplate.measurement import (
    UFF_SUFFIX,
    Cutting,
    Estimate,
    FrfTable,
    Layout,
    Measurement,
    Recording,
    Windows,
    frf_of_hits,
    frfs_of_tables,
    read_frf_table,
    read_node_table,
    read_recordings,
    with_node_table,
    write_uff,
)
from torchplate.notation import counted


@dataclass(frozen=True)
class Conversion:
    """What is told on the command line; see `measurement.Layout`, `Cutting` and `Windows`.

    Args:
        layout: Of the files' channels.
        references: The node that is hit, one for each file or one for all.
        cutting: How hits are cut out.
        windows: Over each hit.
        estimator: "H1", "H2" or "Hv".
        nodes: Table of the nodes' places.
        overwrite: Another file that has the name of the result.
    """

    layout: Layout = field(default_factory=Layout)
    references: tuple[int, ...] = ()
    cutting: Cutting = field(default_factory=Cutting)
    windows: Windows = field(default_factory=Windows)
    estimator: Estimate = "H1"
    nodes: Path | None = None
    overwrite: bool = False


def frf(records: Sequence[Path], out: Path, told: Conversion, console: Console | None = None) -> Measurement:
    """Estimate the FRFs of time records, or name the nodes of FRFs in tables, and write them.

    Args:
        records: Files of time records, or tables of FRFs.
        out: .uff, .unv, .uf or .npz.
        told: What the files do not say.
        console: Where is said what was left out.

    Raises:
        InputError: Something that was told cannot be, or `out` holds something else.
        MeasurementError: A file cannot be used.
    """
    console = console or speaking()
    if out.suffix.lower() not in (*UFF_SUFFIX, ".npz"):
        raise InputError(f"--out {out}: Expected a name that ends in .uff or .npz, got '{out.suffix}'. Rename it.")
    if len(records) > 1 and told.references and len(told.references) not in (1, len(records)):
        raise InputError(
            f"--reference: Expected one node for each of {len(records)} files, or one for all, got "
            f"{len(told.references)}. Correct it."
        )
    _check_told(records, told)
    if not told.references:
        _check_names(records)
    tables = [read_frf_table(path) for path in records]
    if all(table is not None for table in tables):
        return _named_table(records, [table for table in tables if table is not None], out, told, console)
    recordings: list[Recording] = []
    named: list[str] = []
    for number, path in enumerate(records):
        given = told.references[min(number, len(told.references) - 1)] if told.references else None
        read = read_recordings(path, replace(told.layout, reference=given))
        recordings += _labelled(read, path, told)
        if any(recording.reference == 0 for recording in read):
            named.append(f"{recordings[-1].reference} ({path.name})")
    measurement = _written(frf_of_hits(recordings, told.cutting, told.windows, told.estimator), out, told)
    if named:
        text = ", ".join(named)
        say = f"Nodes that were hit, by the last number in the files' names: {text}. --reference gives others."
        console.print(say, highlight=False, markup=False, soft_wrap=True)
    n_frf, n_record = counted(len(measurement.pairs), "FRF"), counted(len(recordings), "recording")
    what = f"{n_frf} ({measurement.kind}, {told.estimator}) from {n_record}"
    _say(measurement, what, out, console, tuple(_of_records(measurement, recordings)))
    return measurement


def _written(measurement: Measurement, out: Path, told: Conversion) -> Measurement:
    """With its nodes' places, where they were told."""
    if told.nodes is not None:
        measurement = with_node_table(measurement, read_node_table(told.nodes), "m")
    with asked_for(out, force=told.overwrite, option="--overwrite") as partial:
        if out.suffix.lower() == ".npz":
            measurement.to_npz(partial)
        else:
            write_uff(measurement, partial)
    return measurement


def _named_table(
    records: Sequence[Path], tables: Sequence[FrfTable], out: Path, told: Conversion, console: Console
) -> Measurement:
    """FRFs that are there already, with their nodes.

    Raises:
        InputError: Nodes that nobody told.
    """
    n_frf = counted(sum(table.n_frf for table in tables), "FRF")
    references = told.references
    if not references and len(records) > 1:
        references = tuple(int(found[-1]) for path in records if (found := re.findall(r"\d+", path.stem)))
    if not told.layout.responses or not references or (len(records) > 1 and len(references) != len(records)):
        raise InputError(
            f"{records[0]}: Expected the nodes of {n_frf}, which the file does not name, got none of the "
            f"{'references' if told.layout.responses else 'responses'}. Give where the sensors are and where was hit, "
            "--response 3 --reference 28 102, say."
        )
    measurement = _written(frfs_of_tables(records, tables, told.layout, references), out, told)
    unused = ", ".join(_of_hits(told))
    remarks = [f"{unused}: left aside, as the file holds FRFs and no time records."] if unused else []
    _say(measurement, f"{n_frf} ({measurement.kind}) from {records[0]}", out, console, remarks)
    return measurement


def _of_hits(told: Conversion) -> list[str]:
    """The options that were given and that FRFs have no use for."""
    usual = Cutting()
    given = {
        "--rate": told.layout.rate is not None,
        "--force": told.layout.force is not None,
        "--estimator": told.estimator != "H1",
        "--trigger": told.cutting.trigger != usual.trigger,
        "--pre-trigger": told.cutting.pre_trigger != usual.pre_trigger,
        "--duration": told.cutting.duration is not None,
        "--keep-all": told.cutting.double_hit is None,
        "--force-window": told.windows.force is not None,
        "--exponential-window": told.windows.exponential is not None,
    }
    return [option for option, is_given in given.items() if is_given]


def _check_told(records: Sequence[Path], told: Conversion) -> None:
    """Whether files and nodes can be meant.

    Raises:
        InputError: A file that is named twice, whose hits would agree with themselves; a node below 1.
    """
    twice = [path for path, number in Counter(path.resolve() for path in records).items() if number > 1]
    if twice:
        raise InputError(
            f"{twice[0]}: Expected each file once, got it twice: its hits would be averaged with themselves. Leave one "
            "out, or name the file that was meant."
        )
    twice_there = [node for node, number in Counter(told.layout.responses).items() if number > 1]
    if twice_there:
        raise InputError(
            f"--response: Expected a node of its own for each response, got {twice_there[0]} twice: of two sensors at "
            "one node only one would be left. Correct it, or leave one channel out of the file."
        )
    for option, nodes in (("--response", told.layout.responses), ("--reference", told.references)):
        if nodes and min(nodes) < 1:
            raise InputError(f"{option}: Expected node labels, which count from 1, got {min(nodes)}. Correct it.")


def _check_names(records: Sequence[Path]) -> None:
    """Whether the last number of each name can be the node that is hit.

    Raises:
        InputError: if it seems to count the hits at each node: hit_11_1, hit_11_2, hit_12_1, ...
    """
    numbers = [re.findall(r"\d+", path.stem) for path in records if path.suffix.lower() not in UFF_SUFFIX]
    if not numbers or min(map(len, numbers)) < 2:
        return
    counts = defaultdict[int, list[int]](list)
    for *_, before, last in numbers:
        counts[int(before)].append(int(last))
    first = min(map(min, counts.values()))
    runs = all(sorted(found) == list(range(first, first + len(found))) for found in counts.values())
    if len(counts) < 2 or min(map(len, counts.values())) < 2 or first > 1 or not runs:
        return
    raise InputError(
        f"{records[0]}: Expected the node that is hit as the last number of a name, got {first}, {first + 1} ... after "
        f"each of {', '.join(map(str, sorted(counts)[:4]))}{' ...' if len(counts) > 4 else ''}, which may count the "
        f"hits. Say which it is: --reference {' '.join(before for *_, before, _ in numbers)}, or --reference "
        f"{' '.join(last for *_, last in numbers)}."
    )


def _labelled(recordings: list[Recording], path: Path, told: Conversion) -> list[Recording]:
    """With the node that is hit taken from the file's name, where nothing else tells it."""
    if path.suffix.lower() not in UFF_SUFFIX and not told.layout.responses:
        raise InputError(
            f"{path}: Expected the nodes of the responses, which this format does not hold, got none. Give them as "
            "--response 3, one for each response channel."
        )
    found = []
    for recording in recordings:
        if recording.reference == 0:
            digits = re.findall(r"\d+", path.stem)
            if not digits:
                raise InputError(
                    f"{path}: Expected the node that is hit, in the file or as the last number of its name, got "
                    "neither. Give it as --reference 12."
                )
            found.append(replace(recording, reference=int(digits[-1])))
        else:
            found.append(recording)
    return found


def _say(measurement: Measurement, what: str, out: Path, console: Console, remarks: Sequence[str] = ()) -> None:
    first, last = float(measurement.frequency[0]), float(measurement.frequency[-1])
    step = "uneven lines" if measurement.step is None else f"step {measurement.step:.4g} Hz"
    lines = [f"{what}, {first:.6g} to {last:.6g} Hz, {step}: {out}"]
    lines += [f"  Note: {note}" for note in (*measurement.notes, *remarks)]
    nodes = "" if measurement.response[0].coordinate is not None else " --nodes nodes.csv"
    for line in (*lines, f"Next: torchplate new {shlex.quote(str(out))}{nodes}"):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _of_records(measurement: Measurement, recordings: Sequence[Recording]) -> Iterator[str]:
    """What else is to be said of FRFs from hits."""
    if not all(recording.has_unit for recording in recordings):
        yield (
            "the records state no unit that is known; taken as N and SI. Give --scale FORCE RESPONSE, or write "
            "gain: unknown in the config."
        )
    if measurement.coherence is None:
        yield "one hit a node, so there is no coherence."
