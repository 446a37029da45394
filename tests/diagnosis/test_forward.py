"""From a model and a measurement to what is missing, end to end; the data come from a much finer mesh."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace

import pytest
import torch

import torchplate as tp
from torchplate.diagnosis.candidates.candidate import nameable
from torchplate.diagnosis.fit import fit
from torchplate.diagnosis.judged import Fit, judged_at
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.selection import forward, pairs, ranking, settling
from torchplate.diagnosis.selection.criterion import choose, is_noise, known_section, remaining
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.selection.ranking import Ranking
from torchplate.diagnosis.selection.screen import Scored
from torchplate.diagnosis.selection.steps import added
from torchplate.diagnosis.selection.trace import Naming, Ranked, State
from torchplate.diagnosis.selection.worth import explains_some, tried_enough, worth_their_names
from torchplate.diagnosis.settings import SETTINGS
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import Found
from torchplate.effects import CATALOGUE, Effect, Parameter
from torchplate.measurement import PERFECT, NaturalFrequencies
from torchplate.measurement.assessment.noise import Noise
from torchplate.model import PlateModel, Searched, extrapolate, ritz_basis
from torchplate.plate import Local, Mesh

RESPONSE, REFERENCE = (3, 17), (7, 9, 14)
LINES = torch.linspace(20.0, 275.0, 120, dtype=torch.float64)
KNOWN = {
    "plate.youngs_modulus": 2.05e11,
    "plate.poisson_ratio": 0.3,
    "plate.density": 7850.0,
    "plate.thickness": 0.003,
    "wires.stiffness": 1500.0,
    "wires.viscous_damping": 0.7,
    "loss.stiffness_loss_factor": 1e-2,
}
YOUNG = {"plate.youngs_modulus": Searched(1.7e11, 2.4e11)}
SHARE = 0.01


@dataclass(frozen=True)
class Strut(Effect):
    """A spring between two places of the plate, which no effect of the catalogue is."""

    parameters = {"strength": Parameter("N/m", "stiffness", neutral=0.0)}
    acts_on = frozenset({"stiffness"})
    shows = "Only this test uses it."
    source = "none"

    def local(self, mesh, value):
        ends = mesh.deflection_at(mesh.places([(0.15, 0.2), (0.8, 0.9)]).to(value["strength"]))
        return Local(ends[:1] - ends[1:], stiffness=value["strength"][..., None])


# The catalogue is what users see, and what is looked for.
del CATALOGUE["strut"]


def plate(
    searched: Mapping[str, Searched] | None = None,
    hidden: Sequence[tuple[Effect, Mapping[str, float]]] = (),
    response: Sequence[int] = RESPONSE,
    reference: Sequence[int] = REFERENCE,
    wires: Sequence[int] = (2, 10, 19),
    refine: int = 1,
) -> PlateModel:
    searched = searched or {}
    effects: dict[str, Effect] = {
        "plate": CATALOGUE["plate"](),
        "loss": CATALOGUE["hysteretic_damping"](),
    }
    if wires:
        effects["wires"] = CATALOGUE["support_spring"](nodes=wires)
    known = {key: value for key, value in KNOWN.items() if key not in searched and key.split(".")[0] in effects}
    for index, (effect, values) in enumerate(hidden):
        effects[f"hidden_{index}"] = effect
        known |= {f"hidden_{index}.{key}": value for key, value in values.items()}
    mesh = Mesh(0.43, 0.3, 4, 3, refine)
    return PlateModel(mesh, effects, known, searched, list(response), list(reference), "accelerance")


def hide(name: str, options: Mapping[str, object] | None = None, **values: float):
    return CATALOGUE[name](**(options or {})), values


MASS = hide("point_mass", x=0.72, y=0.31, mass=0.06)
HOLE = hide("cut_out", x0=0.43, y0=0.31, x1=0.57, y1=0.47)
SMALL_HOLE = hide("cut_out", x0=0.71, y0=0.33, x1=0.79, y1=0.41)
RIB = hide("rib", x0=0.21, y0=0.27, x1=0.23, y1=0.83, bending=30.0, torsion=12.0, mass_per_length=0.1)
FLIPPED = hide("channel_polarity", {"channels": ((None, 9),)})
CASES = {
    "nothing": ((), YOUNG, {}),
    "twins": ((hide("density", value=7650.0),), YOUNG, {"wires": ()}),
    "two": ((MASS, FLIPPED), YOUNG, {}),
    "beyond": (((Strut(), {"strength": 6e4}),), YOUNG, {}),
    "alone": ((hide("sensor_gain", gain=1.4),), YOUNG, {"response": (3,), "reference": (7,)}),
    "upside down": (
        (hide("channel_polarity", {"channels": ((3, None),)}),),
        YOUNG,
        {"response": (3,), "reference": (7, 9, 14, 11)},
    ),
}


@pytest.fixture(scope="module")
def diagnosed(lab):
    """Each case, of a test without imperfections, is diagnosed once, where it is first asked for."""
    done: dict[str, SimpleNamespace] = {}

    def get(name: str) -> SimpleNamespace:
        if name not in done:
            hidden, searched, channels = CASES[name]
            # A force at a place needs a fine mesh.
            true = plate(hidden=hidden, refine=10 if MASS in hidden else 4, **channels)
            frf = extrapolate(true, float(LINES[-1])).model.frf(lab.nobody, LINES)
            std = lab.true_std(frf, SHARE, "mixed")
            where = channels.get("response", RESPONSE), channels.get("reference", REFERENCE)
            measured = lab.measured(LINES, frf + lab.noise_of(std, 11), *where)
            model = plate(searched, **channels)
            said: list[str] = []
            # Looking for a second and a third effect takes longer, and ends no better where none is in the catalogue.
            most = 1 if name == "beyond" else 3
            found = tp.diagnose(model, measured, imperfections=PERFECT, most_effects=most, say=said.append)
            done[name] = SimpleNamespace(found=found, measured=measured, model=model, said=said)
        return done[name]

    return get


def others(found: tp.Diagnosis):
    """What was named beside a finer mesh."""
    return [one for one in found.effects if one.name != "mesh_discretisation"]


def value(one, name: str) -> float:
    return one.parameters[name].value


# Cases that take long: `make check` has them.
LONG = ("two", "beyond", "alone", "twins", "upside down")


@pytest.fixture(params=[pytest.param(name, marks=pytest.mark.check) if name in LONG else name for name in CASES])
def case(request, diagnosed) -> SimpleNamespace:
    return diagnosed(request.param)


@pytest.mark.check
def test_where_nothing_is_hidden_nothing_is_named(diagnosed):
    found = diagnosed("nothing").found
    assert found.verdict == "consistent"
    assert others(found) == []
    assert found.missing == ()
    assert found.gap.final == pytest.approx(found.gap.noise_floor, rel=0.1)
    young = found.parameters["plate.youngs_modulus"]
    assert young.value == pytest.approx(KNOWN["plate.youngs_modulus"], rel=1e-3)
    assert young.std is not None
    assert young.std < 1e-3 * young.value


def test_a_mesh_that_is_too_coarse_is_said_and_mended(diagnosed):
    """Four by three elements for eight modes: the model's own missing effect."""
    found = diagnosed("nothing").found
    (first,) = found.effects
    assert first.name == "mesh_discretisation"
    assert first.gap_after < 0.2 * first.gap_before
    assert found.steps[1].label == "+ mesh_discretisation"


