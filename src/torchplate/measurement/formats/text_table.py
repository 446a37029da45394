"""Tables as text, as spreadsheets, analysers and people write them: any encoding, separator and decimal mark."""

import csv
import re
from pathlib import Path
from typing import Final

_MARKS: Final = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
_GERMAN: Final = re.compile(r"[-+]?\d*,\d+([eEdD][-+]?\d+)?")
"""A number with a decimal comma."""
_GROUPED: Final = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?([eEdD][-+]?\d+)?")
"""A number whose thousands stand apart by commas."""
_POINTED: Final = re.compile(r"[-+]?[\d,]*\.\d*([eEdD][-+]?\d+)?")
_NUMBER: Final = re.compile(r"[-+]?\d+([.,]\d*)?([eEdD][-+]?\d+)?|[-+]?[.,]\d+([eEdD][-+]?\d+)?")
_FORTRAN: Final = re.compile(r"(?<=[\d.])[dD](?=[-+]?\d)")
_IMAGINARY: Final = re.compile(r"[iIJ](?=\)?$)")
_BRACKETED: Final = re.compile(r"[\[(]\s*([^\[\]()]+(?:\([^()]*\))?[^\[\]()]*)\s*[\])]\s*$")


def lines_of(path: Path) -> list[str]:
    """The lines of a text, in UTF-8 or UTF-16 with or without a mark, else in the western code page.

    Raises:
        OSError: It cannot be read.
    """
    content = path.read_bytes()
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            return content.decode(encoding, errors="replace").splitlines()
    try:
        return content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace").splitlines()


def cells_of(line: str) -> list[str]:
    """The cells of a row, empty ones left out.

    Columns stand apart by semicolons or tabs, else by commas, else by blanks. A comma within a number is a decimal
    point, unless commas part the columns and another number of the row has a point: then it parts thousands.

    Raises:
        ValueError: A row that is no table's, such as one without an end.
    """
    mark = next((one for one in ";\t" if one in line), None)
    if mark is None and ("," not in line or _blanks_part(line)):
        cells = line.split()
    else:
        try:
            cells = next(csv.reader([line], delimiter=mark or ",", skipinitialspace=True), [])
        except csv.Error as error:
            raise ValueError(f"a row that does not part: {error}") from error
    found = [text for cell in cells if (text := cell.strip())]
    if mark is None and any(_POINTED.fullmatch(cell) for cell in found):
        found = [cell.replace(",", "") if _GROUPED.fullmatch(cell) else cell for cell in found]
    return [with_point(cell) for cell in found]


def with_point(text: str) -> str:
    """A number with a decimal comma written with a point; anything else as it is."""
    return text.replace(",", ".") if _GERMAN.fullmatch(text) else text


def number_of(cell: str) -> float:
    """A cell as a number; Fortran's D before an exponent, as in 1.0D+03, is an E.

    Raises:
        ValueError: It is none.
    """
    return float(_FORTRAN.sub("e", cell))


def complex_of(cell: str) -> complex:
    """A cell as a complex number, whose imaginary unit is i or j, in either case; else as `number_of`.

    Raises:
        ValueError: It is none.
    """
    return complex(_IMAGINARY.sub("j", _FORTRAN.sub("e", cell.replace(" ", ""))))


def unit_in(name: str) -> str:
    """The unit that a column's head ends in, in brackets: "m/s²" of "Acc 1 [m/s²]"; empty where it has none."""
    found = _BRACKETED.search(name)
    return found.group(1).strip() if found else ""


def _blanks_part(line: str) -> bool:
    """Whether a row of numbers has blanks between its columns and commas within its numbers."""
    parts = line.split()
    return len(parts) > 1 and all(_NUMBER.fullmatch(part) for part in parts)
