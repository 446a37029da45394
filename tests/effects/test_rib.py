"""A rib against beams alone, and what does not depend on the mesh."""

import math

import pytest
import torch

from torchplate.effects import Plate, Rib
from torchplate.effects.rib import most_pieces
from torchplate.model import PlateModel, Searched, SparseModel
from torchplate.plate import Mesh

NONE = torch.zeros(0, dtype=torch.float64)
PLATE = {"plate.poisson_ratio": 0.0, "plate.density": 1e-3, "plate.thickness": 0.003, "plate.youngs_modulus": 7e10}
BEAM = {"rib.bending": 9.0, "rib.torsion": 0.0, "rib.mass_per_length": 0.6}
MESH = Mesh(0.5, 0.3, 6, 4)


def ends(x0: float, y0: float, x1: float, y1: float) -> dict[str, float]:
    return {"rib.x0": x0, "rib.y0": y0, "rib.x1": x1, "rib.y1": y1}


def build(known: dict[str, float], mesh: Mesh = MESH) -> PlateModel:
    return PlateModel(mesh, {"plate": Plate(), "rib": Rib()}, PLATE | known)


def energies(model: PlateModel, field) -> tuple[float, float]:
    """2 U and 2 T/ω² that the rib adds to a motion w(x, y), all over relative places."""
    bare = build(dict.fromkeys(BEAM, 0.0) | ends(0.1, 0.1, 0.9, 0.9), model.mesh).system(NONE)
    place = model.mesh.node_place.clone().requires_grad_()
    w = field(*place.unbind(-1))
    (slope,) = torch.autograd.grad(w.sum(), place)
    nodal = torch.stack([w, slope[:, 1], -slope[:, 0]], dim=-1).detach().flatten()[model.mesh.free_dof]
    system = model.system(NONE)
    return tuple(
        float(nodal @ (m - b) @ nodal) for m, b in ((system.stiffness, bare.stiffness), (system.mass, bare.mass))
    )


LINES = {"along x": (0.0, 0.5, 1.0, 0.5), "across": (0.9, 0.1, 0.2, 0.8), "within": (0.31, 0.42, 0.55, 0.47)}


@pytest.mark.parametrize("name", list(LINES))
def test_it_has_the_energy_of_a_beam_in_a_motion_that_elements_have(name: str) -> None:
    x0, y0, x1, y1 = LINES[name]
    a, b = (x1 - x0) * 0.5, (y1 - y0) * 0.3
    length = math.hypot(a, b)
    known = ends(x0, y0, x1, y1) | {"rib.bending": 9.0, "rib.torsion": 4.0, "rib.mass_per_length": 0.6}
    # w = X² + 0.7 XY in metres: curvature along the line 2 c² + 1.4 cs, twist −2cs + 0.7 (c² − s²), both constant.
    c, s = a / length, b / length
    strain, weight = energies(build(known), lambda x, y: (0.5 * x) ** 2 + 0.7 * 0.5 * 0.3 * x * y)
    curvature, twist = 2 * c * c + 1.4 * c * s, -2 * c * s + 0.7 * (c * c - s * s)
    assert strain == pytest.approx(length * (9.0 * curvature**2 + 4.0 * twist**2), rel=1e-6)
    t = torch.linspace(0, 1, 4001, dtype=torch.float64)
    x, y = 0.5 * x0 + a * t, 0.3 * y0 + b * t
    expected = 0.6 * length * torch.trapezoid((x * x + 0.7 * x * y).square(), t)
    # Two Gauss points a piece, for a quartic.
    assert weight == pytest.approx(float(expected), rel=2e-3)


def test_a_rib_on_a_plate_of_nearly_nothing_is_a_free_beam() -> None:
    soft = {"plate.youngs_modulus": 1e4, "plate.density": 1e-2}
    mesh = Mesh(0.5, 0.02, 12, 1)
    found = build(soft | BEAM | ends(0.0, 0.0, 1.0, 0.0), mesh)
    # (βl)² of a free beam: 22.3733; Blevins (1979).
    expected = 22.3733 / 0.5**2 * math.sqrt(9.0 / 0.6) / (2 * math.pi)
    frequency = found.natural_frequencies(NONE, 30)
    assert float((frequency / expected - 1).abs().min()) < 1e-3


def test_its_direction_does_not_matter_and_two_halves_are_the_whole() -> None:
    whole = build(BEAM | ends(0.0, 0.25, 1.0, 0.75), Mesh(0.5, 0.3, 6, 6)).natural_frequencies(NONE, 9)[3:]
    back = build(BEAM | ends(1.0, 0.75, 0.0, 0.25), Mesh(0.5, 0.3, 6, 6)).natural_frequencies(NONE, 9)[3:]
    # Where pieces end is another place then: an error of the mesh.
    torch.testing.assert_close(whole, back, rtol=1e-2, atol=0)
    rest = ends(0.5, 0.5, 1.0, 0.5)
    parts = PlateModel(
        MESH,
        {"plate": Plate(), "rib": Rib(), "rest": Rib()},
        PLATE | BEAM | ends(0.0, 0.5, 0.5, 0.5) | {k.replace("rib", "rest"): v for k, v in (BEAM | rest).items()},
    )
    expected = build(BEAM | ends(0.0, 0.5, 1.0, 0.5)).natural_frequencies(NONE, 9)
    torch.testing.assert_close(parts.natural_frequencies(NONE, 9)[3:], expected[3:], rtol=1e-6, atol=0)


