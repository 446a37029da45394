"""One notation of gaps and other parts of a whole, wherever people read them."""

import math

LEAST, MOST = 1e-5, 1e3
"""Parts between which digits say something: not below a thousandth of a per cent, nor beyond a thousandfold."""


def percent(part: float | None) -> str:
    """A part as a percentage of three digits, never with an exponent: "36.3 %", "under 0.001 %", "over 100 000 %".

    What rounding leaves below zero is "0 %".

    Args:
        part: of a whole [-]; nothing is said where there is none.
    """
    if part is None:
        return ""
    if math.isnan(part):
        return "not known"
    if abs(part) < LEAST:
        return "under 0.001 %" if part > 0 else "0 %"
    if abs(part) > MOST:
        return f"{'over' if part > 0 else 'below −'}{' ' * (part > 0)}100 000 %"
    rounded = float(f"{100 * part:.3g}")
    return f"{rounded:.6f}".rstrip("0").rstrip(".").replace("-", "−") + " %"
