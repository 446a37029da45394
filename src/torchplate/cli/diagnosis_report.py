"""`report.md` and `report.html` of a diagnosis: one content, written twice, the second a file that holds everything."""

import base64
import html
import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchplate.cli.assurance_figure import caption
from torchplate.cli.diagnosis_figures import DPI, figure_digits, figures, place_found, png
from torchplate.cli.writing import write_bytes, write_text
from torchplate.diagnosis.assurance import frac_by_channel
from torchplate.diagnosis.result import Diagnosis, Estimate, Named, Overlay, Scored
from torchplate.effects import CATALOGUE

N_CHANNEL = 24
"""FRFs that are listed; all are in diagnosis.json."""
SHORT = 36
"""Lines of a cell up to this length are not broken."""
FIGURES = "figures"


@dataclass(frozen=True)
class Heading:
    """Of a section."""

    text: str


@dataclass(frozen=True)
class Paragraph:
    """A sentence or some; `code` and **bold** are marked as in Markdown."""

    text: str


@dataclass(frozen=True)
class Listing:
    """Points, numbered where their order says something."""

    items: Sequence[str]
    numbered: bool = False


@dataclass(frozen=True)
class Table:
    """Rows of cells; a cell of several lines has them one under the other.

    Attributes:
        head: the columns; those that end in ">" are numbers and stand to the right.
        rows: their cells.
        marked: the rows that are set off.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    marked: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Picture:
    """A figure by its name, and what to see on it."""

    name: str
    caption: str


@dataclass(frozen=True)
class Command:
    """A line for the shell."""

    text: str


Block = Heading | Paragraph | Listing | Table | Picture | Command


def write_diagnosis(recipe_name: str, diagnosis: Diagnosis, folder: Path, command: str = "") -> None:
    """Write `report.md` with its figures under `figures/`, and `report.html`, which needs no other file.

    Args:
        recipe_name: what was diagnosed; the title.
        diagnosis: what was found.
        folder: where `model.yaml` of this diagnosis lies, made if it is not there.
        command: what made the report, for its last line.
    """
    pictures = {name: png(figure) for name, figure in figures(diagnosis).items()}
    (folder / FIGURES).mkdir(parents=True, exist_ok=True)
    for name, content in pictures.items():
        write_bytes(folder / FIGURES / f"{name}.png", content)
    title, foot = f"Diagnosis of {recipe_name}", _foot(diagnosis, command)
    blocks = list(_blocks(diagnosis, folder, pictures))
    write_text(folder / "report.md", _markdown(title, diagnosis, blocks, foot))
    write_text(folder / "report.html", _html(title, diagnosis, blocks, foot, pictures))


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence: what was found, and what it means for the use of the values."""
    gap, effects = diagnosis.gap, diagnosis.effects
    before, after, floor = _percent(gap.baseline), _percent(gap.final), _percent(gap.noise_floor)
    names = _listed([_named(effect) for effect in effects])
    were, them = ("was", "it") if len(effects) == 1 else ("were", "them")
    if diagnosis.verdict == "consistent":
        added = f" with {names} added" if effects else " as it is"
        return (
            f"Consistent: the model{added} explains the measurement down to its noise (gap {after}, noise alone "
            f"{floor}), and nothing else of the catalogue is missing; the fitted values can be used."
        )
    if diagnosis.verdict == "explained":
        return (
            f"Explained: {names} {were} missing; with {them} the gap falls from {before} to {after}, where noise alone "
            f"makes {floor}, so the values of the new model can be used."
        )
    if diagnosis.verdict == "partly_explained":
        return (
            f"Partly explained: {names} {were} missing, and with {them} the gap falls from {before} to {after}, but "
            f"noise alone makes {floor}: something without a name is still missing, and the fitted values may make up "
            "for it."
        )
    return (
        f"Unexplained: something is missing that no effect of the catalogue accounts for; the gap stays at {after}, "
        f"where noise alone makes {floor}, so do not take the fitted values for those of the plate."
    )


def _named(effect: Named) -> str:
    twins = _listed([f"`{name}`" for name in effect.equivalent], "or")
    return f"`{effect.name}`" + (f" (or {twins}, which these data cannot tell from it)" if twins else "")


