"""What a lab can do: every test leads to a plate that can be had, and to a state that a config can say."""

import dataclasses

import pytest
import torch

from torchplate.effects import CATALOGUE, find_effect, options
from torchplate.measurement import Imperfections
from torchplate.model import PlateModel
from torchplate.planning import Lab
from torchplate.planning.proposal import KINDS, AddedMass, Hammer, NoWindow, Sensor, Wires
from torchplate.plate import Mesh

CONFIG = {"wires": {"effect": "support_spring", "nodes": [2, 8, 29, 33], "stiffness": [500.0, 5000.0]}}
EXAMPLES = {
    "window": NoWindow(),
    "sensor": Sensor(12),
    "hammer": Hammer(19),
    "mass": AddedMass(12, (2 / 3, 0.25), 0.05, 1e-4, (0.002, 0.003)),
    "wires": Wires("wires", (2, 8, 29, 33), (3, 9, 29, 32)),
}


def square(n: int) -> PlateModel:
    known = {
        "plate.youngs_modulus": 7e10,
        "plate.poisson_ratio": 0.33,
        "plate.density": 2700.0,
        "plate.thickness": 3e-3,
    }
    return PlateModel(Mesh(0.5, 0.5, n, n), {"plate": CATALOGUE["plate"]()}, known, {}, [3], [7, 9], "accelerance")


def test_every_kind_of_test_has_an_example():
    assert set(EXAMPLES) == set(KINDS)
    assert [type(EXAMPLES[word]) for word in KINDS] == list(KINDS.values())


@pytest.mark.parametrize("word", KINDS)
def test_a_state_can_be_modelled_and_said(lab, word):
    proposal, model = EXAMPLES[word], lab.given("support")
    state = proposal.state(model)
    theta = torch.tensor([2e11, 1e-2, 2000.0], dtype=torch.float64)
    frf = state.frf(theta, lab.LINES[:5])
    n_response = 1 if proposal.response else 2
    n_reference = 1 if proposal.reference else 3
    assert frf.shape == (5, n_response, n_reference)
    body = proposal.body(CONFIG)
    assert set(body) <= {"response", "reference", "effects"}
    for one in body.get("effects", {}).values():
        kind = find_effect(one["effect"])
        assert set(one) - {"effect"} <= {*kind.parameters, *options(kind)}
    assert proposal.instruction.endswith(".")
    assert proposal.title


@torch.no_grad()
def test_an_added_mass_lowers_what_moves_there_and_is_off_by_what_is_told(lab):
    model, proposal = lab.given("support"), EXAMPLES["mass"]
    theta = torch.tensor([2e11, 1e-2, 2000.0], dtype=torch.float64)
    before, after = (one.natural_frequencies(theta, 8) for one in (model, proposal.state(model)))
    assert bool((after <= before * (1 + 1e-9)).all())
    assert float((after / before).min()) < 0.99
    heavier, right, up = proposal.off
    assert (heavier.mass, right.place[0], up.place[1]) == pytest.approx((0.0501, 2 / 3 + 0.002, 0.253))
    # On an edge it can only be off inwards.
    assert dataclasses.replace(proposal, place=(1.0, 0.25)).off[1].place[0] == pytest.approx(0.998)


def test_a_tighter_wire_is_tighter_where_it_is_moved_to(lab):
    model = lab.given("support")
    effects = {**model.effects, "odd": CATALOGUE["support_asymmetry"](nodes=(2, 8, 29, 33))}
    moved = EXAMPLES["wires"].effects(model.replaced(effects=effects))
    assert moved["wires"].nodes == moved["odd"].nodes == (3, 9, 29, 32)
    # A spring that somebody else has put there stays.
    other = {**model.effects, "odd": CATALOGUE["support_spring"](nodes=(5,))}
    known = model.known_values | {"odd.stiffness": 100.0}
    assert EXAMPLES["wires"].effects(model.replaced(effects=other, known=known))["odd"].nodes == (5,)


@pytest.mark.parametrize("n", [6, 10])
def test_places_lie_off_the_symmetries_of_a_square_plate(n):
    model = square(n)
    masses = [one for one in Lab(("mass",)).proposals(model, Imperfections()) if isinstance(one, AddedMass)]
    assert len({one.node for one in masses}) == 6
    for one in masses:
        x, y = (2 * part - 1 for part in one.place)
        assert min(abs(x), abs(y), abs(x - y), abs(x + y)) > 0.05
    # Of the plate's 2.025 kg about 2 and 6 per cent.
    assert {one.mass for one in masses} == {0.05, 0.1}


def test_what_is_cheap_comes_first_and_what_is_there_is_not_proposed(lab):
    model = lab.given("support")
    everything = Lab(n_place=40).proposals(model, Imperfections())
    assert list(dict.fromkeys(one.can for one in everything)) == ["window", "sensor", "hammer", "mass", "wires"]
    assert {type(one) for one in everything} == set(KINDS.values())
    assert not {one.node for one in everything if isinstance(one, Sensor)} & {3, 17}
    assert not {one.node for one in everything if isinstance(one, Hammer)} & {7, 9, 26}
    for one in everything:
        if isinstance(one, Wires):
            assert len(set(one.after)) == 4
            assert one.after != one.before


def test_a_lab_does_what_it_can_and_has(lab):
    model = lab.given("support")
    found = Lab(("mass",), masses=(0.033,), n_place=3).proposals(model, Imperfections())
    assert [(one.can, one.mass) for one in found] == [("mass", 0.033)] * 3
    with pytest.raises(ValueError, match="out of window, sensor, hammer, mass, wires, got 'crane'"):
        Lab(("crane",))
    with pytest.raises(ValueError, match="masses above 0 kg"):
        Lab(masses=(0.02, -0.1))
