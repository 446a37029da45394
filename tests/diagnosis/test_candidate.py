"""What may be missing follows from the catalogue, and from what the model has already."""

import itertools
from dataclasses import dataclass

import pytest
import torch

from torchplate.diagnosis.candidates.candidate import vector
from torchplate.diagnosis.candidates.catalogue import candidates
from torchplate.diagnosis.candidates.channels import Channels, Rearrangements
from torchplate.diagnosis.candidates.trials import spread_at
from torchplate.diagnosis.model_builder import with_candidate, without_candidate
from torchplate.effects import CATALOGUE, Effect, Parameter
from torchplate.effects.parameter import Prior, nonnegative
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh, Proportional

CHANNELS = Channels((3, 17), (7, 9, 15))
KNOWN = {
    "plate.youngs_modulus": 2.05e11,
    "plate.poisson_ratio": 0.29,
    "plate.density": 7800.0,
    "plate.thickness": 0.003,
    "wires.stiffness": 1500.0,
    "wires.viscous_damping": 0.7,
    "loss.stiffness_loss_factor": 6e-3,
    "grain.young_ratio": 0.8,
}
LINES = torch.tensor([9.0, 55.0, 120.0, 260.0], dtype=torch.float64)
# What the FRFs promise of exchanged and turned channels.
PROMISED = Rearrangements(
    ({"channels": ((None, 7), (None, 9))}, {"channels": ((3, None), (17, None))}), ({"channels": ((None, 9),)},), 4, 11
)
CORNERS = {"x0", "y0", "x1", "y1"}
# What an effect has beside a strength: it may be anything where the strength is neutral.
WHERE = {"x", "y", "size"}
# Of these effects one number, or none of the rectangle's, says that they are not there.
WITHOUT = {"absorber": {"stiffness", "viscous_damping"}, "cut_out": CORNERS, "rib": CORNERS}


def plate(searched=None, **mesh) -> PlateModel:
    searched = searched or {}
    effects = {
        "plate": CATALOGUE["plate"](),
        "wires": CATALOGUE["support_spring"](nodes=[2, 10, 19]),
        "loss": CATALOGUE["hysteretic_damping"](),
        # An angle of the grain may be missing only where there is one.
        "grain": CATALOGUE["orthotropy"](),
    }
    known = {key: value for key, value in KNOWN.items() if key not in searched}
    channels = list(CHANNELS.response), list(CHANNELS.reference)
    return PlateModel(Mesh(0.43, 0.3, 4, 3, **mesh), effects, known, searched, *channels, "accelerance")


def found(model: PlateModel, channels=CHANNELS):
    theta = model.space.to_si(model.known.new_full((len(model.names),), 0.43))
    return candidates(model, theta, channels, PROMISED)


def names(every) -> set[str]:
    return {one.name for one in every}


# A field of thickness is a nuisance already. The plate is what all others change, the mesh is
# settled before, and a further support follows from what is grounded.
@pytest.mark.parametrize(
    "name",
    sorted(set(CATALOGUE) - {"plate", "mesh_discretisation", "support_spring", "thickness_field", "field"}),
)
def test_every_effect_of_the_catalogue_may_be_missing(name):
    own = [one for one in found(plate()) if one.name == name]
    assert own
    for one in own:
        assert isinstance(one.effect, CATALOGUE[name])
        with_prior = {key for key, parameter in one.effect.parameters.items() if parameter.prior is not None}
        details = {key for key, parameter in one.effect.parameters.items() if parameter.detail}
        assert one.searched.keys() == with_prior - details
        assert one.detail.keys() == details
        # It fits into the model as it stands, and with its details once it was found.
        for each, keys in ((one, with_prior - details), (one.in_detail(), with_prior)):
            model = with_candidate(plate(), "new", each)
            assert set(model.names) == {f"new.{key}" for key in keys}