def _blocks(diagnosis: Diagnosis, folder: Path, pictures: Mapping[str, bytes]) -> Iterator[Block]:
    """The report from the verdict on: first what to know and to do, then why, then every number."""
    yield _gap_table(diagnosis)
    if diagnosis.effects:
        yield Heading("What was missing")
        yield _effects(diagnosis)
        yield Listing([f"**{effect.label}**: {effect.evidence}" for effect in diagnosis.effects])
    if diagnosis.missing:
        yield Heading("What is missing and has no name")
        yield Listing(diagnosis.missing)
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
    yield Picture("gap", "Gap after each step, from the baseline to the last model; dashed, what noise alone makes it.")
    yield from _steps(diagnosis)
    yield from _location(diagnosis, pictures)
    if diagnosis.overlay is not None:
        yield Heading("Measured and modelled FRFs")
        yield Picture("frf", _frf_caption(diagnosis.overlay))
        yield from _channels(diagnosis, diagnosis.overlay)
        yield Picture("assurance", caption(diagnosis.overlay))
    yield from _considered(diagnosis)
    if diagnosis.parameters:
        yield Heading("Fitted parameters")
        yield Paragraph("Of the last model. Standard errors know of noise alone, not of what the model lacks.")
        rows = [
            (f"`{name}`", f"{one.value:.6g}", "not seen" if one.std is None else f"{one.std:.2g}", one.unit)
            for name, one in diagnosis.parameters.items()
        ]
        yield Table(("parameter", "value>", "standard error>", "unit"), rows)


def _gap_table(diagnosis: Diagnosis) -> Table:
    gap = diagnosis.gap
    rows = [("FRFs that were fitted", _percent(gap.baseline), _percent(gap.final), _percent(gap.noise_floor))]
    if gap.heldout_baseline is not None or gap.heldout_final is not None:
        rows.append(("FRFs held out, seen by no fit", _percent(gap.heldout_baseline), _percent(gap.heldout_final), ""))
    return Table(("gap, mean of ‖measured − model‖ / ‖measured‖", "before>", "after>", "noise alone>"), rows)


def _effects(diagnosis: Diagnosis) -> Table:
    rows = []
    for effect in diagnosis.effects:
        name = f"`{effect.name}`" + (f"\nas `{effect.label}`" if effect.label != effect.name else "")
        options = [f"{key} {_plain(value)}" for key, value in effect.options.items() if value not in (None, (), [])]
        found = [f"{key} {_quantity(one)}" for key, one in effect.parameters.items()]
        rows.append(
            (
                "\n".join([name, *options]),
                "\n".join(f"`{twin}`" for twin in effect.equivalent) or "none",
                _confidence(effect.confidence),
                "\n".join([*found, *_in_metres(effect, diagnosis)]) or "no number",
                _percent(effect.gap_before),
                _percent(effect.gap_after),
            )
        )
    head = ("effect", "cannot be told from", "confidence>", "found, ± standard error", "gap before>", "gap after>")
    return Table(head, rows)


def _in_metres(effect: Named, diagnosis: Diagnosis) -> list[str]:
    """Where a ruler finds the place."""
    if (place := place_found(effect)) is None:
        return []
    mesh = diagnosis.model.mesh
    x, y = (1e3 * side * one.value for side, one in zip((mesh.length_x, mesh.length_y), place, strict=True))
    return [f"(at {x:.4g} mm, {y:.4g} mm)"]


def _steps(diagnosis: Diagnosis) -> Iterator[Block]:
    if not diagnosis.steps:
        return
    heldout = any(step.heldout is not None for step in diagnosis.steps)
    rows = [
        (step.label, _percent(step.gap), *([_percent(step.heldout)] if heldout else []), f"{step.misfit:.4g}")
        for step in diagnosis.steps
    ]
    yield Table(("step", "gap, fitted>", *(["gap, held out>"] if heldout else []), "misfit>"), rows)
    yield Paragraph("Misfit: mean square of the residuals over their noise; 1 where nothing but noise is left.")


