"""Frequency response functions against a direct solve, closed forms and what every passive structure must do."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

place = st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0))


def scaled(low: float, high: float) -> st.SearchStrategy[float]:
    """Positive numbers over several decades."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)


def lines(plates, mesh: Mesh, metal: str, thickness: float, n_line: int = 9) -> torch.Tensor:
    """From half of the first bending mode to beyond the first few [Hz]."""
    first = plates.first_bending(mesh, metal=metal, thickness=thickness)
    return torch.linspace(0.5, 6.0, n_line, dtype=torch.float64) * first


def solve_by_hand(model: PlateModel, frequency: torch.Tensor, response: list, reference: list, decay: float = 0.0):
    """Receptance from the model's matrices, in NumPy, with Z(s) written out term by term."""
    system = model.system(torch.zeros(0, dtype=torch.float64))
    mass, stiffness = system.mass.numpy(), system.stiffness.numpy()
    beta, eta, a, b = (float(part) for part in system.proportional[:4])
    viscous = sum(float(c) * np.outer(row, row) for c, row in zip(system.viscous, system.dashpot.numpy(), strict=True))
    hysteretic = 0 if system.hysteretic is None else system.hysteretic.numpy()
    left, right = (
        model.assembly.rows(model.mesh.deflection_at(model.mesh.places(points))).numpy()
        for points in (response, reference)
    )
    found = []
    for line in frequency.tolist():
        s = 2j * np.pi * line + decay
        impedance = stiffness * (1 + 1j * beta) + 1j * hysteretic + 1j * eta * mass
        impedance = impedance + s * (viscous + a * mass + b * stiffness) + s**2 * mass
        found.append(left @ np.linalg.solve(impedance, right.T))
    return torch.from_numpy(np.array(found))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(data=st.data())
@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
def test_the_modal_sum_is_the_direct_solve_on_any_plate_with_any_damping(
    plates, relative_error, loss_field: bool, data: st.DataObject
) -> None:
    draw = data.draw
    metal, thickness = draw(st.sampled_from(list(plates.metals))), draw(scaled(5e-4, 1e-2))
    cells = draw(st.tuples(st.integers(2, 6), st.integers(2, 6)))
    length_x = draw(st.floats(0.1, 1.0))
    square = draw(st.booleans())
    length_y = length_x if square else length_x * draw(st.floats(0.4, 2.5))
    mesh = Mesh(length_x, length_y, cells[0], cells[0] if square else cells[1])
    pulse = 2 * math.pi * plates.first_bending(mesh, metal=metal, thickness=thickness)
    plate_mass = plates.metals[metal][2] * thickness * length_x * length_y
    known = {
        "wires.stiffness": draw(scaled(1e-3, 1e3)) * plate_mass * pulse**2,
        # Up to a hundred times the dashpot that takes the most power: as good as a pin.
        "wires.viscous_damping": draw(scaled(1e-4, 1e2)) * plates.impedance(metal=metal, thickness=thickness),
        "loss.stiffness_loss_factor": draw(scaled(1e-7, 0.1)),
        "loss.mass_loss_factor": draw(scaled(1e-6, 0.1)) * pulse**2,
        "rayleigh.mass_coefficient": draw(scaled(1e-6, 0.1)) * pulse,
        "rayleigh.stiffness_coefficient": draw(scaled(1e-6, 0.1)) / pulse,
        "lump.mass": draw(st.floats(0.0, 1.0)) * plate_mass,
    }
    if loss_field:
        known["field.base"] = draw(st.floats(0.0, 0.1))
    model = plates.build(
        mesh,
        known,
        metal=metal,
        thickness=thickness,
        wires=draw(st.lists(place, min_size=1, max_size=4)),
        lump=draw(place),
        loss_field=loss_field,
    )
    node = st.integers(1, mesh.n_label)
    arguments = lines(plates, mesh, metal, thickness), [draw(node), draw(place)], [draw(place), draw(node)]
    found = model.frf(plates.nothing, *arguments)
    # What both lose: rounding of the highest eigenvalue, up to 1e7 times that of the lines here, and the digits that
    # cancel where a dashpot pins the plate.
    assert relative_error(found, model.frf_direct(plates.nothing, *arguments)) < 1e-8


@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
@pytest.mark.parametrize(
    "mesh",
    [
        Mesh(0.7, 0.4, 5, 3),
        Mesh(0.4, 0.4, 4, 4),
        Mesh(0.7, 0.4, 4, 3, edges={"x0": "clamped", "y1": "simply_supported"}),
    ],
    ids=["rectangle", "square", "held"],
)
def test_both_ways_solve_the_dynamic_stiffness_written_out_term_by_term(
    plates, relative_error, mesh: Mesh, loss_field: bool
) -> None:
    known = {**plates.damping_of_every_kind(mesh), "wires.stiffness": 3e3, "lump.mass": 0.3}
    model = plates.build(mesh, known | ({"field.base": 0.03} if loss_field else {}), loss_field=loss_field)
    frequency = lines(plates, mesh, "aluminium", 0.003)
    arguments = frequency, [8, (0.71, 0.23)], [(0.33, 0.9), 9, (0.5, 0.5)]
    expected = solve_by_hand(model, *arguments)
    # Rounding at the scale of the highest eigenvalue.
    assert relative_error(model.frf_direct(plates.nothing, *arguments), expected) < 1e-10
    assert relative_error(model.frf(plates.nothing, *arguments), expected) < 1e-9


