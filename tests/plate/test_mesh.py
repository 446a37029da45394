"""Where nodes, elements and dofs are, and the deflection between them."""

import pytest
import torch
from torch.autograd import forward_ad

from torchplate.plate import Mesh
from torchplate.plate.transforms import REMEMBERED

PAPER = Mesh(0.48, 0.48, 10, 10)
RECTANGLE = Mesh(0.7, 0.3, 5, 3)


def cubic(place: torch.Tensor) -> torch.Tensor:
    """A field of the element's polynomial in relative coordinates, with no symmetry."""
    x, y = place[..., 0], place[..., 1]
    return 0.3 - x + 0.7 * y + 2 * x**2 - 1.1 * x * y + y**2 + x**3 - 0.4 * x**2 * y + 3 * x * y**2 - y**3 + x**3 * y


def dofs_of(mesh: Mesh) -> torch.Tensor:
    """The cubic field's w, ∂w/∂(y/Ly), −∂w/∂(x/Lx) at all nodes."""
    place = mesh.node_place.clone().requires_grad_()
    value = cubic(place)
    (slope,) = torch.autograd.grad(value.sum(), place)
    return torch.stack([value.detach(), slope[:, 1], -slope[:, 0]], dim=-1).flatten()


@pytest.mark.parametrize(("label", "place"), [(1, (0, 0)), (3, (0.2, 0)), (11, (1, 0)), (12, (0, 0.1)), (121, (1, 1))])
def test_nodes_of_the_papers_plate_count_along_x_first(label: int, place: tuple[float, float]) -> None:
    # Exact fractions up to the rounding of one division.
    torch.testing.assert_close(PAPER.places([label])[0], torch.tensor(place, dtype=torch.float64), rtol=0, atol=1e-15)
    torch.testing.assert_close(PAPER.node_place[label - 1], PAPER.places([label])[0], rtol=0, atol=1e-15)


