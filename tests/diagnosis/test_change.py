"""What changed between two tests of one plate, beside a model that is several per cent off in both."""

import dataclasses
import functools
import math
from collections.abc import Mapping

import pytest
import torch

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.change import PlateTest, what_changed
from torchplate.diagnosis.change.after import After, Ended, against_the_next
from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.comparison import Comparing, Promise, State, ways_of
from torchplate.diagnosis.change.flow import comparing_of, target_of
from torchplate.diagnosis.change.posterior import Weighed, chance
from torchplate.diagnosis.change.settings import SETTINGS
from torchplate.diagnosis.change.settling import End
from torchplate.diagnosis.change.summary import summarise
from torchplate.diagnosis.change.table import _both_ways, _tables
from torchplate.diagnosis.lines import every_nth
from torchplate.diagnosis.problem import Problem
from torchplate.diagnosis.selection.criterion import is_noise, never_equivalent
from torchplate.diagnosis.settings import SETTINGS as DIAGNOSIS
from torchplate.discrepancy import Marginal
from torchplate.effects import CATALOGUE
from torchplate.measurement import Channel, Imperfections, Measurement, NaturalFrequencies
from torchplate.model import PlateModel, Searched, extrapolate, ritz_basis
from torchplate.plate import Mesh

NOBODY = torch.zeros(0, dtype=torch.float64)
# A clamped strip with three known masses, whose tables have five bending modes.
PLACES = (0.25, 0.48, 0.8)
STRIP = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.005}
STEEL = {"plate.youngs_modulus": Searched(1.0e11, 4.0e11)}


def strip(values: dict[str, float] | None = None, edge: float = 0.0) -> PlateModel:
    effects = {"plate": CATALOGUE["plate"]()}
    known = dict(STRIP)
    for number, x in enumerate(PLACES, 1):
        effects[f"m{number}"] = CATALOGUE["point_mass"]()
        known |= {f"m{number}.x": x, f"m{number}.y": 0.5, f"m{number}.mass": 0.006}
    if edge:
        # What no model of these tests knows, in both of them.
        effects["soft"] = CATALOGUE["ground_spring"]()
        known |= {"soft.x": 0.6, "soft.y": 0.5, "soft.stiffness": edge}
    mesh = Mesh(0.38, 0.01, 10, 1, 1, {"x0": "clamped"})
    return PlateModel(mesh, effects, known | (values or {}), None if values else STEEL)


def table(edge: float = 2.0e3, **changed: float) -> NaturalFrequencies:
    values = {"plate.youngs_modulus": 1.9e11} | {f"{name}.mass": mass for name, mass in changed.items()}
    frequency = strip(values, edge).natural_frequencies(NOBODY, 5).tolist()
    # To a part of the spacing of lines, as peaks are read.
    read = {mode: hertz * (1 + 2e-4 * math.sin(7 * mode)) for mode, hertz in enumerate(frequency, 1)}
    return NaturalFrequencies.from_mapping(read, {mode: 4e-4 * hertz for mode, hertz in read.items()})


def of_tables(edge: float = 2.0e3, **changed: float):
    before, after = (PlateTest(strip(), natural_frequencies=one) for one in (table(edge), table(edge, **changed)))
    return what_changed(before, after)


@pytest.mark.check
def test_a_mass_that_was_lightened_is_named_from_natural_frequencies_alone():
    """Though a spring that nobody knows of moves the lowest mode by several per cent, in both tests."""
    found = of_tables(m2=0.002)
    (named,) = found.effects
    assert found.verdict == "explained"
    assert "m2.mass" in {named.name, *named.equivalent}
    if named.name == "m2.mass":
        mass = named.parameters["mass"]
        assert mass.low < 0.002 < mass.high
        assert mass.high < 0.0035
    assert named.gap_after < named.gap_before
    assert named.name in found.remarks[0]


@pytest.mark.check
def test_masses_that_were_lightened_together_are_named_together():
    """One after another starts with an effect at a place of its own, which explains more of both than each alone."""
    found = of_tables(m1=0.0005, m3=0.003)
    names = {one.name: one for one in found.effects}
    assert names.keys() == {"m1.mass", "m3.mass"}
    for name, true in (("m1.mass", 0.0005), ("m3.mass", 0.003)):
        mass = names[name].parameters["mass"]
        assert mass.low <= true <= mass.high
    # Each beside those before it.
    first, second = found.effects
    assert first.gap_before > first.gap_after == second.gap_before > second.gap_after