@pytest.mark.check
def test_twins_are_named_as_a_set(diagnosed):
    """A free plate of another density is, at another modulus, one of another thickness or a chain of another gain."""
    found = diagnosed("twins").found
    assert found.verdict == "explained"
    (one,) = others(found)
    together = {one.name, *one.equivalent}
    assert {"density", "thickness", "sensor_gain"} <= together
    assert not together & {"point_mass", "time_delay", "channel_polarity", "orthotropy", "aspect_ratio"}
    assert "weigh" in found.next_measurements[0]
    assert all(name in one.evidence for name in one.equivalent)


@pytest.mark.check
def test_what_the_catalogue_does_not_hold_is_said_to_be_missing(diagnosed):
    found = diagnosed("beyond").found
    assert found.verdict in ("unexplained", "partly_explained")
    # The contract: what is unexplained names nothing, a finer mesh neither.
    assert (found.effects == ()) == (found.verdict == "unexplained")
    assert bool(others(found)) == (found.verdict == "partly_explained")
    assert len(found.missing) >= 2
    assert all(sentence.endswith(".") for sentence in found.missing)
    assert "noise" in found.missing[0]
    assert found.gap.final > 3 * found.gap.noise_floor
    assert any("twice as hard" in sentence for sentence in found.next_measurements)


@pytest.mark.check
def test_a_single_frf_is_enough_for_a_gain(diagnosed):
    found = diagnosed("alone").found
    assert found.verdict == "explained"
    (one,) = others(found)
    assert "sensor_gain" in {one.name, *one.equivalent}
    assert found.gap.heldout_baseline is None
    assert found.gap.heldout_final is None
    assert all(step.heldout is None for step in found.steps)


def test_the_numbers_agree_with_each_other(case):
    found, measured = case.found, case.measured
    gap, steps = found.gap, found.steps
    assert (steps[0].label, steps[0].gap) == ("baseline", gap.baseline)
    assert (steps[-1].gap, steps[-1].heldout) == (gap.final, gap.heldout_final)
    assert gap.noise_floor == pytest.approx(SHARE, rel=0.25)
    assert gap.final <= gap.baseline or case.found.verdict == "unexplained"
    labels = [step.label.removeprefix("+ ") for step in steps if step.label.startswith("+")]
    assert set(labels) >= {one.name for one in found.effects}
    names = {one.name for one in found.effects}
    # A reader who goes down the table ends at the final gap, and meets no gap that the row above does not have.
    assert [(one.gap_before, one.gap_after) for one in found.effects] == [
        (before.gap, after.gap) for before, after in pairwise(steps) if after.label.removeprefix("+ ") in names
    ]
    for one in found.effects:
        assert one.gap_after <= one.gap_before or one.name == "mesh_discretisation"
        assert 0 < one.confidence < 1
        assert one.evidence.endswith(".")
        assert one.name not in one.equivalent
        for told in one.parameters.values():
            assert math.isfinite(told.value)
    # What is drawn is what was measured, and gives the same gaps.
    seen = found.overlay
    assert seen is not None
    assert torch.equal(seen.measured.frf, measured.frf)
    for after, heldout, expected in (
        (seen.before, ~seen.heldout, gap.baseline),
        (seen.after, ~seen.heldout, gap.final),
        (seen.after, seen.heldout, gap.heldout_final),
    ):
        each = (after - measured.frf).norm(dim=0) / measured.frf.norm(dim=0)
        if expected is not None:
            assert float(each[heldout].mean()) == pytest.approx(expected, rel=1e-9)
    assert found.model.names == ()
    text = json.dumps(found.to_dict(), allow_nan=True)
    assert "nan" not in text.lower().replace("resonan", "")


@pytest.mark.check
def test_the_model_that_is_handed_over_is_the_one_that_was_fitted_in_numbers(diagnosed):
    found = diagnosed("twins").found
    some, nothing = slice(None, None, 40), found.model.known[:0]
    # In a basis of its own: all of its dofs would take minutes.
    model = found.model.projected(ritz_basis(found.model, nothing[None], LINES, 0, 5.0))
    again, drawn = model.frf(nothing, LINES[some]), found.overlay.after
    assert torch.allclose(again, drawn[some], rtol=2e-3, atol=float(2e-3 * drawn.abs().max()))


def test_the_given_model_is_left_alone(case):
    wires = (2, 10, 19) if "wires" in case.model.effects else ()
    fresh = plate(YOUNG, response=case.model.response, reference=case.model.reference, wires=wires)
    assert "mesh_discretisation" not in {effect.name for effect in case.model.effects.values()}
    assert case.model.mesh == fresh.mesh
    assert case.model.assembly.size == fresh.assembly.size
    assert case.said[0].startswith("baseline")


@pytest.mark.check
def test_the_table_names_every_effect_once_and_says_what_became_of_it(diagnosed):
    found = diagnosed("upside down").found
    table = found.scores[0]
    names = [row.name for row in table]
    assert len(set(names)) == len(names)
    # No grain on this plate that could be turned.
    assert set(names) == set(nameable()) - {"grain_angle"}
    remarks = {row.name: row.remark for row in table}
    assert remarks.pop("channel_polarity") == "named"
    assert all(remark.startswith("rejected") for remark in remarks.values())


@pytest.mark.check
def test_a_sensor_upside_down_is_named_and_bends_nothing(diagnosed):
    """All channels there are: nothing else says which way is up."""
    found = diagnosed("upside down").found
    assert found.verdict == "explained"
    (one,) = others(found)
    assert (one.name, one.options) == ("channel_polarity", {"channels": ((3, None),)})
    assert one.confidence > 0.95
    assert found.parameters["plate.youngs_modulus"].value == pytest.approx(KNOWN["plate.youngs_modulus"], rel=1e-3)


