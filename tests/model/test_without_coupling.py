"""A loss in a part of the plate that damps each mode and couples none: the model for the first steps of a search."""

import pytest
import torch

from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel, Searched
from torchplate.model.receptance import modal_receptance
from torchplate.plate import Mesh

KNOWN = {
    "plate.youngs_modulus": 6.9e10,
    "plate.poisson_ratio": 0.31,
    "plate.density": 2710.0,
    "plate.thickness": 0.003,
    "wires.stiffness": 1800.0,
    "wires.viscous_damping": 6.0,
    "loss.stiffness_loss_factor": 4e-3,
    "loss.mass_loss_factor": 30.0,
    "air.mass_coefficient": 1.7,
    "patch.x": 0.5,
    "patch.y": 0.5,
}
SEARCHED = {"patch.loss_factor": Searched(0.0, 0.5), "patch.size": Searched(0.1, 1.0)}
LINES = torch.linspace(8.0, 330.0, 75, dtype=torch.float64)


def build(**rayleigh: float) -> PlateModel:
    effects = {
        "plate": CATALOGUE["plate"](),
        "wires": CATALOGUE["support_spring"](nodes=(2, 9, 14)),
        "loss": CATALOGUE["hysteretic_damping"](),
        "air": CATALOGUE["viscous_damping"](),
        "patch": CATALOGUE["damping_patch"](),
    }
    known = KNOWN | {"air.stiffness_coefficient": 0.0} | {f"air.{key}": value for key, value in rayleigh.items()}
    mesh = Mesh(0.5, 0.33, 4, 3)
    return PlateModel(mesh, effects, known, SEARCHED, [3, (0.61, 0.77)], [8, (0.13, 0.24)], "accelerance")


@pytest.fixture
def asked(monkeypatch):
    """How often the modes were taken one by one."""
    calls = []
    inner = modal_receptance._by_uncoupled_modes
    monkeypatch.setattr(modal_receptance, "_by_uncoupled_modes", lambda *given: calls.append(1) or inner(*given))
    return calls


def off(found, true) -> float:
    return float((found - true).abs().square().sum().sqrt() / true.abs().square().sum().sqrt())


@torch.no_grad()
def test_a_loss_that_is_small_beside_the_distance_of_the_modes_is_nearly_met(asked):
    model, theta = build(), torch.tensor([[0.01, 0.4], [0.04, 0.4], [0.4, 0.4]], dtype=torch.float64)
    true, rough = model.frf_direct(theta, LINES), model.without_coupling().frf(theta, LINES)
    without = model.frf_direct(torch.tensor([[0.0, 0.4]], dtype=torch.float64), LINES)
    assert len(asked) == 1
    for member in range(3):
        # What the patch does to the FRFs, and what of that is missed.
        assert off(rough[member], true[member]) < 0.25 * off(without[0], true[member])
    # The coupling counts by the square of the loss: a fourth of the loss, and about a sixteenth is missed.
    small, larger = (off(rough[member], true[member]) for member in (0, 1))
    assert 0 < small < larger / 8


@torch.no_grad()
def test_what_couples_no_modes_is_left_as_it_is():
    """Neither dashpots nor a loss that the whole plate has are touched."""
    model, theta = build(), torch.tensor([[0.0, 0.4]], dtype=torch.float64)
    assert off(model.without_coupling().frf(theta, LINES), model.frf_direct(theta, LINES)) < 1e-9


@torch.no_grad()
def test_the_model_it_was_made_of_still_couples_them(asked):
    model, theta = build(), torch.tensor([0.4, 0.4], dtype=torch.float64)
    model.without_coupling()
    assert off(model.frf(theta, LINES), model.frf_direct(theta, LINES)) < 1e-8
    assert not asked


@torch.no_grad()
@pytest.mark.parametrize("rayleigh", [0.0, 2e-5])
def test_one_by_one_is_what_a_matrix_of_the_same_diagonal_gives(rayleigh, monkeypatch):
    model = build(stiffness_coefficient=rayleigh).without_coupling()
    theta = torch.tensor([[0.4, 0.4], [0.1, 0.7]], dtype=torch.float64)
    found = model.frf(theta, LINES)
    monkeypatch.setattr(modal_receptance, "_is_diagonal", lambda _: False)
    assert off(model.frf(theta, LINES), found) < 1e-9


@torch.no_grad()
@pytest.mark.parametrize("n_member", [1, 5])
def test_modes_are_summed_alike_in_any_number_of_lines(n_member, monkeypatch):
    """Few lines of many members, many of few."""
    model = build().without_coupling()
    theta = torch.tensor([[0.01, 0.4]], dtype=torch.float64) * torch.linspace(1.0, 2.0, n_member).to(LINES)[:, None]
    found = model.frf(theta, LINES)
    for name in ("LINES_AT_ONCE", "LINES_OF_ALL"):
        monkeypatch.setattr(modal_receptance, name, 7)
    assert torch.allclose(model.frf(theta, LINES), found, rtol=1e-12, atol=0.0)


@torch.no_grad()
@pytest.mark.parametrize("turned", [False, True])
def test_many_channels_on_a_side_read_what_each_of_them_reads_alone(asked, turned):
    """Each row of the shorter side is carried to the places and the modes, then to the many."""
    model, theta = build().without_coupling(), torch.tensor([[0.02, 0.4], [0.3, 0.4]], dtype=torch.float64)
    many, few = list(range(1, 18)), [8]
    sides = (few, many) if turned else (many, few)
    found = model.frf(theta, LINES, *sides)
    alone = [model.frf(theta, LINES, *((few, [one]) if turned else ([one], few))) for one in many]
    assert len(asked) == 1 + len(many)
    torch.testing.assert_close(found, torch.cat(alone, dim=-1 if turned else -2), rtol=1e-9, atol=1e-12)
