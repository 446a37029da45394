"""Numbers at the end of what makes sense: hardly any damping, springs like rock, ν near ½; and threads and chunks."""

import math
import re

import pytest
import torch

from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel, Searched, reduce
from torchplate.plate import Mesh

MESHES = {"rectangle": Mesh(0.7, 0.4, 5, 3), "square": Mesh(0.4, 0.4, 4, 4)}
SHAPES = pytest.mark.parametrize("name", list(MESHES))
READ, HIT = (0.23, 0.11), (0.71, 0.64)


@SHAPES
def test_with_a_loss_of_1e_minus_8_a_resonance_has_the_height_of_its_mode(plates, name: str) -> None:
    beta = 1e-8
    model = plates.build(MESHES[name], {"wires.stiffness": 900.0, "loss.stiffness_loss_factor": beta})
    modes = model.modes(plates.nothing)
    rows = model.assembly.rows(model.mesh.deflection_at(model.mesh.places([READ, HIT]).to(model.known)))
    # The first two of bending; the square's next ones come in pairs.
    for mode in (3, 4):
        left, right = rows @ modes.shape[:, mode]
        found = model.frf(plates.nothing, modes.frequency[mode], [READ], [HIT], "receptance").flatten()
        # α = φ φ / (i β ω²): the frequency itself is known to 1e-16 · 1e4, half a millionth of a peak's width.
        expected = left * right / (1j * beta * modes.eigenvalue[mode])
        torch.testing.assert_close(found, expected[None], rtol=1e-4, atol=0)


@SHAPES
def test_springs_of_1e9_newtons_per_metre_are_rigid_supports(plates, name: str) -> None:
    mesh = MESHES[name]
    corners = [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)]
    stiff = 1e9
    found, stiffer = (
        plates.build(mesh, {"wires.stiffness": k, "loss.stiffness_loss_factor": 0.01}, wires=corners)
        for k in (stiff, 4 * stiff)
    )
    lines = torch.linspace(0.3, 4.0, 9, dtype=torch.float64) * plates.first_bending(mesh)
    one, other, direct = (
        way(plates.nothing, lines, [READ], [HIT], "accelerance") for way in (found.frf, stiffer.frf, found.frf_direct)
    )
    # Rounding of the springs' own eigenvalue, 1e-16 · 1e9 / 1e4 of the plate's stiffness, at a peak 100 times.
    assert float((one - direct).norm() / direct.norm()) < 1e-7
    # Four times as stiff is nearly the same: the plate's stiffness at a corner is 1e-5 of that of the springs.
    assert 1e-9 < float((one - other).norm() / one.norm()) < 1e-3
    # The corners stand still: they move less than the plate does by the ratio of the stiffnesses.
    corner = found.frf(plates.nothing, lines, [corners[0]], [HIT], "accelerance")
    assert float(corner.norm()) < 1e-3 * float(one.norm())


@SHAPES
@pytest.mark.parametrize(
    ("name_of", "effect", "number"),
    [
        ("ground_spring", CATALOGUE["ground_spring"](), "stiffness"),
        ("edge_spring", CATALOGUE["edge_spring"](edge="y1"), "stiffness"),
        ("edge_spring", CATALOGUE["edge_spring"](edge="y1"), "rotational_stiffness"),
    ],
)
def test_a_spring_is_as_stiff_as_the_digits_of_the_plate_allow_and_no_stiffer(name, name_of, effect, number) -> None:
    mesh = MESHES[name]
    known = {
        "plate.youngs_modulus": 7e10,
        "plate.poisson_ratio": 0.33,
        "plate.density": 2700.0,
        "plate.thickness": 0.003,
    }
    known |= {"loss.stiffness_loss_factor": 0.01, "spring.stiffness": 0.0}
    known |= {"spring.x": 0.2, "spring.y": 0.9} if name_of == "ground_spring" else {}
    effects = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"](), "spring": effect}

    def build(value: float) -> PlateModel:
        return PlateModel(mesh, effects, known | {f"spring.{number}": value})

    with pytest.raises(ValueError, match="rounding") as refused:
        build(1e20)
    most = float(re.search(r"at most ([\d.e+]+)", str(refused.value))[1])
    lines = torch.linspace(15.0, 400.0, 9, dtype=torch.float64)
    nothing = torch.zeros(0, dtype=torch.float64)
    stiffest, direct, rigid = (
        getattr(build(part * most), way)(nothing, lines, [READ], [HIT], "accelerance")
        for part, way in ((0.9, "frf"), (0.9, "frf_direct"), (0.01, "frf"))
    )
    assert float((stiffest - direct).norm() / direct.norm()) < 1e-5  # as stands beside the limit
    # At the peak that moves most, whose width is a hundredth of its frequency.
    assert float((rigid - direct).norm() / direct.norm()) < 3e-3


