"""Truth values where numbers belong: Python takes true for 1 and false for 0, and so does pydantic."""

from collections.abc import Iterator, Mapping
from typing import Any, get_args


def check_number(kind: Any, value: Any) -> None:
    """Whether no truth value stands where numbers belong.

    Args:
        kind: of the value, as it is annotated.
        value: as it was written.

    Raises:
        ValueError: one stands there, saying what was expected and what came.
    """
    leaves = set(_leaves(kind))
    if not leaves & {int, float} or leaves & {bool, Any}:
        return
    if (found := next(_truths(value), None)) is not None:
        words = "true, yes or on" if found else "false, no or off"
        wanted = "a number" if float in leaves else "a whole number"
        raise ValueError(f"Expected {wanted}, got {words}, which is none. Write a number.")


def _leaves(kind: Any) -> Iterator[Any]:
    """The types that a type is made of, those of the keys of mappings with them."""
    inner = get_args(kind)
    if not inner:
        yield kind
    for one in inner:
        yield from _leaves(one)


def _truths(value: Any) -> Iterator[bool]:
    """The truth values that a value is or holds."""
    if isinstance(value, bool):
        yield value
    elif isinstance(value, Mapping):
        for pair in value.items():
            yield from _truths(pair)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _truths(one)
