"""Numbers as people read them: values with their errors and units, probabilities, lists of words."""

import math
from collections.abc import Sequence

from torchplate.diagnosis import Estimate
from torchplate.notation import percent


def figure_digits(value: float, std: float | None) -> str:
    """A number as far as its standard error lets it be read, to two digits of that."""
    text = digits(value, std)
    if std is None or not _tells(value, std):
        return text
    small = std < 1e-4 and "e" not in text
    # Both are written in one way.
    return f"{text} ± {f'{std:.{1 - math.floor(math.log10(std))}f}' if small else f'{std:.2g}'}"


def digits(value: float, std: float | None) -> str:
    """The number alone, with the digits that its standard error leaves; four where there is none."""
    if std is None or not _tells(value, std):
        return f"{value:.4g}"
    known = 2 + math.floor(math.log10(abs(value) or std)) - math.floor(math.log10(std))
    return f"{value:.{min(max(known, 2), 9)}g}"


def _tells(value: float, std: float) -> bool:
    return math.isfinite(value) and math.isfinite(std) and std > 0


def confidence(probability: float) -> str:
    """A probability that is not rounded to certainty."""
    return "over 99.9 %" if probability > 0.9995 else percent(probability)


def interval(low: float | None, high: float | None, std: float | None = None) -> str:
    """From here to there, with the digits that a standard error leaves; nothing where an end is not known."""
    return "" if low is None or high is None else f"{digits(low, std)} to {digits(high, std)}"


def quantity(one: Estimate) -> str:
    """A number with its error and its unit."""
    seen = "" if one.std is not None else " (error not seen)"
    return f"{figure_digits(one.value, one.std)}{with_unit(one.unit)}{seen}"


def with_unit(unit: str) -> str:
    """A unit behind its number; nothing where there is none."""
    return "" if unit in ("", "-") else f" {unit}"


def listed(words: Sequence[str], last: str = "and") -> str:
    """Words as a sentence has them: a, b and c."""
    return f" {last} ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
