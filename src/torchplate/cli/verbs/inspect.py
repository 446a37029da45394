"""`torchplate inspect FILE`: what a measurement file holds, what looks wrong in it, and one figure."""

import re
import shlex
import zipfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from torchplate.cli.folder.writing import asked_for
from torchplate.cli.progress.console import speaking
from torchplate.cli.results.table import plain_table
from torchplate.measurement import (
    RECORD_SUFFIX,
    UFF_SUFFIX,
    Contents,
    FrfTable,
    Measurement,
    MeasurementError,
    ModalModel,
    Quality,
    Recording,
    assess,
    describe,
    is_modal_table,
    propose,
    read_frf_table,
    read_geometry,
    read_measurement,
    read_modal_table,
    read_recordings,
)
from torchplate.notation import counted, percent

COMMAND = re.compile(r"torchplate [^;]+")


def inspect(path: Path, out: Path | None = None, console: Console | None = None, *, force: bool = False) -> Path | None:
    """Describe a file; report on its FRFs, where there are any, and save one figure of them.

    Args:
        path: A universal file, an .npz archive, time records (WAV, MAT, CSV, LVM), or a table of modes (CSV).
        out: Folder of the figure; by default runs/inspect, under the current folder, where a name's figure is always
            that of the last look.
        console: Where the report goes; by default the terminal.
        force: Write over another figure in `out`.

    Returns:
        The figure's path, OUT/<file's stem>.png; None where the file holds no FRFs that can be used.

    Raises:
        MeasurementError: The file cannot be used.
        InputError: `out` holds another figure of that name.
    """
    console = console or speaking()
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".csv" and is_modal_table(path):
        console.print(_modes(read_modal_table(path), path))
        return None
    table = None if suffix == ".npz" and _holds_frfs(path) else read_frf_table(path)
    if table is not None:
        console.print(_frf_table(table, path))
        return None
    if suffix in RECORD_SUFFIX and (suffix != ".npz" or not _holds_frfs(path)):
        console.print(_records(read_recordings(path), path))
        return None
    contents = describe(path) if suffix in UFF_SUFFIX and path.is_file() else None
    if contents is not None:
        console.print(_contents(contents, path))
        if not contents.has_frf:
            _next(contents, path, console)
            return None
    try:
        measurement = read_measurement(path, normal=3 if contents is None else _normal(path))
    except MeasurementError as error:
        if contents is None:
            raise
        console.print(f"[yellow]No report on the FRFs:[/yellow] {escape(str(error))}", highlight=False, soft_wrap=True)
        if "--kind" in contents.new:
            _next(contents, path, console)
        return None
    quality = assess(measurement)
    console.print(_summary(measurement, quality, Path(path)))
    if quality.coherence or len(measurement.pairs) > 1:
        console.print(_channels(measurement, quality))
    for suspicion in quality.suspicions:
        console.print(f"[yellow]{suspicion.label}[/yellow]: {escape(suspicion.reason)}", highlight=False)
    for note in measurement.notes:
        console.print(f"[yellow]Note:[/yellow] {escape(note)}", highlight=False)
    from torchplate.report import quality_figure

    folder = Path("runs") / "inspect" if out is None else Path(out)
    target = folder / f"{Path(path).stem}.png"
    with asked_for(target, force=force or out is None) as partial:
        quality_figure(measurement, quality, path.name).savefig(partial, format="png", dpi=150)
    console.print(f"Figure: {target}", highlight=False, markup=False, soft_wrap=True)
    if contents is not None:
        _next(contents, path, console)
    return target


def _normal(path: Path) -> int:
    """The file's axis out of the plate: z, unless its points lie in another plane."""
    places, axis = read_geometry(path)
    try:
        return (
            propose(np.array(list(places.values()), dtype=np.float64), axis or 3).frame.normal if places else axis or 3
        )
    except MeasurementError:
        return axis or 3


def _next(contents: Contents, path: Path, console: Console) -> None:
    """The commands of the table, each in one line that can be copied."""
    found = [match.group().strip() for part in contents.parts if (match := COMMAND.search(part.use))]
    name, whole_name = shlex.quote(path.name), shlex.quote(str(path))
    for command in dict.fromkeys(found):
        console.print(f"Next: {command.replace(name, whole_name)}", highlight=False, markup=False, soft_wrap=True)


def _holds_frfs(path: Path) -> bool:
    """Whether an archive says it holds FRFs; one that cannot be opened is left to the reader of FRFs to refuse."""
    if not path.is_file():  # a pipe that nobody writes into would be waited for
        return True
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {"frf", "response", "reference"} <= {*archive.files}
    except (OSError, EOFError, ValueError, zipfile.BadZipFile):
        return True


def _frf_table(table: FrfTable, path: Path) -> Table:
    found = plain_table("", "", title=f"{path}: FRFs")
    lines = table.frequency
    found.add_row(
        "holds", f"{counted(table.n_frf, 'FRF')} of {counted(len(lines), 'line')}, {lines[0]:g} to {lines[-1]:g} Hz"
    )
    found.add_row("unit", escape(table.unit or "none is stated"))
    for note in table.notes:
        found.add_row("note", escape(note))
    what = (
        f"names the nodes: torchplate frf {shlex.quote(path.name)} --response NODE --reference NODE ... --out FRFS.uff"
    )
    found.add_row("what torchplate does", escape(what))
    return found


