"""Sizes and moduli of a plate against what plates are made of: what no plate is, what few are, and the unit meant.

Possible ends are physics: no plate in a vibration test is longer than a street, no solid is lighter than the lightest
foam or softer than the softest rubber. Between these and the usual ends a value is worth a word.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from torchplate.effects import AirLoading, EdgeSpring, GroundSpring, Plate, SupportSpring
from torchplate.model.plate_model import PlateModel
from torchplate.plate import ELEMENTS_PER_WAVELENGTH, bending_wavelength


@dataclass(frozen=True)
class Quantity:
    """One kind of number, in SI units.

    Args:
        name: in words.
        unit: SI unit as text.
        possible: outside these no plate is.
        usual: outside these few are.
        mistaken: units in which it is often written by mistake, and what turns each into SI.
    """

    name: str
    unit: str
    possible: tuple[float, float]
    usual: tuple[float, float]
    mistaken: tuple[tuple[str, float], ...]

    def meant(self, low: float, high: float) -> list[tuple[str, float]]:
        """Units in which both ends of an interval are usual, the likeliest first, each with its factor."""
        return [
            (unit, factor)
            for unit, factor in self.mistaken
            if self.usual[0] <= factor * low and factor * high <= self.usual[1]
        ]


LENGTHS = (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254), ("micrometres", 1e-6))
SIDE = Quantity("side of the plate", "m", (1e-6, 100.0), (5e-3, 10.0), LENGTHS)
QUANTITIES = {
    "thickness": Quantity("thickness", "m", (1e-9, 10.0), (1e-5, 0.2), LENGTHS),
    # Silicone rubber: 1 MPa; the stiffest solid, diamond: 1.2 TPa.
    "youngs_modulus": Quantity(
        "Young's modulus",
        "Pa",
        (1e6, 1e13),
        (1e8, 1.3e12),
        (("gigapascals", 1e9), ("megapascals", 1e6), ("pounds per square inch", 6894.757), ("kilopascals", 1e3)),
    ),
    # Foams begin near 20 kg/m³, balsa at 60; osmium has 22 590.
    "density": Quantity(
        "density",
        "kg/m³",
        (20.0, 1e5),
        (60.0, 2.3e4),
        (("g/cm³", 1e3), ("t/mm³", 1e12), ("kg/mm³", 1e9), ("lb/in³", 27679.9), ("lb/ft³", 16.01846)),
    ),
}
# Of the shorter side, beyond which a plate is a block; of the longer, beyond which thin-plate theory is far off.
BLOCK, THICK = 1.0, 0.1
# Masses of plates that somebody hangs up and hits [kg].
MASSES = (1e-5, 1e4)
# Wires of 4 m let a plate swing at 0.25 Hz; longer ones hang in no laboratory.
SLOWEST, GRAVITY = 0.25, 9.81
# Axes of a plate that are turned further are named the other way round.
RIGHT_ANGLE = math.pi / 2
# Of air [kg/m³], as thin as 20 km up, where nobody tests plates.
THIN_AIR = 0.1
# Elements along a bending wave below which natural frequencies are a tenth off and more; less is a diagnosis' to name.
COARSE = 1.5


class Remark(NamedTuple):
    """What is wrong or odd in a config.

    Args:
        key: of the config: "effects.plate.density".
        sentence: expected, got, what to do.
    """

    key: str
    sentence: str


class Span(NamedTuple):
    """A value from the lowest to the highest that a search may take; a known one's ends are equal."""

    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.low:.4g}" if self.low == self.high else f"{self.low:.4g} to {self.high:.4g}"

    def times(self, factor: float) -> "Span":
        """Both ends times a factor."""
        return Span(factor * self.low, factor * self.high)

    def to_power(self, power: float) -> "Span":
        """Both ends, above 0, to a power."""
        return Span(*sorted((self.low**power, self.high**power)))

    def by(self, other: "Span") -> "Span":
        """All products of numbers above 0."""
        return Span(self.low * other.low, self.high * other.high)

    def as_written(self) -> str:
        """As a config holds it."""
        return f"{self.low:.4g}" if self.low == self.high else f"[{self.low:.4g}, {self.high:.4g}]"


