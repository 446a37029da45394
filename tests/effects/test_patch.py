"""A patch of other stiffness or damping: what it covers, and what it does there."""

import math

import pytest
import torch

from torchplate.effects import DampingPatch, HystereticDamping, Plate, StiffnessLoss
from torchplate.model import PlateModel
from torchplate.model.discretisation.extrapolation import extrapolate
from torchplate.model.discretisation.fine_mesh import SparseModel
from torchplate.plate import Mesh, element

STEEL = {"plate.youngs_modulus": 205e9, "plate.poisson_ratio": 0.29, "plate.density": 7850.0, "plate.thickness": 0.002}
NONE = torch.zeros(0, dtype=torch.float64)
RECTANGLE, SQUARE = Mesh(0.6, 0.3, 6, 5), Mesh(0.4, 0.4, 4, 4)
LINES = torch.linspace(20.0, 300.0, 29, dtype=torch.float64)


def _coverage(mesh: Mesh, x: float, y: float, size: float, aspect: float = 1.0) -> torch.Tensor:
    given = (torch.tensor(number, dtype=torch.float64) for number in (x, y, size, aspect))
    along_x, along_y = mesh.coverage(*given)
    return along_x * along_y


def _model(mesh: Mesh, effect, value: dict[str, float], beta: float = 0.0) -> PlateModel:
    effects = {"plate": Plate(), "loss": HystereticDamping(), "patch": effect()}
    known = STEEL | {"loss.stiffness_loss_factor": beta} | {f"patch.{key}": number for key, number in value.items()}
    return PlateModel(mesh, effects, known)


@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
@pytest.mark.parametrize(
    ("x", "y", "size", "part"), [(0.43, 0.56, 0.31, 1.0), (0.0, 0.47, 0.2, 0.5), (1.0, 1.0, 0.35, 0.25)]
)
def test_coverage_adds_up_to_the_patchs_area_on_the_plate(mesh, x, y, size, part):
    area = mesh.length_x * mesh.length_y
    covered = float(_coverage(mesh, x, y, size).sum()) * area / mesh.n_element
    # A square of that side over √area, and of it what an edge or a corner cuts off.
    assert covered == pytest.approx(part * (size * math.sqrt(area)) ** 2, rel=1e-12)


@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
def test_coverage_is_the_part_of_each_element_within_the_square(mesh):
    x, y, size = 0.37, 0.61, 0.44
    half = size * math.sqrt(mesh.length_x * mesh.length_y) / 2
    found, n = _coverage(mesh, x, y, size), 400
    for index, centre in enumerate(mesh.element_place.tolist()):
        # Points of a fine grid over the element, in metres from the centre of the patch.
        grid = (torch.arange(n) + 0.5) / n - 0.5
        along = [
            ((c + grid / cells - place) * side).abs() < half
            for c, cells, place, side in zip(centre, mesh.cells, (x, y), (mesh.length_x, mesh.length_y), strict=True)
        ]
        counted = float(along[0].double().mean() * along[1].double().mean())
        assert float(found[index]) == pytest.approx(counted, abs=2.1 / n)  # a grid line more or less on each axis


@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
@pytest.mark.parametrize("aspect", [0.5, 2.5])
def test_an_aspect_makes_a_patch_longer_along_x_and_keeps_its_area(mesh, aspect):
    size, area = 0.2, mesh.length_x * mesh.length_y
    found = _coverage(mesh, 0.48, 0.52, size, aspect)
    assert float(found.sum()) * area / mesh.n_element == pytest.approx(size**2 * area, rel=1e-12)
    along_x, along_y = mesh.coverage(
        *(torch.tensor(number, dtype=torch.float64) for number in (0.48, 0.52, size, aspect))
    )
    # Sides in metres: what is covered of a row of elements, and of a column.
    n_x, n_y = mesh.cells
    sides = (
        float(along_x.reshape(n_y, n_x).sum(-1).max()) * mesh.length_x / n_x,
        float(along_y.reshape(n_y, n_x).sum(0).max()) * mesh.length_y / n_y,
    )
    assert sides[0] / sides[1] == pytest.approx(aspect, rel=1e-12)


