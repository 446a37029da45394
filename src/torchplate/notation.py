"""One notation of gaps and other parts of a whole, and of counts, wherever people read them."""

import math
from typing import Final

LEAST: Final = 1e-5
"""A part below which digits say nothing: a thousandth of a per cent [-]."""
MOST: Final = 1e3
"""A part beyond which digits say nothing: a thousandfold [-]."""


def percent(part: float | None, digits: int = 3, *, decimals: int | None = None, signed: bool = False) -> str:
    """A part as a percentage, never with an exponent: "36.3 %", "under 0.001 %", "over 100 000 %".

    What rounding leaves below zero is "0 %".

    Args:
        part: of a whole [-]; nothing is said where there is none.
        digits: that are right, ≥ 1.
        decimals: instead of them, so that a column of differences lines up.
        signed: with a plus where it is above zero, as differences have it.
    """
    if part is None:
        return ""
    if math.isnan(part):
        return "not known"
    if abs(part) > MOST:
        return f"{'over' if part > 0 else 'below −'}{' ' * (part > 0)}100 000 %"
    sign = "+" if signed else "-"
    if decimals is not None:
        text = f"{100 * part:{sign}.{decimals}f}"
    elif abs(part) < LEAST:
        return "under 0.001 %" if part > 0 else "0 %"
    else:
        text = f"{float(f'{100 * part:.{digits}g}'):{sign}.6f}".rstrip("0").rstrip(".")
    return text.replace("-", "−") + " %"


def drop(part: float) -> str:
    """The part that something would take away, as a percentage; "none" where it would add to what is there.

    Args:
        part: of a whole [-], below zero where it would grow.
    """
    return "none" if part <= -LEAST else percent(part)


def number_of_percent(part: float, digits: int = 3, *, decimals: int | None = None) -> str:
    """The same without its sign, where the head of a column or an axis has it: "36.3".

    Args:
        part: of a whole [-].
        digits: as for `percent`.
        decimals: likewise.
    """
    return percent(part, digits, decimals=decimals).removesuffix(" %")


def counted(n: int, one: str, many: str = "") -> str:
    """A number of things: "1 FRF", "12 FRFs".

    Args:
        n: of them.
        one: the word for one.
        many: for several; with an s where left out.
    """
    return f"{n} {one if n == 1 else many or one + 's'}"


def shortened(text: str, most: int = 200) -> str:
    """Text that somebody else wrote, as a sentence may quote it: cut where it is long.

    Args:
        text: of a file, say.
        most: characters that are left [-].
    """
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"
