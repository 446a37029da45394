"""Held edges on springs: as rigid as the edge condition, and found where they are not."""

import pytest
import torch

from torchplate.diagnosis import diagnose
from torchplate.diagnosis.candidates.candidate import n_options
from torchplate.diagnosis.candidates.catalogue import candidates, channels_of
from torchplate.diagnosis.candidates.held_edges import PREFIX, held_again, held_edges, on_springs, standing_for
from torchplate.diagnosis.model_builder import with_candidate
from torchplate.diagnosis.selection.screen import Scored, _moved
from torchplate.diagnosis.selection.starts import without_rigid
from torchplate.effects import CATALOGUE
from torchplate.measurement import PERFECT
from torchplate.model import PlateModel, Searched
from torchplate.model.discretisation.extrapolation import extrapolate
from torchplate.plate import Mesh

NOTHING = torch.zeros(0, dtype=torch.float64)
SIDES = (0.3, 0.1)
CLAMPED = {"x0": "clamped"}
HELD = {"x0": "clamped", "y1": "simply_supported"}
# κ of the clamp over D/L: the first natural frequency falls by about 1 / κ.
CLAMP = 60.0
NUMBERS = {"youngs_modulus": 7.0e10, "poisson_ratio": 0.33, "density": 2700.0, "thickness": 0.003}
RIGIDITY = NUMBERS["youngs_modulus"] * NUMBERS["thickness"] ** 3 / 12 / (1 - NUMBERS["poisson_ratio"] ** 2)
SOFT = CLAMP * RIGIDITY / SIDES[0]


def plate(edges, more=None, known=None, searched=None, refine=1, **channels):
    effects = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"](), **(more or {})}
    numbers = {f"plate.{name}": value for name, value in NUMBERS.items()} | {"loss.stiffness_loss_factor": 4e-3}
    numbers = {key: value for key, value in numbers.items() if key not in (searched or {})} | (known or {})
    return PlateModel(Mesh(*SIDES, 9, 3, refine, edges), effects, numbers, searched, kind="accelerance", **channels)


@pytest.mark.parametrize("edges", [CLAMPED, HELD, {"x0": "simply_supported", "x1": "simply_supported"}], ids=str)
def test_rigid_springs_hold_an_edge_as_its_condition_does(edges):
    held = plate(edges)
    sprung = on_springs(held)
    assert held_edges(sprung) == {}
    expected, found = (model.natural_frequencies(NOTHING, 12) for model in (held, sprung))
    assert torch.allclose(found, expected, rtol=1e-4, atol=1e-3)


def test_a_free_plate_stays_what_it_is():
    free = plate({})
    assert on_springs(free) is free
    assert held_again(free, {}) is free
    assert standing_for(free, "x0") is None


def test_what_did_not_yield_is_held_again():
    held = plate(HELD)
    again = held_again(on_springs(held), held_edges(held))
    assert held_edges(again) == HELD
    assert set(again.effects) == set(held.effects)
    assert torch.equal(again.natural_frequencies(NOTHING, 12), held.natural_frequencies(NOTHING, 12))


def test_an_effect_that_is_called_as_an_edge_stays_where_the_edge_is_held_again():
    held = plate(HELD, {"x0": CATALOGUE["point_mass"]()}, {"x0.x": 0.4, "x0.y": 0.6, "x0.mass": 0.01})
    again = held_again(on_springs(held), held_edges(held))
    assert set(again.effects) == set(held.effects)


def test_a_simple_support_may_give_way_and_resist_turning():
    model = on_springs(plate(HELD, response=RESPONSE, reference=REFERENCE))
    every = candidates(model, NOTHING, channels_of(model))
    (one,) = [one for one in every if one.replaces == PREFIX + "y1"]
    assert one.neutral["stiffness"] > 0
    assert one.neutral["rotational_stiffness"] == 0
    for trial in (*one.far, *one.near):
        for alpha in (trial.lowest, trial.highest):
            moved = _moved(one, dict(trial.values), alpha)
            assert all(interval.low <= moved[key] <= interval.high for key, interval in one.searched.items())
    assert {trial.values["stiffness"] < one.neutral["stiffness"] for trial in one.far} == {True, False}
    assert len({trial.values["rotational_stiffness"] for trial in one.far}) == 2


