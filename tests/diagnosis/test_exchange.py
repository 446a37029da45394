"""Each name is judged again once the later ones are known."""

from dataclasses import replace

import pytest
import torch

from torchplate.diagnosis.fit import NOBODY, Beat, fit
from torchplate.diagnosis.model_builder import with_candidate
from torchplate.diagnosis.selection import exchange as module
from torchplate.diagnosis.selection.criterion import Hypothesis, choose, never_equivalent
from torchplate.diagnosis.selection.exchange import Exchange
from torchplate.diagnosis.selection.settling import Settling
from torchplate.diagnosis.selection.trace import Naming, State
from torchplate.diagnosis.settings import SETTINGS


class Two:
    """A gain and a mass are hidden; one of two names was given first, the mass is found beside it."""

    def __init__(self, lab, first: str, *rivals: str, hidden=None, idle=()):
        scene = lab.Scene(hidden=(hidden or {"gain": 1.1}) | {"mass": 0.15})
        self.builder, before = scene.builder, scene.fit
        hypotheses = {name: scene.hypothesis(name, idle=idle) for name in (first, *rivals)}
        named = hypotheses[first]
        choice = choose(list(hypotheses.values()), before, named)
        model = with_candidate(scene.state.model, named.label, named.candidate)
        state = State(model, named.fit, (Naming(named, choice, before, tuple(hypotheses.values())),), scene.state)
        mass = scene.hypothesis("point_mass", state=state)
        whole = with_candidate(model, mass.label, mass.candidate)
        values = dict(zip(mass.fit.model.names, mass.fit.theta.tolist(), strict=True))
        values |= {"point_mass_1.x": lab.spot[0], "point_mass_1.y": lab.spot[1]}
        start = whole.space.to_cube(torch.tensor([values[name] for name in whole.names], dtype=torch.float64))
        mass = replace(mass, fit=fit(self.builder, whole, start[None], wide=False))
        last = Naming(mass, choose([mass], named.fit), named.fit, (mass,))
        self.state = State(whole, mass.fit, (*state.named, last), state)
        self.said: list[str] = []
        self.exchange = Exchange(self.builder, scene.ranking, {}, self.said.append)


@torch.no_grad()
@pytest.mark.check
def test_a_name_that_another_fits_better_now_is_replaced(lab):
    two = Two(lab, "orthotropy", "sensor_gain", "time_delay")
    found = two.exchange.judged_again(two.state)
    assert [one.hypothesis.name for one in found.named] == ["sensor_gain", "point_mass"]
    assert found.fit.square < 0.5 * two.state.fit.square
    values = dict(zip(found.model.names, found.fit.theta.tolist(), strict=True))
    assert values["sensor_gain_1.gain"] == pytest.approx(1.1, rel=0.01)
    assert values["point_mass_1.mass"] == pytest.approx(0.15, rel=0.05)
    assert not any(name.startswith("orthotropy") for name in found.model.names)
    assert "sensor_gain in place of orthotropy" in two.said
    # How it was when it was named is kept; what is known of it now stands beside it.
    first = found.named[0]
    assert first.hypothesis.fit.gap > 2 * first.again.best.fit.gap
    # What the mass was added to is what is left with this name alone.
    assert found.named[1].before is first.hypothesis.fit
    assert first.known is first.again
    # Beside the best the other one is far off.
    assert first.known.equivalent == ()


@torch.no_grad()
@pytest.mark.check
def test_what_promises_most_beside_the_others_takes_the_place_of_a_name_that_nothing_came_near(lab):
    two = Two(lab, "orthotropy")
    assert two.state.fit.reduced_misfit > SETTINGS.selecting.doubtful
    found = two.exchange.judged_again(two.state)
    assert sorted(one.hypothesis.name for one in found.named) == ["point_mass", "sensor_gain"]
    assert found.fit.square < 0.5 * two.state.fit.square
    said = len(two.said)
    # What was judged last is as it was judged.
    assert two.exchange.judged_again(found) is found
    assert len(two.said) == said


