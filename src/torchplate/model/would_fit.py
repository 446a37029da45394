"""Which number of a plate would bring its resonances and its level to those of a test, and what material has it."""

from typing import Final, NamedTuple

from torchplate.effects import Plate
from torchplate.model.plate_model import PlateModel
from torchplate.model.usual_ranges import Span, plate_mass, sizes
from torchplate.plate import MATERIALS

NEAR: Final = 1.4
"""How near the level of FRFs comes where their modes overlap and their damping is guessed [-]."""
SLACK: Final = 1.05
"""Of a material's usual ranges [-]: callipers are 1 % off, and a coarse mesh as much."""


class SectionNumbers(NamedTuple):
    """The numbers of a model's plate, the lowest and the highest of each.

    Attributes:
        key: of the plate in a config.
        thickness: [m].
        youngs_modulus: [Pa].
        density: [kg/m³].
        mass: [kg].
    """

    key: str
    thickness: Span
    youngs_modulus: Span
    density: Span
    mass: Span

    @property
    def product(self) -> Span:
        """h√(E/ρ) [m²/s], which all natural frequencies go with."""
        return self.thickness.by(self.youngs_modulus.to_power(0.5)).by(self.density.to_power(-0.5))

    def would_fit(self, product: float, level: float | None = None) -> str:
        """Which number alone would have an h√(E/ρ), of those that would have a level, too.

        Args:
            product: by the resonances [m²/s].
            level: of the FRFs over the model's [-], which goes with one over hρ; None where it is not known.
        """
        squared = self.thickness.to_power(-2.0).times(product**2)
        density, modulus = self.youngs_modulus.by(squared.to_power(-1.0)), self.density.by(squared)
        thickness = self.density.to_power(0.5).by(self.youngs_modulus.to_power(-0.5)).times(product)
        found = (
            ("density", density, self.density.by(density.to_power(-1.0)), as_of(self.youngs_modulus, density)),
            ("youngs_modulus", modulus, Span(1.0, 1.0), as_of(modulus, self.density)),
            ("thickness", thickness, self.thickness.by(thickness.to_power(-1.0)), ""),
        )
        parts = [
            f"{self.key}.{name} {span}{material}"
            for name, span, levels, material in found
            if level is None or levels.low / NEAR < level < NEAR * levels.high
        ]
        if not parts:
            return "They go with thickness √(youngs_modulus / density) / side²: check these, and what holds the plate."
        too = "" if level is None else ", as the level would,"
        return f"They would fit{too} with {' or '.join(parts)}. Check these numbers and the sides, and weigh the plate."

    def would_weigh(self, product: float, level: float) -> str:
        """What a level says of the mass where the resonances are the plate's; arguments as for `would_fit`."""
        density = self.density.times(1 / level)
        modulus = density.by(self.thickness.to_power(-2.0)).times(product**2)
        material = as_of(*(Span(span.low / NEAR, NEAR * span.high) for span in (modulus, density)))
        return (
            f"The measured level is {level:.2g} times that of a plate of {self.mass} kg with these resonances: one of "
            f"{self.mass.times(1 / level)} kg would have it{material}. Weigh the plate, and correct its density; or "
            "correct the FRFs' unit or calibration, or set measurement.gain: unknown, and the level is fitted."
        )


def section_numbers(model: PlateModel) -> SectionNumbers:
    """Those of a model's plate."""
    found = {key: span for key, (_, span) in sizes(model).items()}
    key = f"effects.{next(label for label, one in model.effects.items() if isinstance(one, Plate))}"
    thickness, modulus, density = (found[f"{key}.{name}"] for name in ("thickness", "youngs_modulus", "density"))
    return SectionNumbers(key, thickness, modulus, density, plate_mass(model))


def as_of(modulus: Span, density: Span) -> str:
    """The materials that have such a modulus and such a density, in brackets; nothing where none has."""
    names = [
        one.name.replace("_", " ")
        for one in MATERIALS.values()
        if all(
            span.low <= SLACK * usual[2] and usual[0] <= SLACK * span.high
            for span, usual in ((modulus, one.youngs_modulus), (density, one.density))
        )
    ]
    return f" (as of {', '.join(names)})" if names else ""
