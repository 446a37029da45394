"""The seed paper's plate: Table 4's values beside the printed frequencies of Table 5."""

import pytest
import torch

from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

# Mode number, counted from 1 → the updated model's frequency [Hz].
UPDATED = {
    1: 4.8,
    2: 6.8,
    3: 8.5,
    6: 68.4,
    10: 171.4,
    11: 178.4,
    12: 193.6,
    14: 292.8,
    15: 293.9,
    16: 327.0,
    17: 343.7,
    18: 364.7,
    19: 368.4,
}


@pytest.fixture(scope="module")
def paper() -> PlateModel:
    """Table 1, searched over the intervals of Table 3."""
    return PlateModel(
        Mesh(0.48, 0.48, 10, 10),
        {
            "plate": Plate(),
            "wires": SupportSpring(nodes=[2, 10, 112, 120]),
            "loss": HystereticDamping(),
        },
        {"plate.poisson_ratio": 0.3, "plate.density": 7860.0, "plate.thickness": 0.0027},
        {
            "plate.youngs_modulus": Searched(150e9, 260e9),
            "wires.stiffness": Searched(700.0, 2000.0),
            "wires.viscous_damping": Searched(0.2, 1.5),
            "loss.stiffness_loss_factor": Searched(9e-8, 9e-3),
        },
        response=[3],
        reference=[28, 102, 104],
        kind="accelerance",
    )


UPDATED_VALUES = [194.331e9, 1171.571, 1.5, 9e-3]


def test_the_updated_plate_vibrates_at_the_printed_frequencies(paper: PlateModel) -> None:
    found = paper.natural_frequencies(torch.tensor(UPDATED_VALUES, dtype=torch.float64)).tolist()
    # Independent assemblies of the same element differ from the printed column by up to 1.2 %, and the lowest are
    # printed to two digits only.
    for mode, printed in UPDATED.items():
        assert found[mode - 1] == pytest.approx(printed, rel=0.012), f"mode {mode}"


def test_the_updated_dampings_sit_on_the_edge_of_their_intervals(paper: PlateModel) -> None:
    at_bound = paper.space.at_bound(torch.tensor(UPDATED_VALUES, dtype=torch.float64))
    assert dict(zip(paper.names, at_bound.tolist(), strict=True)) == {
        "plate.youngs_modulus": False,
        "wires.stiffness": False,
        "wires.viscous_damping": True,
        "loss.stiffness_loss_factor": True,
    }


def test_the_modal_diagonal_of_the_wires_dashpots_would_not_do(paper: PlateModel, relative_error) -> None:
    theta = torch.tensor(UPDATED_VALUES, dtype=torch.float64)
    frequency = torch.arange(1.0, 400.5, 7.5, dtype=torch.float64)
    exact = paper.frf_direct(theta, frequency)
    assert relative_error(paper.frf(theta, frequency), exact) < 1e-8
    system, modes = paper.system(theta), paper.modes(theta)
    row = paper.assembly.rows(paper.mesh.deflection_at(paper.mesh.places([3, 28, 102, 104]))) @ modes.shape
    dashpot = (system.viscous[:, None] * (system.dashpot @ modes.shape) ** 2).sum(0)
    omega = 2 * torch.pi * frequency[:, None]
    denominator = modes.eigenvalue * (1 + 9e-3j) - omega**2 + 1j * omega * dashpot
    diagonal = -(omega[..., None] ** 2) * torch.einsum("fm,im,jm->fij", 1 / denominator, row[:1] + 0j, row[1:] + 0j)
    # What the low-rank correction is for: measured 1.2 % on these lines.
    assert relative_error(diagonal, exact) > 5e-3
