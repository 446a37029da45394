"""The catalogue beside one model: what came near before is tried again, and the best are followed to the end."""

import math
from dataclasses import replace

import pytest
import torch

from torchplate.diagnosis.fit import Beat
from torchplate.diagnosis.judged import judged_at
from torchplate.diagnosis.model_builder import with_candidate
from torchplate.diagnosis.problem import Problem
from torchplate.diagnosis.selection import afar
from torchplate.diagnosis.selection import ranking as module
from torchplate.diagnosis.selection import refit as refit_module
from torchplate.diagnosis.selection.criterion import Choice, Hypothesis, is_noise, never_equivalent
from torchplate.diagnosis.selection.grounded import is_alone
from torchplate.diagnosis.selection.screen import Scored, screen, start_of
from torchplate.diagnosis.selection.shortlist import kept
from torchplate.diagnosis.selection.starts import spread_out
from torchplate.diagnosis.selection.trace import Naming, Ranked, State
from torchplate.diagnosis.settings import SETTINGS
from torchplate.discrepancy import Found
from torchplate.effects import CATALOGUE
from torchplate.model import Searched

# What candidates promise to take from −2 ln L, the best one first.
PROMISED = {"gain": 41.0, "mass": 22.0, "spring": 12.0, "delay": 3.0}


@pytest.fixture(scope="module")
def scene(lab):
    with torch.no_grad():
        return lab.Scene()


@torch.no_grad()
@pytest.mark.check
def test_what_came_near_before_is_tried_again_from_where_it_ended(scene, monkeypatch):
    gain, mass = scene.hypothesis("sensor_gain"), scene.hypothesis("point_mass")
    assert gain.fit.gap < 0.2 * scene.fit.gap < mass.fit.gap
    followed = Naming(mass, Choice(mass, (), gain, 1.0), scene.fit)
    model = with_candidate(scene.state.model, mass.label, mass.candidate)
    state = State(model, mass.fit, (followed,), scene.state, Ranked((), (mass, gain)))
    (again,) = scene.ranking._again(state)
    assert again.name == "sensor_gain"
    values = dict(zip(again.fit.model.names, again.fit.theta.tolist(), strict=True))
    assert values["sensor_gain_1.gain"] == pytest.approx(1.1, rel=0.01)
    assert "point_mass_1.mass" in values
    # What leaves far more than what was refitted beside the same does not go to its end.
    limits = []
    monkeypatch.setattr(scene.ranking.refits, "refit", lambda *given, beat: limits.append((given[4], beat)) or gain)
    scene.ranking._again(state, [gain, mass])
    monkeypatch.undo()
    assert limits == [(SETTINGS.searching.hopeless * gain.fit.square, scene.ranking._beat(state, [gain]))]
    # Not where nothing was looked at before, nor what did not come near.
    assert scene.ranking._again(scene.state) == []
    assert scene.ranking._again(State(model, mass.fit, (followed,), scene.state, Ranked((), (mass,)))) == []


@torch.no_grad()
@pytest.mark.check
def test_the_best_are_followed_as_long_as_that_takes_them_further(lab, scene, monkeypatch):
    first, second = scene.hypothesis("point_mass"), scene.hypothesis("time_delay")
    # Both leave far more than noise, one of them more than the other by far more than rounding.
    left = {"point_mass": [0.8, 0.4, 0.4], "time_delay": [0.85, 0.85, 0.85]}
    ended, other = (
        replace(one, fit=lab.leaving(one.fit, left[one.name].pop(0) * scene.fit.square)) for one in (first, second)
    )
    asked = []

    def refit(model, candidate, label, start, about=None):
        one = ended if candidate is ended.candidate else other
        asked.append(one.name)
        assert torch.allclose(start[0], one.fit.model.space.to_cube(one.fit.theta))
        return replace(one, fit=lab.leaving(one.fit, left[one.name].pop(0) * scene.fit.square))

    monkeypatch.setattr(scene.ranking.refits, "refit", refit)
    found = scene.ranking._run_off(scene.state, [ended, other])
    # A half less: once more. No less: that was the end.
    assert sorted(asked) == ["point_mass"] * 2 + ["time_delay"] * 2
    assert found[0].name == "point_mass"
    assert found[0].fit.square == pytest.approx(0.4 * scene.fit.square, rel=1e-6)


@torch.no_grad()
@pytest.mark.check
def test_what_came_near_the_best_is_fitted_again_from_where_that_was_taken(lab, monkeypatch):
    scene = lab.Scene(hidden={"wire": (2000.0, 0.5)})
    spring, mass = scene.hypothesis("ground_spring", start=0.4), scene.hypothesis("point_mass")
    # The others had ended far off, one of them with the plate's own parameters elsewhere.
    patch = scene.hypothesis("damping_patch")
    stuck = torch.tensor([[0.9, *patch.fit.model.space.to_cube(patch.fit.theta)[1:].tolist()]]).double()
    lost = replace(patch, fit=judged_at(scene.builder, patch.fit, {}, stuck[0]))
    assert lost.fit.square > 5 * patch.fit.square
    far = replace(mass, fit=lab.leaving(mass.fit, 1.5 * lost.fit.square))
    before = lab.leaving(spring.fit, 0.6 * lost.fit.square)
    begun = {}
    refit = scene.ranking.refits.refit

    def watched(state, candidate, label, starts, *others, **known):
        begun[candidate.name] = with_candidate(state.model, label, candidate).space.to_si(starts)[0]
        return refit(state, candidate, label, starts, *others, **known)

    monkeypatch.setattr(scene.ranking.refits, "refit", watched)
    first, *rest = scene.ranking.from_there(scene.state, spring, [spring, lost, far], before)
    assert first.fit is spring.fit
    named = {one.name: one for one in rest}
    # One that is no longer near is left; a support at the same place is asked for.
    assert set(named) == {"damping_patch", "support_spring"}
    assert named["damping_patch"].fit.square < 1.1 * patch.fit.square
    # With the plate's own parameters as they are beside the best, and its own as they were.
    young, x = (patch.fit.model.names.index(name) for name in ("plate.youngs_modulus", "damping_patch_1.x"))
    best = spring.fit.model.as_dict(spring.fit.theta)
    assert float(begun["damping_patch"][young]) == pytest.approx(best["plate.youngs_modulus"], rel=1e-6)
    assert float(begun["damping_patch"][x]) == pytest.approx(float(lost.fit.theta[x]), rel=1e-6)


