"""Tables in LaTeX, of the standard packages alone, to be read by `input`."""

import re
from collections.abc import Sequence

from torchplate.report.blocks.document import Table

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "²": r"\textsuperscript{2}",
    "³": r"\textsuperscript{3}",
    "−": r"\textminus{}",
    "·": r"\textperiodcentered{}",
    "°": r"\textdegree{}",
    "√": r"$\surd$",
} | {sign: f"\\{sign}" for sign in "{}$&#_%"}


def latex(tables: Sequence[Table]) -> str:
    """Each as a `table` with its caption; heads that end in ">" are numbers and stand to the right."""
    return "\n".join(_table(table) for table in tables)


def _table(table: Table) -> str:
    columns = "".join("r" if name.endswith(">") else "l" for name in table.head)
    rows = [[name.removesuffix(">") for name in table.head], *table.rows]
    lines = [" & ".join(map(escaped, row)) + r" \\" for row in rows]
    inner = [r"\hline", lines[0], r"\hline", *lines[1:], r"\hline"]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{escaped(table.caption)}}}",
            r"\centering",
            rf"\begin{{tabular}}{{{columns}}}",
            *inner,
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def escaped(text: str) -> str:
    """Text that LaTeX sets as it is."""
    special = "".join(map(re.escape, _SPECIAL))
    return re.sub(f"[{special}]", lambda found: _SPECIAL[found[0]], text.replace("\n", " "))
