"""A plate that is longer and narrower, or shorter and wider, than the drawing says."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, positive
from torchplate.plate import Geometry


@dataclass(frozen=True)
class AspectRatio(Effect):
    """Sides Lx/√r and Ly √r, r = (Ly/Lx) over nominal: the area is kept, and nodes stay at their relative places."""

    parameters = {"ratio": Parameter("-", "Ly/Lx over its nominal value", positive, neutral=1.0, prior=Prior(0.9, 1.1))}
    check = Check(1, "measure both sides with a ruler, to 0.5 mm")
    acts_on = frozenset({"geometry"})
    shows = (
        "Modes that bend along x move one way and those along y the other; twist and equally bent modes hardly move."
    )
    source = "Leissa, Vibration of Plates, NASA SP-160 (1969), chapter 4"

    def geometry(self, geometry: Geometry, value: Value) -> Geometry:
        """One side shrinks as the other grows."""
        root = value["ratio"].sqrt()
        return Geometry(geometry.length_x / root, geometry.length_y * root)
