"""Air around a plate."""

import pytest
import torch

from torchplate.effects import AirLoading, AspectRatio, HystereticDamping, Orthotropy, Plate, SupportSpring
from torchplate.model import PlateModel, Searched, SparseModel, extrapolate, reduce
from torchplate.plate import Geometry, Mesh

NONE = torch.zeros(0, dtype=torch.float64)
LINES = torch.linspace(20.0, 400.0, 61, dtype=torch.float64)
STEEL = (2.1e11, 0.3, 7860.0, 0.0027)
ALUMINIUM = (7.0e10, 0.33, 2700.0, 0.003)
# A spruce plate of 236 g: √(E_x E_y) of 9.65 and 0.783 GPa, G = 0.513 GPa.
SPRUCE = (2.749e9, 0.2, 396.6, 0.00481)


def plate(numbers: tuple[float, ...]) -> dict[str, float]:
    names = ("youngs_modulus", "poisson_ratio", "density", "thickness")
    return {f"plate.{name}": value for name, value in zip(names, numbers, strict=True)}


def build(mesh: Mesh, numbers: tuple[float, ...], density: float, searched: dict | None = None, **more) -> PlateModel:
    effects = {
        "plate": Plate(),
        "wires": SupportSpring(at=((0.21, 0.0), (0.66, 0.94))),
        "loss": HystereticDamping(),
        "air": AirLoading(),
    }
    known = plate(numbers) | {"wires.stiffness": 900.0, "loss.stiffness_loss_factor": 0.01, "air.density": density}
    known = {key: value for key, value in known.items() if key not in (searched or {})}
    return PlateModel(mesh, effects, known, searched, [3, (0.6, 0.7)], [8], "accelerance", **more)


def lowering(mesh: Mesh, numbers: tuple[float, ...], grain: dict[str, float] | None = None) -> torch.Tensor:
    """By how much air lowers the natural frequencies of a free plate [-], the lowest flexible ones first."""
    found = []
    for density in (0.0, 1.2):
        effects = {"plate": Plate(), "air": AirLoading()} | ({"grain": Orthotropy()} if grain else {})
        model = PlateModel(mesh, effects, plate(numbers) | {"air.density": density} | (grain or {}))
        found.append(model.natural_frequencies(NONE, 11)[3:])
    return 1 - found[1] / found[0]


def distance(first: torch.Tensor, second: torch.Tensor) -> float:
    return float((first - second).norm() / second.norm())


@pytest.mark.parametrize(
    ("mesh", "numbers", "grain", "between"),
    [
        (Mesh(0.48, 0.48, 12, 12), STEEL, None, (0.0015, 0.0032)),
        (Mesh(0.9, 0.6, 12, 10), ALUMINIUM, None, (0.007, 0.0125)),
        (
            Mesh(0.5798, 0.2134, 14, 8), SPRUCE,
            {"grain.young_ratio": 0.783 / 9.65, "grain.shear_factor": 0.513 / (2.749 / 2.4)}, (0.012, 0.029),
        ),
    ],
    ids=["the paper's plate", "large aluminium", "spruce"],
)  # fmt: skip
def test_it_lowers_natural_frequencies_as_a_doublet_lattice_does(mesh, numbers, grain, between):
    # A doublet lattice of another hand found 0.2 to 0.3 %, 0.8 to 1.2 % and 1.6 to 2.7 % of the lowest.
    found = lowering(mesh, numbers, grain)
    assert between[0] < float(found.min())
    assert float(found.max()) < between[1]
    # One number for all would be a density.
    assert float(found.max()) > 1.3 * float(found.min())


def test_it_goes_with_the_cube_of_the_size():
    small, large = (lowering(Mesh(0.5 * size, 0.3 * size, 8, 6), (7e10, 0.33, 2700.0, 0.003 * size)) for size in (1, 3))
    torch.testing.assert_close(small, large, rtol=1e-6, atol=0.0)
    sides = Geometry(torch.tensor([0.5, 1.0]).double(), torch.tensor([0.3, 0.6]).double())
    one, eight = AirLoading().added_mass(Mesh(0.5, 0.3, 6, 4), sides, {"density": torch.tensor(1.2)}).coefficient
    assert float(eight / one) == pytest.approx(8.0, rel=1e-6)
    mesh, effects = Mesh(0.5, 0.3, 6, 4), {"plate": Plate(), "air": AirLoading(), "stretch": AspectRatio()}
    model = PlateModel(mesh, effects, plate(STEEL) | {"air.density": 1.2, "stretch.ratio": 1.05})
    rigid = mesh.rigid_translation
    # The area is kept, and the air with it.
    own = [float(rigid @ one.system(NONE).mass @ rigid) for one in (model, build(mesh, STEEL, 1.2))]
    assert own[0] == pytest.approx(own[1], rel=1e-9)