@pytest.mark.parametrize("mass", [pytest.param(0.0, marks=pytest.mark.check), 0.012])
@pytest.mark.check
def test_what_the_modes_of_a_model_that_is_far_off_leave_of_a_change_is_no_second_one(mass):
    """The spring that nobody knows of bends each mode: the mass that went leaves another part of each."""
    found = of_tables(2e4, m2=mass)
    assert [one.name for one in found.effects] == ["m2.mass"]
    assert found.verdict == "explained"
    assert not found.effects[0].equivalent


@pytest.mark.check
def test_tables_that_are_alike_name_nothing():
    found = of_tables()
    assert found.verdict == "consistent"
    assert not found.effects
    assert found.remarks[0].startswith("No change")


@pytest.mark.check
def test_what_came_and_what_went_share_the_prior_of_their_name():
    tables = _tables(*(PlateTest(strip(), natural_frequencies=one) for one in (table(), table(m2=0.0))), SETTINGS)
    effect, prior = CATALOGUE["point_mass"](), {"x": Searched(0.0, 1.0), "y": Searched(0.0, 1.0)}
    mass = Candidate(effect, {}, prior | {"mass": Searched(0.0, 0.01)}, {"mass": 0.0})
    ways = _both_ways(tables, Change("point_mass", "one", mass, n_option=3), SETTINGS)
    assert [(fit.gone, fit.change.n_option) for fit in ways] == [(False, 6), (True, 6)]
    # A parameter goes up and down in one interval.
    moved = Change("m2.mass", "m2", interval=Searched(0.0, 0.01), before=0.006)
    assert [(fit.gone, fit.change.n_option) for fit in _both_ways(tables, moved, SETTINGS)] == [(False, 1)]


def test_one_kind_of_test_is_not_held_against_another():
    before = PlateTest(strip(), natural_frequencies=table())
    with pytest.raises(ValueError, match="in both tests"):
        what_changed(before, PlateTest(strip(), measurement=measured(plate(TRUE), 1)))


# A free plate on soft wires, with a soft patch in both tests that no model knows, and a damping of each mode's own.
LINES = torch.arange(20.0, 260.0, 1.2, dtype=torch.float64)
RESPONSE, REFERENCE = (3, 17), (7, 9, 26, 31)
TRUE = {
    "plate.youngs_modulus": 2.05e11,
    "wires.stiffness": 1e4,
    "wires.viscous_damping": 1.0,
    "loss.stiffness_loss_factor": 1e-2,
}
BOX = {
    "plate.youngs_modulus": Searched(1.8e11, 2.3e11),
    "wires.stiffness": Searched(3e3, 3e4, True),
    "wires.viscous_damping": Searched(0.1, 10.0, True),
    "loss.stiffness_loss_factor": Searched(2e-3, 5e-2, True),
}
PATCH = ("stiffness_loss", {"x": 0.4, "y": 0.4, "size": 0.4, "factor": 0.85})
LUMP = ("point_mass", {"x": 0.31, "y": 0.62, "mass": 0.06})
TOLD = Imperfections(position_std=1e-4, frequency_drift=1e-5, calibration_std=1e-3, damping_scatter=0.1)


def plate(values: dict[str, float] | None = None, **more: tuple[str, dict[str, float]]) -> PlateModel:
    wires = CATALOGUE["support_spring"](nodes=[2, 6, 37, 41])
    effects = {"plate": CATALOGUE["plate"](), "wires": wires, "loss": CATALOGUE["hysteretic_damping"]()}
    known = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003} | (values or {})
    for label, (name, numbers) in more.items():
        effects[label] = CATALOGUE[name]()
        known |= {f"{label}.{key}": value for key, value in numbers.items()}
    box = None if values else BOX
    return PlateModel(Mesh(0.43, 0.3, 6, 5), effects, known, box, list(RESPONSE), list(REFERENCE), "accelerance")


def measured(model: PlateModel, seed: int, lines: torch.Tensor = LINES) -> Measurement:
    scatter = (0.1 * torch.randn(12, generator=torch.Generator().manual_seed(9), dtype=torch.float64)).exp()
    with torch.no_grad():
        frf = model.with_damping_factors(scatter).frf(NOBODY, lines)
    level = 4e-3 * frf.abs().square().mean(0, keepdim=True).sqrt() / math.sqrt(2)
    generator = torch.Generator().manual_seed(seed)
    noise = torch.view_as_complex(torch.randn(*frf.shape, 2, generator=generator, dtype=torch.float64)) * level
    response, reference = (tuple(Channel(node) for node in nodes) for nodes in (RESPONSE, REFERENCE))
    every = torch.ones(frf.shape[1:], dtype=torch.bool)
    return Measurement(lines, frf + noise, every, response, reference, kind="accelerance", unit="m/(N s²)")