@torch.no_grad()
@pytest.mark.parametrize("aspect", [1.0, 2.0])
@pytest.mark.check
def test_a_patch_that_was_found_is_fitted_as_a_rectangle_and_is_a_square_where_that_is_enough(lab, aspect):
    scene = lab.Scene(hidden={"patch": 0.4, "aspect": aspect})
    square = scene.hypothesis("stiffness_loss")
    assert "stiffness_loss_1.aspect" not in square.fit.model.names
    (rectangle,) = scene.ranking.details.fitted(scene.state, [square])
    values = rectangle.fit.model.as_dict(rectangle.fit.theta)
    spread = float(
        rectangle.fit.covariance.diagonal()[rectangle.fit.model.names.index("stiffness_loss_1.aspect")].sqrt()
    )
    assert abs(values["stiffness_loss_1.aspect"] - aspect) < 3 * spread < 0.9
    # A number more has to earn what it costs.
    assert (rectangle.cost < square.cost) == (aspect != 1.0)
    # What is no equivalent of the best is not asked.
    far = replace(square, fit=lab.leaving(square.fit, 50 * square.fit.square))
    mass = scene.hypothesis("point_mass")
    assert mass.cost < far.cost
    assert scene.ranking.details.fitted(scene.state, [mass, far]) == []


@torch.no_grad()
@pytest.mark.parametrize("idle", [("mass_coefficient",), ("mass_coefficient", "stiffness_coefficient"), ()])
@pytest.mark.check
def test_a_number_that_does_nothing_is_left_out_and_costs_nothing(lab, scene, idle):
    whole = scene.hypothesis("viscous_damping")
    names, space = whole.fit.model.names, whole.fit.model.space
    own = {key: names.index(f"viscous_damping_1.{key}") for key in whole.candidate.searched}
    position = space.to_cube(whole.fit.theta)
    for key, column in own.items():
        position[column] = 0.0 if key in idle else 1e-2
    whole = replace(whole, fit=judged_at(scene.builder, whole.fit, {}, position))
    assert whole.fit.n_on_bound == len(idle)
    found = scene.ranking.details.left_out(scene.state, [whole])
    # An effect of which no number is left is none.
    assert len(found) == (len(idle) == 1)
    for simpler in found:
        assert set(simpler.candidate.searched) == set(own) - set(idle)
        assert simpler.fit.n_on_bound == 0
        assert simpler.fit.model.as_dict(simpler.fit.theta)["viscous_damping_1.mass_coefficient"] == 0.0
        edge = -2 * math.log(simpler.fit.comparison.on_bound)
        assert simpler.cost < whole.cost - edge
    # What is no equivalent of the best is not asked.
    far = replace(whole, fit=lab.leaving(whole.fit, 50 * whole.fit.square))
    gain = scene.hypothesis("sensor_gain")
    assert scene.ranking.details.left_out(scene.state, [gain, far]) == []


@torch.no_grad()
@pytest.mark.check
def test_what_sits_on_the_edge_of_its_interval_starts_from_the_middle_too(lab, monkeypatch):
    starts = []

    def descend(_problem, start, level, **_):
        if level == 0:
            starts.append(start)
        return start, start[:, 0]

    monkeypatch.setattr(afar, "one_level", descend)
    for young, on_edge in ((2.1e11, False), (2.29999e11, True)):
        scene = lab.Scene(young)
        base = scene.builder.reduced(scene.fit.model, scene.fit.theta[None], by_element=True)
        every = screen(scene.builder, base, scene.fit.theta, [scene.candidate("sensor_gain")], {})
        starts.clear()
        scene.ranking.afar.down(scene.state, every)
        (tried,) = starts
        column = every[0].model.names.index("plate.youngs_modulus")
        assert (len(tried) > len(every[0].starts)) == on_edge
        assert bool((tried[:, column] == 0.5).any()) == on_edge
        assert torch.equal(tried[: len(every[0].starts)], every[0].starts)


@torch.no_grad()
def test_what_runs_along_a_line_takes_the_place_of_no_other(lab, monkeypatch):
    """Seven numbers come near nearly everything: a clamp that yields was the sixth of six, and left out."""
    scene = lab.Scene()
    base = scene.builder.reduced(scene.fit.model, scene.fit.theta[None], by_element=True)
    names = ["rib", "sensor_gain", "density", "point_mass", "ground_spring", "orthotropy", "stiffness_loss"]
    every = screen(scene.builder, base, scene.fit.theta, [scene.candidate(name) for name in names], {})
    near = {one.label: 1 + 0.01 * names.index(one.candidate.name) for one in every}

    def descend(problem, start, *_, **__):
        (value,) = (near[label] for label in problem.model.effects if label in near)
        return start, start.new_full((len(start),), value)

    monkeypatch.setattr(afar, "one_level", descend)
    found = [promise.candidate.name for promise, _ in scene.ranking.afar.down(scene.state, every)]
    assert found[: SETTINGS.screening.n_sharp + 1] == names[:-1]


