"""Motions without strain: exactly zero on a free plate, and never taken from a support, however soft."""

import math
import re

import pytest
import torch

from torchplate.model import Modes, Searched, modal_impedance, own_damping, reduce
from torchplate.model.receptance.modes import solve_eigenvalues
from torchplate.plate import Mesh

# The strips are 13:1 and 40:1: there the highest eigenvalue is 1e7 and 1e8 times the first elastic one.
MESHES = {
    "square": Mesh(0.4, 0.4, 6, 6),
    "rectangle": Mesh(0.7, 0.4, 5, 3),
    "one element": Mesh(0.7, 0.4, 1, 1),
    "strip": Mesh(1.3, 0.1, 26, 2),
    "rod": Mesh(2.0, 0.05, 40, 1),
}
READ, HIT = (0.2, 0.0), (0.7, 0.3)
SHAPES = pytest.mark.parametrize("name", list(MESHES))


def mass_of(plates, mesh: Mesh) -> float:
    return plates.metals["aluminium"][2] * 0.003 * mesh.length_x * mesh.length_y


def rigid_accelerance(mass: float) -> float:
    """Acceleration over force of a rigid rectangle: 1/m (1 + 12 u₁ u₂ + 12 v₁ v₂), places from the middle."""
    (x, y), (u, v) = READ, HIT
    return (1 + 12 * (x - 0.5) * (u - 0.5) + 12 * (y - 0.5) * (v - 0.5)) / mass


@SHAPES
def test_a_free_plate_has_three_modes_at_exactly_zero(plates, name: str) -> None:
    model = plates.build(MESHES[name])
    frequency = model.natural_frequencies(plates.nothing, 5)
    assert frequency[:3].tolist() == [0.0, 0.0, 0.0]
    assert frequency[3] > 0.5 * plates.first_bending(MESHES[name])
    assert model.modes(plates.nothing).eigenvalue[:3].tolist() == [0.0, 0.0, 0.0]


def test_each_member_of_a_batch_has_its_own(plates) -> None:
    model = plates.build(MESHES["strip"], None, {"wires.stiffness": Searched(0.0, 10.0)})
    found = model.natural_frequencies(torch.tensor([[0.0], [5.0]], dtype=torch.float64), 4)
    assert bool((found[0, :3] == 0).all())
    assert bool((found[1, :3] > 0.1).all())


@pytest.mark.parametrize("name", ["square", "strip"])
@pytest.mark.parametrize("low", [3e-2, 3e-3])
def test_a_support_as_soft_as_it_may_be_keeps_its_modes(plates, name: str, low: float) -> None:
    mesh = MESHES[name]
    mass, wanted = mass_of(plates, mesh), low * plates.first_bending(mesh)
    stiffness = mass * (2 * math.pi * wanted) ** 2
    corners = [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)]
    model = plates.build(mesh, {"wires.stiffness": stiffness / 4}, wires=corners)
    found = model.natural_frequencies(plates.nothing, 3)
    # On a spring at each corner a rectangle bounces at √(k/m) and rocks at √3 times that, about either axis.
    expected = torch.tensor([1.0, math.sqrt(3), math.sqrt(3)], dtype=torch.float64) * wanted
    # Its own bending gives way by the square of the ratio, measured 4 times it; rounding of the highest eigenvalue is
    # 2e-16 · 1e7 / low².
    torch.testing.assert_close(found, expected, rtol=6 * low**2 + 1e-9 / low**2, atol=0)


@pytest.mark.parametrize(
    ("name", "searched"),
    [(name, "plate.youngs_modulus") for name in MESHES]
    + [(name, "plate.poisson_ratio") for name in ("square", "strip")],
)
def test_far_below_its_first_bending_a_free_plate_is_a_rigid_body(plates, name: str, searched: str) -> None:
    mesh = MESHES[name]
    box = {"plate.youngs_modulus": Searched(6e10, 8e10), "plate.poisson_ratio": Searched(0.3, 0.36)}
    places = {"response": [READ], "reference": [HIT], "kind": "accelerance"}
    model = plates.build(mesh, None, {searched: box[searched]}, **places)
    first = plates.first_bending(mesh)
    theta = torch.tensor([0.5 * (box[searched].low + box[searched].high)], dtype=torch.float64)
    frequency = torch.tensor([0.0, 1e-7, 1e-5, 1e-4], dtype=torch.float64) * first
    # By shared modes, and in a basis of its own, which does not pay for few elements.
    found = reduce(model, torch.linspace(0.5, 4.0, 30, dtype=torch.float64) * first)
    assert (found is not None) or mesh.n_element < 20
    for way in (model, *(found or ())[:1]):
        ratio = way.frf(theta, frequency)[:, 0, 0] / rigid_accelerance(mass_of(plates, mesh))
        # Bending adds the square of the ratio of frequencies; rounding turns the shapes by some 1e-10.
        torch.testing.assert_close(ratio, torch.ones_like(ratio), rtol=3e-7, atol=0)


