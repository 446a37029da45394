"""What is grounded at a place may be a support."""

import math

import pytest
import torch

from torchplate.diagnosis.candidates.supports import supports_at, tighter_at
from torchplate.diagnosis.model_builder import with_candidate
from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

KNOWN = {
    "plate.youngs_modulus": 2.05e11,
    "plate.poisson_ratio": 0.29,
    "plate.density": 7800.0,
    "plate.thickness": 0.003,
    "wires.stiffness": 1500.0,
    "wires.viscous_damping": 0.7,
}
LINES = torch.tensor([9.0, 55.0, 120.0, 260.0], dtype=torch.float64)
NOBODY = torch.zeros(0, dtype=torch.float64)
WIRES = {"by node": {"nodes": (2, 10, 19)}, "by place": {"at": ((0.25, 0.0), (1.0, 1 / 3), (0.75, 1.0))}}


def plate(searched=None, wires=None, further=None) -> PlateModel:
    searched = searched or {}
    effects = {"plate": CATALOGUE["plate"](), "wires": CATALOGUE["support_spring"](**(wires or WIRES["by node"]))}
    known = dict(KNOWN)
    for label, (effect, values) in (further or {}).items():
        effects[label] = effect
        known |= {f"{label}.{key}": value for key, value in values.items()}
    known = {key: value for key, value in known.items() if key not in searched}
    return PlateModel(Mesh(0.43, 0.3, 4, 3), effects, known, searched, [3, 17], [7, 9], "receptance")


@pytest.mark.parametrize(
    ("x", "y", "options"),
    [
        (0.252, 0.331, [{"nodes": (7,)}]),
        (0.27, 0.32, [{"nodes": (7,)}, {"at": ((0.27, 0.32),)}]),
        (0.37, 0.5, [{"at": ((0.37, 0.5),)}]),
    ],
    ids=["at a node", "perhaps at a node", "between nodes"],
)
def test_a_further_support_is_at_a_node_where_one_is_near(x, y, options):
    # Node 7 is at (1/4, 1/3).
    model = plate()
    found = supports_at(model, NOBODY, x, y, 800.0, 0.0)
    assert [one.options for one in found] == options
    for one in found:
        assert one.searched.keys() == {"stiffness", "viscous_damping"}
        start = one.far[0].values
        assert start["stiffness"] == pytest.approx(800.0)
        interval = one.searched["viscous_damping"]
        assert start["viscous_damping"] == pytest.approx(interval.low, rel=0.02)
        # A spring was found: its dashpot may be anything.
        middle = one.far[1].values
        assert middle["stiffness"] == start["stiffness"]
        assert middle["viscous_damping"] == pytest.approx(math.sqrt(interval.low * interval.high))


@pytest.mark.parametrize("searched", [{}, {"wires.stiffness": Searched(500.0, 9000.0)}], ids=["known", "searched"])
@pytest.mark.parametrize(("node", "x", "y"), [(2, 0.25, 0.0), (19, 0.75, 1.0)])
@pytest.mark.parametrize("wires", WIRES)
def test_a_spring_where_a_support_is_is_that_support_tighter(searched, wires, node, x, y):
    model = plate(searched, WIRES[wires])
    theta = torch.tensor([1200.0] * len(searched), dtype=torch.float64)
    spring = CATALOGUE["ground_spring"](), {"x": x, "y": y, "stiffness": 700.0}
    beside = plate(searched, WIRES[wires], {"spring": spring})
    candidate, _, there = tighter_at(model, theta, x + 1e-3, y, 700.0)
    assert there
    # It names the one wire, and has one number.
    assert candidate.options == ({"nodes": (node,)} if wires == "by node" else {"at": ((x, y),)})
    whole = with_candidate(model, "tighter", candidate)
    (factor,) = candidate.far[0].values.values()
    at = torch.tensor([*theta.tolist(), factor], dtype=torch.float64)
    assert torch.allclose(whole.frf(at, LINES), beside.frf(theta, LINES), rtol=1e-6)


def test_that_a_spring_ends_at_a_support_is_a_coincidence():
    _, coincidence, _ = tighter_at(plate(), NOBODY, 0.25, 0.0, 700.0)
    # A place anywhere on the plate is within 0.012 of one of three supports once in 737 times.
    assert coincidence == pytest.approx(2 * math.log(1 / (3 * math.pi * 0.012**2)))
    assert 13 < coincidence < 14


def test_a_spring_beside_the_supports_is_none_of_them():
    assert tighter_at(plate(), NOBODY, 0.4, 0.5, 700.0) is None


@pytest.mark.parametrize(
    ("x", "y", "std", "rho", "may_be"),
    [
        # Node 2 is at (1/4, 0).
        (0.265, 0.03, 1e-3, 0.0, True),
        (0.30, 0.06, 1e-3, 0.0, False),
        (0.30, 0.06, 0.03, 0.0, True),
        # Three standard errors away: one in a hundred is that far off.
        (0.328, 0.03, 0.028, 0.0, True),
        (0.34, 0.03, 0.028, 0.0, False),
        # Far off along the short axis of its ellipse.
        (0.29, 0.04, 0.03, -0.99, False),
        (0.29, 0.04, 0.03, 0.99, True),
    ],
)
def test_a_spring_may_be_at_a_support_that_is_no_farther_off_than_its_place_is_known(x, y, std, rho, may_be):
    spread = std**2 * torch.tensor([[1.0, rho], [rho, 1.0]], dtype=torch.float64)
    found = tighter_at(plate(), NOBODY, x, y, 700.0, spread)
    if not may_be:
        assert found is None
        return
    # That it is there is no more than a guess: no coincidence speaks against the spring.
    assert (found.candidate.options, found.coincidence, found.there) == ({"nodes": (2,)}, 0.0, False)
    nothing_known = torch.full((2, 2), torch.nan, dtype=torch.float64)
    beyond = math.hypot(x - 0.25, y) > 0.04
    assert (tighter_at(plate(), NOBODY, x, y, 700.0, nothing_known) is None) == beyond


def test_a_support_without_a_spring_is_not_tighter():
    loose = plate({"wires.stiffness": Searched(0.0, 9000.0)})
    assert tighter_at(loose, torch.zeros(1, dtype=torch.float64), 0.25, 0.0, 700.0) is None
    assert tighter_at(plate(), NOBODY, 0.25, 0.0, 0.0) is None


def test_what_is_named_tighter_already_is_not_so_twice():
    uneven = CATALOGUE["support_asymmetry"](nodes=[2]), {"factor_1": 1.3}
    model = plate(further={"uneven": uneven})
    assert tighter_at(model, NOBODY, 0.25, 0.0, 700.0) is None
    # Another one may be.
    assert tighter_at(model, NOBODY, 0.75, 1.0, 700.0).candidate.options == {"nodes": (19,)}