@pytest.mark.check
def test_both_of_two_are_named_with_their_numbers(diagnosed):
    found = diagnosed("two").found
    assert found.verdict == "explained"
    assert {one.name for one in others(found)} == {"point_mass", "channel_polarity"}
    (mass,) = [one for one in others(found) if one.name == "point_mass"]
    for key, true in MASS[1].items():
        told = mass.parameters[key]
        # Four standard errors, and what the mesh of the FRFs leaves.
        assert told.value == pytest.approx(true, abs=4 * told.std + 2e-3 * true)


@torch.no_grad()
@pytest.mark.parametrize(
    ("by_noise", "squares", "gaps", "worth"),
    [
        (True, 0.4, 0.6, True),
        (True, 0.6, 0.6, False),
        # It took half of the sum of squares, from lines that nobody sees.
        (True, 0.4, 0.98, False),
        # Beside an inflated model error, more probable than none says little.
        (False, 0.9, 0.45, True),
        (False, 0.4, 0.6, False),
    ],
)
@pytest.mark.check
def test_where_more_is_missing_a_name_has_to_take_a_part_of_what_is_left(lab, by_noise, squares, gaps, worth):
    scene = lab.Scene(hidden={"gain": 1.5})
    far = lab.leaving(scene.fit, 1e6)._replace(left=0.8, by_noise=by_noise)
    hypothesis = scene.hypothesis("sensor_gain")
    less = lab.leaving(scene.fit, squares * 1e6)._replace(left=gaps * 0.8, by_noise=by_noise)
    before = State(scene.state.model, far)
    named = State(scene.state.model, less, (Naming(hypothesis, choose((hypothesis,), far), far),), before)
    assert worth_their_names(named, scene.builder) is (named if worth else before)


@torch.no_grad()
@pytest.mark.parametrize(("squares", "worth"), [(0.4, True), (0.7, False)])
def test_two_names_take_a_part_of_what_there_was_and_not_of_what_the_first_alone_leaves(lab, squares, worth):
    """On the way to a pair the first may leave more than nothing did: beside it any second explains much."""
    scene = lab.Scene(hidden={"gain": 1.5})
    hypothesis = scene.hypothesis("sensor_gain")

    def left(part):
        return lab.leaving(scene.fit, part * 1e6)._replace(left=0.8 * part**0.5, by_noise=True)

    state = before = State(scene.state.model, left(1.0))
    for part in (1.6, squares):
        naming = Naming(hypothesis, choose((hypothesis,), state.fit), state.fit)
        state = State(scene.state.model, left(part), (*state.named, naming), state)
    assert worth_their_names(state, scene.builder) is (state if worth else before)


@torch.no_grad()
@pytest.mark.parametrize(("scatter", "shows"), [(4.6, True), (2.9, False)])
def test_a_name_shows_in_what_nuisances_need_not_take_on_beside_it(lab, scatter, shows):
    """Modes' dampings that scatter as they like leave no gap of a window that was not said."""
    scene = lab.Scene(hidden={"gain": 1.5})
    hypothesis = scene.hypothesis("sensor_gain")

    def left(misfit, scatter):
        one = lab.leaving(scene.fit, misfit * scene.fit.judged.n)._replace(left=0.044)
        return one._replace(judged=one.judged._replace(scale={"grain": 3.2, "damping_scatter": scatter}))

    far, less = left(3.0, scatter), left(1.2, 1.04)
    before = State(scene.state.model, far)
    naming = Naming(hypothesis, choose((hypothesis,), far), far)
    named = State(scene.state.model, less, (naming,), before)
    assert worth_their_names(named, scene.builder) is (named if shows else before)
    # Of the misfit beyond noise a tenth is left, in squares.
    assert remaining(far, less) == pytest.approx(0.1**0.5 if shows else 1.0, rel=0.03)
    assert naming.confidence(less, explained=False) == pytest.approx(
        naming.known.confidence * (1 - remaining(far, less)), abs=1e-9
    )


@torch.no_grad()
@pytest.mark.check
def test_beside_an_inflated_error_a_name_that_halves_what_is_left_where_peaks_overlap_stays(lab):
    """Though sharp peaks that are still off count as if they were not there."""
    scene = lab.Scene(hidden={"gain": 1.5})
    hypothesis = scene.hypothesis("sensor_gain")
    far, less = (
        lab.leaving(one, 1e6)._replace(left=left, by_noise=False)
        for one, left in ((scene.fit, 0.8), (hypothesis.fit, 0.7))
    )
    before = State(scene.state.model, far)
    choice = choose((hypothesis,), far)
    named = State(less.model, less, (Naming(hypothesis, choice, far),), before)
    assert worth_their_names(named, scene.builder) is named
    # The other way round it leaves more of them.
    worse = State(far.model, far._replace(left=0.7), (Naming(hypothesis, choice, far),), State(less.model, less))
    assert worth_their_names(worse, scene.builder) is worse.previous


@torch.no_grad()
@pytest.mark.parametrize(("n_modal", "worth"), [(1e6, True), (8.0, False)])
def test_beside_an_inflated_error_what_is_left_counts_per_degree_of_freedom(lab, n_modal, worth):
    scene = lab.Scene(hidden={"gain": 1.5})
    hypothesis = scene.hypothesis("sensor_gain")
    far, less = (
        lab.leaving(scene.fit, 1e6)._replace(left=left, by_noise=False, n_modal=n_modal) for left in (0.8, 0.39)
    )
    before = State(scene.state.model, far)
    named = State(scene.state.model, less, (Naming(hypothesis, choose((hypothesis,), far), far),), before)
    assert worth_their_names(named, scene.builder) is (named if worth else before)


def test_either_frfs_or_a_table_are_needed(lab):
    one = NaturalFrequencies.from_mapping({4: 80.0})
    measured = lab.measured(LINES, torch.ones(len(LINES), 2, 3, dtype=torch.complex128), RESPONSE, REFERENCE)
    for given in ({}, {"measurement": measured, "natural_frequencies": one}):
        with pytest.raises(ValueError, match=r"either FRFs or natural frequencies.*Give one"):
            tp.diagnose(plate(YOUNG), **given)


def test_a_tolerance_of_a_number_that_is_not_there_is_said(lab):
    measured = lab.measured(LINES, torch.ones(len(LINES), 2, 3, dtype=torch.complex128), RESPONSE, REFERENCE)
    with pytest.raises(ValueError, match=r"'plate\.densty'"):
        tp.diagnose(plate(YOUNG), measured, tolerance={"plate.densty": 1.0})


