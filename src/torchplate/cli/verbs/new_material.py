"""What the resonances of a test say of a plate whose material or thickness nobody told."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch

from torchplate.effects import Searched, find_effect
from torchplate.identification import GRAINS, coarse_cells, stretched
from torchplate.measurement import METRES, Measurement, Proposal, peaks, place
from torchplate.model import PlateModel
from torchplate.notation import percent
from torchplate.plate import MATERIALS, Material, Mesh, thickness_of

UNKNOWN = Material(
    "unknown material", (0.5e9, 20e9, 260e9), 0.3, 0.05, (500.0, 2700.0, 9000.0), (1e-4, 1e-1), "none named"
)
WOOD: Final = MATERIALS["wood"]
ODDS: Final = 10.0
"""Wood has to be so many times likelier than an isotropic plate [-]; where the density is that of wood, likelier."""
ENOUGH: Final = 0.5
"""Of the FRFs' variance in decibel that a model may leave, to be believed [-]: more is hardly better than none."""
THICKNESS: Final = 1e-3
"""Of the models that are tried [m]: natural frequencies go with it."""
FAR: Final = 0.4
"""Of natural frequencies [-]: points keep no margin of more than a third of a side from the edges."""
ROUGHLY: Final = 1.4
"""How near a factor on natural frequencies comes to that of a unit [-], of points that keep a margin of a tenth of a
side and a plate whose thickness is a fifth off."""
SLACK: Final = 1.05
"""Of √(E/ρ) squared and of ρ beyond the usual ranges [-]: callipers are 1 % off, and a coarse mesh as much."""


@dataclass(frozen=True)
class Heard:
    """What was heard of the plate.

    Attributes:
        material: As named; wood where the resonances are those of wood; else unknown.
        said: What the resonances say of a material that was not named; empty where they say nothing.
        young_ratio: E_y/E_x [-]; 1 of an isotropic plate.
        shear_factor: G over its isotropic value [-], by the resonances; None where they say nothing of the grain.
        thickness: Low, taken, high [m], with the material's usual numbers; all alike where given.
        by: What the thickness is from.
        sides: What the resonances say of sides that were guessed, where they are others; else empty.
    """

    material: Material
    said: str
    young_ratio: float
    shear_factor: float | None
    thickness: tuple[float, float, float]
    by: str
    sides: str = ""


class _Nearest(NamedTuple):
    """The model of a material that is nearest to a test: see `Stretch`."""

    material: Material
    young_ratio: float
    shear_factor: float
    factor: float
    left: float
    n_peak: int


def heard(
    measurement: Measurement,
    proposal: Proposal,
    edges: Mapping[str, str],
    named: Material | None,
    thickness: float | None,
    mass: float | None,
) -> Heard:
    """Take the material and the thickness from the resonances where they were not told.

    Args:
        measurement: In the plate's own axes.
        proposal: The plate's sides.
        edges: That are held.
        named: The material, if it was named.
        thickness: [m], if it was given.
        mass: Of the plate [kg], if it was given.
    """
    sides = proposal.length_x, proposal.length_y
    material = named or UNKNOWN
    given = None if thickness is None else (thickness,) * 3
    if named is not None and named.young_ratio == 1 and given is not None:
        guessed = _nearest(measurement, sides, edges, named) if proposal.sides.guess else None
        return Heard(named, "", 1.0, None, given, "given", _other_sides(guessed, proposal, given[1]))
    plate = _nearest(measurement, sides, edges, material)
    wood = None if named is not None else _nearest(measurement, sides, edges, WOOD)
    density = None if mass is None or thickness is None else mass / (sides[0] * sides[1] * thickness)
    said = ""
    if plate is not None and wood is not None and _is_wood(wood, plate, density):
        along = "x" if wood.young_ratio < 1 else "y"
        said = (
            f"the resonances are those of wood with its grain along {along}, which leaves {percent(wood.left, 2)} of "
            f"the FRFs' variance in decibel, an isotropic plate {percent(plate.left, 2)}"
        )
        plate = wood
    if plate is None or plate.left > ENOUGH:
        # The longer side is along the grain, where nothing better is known.
        usual = 1 / material.young_ratio if sides[0] >= sides[1] else material.young_ratio
        by_number = _by_number(measurement, sides, material)
        return Heard(material, "", usual, None, given or by_number, "given" if given else "the number of peaks")
    grain = plate.young_ratio, plate.shear_factor if plate.material.young_ratio > 1 else None
    if given is not None:
        if named is None and not said:
            said = _likely(plate, given[1], density)
        return Heard(plate.material, said, *grain, given, "given")
    taken = float(f"{plate.factor * THICKNESS:.2g}")
    return Heard(plate.material, said, *grain, (taken / 2, taken, 2 * taken), "the resonances")


