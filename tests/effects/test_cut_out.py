"""A hole whose corners are numbers, against the same hole left out of the mesh."""

import pytest
import torch

from torchplate.effects import (
    CutOut,
    DampingPatch,
    DirectionalDamping,
    Effect,
    HystereticDamping,
    Plate,
    StiffnessLoss,
    SupportSpring,
)
from torchplate.effects.cut_out import MASS_LEFT
from torchplate.model import PlateModel, Searched, SparseModel, sharing_modes
from torchplate.plate import Mesh, uneven_mass_coefficient

NONE = torch.zeros(0, dtype=torch.float64)
METAL = {
    "plate.youngs_modulus": 69e9, "plate.poisson_ratio": 0.31, "plate.density": 2710.0, "plate.thickness": 0.0031,
}  # fmt: skip
HOLES = {"hole": (0.3, 0.25, 0.6, 0.5), "notch": (0.7, 0.25, 1.0, 0.5), "corner": (0.7, 0.0, 1.0, 0.5)}
LINES = torch.linspace(20.0, 500.0, 121, dtype=torch.float64)
SIDES, CELLS = (0.5, 0.4), (10, 8)


def build(corners: tuple[float, ...] | None, cut: tuple[tuple[float, ...], ...] = (), refine: int = 1) -> PlateModel:
    effects, known = {"plate": Plate(), "loss": HystereticDamping()}, METAL | {"loss.stiffness_loss_factor": 0.01}
    if corners is not None:
        effects["hole"] = CutOut()
        known |= {f"hole.{name}": value for name, value in zip(CutOut.parameters, corners, strict=True)}
    mesh = Mesh(*SIDES, *CELLS, refine=refine, cut=cut)
    return PlateModel(mesh, effects, known, response=[3, (0.15, 0.9)], reference=[(0.05, 0.1)])


@pytest.mark.parametrize("name", list(HOLES))
def test_on_lines_of_the_mesh_it_is_the_hole_that_is_left_out(name: str) -> None:
    corners = HOLES[name]
    smooth, known = build(corners), build(None, (corners,))
    # A 1e-6 of the stiffness is left, and each mode feels it less than that.
    torch.testing.assert_close(
        smooth.natural_frequencies(NONE, 12)[3:], known.natural_frequencies(NONE, 12)[3:], rtol=2e-4, atol=0
    )
    found, expected = smooth.frf(NONE, LINES), known.frf(NONE, LINES)
    # Of a resonance of 1 % width the shift is seen a hundred times over.
    assert float((found - expected).norm() / expected.norm()) < 1e-2


def test_what_is_left_of_it_vibrates_far_above_the_band() -> None:
    found = build(HOLES["hole"]).natural_frequencies(NONE, 30)
    expected = build(None, (HOLES["hole"],)).natural_frequencies(NONE, 30)
    torch.testing.assert_close(found[3:], expected[3:], rtol=1e-3, atol=0)


def test_its_corners_may_come_in_any_order_and_reach_over_the_plate() -> None:
    x0, y0, x1, y1 = HOLES["hole"]
    expected = build(HOLES["hole"]).natural_frequencies(NONE, 8)
    torch.testing.assert_close(build((x1, y0, x0, y1)).natural_frequencies(NONE, 8), expected)
    torch.testing.assert_close(build((x1, y1, x0, y0)).natural_frequencies(NONE, 8), expected)


def test_between_lines_of_the_mesh_its_error_falls_with_the_mesh() -> None:
    corners = (0.32, 0.3, 0.58, 0.55)
    # On lines of a mesh of 50 × 40.
    coarse, fine, exact = (SparseModel(build(corners, refine=k), NONE).modes(9).frequency[3:9] for k in (1, 3, 5))
    off = [float((found / exact - 1).abs().max()) for found in (coarse, fine)]
    # Measured 2.3 and 0.41 %, the mesh's own error in it; 4.1 and 1.1 % if an element that is cut is one of a mean.
    assert off[0] < 0.025
    assert off[1] < 0.005


def test_an_element_that_is_cut_loses_where_there_is_plate() -> None:
    """A loss of the elements' own that is the same everywhere is one of the whole plate, wherever the hole is."""
    corners = (0.32, 0.3, 0.58, 0.55)
    everywhere = {f"own.loss_{axis}": 0.01 for axis in ("x", "y", "xy")}
    hole = {f"hole.{name}": value for name, value in zip(CutOut.parameters, corners, strict=True)}
    for order in (("own", "hole"), ("hole", "own")):
        kinds = {"own": DirectionalDamping(), "hole": CutOut()}
        effects = {"plate": Plate(), **{label: kinds[label] for label in order}}
        model = PlateModel(Mesh(*SIDES, *CELLS), effects, METAL | everywhere | hole)
        system = model.system(NONE[None])
        torch.testing.assert_close(system.hysteretic, 0.01 * system.stiffness, rtol=1e-9, atol=1e-9)


