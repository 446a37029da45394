"""The report of a diagnosis: first what to know and to do, then why, then every number."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from torchplate.diagnosis import Diagnosis, Overlay
from torchplate.discrepancy import ModalEvidence
from torchplate.report.blocks.channel_names import explained
from torchplate.report.blocks.document import Block, Command, Document, Heading, Listing, Panel, Paragraph, Picture
from torchplate.report.diagnosis_figures import figures, panels
from torchplate.report.diagnosis_tables import bands, channels, considered, effects, gap_table, kinds, parameters, steps
from torchplate.report.figures.assurance import caption
from torchplate.report.figures.drawing import png
from torchplate.report.figures.mode_shapes import composite, mode_shapes, modes_caption, modes_of
from torchplate.report.figures.paired_shapes import shapes_of
from torchplate.report.figures.plate_map import place_found
from torchplate.report.figures.shape_agreement import agreement
from torchplate.report.forms.markdown import markdown
from torchplate.report.forms.page import page
from torchplate.report.verdict import verdict_sentence

FIGURES = "figures/"
"""The folder that the figures of report.md lie in."""


def diagnosis_report(
    name: str, diagnosis: Diagnosis, folder: Path, command: str = "", modal: ModalEvidence | None = None
) -> dict[str, bytes]:
    """`report.md` with its figures under `figures/`, and `report.html`, which needs no other file.

    Args:
        name: of what was diagnosed; the title.
        diagnosis: what was found.
        folder: where `model.yaml` of this diagnosis lies.
        command: what made the report, for its last line.
        modal: measured mode shapes, where it was these that were diagnosed.

    Returns:
        The content of each file by its path in the folder.
    """
    drawn = figures(diagnosis)
    shown = panels(diagnosis, drawn)
    model, overlay = diagnosis.model, diagnosis.overlay
    modes = modes_of(model, model.known[:0], None if overlay is None else overlay.measured)
    if modes:
        sides = model.mesh.length_x, model.mesh.length_y
        drawn["modes"], shown["modes"] = composite(modes, sides), mode_shapes(modes, sides)
    alike = {} if modal is None else agreement(shapes_of(modal, model, model.known[:0]))
    drawn |= {key: figure for key, (_, figure) in alike.items()}
    pictures = [picture for picture, _ in alike.values()]
    blocks = list(_blocks(diagnosis, folder, shown, modes_caption(modes), pictures))
    if overlay is not None:
        blocks = list(explained(blocks, overlay.measured))
    told = Document(
        f"Diagnosis of {name}", verdict_sentence(diagnosis), diagnosis.verdict, blocks, _foot(diagnosis, command)
    )
    files = {f"{FIGURES}{key}.png": png(figure) for key, figure in drawn.items()}
    return files | {"report.md": markdown(told, FIGURES).encode(), "report.html": page(told).encode()}


def _blocks(
    diagnosis: Diagnosis,
    folder: Path,
    shown: Mapping[str, tuple[Panel, ...]],
    of_modes: str,
    alike: Sequence[Picture] = (),
) -> Iterator[Block]:
    """The report from the verdict on: first what to know and to do, then why, then every number."""
    yield gap_table(diagnosis)
    if diagnosis.effects:
        yield Heading("What was missing")
        yield effects(diagnosis)
        yield Listing([f"**{effect.label}**: {effect.evidence}" for effect in diagnosis.effects])
    if diagnosis.missing:
        yield Heading("What is missing and has no name")
        yield Listing(diagnosis.missing)
    if diagnosis.field is not None:
        yield Heading("What is missing, as a field over the plate")
        yield Listing(diagnosis.field.sentences)
        text = "What would have to be there, and where. `model.yaml` holds it, and the numbers fitted beside it."
        yield Picture("field", text, shown["field"])
    if diagnosis.remarks:
        yield Heading("Remarks")
        yield Listing(diagnosis.remarks)
    if diagnosis.next_measurements:
        yield Heading("What to measure next")
        yield Paragraph("The cheapest first:")
        yield Listing(diagnosis.next_measurements, numbered=True)
    yield Heading("How to go on")
    yield Paragraph(
        "`model.yaml` is the config of the last model, the values found in it as numbers. This evaluates it; replace a "
        "number by an interval, `[low, high]`, to search it again:"
    )
    yield Command(f"torchplate run {shlex.quote(str(folder / 'model.yaml'))}")
    yield Heading("The gap step by step")
    text = "Gap after each step, from the baseline to the last model; dashed, what noise alone makes it."
    yield Picture("gap", text, shown["gap"])
    yield from steps(diagnosis)
    yield from _location(diagnosis, shown)
    if diagnosis.overlay is not None:
        yield Heading("Measured and modelled FRFs")
        yield Picture("frf", _frf_caption(diagnosis.overlay), shown["frf"])
        yield from channels(diagnosis, diagnosis.overlay)
        yield Picture("assurance", caption(diagnosis.overlay), shown["assurance"])
    if "modes" in shown:
        yield Heading("Mode shapes")
        yield Picture("modes", of_modes, shown["modes"])
    if alike:
        yield Heading("Measured and modelled mode shapes")
        yield from alike
    yield from considered(diagnosis)
    if diagnosis.parameters:
        yield Heading("Fitted parameters")
        yield parameters(diagnosis)


def _location(diagnosis: Diagnosis, shown: Mapping[str, tuple[Panel, ...]]) -> Iterator[Block]:
    location = diagnosis.location
    if not (location.sentences or location.kind or location.bands or {"bands", "map"} & set(shown)):
        return
    yield Heading("Where model and measurement disagree")
    if location.sentences:
        yield Listing(location.sentences)
    if location.kind:
        yield kinds(location)
    if location.bands:
        yield bands(location)
    shaded = " Shaded, the bands above." if location.bands else ""
    if "bands" in shown:
        text = f"Where in frequency: the misfit of each line over its noise.{shaded}"
        yield Picture("bands", text, shown["bands"])
    if "map" in shown:
        said = ["Where on the plate."]
        if location.map is not None:
            said.append("The stronger the colour, the more of the misfit before would a force there explain.")
        places = [place for effect in diagnosis.effects if (place := place_found(effect)) is not None]
        if any(x.std is not None and y.std is not None for x, y in places):
            said.append("Ellipses take the errors of x and y as independent.")
        yield Picture("map", " ".join(said), shown["map"])


def _frf_caption(overlay: Overlay) -> str:
    if bool(overlay.heldout.any()):
        return (
            "FRFs that no fit saw first, on a tinted ground, then the others; of each the worst at the baseline first."
        )
    return "The FRFs that were worst at the baseline."


def _foot(diagnosis: Diagnosis, command: str) -> str:
    effort = f"{diagnosis.n_evaluation} evaluations in {diagnosis.seconds:.3g} s."
    made = f" Made by `{command}`." if command else ""
    if diagnosis.overlay is None:
        return f"Natural frequencies; {effort}{made}"
    measured = diagnosis.overlay.measured
    first, last = float(measured.frequency[0]), float(measured.frequency[-1])
    n = len(measured.pairs)
    return (
        f"{n} FRF{'s' if n > 1 else ''} ({measured.kind}), {len(measured.frequency)} lines from {first:g} to {last:g} "
        f"Hz; {effort}{made}"
    )