def test_its_mirror_image_is_the_same_where_it_crosses_lines_of_the_mesh() -> None:
    """Its stations lie on edges there, where slopes of elements jump."""
    known = {"plate.density": 2700.0, "rib.bending": 0.0, "rib.torsion": 1.0, "rib.mass_per_length": 0.0}
    mesh = Mesh(0.52, 0.37, 5, 4)
    one = build(known | ends(0.4, 0.375, 0.0, 0.0), mesh).natural_frequencies(NONE, 12)[3:]
    for image in (ends(0.6, 0.375, 1.0, 0.0), ends(0.4, 0.625, 0.0, 1.0), ends(0.6, 0.625, 1.0, 1.0)):
        other = build(known | image, mesh).natural_frequencies(NONE, 12)[3:]
        torch.testing.assert_close(other, one, rtol=1e-10, atol=0)


@pytest.mark.parametrize("line", [(0.4, 0.1, 0.4, 0.8), (0.1, 0.2, 0.7, 0.5), (0.3, 0.1, 0.3, 0.75)])
def test_nothing_jumps_where_it_crosses_a_line_of_the_mesh(line: tuple[float, ...]) -> None:
    """Lines at x = 0.4 and at y = 0.5 and 0.75: along them, and with an end on them."""
    known = {"plate.density": 2700.0, "rib.bending": 5.0, "rib.torsion": 2.0, "rib.mass_per_length": 0.3}
    names, mesh = ("rib.x0", "rib.y0", "rib.x1", "rib.y1"), Mesh(0.52, 0.37, 5, 4)
    searched = {name: Searched(0.0, 1.0) for name in names}
    model = PlateModel(mesh, {"plate": Plate(), "rib": Rib()}, PLATE | known, searched)
    theta = torch.tensor(line, dtype=torch.float64, requires_grad=True)
    slope = torch.autograd.functional.jacobian(lambda at: model.natural_frequencies(at, 9)[3:], theta)
    for step in (1e-4, 1e-6):
        beside = [
            model.natural_frequencies((theta + step * one).detach(), 9)[3:]
            - model.natural_frequencies((theta - step * one).detach(), 9)[3:]
            for one in torch.eye(4, dtype=torch.float64)
        ]
        moved = torch.stack(beside, dim=-1) / (2 * step)
        torch.testing.assert_close(moved, slope, rtol=0, atol=0.01 * float(slope.abs().max()))


def test_a_rib_of_no_length_is_none() -> None:
    stiffness = build(BEAM | ends(0.4, 0.4, 0.4, 0.4)).system(NONE).stiffness
    bare = build(dict.fromkeys(BEAM, 0.0) | ends(0.1, 0.1, 0.9, 0.9)).system(NONE).stiffness
    assert float((stiffness - bare).abs().max()) < 1e-9 * float(bare.abs().max())


@pytest.mark.parametrize("mesh", [MESH, Mesh(0.4, 0.4, 5, 5, refine=2), Mesh(0.9, 0.2, 3, 8)])
def test_there_are_pieces_for_the_longest_line(mesh: Mesh) -> None:
    n = most_pieces(mesh)
    for line in ((0.0, 0.0, 1.0, 1.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.83, 0.0)):
        way = torch.tensor([line[2] - line[0], line[3] - line[1]]) * torch.tensor([mesh.length_x, mesh.length_y])
        side = torch.tensor([mesh.length_x / mesh.cells[0], mesh.length_y / mesh.cells[1]])
        piece = float((way * side).norm() / way.norm())
        assert float(way.norm()) <= piece * n * (1 + 1e-6)


def test_sparse_and_dense_models_agree() -> None:
    model = build(BEAM | {"plate.density": 2700.0, "rib.torsion": 2.0} | ends(0.12, 0.23, 0.87, 0.71))
    torch.testing.assert_close(
        SparseModel(model, NONE).modes(9).frequency[3:9], model.natural_frequencies(NONE, 9)[3:], rtol=1e-7, atol=0
    )


def test_it_has_the_energy_of_a_beam_whose_curvature_grows_along_it():
    """w = X³: what the slopes at both ends of a piece do not say of its bending, its shear does."""
    known = ends(0.0, 0.5, 1.0, 0.5) | {"rib.bending": 9.0, "rib.torsion": 0.0, "rib.mass_per_length": 0.0}
    strain, _ = energies(build(known), lambda x, _: (0.5 * x) ** 3)
    # ∫ (6 X)² dX over 0.5 m.
    assert strain == pytest.approx(9.0 * 36 * 0.5**3 / 3, rel=1e-6)


def test_rows_of_many_members_stay_within_the_memory(monkeypatch):
    """Rows along a line are over all dofs of the mesh, for each member."""
    sizes, sound = [], Rib.local

    def local(self, mesh, value):
        found = sound(self, mesh, value)
        sizes.append(found.vector.numel() * found.vector.element_size())
        assert found.vector.shape[-2] == self.n_row(mesh)
        return found

    monkeypatch.setattr(Rib, "local", local)
    memory = 2**21
    whole = PlateModel(
        MESH, {"plate": Plate(), "rib": Rib()}, PLATE | BEAM | {"rib.x0": 0.1, "rib.y0": 0.2, "rib.x1": 0.9},
        {"rib.y1": Searched(0.1, 0.9)},
    )  # fmt: skip
    theta = torch.linspace(0.2, 0.8, 40, dtype=torch.float64)[:, None]
    # In a basis of few columns its matrices are small beside the rows.
    model = whole.projected(torch.eye(whole.assembly.size, 12, dtype=torch.float64))
    expected = model.frf(theta, [50.0], [3], [7], "receptance")
    model.memory = memory
    sizes.clear()
    found = model.frf(theta, [50.0], [3], [7], "receptance")
    assert len(sizes) > 1
    assert max(sizes) <= memory // 8
    assert torch.allclose(found, expected, rtol=1e-9)
