"""The unit of length that the head of a table of nodes states: x [mm], y (mm), Z_mm, x / mm, or a row of units."""

import re
from collections.abc import Iterator, Sequence
from typing import Final

from torchplate.measurement.formats.text_table import unit_in
from torchplate.measurement.points.frame import METRES

_NAMES: Final = {
    **{name: name for name in METRES},
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("centimetre", "centimetres", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
    **dict.fromkeys(("inch", "inches", '"', "''", "″"), "in"),
}
"""How people write the units that a frame has."""
_OTHERS: Final = frozenset(
    {"dm", "km", "um", "µm", "μm", "nm", "ft", "foot", "feet", "yd", "mil", "thou", "px", "pixel", "%"}
)
"""What else lengths come in: behind a blank or an underscore only these are units, and not x_1 or x_plate."""
_AXIS: Final = re.compile(r"(?<![^\W_])[xyz](?:pos|coord\w*)?(?![^\W_])(?P<rest>.*)", re.IGNORECASE)
_BEHIND: Final = re.compile(r"\s*(?P<mark>[/_\s])\s*(?:in[_\s]+)?(?P<unit>[^\W\d_]+|[%\"″]|'')\s*", re.IGNORECASE)


def is_head(cells: Sequence[str]) -> bool:
    """Whether these cells name coordinates: a column x and a column y."""
    axes = {found.group()[0].lower() for cell in cells if (found := _AXIS.search(cell))}
    return {"x", "y"} <= axes


def is_row_of_units(cells: Sequence[str]) -> bool:
    """Whether these cells are units, and signs of none, alone."""
    return any(known(cell) for cell in cells) and all(known(cell) or cell.strip("[]()- ") == "" for cell in cells)


def known(unit: str) -> str | None:
    """A frame's name for a unit as people write it; None where it is none of these."""
    return _NAMES.get(unit.strip("[]() ").lower())


def units_of(cells: Sequence[str]) -> list[str]:
    """The units that a head's columns state, as they are written, those of the column of nodes apart."""
    return list(dict.fromkeys(_units(_whole(cells)[1:])))


def _units(cells: Sequence[str]) -> Iterator[str]:
    for cell in cells:
        if bracketed := unit_in(cell):
            yield bracketed
        elif (axis := _AXIS.search(cell)) and (behind := _BEHIND.fullmatch(axis.group("rest"))):
            unit = behind.group("unit")
            if behind.group("mark") == "/" or known(unit) or unit.lower() in _OTHERS:
                yield unit


def _whole(cells: Sequence[str]) -> list[str]:
    """Cells of a head that blanks part, their units put back to them."""
    found: list[str] = []
    for cell in cells:
        if found and (cell[:1] in "[(/" or (_AXIS.fullmatch(found[-1]) and known(cell))):
            found[-1] += f" {cell}"
        else:
            found.append(cell)
    return found