@pytest.mark.check
@torch.no_grad()
def test_a_baseline_that_stopped_too_soon_is_taken_up_from_where_an_effect_led(lab, monkeypatch):
    scene = lab.Scene(hidden={"gain": 1.0})
    said: list[str] = []
    selection = ForwardSelection(scene.builder, {}, said.append)
    model, end = scene.state.model, scene.fit
    stuck = judged_at(selection.builder, end, {}, model.space.to_cube(torch.tensor([2.15e11, 1e-2]).double()))
    assert stuck.reduced_misfit > 20 * end.reduced_misfit
    # An effect let the plate's own parameters go where they belong: without it they do as well.
    ranked = Ranked((), (), 15.0)
    lower = selection._lower(State(model, stuck), State(model, end), ranked, alone=False)
    assert lower.fit.square == pytest.approx(end.square, rel=1e-3)
    assert any("without it" in one for one in said)
    # Where it had come to its end, nothing is taken up.
    assert selection._lower(State(model, end), State(model, end), ranked, alone=False) is None
    # Where the effect alone leaves noise, a baseline that ends lower but far above that is not taken up.
    nearly = lab.leaving(end, 0.1 * end.square)
    assert selection._lower(State(model, stuck), State(model, nearly), ranked, alone=True) is None
    assert selection._lower(State(model, stuck), State(model, end), ranked, alone=True) is not None
    # Far above the noise a baseline that is likelier, but leaves as much, is another end of one valley.
    beside = stuck._replace(judged=stuck.judged._replace(cost=stuck.judged.cost + 1e3))
    monkeypatch.setattr(forward, "fit", lambda *_, **__: stuck)
    assert selection._lower(State(model, beside), State(model, end), ranked, alone=False) is None
    little = stuck._replace(judged=end.judged)
    monkeypatch.setattr(forward, "fit", lambda *_, **__: little)
    more = little._replace(judged=end.judged._replace(cost=end.judged.cost + 1e3))
    assert selection._lower(State(model, more), State(model, end), ranked, alone=False) is not None


@torch.no_grad()
@pytest.mark.check
def test_two_are_looked_for_where_one_promised_much_and_explains_nothing(lab, monkeypatch):
    """A wrong level beside peaks that do not overlap: neither is seen before the other is mended."""
    scene, said = lab.Scene(), []
    selection = ForwardSelection(scene.builder, {}, said.append)
    gain, mass = scene.hypothesis("sensor_gain"), scene.hypothesis("point_mass")
    far, right = lab.leaving(scene.fit, 1e6), gain.fit
    alone, both = (replace(one, fit=fit) for one, fit in ((gain, lab.leaving(gain.fit, 1e6)), (mass, right)))
    signatures = torch.eye(3, dtype=torch.float64)

    def ranked(*drops: float) -> Ranked:
        names = ("sensor_gain", "density", "thickness")
        nothing = torch.zeros(0, dtype=torch.float64)
        promises = [
            Scored(scene.candidate(name), name, scene.state.model, drop, {}, nothing[None], signature, nothing)
            for name, drop, signature in zip(names, drops, signatures, strict=True)
        ]
        # A support that was tried where a spring had been found is among those refitted, and was never scored.
        return Ranked(tuple(promises), (replace(mass, fit=far), alone))

    begun = []

    def needed(state, rankings):
        begun.append([one.hypothesis.name for one in state.named])
        return choose([both], state.fit), rankings[0]

    monkeypatch.setattr(selection.steps, "needed", needed)
    state = State(scene.state.model, far)
    found = selection.pairs.that_promise(state, [ranked(0.6, 0.3, 0.1)], 3)
    assert [one.hypothesis.name for one in found.named] == ["sensor_gain", "point_mass"]
    assert begun == [["sensor_gain"]]
    assert any("promised much and explains little" in one for one in said)
    # Not where it promised less than half, where one effect is all that may be added, where nothing was scored, where
    # something is named, or where noise is left.
    for one, rankings, most in (
        (state, [ranked(0.4, 0.3, 0.1)], 3),
        (state, [ranked(0.6, 0.3, 0.1)], 1),
        (state, [], 3),
        (found, [ranked(0.6, 0.3, 0.1)], 3),
        (State(scene.state.model, right), [ranked(0.6, 0.3, 0.1)], 3),
    ):
        assert selection.pairs.that_promise(one, rankings, most) is None
    # That which smoothed FRFs were followed to most nearly goes first, from there: sharply the other led it astray.
    end = torch.full((len(alone.fit.model.names),), 0.4, dtype=torch.float64)
    second = scene.hypothesis("density")
    second = replace(second, fit=lab.leaving(second.fit, 1e6))
    several = replace(ranked(0.8, 0.6, 0.1), hypotheses=(second, alone), ways=((alone.candidate, end),))
    begun.clear()
    states = []
    monkeypatch.setattr(
        selection.steps, "needed", lambda state, _: states.append(state) or (choose([both], state.fit), several)
    )
    assert selection.pairs.that_promise(state, [several], 3) is not None
    assert [one.hypothesis.name for one in states[0].named] == ["sensor_gain"]
    torch.testing.assert_close(states[0].model.space.to_cube(states[0].fit.theta), end)
    several = replace(several, ways=((second.candidate, end), (alone.candidate, end)))
    assert selection.pairs.that_promise(state, [several], 3) is not None
    assert [one.hypothesis.name for one in states[1].named] == ["density"]
    # A second one is not tried once so much was evaluated.
    more = lab.leaving(scene.fit, 1e5)
    second_best = replace(both, fit=more)
    for evaluated, n_tried in ((0, 2), (SETTINGS.selecting.enough + 1, 1)):
        states.clear()
        monkeypatch.setattr(ModelBuilder, "n_evaluation", property(lambda _, n=evaluated: n))
        monkeypatch.setattr(
            selection.steps,
            "needed",
            lambda state, _: states.append(state) or (choose([second_best], state.fit), several),
        )
        selection.pairs.that_promise(state, [several], 3)
        assert len(states) == n_tried
    # Nor any, where two were looked for already, from the best one.
    for evaluated, n_ranking, n_tried in ((0, 2, 2), (SETTINGS.selecting.enough + 1, 2, 0)):
        states.clear()
        monkeypatch.setattr(ModelBuilder, "n_evaluation", property(lambda _, n=evaluated: n))
        selection.pairs.that_promise(state, [several] * n_ranking, 3)
        assert len(states) == n_tried
    monkeypatch.setattr(selection.steps, "needed", needed)
    # Nor if both explain no more than none does.
    both = replace(both, fit=far)
    assert selection.pairs.that_promise(state, [ranked(0.6, 0.3, 0.1)], 3) is None