def of_frfs(values: dict[str, float] | None = None, **more: tuple[str, dict[str, float]]):
    before = PlateTest(plate(), measured(plate(TRUE, patch=PATCH), 1), imperfections=TOLD, name="before")
    truth = plate(TRUE | (values or {}), patch=PATCH, **more)
    # The data come from the same mesh.
    return what_changed(before, PlateTest(plate(), measured(truth, 2), imperfections=TOLD), as_given=True)


@pytest.mark.check
def test_a_mass_that_came_is_named_beside_a_patch_that_was_there_before():
    found = of_frfs(lump=LUMP)
    (named,) = found.effects
    assert (found.verdict, named.name) == ("explained", "point_mass")
    for key, true in LUMP[1].items():
        # Within a fifth of the spacing of the sensors, and a tenth of the mass.
        assert named.parameters[key].value == pytest.approx(true, abs=0.03 if key != "mass" else 0.006)
    assert "since before" in found.remarks[0]


@pytest.mark.check
def test_softer_wires_are_named():
    found = of_frfs({"wires.stiffness": 5e3})
    assert found.effects[0].name in ("wires.stiffness", "support_asymmetry")
    assert "wires.stiffness" in {found.effects[0].name, *found.effects[0].equivalent}


@pytest.mark.check
def test_two_tests_of_an_unchanged_plate_are_consistent():
    found = of_frfs()
    assert found.verdict == "consistent"
    assert not found.effects


@functools.cache
def warmed() -> Comparing:
    """Two tests of an unchanged plate that loses little, the second two kelvin warmer."""
    light = {"loss.stiffness_loss_factor": 1e-3, "wires.viscous_damping": 0.1}
    warm = light | {"plate.youngs_modulus": TRUE["plate.youngs_modulus"] * (1 + 1e-3)}
    box = {
        "loss.stiffness_loss_factor": Searched(2e-4, 5e-2, True),
        "wires.viscous_damping": Searched(0.01, 10.0, True),
    }
    lines = torch.arange(20.0, 110.0, 0.12, dtype=torch.float64)
    told = Imperfections(position_std=1e-4, frequency_drift=1e-4, calibration_std=1e-3, damping_scatter=0.1)
    before, after = (
        PlateTest(
            plate().replaced(searched=BOX | box),
            measured(plate(TRUE | values, patch=PATCH), seed, lines),
            imperfections=told,
        )
        for seed, values in ((1, light), (2, warm))
    )
    return comparing_of(before, after, (), 0, lambda _: None, SETTINGS, True)


@pytest.mark.check
def test_what_drifts_is_integrated_about_where_it_went_however_sharp_the_peaks():
    """Five parts in ten thousand are half a width of these peaks: taken for linear, 24 times the noise is left."""
    comparing = warmed()
    none = comparing.none()
    assert none.fit.reduced_misfit < none.fit.comparison.size_limit
    assert none.fit.judged.noise_scale**2 < none.fit.comparison.noise_limit
    # Another modulus is another way to the same frequencies, and has nothing left to explain.
    box = comparing.given.searched["plate.youngs_modulus"]
    change = Change("plate.youngs_modulus", "plate", interval=box, before=TRUE["plate.youngs_modulus"])
    start = {"plate.youngs_modulus": TRUE["plate.youngs_modulus"]}
    moved = comparing.after.fit([change], [start], none.nuisances)
    assert moved.fit.cost > none.fit.cost - chance(Weighed(change, 0.0, 0.0, 1), 1, SETTINGS)


@functools.cache
def lightened():
    """A test without a mass and one with it, a mass that is sought, and the place of its mirror image."""
    before = PlateTest(plate(), measured(plate(TRUE), 1), imperfections=TOLD)
    test = PlateTest(plate(), measured(plate(TRUE, lump=LUMP), 2), imperfections=TOLD)
    comparing = comparing_of(before, test, (), 0, lambda _: None, SETTINGS, True)
    own = {key: Searched(0.0, 1.0) for key in ("x", "y")} | {"mass": Searched(0.0, 0.2)}
    change = Change("point_mass", "one", Candidate(CATALOGUE["point_mass"](), {}, own, {"mass": 0.0}))
    place = LUMP[1] | {"x": 1 - LUMP[1]["x"]}
    return comparing, change, {f"one.{key}": value for key, value in place.items()}


@pytest.mark.check
def test_what_is_said_beside_the_reference_is_said_of_the_test_and_its_own_noise():
    """A reference that leaves twice its noise doubles what the test after is weighed by, and not what is reported."""
    after = lightened()[0].after
    builder, reference = after.builder, after.reference
    plain = builder.target.at_all_lines
    target = against_the_next(builder, dataclasses.replace(reference, noise_scale=2.0)).target
    assert torch.equal(target.noise.std, 2.0 * builder.target.noise.std)
    assert torch.equal(target.at_all_lines.noise.std, plain.noise.std)
    assert torch.equal(target.at_all_lines.frequency, plain.frequency)