def _location(diagnosis: Diagnosis, pictures: Mapping[str, bytes]) -> Iterator[Block]:
    location = diagnosis.location
    if not (location.sentences or location.kind or location.bands or {"bands", "map"} & set(pictures)):
        return
    yield Heading("Where model and measurement disagree")
    if location.sentences:
        yield Listing(location.sentences)
    if location.kind:
        rows = [(kind, _percent(part)) for kind, part in sorted(location.kind.items(), key=lambda item: -item[1])]
        yield Table(("of what kind", "part of the misfit it explains>"), rows)
    if location.bands:
        rows = [(f"{band.low:.4g} to {band.high:.4g}", _percent(band.share)) for band in location.bands]
        yield Table(("band [Hz]", "share of the squared misfit>"), rows)
    shaded = " Shaded, the bands above." if location.bands else ""
    if "bands" in pictures:
        yield Picture("bands", f"Where in frequency: the misfit of each line over its noise.{shaded}")
    if "map" in pictures:
        caption = ["Where on the plate."]
        if location.map is not None:
            caption.append("The darker, the more of the misfit before would a force there explain.")
        places = [place for effect in diagnosis.effects if (place := place_found(effect)) is not None]
        if any(x.std is not None and y.std is not None for x, y in places):
            caption.append("Ellipses take the errors of x and y as independent.")
        yield Picture("map", " ".join(caption))


def _frf_caption(overlay: Overlay) -> str:
    if bool(overlay.heldout.any()):
        return (
            "FRFs that no fit saw first, on a tinted ground, then the others; of each the worst at the baseline first."
        )
    return "The FRFs that were worst at the baseline."


def _channels(diagnosis: Diagnosis, overlay: Overlay) -> Iterator[Block]:
    every = sorted(diagnosis.location.channels, key=lambda one: -one.before)
    if not every:
        return
    frac = _fracs(overlay)
    rows = [
        (f"{one.response}/{one.reference}", _percent(one.before), _percent(one.after), _percent(one.floor),
         *frac.get((one.response, one.reference), ("", "")), "held out" if one.heldout else "fitted")
        for one in every[:N_CHANNEL]
    ]  # fmt: skip
    gaps, fracs = ("gap before>", "gap after>", "noise alone>"), ("FRAC before>", "FRAC after>")
    yield Table(("FRF, response/reference", *gaps, *fracs, ""), rows)
    if len(every) > N_CHANNEL:
        yield Paragraph(f"And {len(every) - N_CHANNEL} FRFs that were nearer; `diagnosis.json` has all.")
    yield Paragraph("FRAC: correlation of measured and modelled FRF over the lines; 1 where its course is right.")


def _fracs(overlay: Overlay) -> dict[tuple[str, str], tuple[str, str]]:
    """FRAC before and after of each measured FRF, by the labels of its channels."""
    measured = overlay.measured
    before, after = (frac_by_channel(measured, frf) for frf in (overlay.before, overlay.after))
    return {
        (measured.response[j].label, measured.reference[k].label): (f"{before[j, k]:.3f}", f"{after[j, k]:.3f}")
        for j, k in measured.pairs
    }


def _considered(diagnosis: Diagnosis) -> Iterator[Block]:
    """The score table of the first step, and what was rejected in later ones."""
    if not any(diagnosis.scores):
        return
    yield Heading("What was considered, and rejected")
    if diagnosis.scores[0]:
        yield Paragraph(
            "Each effect of the catalogue at its best place, before any refit: the part of the squared misfit of the "
            "baseline that it would take away, less what the fitted parameters can do themselves. Tables of later "
            "steps are in `diagnosis.json`."
        )
        table = _ranked(diagnosis.scores[0])
        yield Table(
            ("effect", "expected drop>", "it would be", "parallel to", "gap after a refit>", "what became of it"),
            [_scored(row) for row in table],
            frozenset(index for index, row in enumerate(table) if row.remark.startswith("named")),
        )
    later = [
        (f"`{row.name}`{_of(row.options)}", str(step), _percent(row.expected_drop), _percent(row.gap), row.remark)
        for step, table in enumerate(diagnosis.scores[1:], start=2)
        for row in _ranked(table)
        if row.remark.startswith("rejected")
    ]
    if later:
        yield Paragraph("Rejected in later steps, beside the effects that were in the model by then:")
        yield Table(("effect", "step>", "expected drop>", "gap after a refit>", "what became of it"), later)


def _ranked(table: Sequence[Scored]) -> list[Scored]:
    return sorted(table, key=lambda row: -row.expected_drop)