@torch.no_grad()
@pytest.mark.parametrize(
    ("misfit", "by_noise", "evaluated", "enough"),
    [
        (500.0, True, 10**5, True),
        (500.0, True, 10, False),
        # Little is left: a third may be all that is missing.
        (5.0, True, 10**5, False),
        # Beside an inflated error squares say nothing of how much is left.
        (500.0, False, 10**5, False),
    ],
)
def test_a_third_effect_is_not_looked_for_where_two_leave_far_more_than_noise_and_much_was_tried(
    lab, misfit, by_noise, evaluated, enough
):
    scene = lab.Scene()
    left = lab.leaving(scene.fit, misfit * scene.fit.judged.n)._replace(by_noise=by_noise)
    assert tried_enough(replace(scene.state, fit=left), evaluated, SETTINGS.selecting) is enough


@torch.no_grad()
@pytest.mark.parametrize(
    ("stays", "misfit", "names"),
    [
        (("point_mass",), 5.0, ["point_mass", "sensor_gain"]),
        (("point_mass",), 0.9, ["point_mass"]),
        (("orthotropy", "point_mass"), 5.0, ["orthotropy", "point_mass"]),
        ((), 5.0, []),
    ],
)
@pytest.mark.check
def test_where_one_of_two_that_promised_much_is_needless_another_is_looked_for(lab, monkeypatch, stays, misfit, names):
    """The first may only have led to the second, and what is missing beside that was not looked for without it."""
    scene = lab.Scene()
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    two = {name: scene.hypothesis(name) for name in ("orthotropy", "point_mass")}

    def beside(*some: str) -> State:
        state = State(scene.state.model, lab.leaving(scene.fit, misfit * scene.fit.judged.n))
        for name in some:
            one = replace(two[name], fit=lab.leaving(two[name].fit, misfit * scene.fit.judged.n))
            ranked = Ranked((), (one,))
            state = added(state, choose([one], state.fit), ranked)
        return replace(state, previous=None)

    monkeypatch.setattr(selection.exchange, "judged_again", lambda _: beside(*stays))
    monkeypatch.setattr(pairs, "is_noise", lambda fit: fit.reduced_misfit < 1)
    gain = scene.hypothesis("sensor_gain")
    monkeypatch.setattr(selection.steps, "needed", lambda state, _: (choose([gain], state.fit), Ranked((), (gain,))))
    found = selection.pairs.that_stay(beside("orthotropy", "point_mass"), [])
    assert [one.hypothesis.name for one in found.named] == names


@torch.no_grad()
@pytest.mark.parametrize(("misfit", "first"), [(500.0, True), (5.0, False)])
@pytest.mark.check
def test_where_far_more_than_noise_is_left_a_second_is_looked_for_where_smoothed_frfs_ended(
    lab, monkeypatch, misfit, first
):
    """Sharply the first took on what it could of what lacks still."""
    scene = lab.Scene()
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    alone, states = scene.hypothesis("sensor_gain"), []
    n = alone.fit.judged.n
    before = State(scene.state.model, lab.leaving(scene.fit, 10 * misfit * n))
    alone = replace(alone, fit=lab.leaving(alone.fit, misfit * n))
    end = torch.full((len(alone.fit.model.names),), 0.4, dtype=torch.float64)
    ranked = Ranked((), (alone,), ways=((alone.candidate, end),))
    single = added(before, choose([alone], before.fit), ranked)
    monkeypatch.setattr(selection.steps, "needed", lambda state, _: states.append(state))
    assert selection.pairs.beside_the_best(before, ranked, single, []) == (None, None)
    where = states[0].model.space.to_cube(states[0].fit.theta)
    assert torch.allclose(where, end) == first
    # Where it ended sharply is tried, too.
    assert states[-1] is single
    assert len(states) == 1 + first


@torch.no_grad()
@pytest.mark.parametrize(("leaves", "needed"), [(5e5, True), (1.7e6, False)])
@pytest.mark.check
def test_a_second_effect_has_to_be_more_probable_than_the_first_alone_at_its_end(lab, monkeypatch, leaves, needed):
    """Where smoothed FRFs had taken the first, it leaves more: what does nothing takes a part of that."""
    scene = lab.Scene()
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    alone = scene.hypothesis("sensor_gain")
    before = State(scene.state.model, lab.leaving(scene.fit, 9e6))
    alone = replace(alone, fit=lab.leaving(alone.fit, 1.6e6))
    single = added(before, choose([alone], before.fit), Ranked((), (alone,)))
    smoothed = replace(single, fit=lab.leaving(single.fit, 4e6))
    second = scene.hypothesis("point_mass", state=single)
    ranked = Ranked((), (replace(second, fit=lab.leaving(second.fit, leaves)),))
    monkeypatch.setattr(selection.pairs, "_where_smoothed", lambda *_: [smoothed])
    monkeypatch.setattr(selection.ranking, "at", lambda state: ranked if state is smoothed else Ranked((), ()))
    assert selection.steps.needed(smoothed, []) is not None
    further, _ = selection.pairs.beside_the_best(before, ranked, single, [])
    assert (further is not None) == needed
    if further is not None:
        # What it explains is told from there, too.
        assert further.previous is single
        assert further.named[-1].before is single.fit


@torch.no_grad()
@pytest.mark.parametrize(("off", "taken"), [(0.0, True), (50.0, False)])
@pytest.mark.check
def test_an_end_elsewhere_in_the_box_counts_by_what_hypotheses_are_compared_by(lab, monkeypatch, off, taken):
    """Far from noise a sum of squares counts for little, and what is known of a number for all that it is."""
    scene = lab.Scene()
    said: list[str] = []
    selection = ForwardSelection(scene.builder, {}, said.append)
    state = State(scene.state.model, lab.leaving(scene.fit, 1e5))
    best = scene.hypothesis("sensor_gain")
    best = replace(best, fit=far_from_noise(lab.leaving(best.fit, 5e4)))
    there = far_from_noise(lab.leaving(best.fit, 4.98e4))._replace(prior=off)
    known = []
    monkeypatch.setattr(forward, "fit_from_the_box", lambda *given: known.append(given[-1]) or there)
    monkeypatch.setattr(selection.ranking, "from_there", lambda _, one, *__: [one])
    assert there.cost < best.fit.cost
    choice, ranked = selection._restarted(state, choose([best], state.fit), Ranked((), (best,)))
    # What leads nowhere near where it ended need not be followed.
    assert known == [best.fit]
    assert (choice.best.fit is there) == taken
    assert (ranked.hypotheses[0].fit is there) == taken
    assert bool(said) == taken


