"""A mass on a spring and a dashpot: a tuned absorber, a loose fitting, a cable end, somebody's forgotten magnet."""

from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative, unit_interval
from torchplate.plate import Local, Mesh, Sprung


@dataclass(frozen=True)
class Absorber(Effect):
    """A mass m that hangs on the plate by a spring k and a dashpot c: D(s) = s² m (k + sc) / (k + sc + s² m) there.

    Well below √(k/m) it is a point mass, well above it a spring and a dashpot to the ground; there it splits a peak in
    two. It adds a natural frequency, which is listed with the others. Loss factors of the whole model do not act on its
    spring, whose dashpot says its loss.
    """

    parameters = {
        "x": Parameter("-", "place along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y": Parameter("-", "place along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "mass": Parameter(
            "kg",
            "mass at the far end of the spring",
            nonnegative,
            neutral=0.0,
            prior=Prior(0.0, 0.1, relative_to="plate"),
        ),
        "stiffness": Parameter(
            "N/m",
            "of the spring between plate and mass",
            nonnegative,
            prior=Prior(0.1, 1e3, logarithmic=True, relative_to="plate"),
        ),
        "viscous_damping": Parameter(
            "N s/m",
            "of the dashpot beside the spring",
            nonnegative,
            # Up to a quarter of what is critical for the heaviest on the stiffest spring: rubber.
            prior=Prior(1e-4, 5.0, logarithmic=True, relative_to="plate"),
        ),
    }
    check = Check(1, "touch, tape down or take off what can move against the plate near the place found")
    acts_on = frozenset({"mass", "stiffness", "damping"})
    # On a rigid spring, and with a mass that stays where it is.
    contains = ("point_mass", "ground_spring", "ground_dashpot")
    shows = (
        "One more peak, and a dip between two where one was expected, near one frequency; far above and below hardly "
        "anything."
    )
    source = "Den Hartog, Mechanical Vibrations, 4th ed. (1956), section 3.2"

    def local(self, mesh: Mesh, value: Value) -> Local:
        """One sprung mass."""
        place = torch.stack(torch.broadcast_tensors(value["x"], value["y"]), dim=-1)
        own = (value[name][..., None] for name in ("mass", "stiffness", "viscous_damping"))
        return Local(mesh.deflection_at(place[..., None, :]), sprung=Sprung(*own))