def _scored(row: Scored) -> tuple[str, ...]:
    found = CATALOGUE.get(row.name)
    units = {} if found is None else {name: one.unit for name, one in found.parameters.items()}
    change = [f"{name} {value:.4g}{_unit(units.get(name, '-'))}" for name, value in row.expected_change.items()]
    twins = "\n".join(f"`{twin}`" for twin in row.twins)
    return (
        f"`{row.name}`{_of(row.options)}",
        _percent(row.expected_drop),
        "\n".join(change),
        twins,
        _percent(row.gap),
        row.remark,
    )


def _of(options: Mapping[str, Any]) -> str:
    parts = [f"{key} {_plain(value)}" for key, value in options.items() if value not in (None, (), [])]
    return f", {', '.join(parts)}" if parts else ""


def _plain(value: Any) -> str:
    return "[" + ", ".join(map(_plain, value)) + "]" if isinstance(value, list | tuple) else f"{value}"


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


def _percent(part: float | None) -> str:
    if part is None:
        return ""
    return f"{100 * part:.3g} %" if math.isfinite(part) else "not known"


def _confidence(probability: float) -> str:
    return "over 99.9 %" if probability > 0.9995 else f"{100 * probability:.3g} %"


def _quantity(one: Estimate) -> str:
    seen = "" if one.std is not None else " (error not seen)"
    return f"{figure_digits(one.value, one.std)}{_unit(one.unit)}{seen}"


def _unit(unit: str) -> str:
    return "" if unit in ("", "-") else f" {unit}"


def _listed(words: Sequence[str], last: str = "and") -> str:
    return f" {last} ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _markdown(title: str, diagnosis: Diagnosis, blocks: Sequence[Block], foot: str) -> str:
    parts = [f"# {_md(title)}", f"**{verdict_sentence(diagnosis)}**"]
    for block in blocks:
        match block:
            case Heading(text):
                parts.append(f"## {text}")
            case Paragraph(text):
                parts.append(_md(text))
            case Listing(items, numbered):
                marks = [f"{index}." if numbered else "-" for index in range(1, len(items) + 1)]
                parts.append("\n".join(f"{mark} {_md(item)}" for mark, item in zip(marks, items, strict=True)))
            case Table(head, rows, marked):
                lines = [[name.removesuffix(">") for name in head]]
                lines.append(["---:" if name.endswith(">") else "---" for name in head])
                for index, row in enumerate(rows):
                    cells = [_md(cell).replace("|", "\\|").replace("\n", "<br>") for cell in row]
                    lines.append([f"**{cells[0]}**", *cells[1:]] if index in marked else cells)
                parts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))
            case Picture(name, caption):
                parts.append(f"![{_md(caption)}]({FIGURES}/{name}.png)\n\n*{_md(caption)}*")
            case Command(text):
                parts.append(f"```sh\n{text}\n```")
    return "\n\n".join([*parts, _md(foot)]) + "\n"


def _md(text: str) -> str:
    """Text that Markdown shows as it is, but for the marks of this module."""
    return text.replace("<", "&lt;")


def _html(title: str, diagnosis: Diagnosis, blocks: Sequence[Block], foot: str, pictures: Mapping[str, bytes]) -> str:
    parts = [
        f"<h1>{_inline(title)}</h1>",
        f'<p class="verdict {diagnosis.verdict}">{_inline(verdict_sentence(diagnosis))}</p>',
    ]
    for block in blocks:
        match block:
            case Heading(text):
                parts.append(f"<h2>{_inline(text)}</h2>")
            case Paragraph(text):
                parts.append(f"<p>{_inline(text)}</p>")
            case Listing(items, numbered):
                kind = "ol" if numbered else "ul"
                parts.append(f"<{kind}>" + "".join(f"<li>{_inline(item)}</li>" for item in items) + f"</{kind}>")
            case Table():
                parts.append(_html_table(block))
            case Picture(name, caption):
                data = base64.b64encode(pictures[name]).decode("ascii")
                size = f'class="{name}" width="{_width(pictures[name])}"'
                parts.append(
                    f'<figure><img {size} alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'
                    f"<figcaption>{_inline(caption)}</figcaption></figure>"
                )
            case Command(text):
                parts.append(f"<pre>{html.escape(text)}</pre>")
    parts.append(f"<footer>{_inline(foot)}</footer>")
    return _PAGE.replace("{title}", html.escape(title)).replace("{style}", _STYLE).replace("{body}", "\n".join(parts))