@torch.no_grad()
@pytest.mark.check
def test_what_an_absorber_becomes_is_tried_where_it_took_the_place_of_a_name(lab):
    """A mass was never refitted beside the other name, and an absorber that nearly stays with the plate does."""
    scene = lab.Scene(hidden={"gain": 1.1, "mass": 0.15})
    gain = scene.hypothesis("sensor_gain")
    model = with_candidate(scene.state.model, gain.label, gain.candidate)
    beside = State(model, gain.fit, (Naming(gain, choose([gain], scene.fit), scene.fit),), scene.state)
    candidate = scene.candidate("absorber")
    whole = with_candidate(model, "absorber_1", candidate)
    values = {"plate.youngs_modulus": 2.06e11, "loss.stiffness_loss_factor": 1e-2, "sensor_gain_1.gain": 1.1}
    values |= {"absorber_1.x": lab.spot[0], "absorber_1.y": lab.spot[1], "absorber_1.mass": 0.148}
    values |= {"absorber_1.stiffness": 0.9 * candidate.searched["stiffness"].high, "absorber_1.viscous_damping": 5.0}
    start = whole.space.to_cube(torch.tensor([values[name] for name in whole.names], dtype=torch.float64))
    absorber = Hypothesis(candidate, "absorber_1", fit(scene.builder, whole, start[None], wide=False))
    assert absorber.fit.reduced_misfit < SETTINGS.selecting.doubtful
    first = Naming(absorber, choose([absorber], scene.fit), scene.fit, (absorber,))
    state = State(whole, absorber.fit, (first, replace(beside.named[0], before=absorber.fit)), beside)
    said: list[str] = []
    found = Exchange(scene.builder, scene.ranking, {}, said.append).judged_again(state)
    assert [one.hypothesis.name for one in found.named] == ["point_mass", "sensor_gain"]
    assert "point_mass in place of absorber" in said
    assert found.model.as_dict(found.fit.theta)["point_mass_1.mass"] == pytest.approx(0.15, rel=0.05)


@torch.no_grad()
@pytest.mark.check
@pytest.mark.parametrize("idle", [("loss_x",), ("loss_x", "loss_xy"), ()])
def test_a_number_that_did_nothing_when_its_effect_was_named_is_asked_again_beside_the_others(lab, idle):
    """What else was missing then may have kept it there; and one that does nothing now is left out."""
    two = Two(lab, "directional_damping", hidden={"along": (0.006, 0.03, 0.0)}, idle=idle)
    found = two.exchange.judged_again(two.state)
    assert [one.hypothesis.name for one in found.named] == ["directional_damping", "point_mass"]
    values = dict(zip(found.model.names, found.fit.theta.tolist(), strict=True))
    assert found.fit.reduced_misfit == pytest.approx(1.0, abs=0.15)
    # The same loss more in all directions is the common one: what they differ by is known.
    least = values.get("directional_damping_1.loss_xy", 0.0)
    assert values["directional_damping_1.loss_x"] - least == pytest.approx(0.006, rel=0.05)
    assert values["directional_damping_1.loss_y"] - least == pytest.approx(0.03, rel=0.05)
    assert {*found.named[0].hypothesis.own} == {*found.named[0].hypothesis.candidate.searched}
    assert not bool(found.model.space.at_bound(found.fit.theta).any())


@torch.no_grad()
@pytest.mark.parametrize(("misfit", "times"), [(1.0, 10.0), (500.0, 2.0)])
@pytest.mark.check
def test_rivals_have_to_come_nearer_where_far_more_than_noise_is_left(lab, monkeypatch, misfit, times):
    two, limits = Two(lab, "orthotropy", "sensor_gain"), []

    def limited(*given, hopeless, **named):
        limits.append(hopeless)
        return fit(*given, hopeless=hopeless, **named)

    monkeypatch.setattr(module, "fit", limited)
    # Of all candidates none promises anything.
    monkeypatch.setattr(two.exchange.ranking, "promised", lambda _: [])
    square = misfit * two.state.fit.judged.n
    left = lab.leaving(two.state.fit, square)
    two.exchange.beside_the_others(replace(two.state, fit=left), 1)
    assert limits == [pytest.approx(times * square)]


@pytest.mark.check
@torch.no_grad()
@pytest.mark.parametrize("noise", [True, False])
def test_beside_noise_others_have_to_come_near_to_be_followed(lab, monkeypatch, noise):
    two, beats = Two(lab, "orthotropy", "sensor_gain"), []

    def limited(*given, beat, **named):
        beats.append(beat)
        return fit(*given, beat=beat, **named)

    monkeypatch.setattr(module, "fit", limited)
    monkeypatch.setattr(module, "is_noise", lambda _: noise)
    monkeypatch.setattr(two.exchange, "_is_far", lambda _: False)
    state = replace(two.state, fit=two.state.fit._replace(way=3.0))
    two.exchange.beside_the_others(state, 1)
    two.exchange.without_needless(state, two.builder, state.named[:1])
    above = never_equivalent(state.fit)
    wanted = Beat(3.0 + above, state.fit.cost + above) if noise else NOBODY
    assert beats == [wanted] * 2
    # A name that is taken out in the end is fitted without, whatever that leaves.
    two.exchange._fitted_without(state, state.named[0], two.builder)
    assert beats[2:] == [NOBODY]