@pytest.mark.check
def test_a_mass_is_found_from_its_mirror_image():
    """Over the line in the middle the natural frequencies are alike: the wide levels alone end there."""
    comparing, change, wrong = lightened()
    starts, _ = comparing.after.down([change], [wrong])
    for key, true in LUMP[1].items():
        assert starts[0][f"one.{key}"] == pytest.approx(true, abs=0.03 if key != "mass" else 0.01)
    # Each end once, the best first.
    assert len(starts) == 1 or max(abs(starts[0][f"one.{key}"] - starts[1][f"one.{key}"]) for key in "xy") > 0.05


@pytest.mark.check
def test_a_change_without_a_number_is_tried_from_afar_too():
    """A channel is turned or not."""
    comparing, _, _ = lightened()
    channels = {"channels": ((None, plate().reference[0]),)}
    turned = Change(
        "channel_polarity", "turned", Candidate(CATALOGUE["channel_polarity"](**channels), channels, {}, {})
    )
    (start,), left = comparing.after.down([turned], [{}])
    _, without = comparing.after.down([], [{}])
    assert start == {}
    assert left > 2 * without > 0


@pytest.mark.check
def test_beside_the_axis_every_start_is_gone_from():
    """The best three of a few values at each place were far from the mass; one of eight was near."""
    comparing, _, _ = lightened()
    promises = comparing._tried(comparing.none())
    (mass,) = [one for one in promises if one.change.name == "point_mass" and one.wide]
    assert len(mass.starts) > SETTINGS.n_start
    starts, _ = comparing.after.down([mass.change], mass.starts)
    for key, true in LUMP[1].items():
        assert starts[0][f"{mass.change.label}.{key}"] == pytest.approx(true, abs=0.03 if key != "mass" else 0.01)


@pytest.mark.check
def test_a_hopeless_change_is_not_followed():
    comparing, change, wrong = lightened()
    count = []
    for hopeless in (math.inf, 1e-3):
        begun = comparing.after.builder.n_evaluation
        comparing.after.fit([change], [wrong], hopeless=hopeless)
        count.append(comparing.after.builder.n_evaluation - begun)
    assert count[1] < 0.7 * count[0]


@pytest.mark.check
def test_what_the_reference_leaves_open_hangs_on_no_rounding():
    """Parameters and modes of their own make one change of sharp peaks between them, and what is left is the error."""
    after = warmed().after
    one = after.hypothesis([])
    for size in (0.0, 1.0):
        drift = torch.full((one.n_drift,), size, dtype=torch.float64)
        held = [after.judged(one, NOBODY, None, drift + step).held for step in (0.0, 1e-13)]
        assert held[1] == pytest.approx(held[0], abs=0.1)


@pytest.mark.check
def test_starts_that_end_at_one_place_are_gone_on_from_once(monkeypatch):
    comparing, change, _ = lightened()
    near = {f"one.{key}": value for key, value in LUMP[1].items()}
    none = comparing.none()
    sharply, gone_on = After._sharply, []

    def counted(self, *given, **named):
        gone_on.append(named.get("drifts", False))
        return sharply(self, *given, **named)

    monkeypatch.setattr(After, "_sharply", counted)
    comparing.after.fit([change], [near] * 3, none.nuisances)
    assert gone_on[:5] == [False, False, False, True, True]
    assert len(gone_on) <= 3 + SETTINGS.n_turn


def falling(monkeypatch, much: float) -> list[int]:
    """Steps of what settles that each fall by so much and leave as much misfit, and an entry for each that is taken."""
    taken = []

    def step(_, one, here, damping):
        taken.append(1)
        there = dataclasses.replace(here)
        there.__dict__.update(held=here.held - much, fit=here.fit)
        return there, damping

    monkeypatch.setattr(After, "_a_step", step)
    return taken


def on_a_way(monkeypatch, held):
    """What settles, with a drift of ones ahead by which −2 ln p is to fall by ten; it falls by what is told of a part.

    Returns:
        It, a hypothesis, where the way begins, and the parts that are asked for.
    """
    after, asked = warmed().after, []

    def ahead(_, one, here):
        return 10.0, None, torch.ones_like(here.put_in)

    def there(_, one, place, channels, drift):
        asked.append(float(drift[0]))
        found = dataclasses.replace(start, drift=drift)
        found.__dict__.update(held=start.held + held(asked[-1]))
        return found

    one = after.hypothesis([])
    start = after.judged(one, NOBODY, None, torch.zeros(one.n_drift, dtype=torch.float64))
    monkeypatch.setattr(After, "_ahead", ahead)
    monkeypatch.setattr(After, "judged", there)
    return after, one, start, asked