@pytest.mark.parametrize(
    ("effect", "strength"), [(StiffnessLoss, {"factor": 0.4}), (DampingPatch, {"loss_factor": 0.3})]
)
def test_a_patch_turned_with_its_plate_is_one_of_the_inverse_aspect(effect, strength):
    here = {"x": 0.3, "y": 0.6, "size": 0.25, "aspect": 1.8} | strength
    turned = {"x": 0.6, "y": 0.3, "size": 0.25, "aspect": 1 / 1.8} | strength
    frfs = []
    for sides, value, places in (
        ((0.5, 0.3), here, ((0.2, 0.1), (0.7, 0.9))),
        ((0.3, 0.5), turned, ((0.1, 0.2), (0.9, 0.7))),
    ):
        model = _model(Mesh(*sides, 6, 6), effect, value, beta=2e-3)
        frfs.append(model.frf(NONE, LINES, response=[places[0]], reference=[places[1]]))
    assert torch.allclose(frfs[0], frfs[1], rtol=1e-9)
    square = _model(Mesh(0.5, 0.3, 6, 6), effect, here | {"aspect": 1.0}, beta=2e-3)
    other = square.frf(NONE, LINES, response=[(0.2, 0.1)], reference=[(0.7, 0.9)])
    assert float((other - frfs[0]).norm() / frfs[0].norm()) > 1e-3


def test_a_loss_softens_the_elements_it_covers_and_no_others():
    # A square of 0.2 m over four of the elements of 0.1 m: the second and third columns, the upper two rows.
    mesh = Mesh(0.6, 0.3, 6, 3)
    size = 0.2 / math.sqrt(0.18)
    patch = {"x": 2 / 6, "y": 2 / 3, "size": size}
    covered = [row * 6 + column for row in (1, 2) for column in (1, 2)]
    found = _model(mesh, StiffnessLoss, patch | {"factor": 0.3}).system(NONE).stiffness
    bare = _model(mesh, StiffnessLoss, patch | {"factor": 1.0}).system(NONE).stiffness
    damped = _model(mesh, DampingPatch, patch | {"loss_factor": 0.05}).system(NONE).hysteretic
    rigidity = _model(mesh, StiffnessLoss, patch).plan(NONE).section.rigidity[0]
    # Elements in metres, and their dofs on the unit square: w, b tx, a ty.
    scale = torch.tensor([1.0, 1 / mesh.length_y, 1 / mesh.length_x], dtype=torch.float64).repeat(4)
    one = element.stiffness(rigidity, 0.1, 0.1) * scale[:, None] * scale
    expected = torch.zeros_like(bare)
    for index in covered:
        dof = mesh.element_dof[index]
        expected[dof[:, None], dof] += one
    assert torch.allclose(found - bare, -0.7 * expected, atol=1e-10 * float(bare.abs().max()))
    assert torch.allclose(damped, 0.05 * expected, atol=1e-10 * float(bare.abs().max()))


def test_elements_that_its_edges_cut_are_as_soft_as_the_patch_makes_them():
    # Its edges are at 3/8 and 5/8: on 16 elements a side they are edges of elements, on 12 they halve some.
    plates = {
        n: extrapolate(_model(Mesh(0.4, 0.4, n, n), StiffnessLoss, {"x": 0.5, "y": 0.5, "size": 0.25, "factor": 0.3}))
        for n in (12, 16, 20)
    }
    cut, exact, cut_less = (SparseModel(one.model, NONE).modes(15).frequency[3:15] for one in plates.values())
    # Means of the stiffness over the cut elements would be off by 1.5 %.
    assert float((cut / exact - 1).abs().max()) < 3e-3
    assert float((cut_less / exact - 1).abs().max()) < 1e-3


