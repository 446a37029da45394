"""A hole, a notch or a missing corner that nobody drew."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, unit_interval
from torchplate.plate import Mesh, Section, with_hole

# What is left of bending stiffness and mass where there is no plate: little enough not to be felt, and the mass so much
# less that what is left there has its natural frequencies ten times as high as a plate would.
STIFFNESS_LEFT, MASS_LEFT = 1e-6, 1e-8


@dataclass(frozen=True)
class CutOut(Effect):
    """A rectangle without plate: stiffness and mass of each element as far as it is not inside.

    The rectangle goes from one corner to the opposite one, in any order, its sides along those of the plate; where it
    reaches an edge it is a notch. What is inside is continuous in all four numbers, so all have a gradient. On lines of
    the mesh the hole is exact but for what is left of it, a 1e-6 of the stiffness and a 1e-8 of the mass; between them
    an element that is cut is stiff and heavy only where there is plate. Where the hole is known, `mesh.cut` leaves the
    elements out.
    """

    parameters = {
        "x0": Parameter("-", "one corner along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y0": Parameter("-", "one corner along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "x1": Parameter("-", "opposite corner along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y1": Parameter("-", "opposite corner along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
    }
    check = Check(1, "look at the plate: a hole, a notch, a missing corner")
    acts_on = frozenset({"section"})
    shows = "Modes that bend there sink and modes that merely move there rise, as mass and stiffness are gone together."
    source = "Parvizian, Düster and Rank, Finite cell method, Computational Mechanics 41 (2007), 121"

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """What is left of the bending and of the mass of each element."""
        corner = [torch.stack(torch.broadcast_tensors(*(value[f"{axis}{end}"] for end in "01"))) for axis in "xy"]
        over_x, over_y = (_sorted(pair) for pair in corner)
        return with_hole(section, mesh, over_x, over_y, (STIFFNESS_LEFT, MASS_LEFT))


def _sorted(pair: Tensor) -> tuple[Tensor, Tensor]:
    return pair.amin(0), pair.amax(0)
