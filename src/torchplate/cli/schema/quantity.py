"""Values as they are written, in the types that they are meant to have."""

import re
from collections.abc import Mapping
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError

from torchplate.cli.schema.complaint import first_complaint, shown
from torchplate.cli.schema.numbers import Known, Unknown
from torchplate.cli.schema.truth import check_number


def quantity(value: Any) -> Known | Unknown:
    """A number, a number with its tolerance, or an interval.

    Raises:
        ValueError: for anything else, saying what was expected and what came.
    """
    try:
        return parse_quantity(value)
    except ValidationError as error:
        kind = Known if error.title == Known.__name__ else Unknown
        raise ValueError(first_complaint(error, kind, "numbers")[1]) from None
    except ValueError as error:
        raise ValueError(f"Expected {error}, got {shown(value)}.") from None


def parse_quantity(value: Any) -> Known | Unknown:
    """As `quantity`; the error says only what was expected."""
    if isinstance(value, list | tuple) and len(value) == 2:
        return Unknown(low=value[0], high=value[1])
    if isinstance(value, Mapping) and not set(value) & (set(Known.model_fields) | set(Unknown.model_fields)):
        raise ValueError("a number, an interval {low: , high: }, or {value: , std: }")
    if isinstance(value, Mapping):
        return Known(**value) if "value" in value else Unknown(**value)
    if isinstance(value, bool | list | tuple):
        raise ValueError("a number, an interval [low, high], or {value: , std: }")
    try:
        return Known(value=value)
    except ValidationError:
        raise ValueError(f"a number, an interval [low, high], or {{value: , std: }}{_hint(value)}") from None


def _hint(value: Any) -> str:
    """What a text that is nearly a number lacks."""
    if not isinstance(value, str):
        return ""
    if re.fullmatch(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*", value):
        return " with a decimal point, not a comma"
    if re.fullmatch(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*[^\d\s.,].*", value):
        return " alone, in SI units and without the unit"
    return ""


def typed(owner: type, name: str, value: Any) -> Any:
    """A setting in the type that its dataclass declares for it; lists become tuples.

    Raises:
        ValueError: if it is of another kind, saying what was expected and what came.
    """
    kind = get_type_hints(owner)[name]
    check_number(kind, value)
    try:
        return _frozen(TypeAdapter(kind).validate_python(value))
    except ValidationError as error:
        raise ValueError(first_complaint(error)[1]) from None


def _frozen(value: Any) -> Any:
    return tuple(_frozen(inner) for inner in value) if isinstance(value, list) else value