@torch.no_grad()
@pytest.mark.check
def test_the_residual_force_says_where_to_start_and_how_large(lab):
    # 5 % of the plate: peaks do not overlap.
    scene = lab.Scene(2.05e11, {"mass": 0.15})
    base = scene.builder.reduced(scene.fit.model, scene.fit.theta[None], by_element=True)
    names = ("point_mass", "ground_spring", "stiffness_loss", "density")
    scored = screen(scene.builder, base, scene.fit.theta, [scene.candidate(name) for name in names], {})
    found = {one.candidate.name: one for one in scene.ranking.afar.from_force(scene.state, base, scored)}
    before = {one.candidate.name: one for one in scored}
    for name in ("stiffness_loss", "density"):
        assert found[name] is before[name]
    first = found["point_mass"].model.space.to_si(found["point_mass"].starts[0])
    values = dict(zip(found["point_mass"].model.names, first.tolist(), strict=True))
    assert values["point_mass_1.x"] == pytest.approx(lab.spot[0], abs=0.04)
    assert values["point_mass_1.y"] == pytest.approx(lab.spot[1], abs=0.04)
    assert values["point_mass_1.mass"] == pytest.approx(0.15, rel=0.3)
    assert values["plate.youngs_modulus"] == pytest.approx(float(scene.fit.theta[0]))
    assert torch.equal(found["point_mass"].starts[1:], before["point_mass"].starts)
    assert found["point_mass"].drop >= 0.5


@torch.no_grad()
@pytest.mark.check
def test_what_took_less_than_it_promised_is_looked_for_farther_off(lab, scene):
    gain = scene.hypothesis("sensor_gain")
    base = scene.builder.reduced(scene.fit.model, scene.fit.theta[None], by_element=True)
    (promise,) = screen(
        scene.builder, base, scene.fit.theta, [scene.candidate("sensor_gain")], {}, near=scene.fit.marginal
    )
    assert promise.drop > 0.9
    settings = scene.ranking.settings.screening
    assert kept([promise], [gain], scene.state, settings, 12.0)
    stuck = Hypothesis(gain.candidate, gain.label, lab.leaving(gain.fit, 0.5 * scene.fit.square))
    assert not kept([promise], [stuck], scene.state, settings, 12.0)
    assert not kept([promise], [], scene.state, settings, 12.0)
    # What promised little and kept it leaves much: something promises more where peaks need not overlap.
    little = promise._replace(drop=0.5)
    assert kept([little], [stuck], scene.state, settings, 1e9)
    assert stuck.fit.reduced_misfit > 12
    assert not kept([little], [stuck], scene.state, settings, 12.0)


@torch.no_grad()
@pytest.mark.check
def test_what_falls_behind_at_a_wide_level_goes_down_no_further_but_for_the_best_two(scene, monkeypatch):
    base = scene.builder.reduced(scene.fit.model, scene.fit.theta[None], by_element=True)
    names = ("sensor_gain", "point_mass", "density", "thickness")
    every = screen(scene.builder, base, scene.fit.theta, [scene.candidate(name) for name in names], {})
    ended = {
        "sensor_gain": (10.0, 1.0, 1.0),
        "point_mass": (11.0, 5.9, 30.0),
        "density": (59.0, 6.1, 0.0),
        "thickness": (61.0, 0.0, 0.0),
    }
    asked = []

    def descend(problem, start, level, keep):
        (promise,) = [one for one in every if one.model is problem.model]
        asked.append((level, promise.candidate.name))
        return start, torch.full_like(start[:, 0], ended[promise.candidate.name][level])

    monkeypatch.setattr(afar, "one_level", descend)
    kept = scene.ranking.afar.down(scene.state, every)
    went = [{name for level, name in asked if level == wanted} for wanted in range(3)]
    # Six times the best is near enough; and of what is left two go on, however far off the second is.
    assert went == [set(names), {"sensor_gain", "point_mass", "density"}, {"sensor_gain", "point_mass"}]
    assert [promise.candidate.name for promise, _ in kept] == ["sensor_gain", "point_mass"]
    assert all(len(starts) == min(2, len(promise.starts)) for promise, starts in kept)


@torch.no_grad()
@pytest.mark.check
def test_what_stays_far_above_the_best_beside_the_axis_is_not_refitted(scene, monkeypatch):
    ranking, state, every = scene.ranking, scene.state, ("sensor_gain", "point_mass", "density", "thickness")
    base = scene.builder.reduced(scene.fit.model, scene.fit.theta[None], by_element=True)
    found = screen(scene.builder, base, scene.fit.theta, [scene.candidate(name) for name in every], {})
    values = {"sensor_gain": 7.0, "point_mass": 1.0, "density": 5.9, "thickness": 6.1}

    def begin(builder, model, start, prior, about):
        assert about is module.known_section(state.fit)
        (name,) = [one.candidate.name for one in found if one.label in model.effects]
        return module.Begun(start[0], start.new_zeros(0), values[name])

    monkeypatch.setattr(module, "begin", begin)
    monkeypatch.setattr(module, "UNIFORM", None)
    monkeypatch.setattr(module, "known_section", lambda _: None)
    ranking._far = set()
    ways = [(one, one.starts) for one in found]
    went = ranking._begun(state, ways)
    # The nearest first; six times the best is near enough.
    assert [one.candidate.name for one, _, _ in went] == ["point_mass", "density"]
    assert ranking._far == {"sensor_gain", "thickness"}
    # Two go on however far off the second is.
    values["density"] = 1e3
    assert [one.candidate.name for one, _, _ in ranking._begun(state, ways)] == ["point_mass", "thickness"]
    # What promised most beside the specimen as it was found is not ruled out there: smoothed, a damping hardly shows.
    ranking._far = set()
    first = next(one for one in found if one.candidate.name == "density")
    kept = ["point_mass", "thickness", "density"]
    assert [one.candidate.name for one, _, _ in ranking._begun(state, ways, first=first)] == kept
    assert ranking._far == {"sensor_gain"}
    # Beside a specimen that is known all of them go, the nearest first: the others need not go to their end then.
    monkeypatch.setattr(module, "known_section", lambda fit: fit)
    went = ranking._begun(state, ways)
    assert [one.candidate.name for one, _, _ in went] == ["point_mass", "thickness", "sensor_gain", "density"]
    assert [begun.value for _, _, begun in went] == [1.0, 6.1, 7.0, 1e3]


