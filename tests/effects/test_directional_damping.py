"""Loss factors of E_x, E_y and G_xy."""

import pytest
import torch

from torchplate.effects import DampingPatch, DirectionalDamping, HystereticDamping, Orthotropy, Plate
from torchplate.model import PlateModel
from torchplate.plate import Mesh

NONE = torch.zeros(0, dtype=torch.float64)
LINES = torch.linspace(20.0, 400.0, 61, dtype=torch.float64)
WOOD = {"plate.youngs_modulus": 3e9, "plate.poisson_ratio": 0.28, "plate.density": 430.0, "plate.thickness": 0.003}
GRAIN = {"grain.young_ratio": 0.1, "grain.shear_factor": 0.7}
MESH = Mesh(0.5, 0.3, 8, 6)


def build(mesh: Mesh, **numbers: dict[str, float]) -> PlateModel:
    kinds = {"own": DirectionalDamping, "loss": HystereticDamping, "patch": DampingPatch}
    effects = {"plate": Plate(), "grain": Orthotropy()} | {label: kinds[label]() for label in numbers if label in kinds}
    known = {f"{label}.{name}": value for label, own in numbers.items() for name, value in own.items()}
    return PlateModel(mesh, effects, WOOD | GRAIN | known, response=[3, (0.6, 0.7)], reference=[8])


def modal_losses(model: PlateModel, n_mode: int = 14) -> torch.Tensor:
    """Loss factors of the flexible modes, by their energies [-]."""
    modes, system = model.modes(NONE), model.system(NONE)
    shape = modes.shape[:, 3:n_mode]
    return (shape * (system.hysteretic @ shape)).sum(0) / modes.eigenvalue[3:n_mode]


def distance(first: torch.Tensor, second: torch.Tensor) -> float:
    return float((first - second).norm() / second.norm())


@pytest.mark.parametrize("mesh", [MESH, Mesh(0.4, 0.4, 6, 6)], ids=["rectangle", "square"])
def test_one_loss_in_all_directions_is_the_common_one(mesh: Mesh):
    own = build(mesh, own={"loss_x": 0.02, "loss_y": 0.02, "loss_xy": 0.02})
    common = build(mesh, loss={"stiffness_loss_factor": 0.02})
    # No spring is there, which alone the common one damps, too. Two ways of solving: rounding.
    assert distance(own.frf(NONE, LINES), common.frf(NONE, LINES)) < 1e-7


@pytest.mark.parametrize(("axis", "mesh"), [("x", Mesh(1.0, 0.03, 20, 2)), ("y", Mesh(0.03, 1.0, 2, 20))])
def test_a_strip_along_an_axis_loses_what_that_modulus_loses(axis: str, mesh: Mesh):
    losses = {"loss_x": 0.01, "loss_y": 0.03, "loss_xy": 0.07}
    found = modal_losses(build(mesh, own=losses), 5)
    # Its sides are free to bend against it, which costs nothing of the other modulus: to (width/length)².
    torch.testing.assert_close(found, torch.full_like(found, losses[f"loss_{axis}"]), rtol=0.02, atol=0.0)


def test_a_plate_that_twists_loses_what_the_shear_modulus_loses():
    # Twisted by its corners it stores energy in G alone: w = xy.
    model = build(Mesh(0.5, 0.3, 4, 3), own={"loss_x": 0.01, "loss_y": 0.03, "loss_xy": 0.07})
    place = model.mesh.node_place
    twist = torch.stack([place[:, 0] * place[:, 1], place[:, 0], -place[:, 1]], dim=-1).flatten()
    system = model.system(NONE)
    assert float(twist @ system.hysteretic @ twist) == pytest.approx(0.07 * float(twist @ system.stiffness @ twist))


def test_no_motion_gains_energy_where_the_directions_lose_alike():
    hysteretic = build(MESH, own={"loss_x": 0.02, "loss_y": 0.015, "loss_xy": 0.0}).system(NONE).hysteretic
    value = torch.linalg.eigvalsh(hysteretic)
    assert float(value[0]) > -1e-10 * float(value[-1])


@pytest.mark.parametrize("poisson", [0.28, 0.49, 0.0, -0.2])
@pytest.mark.parametrize(("x", "y"), [(0.0, 0.05), (0.05, 0.0), (1e-3, 0.05), (0.05, 2e-4)])
def test_no_motion_gains_energy_where_one_direction_loses_hardly_anything(x: float, y: float, poisson: float):
    model = build(MESH, own={"loss_x": x, "loss_y": y, "loss_xy": 0.0}, plate={"poisson_ratio": poisson})
    value = torch.linalg.eigvalsh(model.system(NONE).hysteretic)
    assert float(value[0]) > -1e-10 * float(value[-1])
    # And strips lose what they did: the compliance along them has the loss of one modulus alone.
    for axis, mesh in (("x", Mesh(1.0, 0.02, 20, 2)), ("y", Mesh(0.02, 1.0, 2, 20))):
        strip = build(mesh, own={"loss_x": x, "loss_y": y, "loss_xy": 0.0}, plate={"poisson_ratio": poisson})
        found = modal_losses(strip, 5)
        # To (width/length)² of the other one.
        expected = torch.full_like(found, x if axis == "x" else y)
        torch.testing.assert_close(found, expected, rtol=0.03, atol=0.002 * max(x, y))


def test_what_the_whole_plate_loses_is_asked_to_be_passive_and_not_a_part_of_it():
    # The same losses, told in two ways: the lesser one is at zero beside the common loss in one of them.
    all_own = build(MESH, own={"loss_x": 0.03, "loss_y": 0.01, "loss_xy": 0.02})
    beside = {"loss_x": 0.02, "loss_y": 0.0, "loss_xy": 0.01}
    rest_common = build(MESH, own=beside, loss={"stiffness_loss_factor": 0.01})
    assert distance(rest_common.frf(NONE, LINES), all_own.frf(NONE, LINES)) < 1e-7
    hysteretic = build(MESH, own=beside, loss={"stiffness_loss_factor": 1e-4}).system(NONE)
    value = torch.linalg.eigvalsh(hysteretic.hysteretic + 1e-4 * hysteretic.stiffness)
    assert float(value[0]) > -1e-10 * float(value[-1])


def test_it_lies_on_top_of_a_lossy_patch():
    patch, own = {"x": 0.4, "y": 0.6, "size": 0.3, "loss_factor": 0.1}, {"loss_x": 0.01, "loss_y": 0.03, "loss_xy": 0.0}
    # Under the patch elements are a little stiffer, so that the two are compared in stiffness that both have.
    both, alone = build(MESH, patch=patch, own=own).system(NONE), build(MESH, patch=patch).system(NONE)
    extra = both.hysteretic - alone.hysteretic
    whole = build(MESH, own=own).system(NONE).hysteretic
    assert distance(extra, whole) < 0.02