@pytest.mark.check
def test_a_way_that_does_not_lead_down_is_gone_as_far_as_a_parabola_says(monkeypatch):
    """What was promised falls as 2 p − p², and what it knows nothing of grows evenly."""
    after, one, start, asked = on_a_way(monkeypatch, lambda part: -10 * (2 * part - part**2) + 12 * part)
    found, damping = after._a_step(one, start, 0.0)
    assert asked == pytest.approx([1.0, 0.4])
    assert found.drift.tolist() == pytest.approx([0.4] * one.n_drift)
    assert damping == 0


@pytest.mark.check
def test_damped_steps_end_where_they_promise_nothing(monkeypatch):
    after, one, start, asked = on_a_way(monkeypatch, lambda part: 50.0 * part)
    monkeypatch.setattr(After, "_towards", lambda *_: (None, torch.ones_like(start.put_in)))
    monkeypatch.setattr(After, "_by_columns", lambda *_: (start.held - 1e-6, start.marginal, start.off))
    found, _ = after._a_step(one, start, 0.0)
    assert found is start
    # All of the way, and the step that is not damped.
    assert asked == [1.0, 1.0]


@pytest.mark.check
@pytest.mark.parametrize("part", [0.5, 0.0])
def test_a_way_whose_end_promises_nothing_is_not_gone(monkeypatch, part):
    """Residuals that a descent leaves are those beside nuisances as they are: more it does not have to give."""
    comparing, change, wrong = lightened()
    one = comparing.after.hypothesis([change], [wrong])
    start = comparing.after.judged(one, torch.full((3,), 0.5, dtype=torch.float64), None)
    judged, asked = After.judged, []

    def counted(self, *given):
        asked.append(given)
        return judged(self, *given)

    left = torch.tensor([0.5 * (1 - part) * start.fit.square], dtype=torch.float64)
    monkeypatch.setattr(Problem, "descend", lambda _, places, *__: (places, left, 1))
    monkeypatch.setattr(After, "settled", lambda *given: given[-1])
    monkeypatch.setattr(After, "judged", counted)
    comparing.after._sharply(one, start, n_turn=1)
    # The place is the same, and no part of the way there is more probable.
    assert len(asked) == (len(DIAGNOSIS.fitting.parts) if part else 0)


@pytest.mark.check
def test_each_change_is_told_what_it_would_have_to_beat(monkeypatch):
    comparing, change, wrong = lightened()
    none, told = comparing.none(), []

    def fit(_, changes, starts, begun=None, hopeless=math.inf, beat=math.inf):
        told.append(beat)
        return Ended(none.fit, none.nuisances)

    monkeypatch.setattr(After, "fit", fit)
    monkeypatch.setattr(Comparing, "_tried", lambda *_: [Promise(change, 0.9, (wrong,))])
    monkeypatch.setattr(Comparing, "_ways", lambda *_: [(change, (wrong,), 0.0)] * 2)
    comparing._one_more(none)
    assert told[:2] == [math.inf, none.nuisances.held + never_equivalent(none.fit)]


@pytest.mark.check
def test_a_change_that_cannot_come_near_the_best_need_not_settle(monkeypatch):
    comparing, change, _ = lightened()
    near = {f"one.{key}": value for key, value in LUMP[1].items()}
    none = comparing.none()
    resting, told = After.resting, []

    def counted(self, one, here, beat, **named):
        told.append((here, beat))
        return resting(self, one, here, beat, **named)

    monkeypatch.setattr(After, "resting", counted)
    comparing.after.fit([change], [near], none.nuisances, beat=-1e9)
    assert all(beat == -1e9 for _, beat in told)
    one, here = comparing.after.hypothesis([change], [near]), told[0][0]
    monkeypatch.setattr(After, "_is_lost", lambda *_: False)
    for beat, n_step in ((-1e9, 1), (math.inf, SETTINGS.n_settled)):
        taken = falling(monkeypatch, 10.0)
        comparing.after._rested(one, here, beat)
        assert len(taken) == n_step


@pytest.mark.check
def test_channels_that_are_less_probable_than_those_before_are_not_put_in(monkeypatch):
    """Far off their marks they are not linear: what was said of them anew led away for good."""
    after = lightened()[0].after
    one, seen, asked = after.hypothesis([]), End.from_each_other.fget, []

    def then_afar(end):
        found = seen(end)
        asked.append(end)
        return found if len(asked) == 1 else found._replace(response=20 + 0 * found.response)

    monkeypatch.setattr(End, "from_each_other", property(then_afar))
    found = after.settled(one, after.judged(one, NOBODY, None))
    assert len(asked) == 2
    assert found is asked[1]


