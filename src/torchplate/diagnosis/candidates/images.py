"""Mirror images of what sits at a place.

A plate that is turned over has the same natural frequencies: beside supports and sensors that hardly move them, each
image of a place is a minimum of its own, and only the sizes and signs of the peaks say which is right.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.model import PlateModel


def images(model: PlateModel, place: Float[Tensor, " n"], *labels: str) -> Float[Tensor, "n_image n"]:
    """Effects of a model mirrored together in every way, across the diagonal of a square too; themselves left out.

    Args:
        model: whose searched parameters these are.
        place: of these, on the unit cube.
        labels: of the effects; those that sit nowhere have no images.
    """
    names = {name: k for k, name in enumerate(model.names)}
    along, across = (
        [names[name] for label in labels for key in keys if (name := f"{label}.{key}") in names]
        for keys in (("x", "x0", "x1"), ("y", "y0", "y1"))
    )
    if not along or len(along) != len(across):
        return place.new_zeros(0, len(place))
    theta = model.space.to_si(place)
    found = []
    for swapped in (False, True) if model.mesh.length_x == model.mesh.length_y else (False,):
        for over_x, over_y in ((False, False), (True, False), (False, True), (True, True)):
            image = theta.clone()
            if swapped:
                image[along], image[across] = theta[across], theta[along]
            image[along] = 1 - image[along] if over_x else image[along]
            image[across] = 1 - image[across] if over_y else image[across]
            found.append(image)
    return model.space.to_cube(torch.stack(found[1:])).clamp(0.0, 1.0)