@torch.no_grad()
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.check
def test_what_sits_at_a_place_and_what_does_not_are_refitted_together_beside_a_known_specimen(
    scene, monkeypatch, known
):
    """So that the nearest of them goes first, whatever it is."""
    calls = []

    def refitted(_self, _state, chosen, *_, **__):
        calls.append({one.candidate.has_place for one, _ in chosen})
        return []

    monkeypatch.setattr(module.Ranking, "_refitted", refitted)
    monkeypatch.setattr(module, "known_section", lambda _: object() if known else None)
    monkeypatch.setattr(module, "kept", lambda *_: True)
    two = ("sensor_gain", "point_mass")
    monkeypatch.setattr(module, "promising", lambda every, *_: [one for one in every if one.candidate.name in two])
    monkeypatch.setattr(module, "spread_out", lambda *given: given[-1].starts)
    ranked = scene.ranking.at(scene.state)
    assert ranked.promises[0].drop > 0.5
    assert [one for one in calls if one] == ([{True, False}] if known else [{True}, {False}])


@pytest.mark.check
@torch.no_grad()
def test_what_left_next_to_nothing_beside_the_plate_as_told_is_not_looked_for_beside_smoothed_frfs(lab):
    scene = lab.Scene()
    ranking, gain = scene.ranking, scene.hypothesis("sensor_gain")

    def enough(misfit: float, beside: str) -> bool:
        one = replace(gain, fit=lab.leaving(gain.fit, misfit * gain.fit.judged.n))
        loud = one.fit._replace(judged=one.fit.judged._replace(noise_scale=misfit**0.5))
        told = replace(scene.state)
        here = told if beside == "told" else scene.state
        return ranking._near_enough(scene.state, told, here, [], [replace(one, fit=loud)])

    # A mean square of 2.5 is what smoothed FRFs would not show.
    assert [enough(misfit, "told") for misfit in (1.0, 2.4, 2.6)] == [True, True, False]
    # Beside a specimen that took on what is missing, it may be that specimen: only noise is enough.
    assert [enough(misfit, "state") for misfit in (1.0, 2.4)] == [True, False]


@pytest.mark.check
@torch.no_grad()
def test_where_the_best_is_nearly_right_what_leaves_many_times_as_much_is_not_asked_for_supports(lab, scene):
    gain = scene.hypothesis("sensor_gain")

    def limit(misfit: float, by_noise: bool = True) -> float:
        left = lab.leaving(gain.fit, misfit * gain.fit.judged.n)._replace(by_noise=by_noise)
        return scene.ranking._hopeless([replace(gain, fit=left)])

    n, times = gain.fit.judged.n, SETTINGS.searching.hopeless
    assert limit(1.0) == pytest.approx(times * n)
    # Nuisances may be too large for noise alone: it is nearly right all the same.
    assert limit(2.4) == pytest.approx(times * 2.4 * n)
    assert limit(2.6) == limit(2.4, by_noise=False) == scene.ranking._hopeless([]) == math.inf


@pytest.mark.check
@torch.no_grad()
def test_a_spring_that_leaves_far_too_much_is_not_tried_as_a_support(lab):
    scene = lab.Scene(hidden={"wire": (700.0, 0.2)})
    spring = scene.hypothesis("ground_spring", start=torch.tensor([0.5, 0.6, *lab.spot, 0.2]))
    priced, supports = scene.ranking.grounded.as_supports(scene.state, spring)
    assert "support_spring" in {one.name for one in supports}
    hopeless = replace(spring, fit=lab.leaving(spring.fit, 1e6))
    assert scene.ranking.grounded.as_supports(scene.state, hopeless) == (hopeless, [])
    assert priced.label == spring.label


@pytest.mark.check
@torch.no_grad()
def test_a_support_without_stiffness_is_the_dashpot_that_was_found(lab):
    """Two descents of the same ended a hundred of −2 ln L apart, and the one called support was believed."""
    scene = lab.Scene(hidden={"wire": (1e-3, 5.0)})
    dashpot = scene.hypothesis("ground_dashpot", start=torch.tensor([0.5, 0.6, *lab.spot, 0.6]))
    found, supports = scene.ranking.grounded.as_supports(scene.state, dashpot)
    assert found.name == "ground_dashpot"
    assert "support_spring" not in {one.name for one in supports}


@torch.no_grad()
@pytest.mark.check
def test_a_spring_that_stopped_short_goes_on_from_the_support_at_its_place(lab, monkeypatch):
    scene = lab.Scene(hidden={"wire": (700.0, 0.0)})
    right = scene.hypothesis("ground_spring", start=torch.tensor([0.5, 0.6, *lab.spot, 0.2]))
    # At the right place, and everything else where it was: far too soft.
    theta = right.fit.theta.clone()
    theta[[right.fit.model.names.index(f"{right.label}.stiffness")]] = 150.0
    short = replace(right, fit=judged_at(scene.builder, right.fit, {}, right.fit.model.space.to_cube(theta)))
    assert short.cost > 1.5 * right.cost
    begun = []
    refit = scene.ranking.refits.refit

    def told(state, candidate, label, starts, *others, **more):
        found = refit(state, candidate, label, starts, *others, **more)
        begun.append((found, starts))
        return found

    monkeypatch.setattr(scene.ranking.refits, "refit", told)
    again, supports = scene.ranking.grounded.as_supports(scene.state, short)
    support = begun[0][0]
    assert support.name == "support_spring"
    (start,) = next(starts for found, starts in begun if found.name == "ground_spring")
    values = dict(zip(again.fit.model.names, again.fit.model.space.to_si(start).tolist(), strict=True))
    best = dict(zip(support.fit.model.names, support.fit.theta.tolist(), strict=True))
    assert values["plate.youngs_modulus"] == pytest.approx(best["plate.youngs_modulus"], rel=1e-6)
    assert values[f"{short.label}.stiffness"] == pytest.approx(best[f"{support.label}.stiffness"], rel=1e-6)
    assert values[f"{short.label}.stiffness"] > 400.0
    assert again.name == "ground_spring"
    assert again.fit.cost == pytest.approx(right.fit.cost, rel=1e-3)
    assert torch.allclose(again.fit.theta, right.fit.theta, rtol=0.02)
    assert supports
    # One that came to its end is left as it is.
    same, _ = scene.ranking.grounded.as_supports(scene.state, right)
    assert same.fit is right.fit


