"""From a model and a measurement to what is missing, end to end; the data come from a much finer mesh."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import pytest
import torch

import torchplate as tp
from torchplate.diagnosis.fit import fit
from torchplate.diagnosis.selection.criterion import Choice, Hypothesis
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.selection.trace import Ranked, State
from torchplate.effects import CATALOGUE, Effect, Parameter
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel, Searched, extrapolate
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
FLIPPED = hide("channel_polarity", {"channels": ((None, 9),)})
CASES = {
    "nothing": ((), YOUNG, {}),
    "flipped": ((FLIPPED,), YOUNG, {}),
    "twins": ((hide("density", value=7650.0),), YOUNG, {"wires": ()}),
    "two": ((MASS, FLIPPED), YOUNG, {}),
    "beyond": (((Strut(), {"strength": 6e4}),), YOUNG, {}),
    "alone": ((hide("sensor_gain", gain=1.4),), YOUNG, {"response": (3,), "reference": (7,)}),
}


@pytest.fixture(scope="module")
def diagnosed(lab):
    """Each case is diagnosed once, where it is first asked for."""
    done: dict[str, SimpleNamespace] = {}

    def get(name: str) -> SimpleNamespace:
        if name not in done:
            hidden, searched, channels = CASES[name]
            true = plate(hidden=hidden, refine=4, **channels)
            frf = extrapolate(true, float(LINES[-1])).model.frf(lab.nobody, LINES)
            std = lab.true_std(frf, SHARE, "mixed")
            where = channels.get("response", RESPONSE), channels.get("reference", REFERENCE)
            measured = lab.measured(LINES, frf + lab.noise_of(std, 11), *where)
            model = plate(searched, **channels)
            said: list[str] = []
            # Looking for a second and a third effect takes longer, and ends no better where none is in the catalogue.
            most = 1 if name == "beyond" else 3
            found = tp.diagnose(model, measured, most_effects=most, say=said.append)
            done[name] = SimpleNamespace(found=found, measured=measured, model=model, said=said)
        return done[name]

    return get


def others(found: tp.Diagnosis):
    """What was named beside a finer mesh."""
    return [one for one in found.effects if one.name != "mesh_discretisation"]


def value(one, name: str) -> float:
    return one.parameters[name].value


@pytest.fixture(params=CASES)
def case(request, diagnosed) -> SimpleNamespace:
    return diagnosed(request.param)


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


def test_a_single_frf_is_enough_for_a_gain(diagnosed):
    found = diagnosed("alone").found
    assert found.verdict == "explained"
    (one,) = others(found)
    assert "sensor_gain" in {one.name, *one.equivalent}
    assert found.gap.heldout_baseline is None
    assert found.gap.heldout_final is None
    assert all(step.heldout is None for step in found.steps)


def test_the_ledger_agrees_with_itself(case):
    found, measured = case.found, case.measured
    gap, steps = found.gap, found.steps
    assert (steps[0].label, steps[0].gap) == ("baseline", gap.baseline)
    assert (steps[-1].gap, steps[-1].heldout) == (gap.final, gap.heldout_final)
    assert gap.noise_floor == pytest.approx(SHARE, rel=0.25)
    assert gap.final <= gap.baseline or case.found.verdict == "unexplained"
    labels = [step.label.removeprefix("+ ") for step in steps if step.label.startswith("+")]
    assert set(labels) >= {one.name for one in found.effects}
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
    # The model that is handed over is the one that was fitted, in numbers.
    assert found.model.names == ()
    assert torch.allclose(
        found.model.frf(found.model.known[:0], LINES), seen.after, rtol=2e-3, atol=float(2e-3 * seen.after.abs().max())
    )
    text = json.dumps(found.to_dict(), allow_nan=True)
    assert "nan" not in text.lower().replace("resonan", "")


def test_the_given_model_is_left_alone(case):
    wires = (2, 10, 19) if "wires" in case.model.effects else ()
    fresh = plate(YOUNG, response=case.model.response, reference=case.model.reference, wires=wires)
    assert "mesh_discretisation" not in {effect.name for effect in case.model.effects.values()}
    assert case.model.mesh == fresh.mesh
    assert case.model.assembly.size == fresh.assembly.size
    assert case.said[0].startswith("baseline")


def test_the_table_names_every_effect_once_and_says_what_became_of_it(diagnosed):
    found = diagnosed("flipped").found
    table = found.scores[0]
    names = [row.name for row in table]
    assert len(set(names)) == len(names)
    assert set(names) == set(CATALOGUE) - {"plate", "support_spring", "mesh_discretisation"}
    remarks = {row.name: row.remark for row in table}
    assert remarks.pop("channel_polarity") == "named"
    assert all(remark.startswith("rejected") for remark in remarks.values())


def table(lab, *hidden) -> NaturalFrequencies:
    """Natural frequencies of the bending modes, good to half a thousandth."""
    true = extrapolate(plate(hidden=hidden, refine=4), 400.0).model
    every = true.natural_frequencies(lab.nobody, 14).tolist()
    noise = (1 + 5e-4 * torch.randn(14, generator=torch.Generator().manual_seed(3))).tolist()
    std = {mode: 5e-4 * every[mode - 1] for mode in range(4, 15)}
    values = {mode: every[mode - 1] * noise[mode - 1] for mode in std}
    # Modes that are close may have changed places in the noise.
    return NaturalFrequencies.from_mapping(dict(zip(values, sorted(values.values()), strict=True)), std)


def test_natural_frequencies_alone_of_the_true_plate_are_consistent(lab):
    found = tp.diagnose(plate(YOUNG), natural_frequencies=table(lab))
    assert found.verdict == "consistent"
    assert others(found) == []
    assert found.overlay is None
    assert found.gap.heldout_final is None
    assert found.parameters["plate.youngs_modulus"].value == pytest.approx(2.05e11, rel=2e-3)


def test_natural_frequencies_alone_tell_an_oblong_plate(lab):
    found = tp.diagnose(plate(YOUNG), natural_frequencies=table(lab, hide("aspect_ratio", ratio=1.05)))
    one = others(found)[0]
    assert "aspect_ratio" in {one.name, *one.equivalent}
    assert found.gap.final < 0.2 * found.gap.baseline


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


@torch.no_grad()
def test_a_baseline_that_stopped_too_soon_is_taken_up_from_where_an_effect_led(lab):
    scene = lab.Scene(hidden={"gain": 1.0})
    target = scene.builder.target
    said: list[str] = []
    selection = ForwardSelection(scene.builder.given, target, {}, said.append)
    model = selection.builder.given
    middle = torch.full((1, 2), 0.5, dtype=torch.float64)
    end = fit(selection.builder, model, middle, wide=True)
    theta = torch.tensor([2.15e11, 1e-2], dtype=torch.float64)
    off = selection.builder.predict(end.reduced, theta)
    stuck = end._replace(theta=theta, prediction=off, misfit=target.misfit(off), gap=target.whole_gap(off))
    assert stuck.reduced_misfit > 20 * end.reduced_misfit
    # An effect let the plate's own parameters go where they belong: without it they do as well.
    lower = selection._lower(State(model, stuck), State(model, end))
    assert lower.fit.cost == pytest.approx(end.cost, rel=1e-3)
    assert any("without it" in one for one in said)
    # Where it had come to its end, nothing is taken up.
    assert selection._lower(State(model, end), State(model, end)) is None


@torch.no_grad()
def test_a_second_effect_is_looked_for_beside_what_explains_some(lab):
    scene = lab.Scene()
    selection = ForwardSelection(scene.builder.given, scene.builder.target, {}, lambda _: None)
    measured = scene.builder.target.measured

    def fitted(gap: float, square: float):
        misfit = scene.fit.misfit._replace(fitted=torch.tensor(square, dtype=torch.float64))
        return scene.fit._replace(prediction=(1 - gap) * measured, misfit=misfit, prior=0.0, by_noise=True)

    def after(name: str, gap: float, square: float):
        return Hypothesis(scene.candidate(name), f"{name}_1", fitted(gap, square))

    before = fitted(0.5, 1000.0)
    # The gap is much smaller, or much less speaks against it.
    assert selection._explains_some(before, after("point_mass", 0.36, 900.0))
    assert selection._explains_some(before, after("point_mass", 0.49, 480.0))
    assert not selection._explains_some(before, after("point_mass", 0.39, 900.0))
    # What has no number to be fitted cannot do as much, where something else is missing too.
    assert selection._explains_some(before, after("channel_swap", 0.49, 700.0))
    assert not selection._explains_some(before, after("point_mass", 0.49, 700.0))
    # Beside the best, a smaller gap alone is not enough.
    assert not selection._explains_some(before, after("point_mass", 0.36, 900.0), by_cost=True)
    assert selection._explains_some(before, after("point_mass", 0.49, 480.0), by_cost=True)


@torch.no_grad()
@pytest.mark.parametrize(("n_evaluation", "n_look"), [(100, 2), (1_000_000, 1)], ids=["begun", "long since"])
def test_after_a_long_search_nothing_is_looked_for_beside_the_second_best(lab, monkeypatch, n_evaluation, n_look):
    scene = lab.Scene()
    selection = ForwardSelection(scene.builder.given, scene.builder.target, {}, lambda _: None)

    def half(name: str, part: float):
        one = scene.hypothesis(name)
        misfit = scene.fit.misfit._replace(fitted=part * scene.fit.misfit.fitted)
        return Hypothesis(one.candidate, one.label, one.fit._replace(misfit=misfit, by_noise=True, prior=0.0))

    look = Ranked((), (half("point_mass", 0.3), half("density", 0.4)))
    seen = []
    monkeypatch.setattr(selection.look, "at", lambda state: seen.append(state) or Ranked((), ()))
    selection.builder.n_evaluation = n_evaluation
    single = selection._added(scene.state, Choice(look.hypotheses[0], (), None, 1.0), look)
    assert selection._pairs(scene.state, look, single, []) == (None, None)
    assert [state.named[-1].hypothesis.name for state in seen] == ["point_mass", "density"][:n_look]


@torch.no_grad()
@pytest.mark.parametrize(
    ("left", "n_lower", "n_look"),
    [(0.5, 1, 1), (40.0, 1, 2), (40.0, 2, 2)],
    ids=["nothing but noise", "more than noise", "more than noise, twice"],
)
def test_a_look_is_not_repeated_where_it_holds_beside_the_better_baseline(lab, monkeypatch, left, n_lower, n_look):
    scene = lab.Scene()
    selection = ForwardSelection(scene.builder.given, scene.builder.target, {}, lambda _: None)
    n = scene.fit.misfit.n_fitted

    def at(square: float):
        misfit = scene.fit.misfit._replace(fitted=torch.tensor(square * n, dtype=torch.float64))
        return scene.fit._replace(misfit=misfit, by_noise=True, prior=0.0)

    mass = scene.hypothesis("point_mass")
    named = Hypothesis(mass.candidate, mass.label, mass.fit._replace(misfit=at(left).misfit, by_noise=True, prior=0.0))
    looked = []
    monkeypatch.setattr(selection.look, "at", lambda state: looked.append(state.fit.cost) or Ranked((), (named,)))
    lower = iter([400.0, 200.0][:n_lower])
    monkeypatch.setattr(
        selection, "_lower", lambda state, _: State(state.model, at(value)) if (value := next(lower, None)) else None
    )
    monkeypatch.setattr(selection, "_explained", lambda state: state)
    found, _ = selection.travel(State(scene.state.model, at(900.0)), 3)
    assert len(looked) == n_look
    assert found.named[-1].hypothesis.name == "point_mass"
    # What it was added to is the best that the given model does.
    last = [400.0, 200.0][n_lower - 1]
    assert found.previous is selection.begun
    assert selection.begun.fit.reduced_misfit == pytest.approx(last, rel=1e-6)
    assert found.named[-1].before is selection.begun.fit