def test_a_patch_over_half_of_an_element_is_a_laminate():
    # One element, its half softer: across the cut compliances add, along it stiffnesses, ν = 0.
    model = _model(Mesh(0.4, 0.4, 1, 1), StiffnessLoss, {"x": 0.0, "y": 0.5, "size": 1.0, "factor": 0.25})
    model.known[model_index(model, "plate.poisson_ratio")] = 0.0
    sound = 205e9 * 0.002**3 / 12
    rigidity = model.plan(NONE).section.rigidity[0]
    across, along, twist = rigidity.diagonal().tolist()
    assert across / sound == pytest.approx(1 / (0.5 + 0.5 / 0.25), rel=1e-12)
    assert along / sound == pytest.approx(0.5 + 0.5 * 0.25, rel=1e-12)
    assert twist / (sound / 2) == pytest.approx(0.5 + 0.5 * 0.25, rel=1e-12)


def test_a_patch_turned_with_the_plate_is_the_same():
    one = _model(Mesh(0.6, 0.3, 7, 4), StiffnessLoss, {"x": 0.41, "y": 0.33, "size": 0.3, "factor": 0.3})
    turned = _model(Mesh(0.3, 0.6, 4, 7), StiffnessLoss, {"x": 0.33, "y": 0.41, "size": 0.3, "factor": 0.3})
    found, expected = (model.natural_frequencies(NONE, 12)[3:] for model in (turned, one))
    assert torch.allclose(found, expected, rtol=1e-9)


def model_index(model: PlateModel, name: str) -> int:
    return list(model.known_values).index(name)


def test_a_patch_over_the_whole_plate_is_another_plate():
    whole = {"x": 0.5, "y": 0.5, "size": 1.0}
    bare, soft = (_model(SQUARE, StiffnessLoss, whole | {"factor": factor}) for factor in (1.0, 0.49))
    frequencies = [model.natural_frequencies(NONE, 12)[3:] for model in (bare, soft)]
    assert torch.allclose(frequencies[1], 0.7 * frequencies[0], rtol=1e-8)
    # With a loss of its own besides, the two add.
    damped = _model(SQUARE, DampingPatch, whole | {"loss_factor": 0.03}, beta=0.01)
    plain = _model(SQUARE, DampingPatch, whole, beta=0.04)
    frfs = [model.frf(NONE, LINES, [3], [(0.2, 0.9)]) for model in (damped, plain)]
    assert torch.allclose(*frfs, rtol=1e-8)


def test_two_damping_patches_add():
    mesh, first, second = RECTANGLE, {"x": 0.3, "y": 0.4, "size": 0.3}, {"x": 0.4, "y": 0.6, "size": 0.2}
    effects = {"plate": Plate(), "a": DampingPatch(), "b": DampingPatch()}
    known = {f"{label}.{key}": n for label, one in (("a", first), ("b", second)) for key, n in one.items()}
    known |= {"a.loss_factor": 0.2, "b.loss_factor": 0.07}
    found = PlateModel(mesh, effects, STEEL | known).plan(NONE).section.loss_factor
    expected = 0.2 * _coverage(mesh, **first) + 0.07 * _coverage(mesh, **second)
    # In a cut element that is what a mean makes of it; D₃₃ is one.
    assert torch.allclose(found[..., 3], expected, rtol=1e-12)
    whole = ((expected - 0.2).abs() < 1e-12) | ((expected - 0.27).abs() < 1e-12) | (expected == 0)
    assert 0 < int(whole.sum()) < mesh.n_element
    assert torch.allclose(found[whole], expected[whole, None].expand(-1, 4), rtol=1e-12)


def test_a_lossy_patch_over_half_of_an_element_is_a_laminate():
    # Layers one after the other: the complex compliances add; beside each other: the stiffnesses.
    model = _model(Mesh(0.4, 0.4, 1, 1), DampingPatch, {"x": 0.0, "y": 0.5, "size": 1.0, "loss_factor": 0.5})
    model.known[model_index(model, "plate.poisson_ratio")] = 0.0
    sound = 205e9 * 0.002**3 / 12
    section = model.plan(NONE).section
    found = torch.complex(section.rigidity[0].diagonal(), section.lossy_rigidity[0].diagonal()) / sound
    expected = [1 / (0.5 + 0.5 / (1 + 0.5j)), 1 + 0.25j, (1 + 0.25j) / 2]
    assert torch.allclose(found, torch.tensor(expected, dtype=torch.complex128), rtol=1e-12)