@torch.no_grad()
@pytest.mark.check
def test_one_that_had_not_stopped_short_is_not_followed_from_there(lab, monkeypatch):
    scene = lab.Scene(hidden={"wire": (700.0, 0.0)})
    right = scene.hypothesis("ground_spring", start=torch.tensor([0.5, 0.6, *lab.spot, 0.2]))
    # A support there is more probable by far.
    right = replace(right, fit=lab.leaving(right.fit, right.fit.square + 1e3)._replace(way=7.0))
    beats = []
    refit = scene.ranking.refits.refit

    def told(state, candidate, label, starts, *others, **more):
        if candidate.name == "ground_spring":
            beats.append(more["beat"])
        return refit(state, candidate, label, starts, *others, **more)

    monkeypatch.setattr(scene.ranking.refits, "refit", told)
    scene.ranking.grounded.as_supports(scene.state, right)
    (beat,) = beats
    assert beat.way == 7.0
    # By what chance takes, or what makes a support there.
    assert beat.cost <= right.cost - SETTINGS.selecting.nothing**2
    assert beat.sure == is_noise(right.fit)


@torch.no_grad()
@pytest.mark.parametrize(
    ("noise", "best", "alone"),
    [
        # A support at the place of a spring is what that may be.
        (("ground_spring", "support_spring"), "ground_spring", True),
        (("ground_spring", "support_spring"), "support_spring", True),
        (("ground_spring", "support_spring"), "point_mass", False),
        (("ground_spring", "support_spring", "point_mass"), "ground_spring", False),
        (("point_mass", "support_spring"), "point_mass", False),
        (("support_spring",), "support_spring", True),
        (("point_mass",), "point_mass", True),
        ((), "point_mass", False),
    ],
)
def test_what_is_grounded_and_the_support_that_it_may_be_are_one(scene, noise, best, alone):
    names, nothing = ("ground_spring", "point_mass", "support_spring"), torch.zeros(0)
    effects = {name: replace(scene.candidate("point_mass"), effect=CATALOGUE[name]()) for name in names[:2]}
    effects["support_spring"] = replace(effects["point_mass"], effect=CATALOGUE["support_spring"](nodes=(3,)))
    quiet, loud = (scene.fit._replace(judged=scene.fit.judged._replace(noise_scale=one)) for one in (1.0, 5.0))
    every = {name: Hypothesis(one, name, quiet if name in noise else loud) for name, one in effects.items()}
    scored = [
        Scored(effects[name], name, scene.state.model, 0.1, {}, torch.zeros(1, 3), nothing, nothing)
        for name in names[:2]
    ]
    assert is_alone(every[best], Ranked(tuple(scored), tuple(every.values()))) == alone


@torch.no_grad()
@pytest.mark.check
@pytest.mark.parametrize(("factor", "least", "most"), [(0.6, 50.0, math.inf), (0.85, 4.0, 25.0)])
def test_one_that_leaves_noise_stopped_short_too_where_a_support_is_more_likely(lab, factor, least, most):
    """A little short is enough to be told from the support, which is the same there."""
    scene = lab.Scene(hidden={"wire": (700.0, 0.0)})
    right = scene.hypothesis("ground_spring", start=torch.tensor([0.5, 0.6, *lab.spot, 0.2]))
    theta = right.fit.theta.clone()
    theta[[right.fit.model.names.index(f"{right.label}.stiffness")]] *= factor
    short = replace(right, fit=judged_at(scene.builder, right.fit, {}, right.fit.model.space.to_cube(theta)))
    assert is_noise(short.fit)
    assert least < short.cost - right.cost < most
    again, _ = scene.ranking.grounded.as_supports(scene.state, short)
    assert again.name == "ground_spring"
    assert again.fit.cost == pytest.approx(right.fit.cost, abs=1.0)


@pytest.mark.parametrize("needed", [(), ("gain",)])
def test_beside_noise_what_promises_no_more_than_chance_waits_for_one_that_is_needed(lab, scene, monkeypatch, needed):
    """Of what waits, that is fitted then which promises half of what an equivalent takes: 10 of 20."""
    one, state, nothing = scene.hypothesis("sensor_gain"), scene.state, torch.zeros(0)
    taken = never_equivalent(one.fit) + 20.0
    one = replace(one, fit=lab.leaving(one.fit, one.fit.square + state.fit.cost - one.fit.cost - taken))
    start = torch.zeros(1, 3)
    chosen = [
        (Scored(one.candidate, name, state.model, fall / state.fit.square, {}, start, nothing, nothing), start)
        for name, fall in PROMISED.items()
    ]

    def refitted(_state, some, _before=()):
        return [replace(one, label=scored.label) for scored, _ in some]

    monkeypatch.setattr(scene.ranking, "_refitted", refitted)
    monkeypatch.setattr(module, "is_needed", lambda _fit, found, _by_chance: found.label in needed)

    def checked(by_chance: float, some: int | None = None) -> list[str]:
        return [found.label for found in scene.ranking._checked(state, chosen[:some], by_chance)]

    assert checked(20.0) == (["gain", "mass", "spring"] if needed else ["gain", "mass"])

    # What a larger effect contains comes before it, whatever it promises: it waits like all others.
    chosen.insert(1, chosen.pop())
    every, above = ["gain", "mass", "spring"], ["gain", "mass"]
    assert checked(20.0) == (every if needed else above)
    # The best is looked at whatever it promises.
    assert checked(50.0) == (["gain", "mass", "spring"] if needed else above[:1])
    assert checked(20.0, 0) == []