def _records(recordings: list[Recording], path: Path) -> Table:
    table = plain_table("", "", title=f"{path}: time records")
    first, n = recordings[0], len(recordings)
    length = len(first.force)
    table.add_row(
        "holds",
        f"{counted(n, 'recording')} of {counted(length, 'sample')}, {first.rate:g} Hz, {length / first.rate:.4g} s",
    )
    n_response = len(first.response)
    responses = f"{n_response} response{'s' if n_response > 1 else ''}"
    table.add_row("channels", f"a force up to {np.abs(first.force).max():.4g} and {responses}")
    for note in first.notes:
        table.add_row("note", escape(note))
    name = shlex.quote(path.name)
    what = f"FRFs from hits: torchplate frf {name} --response NODE ... --out FRFS.uff"
    table.add_row("what torchplate does", escape(what))
    return table


def _modes(model: ModalModel, path: Path) -> Table:
    table = plain_table("", "", title=f"{path}: a modal model")
    shown = ", ".join(f"{hertz:.5g}" for hertz in model.frequency[:12].tolist())
    rest = f" and {len(model.frequency) - 12} more" if len(model.frequency) > 12 else ""
    count = f"{counted(len(model.frequency), 'mode')} at {counted(len(model.point), 'point')}"
    table.add_row("holds", f"{count}: {shown}{rest} Hz")
    what = f"in a config: measurement: {{modal_model: {{file: {shlex.quote(path.name)}}}}}"
    table.add_row("what torchplate does", escape(what))
    return table


def _contents(contents: Contents, path: Path) -> Table:
    table = plain_table("", "holds", "what torchplate does with it", title=f"{path}: what it holds")
    for part in contents.parts:
        table.add_row(*(escape(text) for text in part))
    return table


def _summary(measurement: Measurement, quality: Quality, path: Path) -> Table:
    table = plain_table("", "", title=str(path))
    n_response, n_reference = len(measurement.response), len(measurement.reference)
    table.add_row("FRFs", f"{len(measurement.pairs)} of {n_response} × {n_reference} (responses × references)")
    table.add_row("responses", " ".join(c.label for c in measurement.response))
    table.add_row("references", " ".join(c.label for c in measurement.reference))
    table.add_row("kind, unit", escape(f"{measurement.kind}, {measurement.unit}"))
    low, high = quality.band
    step = "uneven step" if quality.step is None else f"step {quality.step:g} Hz"
    table.add_row("band", f"{low:g} to {high:g} Hz, {step}, {counted(quality.n_line, 'line')}")
    table.add_row("coordinates", _coordinates(measurement))
    points = [
        f"{p.label} (Re mobility < 0 on {percent(p.negative_lines, 2)} of the lines, "
        f"{percent(p.negative_power, 2)} of the power)"
        for p in quality.driving_points
    ]
    table.add_row("driving points", "\n".join(points) or "none")
    exchanges = [f"{r.label} against {r.exchanged}: {percent(r.difference)} apart" for r in quality.reciprocity]
    more = [f"and {len(exchanges) - 10} more pairs"] if len(exchanges) > 10 else []
    table.add_row("reciprocity", "\n".join(exchanges[:10] + more) or "no pair both ways round")
    table.add_row("coherence", _coherence(quality))
    table.add_row("peaks", _peaks(quality))
    found = counted(len(quality.suspicions), "finding")
    table.add_row("suspicious", f"{found}, below" if quality.suspicions else "nothing")
    return table


def _coordinates(measurement: Measurement) -> str:
    channels = {c.node: c.coordinate for c in (*measurement.response, *measurement.reference)}
    held = [c for c in channels.values() if c is not None]
    if not held:
        return "none: channels are matched to the plate by node number"
    spans = []
    for axis, values in zip("xyz", zip(*held, strict=True), strict=True):
        low, high = min(values), max(values)
        spans.append(f"{axis} {low:g} m" if low == high else f"{axis} {low:g} to {high:g} m")
    return f"{len(held)} of {counted(len(channels), 'node')}, {', '.join(spans)}"


def _coherence(quality: Quality) -> str:
    if not quality.coherence:
        return "none in the file"
    mean = np.mean([c.mean for c in quality.coherence])
    worst = min(quality.coherence, key=lambda c: c.mean)
    low = f"{percent(worst.share_low, 2)} of the lines below 0.8"
    return f"mean {mean:.4f}; lowest {worst.label}: mean {worst.mean:.4f}, {low}"


def _peaks(quality: Quality) -> str:
    shown = ", ".join(f"{f:.6g}" for f in quality.peaks[:24])
    rest = f", and {len(quality.peaks) - 24} more" if len(quality.peaks) > 24 else ""
    return f"{shown} Hz{rest}" if quality.peaks else "none that stands out by 3 dB"


def _channels(measurement: Measurement, quality: Quality) -> Table:
    heads = ["FRF", f"rms level [{measurement.unit}]", "line noise"]
    coherence = {c.label: c for c in quality.coherence}
    heads += ["coherence mean", "median", "below 0.8"] if coherence else []
    table = plain_table(*heads, title="Channels")
    for column in table.columns[1:]:
        column.justify = "right"
    level = measurement.frf.abs().square().mean(dim=0).sqrt()
    for j, k in measurement.pairs[:60]:
        label = measurement.pair_label(j, k)
        cells = [label, f"{float(level[j, k]):.3g}", percent(quality.line_noise[label], 2)]
        if label in coherence:
            own = coherence[label]
            cells += [f"{own.mean:.4f}", f"{own.median:.4f}", percent(own.share_low, 2)]
        table.add_row(*cells)
    if len(measurement.pairs) > 60:
        table.add_row(f"and {len(measurement.pairs) - 60} more")
    return table
