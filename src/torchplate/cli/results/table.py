"""Tables on a terminal: no frame, and nothing is cut off, since names and commands in them are there to be copied."""

from rich.markup import escape
from rich.table import Table


def plain_table(*heads: str, title: str | None = None, whole: bool = False) -> Table:
    """A table without a frame, whose cells go on in the next line where they are too long.

    Args:
        heads: of the columns, taken as they are written, brackets included.
        title: above it, likewise.
        whole: names in the first column are never broken.
    """
    shown = None if title is None else escape(title)
    table = Table(
        title=shown, title_justify="left", box=None, padding=(0, 2, 0, 0) if whole else (0, 2), show_header=any(heads)
    )
    for index, head in enumerate(heads):
        table.add_column(escape(head), overflow="fold", no_wrap=whole and index == 0)
    return table