@torch.no_grad()
@pytest.mark.check
def test_what_the_mesh_may_have_left_adds_to_what_chance_takes_where_it_looks_like_the_effect(lab):
    """A vector's projection is no longer than those of its two parts together."""
    quiet = lab.Scene(hidden={"gain": 1.0})
    base = quiet.builder.reduced(quiet.fit.model, quiet.fit.theta[None], by_element=True)
    every = [quiet.candidate(name) for name in ("point_mass", "sensor_gain", "time_delay")]
    # A mesh that made all FRFs too small by a part would look like a gain, and not like a delay.
    by_mesh = 0.01 * quiet.fit.expected
    alone, beside = (quiet.ranking._nearby(quiet.state, base, every, one) for one in (None, by_mesh))
    chance = alone[1]
    assert 4 < chance < 30
    assert beside[1] == chance
    ranked = Ranked(tuple(beside[0]), (), chance, square=quiet.fit.square)
    gain, mass, delay = (
        next(one for one in ranked.promises if one.candidate.name == name)
        for name in ("sensor_gain", "point_mass", "time_delay")
    )
    marginal = quiet.fit.marginal
    whole = float(marginal.whitened(marginal.over_noise(by_mesh)).square().sum())
    # The modulus and the loss, which are fitted, take some of it.
    assert 0.5 * whole < gain.by_mesh < whole
    assert mass.by_mesh < gain.by_mesh
    assert delay.by_mesh < 1e-3 * gain.by_mesh
    own = gain.by_chance_at_most
    # A gain is one number, and a mass may sit anywhere.
    assert 4 < own < mass.by_chance_at_most
    assert own < chance
    assert ranked.chance("sensor_gain") == own
    assert ranked.chance("support_spring") == chance
    assert ranked.allowed(gain) == pytest.approx(own + gain.by_mesh + 2 * (own * gain.by_mesh) ** 0.5)
    assert ranked.exceeds(delay) == pytest.approx(delay.drop * quiet.fit.square / ranked.allowed(delay))
    assert ranked.exceeds(ranked.most_beyond) == max(map(ranked.exceeds, ranked.promises))
    assert not any(one.by_mesh for one in alone[0])


@torch.no_grad()
def test_those_go_on_that_gained_a_quarter_of_what_the_best_did(scene):
    gain = scene.hypothesis("sensor_gain")

    def ended(way: float, cost: float) -> Hypothesis:
        judged = gain.fit.judged._replace(cost=cost, white=1.0, n=1000.0, noise_scale=1.0, scale={})
        return Hypothesis(gain.candidate, gain.label, gain.fit._replace(way=way, judged=judged, prior=0.0))

    before = ended(10_000.0, 12_000.0).fit
    state = replace(scene.state, fit=before._replace(judged=before.judged._replace(noise_scale=5.0)))
    beat = scene.ranking._beat(state, [ended(3_000.0, 6_000.0), ended(2_000.0, 4_000.0)])
    assert beat[:2] == pytest.approx((8_000.0, 10_000.0))
    # Where the best gained little, all that are as good as it, or nearly so.
    near = scene.ranking._beat(state, [ended(9_900.0, 11_900.0)])
    assert near.way > 9_900.0 + 100 + 30
    assert near.cost - 11_900.0 == pytest.approx(near.way - 9_900.0)
    # A part of fifty times the noise is that of as many numbers once the noise is as large as what is left.
    far = ended(9_900.0, 11_900.0)
    far = replace(far, fit=far.fit._replace(judged=far.fit.judged._replace(white=50.0)))
    way, cost, _ = scene.ranking._beat(state, [far])
    assert way - cost + 2_000.0 == pytest.approx(SETTINGS.selecting.close_part * 49_000.0)
    # Of what was run off already, and where nothing but noise was left, equivalents alone.
    ended_near = scene.ranking._beat(state, [ended(9_999.0, 11_999.0)], ended=True)
    assert ended_near.way - 9_999.0 == pytest.approx(never_equivalent(ended(0.0, 0.0).fit))
    quiet = replace(state, fit=state.fit._replace(judged=state.fit.judged._replace(noise_scale=1.0)))
    assert scene.ranking._beat(quiet, [ended(9_999.0, 11_999.0)])[:2] == pytest.approx(ended_near[:2])
    loud = gain.fit.judged._replace(noise_scale=5.0)
    assert not scene.ranking._beat(state, [replace(gain, fit=gain.fit._replace(way=1.0, judged=loud))]).sure
    assert ended_near.sure
    # Without ways there is no racing.
    assert scene.ranking._beat(state, [ended(float("inf"), 0.0)]) == module.NOBODY


@torch.no_grad()
@pytest.mark.parametrize(("known", "sure", "counts"), [(True, False, True), (False, False, False), (False, True, True)])
def test_where_nothing_is_known_of_the_specimen_one_that_leaves_noise_counts_alone(
    scene, monkeypatch, known, sure, counts
):
    """From there the first parts of a way say little of its end."""
    asked = []
    monkeypatch.setattr(refit_module, "fit", lambda *given: asked.append(given[-1]) or scene.fit)
    about = Found(torch.zeros(0), torch.zeros(0, 0), None) if known else None
    assert scene.fit.about is None
    beat, start = Beat(1.0, 2.0, sure), torch.full((1, 3), 0.5)
    scene.ranking.refits.refit(scene.state, scene.candidate("sensor_gain"), "g", start, about=about, beat=beat)
    assert asked == [beat if counts else module.NOBODY]


