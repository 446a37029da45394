"""A mass that rides on the plate: an accelerometer, a magnet, a bolt."""

from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative, unit_interval
from torchplate.plate import Local, Mesh


@dataclass(frozen=True)
class PointMass(Effect):
    """A mass at any place of the plate, through the shape functions: M gains m N Nᵀ there."""

    parameters = {
        "x": Parameter("-", "place along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y": Parameter("-", "place along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "mass": Parameter(
            "kg",
            "mass moving with the plate there",
            nonnegative,
            neutral=0.0,
            prior=Prior(0.0, 0.1, relative_to="plate"),
        ),
    }
    check = Check(1, "look for what is mounted at the place found, and weigh it")
    acts_on = frozenset({"mass"})
    shows = "Lowers every mode in proportion to its squared deflection there; a mode with a nodal line there stays."
    source = "Ewins, Modal Testing (2000), transducer mass loading"

    def local(self, mesh: Mesh, value: Value) -> Local:
        """One mass term."""
        place = torch.stack(torch.broadcast_tensors(value["x"], value["y"]), dim=-1)
        return Local(mesh.deflection_at(place[..., None, :]), mass=value["mass"][..., None])
