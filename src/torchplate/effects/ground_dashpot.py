"""A dashpot from the plate to the ground that nobody drew: friction at a stinger, a cable, a damper."""

from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative, unit_interval
from torchplate.plate import Local, Mesh


@dataclass(frozen=True)
class GroundDashpot(Effect):
    """A dashpot at any place, through the shape functions: Z(ω) gains iωc N Nᵀ, so 1/α of that point grows by iωc."""

    parameters = {
        "x": Parameter("-", "place along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y": Parameter("-", "place along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "viscous_damping": Parameter(
            "N s/m",
            "dashpot to the ground there",
            nonnegative,
            neutral=0.0,
            prior=Prior(1e-4, 10.0, logarithmic=True, relative_to="plate"),
        ),
    }
    check = Check(2, "look for what touches the plate at the place found, and test without it")
    acts_on = frozenset({"damping"})
    to_ground = "viscous_damping"
    shows = (
        "Widens every mode that moves there by the same number of hertz per φ²; a mode with a nodal line there stays."
    )
    source = "Bishop and Johnson, The Mechanics of Vibration (1960)"

    def local(self, mesh: Mesh, value: Value) -> Local:
        """One dashpot term."""
        place = torch.stack(torch.broadcast_tensors(value["x"], value["y"]), dim=-1)
        return Local(mesh.deflection_at(place[..., None, :]), viscous=value["viscous_damping"][..., None])