def test_springs_of_a_simple_support_leave_its_slope_free():
    sprung = on_springs(plate(HELD))
    found = [standing_for(sprung, edge) for edge in ("x0", "y1", "x1")]
    assert found[2] is None
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].values["rotational_stiffness"] > 0
    assert found[1].values["rotational_stiffness"] == 0


RESPONSE, REFERENCE = (40, 17), (20, 38)


def a_clamp_that_may_give():
    """A model whose clamp is held by springs, the candidate of its yielding, and what it promises."""
    model = on_springs(by_noise())
    every = candidates(model, model.space.to_si(torch.full((2,), 0.5).double()), channels_of(model))
    (one,) = [one for one in every if one.replaces]
    return model, every, Scored(one, "edge", model, 0.9, {}, NOTHING, NOTHING, NOTHING)


@pytest.mark.parametrize("softened", [None, "stiffness", "rotational_stiffness"])
def test_springs_that_are_rigid_wherever_a_fit_begins_stay_so(softened):
    model, _, promise = a_clamp_that_may_give()
    whole = with_candidate(model, "edge", promise.candidate)
    start = torch.full((2, len(whole.names)), 0.999)
    if softened is not None:
        start[1, whole.names.index(f"edge.{softened}")] = 0.6
    free, starts = without_rigid(model, promise, start)
    # Where none has yielded there is nothing else to begin with.
    kept = {"stiffness", "rotational_stiffness"} if softened is None else {softened}
    assert free.candidate.searched.keys() == kept
    less = with_candidate(model, "edge", free.candidate)
    assert starts.shape == (2, len(less.names))
    assert torch.equal(
        less.space.to_si(starts[1]),
        torch.stack([whole.space.to_si(start[1])[whole.names.index(name)] for name in less.names]),
    )
    held = {f"edge.{key}": promise.candidate.neutral[key] for key in promise.candidate.searched.keys() - kept}
    assert held.items() <= less.known_values.items()


def test_a_clamp_that_gives_is_as_probable_as_any_other_effect():
    _, every, promise = a_clamp_that_may_give()
    number = n_options(every)
    assert number[promise.candidate.cause] == 1
    assert number["edge_spring"] == 3


def measured_accelerances(lab, truth, seed):
    """Accelerances of a plate, its mesh error taken off, with 0.5 % noise."""
    line = torch.arange(20.0, 500.0, 4.0, dtype=torch.float64)
    exact = extrapolate(truth, 500.0).model.frf(NOTHING, line, RESPONSE, REFERENCE)
    return lab.measured(line, exact + lab.noise_of(lab.true_std(exact, 0.005, "mixed"), seed), RESPONSE, REFERENCE)


def by_noise():
    """The model that believes in a rigid clamp, E and the loss searched."""
    interval = {"plate.youngs_modulus": Searched(5e10, 9e10), "loss.stiffness_loss_factor": Searched(1e-4, 5e-2, True)}
    return plate(CLAMPED, searched=interval, response=RESPONSE, reference=REFERENCE)


@pytest.mark.check
def test_a_clamp_that_turns_is_named(lab):
    clamp = {"clamp": CATALOGUE["edge_spring"](edge="x0")}
    values = {"clamp.stiffness": 1e4 * RIGIDITY / SIDES[0] ** 3, "clamp.rotational_stiffness": SOFT}
    measured = measured_accelerances(lab, plate({}, clamp, values, refine=2), 3)
    found = diagnose(by_noise(), measured, imperfections=PERFECT)
    (named,) = [one for one in found.effects if one.name != "mesh_discretisation"]
    assert (found.verdict, named.name, named.options["edge"]) == ("explained", "edge_spring", "x0")
    assert named.parameters["rotational_stiffness"].value == pytest.approx(SOFT, rel=0.05)
    assert found.parameters["plate.youngs_modulus"].value == pytest.approx(NUMBERS["youngs_modulus"], rel=0.01)
    assert held_edges(found.model) == {}
    assert not any(label.startswith(PREFIX) for label in found.model.effects)


@pytest.mark.check
def test_a_clamp_that_does_not_is_held_in_the_end(lab):
    found = diagnose(by_noise(), measured_accelerances(lab, plate(CLAMPED, refine=2), 4), imperfections=PERFECT)
    assert found.verdict == "consistent"
    assert held_edges(found.model) == CLAMPED
    assert found.parameters["plate.youngs_modulus"].value == pytest.approx(NUMBERS["youngs_modulus"], rel=3e-3)