def test_nodes_of_a_rectangle_count_along_x_first_too() -> None:
    assert (RECTANGLE.n_label, RECTANGLE.n_node, RECTANGLE.n_element, RECTANGLE.n_dof) == (24, 24, 15, 72)
    expected = torch.tensor([(1.0, 0.0), (0.0, 1 / 3), (0.8, 2 / 3)], dtype=torch.float64)
    torch.testing.assert_close(RECTANGLE.places([6, 7, 17]), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("mesh", [PAPER, RECTANGLE, Mesh(0.7, 0.3, 5, 3, refine=3)], ids=["paper", "5x3", "refined"])
def test_refining_keeps_every_label_at_its_place(mesh: Mesh) -> None:
    coarse = Mesh(mesh.length_x, mesh.length_y, mesh.n_x, mesh.n_y)
    labels = list(range(1, mesh.n_label + 1))
    assert torch.equal(mesh.places(labels), coarse.places(labels))
    assert mesh.n_node == (mesh.n_x * mesh.refine + 1) * (mesh.n_y * mesh.refine + 1)
    # Every labelled place is a node of the finer mesh: a node's row reads its w and nothing else.
    row = mesh.deflection_at(mesh.places(labels))
    torch.testing.assert_close(row.abs().sum(-1), torch.ones(mesh.n_label, dtype=torch.float64), rtol=0, atol=1e-12)
    torch.testing.assert_close(mesh.node_place[row.argmax(-1) // 3], mesh.places(labels), rtol=0, atol=1e-15)


def test_the_deflection_of_node_n_is_dof_3n_minus_2() -> None:
    for label in (1, 3, 11, 28, 102, 121):
        row = PAPER.deflection_at(PAPER.places([label]))[0]
        # The paper's FRF labels count dofs from 1: node 3 is dof 7, nodes 28, 102 and 104 are dofs 82, 304 and 310.
        assert row.argmax().item() + 1 == 3 * (label - 1) + 1
        expected = torch.zeros(363, dtype=torch.float64)
        expected[3 * (label - 1)] = 1.0
        torch.testing.assert_close(row, expected, rtol=0, atol=1e-12)


def test_an_element_joins_the_four_nodes_around_its_centre() -> None:
    corner_node = RECTANGLE.element_dof[:, ::3] // 3
    assert torch.equal(RECTANGLE.element_dof.reshape(15, 4, 3) % 3, torch.arange(3).expand(15, 4, 3))
    middle = RECTANGLE.node_place[corner_node].mean(1)
    torch.testing.assert_close(middle, RECTANGLE.element_place, rtol=0, atol=1e-15)
    step = RECTANGLE.node_place[corner_node] - RECTANGLE.element_place[:, None]
    around = torch.tensor([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * torch.tensor([0.1, 1 / 6], dtype=torch.float64)
    torch.testing.assert_close(step, around.expand(15, 4, 2), rtol=0, atol=1e-15)


@pytest.mark.parametrize("mesh", [PAPER, RECTANGLE, Mesh(0.7, 0.3, 2, 1, refine=2)], ids=["paper", "5x3", "refined"])
def test_a_cubic_field_is_read_exactly_between_the_nodes(mesh: Mesh) -> None:
    generator = torch.Generator().manual_seed(1)
    place = torch.rand(50, 2, generator=generator, dtype=torch.float64)
    # On edges, on the far corner and on lines between elements as well.
    place = torch.cat([place, torch.tensor([(1.0, 1.0), (1.0, 0.3), (0.77, 1.0), (0.2, 0.5)], dtype=torch.float64)])
    # Rounding of a row of twelve terms.
    torch.testing.assert_close(mesh.deflection_at(place) @ dofs_of(mesh), cubic(place), rtol=0, atol=1e-12)


def about(mesh: Mesh, dofs: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    """w and both relative slopes by `shapes_about` [place, 3]."""
    dof, every = mesh.shapes_about(place, (0, 0), (1, 0), (0, 1))
    return torch.stack([(value * dofs[dof]).sum(-1) for value in every], dim=-1)


# The hole's elements hold dofs of their own inside: whatever reads them sees these numbers.
HOLED = Mesh(0.7, 0.3, 8, 8, cut=((0.25, 0.25, 0.75, 0.75),))


@pytest.mark.parametrize("mesh", [RECTANGLE, HOLED], ids=["whole", "beside a hole"])
def test_about_a_place_a_cubic_field_is_read_exactly_and_nothing_of_a_hole(mesh: Mesh) -> None:
    generator = torch.Generator().manual_seed(2)
    place = torch.rand(200, 2, generator=generator, dtype=torch.float64)
    place = torch.cat([place, torch.tensor([(1.0, 1.0), (0.2, 0.5), (0.2, 0.3), (0.2499, 0.5)], dtype=torch.float64)])
    if mesh is HOLED:
        place = place[~((place - 0.5).abs() < 0.25).all(-1)]
    dofs = dofs_of(mesh)
    inside = ((mesh.node_place - 0.5).abs() < 0.2).all(-1) if mesh is HOLED else torch.zeros(24, dtype=torch.bool)
    dofs.unflatten(0, (-1, 3))[inside] = 1e3
    at = place.clone().requires_grad_()
    (slope,) = torch.autograd.grad(cubic(at).sum(), at)
    expected = torch.cat([cubic(place)[:, None], slope], dim=-1)
    torch.testing.assert_close(about(mesh, dofs, place), expected, rtol=0, atol=1e-11)


def test_about_a_place_slopes_go_over_from_element_to_element() -> None:
    dofs = torch.rand(RECTANGLE.n_dof, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    edge = torch.tensor([(0.4, 0.41), (0.4, 0.9), (0.33, 1 / 3), (0.07, 2 / 3)], dtype=torch.float64)
    step = 1e-7 * torch.tensor([(1.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, 1.0)], dtype=torch.float64)
    moved = about(RECTANGLE, dofs, edge + step) - about(RECTANGLE, dofs, edge - step)
    assert float(moved.abs().max()) < 1e-4
    slopes = [
        (RECTANGLE.deflection_at(at, 1, 0) + RECTANGLE.deflection_at(at, 0, 1)) @ dofs
        for at in (edge + step, edge - step)
    ]
    # Those of each element jump.
    assert float((slopes[0] - slopes[1]).abs().min()) > 0.01


def test_the_polynomial_goes_on_beyond_the_edge() -> None:
    place = torch.tensor([(-0.01, 0.4), (1.02, 0.5), (0.3, -0.02), (0.6, 1.03)], dtype=torch.float64)
    torch.testing.assert_close(RECTANGLE.deflection_at(place) @ dofs_of(RECTANGLE), cubic(place), rtol=0, atol=1e-12)


def test_the_deflection_follows_its_place_by_autograd_and_by_its_own_derivative() -> None:
    place = torch.tensor([(0.31, 0.47), (0.93, 0.12), (1.0, 1.0)], dtype=torch.float64, requires_grad=True)
    dofs = dofs_of(RECTANGLE)
    (expected,) = torch.autograd.grad(cubic(place).sum(), place)
    (found,) = torch.autograd.grad((RECTANGLE.deflection_at(place) @ dofs).sum(), place)
    own = torch.stack([RECTANGLE.deflection_at(place, *order) @ dofs for order in ((1, 0), (0, 1))], dim=-1)
    # Rounding, over elements a fifth and a third of the side.
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)
    torch.testing.assert_close(own, expected, rtol=0, atol=1e-12)


def test_places_keep_their_leading_dimensions() -> None:
    place = torch.rand(2, 3, 4, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    rows = RECTANGLE.deflection_at(place)
    assert rows.shape == (2, 3, 4, 72)
    torch.testing.assert_close(rows[1, 2], RECTANGLE.deflection_at(place[1, 2]), rtol=0, atol=0)


def test_labels_and_places_mix_in_one_list() -> None:
    found = RECTANGLE.places([6, [0.25, 0.75], (1.0, 0.0)])
    torch.testing.assert_close(
        found, torch.tensor([(1, 0), (0.25, 0.75), (1, 0)], dtype=torch.float64), rtol=0, atol=1e-15
    )


EDGE_NODES = {
    "x0": [0, 6, 12, 18],
    "x1": [5, 11, 17, 23],
    "y0": [0, 1, 2, 3, 4, 5],
    "y1": [18, 19, 20, 21, 22, 23],
}


@pytest.mark.parametrize("edge", list(EDGE_NODES))
def test_a_clamped_edge_holds_every_dof_of_its_nodes(edge: str) -> None:
    free = set(Mesh(0.7, 0.3, 5, 3, edges={edge: "clamped"}).free_dof.tolist())
    held = {3 * node + part for node in EDGE_NODES[edge] for part in range(3)}
    assert free == set(range(72)) - held


@pytest.mark.parametrize("edge", list(EDGE_NODES))
def test_a_simply_supported_edge_holds_the_deflection_and_the_slope_along_it(edge: str) -> None:
    free = set(Mesh(0.7, 0.3, 5, 3, edges={edge: "simply_supported"}).free_dof.tolist())
    # Along an edge x = constant the slope is dw/dy, the second dof; along y = constant it is −dw/dx, the third.
    slope = 1 if edge.startswith("x") else 2
    held = {3 * node + part for node in EDGE_NODES[edge] for part in (0, slope)}
    assert free == set(range(72)) - held


def test_a_corner_is_held_by_both_of_its_edges() -> None:
    edges = {"x0": "simply_supported", "y0": "simply_supported", "x1": "clamped", "y1": "free"}
    free = set(Mesh(0.7, 0.3, 5, 3, edges=edges).free_dof.tolist())
    assert not free & {0, 1, 2}
    assert not free & {15, 16, 17}
    assert free & {54, 55, 56} == {56}


def test_a_mesh_without_held_edges_is_free() -> None:
    assert RECTANGLE.free_dof.tolist() == list(range(72))
    named = Mesh(0.7, 0.3, 5, 3, edges=dict.fromkeys(EDGE_NODES, "free"))
    assert named.free_dof.tolist() == list(range(72))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length_x": 0.0}, r"mesh\.length_x above 0, got 0"),
        ({"length_y": -0.3}, r"mesh\.length_y above 0, got -0\.3"),
        ({"n_x": 0}, r"mesh\.n_x above 0, got 0"),
        ({"n_y": -2}, r"mesh\.n_y above 0, got -2"),
        ({"refine": 0}, r"mesh\.refine above 0, got 0"),
        ({"edges": {"left": "clamped"}}, r"No edge named 'left'.*x0, x1, y0, y1"),
        ({"edges": {"x1": "glued"}}, r"mesh\.edges\.x1 .*simply_supported.*'glued'"),
    ],
)
def test_a_mesh_that_cannot_be_says_what_to_mend(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mesh(**{"length_x": 0.7, "length_y": 0.3, "n_x": 5, "n_y": 3, **change})


@pytest.mark.parametrize(
    ("point", "message"),
    [
        (0, "labels from 1 to 24 on a 5 × 3 mesh, got 0"),
        (25, "labels from 1 to 24 on a 5 × 3 mesh, got 25"),
        ((0.2, 1.01), r"both from 0 to 1, got \[0\.2, 1\.01\]"),
        ((-0.1, 0.5), r"both from 0 to 1, got \[-0\.1, 0\.5\]"),
        ((float("nan"), 0.5), r"both from 0 to 1, got \[nan, 0\.5\]"),
        ((0.1, 0.2, 0.3), r"got \[0\.1, 0\.2, 0\.3\]"),
    ],
)
def test_a_point_off_the_plate_is_refused(point: int | tuple[float, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RECTANGLE.places([1, point])


def test_a_tensor_of_places_passes_with_its_gradient() -> None:
    place = torch.tensor([(0.31, 0.2), (0.84, 0.77)], dtype=torch.float64, requires_grad=True)
    assert RECTANGLE.places(place) is place
    value = RECTANGLE.deflection_at(RECTANGLE.places(place)) @ dofs_of(RECTANGLE)
    (slope,) = torch.autograd.grad(value.sum(), place)
    (expected,) = torch.autograd.grad(cubic(place).sum(), place)
    # The element holds this cubic exactly, so rounding is all that parts the two.
    torch.testing.assert_close(slope, expected, rtol=0, atol=1e-11)


def test_rows_of_places_that_stay_are_made_once() -> None:
    place, other = (torch.tensor([[0.31, 0.62], [0.1, end]], dtype=torch.float64) for end in (0.9, 0.8))
    mesh = Mesh(0.7, 0.4, 6, 4)
    first = mesh.deflection_at(place)
    assert mesh.deflection_at(place.clone()) is first
    for found, expected in (
        (mesh.deflection_at(other), mesh._deflection_at(other, 0, 0)),
        (mesh.deflection_at(place, 1, 0), mesh._deflection_at(place, 1, 0)),
        (mesh.deflection_at(place.float()), mesh._deflection_at(place.float(), 0, 0)),
    ):
        assert torch.equal(found, expected)
        assert found is not first
    many = torch.rand(REMEMBERED, 1, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    for one in many:
        mesh.deflection_at(one)
    assert len(mesh._known_deflection) <= REMEMBERED


# torch.func.jacfwd loads its own rules by torch.jit.script, which warns of itself.
@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")
def test_rows_are_made_anew_where_something_is_differentiated_by_the_place_or_mapped_over_it() -> None:
    place, mesh = torch.tensor([[0.31, 0.62]], dtype=torch.float64), Mesh(0.7, 0.4, 6, 4)
    constant = mesh.deflection_at(place)
    moving = place.clone().requires_grad_()
    assert mesh.deflection_at(moving).requires_grad
    forward, reverse = (way(mesh.deflection_at)(place) for way in (torch.func.jacfwd, torch.func.jacrev))
    assert bool(forward.any())
    torch.testing.assert_close(forward, reverse)
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(place, torch.ones_like(place))
        tangent = forward_ad.unpack_dual(mesh.deflection_at(dual)).tangent
    torch.testing.assert_close(tangent, forward.sum((-2, -1)))
    mapped = torch.func.vmap(mesh.deflection_at)(torch.stack([place, place + 0.1]))
    torch.testing.assert_close(mapped[0], constant)
    with torch.inference_mode():
        seen = Mesh(0.7, 0.4, 6, 4)
        seen.deflection_at(place)
    assert not seen._known_deflection


def test_a_rectangle_covers_of_each_element_what_lies_within_and_nothing_of_its_neighbours():
    """An element beside it that shares its span along one side alone is not touched."""
    over_x, over_y = ((torch.tensor(a).double(), torch.tensor(b).double()) for a, b in ((0.3, 0.7), (0.5, 0.9)))
    of_x, of_y = (part.reshape(3, 5) for part in RECTANGLE.overlap(over_x, over_y))
    # Fifths from 0.3 to 0.7, and thirds from 0.5 to 0.9.
    along_x, along_y = torch.tensor([0.0, 0.5, 1.0, 0.5, 0.0]).double(), torch.tensor([0.0, 0.5, 0.7]).double()
    touched = (along_x > 0) & (along_y[:, None] > 0)
    assert int(touched.sum()) == 6
    torch.testing.assert_close(of_x, torch.where(touched, along_x, 0.0))
    torch.testing.assert_close(of_y, torch.where(touched, along_y[:, None], 0.0))
