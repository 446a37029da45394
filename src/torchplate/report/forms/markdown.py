"""A report in Markdown."""

import re

from torchplate.report.blocks.document import Command, Document, Heading, Listing, Paragraph, Picture, Table


def markdown(document: Document, folder: str = "") -> str:
    """The text of `report.md`.

    Args:
        document: what it says.
        folder: that the figures lie in, seen from the text.
    """
    parts = [f"# {_md(document.title)}", f"**{_md(document.first)}**"]
    for block in document.blocks:
        match block:
            case Heading(text):
                parts.append(f"## {_md(text)}")
            case Paragraph(text):
                parts.append(_md(text))
            case Listing(items, numbered):
                marks = [f"{index}." if numbered else "-" for index in range(1, len(items) + 1)]
                parts.append("\n".join(f"{mark} {_md(item)}" for mark, item in zip(marks, items, strict=True)))
            case Table(caption, head, rows, marked):
                lines = [[_md(name.removesuffix(">")).replace("|", "\\|") for name in head]]
                lines.append(["---:" if name.endswith(">") else "---" for name in head])
                for index, row in enumerate(rows):
                    cells = [_md(cell).replace("|", "\\|").replace("\n", "<br>") for cell in row]
                    lines.append([f"**{cells[0]}**", *cells[1:]] if index in marked else cells)
                parts.append(_md(caption))
                parts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))
            case Picture(name, caption):
                told = _md(block.told).replace("[", "(").replace("]", ")")
                parts.append(f"![{told}]({folder}{name}.png)\n\n*{_md(caption)}*")
            case Command(text):
                parts.append(f"```sh\n{text}\n```")
    return "\n\n".join([*parts, _md(document.foot)]).rstrip() + "\n"


def _md(text: str) -> str:
    """Text that Markdown shows as it is, but for the marks of this module: no tag, no link, no picture of its own."""
    parts = re.split(r"(`[^`\n]+`)", text)
    outside = [re.sub(r"[\\`]|\](?=[(\[:])", r"\\\g<0>", part).replace("<", "&lt;") for part in parts[::2]]
    # In code every sign stands for itself.
    parts[::2] = outside
    return "".join(parts)