def far_from_noise(found: Fit) -> Fit:
    """As if the noise were as large as what is left."""
    return found._replace(judged=found.judged._replace(noise_scale=found.reduced_misfit**0.5))


@torch.no_grad()
@pytest.mark.parametrize("alone", [True, False])
def test_where_the_first_effect_alone_leaves_noise_the_baseline_is_told(lab, monkeypatch, alone):
    scene = lab.Scene()
    selection, gain, asked = ForwardSelection(scene.builder, {}, lambda _: None), scene.hypothesis("sensor_gain"), []
    ranked = Ranked((), (gain,))
    choice = choose(ranked.hypotheses, scene.fit)
    monkeypatch.setattr(selection.steps, "needed", lambda _, rankings: rankings.append(ranked) or (choice, ranked))
    monkeypatch.setattr(selection, "_restarted", lambda _, *needed: needed)
    monkeypatch.setattr(forward, "is_alone", lambda best, one: alone and best is gain and one is ranked)
    monkeypatch.setattr(selection, "_lower", lambda *given: asked.append(given[-1]))
    monkeypatch.setattr(selection.steps, "explained", lambda state: state)
    selection.add_effects(State(scene.state.model, scene.fit), 1)
    assert asked == [alone]


@torch.no_grad()
@pytest.mark.parametrize(("most", "hides", "expected"), [(3, True, 2), (3, False, 1), (1, True, 1)])
@pytest.mark.check
def test_a_second_effect_is_looked_for_where_the_first_leaves_noise(lab, monkeypatch, most, hides, expected):
    """One of two may be so small that noise covers it, and still be more probable than none."""
    scene, said, asked = lab.Scene(), [], []
    selection = ForwardSelection(scene.builder, {}, said.append)
    gain, mass = scene.hypothesis("sensor_gain"), scene.hypothesis("point_mass")

    def needed(state, rankings):
        asked.append([one.hypothesis.name for one in state.named])
        ranked = Ranked((), ((mass if state.named else gain),))
        rankings.append(ranked)
        return (choose(ranked.hypotheses, state.fit), ranked) if hides or not state.named else None

    monkeypatch.setattr(selection.steps, "needed", needed)
    monkeypatch.setattr(selection, "_lower", lambda *_: None)
    doubts = []

    def explained(state, doubted=False):
        doubts.append(doubted)
        return state

    monkeypatch.setattr(selection.steps, "explained", explained)
    found, rankings = selection.add_effects(State(scene.state.model, scene.fit), most)
    assert [one.hypothesis.name for one in found.named] == ["sensor_gain", "point_mass"][:expected]
    assert asked == [[], ["sensor_gain"]][: min(most, 2)]
    assert len(rankings) == len(asked)
    # Without the second nothing but noise was left: it alone is doubted.
    assert doubts == [False, True][:expected]


@torch.no_grad()
@pytest.mark.parametrize("promised", [pytest.param(0.0, marks=pytest.mark.check), 6.0, 8.0])
@pytest.mark.check
def test_a_second_has_to_promise_more_on_the_mesh_that_the_first_was_settled_on(lab, monkeypatch, promised):
    scene = lab.Scene()
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    state, settled = scene.state, replace(scene.state)
    finer = selection.settling.on_a_finer_mesh(state)
    assert finer.mesh.n_element >= SETTINGS.meshes.settling.least > scene.builder.mesh.n_element
    nothing, asked, looked = torch.zeros(0), [], []
    candidate = scene.candidate("point_mass")
    drop = promised / scene.fit.square
    promise = Scored(candidate, "point_mass", state.model, drop, {}, torch.zeros(1, 3), nothing, nothing)

    def scored(_self, fine, by_mesh):
        asked.append((fine, by_mesh))
        return Ranked((promise,) if promised else (), (), 7.0, square=fine.fit.square)

    monkeypatch.setattr(Ranking, "scored", scored)
    monkeypatch.setattr(selection.settling, "left_by_mesh", lambda *_: 3.0)
    monkeypatch.setattr(selection.steps, "needed", lambda state, _: looked.append(state))
    # That mesh has a number of elements, whatever its error is.
    monkeypatch.setattr(ModelBuilder, "corrected", lambda *_: pytest.fail("a mesh error was taken off for nothing"))
    rankings: list[Ranked] = []
    assert selection._one_more(state, settled, rankings) is None
    assert asked == [(settled, 3.0)]
    assert looked == ([state] if promised > 7 else [])
    assert len(rankings) == (promised <= 7)
    # What a finer mesh did not leave as noise is looked at where it is.
    assert selection._one_more(state, state, rankings) is None
    assert len(asked) == 1
    assert looked[-1] is state
    # What that mesh costs is counted.
    before = scene.builder.n_evaluation
    finer.count(3)
    assert scene.builder.n_evaluation == before + 3


@torch.no_grad()
@pytest.mark.check
@pytest.mark.parametrize("promised", [5.0, 9.0])
@pytest.mark.parametrize("little", [True, False], ids=["noise is left", "more is left"])
def test_what_shows_in_the_noise_has_to_show_on_a_finer_mesh_before_anything_is_refitted(
    lab, monkeypatch, little, promised
):
    scene, looked = lab.Scene(), []
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    nothing, candidate = torch.zeros(0), scene.candidate("point_mass")
    promise = Scored(candidate, "point_mass", scene.state.model, 0.0, {}, torch.full((1, 5), 0.5), nothing, nothing)

    def nearby(_self, state, _base, _everyone, _by_mesh=0.0, says=None, before=None):
        looked.append("here" if says is None else "finer")
        return [promise._replace(drop=(9.0 if says is None else promised) / state.fit.square)], 7.0

    for module in (ranking, settling):
        monkeypatch.setattr(module, "is_noise", lambda _: little)
    monkeypatch.setattr(Ranking, "_nearby", nearby)
    refitted = []
    monkeypatch.setattr(Ranking, "_refitted", lambda _self, _state, chosen, *_, **__: refitted.extend(chosen) or [])
    ranked = selection.ranking.at(scene.state)
    assert looked == ["here", "finer"][: 1 + little]
    assert bool(refitted) == (promised > 7 or not little)
    assert len(ranked.promises) == 1
    # What was named already is not asked again here.
    looked.clear()
    gain = scene.hypothesis("sensor_gain")
    named = replace(scene.state, named=(Naming(gain, choose((gain,), scene.fit), scene.fit),))
    selection.ranking.at(named)
    assert looked == ["here"]


