"""Whether the resonances of a test, and its level, are those of the plate that a model describes: before any search.

Steel's density beside aluminium's modulus, the thickness of another sheet: every number is a usual one, and no value in
the searched intervals brings the model to the test. One stretch of the bare plate's natural frequencies and one level
do, and tell which number it is.
"""

from typing import Final, NamedTuple

import torch

from torchplate.effects import (
    Absorber,
    EdgeSpring,
    Effect,
    GroundSpring,
    Orthotropy,
    RovingMass,
    Searched,
    SupportAsymmetry,
    SupportSpring,
)
from torchplate.identification.stretch import GRAINS, POWER, Stretch, coarse_cells, stretched
from torchplate.measurement import Measurement, Placement
from torchplate.model import PlateModel, Span, section_numbers
from torchplate.plate import Mesh

ENOUGH: Final = 0.5
"""Of the FRFs' variance in decibel that a model may leave, to be believed [-]: more is hardly better than none."""
FAR: Final = 1.3
"""On natural frequencies [-]. What plates have that their models have not, masses, soft edges, a fifth of the
thickness, moves them by less; steel's density in place of aluminium's by 1.7."""
LEVEL: Final = 1.6
"""On the level of FRFs [-]. Read off a model at its stretch it comes within 1.4; steel's density in place of
aluminium's is 2.9, a channel of twice its gain 2."""
ODDS: Final = 100.0
"""That the numbers of a config are its plate's, before its test is looked at [-]."""
MOVES: Final = frozenset({"section", "geometry", "mass", "stiffness"})
"""What an effect acts on where it moves natural frequencies."""
SWINGS: Final = (SupportSpring, SupportAsymmetry)
"""What a plate swings on, below where it bends."""
APART: Final = (EdgeSpring, GroundSpring, Absorber, RovingMass)
"""With these, natural frequencies do not all go with h√(E/ρ)."""


@torch.no_grad()
def another_plate(
    model: PlateModel, measurement: Measurement, places: Placement, gain_is_unknown: bool = False
) -> tuple[str, ...]:
    """What a test says of another plate than the model's, a sentence each; empty where it may be this one.

    Nothing is said of plates on elastic edges or with holes, nor of a test that no model of such a plate is near to.

    Args:
        model: as searched.
        measurement: cut to the band.
        places: where its channels are.
        gain_is_unknown: the level is fitted, and nothing is said of it.
    """
    found = _nearest(model, measurement, places)
    if found is None:
        return ()
    given = section_numbers(model)
    low, high = given.product
    level = None if gain_is_unknown else float(found.stretch.level[found.which])
    times = Span(found.measured / high, found.measured / low)
    if times.low > FAR or times.high < 1 / FAR:
        if found.odds(low / FAR, FAR * high) < ODDS:
            return ()
        return (
            f"The measured resonances lie at {times} times the model's, whatever the values in the intervals. "
            f"{given.would_fit(found.measured, level)}",
        )
    if level is None or 1 / LEVEL < level < LEVEL:
        return ()
    return (given.would_weigh(found.measured, level),)


class _Nearest(NamedTuple):
    """The model that is nearest to a test: which one of those that were tried, and its h√(E/ρ) [m²/s]."""

    stretch: Stretch
    which: int
    product: float

    @property
    def measured(self) -> float:
        """h√(E/ρ) by the test [m²/s]."""
        return self.product * float(self.stretch.factor[self.which])

    def odds(self, low: float, high: float) -> float:
        """How much likelier it is than the same model with an h√(E/ρ) in this range [-], by Gaussian residuals."""
        within = float(self.stretch.left_within(low / self.product, high / self.product)[self.which])
        return (within / float(self.stretch.left[self.which])) ** (0.5 * self.stretch.n_peak)


def _nearest(model: PlateModel, measurement: Measurement, places: Placement) -> _Nearest | None:
    """The plate itself, at the middle of the box, and where that is not near, one of wood of the same numbers."""
    effects = model.effects
    if measurement.kind not in POWER or model.mesh.cut or any(isinstance(one, APART) for one in effects.values()):
        return None
    bare = {label: one for label, one in effects.items() if one.acts_on & MOVES and not isinstance(one, SWINGS)}
    middle = model.as_dict(model.space.to_si(torch.full_like(model.space.low, 0.5)))
    found = _tried(model, bare, middle, measurement, places)
    if found is not None and float(found.stretch.left[found.which]) <= ENOUGH:
        return found
    grain = [label for label, one in bare.items() if isinstance(one, Orthotropy)]
    if found is None or any(f"{label}.young_ratio" not in model.names for label in grain):
        return None
    isotropic = {label: one for label, one in bare.items() if label not in grain}
    found = _tried(model, isotropic, middle, measurement, places, GRAINS)
    return found if found is not None and float(found.stretch.left[found.which]) <= ENOUGH else None


def _tried(
    model: PlateModel,
    effects: dict[str, Effect],
    values: dict[str, float],
    measurement: Measurement,
    places: Placement,
    grains: tuple[tuple[float, float], ...] = (),
) -> _Nearest | None:
    """Some of a model's effects with these values, and with each of some grains; None where the test tells nothing."""
    mesh = model.mesh
    known = {key: value for key, value in values.items() if key.rpartition(".")[0] in effects}
    searched = {}
    if grains:
        effects = effects | {"grain of wood": Orthotropy()}
        searched = {f"grain of wood.{name}": Searched(1e-2, 1e2) for name in Orthotropy.parameters}
    coarse = Mesh(mesh.length_x, mesh.length_y, *coarse_cells(mesh.length_x, mesh.length_y), edges=mesh.edges)
    tried = PlateModel(coarse, effects, known, searched)
    theta = torch.tensor(grains or ((),), dtype=torch.float64)
    stretch = stretched(tried, theta, measurement, places)
    if stretch is None:
        return None
    return _Nearest(stretch, int(stretch.left.argmin()), section_numbers(tried).product.low)
