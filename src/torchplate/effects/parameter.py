"""One number of an effect: its unit, the values that make sense, and where a search for the effect looks for it."""

import math
from dataclasses import dataclass

from torchplate.plate import Geometry, Section


@dataclass(frozen=True)
class Interval:
    """Values that make physical sense, ends included unless `open_low`; what is `Searched` lies within."""

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
class Searched:
    """The interval of one searched parameter.

    Args:
        low: lower end, in the parameter's unit.
        high: upper end, > low.
        logarithmic: the search sees equal steps as equal ratios; then low > 0.

    Raises:
        ValueError: if the interval is empty, or logarithmic with an end that is not positive.
    """

    low: float
    high: float
    logarithmic: bool = False

    def __post_init__(self) -> None:
        if not self.low < self.high:
            remedy = "Write the number alone" if self.low == self.high else "Swap the ends"
            raise ValueError(f"Expected an interval with low < high, got [{self.low:g}, {self.high:g}]. {remedy}.")
        if self.logarithmic and self.low <= 0:
            raise ValueError(
                f"Expected a positive low end for scale: log, got {self.low:g}. Raise it, or use the linear scale."
            )


# Powers of kilogram, metre and second in each unit, and what these three make of the plate's own scales.
PLATE_SCALE = {
    "kg": ((1, 0, 0), "ρhA"),
    "m": ((0, 1, 0), "√A"),
    "s": ((0, 0, 1), "A √(ρh/D)"),
    "1/s": ((0, 0, -1), "√(D/ρh) / A"),
    "1/s²": ((0, 0, -2), "D/(ρhA²)"),
    "N/m": ((1, 0, -2), "D/A"),
    "N s/m": ((1, 0, -1), "√(Dρh)"),
    "N/m²": ((1, -1, -2), "D/A^(3/2)"),
    "N/rad": ((1, 1, -2), "D/√A"),
    "N m²": ((1, 3, -2), "D √A"),
    "kg/m": ((1, -1, 0), "ρhA/√A"),
}


@dataclass(frozen=True)
class Prior(Searched):
    """Where a search that looks for an effect looks for one of its parameters.

    Args:
        low: lower end, in the parameter's unit or, where `relative_to` is given, in multiples of that.
        high: upper end, likewise.
        logarithmic: as of what is searched.
        relative_to: None; or "plate": what the plate's mass ρhA, length √A and time A √(ρh/D) make of the parameter's
            unit; or the quantity of the plate's section whose present value is meant ("thickness").
        usual: where half of all cases lie close to the neutral value, their standard deviation about it, of the
            logarithm where that is searched; None where the interval alone says what is known.
    """

    relative_to: str | None = None
    usual: float | None = None

    def describe(self, unit: str) -> str:
        """The prior in a few words, for a parameter of that unit."""
        if self.relative_to is None:
            of = ""
        elif self.relative_to == "plate":
            of = f" × {PLATE_SCALE[unit][1]}"
        else:
            of = f" × present {self.relative_to}"
        near = ""
        if self.usual is not None:
            near = f", half of all near no change (std {self.usual:g}{' of ln' if self.logarithmic else ''})"
        return f"{self.low:.3g} to {self.high:.3g}{of}{', log' if self.logarithmic else ''}{near}"


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Args:
        unit: SI unit, "-" for none.
        meaning: what it is, in a few words.
        allowed: the values that make physical sense.
        neutral: the value that leaves the model as it was; None where the parameter must be given.
        prior: where a search for the effect looks for it; None if it is never looked for.
        detail: whether it is looked for only once the effect was found with this at its neutral value.
    """

    unit: str
    meaning: str
    allowed: Interval = Interval()
    neutral: float | None = None
    prior: Prior | None = None
    detail: bool = False

    @property
    def looked_for(self) -> str:
        """Where a search for the effect looks for it, in a few words; empty where it is never looked for."""
        if self.prior is None:
            return ""
        return self.prior.describe(self.unit) + (", once the effect was found" if self.detail else "")

    def prior_interval(self, section: Section, geometry: Geometry) -> Searched:
        """The prior in the parameter's unit, cut to what is allowed.

        Args:
            section: of the plate as it is now; elements that differ count with their mean.
            geometry: its sides.

        Raises:
            ValueError: if the parameter has no prior.
        """
        if self.prior is None:
            raise ValueError(
                f"Expected a prior for the parameter '{self.meaning}', got none. Give an interval, or add a `prior` to "
                "its Parameter."
            )
        ends = self.prior.low, self.prior.high
        if (of := self.prior.relative_to) is not None:
            at_present = of != "plate"
            scale = float(getattr(section, of).mean()) if at_present else plate_scale(self.unit, section, geometry)
            # A Poisson's ratio may be below zero, and what is relative to it then lies the other way round.
            ends = min(end * scale for end in ends), max(end * scale for end in ends)
        return Searched(
            max(ends[0], self.allowed.low), min(ends[1], self.allowed.high), logarithmic=self.prior.logarithmic
        )


# Whether a patch is longer along one side of the plate: three to one, beyond which it is a strip.
patch_aspect = Parameter(
    "-",
    "side along x over that along y, the area kept",
    positive,
    neutral=1.0,
    prior=Prior(1 / 3, 3.0, logarithmic=True),
    detail=True,
)


def plate_scale(unit: str, section: Section, geometry: Geometry) -> float:
    """The one product of powers of the plate's mass ρhA, length √A and time A √(ρh/D) that has this unit.

    Args:
        unit: one of `PLATE_SCALE`.
        section: of the plate; elements that differ count with their mean.
        geometry: its sides.
    """
    kilogram, metre, second = PLATE_SCALE[unit][0]
    area = float((geometry.length_x * geometry.length_y).mean())
    areal_mass, rigidity = float(section.areal_mass.mean()), float(section.rigidity[..., 0, 0].mean())
    time = area * math.sqrt(areal_mass / rigidity)
    return (areal_mass * area) ** kilogram * area ** (metre / 2) * time**second
