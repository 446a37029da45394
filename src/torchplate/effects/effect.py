"""What an effect is, and the catalogue of them.

An effect is declared like a table, data first, then one formula. It has five possible words: `geometry`, `section`,
`local`, `proportional` and `observe`. It never builds a whole matrix, so the same effect serves the dense population,
the fine mesh and the reduced basis. A class body that inherits from Effect enters the catalogue by itself.
"""

import dataclasses
import difflib
import math
import re
from abc import ABC
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.plate import Geometry, Local, Mesh, Proportional, Section

Value = Mapping[str, Tensor]


@dataclass(frozen=True)
class Interval:
    """Values a parameter may take, ends included unless `open_low`."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False

    def __contains__(self, value: float) -> bool:
        return (self.low < value if self.open_low else self.low <= value) and value <= self.high

    def __str__(self) -> str:
        if math.isinf(self.high):
            return "any number" if math.isinf(self.low) else f"{'above' if self.open_low else 'at least'} {self.low:g}"
        return f"from {self.low:g} to {self.high:g}"


positive = Interval(0.0, open_low=True)
nonnegative = Interval(0.0)
unit_interval = Interval(0.0, 1.0)


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Args:
        unit: SI unit, "-" for none.
        meaning: what it is, in a few words.
        allowed: the values that make physical sense.
        neutral: the value that leaves the model as it was; None where the parameter must be given.
    """

    unit: str
    meaning: str
    allowed: Interval = Interval()
    neutral: float | None = None


class SensorChain(NamedTuple):
    """How motion becomes a reading: where the responses sit, at which s the record is transformed, what it is times.

    The reading is factor(s) · H(s), evaluated at s = iω where nothing disturbs it.
    """

    laplace: Complex[Tensor, "*batch n_frequency"]  # s [1/s]
    response: Float[Tensor, "*batch n_response 2"]  # relative places [-]
    factor: Complex[Tensor, "*batch n_frequency n_response n_reference"]  # [-]


CATALOGUE: dict[str, type["Effect"]] = {}


@dataclass(frozen=True)
class Effect(ABC):
    """One physical effect; fields of a subclass are its fixed options (nodes, an edge), never searched."""

    name: ClassVar[str]
    parameters: ClassVar[Mapping[str, Parameter]]
    acts_on: ClassVar[frozenset[str]]
    shows: ClassVar[str]
    source: ClassVar[str]

    def __init_subclass__(cls) -> None:
        """Enter the catalogue under the class's name in snake case."""
        cls.name = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()
        for word in ("parameters", "acts_on", "shows", "source"):
            if word not in vars(cls):
                raise TypeError(f"The effect '{cls.name}' says nothing of its {word}. Add it to the class body.")
        CATALOGUE[cls.name] = cls

    def geometry(self, geometry: Geometry, value: Value) -> Geometry:
        """The plate's sides as this effect changes them."""
        return geometry

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The elements' section as this effect changes it."""
        return section

    def local(self, mesh: Mesh, value: Value) -> Local | None:
        """Masses, springs and dashpots that this effect adds at places."""
        return None

    def proportional(self, value: Value) -> Proportional | None:
        """Damping in proportion to the whole model that this effect adds."""
        return None

    def observe(self, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """The sensor chain as this effect changes it."""
        return chain


def find_effect(name: str) -> type[Effect]:
    """The effect of that name.

    Raises:
        KeyError: if the catalogue holds none, with the nearest name.
    """
    if name not in CATALOGUE:
        near = difflib.get_close_matches(name, CATALOGUE, n=1)
        guess = f" Did you mean '{near[0]}'?" if near else ""
        raise KeyError(f"No effect named '{name}'.{guess} The catalogue holds: {', '.join(CATALOGUE)}.")
    return CATALOGUE[name]


def options(effect: type[Effect]) -> tuple[str, ...]:
    """Names of an effect's fixed options."""
    return tuple(field.name for field in dataclasses.fields(effect))
