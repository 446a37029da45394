"""A response sensor that does not sit where the test sheet says."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, SensorChain, Value
from torchplate.effects.parameter import Parameter, Prior
from torchplate.plate import Geometry, Mesh


@dataclass(frozen=True)
class SensorPosition(Effect):
    """The reading is w(x + dx, y + dy): shape functions at the place (x + dx/Lx, y + dy/Ly); the force stays.

    Args:
        response: node label or relative place [x, y] of the one sensor meant; left out, all are moved alike.
    """

    response: int | Sequence[float] | None = None

    parameters = {
        "dx": Parameter(
            "m", "how far along x the sensor sits off", neutral=0.0, prior=Prior(-0.1, 0.1, relative_to="plate")
        ),
        "dy": Parameter(
            "m", "how far along y the sensor sits off", neutral=0.0, prior=Prior(-0.1, 0.1, relative_to="plate")
        ),
    }
    check = Check(1, "measure with a ruler where the sensor sits")
    acts_on = frozenset({"sensor chain"})
    shows = (
        "Frequencies stay, while the levels of the modes change by the ratio of their deflections; antiresonances move."
    )
    source = (
        "seed paper, Eq. 15–16; Ewins, Modal Testing (2000), section 2.4: the modal constant is φ_response φ_reference"
    )

    def observe(self, mesh: Mesh, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """Responses at other places."""
        offset = torch.broadcast_tensors(value["dx"] / geometry.length_x, value["dy"] / geometry.length_y)
        moved = torch.stack(offset, dim=-1)[..., None, :]
        if self.response is not None:
            moved = moved * chain.at_response(mesh, self.response).to(moved)[:, None]
        return chain._replace(response=chain.response + moved)
