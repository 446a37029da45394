"""A key of a config: its kind, unit, default, meaning and an example, as the reference tells it."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field, field_validator

from torchplate.cli.schema.truth import check_number


class Numbers(BaseModel):
    """A section in which no truth value counts as a number."""

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value(cls, value: Any, info: Any) -> Any:  # beartype cannot check pydantic's protocol
        if info.field_name is not None:
            check_number(cls.model_fields[info.field_name].annotation, value)
        return value


class Strict(Numbers):
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