def test_without_an_extent_it_is_not_there() -> None:
    found = build((0.4, 0.2, 0.4, 0.7)).frf(NONE, LINES)
    torch.testing.assert_close(found, build(None).frf(NONE, LINES), rtol=1e-7, atol=0)  # rounding


def test_what_stands_in_a_hole_is_refused_with_its_label():
    wire = {"wire.stiffness": 1e3, "wire.viscous_damping": 0.1}
    mesh = Mesh(0.6, 0.4, 6, 4, cut=((1 / 3, 0.25, 2 / 3, 0.75),))
    with pytest.raises(ValueError, match=r"wire: Expected points on the plate, got .*inside a hole"):
        PlateModel(mesh, {"plate": Plate(), "wire": SupportSpring(nodes=[18])}, METAL | wire)


def test_plates_whose_hole_is_searched_share_no_modes() -> None:
    """At the ends of all four intervals there is no hole, or no plate: multiples of one plate."""
    effects = {"plate": Plate(), "loss": HystereticDamping(), "hole": CutOut()}
    known = METAL | {"loss.stiffness_loss_factor": 0.01}
    searched = {f"hole.{name}": Searched(0.0, 1.0) for name in CutOut.parameters}
    model = PlateModel(Mesh(*SIDES, *CELLS), effects, known, searched, [3], [(0.05, 0.1)])
    theta = torch.tensor([HOLES["hole"]], dtype=torch.float64)
    assert sharing_modes(model.projected(model.modes(theta).shape[0, :, :40])) is None


def test_a_model_says_whether_there_is_a_hole() -> None:
    corners = HOLES["hole"]
    assert [model.has_hole(NONE) for model in (build(None), build(corners), build(None, (corners,)))] == [
        False,
        True,
        True,
    ]


def test_where_the_base_moves_the_plate_it_is_as_heavy_as_what_is_left_of_it() -> None:
    corners = (0.32, 0.3, 0.58, 0.55)
    model = build(corners)
    plan = model.plan(NONE)
    heavy = uneven_mass_coefficient(plan.section, plan.geometry)
    load = model.assembly.translation_load(plan.section.areal_mass, plan.geometry, heavy)
    rigid = model.mesh.rigid_translation
    torch.testing.assert_close(load, model.system(NONE).mass @ rigid)
    left = 1 - (1 - MASS_LEFT) * (corners[2] - corners[0]) * (corners[3] - corners[1])
    plate = METAL["plate.density"] * METAL["plate.thickness"] * SIDES[0] * SIDES[1]
    assert float(load @ rigid) == pytest.approx(left * plate, rel=1e-12)


@pytest.mark.parametrize(
    "second",
    [
        (CutOut, (0.37, 0.36, 0.64, 0.61)),
        (CutOut, (0.55, 0.52, 0.71, 0.66)),
        (StiffnessLoss, (0.5, 0.45, 0.31, 0.3, 0.7)),
        (DampingPatch, (0.5, 0.45, 0.31, 0.2, 0.7)),
    ],
)
@pytest.mark.parametrize("turn", [False, True])
def test_what_a_hole_cuts_may_be_cut_by_something_else(second: tuple[type[Effect], tuple], turn: bool) -> None:
    """Neither mass nor stiffness nor loss is negative anywhere, whichever comes first."""
    kind, numbers = second
    kinds = {"hole": CutOut(), "other": kind()}
    known = METAL | {
        f"hole.{name}": value for name, value in zip(CutOut.parameters, (0.32, 0.3, 0.58, 0.55), strict=True)
    }
    known |= {f"other.{name}": value for name, value in zip(kind.parameters, numbers, strict=True)}
    effects = {"plate": Plate(), **{label: kinds[label] for label in sorted(kinds, reverse=turn)}}
    system = PlateModel(Mesh(*SIDES, *CELLS), effects, known).system(NONE)
    for matrix in (system.mass, system.stiffness, system.hysteretic):
        if matrix is not None:
            # In units of each dof's own, of which slopes and deflections have others.
            scale = matrix.diagonal().abs().clamp(min=1e-300).rsqrt()
            assert float(torch.linalg.eigvalsh(scale[:, None] * matrix * scale)[0]) > -1e-9


@pytest.mark.parametrize("part", [0.001, 0.003, 0.008, 0.03])
def test_a_sliver_of_an_element_costs_no_digits_and_has_no_mode_in_the_band(part: float) -> None:
    """What is left of elements that a hole covers but for a small part, along two of its sides."""
    model, without = (build((0.3 + one / 10, 0.25 + one / 8, 0.6, 0.5)) for one in (part, 0.0))
    found, expected = model.frf(NONE, LINES), model.frf_direct(NONE, LINES)
    assert float((found - expected).norm() / expected.norm()) < 1e-8
    torch.testing.assert_close(
        model.natural_frequencies(NONE, 25)[3:], without.natural_frequencies(NONE, 25)[3:], rtol=0.01, atol=0
    )