def sizes(model: PlateModel) -> dict[str, tuple[Quantity, Span]]:
    """Sides, thickness, modulus and density of the bare plate by their keys in a config."""
    label = next(label for label, effect in model.effects.items() if isinstance(effect, Plate))
    ends = [model.values(end)[label] for end in (model.space.low, model.space.high)]
    found = {
        f"effects.{label}.{name}": (quantity, Span(*(float(end[name]) for end in ends)))
        for name, quantity in QUANTITIES.items()
    }
    sides = {"mesh.length_x": model.mesh.length_x, "mesh.length_y": model.mesh.length_y}
    return {key: (SIDE, Span(side, side)) for key, side in sides.items()} | found


def plate_mass(model: PlateModel) -> Span:
    """Mass of the bare plate ρhA [kg]."""
    found = {key.rpartition(".")[2]: span for key, (_, span) in sizes(model).items()}
    area = model.mesh.length_x * model.mesh.length_y
    return Span(*(area * found["density"][end] * found["thickness"][end] for end in (0, 1)))


def impossible(model: PlateModel) -> Remark | None:
    """What no plate is, whatever value of its interval a search takes; None where there is nothing of the kind."""
    found = sizes(model)
    for key, (quantity, span) in found.items():
        low, high = quantity.possible
        if span.low <= high and span.high >= low:
            continue
        end = f"above {high:g}" if span.low > high else f"below {low:g}"
        return Remark(
            key,
            f"Expected a {quantity.name} in {quantity.unit}, got {span}: no plate's is {end} {quantity.unit}. "
            f"{_remedy(quantity, span)}",
        )
    shorter = min(model.mesh.length_x, model.mesh.length_y)
    key, (quantity, span) = next((key, entry) for key, entry in found.items() if key.endswith(".thickness"))
    if span.low >= BLOCK * shorter:
        # A side that is as thin as a sheet.
        exchanged = span.low > 10 * shorter and shorter < quantity.usual[1]
        remedy = "Were the two exchanged?" if exchanged else _remedy(quantity, span)
        return Remark(
            key,
            f"Expected a thickness in m below the plate's shorter side, {shorter:g} m, got {span}. {remedy}",
        )
    return None


def unusual(model: PlateModel) -> tuple[Remark, ...]:
    """What few plates are: worth a word, and no more."""
    return tuple(_unusual(model))


def _unusual(model: PlateModel) -> Iterator[Remark]:
    found, said = sizes(model), set[str]()
    for key, (quantity, span) in found.items():
        low, high = quantity.usual
        if (span.low > high or span.high < low) and quantity.name not in said:
            said.add(quantity.name)
            yield Remark(
                key,
                f"{span} {quantity.unit} is unusual: a {quantity.name} mostly lies between {low:g} and {high:g} "
                f"{quantity.unit}. {_remedy(quantity, span)}",
            )
    longer = max(model.mesh.length_x, model.mesh.length_y)
    key, (quantity, span) = next((key, entry) for key, entry in found.items() if key.endswith(".thickness"))
    if span.low > THICK * longer and quantity.name not in said:
        yield Remark(
            key,
            f"{span} m is more than a tenth of the longer side, {longer:g} m, where thin-plate theory is far off. "
            f"{_remedy(quantity, span)}",
        )
    mass = plate_mass(model)
    if mass.low > MASSES[1] or mass.high < MASSES[0]:
        yield Remark(
            "effects",
            f"The plate weighs {mass} kg: few plates of a vibration test do. Check sides and thickness in m and the "
            "density in kg/m³.",
        )
    at_low, at_high = model.values(model.space.low), model.values(model.space.high)
    for label, effect in model.effects.items():
        for name, parameter in effect.parameters.items():
            value = Span(float(at_low[label][name]), float(at_high[label][name]))
            if parameter.unit == "kg" and value.low > max(mass.high, 0.0):
                yield Remark(
                    f"effects.{label}.{name}",
                    f"{value} kg is more than the plate's own {mass} kg. If it is in grams, write "
                    f"{value.times(1e-3).as_written()}.",
                )
            if name.endswith("loss_factor") and parameter.unit == "-" and (value.low > 0.5 or value.high > 1):
                yield Remark(
                    f"effects.{label}.{name}",
                    f"{value} is unusual: loss factors of plates mostly lie below 0.5. If it is in per cent, write "
                    f"{value.times(0.01).as_written()}.",
                )
            if parameter.unit == "rad" and (value.low > RIGHT_ANGLE or value.high < -RIGHT_ANGLE):
                yield Remark(
                    f"effects.{label}.{name}",
                    f"{value} rad is more than a right angle. If it is in degrees, write "
                    f"{value.times(math.pi / 180).as_written()}.",
                )
            if isinstance(effect, AirLoading) and name == "density" and 0 < value.high < THIN_AIR:
                yield Remark(
                    f"effects.{label}.{name}",
                    f"{value} kg/m³ is unusual: the air of a room has 1.2. If it is in g/cm³, write "
                    f"{value.times(1e3).as_written()}.",
                )
    yield from _swinging(model, mass)


