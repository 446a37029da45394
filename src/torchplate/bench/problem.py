"""The paper's plate (Tables 1 and 3), and the members and lines at which it is timed."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

N_MEMBER = 32
LINES = torch.arange(1, 801, dtype=torch.float64) * 0.5
RESPONSE, REFERENCE = [3], [28, 102, 104, 33, 61, 118]
KNOWN = {"plate.poisson_ratio": 0.3, "plate.density": 7860.0, "plate.thickness": 0.0027}
SEARCHED = {
    "plate.youngs_modulus": Searched(150e9, 260e9),
    "wires.stiffness": Searched(700.0, 2000.0),
    "wires.viscous_damping": Searched(0.2, 1.5),
    "loss.stiffness_loss_factor": Searched(9e-8, 9e-3),
}
# Table 4.
TRUTH = (196e9, 1180.0, 0.6, 4e-3)


def paper_model(n_element: int = 10, bent: bool = False, n_reference: int = 6, n_response: int = 1) -> PlateModel:
    """The plate on its wires.

    Args:
        n_element: elements along each side; places stay where they are.
        bent: whether Poisson's ratio is searched too, so that the members share no modes.
        n_reference: of the paper's six, or more places.
        n_response: of the paper's one, or more places.
    """
    grid = Mesh(0.48, 0.48, 10, 10)
    more = [label for label in range(13, 110) if label % 11 not in (0, 1)]
    wires, response, reference = (
        [tuple(place) for place in grid.places(labels).tolist()]
        for labels in ([2, 10, 112, 120], (RESPONSE + more)[:n_response], (REFERENCE + more[::-1])[:n_reference])
    )
    effects = {"plate": Plate(), "wires": SupportSpring(at=wires), "loss": HystereticDamping()}
    known, searched = dict(KNOWN), dict(SEARCHED)
    if bent:
        known.pop("plate.poisson_ratio")
        searched["plate.poisson_ratio"] = Searched(0.28, 0.32)
    mesh = Mesh(0.48, 0.48, n_element, n_element)
    return PlateModel(mesh, effects, known, searched, response, reference, "accelerance")


def members(model: PlateModel, n: int = N_MEMBER, seed: int = 0) -> Float[Tensor, "n_member n_parameter"]:
    """Members drawn evenly over the box."""
    generator = torch.Generator().manual_seed(seed)
    return model.space.to_si(torch.rand(n, len(model.names), dtype=torch.float64, generator=generator))
