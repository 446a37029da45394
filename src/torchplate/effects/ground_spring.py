"""A spring from the plate to the ground that nobody drew: a stinger, a cable under tension, a support too many."""

from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative, unit_interval
from torchplate.plate import Local, Mesh


@dataclass(frozen=True)
class GroundSpring(Effect):
    """A spring at any place, through the shape functions: K gains k N Nᵀ there, so 1/α of that point grows by k."""

    parameters = {
        "x": Parameter("-", "place along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y": Parameter("-", "place along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "stiffness": Parameter(
            "N/m",
            "stiffness to the ground there",
            nonnegative,
            neutral=0.0,
            prior=Prior(0.03, 1e3, logarithmic=True, relative_to="plate"),
        ),
    }
    check = Check(2, "look for what touches the plate at the place found, and test without it")
    acts_on = frozenset({"stiffness"})
    to_ground = "stiffness"
    shows = (
        "Lifts every mode that moves there, low modes most since ω² grows by kφ²; a mode with a nodal line there stays."
    )
    source = "Bishop and Johnson, The Mechanics of Vibration (1960)"

    def local(self, mesh: Mesh, value: Value) -> Local:
        """One spring term."""
        place = torch.stack(torch.broadcast_tensors(value["x"], value["y"]), dim=-1)
        return Local(mesh.deflection_at(place[..., None, :]), stiffness=value["stiffness"][..., None])