@pytest.mark.parametrize(
    ("number", "value"),
    [
        *((name, value) for name in ("plate.density", "plate.thickness") for value in (1e308, 1e31, 1e-31, 5e-324)),
        ("wires.viscous_damping", 1e308),
        ("loss.mass_loss_factor", 1e31),
    ],
)
def test_a_number_that_no_plate_has_is_refused_by_name(plates, number: str, value: float) -> None:
    with pytest.raises(ValueError, match=number):
        plates.build(MESHES["square"], {number: value})
    with pytest.raises(ValueError, match=number):
        plates.build(MESHES["square"], {}, {number: Searched(min(value, 1e-3), max(value, 1e-3))})


@SHAPES
def test_poissons_ratio_of_049_is_a_plate_like_others(plates, name: str) -> None:
    mesh = MESHES[name]
    model = plates.build(mesh, {"plate.poisson_ratio": 0.49, "loss.stiffness_loss_factor": 0.01})
    lines = torch.linspace(0.3, 4.0, 9, dtype=torch.float64) * plates.first_bending(mesh)
    found, direct = (way(plates.nothing, lines, [READ], [HIT], "accelerance") for way in (model.frf, model.frf_direct))
    assert float((found - direct).norm() / direct.norm()) < 1e-8
    # A free square's first mode twists: λ² ~ 24 (1 − ν) · 12 on few elements, as Rayleigh's w = xy has it from above.
    twist = model.natural_frequencies(plates.nothing, 4)[3]
    young, _, density = plates.metals["aluminium"]
    shear = young / (2 * (1 + 0.49))
    # w = x y: ω² = 4 · (G h³/12) · 1 · A / (ρ h · A Lx² Ly² / 144).
    rayleigh = math.sqrt(4 * shear * 0.003**2 / 12 * 144 / (density * (mesh.length_x * mesh.length_y) ** 2))
    assert 0.85 * rayleigh < 2 * math.pi * float(twist) < 1.001 * rayleigh


def test_hardly_any_damping_and_hard_springs_pass_through_a_reduced_basis(plates) -> None:
    mesh = Mesh(0.7, 0.4, 8, 6)
    known = {"wires.stiffness": 1e9, "loss.stiffness_loss_factor": 1e-3}
    model = plates.build(
        mesh, known, {"plate.youngs_modulus": Searched(6e10, 8e10)}, response=[READ], reference=[HIT], kind="mobility"
    )
    lines = torch.linspace(0.3, 3.0, 40, dtype=torch.float64) * plates.first_bending(mesh)
    found = reduce(model, lines)
    assert found is not None
    theta = torch.tensor([[6.3e10], [7.7e10]], dtype=torch.float64)
    full = model.frf_direct(theta, lines)
    # Ten times the tolerance of the basis: these members were not among those it was checked at.
    assert float(((found[0].frf(theta, lines) - full).norm(dim=1) / full.norm(dim=1)).max()) < 1e-3


@SHAPES
def test_one_thread_or_two_and_chunks_or_none_give_the_same_numbers(plates, name: str) -> None:
    searched = {"plate.youngs_modulus": Searched(5e10, 9e10), "wires.stiffness": Searched(100.0, 2000.0)}
    generator = torch.Generator().manual_seed(3)
    place = torch.rand(6, 2, generator=generator, dtype=torch.float64)
    lines = torch.linspace(0.3, 4.0, 7, dtype=torch.float64) * plates.first_bending(MESHES[name])
    before, found = torch.get_num_threads(), []
    try:
        for n_thread, memory in ((1, 2**30), (2, 2**30), (1, 1)):
            torch.set_num_threads(n_thread)
            model = plates.build(MESHES[name], {"loss.stiffness_loss_factor": 0.01}, searched, memory=memory)
            found.append(model.frf(model.space.to_si(place), lines, [READ], [HIT]))
    finally:
        torch.set_num_threads(before)
    for other in found[1:]:
        # Sums are made in another order: rounding, 1e-16, times the highest eigenvalue over the first, 1e4.
        torch.testing.assert_close(other, found[0], rtol=0, atol=1e-11 * float(found[0].abs().max()))