@pytest.mark.check
@torch.no_grad()
def test_what_has_no_number_to_be_fitted_has_no_twin(lab, monkeypatch):
    scene = lab.Scene(hidden={"gain": 1.5})
    turned = scene.hypothesis("sensor_gain")
    turned = replace(turned, candidate=replace(turned.candidate, searched={}))
    turned = replace(turned, fit=lab.leaving(turned.fit, 1e-3 * scene.fit.square))
    everyone = [scene.candidate(name) for name in ("density", "hysteretic_damping")]
    assert scene.ranking.instead.of(scene.state, turned, everyone, module.NOBODY) == []


@pytest.mark.check
@torch.no_grad()
def test_what_else_may_sit_where_the_best_does_is_tried_there(lab, monkeypatch):
    """A soft patch, taken for a mass at its middle: from there it is found."""
    scene = lab.Scene(hidden={"patch": 0.6})
    place = torch.tensor([0.5, 0.6, lab.spot[0] + 0.02, lab.spot[1] - 0.02, 0.3])
    mass = scene.hypothesis("point_mass", start=place)
    everyone = [scene.candidate(name) for name in ("density", "point_mass", "stiffness_loss", "ground_spring")]
    found = {one.name: one for one in scene.ranking.instead.of(scene.state, mass, everyone, module.NOBODY)}
    assert found.keys() == {"stiffness_loss", "ground_spring"}
    patch = found["stiffness_loss"]
    assert patch.fit.square < 0.1 * mass.fit.square
    values = patch.fit.model.as_dict(patch.fit.theta)
    assert values["stiffness_loss_1.factor"] == pytest.approx(0.6, abs=0.1)
    # Where the best explains little, its place is none to look at.
    little = replace(mass, fit=lab.leaving(mass.fit, 0.8 * scene.fit.square))
    assert scene.ranking.instead.of(scene.state, little, everyone, module.NOBODY) == []


@pytest.mark.check
@torch.no_grad()
def test_a_law_of_damping_is_refitted_where_dampings_would_have_to_scatter_more_than_tests_have_them(
    scene, monkeypatch
):
    """Whatever it promises: each mode has taken on its part, and from there the way to it is not linear."""
    asked: list[str] = []
    laws = {name for name, effect in CATALOGUE.items() if "damping_scatter" in effect.like}
    monkeypatch.setattr(module, "beside_what_was_told", lambda *given: replace(given[-1]))
    monkeypatch.setattr(module, "excessive", lambda _: {"damping_scatter": 3.6})
    monkeypatch.setattr(scene.ranking, "_widely", lambda *_: ([], []))
    monkeypatch.setattr(
        scene.ranking,
        "_refitted",
        lambda _, chosen, *__, **___: asked.extend(one.candidate.name for one, _ in chosen) or [],
    )
    for known, wanted in ((Found(torch.zeros(0), torch.zeros(0, 0), None), True), (None, False)):
        asked.clear()
        monkeypatch.setattr(module, "known_section", lambda _, known=known: known)
        scene.ranking.at(scene.state)
        assert (laws - {"hysteretic_damping"} <= {*asked}) is wanted
    assert laws == {
        "viscous_damping", "hysteretic_damping", "exponential_window", "directional_damping", "frequency_dependent_loss"
    }  # fmt: skip


@pytest.mark.check
@torch.no_grad()
def test_the_best_is_tried_at_the_mirror_images_of_its_place(lab, monkeypatch):
    """A mass that was found on the wrong side of the plate, whose natural frequencies say the same there."""
    scene = lab.Scene(hidden={"mass": 0.05})
    x, y = lab.spot
    wrong = scene.hypothesis("point_mass", start=torch.tensor([0.5, 0.6, 1 - x, y, 0.4]))
    assert wrong.own["x"] == pytest.approx(1 - x, abs=0.2)
    (right,) = scene.ranking.instead.at_images(scene.state, wrong)
    assert right.fit.square < 0.5 * wrong.fit.square
    assert is_noise(right.fit)
    assert (right.own["x"], right.own["y"]) == pytest.approx((x, y), abs=0.01)
    assert scene.ranking.instead.at_images(scene.state, scene.hypothesis("sensor_gain")) == []
    # And of a ranking it is.
    monkeypatch.setattr(scene.ranking, "_run_off", lambda *_: [wrong])
    monkeypatch.setattr(scene.ranking.instead, "of", lambda *_: [])
    (named,) = scene.ranking.at(scene.state).hypotheses
    assert named.fit.cost == right.fit.cost


@pytest.mark.check
@torch.no_grad()
def test_a_twin_that_moves_the_modulus_by_many_widths_of_a_peak_is_found(lab):
    """A level 4 % too low is more mass: of a density beside a higher modulus, or of a thickness beside a lower one."""
    box = {"plate.youngs_modulus": Searched(1.4e11, 2.9e11), "loss.stiffness_loss_factor": Searched(1e-4, 5e-2, True)}
    scene = lab.Scene(
        hidden={"gain": 1 / 1.04, "loss": 2e-4}, lines=torch.linspace(10.0, 300.0, 400, dtype=torch.float64), box=box
    )
    everyone = [scene.candidate(name) for name in ("density", "thickness")]
    whole = with_candidate(scene.state.model, "density_1", everyone[0])
    start = torch.tensor([1.04 * 2.05e11, 1.04 * 7850.0, 2e-4]).double()
    heavier = scene.hypothesis("density", start=whole.space.to_cube(start))
    assert is_noise(heavier.fit)
    (thicker,) = scene.ranking.instead.of(scene.state, heavier, everyone, module.NOBODY)
    assert is_noise(thicker.fit)
    values = thicker.fit.model.as_dict(thicker.fit.theta)
    assert values["thickness_1.value"] == pytest.approx(1.04 * 0.003, rel=1e-3)
    assert values["plate.youngs_modulus"] == pytest.approx(2.05e11 / 1.04**2, rel=2e-3)


