"""Where a verb speaks: lines as wide as the terminal, or as long as their sentences where the output is piped."""

import os
from typing import Final

from rich.console import Console

UNBROKEN: Final = 10_000
"""Letters in a line of a pipe or a file: more than any sentence or row has, so that grep finds them whole."""


def speaking() -> Console:
    """The standard output; whoever sets COLUMNS has lines of that many letters, on a pipe too."""
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = UNBROKEN
    return console