def _html_table(table: Table) -> str:
    numbers = [name.endswith(">") for name in table.head]
    head = "".join(
        f"<th{' class=number' if number else ''}>{_inline(name.removesuffix('>'))}</th>"
        for name, number in zip(table.head, numbers, strict=True)
    )
    rows = []
    for index, row in enumerate(table.rows):
        cells = []
        for cell, number in zip(row, numbers, strict=True):
            lines = cell.split("\n")
            kind = " class=number" if number else " class=short" if max(map(len, lines)) <= SHORT else ""
            cells.append(f"<td{kind}>{'<br>'.join(map(_inline, lines))}</td>")
        rows.append(f"<tr{' class=marked' if index in table.marked else ''}>{''.join(cells)}</tr>")
    body = "\n".join(rows)
    return f"<div class=table><table><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table></div>"


def _width(picture: bytes) -> int:
    """Of a PNG on a page at 96 pixels per inch, so that the text on all figures has one size."""
    return round(int.from_bytes(picture[16:20], "big") * 96 / DPI)


def _inline(text: str) -> str:
    """Text in HTML, with `code` and **bold**."""
    text = html.escape(text, quote=False)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    return re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", text)


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}
</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""
_STYLE = """
:root { color-scheme: light; --ink: #1f2933; --muted: #616e7c; --rule: #d9dee4; --tint: #f4f6f8; }
body { margin: 0; background: #fff; color: var(--ink); font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto,
  "Helvetica Neue", Arial, "Noto Sans", sans-serif; -webkit-text-size-adjust: 100%; }
main { max-width: 60rem; margin: 0 auto; padding: 2.5rem 1.5rem 3rem; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 1rem; }
h2 { font-size: 1.2rem; line-height: 1.3; margin: 2.4rem 0 0.6rem; padding-top: 0.9rem;
  border-top: 1px solid var(--rule); }
p, ul, ol { margin: 0.6rem 0; max-width: 46rem; }
ul, ol { padding-left: 1.4rem; }
li { margin: 0.3rem 0; }
li::marker { color: var(--muted); }
.verdict { max-width: none; margin: 0 0 1.4rem; padding: 0.9rem 1.1rem; font-size: 1.15rem; line-height: 1.45;
  background: var(--tint); border-left: 0.4rem solid #0072b2; border-radius: 0 0.3rem 0.3rem 0; }
.verdict.consistent { border-color: #009e73; }
.verdict.partly_explained { border-color: #e69f00; }
.verdict.unexplained { border-color: #d55e00; }
.table { overflow-x: auto; margin: 0.9rem 0; }
table { border-collapse: collapse; font-size: 0.9rem; line-height: 1.4; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: 0.32rem 1.2rem 0.32rem 0;
  border-bottom: 1px solid var(--rule); }
th { color: var(--muted); font-weight: 600; vertical-align: bottom; border-bottom: 1.5px solid var(--ink); }
td.number, th.number { text-align: right; }
td.number, td.short { white-space: nowrap; }
tr.marked td { background: var(--tint); font-weight: 600; }
code, pre { font-family: ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace;
  font-size: 0.9em; }
pre { background: var(--tint); padding: 0.7rem 1rem; border-radius: 0.3rem; white-space: pre-wrap;
  overflow-wrap: anywhere; }
figure { margin: 1.2rem 0; }
img { display: block; max-width: 100%; height: auto; }
figcaption { color: var(--muted); font-size: 0.9rem; margin-top: 0.4rem; max-width: 46rem; }
footer { color: var(--muted); font-size: 0.85rem; margin-top: 2.5rem; padding-top: 0.8rem;
  border-top: 1px solid var(--rule); }
@page { margin: 16mm 15mm; }
@media print {
  body { font-size: 9.5pt; }
  table { font-size: 8.5pt; }
  h2 { margin-top: 1.6rem; }
  main { max-width: none; padding: 0; }
  h2, h2 + p { break-after: avoid; }
  figure, tr, li, pre, .verdict { break-inside: avoid; }
  thead { display: table-header-group; }
  .table { overflow: visible; }
  .verdict, tr.marked td, pre { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
  img { max-height: 225mm; margin: 0 auto; }
  img.map { max-height: 110mm; width: auto; }
}
""".strip()