@pytest.mark.check
@torch.no_grad()
def test_a_right_name_stays_and_knows_its_rivals_now(lab):
    two = Two(lab, "sensor_gain", "orthotropy", "time_delay")
    then = two.state.named[0].choice
    found = two.exchange.judged_again(two.state)
    first, last = found.named
    assert [first.hypothesis.name, last.hypothesis.name] == ["sensor_gain", "point_mass"]
    assert found.fit is two.state.fit
    assert first.choice is then
    assert first.known.next_best.fit.model.names != then.next_best.fit.model.names
    # Nothing came after the last.
    assert last.again is None
    assert last.known is last.choice


@pytest.mark.parametrize(
    ("first", "other"),
    [("sensor_gain", "density"), pytest.param("density", "sensor_gain", marks=pytest.mark.check)],
)
@torch.no_grad()
@pytest.mark.check
def test_a_name_that_is_as_good_as_the_best_stays(lab, first, other):
    # A free plate of another density is one of another gain.
    two = Two(lab, first, other, "orthotropy")
    found = two.exchange.judged_again(two.state)
    assert found.named[0].hypothesis.name == first
    assert found.named[0].known.equivalent == (other,)


@torch.no_grad()
@pytest.mark.check
def test_what_the_others_make_needless_is_taken_out(lab, monkeypatch):
    two = Two(lab, "sensor_gain")
    limits = []

    def limited(*given, hopeless, **named):
        limits.append(hopeless)
        return fit(*given, hopeless=hopeless, **named)

    monkeypatch.setattr(module, "fit", limited)
    kept = two.exchange.without_needless(two.state, two.builder, two.state.named)
    assert kept is two.state
    # What leaves so much more without an effect needs it, and is not fitted to its end.
    assert limits == [SETTINGS.searching.hopeless * two.state.fit.square] * 2
    beside = Two(lab, "time_delay")
    left = beside.exchange.without_needless(beside.state, beside.builder, beside.state.named)
    assert [one.hypothesis.name for one in left.named] == ["point_mass"]
    assert "time_delay is no longer needed" in beside.said


@torch.no_grad()
@pytest.mark.parametrize("seen", [True, False])
def test_a_name_is_taken_out_from_where_others_in_its_place_left_the_rest(lab, seen):
    """Beside a name the rest may go to where it does not do without; beside one that does nothing it does."""
    two = Two(lab, "time_delay", hidden={"gain": 1.0})
    first, last = two.state.named
    there = two.state.fit
    off, names = there.theta.clone(), there.model.names
    # From a mass on the other side there is no way to where it is.
    off[names.index("point_mass_1.x")], off[names.index("point_mass_1.y")] = 1 - lab.spot[0], 1 - lab.spot[1]
    off[names.index("plate.youngs_modulus")] *= 1.1
    state = replace(two.state, fit=there._replace(theta=off))
    nothing = replace(first.hypothesis, label="time_delay_2", fit=there)
    again = choose([replace(first.hypothesis, fit=state.fit), *([nothing] if seen else [])], first.before)
    state = replace(state, named=(replace(first, again=again), last))
    found = two.exchange.without_needless(state, two.builder, state.named[:1])
    assert [one.hypothesis.name for one in found.named] == ["time_delay", "point_mass"][seen:]
    if seen:
        assert found.fit.reduced_misfit == pytest.approx(there.reduced_misfit, rel=0.02)


@torch.no_grad()
@pytest.mark.parametrize("wider", [0.0, 0.9, 1.1])
@pytest.mark.check
def test_a_name_without_which_the_gap_is_narrower_by_more_than_noise_is_taken_out(lab, wider):
    two = Two(lab, "sensor_gain")
    first = two.state.named[0]
    without = two.exchange._fitted_without(two.state, first, two.builder).fit
    left = (without.left**2 + wider * two.builder.target.floor**2) ** 0.5 if wider else two.state.fit.left
    state = replace(two.state, fit=two.state.fit._replace(left=left))
    found = two.exchange.without_needless(state, two.builder, state.named[:1])
    assert (found is state) == (wider < 1)
    assert two.exchange.left_without["sensor_gain_1"] > two.state.fit.left


def loud(fit, gap):
    """The same fit, as if it left five times the noise and such a gap."""
    return fit._replace(gap=gap, left=gap, judged=fit.judged._replace(noise_scale=5.0))


