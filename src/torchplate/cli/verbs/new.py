"""`torchplate new FILE`: a commented config for a measurement, that runs as it is."""

import math
import os
import shlex
from pathlib import Path

from rich.console import Console

from torchplate.cli.config import InputError
from torchplate.cli.config.build import load_run
from torchplate.cli.folder.writing import asked_for
from torchplate.cli.progress.console import speaking
from torchplate.cli.verbs.new_draft import Draft, Wishes, check_sizes, drafted
from torchplate.cli.verbs.new_text import compose
from torchplate.measurement import METRES


def new(
    file: Path | str, wishes: Wishes, out: Path | None = None, console: Console | None = None, force: bool = False
) -> Path:
    """Write a config for a measurement.

    Args:
        file: The measurement.
        wishes: What is known of the plate.
        out: The config; by default the file's name with .yaml, in the current folder.
        console: Where is said what was taken from where.
        force: Write over a config that is there and another.

    Raises:
        InputError: Something that was told cannot be.
        MeasurementError: The file cannot be used.
    """
    console = console or speaking()
    file, out = Path(file), Path(out or f"{Path(file).stem}.yaml")
    if file.suffix.lower() in (".yaml", ".yml"):
        raise InputError(
            f"{file}: Expected a measurement, got a config, which `torchplate run {file}` takes. Give a .uff or .npz "
            "file."
        )
    if file.is_dir():
        raise InputError(f"{file}: Expected a measurement, got a folder. Name a .uff or .npz file in it.")
    if out.is_dir():
        raise InputError(f"--out {out}: Expected the name of a config to write, got a folder. Name a file in it.")
    if out.suffix not in (".yaml", ".yml"):
        raise InputError(f"--out {out}: Expected a name that ends in .yaml, got '{out.suffix}'. Rename it.")
    _check(wishes)
    draft = drafted(file, wishes)
    text = compose(draft, os.path.relpath(file.resolve(), out.resolve().parent), _table(wishes, out))
    with asked_for(out, force=force) as partial:
        partial.write_text(text, encoding="utf-8")
    load_run(out).model()  # a config that does not run would be a defect of ours
    _say(draft, out, console)
    return out


def _check(wishes: Wishes) -> None:
    numbers = {"--thickness": wishes.thickness, "--mass": wishes.mass}
    numbers |= dict(zip(("--length (x)", "--length (y)"), wishes.length or (), strict=False))
    for name, value in numbers.items():
        if value is not None and not 0 < value < math.inf:
            unit = "kg" if name == "--mass" else "m"
            raise InputError(f"{name}: Expected a number above 0 in {unit}, got {value:g}. Correct it.")
    if wishes.length is not None and max(wishes.length) > 20:
        in_m = {unit: " ".join(f"{factor * one:g}" for one in wishes.length) for unit, factor in METRES.items()}
        # A plate of more than 2 m is seldom hit by hand, nor one of less than 0.1 m.
        units = ["cm"] * (max(wishes.length) <= 200) + ["mm"] * (max(wishes.length) >= 100)
        raise InputError(
            f"--length: Expected sides in m, got {wishes.length[0]:g} and {wishes.length[1]:g}, which look like "
            f"{' or '.join(units)}. Write --length {' or --length '.join(in_m[unit] for unit in units)}."
        )
    if wishes.length is not None:
        check_sizes(wishes, *wishes.length)
    if wishes.unit is not None and wishes.unit not in METRES:
        raise InputError(f"--unit: Expected one of {', '.join(METRES)}, got '{wishes.unit}'. Name one of these.")


def _table(wishes: Wishes, out: Path) -> str | None:
    return None if wishes.nodes is None else os.path.relpath(wishes.nodes.resolve(), out.resolve().parent)


def material_said(draft: Draft) -> str:
    """What the plate is taken to be made of, and why."""
    material, told = draft.material, draft.heard.said
    if draft.wishes.material is not None:
        return f"material {material.name}, as told"
    if draft.orthotropic:
        return f"{told}; material taken as {material.name}: give --material spruce, say, or --material plywood"
    known = f"{told}; " if told else ""
    return f"{known}material not named, so only h√(E/ρ) can be found: give --material"


def _say(draft: Draft, out: Path, console: Console) -> None:
    def line(text: str, guess: bool = False) -> None:
        console.print(f"  {'guess: ' if guess else ''}{text}", highlight=False, markup=False, soft_wrap=True)

    console.print(str(out), style="bold", highlight=False, markup=False, soft_wrap=True)
    proposal = draft.proposal
    line(f"plate of {proposal.length_x:g} × {proposal.length_y:g} m ({proposal.sides.text})", proposal.sides.guess)
    if draft.heard.sides:
        line(draft.heard.sides, True)
    for said in (proposal.unit, proposal.axes, proposal.origin):
        line(said.text, said.guess)
    line(material_said(draft), draft.wishes.material is None)
    if draft.wishes.thickness is None:
        line(f"thickness near {1e3 * draft.thickness[1]:.2g} mm, by {draft.heard.by}: give --thickness", True)
    for edge in draft.wishes.edges:
        if "=" not in edge:
            line(f"edge {edge} taken as clamped: write --edge {edge}=simply_supported if it turns", True)
    if draft.supports is None and not draft.edges:
        line("edges and supports taken as free: give --supports or --edge if they are not", True)
    if draft.first is not None and draft.first > draft.band[1]:
        line(
            f"the first natural frequency to expect is {draft.first:.3g} Hz, above the band: check sizes and thickness",
            True,
        )
    line(
        f"band {draft.band[0]:g} to {draft.band[1]:g} Hz, {draft.cells[0]} × {draft.cells[1]} elements, gain "
        f"{'known' if draft.gain_is_known else 'unknown'}"
    )
    name = shlex.quote(str(out))
    console.print(
        f"Next: torchplate run {name}; torchplate diagnose {name}", highlight=False, markup=False, soft_wrap=True
    )