def test_the_frequency_of_a_rigid_motion_has_a_slope_of_zero(plates) -> None:
    model = plates.build(MESHES["strip"], None, {"plate.youngs_modulus": Searched(6e10, 8e10)})
    theta = torch.tensor([7e10], dtype=torch.float64)
    (slope,) = torch.autograd.functional.jacobian(lambda t: model.natural_frequencies(t, 5), theta).unbind(-1)
    assert slope[:3].tolist() == [0.0, 0.0, 0.0]
    # f ~ √E.
    torch.testing.assert_close(slope[3:], model.natural_frequencies(theta, 5)[3:] / (2 * theta), rtol=1e-6, atol=0)


def test_no_more_than_three_are_taken_for_rigid() -> None:
    value = torch.tensor([1e-20, 2e-20, -3e-20, 4e-20, 1.0], dtype=torch.float64)
    found = solve_eigenvalues(torch.diag(value), torch.eye(5, dtype=torch.float64))
    assert int((found == 0).sum()) == 3


@SHAPES
def test_what_loses_by_strain_damps_no_motion_without_strain(plates, name: str) -> None:
    known = {"loss.stiffness_loss_factor": 0.01, "loss.mass_loss_factor": 3.7, "rayleigh.mass_coefficient": 0.8}
    model = plates.build(MESHES[name], known)
    system, modes = model.system(plates.nothing), model.modes(plates.nothing)
    impedance = modal_impedance(system, Modes(modes.eigenvalue, modes.shape), 1j * modes.eigenvalue.sqrt()[3:5])
    own = own_damping(impedance, system.force)
    assert own[:3].tolist() == [3.7, 3.7, 3.7]
    elastic = modes.eigenvalue[3:6]
    torch.testing.assert_close(own[3:6], 0.01 * elastic + 3.7 + 0.8 * elastic.sqrt(), rtol=1e-9, atol=0)


def test_what_an_element_loses_by_itself_adds_to_what_the_whole_plate_does(plates) -> None:
    known = {"loss.stiffness_loss_factor": 0.01, "field.base": 0.02}
    model = plates.build(MESHES["one element"], known, loss_field=True)
    system, modes = model.system(plates.nothing), model.modes(plates.nothing)
    impedance = modal_impedance(system, Modes(modes.eigenvalue, modes.shape), 1j * modes.eigenvalue.sqrt()[3:5])
    # The field at the middle of the only element: 0.02 (1 + 0.5 + 2 · 0.25).
    expected = (0.01 + 0.04) * modes.eigenvalue[3:6]
    torch.testing.assert_close(own_damping(impedance, system.force)[3:6], expected, rtol=1e-9, atol=0)


@SHAPES
def test_a_dashpot_damps_each_mode_by_what_moves_there(plates, name: str) -> None:
    places = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]
    mesh, known = MESHES[name], {"wires.stiffness": 900.0, "wires.viscous_damping": 1.7}
    model = plates.build(mesh, known | {"loss.mass_loss_factor": 3.7}, wires=places)
    system, modes = model.system(plates.nothing), model.modes(plates.nothing)
    omega = modes.eigenvalue.sqrt()
    impedance = modal_impedance(system, Modes(modes.eigenvalue, modes.shape), 1j * omega[:2])
    own = own_damping(impedance, system.force)
    there = mesh.deflection_at(mesh.places(places)) @ modes.shape
    torch.testing.assert_close(own[:5], 3.7 + (1.7 * omega * there.square().sum(0))[:5], rtol=1e-9, atol=0)


def test_what_is_too_stiff_for_the_plate_s_digits_is_told_by_its_rigidity(plates) -> None:
    young, poisson, _ = plates.metals["aluminium"]
    most = 1e9 * young * 0.003**3 / (12 * (1 - poisson**2)) / (0.7 * 0.4)
    with pytest.raises(ValueError, match=re.escape(f"to be at most {most:.2g} [N/m]")):
        plates.build(MESHES["rectangle"], {"wires.stiffness": 1.01 * most}, wires=[(0.0, 0.0)])
    plates.build(MESHES["rectangle"], {"wires.stiffness": 0.99 * most}, wires=[(0.0, 0.0)])