@torch.no_grad()
@pytest.mark.check
def test_a_name_that_takes_nothing_off_the_gap_is_none_where_more_than_noise_is_left(lab):
    """Its confidence would be 0.00: it was less beforehand that no effect describes what is missing."""
    two = Two(lab, "sensor_gain")
    first, last = two.state.named
    worse = last.before._replace(gap=0.3, left=0.3)
    doubted = replace(two.state, named=(first, replace(last, before=worse)))
    # Where the model explains the measurement, the gap says nothing against it.
    assert two.exchange.without_improbable(doubted, two.builder) is doubted
    unexplained = replace(doubted, fit=loud(doubted.fit, 0.303))
    first = replace(first, before=first.before._replace(gap=0.9, left=0.9))
    unexplained = replace(unexplained, named=(first, doubted.named[1]))
    kept = two.exchange.without_improbable(unexplained, two.builder)
    assert [one.hypothesis.name for one in kept.named] == ["sensor_gain"]
    assert not any(name.startswith("point_mass") for name in kept.model.names)
    assert torch.isfinite(kept.fit.theta).all()
    assert two.said == ["point_mass takes nothing off the gap in the end: it is no name"]
    # One that takes three per cent of it stays.
    some = last.before._replace(gap=1.04 * 0.303, left=1.04 * 0.303)
    same = replace(unexplained, named=(first, replace(last, before=some)))
    assert two.exchange.without_improbable(same, two.builder) is same
    # So does one that brings the plate as it was found nearer, though a uniform one misses narrow peaks by more.
    wandering = last.before._replace(gap=0.2, left=0.6)
    nearer = replace(unexplained, named=(first, replace(last, before=wandering)))
    assert two.exchange.without_improbable(nearer, two.builder) is nearer


@torch.no_grad()
@pytest.mark.check
def test_where_no_name_stays_nothing_was_added(lab, monkeypatch):
    two = Two(lab, "sensor_gain")
    begun = two.state.previous.previous
    settling = Settling(two.builder, {}, two.exchange.ranking, two.exchange, two.said.append)
    far = replace(two.state, fit=loud(two.state.fit, 0.3))
    monkeypatch.setattr(settling, "ended", lambda state: state)
    nothing = tuple(replace(one, before=one.before._replace(gap=0.0, left=0.0)) for one in far.named)
    assert settling.last(replace(far, named=nothing), begun) is begun


def named_after(scene, state, name, **start):
    """The state with one effect more, fitted from these values."""
    candidate = scene.candidate(name)
    whole = with_candidate(state.model, f"{name}_1", candidate)
    values = dict(zip(state.model.names, state.fit.theta.tolist(), strict=True))
    values |= {f"{name}_1.{key}": value for key, value in start.items()}
    place = whole.space.to_cube(torch.tensor([values[one] for one in whole.names], dtype=torch.float64))
    hypothesis = Hypothesis(candidate, f"{name}_1", fit(scene.builder, whole, place[None], wide=False))
    naming = Naming(hypothesis, choose([hypothesis], state.fit), state.fit, (hypothesis,))
    return State(whole, hypothesis.fit, (*state.named, naming), state)


@torch.no_grad()
@pytest.mark.check
def test_a_spring_and_a_dashpot_at_one_place_are_one_support(lab):
    scene = lab.Scene(hidden={"wire": (9e3, 6.0)})
    x, y = lab.spot
    first = named_after(scene, scene.state, "ground_spring", x=x, y=y, stiffness=8e3)
    both = named_after(scene, first, "ground_dashpot", x=x, y=y, viscous_damping=5.0)
    assert both.fit.reduced_misfit < 1.1
    said: list[str] = []
    exchange = Exchange(scene.builder, scene.ranking, {}, said.append)
    found = exchange._as_one_support(both)
    assert [one.hypothesis.name for one in found.named] == ["support_spring"]
    assert found.fit.reduced_misfit < 1.1
    values = dict(zip(found.model.names, found.fit.theta.tolist(), strict=True))
    assert values["support_spring_1.stiffness"] == pytest.approx(9e3, rel=0.03)
    assert values["support_spring_1.viscous_damping"] == pytest.approx(6.0, rel=0.1)
    assert not any(name.startswith("ground") for name in found.model.names)
    # Alone, or at another place, it stays what it is.
    assert exchange._as_one_support(first) is first
    theta = both.fit.theta.clone()
    theta[both.model.names.index("ground_dashpot_1.x")] += 0.05
    apart = replace(both, fit=both.fit._replace(theta=theta))
    assert exchange._as_one_support(apart) is apart