@pytest.mark.check
def test_no_plate_drifts_by_more_than_ten_standard_deviations(monkeypatch):
    after = warmed().after
    here = after.judged(after.hypothesis([]), NOBODY, None)
    far = torch.linspace(-40.0, 40.0, len(here.put_in)).to(here.put_in)
    monkeypatch.setattr(Marginal, "towards", lambda *_: (far, None))
    channels, drift = after._towards(here.marginal, here.off, 0.0)
    assert channels is None
    assert drift.tolist() == [max(-10.0, min(10.0, value)) for value in far.tolist()]


@pytest.mark.check
def test_a_drift_whose_misfit_still_falls_is_not_lost():
    """One that halves with every round is on its way."""
    after = lightened()[0].after
    far = after.judged(after.hypothesis([]), NOBODY, None)
    assert after._is_lost(far)
    assert after._is_lost(far, far)
    before = after.judged(after.hypothesis([]), NOBODY, None)
    before.__dict__["fit"] = far.fit._replace(judged=far.fit.judged._replace(white=2 * far.fit.judged.white))
    assert not after._is_lost(far, before)


@pytest.mark.check
@pytest.mark.parametrize("sure", [True, False])
def test_changes_are_tried_beside_what_was_found_only_where_hardly_more_than_noise_is_left(monkeypatch, sure):
    """Channels and a drift take on what is missing, and hide it."""
    comparing = warmed() if sure else lightened()[0]
    none = comparing.none()
    assert (none.fit.reduced_misfit < 2.5) == sure
    moved, asked = After.moved, []

    def counted(self, *given):
        asked.append(given)
        return moved(self, *given)

    monkeypatch.setattr(After, "moved", counted)
    comparing._tried(none)
    assert bool(asked) == sure


@pytest.mark.check
def test_no_drift_is_settled_where_far_more_than_noise_is_left(monkeypatch):
    """A mass that is missing is no drift, and what a drift makes of it goes on for ever."""
    after = lightened()[0].after
    one = after.hypothesis([])
    far = after.judged(one, NOBODY, None)
    assert far.fit.reduced_misfit > 100
    taken = falling(monkeypatch, 1e4)
    after._rested(one, far)
    assert len(taken) == SETTINGS.n_turn < SETTINGS.n_settled


@pytest.mark.check
@pytest.mark.parametrize("idle", [True, False])
def test_a_change_that_stood_in_for_the_next_is_taken_back(idle):
    """Beside the mass that came a dashpot that does nothing goes, and the mass stays beside a dashpot."""
    comparing, mass, wrong = lightened()
    own = {key: Searched(0.0, 1.0) for key in ("x", "y")} | {"viscous_damping": Searched(0.0, 10.0)}
    dashpot = Change("ground_dashpot", "two", Candidate(CATALOGUE["ground_dashpot"](), {}, own, {}))
    start = {f"two.{key}": 0.3 for key in ("x", "y")} | {"two.viscous_damping": 1e-3}
    start |= wrong | {f"one.{key}": value for key, value in LUMP[1].items()}
    changes = (dashpot, mass) if idle else (mass, dashpot)
    none = comparing.none()
    both = comparing.after.fit(changes, [start])
    promises = tuple((Promise(change, 0.5, (start,)),) for change in changes)
    steps = [
        (comparing._choice(none.fit, [(one, both.fit)], told), {one.key: both.fit}, none.fit)
        for one, told in zip(changes, promises, strict=True)
    ]
    found = comparing.pruned(State(changes, *both, tuple(steps), promises))
    assert [change.name for change in found.changes] == (["point_mass"] if idle else ["point_mass", "ground_dashpot"])
    assert len(found.choices) == len(found.promises) == len(found.changes)
    assert found.fit.reduced_misfit < 1.3


