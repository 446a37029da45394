"""Holes and missing corners: what is left out, and what stays as it was."""

import numpy as np
import pytest
import torch

from torchplate.effects import EdgeSpring, GroundSpring, Plate, PointMass, SupportSpring
from torchplate.model import PlateModel, SparseModel, extrapolate
from torchplate.plate import Mesh

NONE = torch.zeros(0, dtype=torch.float64)
METAL = {
    "plate.youngs_modulus": 69e9, "plate.poisson_ratio": 0.31, "plate.density": 2710.0, "plate.thickness": 0.0031,
}  # fmt: skip
HOLE = (0.2, 0.25, 0.6, 0.75)
HOLED = Mesh(0.5, 0.3, 5, 4, cut=(HOLE,))


def build(mesh: Mesh, extra: dict | None = None, known: dict | None = None, **more) -> PlateModel:
    return PlateModel(mesh, {"plate": Plate()} | (extra or {}), METAL | (known or {}), **more)


@pytest.mark.parametrize("refine", [1, 2, 3])
def test_a_hole_takes_its_share_of_the_mass_and_of_nothing_else(refine: int) -> None:
    mesh = Mesh(0.5, 0.3, 5, 4, refine=refine, cut=(HOLE,))
    assert mesh.n_element == 16 * refine**2
    assert mesh.n_label == 30
    rigid = mesh.rigid_translation[mesh.free_dof]
    mass = build(mesh).system(NONE).mass
    assert float(rigid @ mass @ rigid) == pytest.approx(2710.0 * 0.0031 * 0.15 * 0.8, rel=1e-12)
    # The inner nodes of the hole have no dof left: (2 refine − 1)².
    assert mesh.n_dof - len(mesh.free_dof) == 3 * (2 * refine - 1) ** 2


