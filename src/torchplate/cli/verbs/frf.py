"""`torchplate frf RECORDS... --out FILE.uff`: from the time records of hits to FRFs and coherence."""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from torchplate.cli.config import InputError
from torchplate.cli.folder.writing import whole
from torchplate.measurement import (
    UFF_SUFFIX,
    Cutting,
    Estimate,
    Layout,
    Measurement,
    Recording,
    Windows,
    frf_of_hits,
    read_nodes,
    read_recordings,
    with_nodes,
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
    """

    layout: Layout = field(default_factory=Layout)
    references: tuple[int, ...] = ()
    cutting: Cutting = field(default_factory=Cutting)
    windows: Windows = field(default_factory=Windows)
    estimator: Estimate = "H1"
    nodes: Path | None = None


def frf(records: Sequence[Path], out: Path, told: Conversion, console: Console | None = None) -> Measurement:
    """Estimate the FRFs of time records, and write them.

    Args:
        records: Files of time records.
        out: .uff, .unv, .uf or .npz.
        told: What the files do not say.
        console: Where is said what was left out.

    Raises:
        InputError: Something that was told cannot be.
        MeasurementError: A file cannot be used.
    """
    console = console or Console()
    if out.suffix.lower() not in (*UFF_SUFFIX, ".npz"):
        raise InputError(f"--out {out}: Expected a name that ends in .uff or .npz, got '{out.suffix}'. Rename it.")
    if told.references and len(told.references) not in (1, len(records)):
        raise InputError(
            f"--reference: Expected one node for each of {len(records)} files, or one for all, got "
            f"{len(told.references)}. Correct it."
        )
    if not told.references:
        _check_names(records)
    recordings: list[Recording] = []
    named: list[str] = []
    for number, path in enumerate(records):
        given = told.references[min(number, len(told.references) - 1)] if told.references else None
        read = read_recordings(path, replace(told.layout, reference=given))
        recordings += _labelled(read, path, told)
        if any(recording.reference == 0 for recording in read):
            named.append(f"{recordings[-1].reference} ({path.name})")
    measurement = frf_of_hits(recordings, told.cutting, told.windows, told.estimator)
    if told.nodes is not None:
        measurement = with_nodes(measurement, read_nodes(told.nodes), str(told.nodes))
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole(out) as partial:
        if out.suffix.lower() == ".npz":
            measurement.to_npz(partial)
        else:
            write_uff(measurement, partial)
    if named:
        text = ", ".join(named)
        say = f"Nodes that were hit, by the last number in the files' names: {text}. --reference gives others."
        console.print(say, highlight=False, markup=False, soft_wrap=True)
    _say(measurement, recordings, out, told, console)
    return measurement


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


def _say(
    measurement: Measurement, recordings: Sequence[Recording], out: Path, told: Conversion, console: Console
) -> None:
    first, last = float(measurement.frequency[0]), float(measurement.frequency[-1])
    step = measurement.step or 0.0
    console.print(
        f"{counted(len(measurement.pairs), 'FRF')} ({measurement.kind}, {told.estimator}) from "
        f"{counted(len(recordings), 'recording')}, "
        f"{first:.6g} to {last:.6g} Hz, step {step:.4g} Hz: {out}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
    for note in measurement.notes:
        console.print(f"  Note: {note}", highlight=False, markup=False, soft_wrap=True)
    if not all(recording.has_unit for recording in recordings):
        console.print(
            "  Note: the records state no unit that is known; taken as N and SI. Give --scale FORCE RESPONSE, or write "
            "gain: unknown in the config.",
            highlight=False,
            soft_wrap=True,
        )
    if measurement.coherence is None:
        console.print("  Note: one hit a node, so there is no coherence.", highlight=False)
    nodes = "" if measurement.response[0].coordinate is not None else " --nodes nodes.csv"
    console.print(f"Next: torchplate new {out}{nodes}", highlight=False, markup=False, soft_wrap=True)