@pytest.mark.check
def test_a_mass_is_found_where_an_absorber_that_stays_with_the_plate_has_ended(monkeypatch):
    """Its own refit ended at its mirror image; the absorber is as stiff as its interval allows."""
    comparing, mass, wrong = lightened()
    own = {key: Searched(0.0, 1.0) for key in ("x", "y")} | {"mass": Searched(0.0, 0.2)}
    own |= {"stiffness": Searched(1e2, 1e6, True), "viscous_damping": Searched(0.0, 10.0)}
    absorber = Change("absorber", "two", Candidate(CATALOGUE["absorber"](), {}, own, {"mass": 0.0}))
    start = {f"two.{key}": value for key, value in LUMP[1].items()}
    state = comparing.none()
    ended = comparing.after.fit([absorber], [start | {"two.stiffness": 9e5, "two.viscous_damping": 0.1}])
    promises = [Promise(absorber, 0.5, ()), Promise(mass, 0.1, (wrong,))]
    fit, begun = After.fit, []

    def from_where(self, changes, starts, *more):
        begun.append(starts[0])
        return fit(self, changes, starts, *more)

    monkeypatch.setattr(After, "fit", from_where)
    ((change, found),) = comparing._simpler(state, absorber, ended, promises)
    assert change is mass
    where = ended.fit.model.as_dict(ended.fit.theta)
    assert all(begun[0][f"one.{key}"] == where[f"two.{key}"] for key in LUMP[1])
    for key, true in LUMP[1].items():
        value = dict(zip(found.fit.model.names, found.fit.theta.tolist(), strict=True))[f"one.{key}"]
        assert value == pytest.approx(true, abs=0.03 if key != "mass" else 0.006)
    choice = comparing._choice(state.fit, [(absorber, ended.fit), (mass, found.fit)], promises)
    assert choice.best.change is mass


# A soft patch over some elements and a half of others, whose plate is on a mesh that no diagnosis is made on.
SOFT = ("stiffness_loss", {"x": 0.62, "y": 0.55, "size": 0.25, "factor": 0.6})
SPOTS = ([(0.11, 0.87), (0.43, 0.31)], [(0.2, 0.2), (0.71, 0.4), (0.35, 0.75), (0.9, 0.63)])


def on_a_mesh_of_its_own(model: PlateModel, split: int) -> PlateModel:
    """The same plate read at places that are no nodes, on a mesh split anew whose error is taken off."""
    response, reference = SPOTS
    mesh = dataclasses.replace(model.mesh, refine=split)
    found = PlateModel(mesh, model.effects, model.known_values, model.searched, response, reference, "accelerance")
    top = float(LINES[-1])
    whole = extrapolate(found, top, NOBODY, margin=5.0).model
    return whole.projected(ritz_basis(whole, NOBODY[None], torch.tensor([top]).to(NOBODY), 0, 3.0))


def on_both_meshes(came: bool, step: int = 1):
    """A patch tried beside a plate to which it came, or not: on the mesh where changes are looked for and a finer one.

    Args:
        came: whether it did.
        step: of the lines of the test after that are looked at on the finer mesh.

    Returns:
        What compares on each, where the patch ends on the first, and from where it began.
    """
    given = PlateModel(plate().mesh, plate().effects, plate().known_values, BOX, *SPOTS, "accelerance")
    truths = [on_a_mesh_of_its_own(plate(TRUE, **more), 7) for more in ({}, {"soft": SOFT} if came else {})]
    before, after = (PlateTest(given, measured(one, seed), imperfections=TOLD) for seed, one in enumerate(truths))
    own = {key: Searched(0.0, 1.0) for key in ("x", "y")} | {"size": Searched(0.05, 0.5), "factor": Searched(0.1, 1.5)}
    change = Change("stiffness_loss", "soft", Candidate(CATALOGUE["stiffness_loss"](), {}, own, {"factor": 1.0}))
    targets = target_of(before, 0), target_of(after, 0)
    comparing = comparing_of(before, after, (), 0, lambda _: None, SETTINGS, False, None, targets)
    others = targets[0], every_nth(targets[1], step)
    finer = comparing_of(before, after, (), 0, lambda _: None, SETTINGS, False, DIAGNOSIS.meshes.settling, others)
    start = {f"soft.{key}": value for key, value in SOFT[1].items()}
    if not came:
        start["soft.factor"] = 0.99
    found = comparing.after.fit([change], [start])
    state = State((change,), *found, promises=((Promise(change, 0.9, (start,)),),))
    return comparing, finer, state, start


@pytest.mark.check
@pytest.mark.proof
def test_a_patch_that_came_is_as_large_as_it_is_on_whatever_mesh():
    """Its corners and the elements that its edges cut are a per cent and more of it on 18 × 15 elements."""
    comparing, finer, state, start = on_both_meshes(came=True)
    for fit in (state.fit, comparing.settled(state, finer).fit):
        assert is_noise(fit)
        off = fit.theta - torch.tensor([start[name] for name in fit.model.names], dtype=torch.float64)
        # The quantile at 99.9 % of χ² of four numbers: the mesh alone made 22.7 of it.
        assert float(off @ torch.linalg.solve(fit.covariance, off)) < 18.5