def test_a_base_that_moves_moves_the_air_too():
    mesh = Mesh(0.5, 0.3, 6, 4)
    model = build(mesh, ALUMINIUM, 1.2)
    load = model.excitation(model.plan(NONE), None)[0]
    torch.testing.assert_close(load, model.system(NONE).mass @ mesh.rigid_translation, rtol=1e-9, atol=1e-12)


@pytest.mark.check
def test_without_air_sparse_matrices_are_those_of_the_plate_alone():
    """A density of zero, as in a vacuum."""
    mesh = Mesh(0.5, 0.3, 6, 4)
    empty, airy = (SparseModel(build(mesh, SPRUCE, density), NONE) for density in (0.0, 1.2))
    model = PlateModel(
        mesh,
        {"plate": Plate(), "wires": SupportSpring(at=((0.21, 0.0), (0.66, 0.94))), "loss": HystereticDamping()},
        plate(SPRUCE) | {"wires.stiffness": 900.0, "loss.stiffness_loss_factor": 0.01},
        {},
        [3, (0.6, 0.7)],
        [8],
        "accelerance",
    )
    bare = SparseModel(model, NONE)
    # Rounding of solves without pivots.
    assert distance(empty.frf(LINES), bare.frf(LINES)) < 1e-7
    assert distance(airy.frf(LINES), bare.frf(LINES)) > 1e-3
    torch.testing.assert_close(
        empty.modes(12, dense=False).frequency[:12], model.natural_frequencies(NONE, 12), rtol=1e-6, atol=1e-4
    )


@pytest.mark.check
@pytest.mark.parametrize("edges", [{}, {"y1": "clamped"}], ids=["free", "clamped"])
def test_sparse_matrices_answer_as_dense_ones_do(edges):
    model = build(Mesh(0.5, 0.3, 6, 4, edges=edges), SPRUCE, 1.2)
    for one in (model, extrapolate(model, 200.0).model):
        sparse = SparseModel(one, NONE)
        # Rounding of solves without pivots.
        assert distance(sparse.frf(LINES), one.frf_direct(NONE, LINES)) < 1e-7
    sparse = SparseModel(model, NONE)
    for way in (True, False):
        found = sparse.modes(12, dense=way).frequency[:12]
        torch.testing.assert_close(found, model.natural_frequencies(NONE, 12), rtol=1e-6, atol=1e-4)


def test_plates_of_one_mass_share_their_modes_in_air_as_they_do_without():
    searched = {"plate.youngs_modulus": Searched(5e10, 9e10), "wires.stiffness": Searched(300.0, 2000.0)}
    model = build(Mesh(0.5, 0.3, 6, 4), ALUMINIUM, 1.2, searched)
    outcome = reduce(model, LINES)
    assert outcome is not None
    small, error = outcome
    assert small.shared_modes is not None
    theta = model.space.to_si(torch.rand(5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2)))
    assert distance(small.frf(theta, LINES), model.frf(theta, LINES)) < 5 * max(error, 1e-9)


@pytest.mark.parametrize("name", ["plate.density", "air.density"])
@pytest.mark.check
def test_plates_whose_air_is_another_part_of_their_mass_have_modes_of_their_own(name: str):
    ends = {"plate.density": (2500.0, 2900.0), "air.density": (1.0, 1.4)}[name]
    searched = {"plate.youngs_modulus": Searched(6e10, 8e10), name: Searched(*ends)}
    model = build(Mesh(0.5, 0.3, 8, 6), ALUMINIUM, 1.2, searched)
    outcome = reduce(model, LINES)
    assert outcome is not None
    small, _ = outcome
    assert small.shared_modes is None
    theta = model.space.to_si(torch.rand(4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(5)))
    # Ten times the tolerance of `reduce`: other members than it looked at.
    assert distance(small.frf(theta, LINES), model.frf(theta, LINES)) < 1e-3


def test_the_air_in_a_basis_is_found_once_and_in_another_anew():
    mesh = Mesh(0.5, 0.3, 6, 4)
    model = build(mesh, ALUMINIUM, 1.2)
    plan = model.plan(NONE)
    assembly, added = model.assembly, plan.added[0]
    whole = assembly.added_mass(added)
    assert assembly.added_mass(added) is whole
    basis = torch.linalg.qr(torch.randn(assembly.size, 5, generator=torch.Generator().manual_seed(1)).double())[0]
    few = model.projected(basis).assembly
    found = few.added_mass(added)
    assert few.added_mass(added) is found
    torch.testing.assert_close(found, basis.mT @ whole @ basis, rtol=1e-9, atol=1e-15)
    few.basis = 2 * basis
    torch.testing.assert_close(few.added_mass(added), 4 * found, rtol=1e-9, atol=1e-15)
