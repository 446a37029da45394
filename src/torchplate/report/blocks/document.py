"""What a report is made of: blocks, in the order in which they are read."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from matplotlib.figure import Figure


@dataclass(frozen=True)
class Heading:
    """Of a section."""

    text: str

    @property
    def anchor(self) -> str:
        """What a link to the section ends with."""
        return re.sub(r"[^a-z0-9]+", "-", self.text.lower()).strip("-")


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
        caption: what the rows are.
        head: the columns; those that end in ">" are numbers and stand to the right.
        rows: their cells; the first names the row.
        marked: the rows that are set off.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    marked: frozenset[int] = frozenset()


class Panel(NamedTuple):
    """A figure no wider than a telephone's screen, or one for wide screens alone.

    Attributes:
        draw: makes the figure, when the page is put together.
        told: what it shows, in words, for who does not see it.
        screen: where it stands: on all, on wide ones alone, or on narrow ones alone.
        small: whether two stand beside each other on a narrow screen.
    """

    draw: Callable[[], Figure]
    told: str
    screen: Literal["all", "wide", "narrow"] = "all"
    small: bool = False


@dataclass(frozen=True)
class Picture:
    """A figure by its name, and what to see on it.

    Attributes:
        name: of its file beside the Markdown.
        caption: how to read it.
        panels: what stands on the page; of a wide and a narrow one either is seen.
    """

    name: str
    caption: str
    panels: tuple[Panel, ...] = ()

    @property
    def told(self) -> str:
        """All that it shows, in words."""
        return " ".join(dict.fromkeys(panel.told for panel in self.panels)) or self.caption


@dataclass(frozen=True)
class Command:
    """A line for the shell."""

    text: str


Block = Heading | Paragraph | Listing | Table | Picture | Command


@dataclass(frozen=True)
class Document:
    """A whole report.

    Attributes:
        title: of the page.
        first: the sentence that is read first.
        mood: what colours it, a class of the page's style.
        blocks: what follows.
        foot: how it was made.
    """

    title: str
    first: str
    mood: str
    blocks: Sequence[Block]
    foot: str = ""


def words(block: Block) -> Iterator[str]:
    """All texts of a block."""
    match block:
        case Heading(text) | Paragraph(text):
            yield text
        case Listing(items):
            yield from items
        case Table(caption, head, rows):
            yield from (caption, *head, *(cell for row in rows for cell in row))
        case Picture(_, caption):
            yield from (caption, block.told)
        case Command():
            pass