def test_a_new_effect_may_be_missing_as_soon_as_it_is_defined():
    assert "rust" not in names(found(plate()))
    try:

        @dataclass(frozen=True)
        class Rust(Effect):
            """Damping that only this test knows."""

            parameters = {
                "depth": Parameter("1/s", "how deep", nonnegative, neutral=0.0, prior=Prior(0.0, 3.0)),
                "colour": Parameter("-", "never looked for", neutral=1.0),
            }
            acts_on = frozenset({"damping"})
            shows = "Only this test uses it."
            source = "none"

            def proportional(self, value):
                return Proportional(mass_coefficient=value["depth"] * value["colour"])

        (own,) = [one for one in found(plate()) if one.name == "rust"]
    finally:
        CATALOGUE.pop("rust", None)
    assert own.searched == {"depth": Searched(0.0, 3.0)}
    assert own.neutral == {"depth": 0.0}
    assert all(0 < trial.values["depth"] <= 3 for trial in (*own.far, *own.near))


@pytest.mark.parametrize(
    ("key", "gone"),
    [("plate.density", "density"), ("plate.thickness", "thickness"), ("plate.poisson_ratio", "poisson_ratio")],
)
def test_what_is_searched_already_is_not_missing(key, gone):
    model = plate({key: Searched(0.9 * KNOWN[key], 1.1 * KNOWN[key])})
    assert names(found(plate())) - names(found(model)) == {gone}


@pytest.mark.parametrize("name", ["point_mass", "ground_spring", "stiffness_loss", "absorber", "rib"])
def test_beside_one_at_a_place_another_may_sit_elsewhere(name):
    """A rib that is searched is no reason why there should not be two."""
    model = plate()
    (one, *_) = [one for one in found(model) if one.name == name]
    with_one = with_candidate(model, "first", one)
    (again, *_) = [one for one in found(with_one) if one.name == name]
    assert again.searched.keys() == one.searched.keys()
    both = with_candidate(with_one, "second", again)
    assert {f"{label}.{key}" for label in ("first", "second") for key in one.searched} <= {*both.names}


def test_only_what_is_not_searched_of_an_effect_is_looked_for():
    (own,) = [
        one
        for one in found(plate({"loss.stiffness_loss_factor": Searched(1e-3, 2e-2)}))
        if one.name == "hysteretic_damping"
    ]
    assert own.searched.keys() == {"mass_loss_factor"}
    stiffness = {"wires.stiffness": Searched(500.0, 3000.0)}
    for model, n_factor in ((plate(), 3), (plate(stiffness), 2)):
        (own,) = [one for one in found(model) if one.name == "support_asymmetry"]
        # Of the common stiffness and all three factors one is too many.
        assert len(own.searched) == n_factor
        # Beside a slack first support the others are as many times as stiff.
        assert own.searched["factor_2"].high == (2.0 if n_factor == 3 else 10.0)


def test_a_common_stiffness_may_be_that_of_a_slack_first_support():
    """0.38 of the others, which stand at the lower end of what is searched: the first one's own is below it."""
    model = plate({"wires.stiffness": Searched(500.0, 3000.0)})
    (own,) = [one for one in found(model) if one.name == "support_asymmetry"]
    beside = with_candidate(model, "own", own)
    assert (beside.searched["wires.stiffness"].low, beside.searched["wires.stiffness"].high) == (50.0, 6000.0)
    assert without_candidate(beside, "own", own).searched == model.searched
    # A spring that is known stays what it is.
    (own,) = [one for one in found(plate()) if one.name == "support_asymmetry"]
    assert with_candidate(plate(), "own", own).searched.keys() == {f"own.{key}" for key in own.searched}


def test_a_held_edge_has_no_spring():
    free = {one.options["edge"] for one in found(plate()) if one.name == "edge_spring"}
    held = plate(edges={"x0": "clamped", "y1": "free"})
    assert free == {"x0", "x1", "y0", "y1"}
    assert {one.options["edge"] for one in found(held) if one.name == "edge_spring"} == {"x1", "y0", "y1"}