@pytest.mark.check
@torch.no_grad()
def test_the_twin_of_an_effect_of_the_whole_plate_is_tried_where_that_ended(lab):
    """E_y/E_x does to the modes what the fourth power of the sides' ratio does."""
    scene = lab.Scene(hidden={"ratio": 0.8})
    everyone = [scene.candidate(name) for name in ("orthotropy", "aspect_ratio", "density", "hysteretic_damping")]
    start = torch.tensor([2.1e11, 1e-2, 0.8, 1.0]).double()
    label, candidate = "orthotropy_1", everyone[0]
    whole = with_candidate(scene.state.model, label, candidate)
    grain = scene.hypothesis("orthotropy", start=whole.space.to_cube(start))
    found = scene.ranking.instead.of(scene.state, grain, everyone, module.NOBODY)
    (sides,) = (one for one in found if one.name == "aspect_ratio")
    values = sides.fit.model.as_dict(sides.fit.theta)
    assert values["aspect_ratio_1.ratio"] == pytest.approx(0.8**-0.25, rel=2e-3)
    # What changes all modes alike does not do the same.
    assert "density" not in {one.name for one in found}
    # Where a baseline leaves little, what takes all of that has twins too.
    assert is_noise(grain.fit)
    near = replace(scene.state, fit=lab.leaving(scene.fit, 1.5 * grain.fit.square))
    assert "aspect_ratio" in {one.name for one in scene.ranking.instead.of(near, grain, everyone, module.NOBODY)}


@pytest.mark.check
@torch.no_grad()
def test_what_sits_at_a_place_starts_from_the_sizes_and_strengths_that_fit_there(lab):
    scene = lab.Scene(hidden={"patch": 0.1})
    base = scene.builder.reduced(scene.fit.model, scene.fit.theta[None], by_element=True)
    near = scene.fit.marginal
    (promise,) = screen(scene.builder, base, scene.fit.theta, [scene.candidate("stiffness_loss")], {}, near=near)
    starts = spread_out(scene.builder, {}, scene.state, base, promise)
    half = scene.ranking.settings.screening.n_start // 2
    assert len(starts) == 2 * half + 1
    # As they were promised, too, and where the model is.
    assert torch.equal(starts[half:-1], promise.starts[:half])
    assert torch.equal(starts[-1], promise.starts[-1])
    level = scene.builder.target.levels - 1
    left = Problem(scene.builder, promise.model, {}, near).residual(starts[:half], level).square().sum(-1)
    assert bool((left.diff() >= 0).all())
    told = {tuple(row) for row in promise.starts.tolist()}
    assert sum(tuple(row) not in told for row in starts.tolist()) >= half // 2
    columns = [promise.model.names.index(f"{promise.label}.{axis}") for axis in ("x", "y")]
    places = {tuple(row) for row in promise.starts[: scene.ranking.settings.selecting.n_best, columns].tolist()}
    fresh = [row for row in starts if tuple(row.tolist()) not in told]
    assert {tuple(row[columns].tolist()) for row in fresh} <= places


@pytest.mark.check
@torch.no_grad()
def test_what_may_make_another_plate_is_spread_over_its_prior_where_no_peaks_overlap(lab):
    """A wooden plate taken for an isotropic one: no step from the fitted modulus promises anything."""
    scene = lab.Scene(hidden={"ratio": 0.1})
    assert scene.builder.target.trusts_the_noise
    assert scene.fit.left > 0.5
    base = scene.builder.reduced(scene.fit.model, scene.fit.theta[None], by_element=True)
    every = [scene.candidate(name) for name in ("orthotropy", "point_mass")]
    scored = {one.candidate.name: one for one in screen(scene.builder, base, scene.fit.theta, every, {})}
    spread = scene.ranking.afar.spread(scene.state, scored["orthotropy"])
    assert 1 - spread.drop < 0.25 * (1 - scored["orthotropy"].drop)
    best = dict(zip(spread.model.names, spread.model.space.to_si(spread.starts[0]).tolist(), strict=True))
    assert best["orthotropy_1.young_ratio"] == pytest.approx(0.1, rel=0.3)
    # What sits at a place does not, and nothing where peaks overlap.
    assert scene.ranking.afar.spread(scene.state, scored["point_mass"]) is scored["point_mass"]
    near = replace(scene.state, fit=scene.fit._replace(left=0.3))
    assert scene.ranking.afar.spread(near, scored["orthotropy"]) is scored["orthotropy"]


@pytest.mark.check
@torch.no_grad()
def test_what_is_simpler_is_tried_where_a_larger_effect_leaves_noise(lab):
    scene = lab.Scene(hidden={"mass": 0.05})
    lost = scene.hypothesis("point_mass", start=torch.tensor([0.5, 0.6, 0.9, 0.9, 0.01]))
    values = {"x": lab.spot[0], "y": lab.spot[1], "mass": 0.05, "stiffness": 1e9, "viscous_damping": 1.0}
    candidate = scene.candidate("absorber")
    whole = with_candidate(scene.state.model, "absorber_1", candidate)
    start = start_of(whole, torch.tensor([2.1e11, 1e-2]).double(), scene.state.model, values, "absorber_1")
    larger = scene.hypothesis("absorber", start=start)
    assert is_noise(larger.fit)
    assert not is_noise(lost.fit)
    everyone = [scene.candidate(name) for name in ("point_mass", "stiffness_loss")]
    (mass,) = scene.ranking.instead.of(scene.state, larger, everyone, module.NOBODY)
    assert mass.name == "point_mass"
    assert is_noise(mass.fit)