@pytest.mark.parametrize("mesh", [HOLED, Mesh(0.4, 0.4, 6, 6, cut=((0.5, 0.5, 1.0, 1.0),))], ids=["hole", "square L"])
def test_it_moves_as_a_rigid_body_without_force_and_no_matrix_is_singular(mesh: Mesh) -> None:
    system = build(mesh).system(NONE)
    place = mesh.node_place
    rows = mesh.deflection_at(place[mesh.element_dof.flatten()[::3] // 3])[:, mesh.free_dof]
    moved = torch.zeros(mesh.n_dof, 3, dtype=torch.float64)
    # w = 1, x and y; dofs are w, ∂w/∂y, −∂w/∂x over relative places.
    moved[0::3] = torch.stack([torch.ones(len(place)).double(), *place.unbind(-1)], dim=-1)
    moved[2::3, 1], moved[1::3, 2] = -1.0, 1.0
    rigid = moved[mesh.free_dof]
    assert float((system.stiffness @ rigid).abs().max()) < 1e-9 * float(system.stiffness.abs().max())
    expected = moved[0::3][mesh.element_dof.flatten()[::3] // 3]
    torch.testing.assert_close(rows @ rigid, expected, rtol=0, atol=1e-12)
    found = build(mesh).natural_frequencies(NONE, 6)
    assert float(found[2]) < 1e-2
    assert float(found[3]) > 10.0
    torch.linalg.cholesky(system.mass)


def test_a_cut_along_a_whole_side_leaves_the_smaller_plate() -> None:
    cut = build(Mesh(0.5, 0.3, 5, 4, cut=((0.6, 0.0, 1.0, 1.0),)), response=[(0.3, 0.4)], reference=[(0.5, 0.9)])
    small = build(Mesh(0.3, 0.3, 3, 4), response=[(0.5, 0.4)], reference=[(0.5 / 0.6, 0.9)])
    lines = torch.linspace(20.0, 600.0, 50, dtype=torch.float64)
    torch.testing.assert_close(cut.frf(NONE, lines), small.frf(NONE, lines), rtol=1e-9, atol=1e-15)


@pytest.mark.check
def test_dense_sparse_and_extrapolated_models_agree_about_a_hole() -> None:
    model = build(HOLED, response=[1, (0.9, 0.6)], reference=[8])
    np.testing.assert_allclose(
        SparseModel(model, NONE).modes(9).frequency[3:9], model.natural_frequencies(NONE, 9)[3:], rtol=1e-8
    )
    # 1.2 % at the mesh's own highest of these, and the corners' part of the error falls more slowly than h².
    better, fine = (
        m.natural_frequencies(NONE, 7)[3:]
        for m in (extrapolate(model).model, build(Mesh(0.5, 0.3, 5, 4, refine=6, cut=(HOLE,))))
    )
    coarse = model.natural_frequencies(NONE, 7)[3:]
    assert float((better / fine - 1).abs().max()) < 0.5 * float((coarse / fine - 1).abs().max())


def test_there_is_nothing_inside_a_hole_and_its_edge_belongs_to_the_plate() -> None:
    edge = torch.tensor([[0.2, 0.4], [0.6, 0.6], [0.4, 0.25], [0.33, 0.75], [0.6, 0.75]], dtype=torch.float64)
    rows = HOLED.deflection_at(edge)
    assert bool((rows @ HOLED.rigid_translation - 1).abs().max() < 1e-12)
    held = torch.ones(HOLED.n_dof, dtype=torch.bool)
    held[HOLED.free_dof] = False
    assert not bool(rows[:, held].any())
    assert not bool(HOLED.deflection_at(torch.tensor([[0.4, 0.5], [0.21, 0.3]]).double()).any())
    # A mass there changes nothing.
    lump = {"lump.x": 0.45, "lump.y": 0.5, "lump.mass": 1.0}
    found = build(HOLED, {"lump": PointMass()}, lump).natural_frequencies(NONE, 8)
    torch.testing.assert_close(found, build(HOLED).natural_frequencies(NONE, 8))


@pytest.mark.parametrize("off", [-1e-9, 1e-9], ids=["before", "beyond"])
def test_a_place_on_the_edge_of_a_hole_is_on_the_plate_whatever_rounding_makes_of_it(off: float) -> None:
    """In the middle of each edge, and at the corners: seen from the hole, the plate begins on the other side of it."""
    x, y = (0.2, 0.4, 0.6), (0.25, 0.5, 0.75)
    edge = [(a, b) for a in x for b in y if (a, b) != (0.4, 0.5)]
    place = torch.tensor(edge, dtype=torch.float64)
    on_it, beside = (HOLED.deflection_at(place + by) for by in (0.0, off))
    # Rigid motion is what the place says, and shape functions change by some part of what the place does.
    held = HOLED.rigid_translation
    torch.testing.assert_close(beside @ held, torch.ones(len(edge)).double(), rtol=1e-12, atol=0.0)
    torch.testing.assert_close(beside, on_it, rtol=0.0, atol=1e-7)


def test_springs_along_an_edge_hold_what_is_left_of_it() -> None:
    notch = Mesh(0.5, 0.3, 5, 4, cut=((0.8, 0.0, 1.0, 0.5),))
    spring = {"edge.stiffness": 1e4, "edge.rotational_stiffness": 0.0}
    system = build(notch, {"edge": EdgeSpring(edge="x1")}, spring).system(NONE)
    rigid = notch.rigid_translation[notch.free_dof]
    assert float(rigid @ system.stiffness @ rigid) == pytest.approx(1e4 * 0.15, rel=1e-9)


@pytest.mark.parametrize(
    ("edge", "left", "across", "dof", "sign"), [("x1", 0.15, 0.5, 2, -1.0), ("y0", 0.4, 0.3, 1, 1.0)]
)
def test_rotational_springs_along_an_edge_hold_what_is_left_of_it_too(edge, left, across, dof, sign) -> None:
    """A rigid body that turns about the edge by an angle φ stores κ φ² over the length that is there."""
    notch = Mesh(0.5, 0.3, 5, 4, cut=((0.8, 0.0, 1.0, 0.5),))
    spring = {"edge.stiffness": 0.0, "edge.rotational_stiffness": 40.0}
    system = build(notch, {"edge": EdgeSpring(edge=edge)}, spring).system(NONE)
    turned = torch.zeros(notch.n_dof, dtype=torch.float64)
    # w = x or y over the side, so that the angle is one over it.
    turned[0::3] = notch.node_place[:, 0 if edge == "x1" else 1]
    turned[dof::3] = sign
    turned = turned[notch.free_dof]
    assert float(turned @ system.stiffness @ turned) == pytest.approx(40.0 * left / across**2, rel=1e-9)


@pytest.mark.parametrize(
    ("cut", "told"),
    [
        ((0.2, 0.25, 0.5, 0.75), "x1 of mesh.cut\\[0\\] on a line of the 5 × 4 mesh, such as 0.4 or 0.6, got 0.5"),
        ((0.6, 0.25, 0.2, 0.75), "x0 < x1"),
        ((0.2, 0.25, 0.2, 0.75), "x0 < x1"),
        ((0.2, 0.25, 0.6, 0.25), "y0 < y1"),
        ((0.2, 0.25, 1.2, 0.75), "x0 < x1 ≤ 1"),
        ((0.2, 0.25, 0.6, 1.25), "y0 < y1 ≤ 1"),
        ((-0.2, 0.25, 0.6, 0.75), "0 ≤ x0"),
        ((0.2, -0.25, 0.6, 0.75), "0 ≤ y0"),
        ((0.0, 0.0, 1.0, 1.0), "leave some of the plate"),
        ((0.2, 0.25, 0.6), "as \\[x0, y0, x1, y1\\]"),
    ],
)
def test_a_cut_that_is_none_is_refused_in_a_sentence(cut: tuple[float, ...], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Mesh(0.5, 0.3, 5, 4, cut=(cut,))


def test_sensors_and_supports_inside_a_hole_are_refused() -> None:
    model = build(HOLED)
    with pytest.raises(ValueError, match=r"got \[0.4, 0.5\] inside a hole of mesh.cut"):
        model.frf(NONE, 50.0, [(0.4, 0.5)], [1])
    # Node 15: x = 0.4, y = 0.5.
    with pytest.raises(ValueError, match="inside a hole"):
        model.frf(NONE, 50.0, [1], [15])
    # Of a model's own channels it is said as the model is made; one that has none yet is made.
    for own in ({"response": [(0.4, 0.5)]}, {"response": [1], "reference": [15]}):
        with pytest.raises(ValueError, match="inside a hole"):
            build(HOLED, **own)
    assert build(HOLED, response=[1]).frf(NONE, 50.0, reference=[2]).shape == (1, 1, 1)
    with pytest.raises(ValueError, match="wires: Expected points on the plate, got 15 inside a hole"):
        build(HOLED, {"wires": SupportSpring(nodes=(1, 15))}, {"wires.stiffness": 1e3, "wires.viscous_damping": 0.0})


def test_a_place_that_is_searched_has_a_gradient_beside_a_hole() -> None:
    def stiff(place: torch.Tensor) -> torch.Tensor:
        model = build(HOLED, {"spring": GroundSpring()}, {"spring.x": 0.7, "spring.y": 0.4, "spring.stiffness": 1e4})
        row = model.mesh.deflection_at(place[None])[..., model.mesh.free_dof]
        return (row @ torch.linspace(0, 1, row.shape[-1]).double()).square().sum()

    place = torch.tensor([0.71, 0.37], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(stiff, (place,))
