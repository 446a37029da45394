"""What may stand where a number belongs: one that is known, or an interval that is searched."""

from typing import Literal

from pydantic import model_validator

from torchplate.cli.schema.key import Strict, key
from torchplate.model import Searched


class Known(Strict):
    """A number, and how well it is known: `run` takes the value, `diagnose` weighs it."""

    value: float = key("the number", "as the key", example=0.48)
    std: float = key("its standard deviation", "as the key", example=0.0005, default=0.0, ge=0)


class Unknown(Strict):
    """An interval to be searched; `[low, high]` for short."""

    low: float = key("lower end", "as the key", example=1.0e-5)
    high: float = key("upper end", "as the key", example=1.0e-2)
    scale: Literal["linear", "log"] = key(
        "whether the search sees equal differences or equal ratios as equal steps", example="log", default="linear"
    )

    @model_validator(mode="after")
    def _ends_in_order(self) -> "Unknown":
        Searched(self.low, self.high, self.scale == "log")
        return self