@torch.no_grad()
@pytest.mark.check
def test_beside_a_finer_mesh_candidates_promise_what_they_would_on_it(lab, monkeypatch):
    """Changes are those of the mesh where effects are looked for; what is left is the finer one's."""
    true = plate(hidden=(hide("point_mass", x=0.72, y=0.31, mass=0.004),), refine=10)
    frf = true.frf(lab.nobody, LINES)
    std = lab.true_std(frf, SHARE, "mixed")
    noise, none = Noise(std, lab.true_floor(std, frf), (), torch.zeros_like(std)), torch.zeros(2, 3, dtype=torch.bool)
    measured = lab.measured(LINES, frf + lab.noise_of(std, 11), RESPONSE, REFERENCE)
    selection = ForwardSelection.of(plate(YOUNG), FrfTarget(measured, noise, none, False, PERFECT), {}, lambda _: None)
    names, every = ("point_mass", "ground_spring", "stiffness_loss", "orthotropy", "density"), ranking.candidates

    def some(*given):
        return [one for one in every(*given) if one.name in names]

    monkeypatch.setattr(ranking, "candidates", some)
    given = selection.builder.given
    start = torch.full((1, 1), 0.5, dtype=torch.float64)
    state = State(given, fit(selection.builder, given, start, wide=False))
    builder = selection.settling.on_a_finer_mesh(state)
    fine = replace(state, fit=fit(builder, given, start, wide=False))
    finer = ForwardSelection(builder, {}, lambda _: None)
    found, expected = (
        {one.candidate.name: one.drop for one in one.ranking.scored(fine, None).promises} for one in (selection, finer)
    )
    assert selection.builder.mesh.n_element < builder.mesh.n_element / 5
    assert expected["point_mass"] == max(expected.values()) > 0.1
    for name in names:
        assert found[name] == pytest.approx(expected[name], abs=0.03 * expected["point_mass"]), name


@torch.no_grad()
@pytest.mark.check
@pytest.mark.parametrize(
    ("hidden", "name", "low", "high", "most"),
    [
        (MASS, "mass", 0.03, 0.1, 3),
        (HOLE, "x1", 0.4, 0.7, 30),
        (SMALL_HOLE, "y1", 0.3, 0.5, 150),
        (RIB, "bending", 10.0, 60.0, 30),
    ],
    ids=["mass", "hole", "small hole", "rib"],
)
def test_what_two_meshes_differ_by_says_what_the_finer_one_leaves(lab, hidden, name, low, high, most):
    """Under a mass, whose force the elements do not follow; at corners of a hole at most. Against 10,000 elements."""
    true = plate(hidden=(hidden,))
    searched = {f"hidden_0.{name}": Searched(low, high)}
    known = {key: value for key, value in true.known_values.items() if key not in searched}
    model = true.replaced(known=known, searched=searched)
    theta = torch.tensor([hidden[1][name]], dtype=torch.float64)
    frf = true.frf(lab.nobody, LINES)
    std = lab.true_std(frf, 1e-3, "mixed")
    noise, none = Noise(std, lab.true_floor(std, frf), (), torch.zeros_like(std)), torch.zeros(2, 3, dtype=torch.bool)

    def seen(frf: torch.Tensor) -> FrfTarget:
        return FrfTarget(lab.measured(LINES, frf, RESPONSE, REFERENCE), noise, none, False, PERFECT)

    finest = ModelBuilder(model, seen(frf), fineness=replace(SETTINGS.meshes.settling, least=10_000))
    whole = finest.corrected(finest.given, theta).model
    truth = finest.predict(finest.reduced(whole, theta[None]), theta)
    selection = ForwardSelection.of(model, seen(truth), {}, lambda _: None)
    given = selection.builder.given
    start = given.space.to_cube(theta)[None]
    coarse = State(given, fit(selection.builder, given, start, wide=False))
    finer = selection.settling.on_a_finer_mesh(coarse)
    fine = State(given, fit(finer, given, start, wide=False))
    marginal = fine.fit.marginal
    left = float(marginal.whitened(marginal.over_noise(truth - fine.fit.expected)).square().sum())
    # It need not be sharp, and it is no less than what is left.
    expected = selection.settling.left_by_mesh(coarse, fine, finer)
    assert left < float(marginal.whitened(marginal.over_noise(expected)).square().sum()) < most * left


@pytest.mark.check
@pytest.mark.parametrize("wires", [(2, 10, 19), ()], ids=["on wires", "free"])
def test_beside_a_rib_the_finer_mesh_is_expected_to_leave_as_much_as_it_does(lab, wires):
    """Its couples are a kink for the elements that it crosses, which taking the plate's mesh error off leaves."""
    true = plate(hidden=(RIB,), wires=wires)
    known = {key: value for key, value in true.known_values.items() if key != "hidden_0.bending"}
    model = true.replaced(known=known, searched={"hidden_0.bending": Searched(10.0, 60.0)})
    theta = torch.tensor([RIB[1]["bending"]], dtype=torch.float64)
    frf = true.frf(lab.nobody, LINES)
    std = lab.true_std(frf, 1e-3, "mixed")
    noise, none = Noise(std, lab.true_floor(std, frf), (), torch.zeros_like(std)), torch.zeros(2, 3, dtype=torch.bool)
    target = FrfTarget(lab.measured(LINES, frf, RESPONSE, REFERENCE), noise, none, False, PERFECT)
    selection = ForwardSelection.of(model, target, {}, lambda _: None)
    given = selection.builder.given
    coarse = State(given, fit(selection.builder, given, given.space.to_cube(theta)[None], wide=False))
    builder = selection.settling.on_a_finer_mesh(coarse)
    finest = ModelBuilder(model, target, fineness=replace(SETTINGS.meshes.settling, least=10_000))
    fine, truth = (one.natural_frequencies(given, theta)[3:-1] for one in (builder, finest))
    off = ((fine - truth) / truth).abs()
    line = torch.searchsorted(LINES, truth).clamp(max=len(LINES) - 1)
    expected, plain = builder.target.mesh_shift[line], selection.builder.fineness.shift
    assert float(off.square().mean().sqrt()) < float(expected.square().mean().sqrt()) < 10 * float(off.max())
    assert float(off.max()) > plain


