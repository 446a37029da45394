"""Drive points: where a hit and a sensor are at one place, how much less gives way there than under a point force.

Under a force F at a point the deflection of a thin plate falls with the distance r from it, within a radius R, as

    w(0) − w(r) = F r² / (8πD) (ln (R / r) + ½),

which no expansion in the places of hit and sensor holds: its second derivative has no limit. A hit beside its mark, a
sensor beside its own, and a thickness within which a plate is no thin one make an FRF of a drive point stiffer by about
that, the same at all lines; FRFs between places apart do not have it.

Source: Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells (1959), § 19, a clamped circular plate under a
force at its middle.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.plate import Plan


def drive_points(
    plan: Plan,
    response: Float[Tensor, "n_response 2"],
    reference: Float[Tensor, "n_reference 2"],
    off: float,
) -> list[Float[Tensor, "n_response n_reference"]]:
    """What each drive point of a test may give way less than a point force makes it, one standard deviation [m/N].

    Args:
        plan: of the plate.
        response: marks of the sensors, relative to the sides.
        reference: marks of the hits, likewise.
        off: how far each may be from its mark, along each side [m].

    Returns:
        For each pair of a sensor and a hit whose marks are at one place, receptances that are zero but there; none in a
        test whose places are exact.
    """
    if off <= 0:
        return []
    section, geometry = plan.section, plan.geometry
    sides = torch.stack([geometry.length_x.mean(), geometry.length_y.mean()]).to(response)
    rigidity = section.rigidity.diagonal(dim1=-2, dim2=-1)[..., :2].prod(-1).sqrt().mean()
    # Both ends are off along both sides.
    near = math.sqrt(4 * off**2 + float(section.thickness.mean()) ** 2)
    less = near**2 / (8 * math.pi * float(rigidity)) * (math.log(max(float(sides.min()) / near, 1.0)) + 0.5)
    apart = ((response[:, None] - reference[None]) * sides).norm(dim=-1)
    found = []
    for j, r in (apart <= near).nonzero().tolist():
        change = torch.zeros_like(apart)
        change[j, r] = less
        found.append(change)
    return found
