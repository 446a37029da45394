"""Kind and unit of a level, from a universal file's specifiers and labels.

Source: Universal File Format, dataset 58, records 9 and 10 (specific data type, axis units label) and
dataset 164 (units), University of Cincinnati SDRL.
"""

import math
import re
from typing import Final, NamedTuple

from torchplate.measurement.measurement import Kind

MOTION: Final = {8: "displacement", 11: "velocity", 12: "acceleration"}
FORCE: Final = {9: "reaction force", 13: "excitation force"}
KIND_OF_MOTION: Final[dict[str, Kind]] = {
    "displacement": "receptance",
    "velocity": "mobility",
    "acceleration": "accelerance",
}
MOTION_OF_KIND: Final = {kind: motion for motion, kind in KIND_OF_MOTION.items()}
SPECIFIER: Final = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}
SI_LABEL: Final = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2", "force": "N"}

_LENGTH: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
_TO_SI: Final[dict[str, dict[str, float]]] = {
    "displacement": _LENGTH,
    "velocity": {f"{name}/s": factor for name, factor in _LENGTH.items()},
    "acceleration": {f"{name}/s2": factor for name, factor in _LENGTH.items()}
    | dict.fromkeys(("g", "gn", "g's"), 9.80665),
    "force": dict.fromkeys(("n", "newton", "newtons"), 1.0)
    | {"kn": 1e3, "lbf": 4.4482216152605, "lb": 4.4482216152605, "kgf": 9.80665},
}
_SECOND: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
_HERTZ: Final = (
    {"hz": 1.0, "khz": 1e3, "1/s": 1.0, "cps": 1.0}
    | dict.fromkeys(("rad/s", "rad/s.", "radians/s"), 1 / (2 * math.pi))
    | dict.fromkeys(("rpm", "cpm", "1/min"), 1 / 60)
)
_ANGLES: Final = {"deg", "degree", "degrees", "°", "grad", "rad", "radian", "radians", "pi", "π", "pirad", "πrad"}
_OTHER: Final = {"", "-", "v", "mv", "pa", "um/m", "counts", "eu", "db"} | _ANGLES
"""What else stands in a row of units."""

UNIT_OF_KIND: Final[dict[str, Kind]] = {
    r"/s[2\ufffd]|(^|[^a-z])gn?([^a-z]|$)": "accelerance",
    r"m/s": "mobility",
    r"^[mcu]?m/": "receptance",
}
"""What to look for in a unit's label, the first that is found."""


class Units(NamedTuple):
    """Factors of dataset 164: a value of the file divided by its factor is SI.

    Args:
        length: File lengths per metre [-], > 0.
        force: File forces per newton [-], > 0.
    """

    length: float = 1.0
    force: float = 1.0


def kind_of(numerator: int, denominator: int, function_type: int) -> Kind | None:
    """Read the kind from the specific data types; None where they do not settle it.

    Args:
        numerator: Specific data type of the ordinate: 8 displacement, 11 velocity, 12 acceleration.
        denominator: Of what the response is divided by: 13 (or 9) force, or the numerator's own type.
        function_type: 4 for an FRF, 5 for a transmissibility.
    """
    if function_type == 5 or (numerator in MOTION and numerator == denominator):
        return "transmissibility"
    if numerator in MOTION and denominator in FORCE:
        return KIND_OF_MOTION[MOTION[numerator]]
    return None


def likely_kind(numerator: int, label: str) -> Kind | None:
    """What FRFs of unclear specifiers probably are; None where nothing in the file tells.

    Args:
        numerator: Specific data type of the ordinate.
        label: Unit of the ordinate, which some exporters write of the whole FRF: "(1/N)*(m/s²)".
    """
    if numerator in MOTION:
        return KIND_OF_MOTION[MOTION[numerator]]
    text = _plain(label)
    # A ² of another encoding comes as a character that stands for what cannot be read.
    for pattern, kind in UNIT_OF_KIND.items():
        if re.search(pattern, text):
            return kind
    return None


def factor_to_si(kind: Kind, numerator_label: str, denominator_label: str, units: Units) -> tuple[float, str | None]:
    """Find what turns the file's level into SI, and what had to be assumed.

    A label that is understood wins over dataset 164, as dataset 58 rules for its axis labels; without either,
    the level is taken as SI.

    Returns:
        The factor [SI unit per file unit] and a sentence where a label was not understood, else None.
    """
    if kind == "transmissibility":
        if _plain(numerator_label) == _plain(denominator_label):
            return 1.0, None
        stated = f"{numerator_label or 'none'} over {denominator_label or 'none'}"
        return 1.0, f"A transmissibility has no unit; the file's labels ({stated}) were not applied."
    factor, strange = 1.0, []
    numerator_label, denominator_label = _parted(kind, numerator_label, denominator_label)
    sides = (
        (MOTION_OF_KIND[kind], numerator_label, 1.0 / units.length),
        ("force", denominator_label, 1.0 / units.force),
    )
    for sign, (quantity, label, without_label) in zip((1, -1), sides, strict=True):
        found = to_si(quantity, label)
        if found is None:
            found = without_label
            if _plain(label):
                strange.append(f"{label.strip()!r} as {quantity}")
        factor *= found**sign
    note = f"The unit label {' and '.join(strange)} is not known; the level was taken as SI." if strange else None
    return factor, note


def _parted(kind: Kind, numerator: str, denominator: str) -> tuple[str, str]:
    """Labels of motion and force where one of them holds both, as in "g/N" or "(m/s^2)/N"."""
    if to_si(MOTION_OF_KIND[kind], numerator) is not None:
        return numerator, denominator
    motion, slash, force = numerator.strip().rpartition("/")
    if not slash or to_si(MOTION_OF_KIND[kind], motion) is None or to_si("force", force) is None:
        return numerator, denominator
    return motion, force


def second_of(label: str) -> float | None:
    """Factor from a unit's label to seconds; None where the label is not known."""
    return _SECOND.get(_plain(label))


def hertz_of(label: str) -> float | None:
    """Factor from the unit's label of a frequency axis to Hz, 1 for none; None where the label is not known."""
    return 1.0 if not _plain(label) else _HERTZ.get(_plain(label))


def is_unit(label: str) -> bool:
    """Whether a cell of a table is the unit of its column."""
    known = _plain(label) in _OTHER | {*_HERTZ} or second_of(label) is not None or quantity_of(label) is not None
    motion, slash, force = label.strip("()[] ").rpartition("/")
    return known or (slash != "" and quantity_of(motion) is not None and quantity_of(force) == "force")


def quantity_of(label: str) -> str | None:
    """The quantity a unit's label is of, "displacement", "velocity", "acceleration" or "force"; None for another."""
    return next((quantity for quantity in _TO_SI if to_si(quantity, label) is not None), None) if label else None


def to_si(quantity: str, label: str) -> float | None:
    """Factor from a unit's label to SI; None where the label is not known.

    Args:
        quantity: "displacement", "velocity", "acceleration" or "force".
        label: As a file writes it.
    """
    if quantity == "force" and label.strip() == "mN":  # case is all that parts milli from mega
        return 1e-3
    return _TO_SI[quantity].get(_plain(label))


def _plain(label: str) -> str:
    text = label.strip().lower().replace(" ", "").replace("^", "").replace("²", "2").replace("µ", "u")
    text = text.replace("seconds", "s").replace("sec", "s").replace("s**2", "s2").replace("/s/s", "/s2").strip("()[]")
    return "" if text in ("none", "null", "nounit") else text