@torch.no_grad()
@pytest.mark.parametrize("excessive", [pytest.param({}, marks=pytest.mark.check), {"thickness": 9.0}])
def test_on_the_finer_mesh_a_specimen_begins_as_it_was_whatever_it_took_on(lab, monkeypatch, excessive):
    scene, asked = lab.Scene(hidden={"gain": 1.0}), []
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    about = Found(torch.zeros(0), torch.zeros(0, 0), None)
    of_fit, scale = scene.fit.beside, {**scene.fit.judged.scale, **excessive}
    monkeypatch.setattr(of_fit, "about", about)
    found = scene.fit._replace(judged=scene.fit.judged._replace(scale=scale))
    assert (known_section(found) is None) == bool(excessive)
    gain = scene.hypothesis("sensor_gain")
    named = Naming(gain, choose([gain], scene.fit), scene.fit, (gain,))
    state = replace(scene.state, fit=found, named=(named,))
    monkeypatch.setattr(selection.exchange, "judged_again", lambda state: state)
    monkeypatch.setattr(selection.exchange, "without_needless", lambda state, *_: state)
    monkeypatch.setattr(settling, "fit", lambda *_, about, **__: asked.append(about) or scene.fit)
    selection.settling.settled(state)
    assert asked == [about]


@torch.no_grad()
@pytest.mark.check
def test_what_is_doubted_is_asked_again_on_the_finer_mesh_whatever_it_closed(lab, monkeypatch):
    scene = lab.Scene(hidden={"gain": 1.5})
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    hypothesis = scene.hypothesis("sensor_gain")
    choice = choose((hypothesis,), scene.state.fit)
    state = added(scene.state, choice, Ranked((), (hypothesis,)))
    (naming,) = state.named
    assert naming.before.left > selection.settings.small_gap * scene.builder.target.floor
    asked = []
    monkeypatch.setattr(selection.exchange, "judged_again", lambda state: state)
    monkeypatch.setattr(selection.exchange, "without_needless", lambda state, _, which: asked.append(which) or state)
    for doubted in (False, True):
        selection.settling.settled(state, doubted)
    assert asked == [(), (naming,)]
    # What it was added to had stopped far from where the others alone end.
    selection.exchange.left_without = {
        hypothesis.label: 0.9 * selection.settings.small_gap * scene.builder.target.floor
    }
    selection.settling.settled(state)
    assert asked[2:] == [(naming,)]
    selection.exchange.left_without.clear()
    # A gain of 1 within its standard errors changes nothing.
    fit, asked[:] = state.fit, []
    index = fit.model.names.index("sensor_gain_1.gain")
    for far, expected in ((4.0, (naming,)), (6.0, ())):
        theta = fit.theta.clone()
        theta[index] = 1 + far * float(fit.covariance[index, index]) ** 0.5
        monkeypatch.setattr(settling, "fit", lambda *_, theta=theta, **__: fit._replace(theta=theta))
        selection.settling.settled(state)
        assert asked.pop() == expected
    # And what took the place of another on the finer mesh, not what was there before.
    other = replace(naming)
    monkeypatch.setattr(selection.exchange, "beside_those_in_doubt", lambda state, *_: replace(state, named=(other,)))
    selection.settling.settled(state, True)
    ((found,),) = asked
    assert found is other


@torch.no_grad()
@pytest.mark.parametrize("doubted", [True, False])
def test_a_doubted_name_that_the_finer_mesh_takes_out_is_out_whatever_that_leaves(lab, monkeypatch, doubted):
    """Else the coarser mesh, which leaves noise with it, would have the last word."""
    scene = lab.Scene(hidden={"gain": 1.1})
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    hypothesis = scene.hypothesis("sensor_gain")
    state = added(scene.state, choose((hypothesis,), scene.fit), Ranked((), (hypothesis,)))
    assert is_noise(state.fit)
    assert not is_noise(scene.fit)
    monkeypatch.setattr(selection.settling, "settled", lambda *_: scene.state)
    assert selection.settling.ended(state, doubted) is (scene.state if doubted else state)
    assert selection.steps.explained(state, doubted) is (None if doubted else state)


@torch.no_grad()
def test_beside_a_hole_the_finer_mesh_is_asked_whatever_is_left(lab, monkeypatch):
    scene, asked = lab.Scene(hidden={"gain": 1.0}), []
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    times = 2 * SETTINGS.selecting.doubtful
    fit = lab.leaving(scene.fit, times * scene.fit.judged.n)
    far = replace(scene.state, fit=fit._replace(judged=fit.judged._replace(noise_scale=times**0.5)))
    monkeypatch.setattr(selection.settling, "ended", lambda state, _: asked.append(state) or state)
    assert selection.steps.explained(far) is None
    assert not asked
    monkeypatch.setattr(PlateModel, "has_hole", lambda *_: True)
    assert selection.steps.explained(far) is far
    assert asked == [far]


@torch.no_grad()
def test_where_oversized_nuisances_leave_noise_squares_do_not_say_what_explains_something(lab):
    """A window that takes hundreds from −2 ln L, and one part in thirty from a sum of squares that is noise."""
    scene = lab.Scene(hidden={"gain": 1.0})
    hypothesis, n = scene.hypothesis("sensor_gain"), scene.fit.judged.n
    near, less = (lab.leaving(scene.fit, times * n) for times in (0.97, 0.94))
    assert explains_some(near, replace(hypothesis, fit=less), SETTINGS.selecting)
    assert explains_some(near, replace(hypothesis, fit=less), SETTINGS.selecting, by_cost=True)
    # Far from noise a thirtieth is little.
    far, less = (lab.leaving(scene.fit, times * n) for times in (97.0, 94.0))
    assert not explains_some(far, replace(hypothesis, fit=less), SETTINGS.selecting, by_cost=True)


@torch.no_grad()
def test_a_baseline_is_fitted_on_the_given_mesh_once(lab, monkeypatch):
    """It is asked before effects are looked for, and in the end again."""
    scene, asked = lab.Scene(), []
    far = lab.leaving(scene.fit, 100 * scene.fit.judged.n)
    monkeypatch.setattr(settling.Settling, "as_given_from", lambda *given, **_: asked.append(given[3]) or far)
    selection = ForwardSelection(scene.builder, {}, lambda _: None)
    selection.begun = state = State(scene.state.model, far)
    assert selection.on_the_given_mesh(state) is None
    assert selection.as_given(state) == (far, None)
    assert len(asked) == 1
    # Another baseline is another matter.
    selection.begun = replace(state, fit=lab.leaving(scene.fit, 90 * scene.fit.judged.n))
    assert selection.as_given(selection.begun)[0] is far
    assert len(asked) == 2
