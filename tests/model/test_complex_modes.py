"""Where a part of the plate has a loss of its own, the complex modes say what solves at each line say."""

import pytest
import torch

from torchplate.effects import DampingPatch, ExponentialWindow, HystereticDamping, Plate, SupportSpring, ViscousDamping
from torchplate.model import PlateModel, Searched
from torchplate.model.receptance import modal_receptance
from torchplate.model.receptance.complex_modes import complex_modes
from torchplate.plate import Mesh

KNOWN = {
    "plate.poisson_ratio": 0.31,
    "plate.density": 2710.0,
    "plate.thickness": 0.003,
    "wires.stiffness": 1800.0,
    "loss.stiffness_loss_factor": 4e-3,
    "loss.mass_loss_factor": 30.0,
    "air.mass_coefficient": 1.7,
    "patch.x": 0.31,
    "patch.y": 0.64,
    "patch.size": 0.37,
    "window.rate": 2.3,
}
SEARCHED = {
    "plate.youngs_modulus": Searched(5e10, 9e10),
    "wires.viscous_damping": Searched(0.0, 20.0),
    "patch.loss_factor": Searched(0.0, 0.5),
}
LINES = torch.linspace(8.0, 330.0, 23, dtype=torch.float64)
# Young's modulus, a dashpot about the plate's own impedance, a loss that couples the modes.
MEMBERS = torch.tensor([[6.9e10, 9.0, 0.31], [7.4e10, 0.4, 0.02], [6.1e10, 17.0, 0.45]], dtype=torch.float64)
MESHES = {"rectangle": Mesh(0.5, 0.33, 4, 3), "square": Mesh(0.4, 0.4, 4, 4)}


def build(mesh: Mesh, rayleigh: float = 0.0) -> PlateModel:
    effects = {
        "plate": Plate(),
        "wires": SupportSpring(nodes=(2, 9, 14)),
        "loss": HystereticDamping(),
        "air": ViscousDamping(),
        "patch": DampingPatch(),
        "window": ExponentialWindow(),
    }
    known = KNOWN | {"air.stiffness_coefficient": rayleigh}
    return PlateModel(mesh, effects, known, SEARCHED, [3, (0.61, 0.77)], [8, (0.13, 0.24)], "accelerance")


@pytest.fixture
def asked(monkeypatch):
    """How often the complex modes were asked."""
    calls = []
    inner = modal_receptance._by_complex_modes
    monkeypatch.setattr(modal_receptance, "_by_complex_modes", lambda *given: calls.append(1) or inner(*given))
    return calls


@pytest.mark.parametrize("mesh", MESHES)
def test_they_are_the_direct_solves(asked, relative_error, mesh):
    model = build(MESHES[mesh])
    with torch.no_grad():
        found = model.frf(MEMBERS, LINES)
        alone = model.frf(MEMBERS[0], LINES)
    assert len(asked) == 2
    # Complex modes of a plate whose loss is a half here and nothing there are still well conditioned.
    assert relative_error(found, model.frf_direct(MEMBERS, LINES)) < 1e-8
    assert torch.allclose(alone, found[0], rtol=1e-8)


def test_damping_that_grows_with_frequency_is_solved_line_by_line(asked, relative_error):
    model = build(MESHES["rectangle"], rayleigh=2e-5)
    with torch.no_grad():
        found = model.frf(MEMBERS, LINES)
    assert not asked
    assert relative_error(found, model.frf_direct(MEMBERS, LINES)) < 1e-8


@pytest.mark.parametrize("mesh", MESHES)
def test_gradients_are_those_of_the_direct_solves(mesh):
    model = build(MESHES[mesh])
    weight = torch.linspace(-1.0, 1.3, 23 * 4, dtype=torch.float64).reshape(23, 2, 2)
    slopes = []
    for evaluate in (model.frf, model.frf_direct):
        theta = MEMBERS[0].clone().requires_grad_()
        found = evaluate(theta, LINES)
        (weight * (found.real + 0.7 * found.imag)).sum().backward()
        slopes.append(theta.grad)
    assert torch.allclose(*slopes, rtol=1e-7, atol=0)
    # And of what the complex modes themselves say.
    for index, slope in enumerate(slopes[0].tolist()):
        step = torch.zeros_like(MEMBERS[0])
        step[index] = 1e-5 * MEMBERS[0, index]
        with torch.no_grad():
            ends = [model.frf(MEMBERS[0] + sign * step, LINES) for sign in (1, -1)]
        change = [float((weight * (end.real + 0.7 * end.imag)).sum()) for end in ends]
        # Rounding of the difference, and its third derivative.
        assert (change[0] - change[1]) / (2 * float(step[index])) == pytest.approx(slope, rel=1e-5)


@pytest.fixture
def solved(monkeypatch):
    """How many matrices complex modes were solved for."""
    numbers = []
    inner = torch.linalg.eig

    def counted(matrix):
        numbers.append(matrix[..., 0, 0].numel())
        return inner(matrix)

    monkeypatch.setattr(torch.linalg, "eig", counted)
    return numbers


@pytest.mark.parametrize("mesh", MESHES)
def test_members_a_step_of_differences_apart_share_one_solution(solved, relative_error, mesh):
    model = build(MESHES[mesh])
    steps = 1e-8 * torch.tensor([7e10, 20.0, 0.5], dtype=torch.float64)
    members = torch.cat([MEMBERS[:1], MEMBERS[:1] + torch.diag(steps)])
    with torch.no_grad():
        together = model.frf(members, LINES)
        n_together = sum(solved)
        alone = torch.stack([model.frf(member, LINES) for member in members])
    assert n_together == 1
    assert relative_error(together, alone) < 1e-11
    # The derivative by differences is that of solutions of their own, to what rounding leaves of a step of 1e-8.
    slope, own = (found[1:] - found[:1] for found in (together, alone))
    assert relative_error(slope, own) < 1e-3


def test_members_far_apart_are_solved_for_alone(solved):
    with torch.no_grad():
        build(MESHES["rectangle"]).frf(MEMBERS, LINES)
    assert sum(solved) == len(MEMBERS)


@pytest.mark.parametrize("part", [1e-9, 1e-6, 1e-3])
def test_what_is_found_from_a_neighbour_are_eigenvectors(part):
    generator = torch.Generator().manual_seed(3)
    square = torch.linspace(2.0, 9.0, 12, dtype=torch.float64).pow(4)
    loss = 0.1 * torch.rand(2, 12, 12, generator=generator, dtype=torch.float64) * (square[:, None] * square).sqrt()
    loss = loss + loss.mT
    matrix = torch.diag_embed(square * (1 + 0.01j)) + 1j * torch.stack([loss[0], loss[0] + part * loss[1]])
    value, shape, inverse = complex_modes(matrix)
    assert (shape @ torch.diag_embed(value) @ inverse - matrix).abs().max() < 1e-12 * matrix.abs().max()
    assert (shape @ inverse - torch.eye(12)).abs().max() < 1e-12