def test_channels_are_those_that_were_measured_and_promise_something():
    every = found(plate())
    for name, promised in (("channel_swap", PROMISED.swap), ("channel_polarity", PROMISED.polarity)):
        assert [one.options for one in every if one.name == name] == list(promised)
    moved = [one.options for one in every if one.name == "sensor_position"]
    assert [one["response"] for one in moved] == [3, 17]
    # Where nothing was measured that could be exchanged, as in a table, nothing is.
    model = plate()
    table = candidates(model, model.known.new_zeros(0), Channels((3,), (7,)))
    assert not names(table) & {"channel_swap", "channel_polarity"}


@pytest.mark.parametrize("where", ["near", "far"])
@pytest.mark.check
def test_a_neutral_value_leaves_the_frfs_as_they_are(where):
    model = plate({"plate.youngs_modulus": Searched(1.8e11, 2.4e11)})
    theta = torch.tensor([2.01e11], dtype=torch.float64)
    plain = model.frf(theta, LINES)
    seen = set()
    for one in candidates(model, theta, CHANNELS):
        if not one.searched:
            continue
        assert one.searched.keys() - WHERE - WITHOUT.get(one.name, set()) <= one.neutral.keys(), one.name
        whole = with_candidate(model, "new", one)
        middle = getattr(one, where)[len(getattr(one, where)) // 2]
        # Of a rib one number at a time is tried: its place alone is none.
        trial = middle if one.name != "rib" else next(t for t in getattr(one, where) if t.values["bending"] > 0)
        neutral = one.neutral or {"x1": trial.values["x0"]}
        for values, same in ((dict(trial.values) | neutral, True), (trial.values, False)):
            own = vector(whole, values, "new")
            member = torch.where(own.isnan(), theta[0], own)
            change = float((whole.frf(member, LINES) - plain).norm() / plain.norm())
            # Elements that differ are summed in another order; a tiny step changes far more than that does.
            assert (change < 1e-9) if same else (change > 1e-8), (one.name, values, change)
        seen.add(one.name)
    assert len(seen) > 15


def test_what_has_no_number_is_there_or_not():
    model = plate()
    theta = model.known.new_zeros(0)
    plain = model.frf(theta, LINES)
    for one in found(model):
        if not one.searched:
            changed = with_candidate(model, "new", one).frf(theta, LINES)
            assert float((changed - plain).norm() / plain.norm()) > 0.1, one.options


def test_a_support_that_is_not_searched_keeps_all_its_factors_beside_one_that_is():
    further = CATALOGUE["support_spring"](at=((0.4, 0.5),))
    model = plate()
    effects = {**model.effects, "further": further}
    searched = {"further.stiffness": Searched(100.0, 900.0)}
    numbers = KNOWN | {"further.viscous_damping": 0.1}
    beside = PlateModel(model.mesh, effects, numbers, searched, list(CHANNELS.response), list(CHANNELS.reference))
    theta = torch.tensor([300.0], dtype=torch.float64)
    (own,) = [one for one in candidates(beside, theta, CHANNELS) if one.options.get("nodes") == [2, 10, 19]]
    assert own.searched.keys() == {"factor_1", "factor_2", "factor_3"}


@pytest.mark.parametrize("name", [one for one, kind in CATALOGUE.items() if {"x", "y"} <= kind.parameters.keys()])
def test_what_is_tried_at_one_place_is_of_all_strengths(name):
    model = plate()
    one = next(one for one in found(model) if one.name == name)
    members = spread_at(one, 0.3, 0.7, 64)
    assert len(members) == 64
    assert {(member["x"], member["y"]) for member in members} == {(0.3, 0.7)}
    for key, interval in one.searched.items():
        if key in ("x", "y"):
            continue
        values = sorted(member[key] for member in members)
        assert interval.low <= values[0] < values[-1] <= interval.high
        neutral = one.neutral.get(key, 0.0)
        if neutral < interval.low:
            neutral = 0.0
        change = sorted(abs(value - neutral) for value in values)
        # As many below a tenth of the largest as above it, of two decades; and of fewer, about the middle.
        middle = (change[0] * change[-1]) ** 0.5
        assert 20 < sum(value < middle for value in change) < 44, key


@pytest.mark.parametrize("name", ["hysteretic_damping", "edge_spring", "viscous_damping", "orthotropy", "rib"])
def test_each_number_of_an_effect_is_tried_alone(name):
    one = next(one for one in found(plate()) if one.name == name)
    rest = {key: max(neutral, one.searched[key].low) for key, neutral in one.neutral.items()}
    alone = {
        key
        for trial in one.far
        for key in rest
        if trial.values[key] != rest[key]
        and all(trial.values[other] == at_rest for other, at_rest in rest.items() if other != key)
    }
    assert alone == rest.keys()
    # One that changes nothing is no trial.
    assert all(any(trial.values[key] != rest[key] for key in rest) for trial in one.far)


def test_a_number_that_was_said_to_be_known_may_be_what_is_wrong():
    """Sides to 0.3 mm of a plate whose drawing is of another: but not a ratio that is looked for in any case."""
    model = plate({"grain.young_ratio": Searched(0.7, 0.9)})
    effects = {**model.effects, "sides": CATALOGUE["aspect_ratio"]()}
    searched = {"sides.ratio": Searched(0.998, 1.002)}
    beside = PlateModel(model.mesh, effects, KNOWN, searched, list(CHANNELS.response), list(CHANNELS.reference))
    theta = torch.tensor([1.0], dtype=torch.float64)
    assert "aspect_ratio" not in names(candidates(beside, theta, CHANNELS))
    told = [one for one in candidates(beside, theta, CHANNELS, told=["sides.ratio"]) if one.name == "aspect_ratio"]
    assert [set(one.searched) for one in told] == [{"ratio"}]
    # Somebody has measured it.
    assert [one.overrules for one in told] == [True]
    assert not any(one.overrules for one in candidates(beside, theta, CHANNELS))
    # Or nobody has, and it is held by what was measured of other numbers.
    held = candidates(beside, theta, CHANNELS, told=["sides.ratio"], measured=[])
    assert [one.overrules for one in held if one.name == "aspect_ratio"] == [False]
    # Beside what it was said to be known to.
    assert told[0].searched["ratio"].low < 0.95


def test_ribs_are_tried_along_both_sides_and_along_half_of_each():
    (rib,) = [one for one in found(plate()) if one.name == "rib"]
    assert rib.is_local
    assert not rib.is_placed
    lines = {tuple(trial.values[key] for key in ("x0", "y0", "x1", "y1")) for trial in rib.far}
    assert len(lines) == 30
    assert all(x0 == x1 or y0 == y1 for x0, y0, x1, y1 in lines)
    strengths = ("bending", "torsion", "mass_per_length")
    for trial in (*rib.far, *rib.near):
        # Its stiffnesses together, or its mass; along the whole of a line each alone.
        tried = [trial.values[key] > 0 for key in strengths]
        whole = abs(trial.values["x1"] - trial.values["x0"]) + abs(trial.values["y1"] - trial.values["y0"]) > 0.7
        assert tried in ([True, True, False], [False, False, True]) or (whole and sum(tried) == 1)
        # Nothing lies the other way: no rib takes stiffness or mass off the plate.
        assert trial.lowest == 0
    # As stiff as the plate is, and a fiftieth of that: from one of both, a straight line does not lead to the other.
    bent = sorted({trial.values["bending"] for trial in rib.far if trial.values["bending"] > 0})
    stiffest = rib.searched["bending"].high
    assert bent[0] < 0.02 * stiffest < 0.5 * stiffest < bent[-1]
    assert all(after < 7 * before for before, after in itertools.pairwise(bent))
    assert all(trial.rest is not None and not any(trial.rest[key] for key in strengths) for trial in rib.near)