def test_a_window_moves_the_lines_off_the_frequency_axis(plates, relative_error) -> None:
    mesh = Mesh(0.7, 0.4, 5, 3)
    known = {**plates.damping_of_every_kind(mesh), "wires.stiffness": 3e3, "lump.mass": 0.3, "field.base": 0.03}
    for loss_field in (False, True):
        chosen = {key: value for key, value in known.items() if loss_field or key != "field.base"}
        model = plates.build(mesh, chosen, loss_field=loss_field)
        arguments = lines(plates, mesh, "aluminium", 0.003), [8, (0.71, 0.23)], [(0.33, 0.9), 9]
        rate = 0.2 * 2 * math.pi * plates.first_bending(mesh)
        expected = solve_by_hand(model, *arguments, decay=rate)
        # Rounding, as above.
        assert relative_error(model.frf(plates.nothing, *arguments, decay=rate), expected) < 1e-9
        assert relative_error(model.frf(plates.nothing, *arguments), expected) > 1e-2


@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
def test_force_and_response_change_places(plates, relative_error, loss_field: bool) -> None:
    for mesh in (Mesh(0.7, 0.4, 5, 3), Mesh(0.4, 0.4, 4, 4)):
        known = {**plates.damping_of_every_kind(mesh), "wires.stiffness": 3e3, "lump.mass": 0.3}
        model = plates.build(mesh, known | ({"field.base": 0.03} if loss_field else {}), loss_field=loss_field)
        frequency = lines(plates, mesh, "aluminium", 0.003)
        first, second = [2, (0.71, 0.23)], [(0.33, 0.9), 12, 7]
        there = model.frf(plates.nothing, frequency, first, second)
        back = model.frf(plates.nothing, frequency, second, first)
        # Symmetric matrices: rounding at the scale of the highest eigenvalue.
        assert relative_error(there, back.mT) < 1e-9


@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
@pytest.mark.parametrize("size", [1e-3, 1.0, 30.0])
def test_no_force_takes_power_out_of_the_plate(plates, size: float, loss_field: bool) -> None:
    for mesh in (Mesh(0.7, 0.4, 5, 3), Mesh(0.4, 0.4, 4, 4)):
        known = {**plates.damping_of_every_kind(mesh, size=size), "wires.stiffness": 3e3, "lump.mass": 0.3}
        model = plates.build(mesh, known | ({"field.base": 0.03} if loss_field else {}), loss_field=loss_field)
        frequency = torch.linspace(0.05, 12.0, 25, dtype=torch.float64) * plates.first_bending(mesh)
        points = [1, 9, (0.71, 0.23), (0.21, 0.0)]
        mobility = model.frf(plates.nothing, frequency, points, points, kind="mobility")
        driving = mobility.diagonal(dim1=-2, dim2=-1)
        # Rounding of the imaginary part, which is the larger by far where there is little damping.
        rounding = 1e-10 * mobility.abs().amax((-2, -1))
        assert bool((driving.real > -rounding[:, None]).all())
        # Several forces at once take none out either: the Hermitian part has no negative eigenvalue.
        power = torch.linalg.eigvalsh(0.5 * (mobility + mobility.mH))
        assert bool((power[:, 0] > -rounding).all())
        assert bool((power[:, -1] > 0).all())


def test_a_stiff_plate_on_springs_is_a_mass_on_a_spring(plates) -> None:
    sides, thickness, metal = (0.1, 0.06), 0.02, "steel"
    corners = [(0.1, 0.2), (0.9, 0.2), (0.1, 0.8), (0.9, 0.8)]
    known = {
        "wires.stiffness": 1e3,
        "wires.viscous_damping": 2.0,
        "loss.stiffness_loss_factor": 0.04,
        "loss.mass_loss_factor": 30.0,
        "rayleigh.mass_coefficient": 3.0,
        "rayleigh.stiffness_coefficient": 2e-4,
        "lump.mass": 0.3,
    }
    model = plates.build(Mesh(*sides, 2, 2), known, metal=metal, thickness=thickness, wires=corners, lump=(0.5, 0.5))
    mass = 7860.0 * thickness * sides[0] * sides[1] + 0.3
    stiffness, dashpot = 4e3, 8.0
    natural = math.sqrt(stiffness / mass) / (2 * math.pi)
    frequency = torch.linspace(0.1, 3.0, 59, dtype=torch.float64) * natural
    omega = 2 * torch.pi * frequency
    damping = 0.04 * stiffness + 30.0 * mass + omega * (dashpot + 3.0 * mass + 2e-4 * stiffness)
    expected = 1 / (stiffness - omega**2 * mass + 1j * damping)
    # Force and lump at the middle move the plate without tilting it, so all its points move alike. The plate itself
    # bends (9 Hz)²/(10 kHz)² as much, and rounding at the scale of its highest mode is of that order too: 1e-5 of
    # stiffness, times a peak of height 1/0.2.
    found = model.frf(plates.nothing, frequency, [5, 1, (0.83, 0.4)], [(0.5, 0.5)])[..., 0]
    torch.testing.assert_close(found, expected[:, None].expand(-1, 3), rtol=1e-4, atol=0)
    assert model.natural_frequencies(plates.nothing, n_mode=1).item() == pytest.approx(natural, rel=1e-4)


