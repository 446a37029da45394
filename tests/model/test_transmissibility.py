"""Motion over the motion of the held edges, against a solve with the edges' motion prescribed."""

import numpy as np
import pytest
import torch

from torchplate.model import Searched
from torchplate.plate import Mesh

SIDES, CELLS = (0.7, 0.4), (4, 3)
EDGES = {
    "cantilever": {"x0": "clamped"},
    "two edges": {"x1": "clamped", "y0": "simply_supported"},
}
POINTS = [9, 13, (0.71, 0.63)]


def prescribed(plates, known: dict[str, float], edges: dict[str, str], frequency: torch.Tensor) -> torch.Tensor:
    """u_f = −Z_ff⁻¹ Z_fc u_c in absolute motion, from the free plate's matrices; grounds ride on the base.

    A spring or dashpot to the ground that moves with the base pulls with its stiffness times the base's motion.
    """
    free_plate = plates.build(Mesh(*SIDES, *CELLS), known, loss_field=True)
    held_mesh = Mesh(*SIDES, *CELLS, edges=edges)
    system = free_plate.system(plates.nothing)
    free = held_mesh.free_dof.numpy()
    held = np.setdiff1d(np.arange(held_mesh.n_dof), free)
    base = held_mesh.rigid_translation.numpy()
    beta, b = float(system.proportional.stiffness_loss_factor), float(system.proportional.stiffness_coefficient)
    stiffness, mass, hysteretic = (matrix.numpy() for matrix in (system.stiffness, system.mass, system.hysteretic))
    dashpot, viscous = system.dashpot.numpy(), system.viscous.numpy()
    wires = dashpot.T @ dashpot * known["wires.stiffness"]
    dashpots = dashpot.T @ (viscous[:, None] * dashpot)
    row = held_mesh.deflection_at(held_mesh.places(POINTS)).numpy()[:, free]
    found = []
    for line in frequency.tolist():
        omega = 2 * np.pi * line
        impedance = stiffness * (1 + 1j * beta + 1j * omega * b) + 1j * hysteretic + 1j * omega * dashpots
        impedance = impedance - omega**2 * mass
        pull = (wires * (1 + 1j * beta + 1j * omega * b) + 1j * omega * dashpots) @ base
        force = pull[free] - impedance[np.ix_(free, held)] @ base[held]
        found.append(row @ np.linalg.solve(impedance[np.ix_(free, free)], force))
    return torch.from_numpy(np.array(found))[..., None]


def known_values(plates) -> dict[str, float]:
    """Damping that strain makes; damping in proportion to the mass has no meaning on a moving base."""
    damping = plates.damping_of_every_kind(Mesh(*SIDES, *CELLS))
    return {
        **{key: damping[key] for key in ("wires.viscous_damping", "loss.stiffness_loss_factor")},
        "rayleigh.stiffness_coefficient": damping["rayleigh.stiffness_coefficient"],
        "wires.stiffness": 3e3,
        "lump.mass": 0.2,
        "field.base": 0.01,
    }


@pytest.mark.parametrize("name", list(EDGES))
def test_transmissibility_is_the_motion_over_that_of_the_held_edges(plates, relative_error, name: str) -> None:
    known, mesh = known_values(plates), Mesh(*SIDES, *CELLS, edges=EDGES[name])
    model = plates.build(mesh, known, loss_field=True, kind="transmissibility", response=POINTS)
    frequency = torch.linspace(0.05, 8.0, 23, dtype=torch.float64) * plates.first_bending(mesh)
    expected = prescribed(plates, known, EDGES[name], frequency)
    found = model.frf(plates.nothing, frequency)
    assert found.shape == (23, 3, 1)
    # Rounding at the scale of the highest eigenvalue.
    assert relative_error(found, expected) < 1e-9
    assert relative_error(model.frf_direct(plates.nothing, frequency), expected) < 1e-9


@pytest.mark.parametrize("name", list(EDGES))
def test_the_plate_follows_its_held_edges_when_they_move_slowly(plates, name: str) -> None:
    mesh = Mesh(*SIDES, *CELLS, edges=EDGES[name])
    model = plates.build(mesh, known_values(plates), loss_field=True, kind="transmissibility", response=POINTS)
    first = model.natural_frequencies(plates.nothing, n_mode=1).item()
    found = model.frf(plates.nothing, torch.tensor([0.0, 1e-3 * first], dtype=torch.float64))
    # 0 Hz stands for 1e-9 Hz, whose lag is below rounding.
    assert float((found[0] - 1).abs().max()) < 1e-15
    # What it lags by is (f/f₁)², here 1e-6, times a participation factor below two.
    assert 0 < (found[1] - 1).abs().max() < 3e-6


def test_of_no_member_or_no_line_it_has_one_column_all_the_same(plates) -> None:
    mesh = Mesh(*SIDES, *CELLS, edges={"x0": "clamped"})
    box = {"plate.youngs_modulus": Searched(6e10, 8e10)}
    model = plates.build(mesh, {}, box, kind="transmissibility", response=POINTS)
    frequency = torch.tensor([11.0, 29.0], dtype=torch.float64)
    theta = torch.tensor([[7e10]], dtype=torch.float64)
    assert model.frf(theta, frequency).shape == (1, 2, 3, 1)
    assert model.frf(theta[:0], frequency).shape == (0, 2, 3, 1)
    assert model.frf(theta, frequency[:0]).shape == (1, 0, 3, 1)


def test_a_point_on_a_held_edge_moves_with_it(plates) -> None:
    mesh = Mesh(*SIDES, *CELLS, edges={"x0": "clamped"})
    model = plates.build(mesh, known_values(plates), loss_field=True)
    frequency = torch.linspace(0.5, 8.0, 5, dtype=torch.float64) * plates.first_bending(mesh)
    found = model.frf(plates.nothing, frequency, [1, 6, (0.0, 0.4)], kind="transmissibility")
    # Its row over the free dofs is zero.
    torch.testing.assert_close(found, torch.ones_like(found), rtol=0, atol=1e-12)


def test_a_cantilevers_tip_resonates_at_its_natural_frequency(plates) -> None:
    mesh = Mesh(*SIDES, *CELLS, edges={"x0": "clamped"})
    model = plates.build(mesh, {"loss.stiffness_loss_factor": 0.01}, kind="transmissibility", response=[(1.0, 0.5)])
    first = model.natural_frequencies(plates.nothing, n_mode=1)
    found = model.frf(plates.nothing, first)
    # At ω₁ the first mode answers Γ₁ φ₁ / (iβ), Γ₁ φ₁ = 1.566 at the tip of an Euler–Bernoulli cantilever (Blevins
    # 1979); a plate of this width is within a few percent of it.
    assert found.abs().item() == pytest.approx(1.566 / 0.01, rel=0.03)
    assert found.imag.item() == pytest.approx(-found.abs().item(), rel=0.01)