def coarse(model: PlateModel, top: float) -> tuple[str, ...]:
    """What is to say of a mesh whose elements do not follow the waves at the top of the band.

    Args:
        model: as searched; its stiffest and lightest plate has the longest waves.
        top: the last line [Hz].
    """
    if model.mesh.extrapolate or top <= 0:
        return ()
    found = {key.rpartition(".")[2]: span for key, (_, span) in sizes(model).items()}
    wave = bending_wavelength(top, found["youngs_modulus"].high, 0.3, found["density"].low, found["thickness"].high)
    cells, sides = model.mesh.cells, (model.mesh.length_x, model.mesh.length_y)
    along = min(n * wave / side for n, side in zip(cells, sides, strict=True))
    if along >= COARSE:
        return ()
    finer = math.ceil(model.mesh.refine * ELEMENTS_PER_WAVELENGTH / along)
    return (
        f"mesh: {cells[0]} × {cells[1]} elements have {along:.2g} along a bending wave at {top:g} Hz, and it takes "
        f"{ELEMENTS_PER_WAVELENGTH:g} to follow one. Set mesh.refine: {finer}, which changes no node's number, or end "
        "the band below.",
    )


def _swinging(model: PlateModel, mass: Span) -> Iterator[Remark]:
    """Supports so soft that the plate swings slower on them than on the longest wires."""
    springs = {label: one for label, one in model.effects.items() if isinstance(one, SupportSpring)}
    if not springs or any(condition != "free" for condition in model.mesh.edges.values()):
        return
    ends = [model.values(end) for end in (model.space.low, model.space.high)]
    total = sum(float(ends[1][label]["stiffness"]) * len([*one.nodes, *one.at]) for label, one in springs.items())
    frequency = math.sqrt(total / mass.low) / (2 * math.pi)
    if not 0 < frequency < SLOWEST or any(isinstance(one, GroundSpring | EdgeSpring) for one in model.effects.values()):
        return
    label = next(iter(springs))
    span = Span(*(float(end[label]["stiffness"]) for end in ends))
    yield Remark(
        f"effects.{label}.stiffness",
        f"On {span} N/m the plate of {mass} kg swings at {frequency:.2g} Hz at most, as on wires "
        f"{GRAVITY / (2 * math.pi * frequency) ** 2:.0f} m long. If it is in N/mm, write "
        f"{span.times(1e3).as_written()}; of a free plate leave the supports out.",
    )


def _remedy(quantity: Quantity, span: Span) -> str:
    meant = [f"{unit} (write {span.times(factor).as_written()})" for unit, factor in quantity.meant(*span)[:2]]
    return f"It looks like {' or '.join(meant)}." if meant else f"Give it in {quantity.unit}."