@pytest.mark.parametrize("sides", [(0.7, 0.4), (0.4, 0.4)], ids=["rectangle", "square"])
def test_a_free_plate_moves_as_a_rigid_body_below_its_first_mode(plates, sides: tuple[float, float]) -> None:
    mesh = Mesh(*sides, 4, 4)
    model = plates.build(mesh)
    first = model.natural_frequencies(plates.nothing)[3].item()
    points = torch.tensor([(0.5, 0.5), (0.0, 0.0), (0.83, 0.4), (0.2, 0.9)], dtype=torch.float64)
    mass = 2700.0 * 0.003 * sides[0] * sides[1]
    # From the centre of mass in metres; moments of inertia of a thin rectangle, m L²/12.
    arm = (points - 0.5) * torch.tensor(sides, dtype=torch.float64)
    flexibility = 1 / mass + (arm / torch.tensor(sides, dtype=torch.float64) ** 2) @ arm.mT * 12 / mass
    miss = []
    for part in (0.1, 0.05):
        frequency = torch.tensor([part * first], dtype=torch.float64)
        found = model.frf(plates.nothing, frequency, points.tolist(), points.tolist())[0]
        expected = -flexibility / (2 * torch.pi * frequency) ** 2
        # The elastic modes answer as 1/ω₁² against 1/ω²: measured 2.1 (f/f₁)² of the largest.
        miss.append((found - expected).abs().max() / expected.abs().max())
        assert miss[-1] < 3 * part**2
    assert miss[0] / miss[1] == pytest.approx(4, rel=0.03)
    accelerance = model.frf(plates.nothing, frequency, [(0.5, 0.5)], [(0.5, 0.5)], kind="accelerance")
    assert accelerance.real.item() == pytest.approx(1 / mass, rel=0.01)


def test_mobility_and_accelerance_are_derivatives_of_receptance(plates) -> None:
    mesh = Mesh(0.7, 0.4, 5, 3)
    model = plates.build(mesh, plates.damping_of_every_kind(mesh))
    frequency = lines(plates, mesh, "aluminium", 0.003)
    omega = 2 * torch.pi * frequency[:, None, None]
    found = {
        kind: model.frf(plates.nothing, frequency, [8, 2], [5], kind=kind)
        for kind in ("receptance", "mobility", "accelerance")
    }
    # One more product.
    torch.testing.assert_close(found["mobility"], 1j * omega * found["receptance"], rtol=1e-12, atol=0)
    torch.testing.assert_close(found["accelerance"], -(omega**2) * found["receptance"], rtol=1e-12, atol=0)
    direct = model.frf_direct(plates.nothing, frequency, [8, 2], [5], kind="accelerance")
    torch.testing.assert_close(found["accelerance"], direct, rtol=1e-7, atol=0)


def test_a_model_on_another_device_has_the_same_frfs(plates, relative_error, device) -> None:
    mesh = Mesh(0.7, 0.4, 5, 3)
    model = plates.build(mesh, plates.damping_of_every_kind(mesh), {"wires.stiffness": Searched(2e3, 4e3)})
    theta = torch.tensor([[2.3e3], [3.6e3]], dtype=torch.float64)
    frequency = lines(plates, mesh, "aluminium", 0.003)
    expected = model.frf_direct(theta, frequency, [8, 2], [5])
    found = model.to(device).frf(theta.to(device), frequency.to(device), [8, 2], [5])
    assert found.device.type == device.type
    # Rounding of the eigenproblem times its condition, as for the modal sum above.
    assert relative_error(found.cpu(), expected) < 1e-7


def test_a_supported_plate_at_rest_has_its_static_flexibility(plates) -> None:
    mesh = Mesh(0.7, 0.4, 5, 3)
    model = plates.build(mesh, {"wires.stiffness": 3e3})
    found = model.frf(plates.nothing, torch.zeros(1, dtype=torch.float64), [8, (0.1, 0.2)], [(0.6, 0.3)])[0]
    row = model.assembly.rows(mesh.deflection_at(mesh.places([8, (0.1, 0.2), (0.6, 0.3)])))
    expected = row[:2] @ torch.linalg.solve(model.system(plates.nothing).stiffness, row[2:].mT)
    # Rounding times the condition of K, some 1e8 between a wire and the stiffest element motion.
    torch.testing.assert_close(found.real, expected, rtol=1e-7, atol=0)
    assert found.imag.abs().max() == 0
