"""A report as one HTML file that needs no other."""

import html
import re
from collections import Counter
from collections.abc import Iterator

from torchplate.report.blocks.document import Command, Document, Heading, Listing, Paragraph, Picture, Table
from torchplate.report.figures.drawing import svg
from torchplate.report.forms.page_style import style

SHORT = 30
"""Lines of a cell up to this length are not broken."""
FOLDED = 3
"""A table of so many columns has its rows one under the other on a telephone, each cell below its column's name."""
MANY = 4
"""A report of so many sections begins with links to them."""


def page(document: Document) -> str:
    """The text of `report.html`."""
    anchors = _anchors(document)
    title = html.escape(document.title)
    body = [
        f"<h1>{_inline(document.title)}</h1>",
        f'<p class="verdict {html.escape(document.mood)}">{_inline(document.first)}</p>',
        *_links(document, anchors),
    ]
    headings = iter(anchors)
    for block in document.blocks:
        match block:
            case Heading(text):
                anchor = next(headings)
                body.append(f'<h2 id="{anchor}"><a href="#{anchor}">{_inline(text)}</a></h2>')
            case Paragraph(text):
                body.append(f"<p>{_inline(text)}</p>")
            case Listing(items, numbered):
                kind = "ol" if numbered else "ul"
                body.append(f"<{kind}>" + "".join(f"<li>{_inline(item)}</li>" for item in items) + f"</{kind}>")
            case Table():
                body.append(_table(block))
            case Picture():
                body.append(_picture(block))
            case Command(text):
                body.append(f"<pre>{html.escape(text)}</pre>")
    body.append(f"<footer>{_inline(document.foot)}</footer>")
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">',
            f"<title>{title}</title>\n<style>\n{style()}\n</style>\n</head>\n<body>\n<main>",
            *body,
            "</main>\n</body>\n</html>\n",
        ]
    )


def _anchors(document: Document) -> list[str]:
    """One for each heading, in their order."""
    seen: Counter[str] = Counter()
    found = []
    for block in document.blocks:
        if isinstance(block, Heading):
            seen[block.anchor] += 1
            turn = seen[block.anchor]
            found.append(block.anchor if turn == 1 else f"{block.anchor}-{turn}")
    return found


def _links(document: Document, anchors: list[str]) -> Iterator[str]:
    if len(anchors) < MANY:
        return
    texts = [block.text for block in document.blocks if isinstance(block, Heading)]
    links = [f'<a href="#{anchor}">{_inline(text)}</a>' for anchor, text in zip(anchors, texts, strict=True)]
    yield f'<nav aria-label="Sections">{" ".join(links)}</nav>'


def _picture(picture: Picture) -> str:
    drawn = [
        f'<div class="panel {panel.screen}">{svg(panel.draw(), f"{picture.name}-{turn}", panel.told)}</div>'
        for turn, panel in enumerate(picture.panels)
    ]
    kind = "panels" if all(panel.screen == "all" for panel in picture.panels) else "either"
    if any(panel.small for panel in picture.panels):
        kind += " small"
    return (
        f'<figure><div class="{kind} {picture.name}">\n{"".join(drawn)}\n</div>'
        f"<figcaption>{_inline(picture.caption)}</figcaption></figure>"
    )


def _table(table: Table) -> str:
    numbers = [name.endswith(">") for name in table.head]
    names = [name.removesuffix(">") for name in table.head]
    # A style that lays cells out otherwise takes their roles away; said again, they stay.
    folded = len(names) >= FOLDED
    role = (lambda name: f" role={name}") if folded else (lambda _: "")
    head = "".join(
        f"<th scope=col{role('columnheader')}{' class=number' if number else ''}>{_inline(name)}</th>"
        for name, number in zip(names, numbers, strict=True)
    )
    rows = []
    for index, row in enumerate(table.rows):
        cells = []
        for column, (cell, number) in enumerate(zip(row, numbers, strict=True)):
            lines = cell.split("\n")
            kind = " class=number" if number else " class=short" if max(map(len, lines)) <= SHORT else ""
            tag, scope = ("td", role("cell")) if column else ("th", f" scope=row{role('rowheader')}")
            told = f' data-column="{html.escape(re.sub(r"[`*]", "", names[column]))}"' if folded and column else ""
            cells.append(f"<{tag}{scope}{kind}{told}>{'<br>'.join(map(_inline, lines))}</{tag}>")
        rows.append(f"<tr{role('row')}{' class=marked' if index in table.marked else ''}>{''.join(cells)}</tr>")
    body = "\n".join(rows)
    label = html.escape(re.sub(r"[`*]", "", table.caption))
    return (
        f'<div class="table{" folded" if folded else ""}" role=region tabindex=0 aria-label="{label}">'
        f"<table{role('table')}><caption><span>{_inline(table.caption)}</span></caption>"
        f"<thead{role('rowgroup')}><tr{role('row')}>{head}</tr></thead>"
        f"<tbody{role('rowgroup')}>\n{body}\n</tbody></table></div>"
    )


def _inline(text: str) -> str:
    """Text in HTML, with `code` and **bold**."""
    text = html.escape(text, quote=False)
    # A number, its sign and its error stay on one line.
    text = re.sub(r"(?<=\d) (?=%|000 %|± )|(?<=±) (?=\d)", "\u00a0", text)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    return re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", text)