def _nearest(
    measurement: Measurement, sides: tuple[float, float], edges: Mapping[str, str], material: Material
) -> _Nearest | None:
    """The nearest of a material's models, by its usual numbers and `THICKNESS`."""
    known = {
        "plate.youngs_modulus": material.youngs_modulus[1],
        "plate.poisson_ratio": material.poisson_ratio,
        "plate.density": material.density[1],
        "plate.thickness": THICKNESS,
    }
    grains = GRAINS if material.young_ratio > 1 else ((1.0, 1.0),)
    model = PlateModel(
        Mesh(*sides, *coarse_cells(*sides), edges=dict(edges)),
        {"plate": find_effect("plate")(), "grain": find_effect("orthotropy")()},
        known,
        {"grain.young_ratio": Searched(0.01, 100.0), "grain.shear_factor": Searched(0.1, 10.0)},
    )
    found = stretched(model, torch.tensor(grains, dtype=torch.float64), measurement, place(measurement, *sides, 4, 4))
    if found is None:
        return None
    best = int(found.left.argmin())
    return _Nearest(material, *grains[best], float(found.factor[best]), float(found.left[best]), found.n_peak)


def _is_wood(wood: _Nearest, plate: _Nearest, density: float | None) -> bool:
    """Whether wood is likelier, by Schwarz's criterion: as many data as peaks, two numbers more."""
    gain = wood.n_peak * math.log(plate.left / wood.left) - 2 * math.log(wood.n_peak)
    of_wood = density is not None and WOOD.density[0] <= density <= WOOD.density[2]
    return wood.left <= ENOUGH and gain > 2 * math.log(1.0 if of_wood else ODDS)


def _other_sides(plate: _Nearest | None, proposal: Proposal, thickness: float) -> str:
    """Where no number of the material brings the resonances to guessed sides: the sides or the unit that would."""
    if plate is None or plate.left > ENOUGH or _has(plate.material, _squared(plate, thickness)):
        return ""
    ratio, sides = plate.factor * THICKNESS / thickness, (proposal.length_x, proposal.length_y)
    remedy = _other_unit(ratio, proposal) or "check the sides (--length), --thickness and --material"
    if FAR < ratio < 1:
        # Natural frequencies of a plate with another margin go about with one over its area.
        half = sum(sides) / 4
        margin = math.sqrt(half**2 + sides[0] * sides[1] * (1 / ratio - 1) / 4) - half
        larger = " × ".join(f"{side + 2 * margin:.3g}" for side in sides)
        remedy = (
            f"with one margin around these points it would have some {larger} m. Measure the sides and give --length, "
            "or check --thickness and --material"
        )
    return f"the resonances lie at {ratio:.2g} of those of such a plate of {sides[0]:g} × {sides[1]:g} m: {remedy}"


def _other_unit(ratio: float, proposal: Proposal) -> str:
    """The unit of coordinates or frequencies that a factor on all natural frequencies speaks for, and what to do."""
    own = METRES[proposal.frame.unit]
    for unit, metres in METRES.items():
        # Natural frequencies go with one over the sides squared.
        if unit != proposal.frame.unit and abs(math.log(ratio * (metres / own) ** 2)) < math.log(ROUGHLY):
            sides = " × ".join(f"{side * metres / own:.3g}" for side in (proposal.length_x, proposal.length_y))
            return f"in {unit} it would have {sides} m: give --unit {unit}, or --length"
    for factor, unit in ((1e-3, "kHz"), (2 * math.pi, "rad/s")):
        if abs(math.log(ratio / factor)) < math.log(ROUGHLY):
            return f"the frequency axis looks like {unit} that are taken for Hz: correct it, or its label in the file"
    return ""


def _squared(plate: _Nearest, thickness: float) -> float:
    """E/ρ [m²/s²] that the resonances give a plate of this thickness."""
    usual = plate.material.youngs_modulus[1] / plate.material.density[1]
    return (plate.factor * THICKNESS / thickness) ** 2 * usual


def _has(material: Material, squared: float) -> bool:
    """Whether this E/ρ is a usual one."""
    low, high = (material.youngs_modulus[end] / material.density[2 - end] for end in (0, 2))
    return low <= SLACK * squared and squared <= SLACK * high


def _likely(plate: _Nearest, thickness: float, density: float | None) -> str:
    """The materials whose √(E/ρ) the resonances have, and whose density the mass gives."""
    squared = _squared(plate, thickness)
    names = [
        one.name
        for one in MATERIALS.values()
        if one.young_ratio == 1
        and _has(one, squared)
        and (density is None or one.density[0] / SLACK <= density <= SLACK * one.density[2])
    ]
    return f"√(E/ρ) is near {math.sqrt(squared):.3g} m/s" + (f", as in {', '.join(names)}" if names else "")


def _by_number(measurement: Measurement, sides: tuple[float, float], material: Material) -> tuple[float, float, float]:
    """Thickness by the number of peaks: low, taken, high [m]."""
    area = sides[0] * sides[1]
    seen = max(len(peaks(measurement)), 1) / float(measurement.frequency[-1])
    guess = thickness_of(area, seen, material.youngs_modulus[1], material.poisson_ratio, material.density[1])
    guess = min(guess, 0.05 * math.sqrt(area))
    # Some modes show no peak of their own, so the plate is rather thinner than that.
    return float(f"{guess / 6:.2g}"), float(f"{guess / 2:.2g}"), float(f"{1.5 * guess:.2g}")
