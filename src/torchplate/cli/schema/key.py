"""A key of a config: its kind, unit, default, meaning and an example, as the reference tells it."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Strict(BaseModel):
    """A section that has no other keys than its own, and no number that is none."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def key(meaning: str, unit: str = "-", *, example: Any, default: Any = ..., **limits: Any) -> Any:
    """A key of a config, as the reference tells it.

    Args:
        meaning: what it says, half a sentence.
        unit: SI unit, "-" for none.
        example: a value that could stand there.
        default: what holds where the key is left out; required if left out here.
        limits: of its value, as pydantic takes them.
    """
    return Field(default, description=meaning, examples=[example], json_schema_extra={"unit": unit}, **limits)