@pytest.mark.check
def test_what_was_settled_beside_other_lines_is_told_of_all_of_them():
    """A mode that comes into the band on the finer mesh brings ten lines with it."""
    comparing, finer, state, _ = on_both_meshes(came=True, step=2)
    none, target = comparing.none(), comparing.after.builder.target
    choice = comparing._choice(none.fit, [(state.changes[0], state.fit)], state.promises[0])
    last = comparing.settled(dataclasses.replace(state, choices=((choice, {}, none.fit),)), finer)
    assert len(last.finer.frequency) < len(target.frequency)
    test = PlateTest(comparing.given, target.measurement)
    found = summarise(comparing, none, last, (test, test), 0.0)
    assert (found.verdict, [one.name for one in found.effects]) == ("explained", ["stiffness_loss"])
    assert found.gap.final < 1.2 * found.gap.expected < found.gap.baseline
    assert found.overlay.after.shape == found.overlay.before.shape == target.measurement.frf.shape


@pytest.mark.check
def test_a_change_that_does_not_show_on_a_finer_mesh_is_taken_back():
    comparing, finer, state, _ = on_both_meshes(came=False)
    settled = comparing.settled(state, finer)
    assert settled.changes == settled.choices == ()
    assert settled.fit.model.names == comparing.none().fit.model.names


@pytest.mark.check
def test_a_change_that_changes_nothing_leaves_the_mesh_error_as_it_was():
    """That of both tests is the reference's: taken off a plate from the middle of the box it stood for a change."""
    wide = BOX | {"wires.stiffness": Searched(1e3, 1e6, True)}
    given = PlateModel(plate().mesh, plate().effects, plate().known_values, wide, *SPOTS, "accelerance")
    truth = on_a_mesh_of_its_own(plate(TRUE), 7)
    before, after = (PlateTest(given, measured(truth, seed), imperfections=TOLD) for seed in (0, 1))
    of_after = comparing_of(before, after, (), 0, lambda _: None, SETTINGS, False).after
    own = {key: Searched(0.0, 1.0) for key in ("x", "y")} | {"size": Searched(0.05, 0.5), "factor": Searched(0.1, 1.5)}
    change = Change("stiffness_loss", "soft", Candidate(CATALOGUE["stiffness_loss"](), {}, own, {"factor": 1.0}))
    nothing = {f"soft.{key}": value for key, value in (SOFT[1] | {"factor": 1.0}).items()}
    there = of_after.taken_off_at([change], nothing)
    taken_off, anew = (
        one.correction.stiffness.diagonal() / one.correction.rigidity for one in (of_after.model.assembly, there.anew)
    )
    # Of modes that the wires hold it was seven times as large in the middle of the box, of others up to a half more.
    assert torch.allclose(taken_off, anew, rtol=0.05)


def test_a_change_that_promises_least_is_refitted_where_it_ends_lowest():
    """A few values on its interval say little of where a parameter ends, once it is free to go there."""
    others = [Promise(Change(f"wires.k{k}", "wires"), 0.9 - 0.02 * k, ({},), wide=True) for k in range(12)]
    right = Promise(Change("wires.stiffness", "wires"), 0.3, ({"wires.stiffness": 5e3},), wide=True)
    left = {one.change.name: 20.0 for one in others} | {"wires.stiffness": 0.1}
    # What a tangent promises, of which nothing is lost either.
    near = Promise(Change("loss.stiffness_loss_factor", "loss"), 0.8, ({},))

    def down(one: Promise) -> tuple[tuple[Mapping[str, float], ...], float]:
        return one.starts, left[one.change.name]

    ways = ways_of([near], [*others, right], down, misfit=50.0, most=8, beside=6.0)
    assert [(change.name, promised) for change, _, promised in ways] == [
        ("wires.stiffness", 0.0),
        ("loss.stiffness_loss_factor", pytest.approx(10.0)),
    ]


@torch.no_grad()
def test_a_mode_off_by_its_own_number_moves_alone():
    """By that part of its frequency; the basis says nothing of it."""
    from torchplate.diagnosis.change.specimen import OwnModes, ReferenceSpecimens
    from torchplate.discrepancy.wandering import UNIFORM

    model = plate(TRUE)
    modes = OwnModes.of(model, model, NOBODY, 8)
    specimens = ReferenceSpecimens(model, NOBODY, UNIFORM, 0.5, modes, 0.05)
    shift = torch.zeros(len(specimens.names), dtype=torch.float64)
    shift[5] = 0.2
    before, after = (one.natural_frequencies(NOBODY, 8) for one in (model, specimens.at(shift)))
    moved = (after / before).log()
    # √(1 + 2b) is 1 + b to the second order.
    assert float(moved[5]) == pytest.approx(0.01, rel=0.02)
    assert float(moved[[0, 1, 2, 3, 4, 6, 7]].abs().max()) < 1e-6
