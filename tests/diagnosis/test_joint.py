"""Parameters and specimen fitted at once: what a fit finds of a plate that is not quite the one that was meant."""

import gc
import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from torchplate.diagnosis import fit as fit_module
from torchplate.diagnosis import joint as fitted_at_once
from torchplate.diagnosis.basins import fit_from_the_box
from torchplate.diagnosis.fit import Beat, fit
from torchplate.diagnosis.joint import Joint, Lower
from torchplate.diagnosis.judged import settled
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.settings import SETTINGS
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import Found, Marginal, n_terms
from torchplate.effects import CATALOGUE
from torchplate.measurement import Imperfections
from torchplate.measurement.assessment.noise import Noise, noise_level
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

LINES = torch.arange(20.0, 400.0, 0.75, dtype=torch.float64)
RESPONSE, REFERENCE = (3, 17), (7, 9, 26, 31)
TRUTH = torch.tensor([2.05e11, 4e-3], dtype=torch.float64)
KNOWN = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003}
BOX = {"plate.youngs_modulus": Searched(1.8e11, 2.3e11), "loss.stiffness_loss_factor": Searched(1e-3, 5e-2, True)}
TOLD = Imperfections(position_std=1e-4, frequency_drift=1e-5, calibration_std=1e-3, damping_scatter=0.15)
# The section off by up to 2.4 standard deviations, and one mode damped 1.9 times as much as its law says.
FAR = {0: -1.6, 2: 2.4, 5: -1.1, 8: 1.3, 18: 1.2}
ODD_MODE, ODD = 5, 4.3


@pytest.fixture(scope="module")
def workshop(lab) -> SimpleNamespace:
    """A lightly damped plate as a workshop makes it, and the model that was meant."""
    effects = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"]()}
    meant = PlateModel(Mesh(0.43, 0.3, 6, 5), effects, KNOWN, BOX, list(RESPONSE), list(REFERENCE), "accelerance")

    def against(frf, signal) -> ModelBuilder:
        std = lab.true_std(signal, 2e-3, "mixed")
        noise = Noise(std, lab.true_floor(std, signal), (), torch.zeros_like(std))
        frfs = lab.measured(LINES, frf + lab.noise_of(std, 3), RESPONSE, REFERENCE)
        target = FrfTarget(frfs, noise, torch.zeros(frf.shape[1:], dtype=torch.bool), imperfections=TOLD)
        # No mesh error: the data come from the same mesh.
        return ModelBuilder(meant, target.with_mesh_error(torch.zeros_like(LINES), 0.0, 8), as_given=True)

    with torch.no_grad():
        uniform = meant.frf(TRUTH, LINES)
        builder = against(uniform, uniform)
        plain = builder.reduced(builder.given, TRUTH[None])
        specimens = builder.target.specimens(plain, TRUTH)
        shift = torch.zeros(len(specimens.names), dtype=torch.float64)
        for index, far in FAR.items():
            shift[index] = far
        shift[specimens.n_term + ODD_MODE] = ODD
        frf = specimens.at(shift).frf(TRUTH, LINES)
        builder = against(frf, frf)
    joint = Joint(builder, builder.given, specimens, {})
    return SimpleNamespace(builder=builder, joint=joint, specimens=specimens, shift=shift, uniform=uniform, frf=frf)


@torch.no_grad()
@pytest.mark.check
def test_a_plate_that_wanders_is_fitted_to_its_noise(workshop):
    """Though the plate that was meant misses it by more than half."""
    away = (workshop.frf - workshop.uniform).norm(dim=0) / workshop.frf.norm(dim=0)
    assert float(away.mean()) > 0.5
    found = fit_from_the_box(workshop.builder, workshop.builder.given, {})
    # χ²/n of some 8,000 numbers scatters by 1.6 %.
    assert found.reduced_misfit < 1.05
    assert found.about is not None
    odd = float(found.about.shift[workshop.specimens.n_term + ODD_MODE])
    # The law is fitted too, so that the other modes share what this one has more.
    assert odd == pytest.approx(ODD, abs=1.0)
    # E and a section that wanders are told apart by the prior alone: within what is said of E.
    std = found.covariance.diagonal().sqrt()
    assert bool(((found.theta - TRUTH).abs() < 3.5 * std).all())


@torch.no_grad()
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.check) for seed in (1, 2))])
@pytest.mark.check
def test_no_way_ends_less_probable_than_it_began(workshop, seed):
    joint, generator = workshop.joint, torch.Generator().manual_seed(seed)
    shift = workshop.shift + 0.5 * torch.randn(len(workshop.shift), generator=generator, dtype=torch.float64)
    position = workshop.builder.given.space.to_cube(TRUTH) + 0.002
    before = joint._judged(position, shift, None)[1]
    ended = joint.descend_sharply(position, shift)
    after, truth = (
        joint._judged(where, off, places)[1]
        for where, off, places in (
            (ended.position, ended.found.shift, ended.found.channels),
            (workshop.builder.given.space.to_cube(TRUTH), workshop.shift, None),
        )
    )
    assert after < before
    # The most probable is more probable than the truth, by a few for each of some thirty unknowns.
    assert after < truth


@torch.no_grad()
def test_a_step_that_leads_up_is_not_taken(workshop, monkeypatch):
    """Nor half of it, nor a quarter."""
    position = workshop.builder.given.space.to_cube(TRUTH)
    monkeypatch.setattr(workshop.joint, "descend", lambda where, shift, *_: (where + 0.2, shift, 1.0))
    ended = workshop.joint.descend_sharply(position, workshop.shift)
    assert torch.equal(ended.position, position)


@torch.no_grad()
@pytest.mark.parametrize(
    ("at_end", "part"),
    [
        # Nuisances about the beginning say that it falls up to four times as far, and so do those about the end.
        (lambda part: (part - 5) ** 2, 4.0),
        # Those promised it alone: half of that is there.
        (lambda part: 20 + (part - 1) ** 2, 2.0),
        (lambda part: 20 + 6 * part, 0.5),
        (lambda _: 26.0, None),
    ],
)
def test_a_part_is_as_long_as_it_leads_on_and_counts_what_is_there(workshop, monkeypatch, at_end, part):
    joint, here = workshop.joint, (workshop.builder.given.space.to_cube(TRUTH), workshop.shift)
    begun, step = joint._beside(*here, None), 1e-2

    def misfit(_, place, __, marginal) -> float:
        gone = float((place[0] - here[0])[0]) / step
        return (gone - 5) ** 2 if marginal is begun else at_end(gone)

    monkeypatch.setattr(Joint, "_misfit", misfit)
    monkeypatch.setattr(Joint, "_seen", lambda *_: None)
    monkeypatch.setattr(Joint, "_beside", lambda *_: begun)
    found = joint._lower(here, (here[0] + step, here[1]), None, begun)
    if part is None:
        assert found is None
        return
    assert torch.allclose(found.place[0], here[0] + part * step)
    assert found.fallen == pytest.approx(25 - at_end(part))


@torch.no_grad()
@pytest.mark.check
def test_along_a_valley_that_priors_alone_make_uneven_the_way_is_not_left_half_way(workshop):
    """A law of a third more loss, each mode as much below it: the FRFs are the same, their scatter is less likely."""
    joint, n = workshop.joint, workshop.specimens.n_term
    space, ends = workshop.builder.given.space, []
    for share in (-0.3, 0.3):
        theta, shift = TRUTH.clone(), workshop.shift.clone()
        theta[1] *= math.exp(share)
        shift[n:] -= share / TOLD.damping_scatter
        ends.append(float(space.to_si(joint.descend_sharply(space.to_cube(theta), shift).position)[1]))
    # Beside one another within half of what the mean of so many scattered modes is known by.
    std = TOLD.damping_scatter / (len(workshop.shift) - n) ** 0.5
    assert abs(math.log(ends[1] / ends[0])) < 0.5 * std


@torch.no_grad()
@pytest.mark.check
def test_how_well_a_specimen_is_known_hangs_on_no_interval(workshop):
    """One hypothesis has a parameter known to a millionth of what is searched, another has not."""
    builder = workshop.builder
    wide = {"plate.youngs_modulus": Searched(1e9, 1e16)}
    every = []
    for model in (builder.given, builder.given.replaced(searched=builder.given.searched | wide)):
        plain = builder.reduced(model, TRUTH[None])
        joint = Joint(builder, model, builder.target.specimens(plain, TRUTH), {})
        every.append(joint.descend_sharply(model.space.to_cube(TRUTH), workshop.shift).found.spread.diagonal().sqrt())
    near, far = every
    # Both end in one place, within what an unknown is worth.
    assert torch.allclose(near, far, rtol=0.05, atol=1e-3)
    assert float(near.min()) > 1e-4


@torch.no_grad()
def test_what_cannot_get_near_is_left_soon(workshop, monkeypatch):
    """At the rate of its last part, in as many as it may be hoped to go on so: one that can goes on."""
    builder, joint = workshop.builder, workshop.joint
    position, settings = builder.given.space.to_cube(TRUTH), builder.target.settings.fitting
    n_part, hoped = settings.n_way, settings.hoped
    marginal, _ = joint._judged(position, workshop.shift, None)
    costs: list[float] = []

    def cost(*_):
        costs.append(-10.0 * len(costs))
        return costs[-1]

    monkeypatch.setattr(Joint, "_cost", cost)
    monkeypatch.setattr(Joint, "_lower", lambda _, here, *__: Lower(here, None, marginal, 10.0, 1e3))
    monkeypatch.setattr(Joint, "descend", lambda _, where, shift, *__: (where, shift, 1.0))
    for beat, hopeless, n in (
        # Ten for each part, of which one is judged before the first.
        (-10.0 * (1 + hoped), 3.0, 1 + n_part),
        (-10.0 * (1 + hoped) - 5.0, 3.0, 2),
        # A sum of squares that no longer falls, and is too large.
        (math.inf, 1.0, 2),
    ):
        costs.clear()
        way = Joint(builder, builder.given, workshop.specimens, {}, hopeless=hopeless, beat=beat)
        way.descend_sharply(position, workshop.shift)
        assert len(costs) == n


@torch.no_grad()
@pytest.mark.parametrize(("left", "n"), [(3.0, 6), (1.5, 13)])
def test_a_way_that_leads_round_is_left_and_ends_where_it_was_best(workshop, monkeypatch, left, n):
    """Far off, every part leads down beside as much noise as is left, and no place becomes more probable.

    Near the noise that is no reason to stop.
    """
    builder = workshop.builder
    start = builder.given.space.to_cube(TRUTH)
    marginal, _ = workshop.joint._judged(start, workshop.shift, None)
    places = [start + 0.01 * k for k in range(20)]
    costs = [1e6, 9e5, 5e5, *(6e5 + 1e3 * k for k in range(20))]
    turn: list[float] = []

    def cost(*_):
        turn.append(costs[len(turn)])
        return turn[-1]

    monkeypatch.setattr(Joint, "_cost", cost)
    monkeypatch.setattr(Joint, "_louder", lambda *_: (marginal, left))
    monkeypatch.setattr(
        Joint, "_lower", lambda *_: Lower((places[len(turn)], workshop.shift), None, marginal, 10.0, 1e3)
    )
    monkeypatch.setattr(Joint, "descend", lambda _, where, shift, *__: (where, shift, 1.0))
    ended = Joint(builder, builder.given, workshop.specimens, {}).descend_sharply(start, workshop.shift)
    # The third is the best, and three more are given to it.
    assert len(turn) == n
    assert torch.equal(ended.position, places[2 if n == 6 else n - 1])
    assert ended.cost == (5e5 if n == 6 else costs[n - 1])


@torch.no_grad()
def test_what_was_evaluated_a_moment_ago_is_not_evaluated_again(workshop, monkeypatch):
    """It counts all the same, so that a fit that is gone on with has the same numbers."""
    builder, position = workshop.builder, workshop.builder.given.space.to_cube(TRUTH)
    joint = Joint(builder, builder.given, workshop.specimens, {})
    marginal, cost = joint._judged(position, workshop.shift, None)
    asked: list[int] = []
    inner = FrfTarget.predict
    monkeypatch.setattr(FrfTarget, "predict", lambda *given: asked.append(1) or inner(*given))
    before = builder.n_evaluation
    residual = joint._residual(position, workshop.shift, None, builder.target.levels - 1, marginal)
    assert joint._judged(position, workshop.shift, None)[1] == cost
    assert not asked
    assert builder.n_evaluation == before + 2
    anew = Joint(builder, builder.given, workshop.specimens, {})
    again = anew._residual(position, workshop.shift, None, builder.target.levels - 1, marginal)
    assert torch.equal(again, residual)
    moved = joint._residual(position + 1e-3, workshop.shift, None, builder.target.levels - 1, marginal)
    assert not torch.equal(moved, residual)
    assert len(asked) == 2


@torch.no_grad()
@pytest.mark.parametrize(("part", "goes_on"), [(1.0, True), (1.05, False)])
@pytest.mark.check
def test_far_off_nuisances_are_not_found_anew(workshop, monkeypatch, part, goes_on):
    """They take on what the parameters have not found; near the end they turn out smaller than was said."""
    builder = workshop.builder
    position = builder.given.space.to_cube(TRUTH * torch.tensor([part, 1.0], dtype=torch.float64))
    plain = builder.reduced(builder.given, TRUTH[None])
    specimens = builder.target.specimens(plain, TRUTH)
    asked: list[int] = []
    inner = Joint.descend_sharply
    monkeypatch.setattr(Joint, "descend_sharply", lambda *given: asked.append(1) or inner(*given))
    found = settled(builder, builder.given, plain, {}, position, None, specimens=specimens)
    assert bool(asked) == goes_on == (found.reduced_misfit < 2.0)


@pytest.mark.check
@torch.no_grad()
def test_a_fit_that_is_beaten_ends_in_its_first_basis_unless_its_nuisances_say_otherwise(workshop):
    builder = workshop.builder
    start = builder.given.space.to_cube(TRUTH)[None]
    first = fit(builder, builder.given, start, {}, wide=False)
    low, every = Beat(first.way - 1e5, first.cost - 1e5), []
    for beat in (low, low._replace(cost=first.cost + 10.0)):
        before = builder.n_evaluation
        found = fit(builder, builder.given, start, {}, wide=False, beat=beat)
        every.append((found.cost, builder.n_evaluation - before))
    # Ends of one basin differ by less than an unknown is worth.
    assert [cost for cost, _ in every] == pytest.approx([first.cost] * 2, abs=3.0)
    assert every[0][1] < every[1][1]


@torch.no_grad()
@pytest.mark.check
def test_what_is_known_of_a_specimen_is_where_the_next_fit_begins(workshop):
    builder = workshop.builder
    first = fit_from_the_box(builder, builder.given, {})
    start = builder.given.space.to_cube(first.theta)[None]
    before = builder.n_evaluation
    again = fit(builder, builder.given, start, {}, wide=False, about=first.about)
    assert again.cost == pytest.approx(first.cost, abs=3.0)
    assert builder.n_evaluation - before < before / 3


@torch.no_grad()
@pytest.mark.check
def test_a_fit_that_another_basis_can_gain_nothing_for_is_not_gone_on_with(workshop, monkeypatch):
    builder = workshop.builder
    first = fit_from_the_box(builder, builder.given, {})
    descents: list[int] = []
    inner = fit_module._jointly
    monkeypatch.setattr(fit_module, "_jointly", lambda *given: descents.append(1) or inner(*given))
    start = builder.given.space.to_cube(first.theta)[None] + 0.01
    again = fit(builder, builder.given, start, {}, wide=False, about=first.about)
    assert len(descents) == 1
    assert again.cost == pytest.approx(first.cost, abs=3.0)
    # One that holds too few modes changes what is left; and what leaves more than noise has not come to rest.
    full, few = (
        builder.target.specimens(builder.reduced(builder.given, again.theta[None], margin=margin), again.theta)
        for margin in (3.0, 1.05)
    )
    now, rough = full.of(again.about), few.of(again.about)
    half = 0.5 * again.square
    for before, value, rests in ((now, half, True), (rough, half, False), (now, 1e3 * half, False)):
        assert fit_module._at_rest(builder, before, now, again.theta, again.about, value) == rests


@torch.no_grad()
@pytest.mark.check
def test_hypotheses_from_one_specimen_are_compared_beside_one_variance(workshop):
    """What is not linear adds as much beside each, or −2 ln L would say how well each knows the specimen."""
    builder = workshop.builder
    first = fit_from_the_box(builder, builder.given, {})
    candidate = CATALOGUE["point_mass"]()
    known = {"lump.x": 0.31, "lump.y": 0.62}
    heavier = builder.given.replaced(
        effects={**builder.given.effects, "lump": candidate},
        known=builder.given.known_values | known,
        searched=builder.given.searched | {"lump.mass": Searched(0.0, 1e3)},
    )
    start = heavier.space.to_cube(torch.cat([first.theta, torch.tensor([1e-3], dtype=torch.float64)]))[None]
    found = fit(builder, heavier, start, {}, wide=False, about=first.about)
    n = len(first.about.shift)
    assert torch.equal(found.about.of(n).spread, first.about.spread)
    assert torch.equal(found.about.channels.reference_left, first.about.channels.reference_left)
    assert not torch.equal(found.about.of(n).shift, first.about.shift)
    # A mass of nothing gains nothing.
    assert abs(found.cost - first.cost) < 5.0


@torch.no_grad()
def test_hits_far_off_their_marks_are_found_where_they_were(workshop):
    """Seven standard deviations, so far that what they do to an FRF is not linear in the distance any more."""
    builder, far = workshop.builder, 2e-3 / TOLD.position_std
    off = torch.zeros(len(REFERENCE), 2, dtype=torch.float64)
    off[1], off[3] = torch.tensor([0.3, 0.35]) * far, torch.tensor([-0.35, 0.2]) * far
    response = torch.zeros(len(RESPONSE), 2, dtype=torch.float64)
    response[0] = torch.tensor([0.15, -0.3]) * far
    sides = torch.tensor([0.43, 0.3], dtype=torch.float64)
    moved = workshop.specimens.at(workshop.shift).with_places_off(
        response * TOLD.position_std / sides, off * TOLD.position_std / sides
    )
    frf = moved.frf(TRUTH, LINES)
    noise = frf.detach() - frf + builder.target.measured - workshop.frf
    twin = replace(builder.target, measurement=replace(builder.target.measurement, frf=frf + noise))
    against = builder.against(twin)
    joint = Joint(against, against.given, workshop.specimens, {})
    ended = joint.descend_sharply(against.given.space.to_cube(TRUTH), workshop.shift)
    channels = ended.found.channels
    (of_response, of_reference), left = channels.places(), channels.places_left()
    # What is said of a place goes beside a specimen that is known; one that is fitted too moves it by some more.
    assert bool(((of_response - response).abs() < 0.5 + 3 * left[0]).all())
    assert bool(((of_reference - off).abs() < 0.5 + 3 * left[1]).all())
    assert float(left[1].max()) < 0.7
    # Noise alone is left: χ²/n of some 8,000 numbers scatters by 1.6 %.
    marginal = joint._beside(ended.position, ended.found.shift, channels)
    theta = against.given.space.to_si(ended.position)
    rest = twin.off(against.predict(workshop.specimens.at(ended.found.shift, channels), theta), marginal.about)
    assert float(marginal.whitened(marginal.residual(rest)).square().mean()) < 1.05


@torch.no_grad()
@pytest.mark.check
def test_supports_off_their_marks_are_found_where_they_were(workshop, lab):
    """Rigid-body modes on wires are sharp: a wire off by one and a half standard deviations is not linear any more."""
    given, std = workshop.builder.given, 3e-3
    effects = {
        **given.effects,
        "wires": CATALOGUE["support_spring"](at=[(0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9)]),
    }
    known = KNOWN | {"wires.stiffness": 3e3, "wires.viscous_damping": 0.2}
    meant = PlateModel(given.mesh, effects, known, BOX, list(RESPONSE), list(REFERENCE), "accelerance")
    lines = torch.arange(8.0, 200.0, 0.25, dtype=torch.float64)
    off = torch.tensor([[1.4, -0.6], [-0.8, 1.1], [0.3, 1.5], [-1.2, -0.4]], dtype=torch.float64)
    nowhere = torch.zeros(len(RESPONSE), 2, dtype=torch.float64), torch.zeros(len(REFERENCE), 2, dtype=torch.float64)
    sides = torch.tensor([0.43, 0.3], dtype=torch.float64)
    frf = meant.with_places_off(*nowhere, off * std / sides).frf(TRUTH, lines)
    noise_std = lab.true_std(frf, 2e-3, "mixed")
    noise = Noise(noise_std, lab.true_floor(noise_std, frf), (), torch.zeros_like(noise_std))
    frfs = lab.measured(lines, frf + lab.noise_of(noise_std, 3), RESPONSE, REFERENCE)
    told = replace(TOLD, position_std=std)
    target = FrfTarget(frfs, noise, torch.zeros(frf.shape[1:], dtype=torch.bool), imperfections=told)
    builder = ModelBuilder(meant, target.with_mesh_error(torch.zeros_like(lines), 0.0, 8), as_given=True)
    specimens = builder.target.specimens(builder.reduced(builder.given, TRUTH[None]), TRUTH)
    joint = Joint(builder, builder.given, specimens, {})
    ended = joint.descend_sharply(builder.given.space.to_cube(TRUTH), torch.zeros(0, dtype=torch.float64))
    channels = ended.found.channels
    # Two wires off alike hold a rigid body nearly as two others off the other way do.
    assert torch.allclose(channels.support, off, atol=0.3)
    marginal = joint._beside(ended.position, ended.found.shift, channels)
    theta = builder.given.space.to_si(ended.position)
    rest = builder.target.off(builder.predict(specimens.at(ended.found.shift, channels), theta), marginal.about)
    # χ²/n of some 12,000 numbers scatters by 1.3 %; wires that are linear about their marks leave hundreds.
    assert float(marginal.whitened(marginal.residual(rest)).square().mean()) < 1.05


@torch.no_grad()
def test_what_a_drift_shows_is_what_taking_more_of_it_off_does(workshop):
    """The measured resonances, not the model's: a way is judged by what is taken off."""
    measurement = workshop.builder.target.measurement
    told = replace(workshop.builder.target.noise, resonances=noise_level(measurement).resonances)
    loose = Imperfections(position_std=0.0, frequency_drift=1e-4, calibration_std=0.01, damping_scatter=0.0)
    twin = replace(workshop.builder.target, noise=told, imperfections=loose)
    joint = Joint(workshop.builder.against(twin), workshop.builder.given, workshop.specimens, {})
    position = workshop.builder.given.space.to_cube(TRUTH)
    seen = joint._seen((position, workshop.shift), None, joint._beside(position, workshop.shift, None))
    names, drift = seen.of_reference, seen.of_reference.index("drift")
    assert "level" in names
    seen = seen._replace(response=0.5 + 0 * seen.response, reference=1.5 + 0 * seen.reference)
    marginal = joint._beside(position, workshop.shift, seen)
    step, off = 1e-3, []
    for sign in (1, -1):
        other = seen.reference.clone()
        other[2, drift] += sign * step
        off.append(twin.off(torch.zeros_like(workshop.frf), joint._about(seen._replace(reference=other))))
    whole = (off[1] - off[0]) / (2 * step)
    column = torch.complex(*marginal._nuisances.by_reference[..., drift].unbind(-1))
    assert float((whole[..., 2] - column[..., 2]).norm()) < 1e-3 * float(column[..., 2].norm())
    assert float(whole[..., :2].norm()) == 0.0


@torch.no_grad()
def test_far_off_a_way_is_judged_beside_as_much_noise_as_is_left(workshop):
    joint, position = workshop.joint, workshop.builder.given.space.to_cube(TRUTH)
    for where, far in ((position, False), (position + 0.1, True)):
        here = where, workshop.shift
        marginal = joint._beside(*here, None)
        louder, noise = joint._louder(here, None, marginal)
        assert (noise > 10) == far
        assert torch.allclose(louder.variance, noise * marginal.variance)
        assert joint._misfit(here, None, louder) == pytest.approx(marginal.n, rel=0.2)


@pytest.mark.check
@torch.no_grad()
def test_records_that_drift_and_channels_of_another_level_are_read_as_one_test(workshop, lab):
    """Each hit's record with natural frequencies of its own: beside sharp peaks that is not linear in the drift."""
    builder, std = workshop.builder, 1e-3
    drift = torch.tensor([1.6, -1.2, 0.4, -0.8], dtype=torch.float64)
    level = torch.tensor([2.0, -1.5, 0.0, 0.7], dtype=torch.float64)
    plate = workshop.specimens.at(workshop.shift)
    # All natural frequencies of a free plate go with the root of its modulus.
    higher = TRUTH * torch.stack([(1 + std * drift).square(), torch.ones_like(drift)], dim=-1)
    frf = torch.cat([plate.frf(theta, LINES)[..., k : k + 1] for k, theta in enumerate(higher)], dim=-1)
    frf = frf * (1 + 0.01 * level)
    noise = lab.noise_of(builder.target.noise.std, 11)
    measurement = replace(builder.target.measurement, frf=frf + noise)
    told = replace(builder.target.noise, resonances=noise_level(measurement).resonances)
    loose = Imperfections(position_std=1e-4, frequency_drift=std, calibration_std=0.01, damping_scatter=0.15)
    twin = replace(builder.target, measurement=measurement, noise=told, imperfections=loose)
    against = builder.against(twin)
    joint, true = Joint(against, against.given, workshop.specimens, {}), against.given.space.to_cube(TRUTH)
    starts = [(true, 1.0), (true, 0.5), (true + 0.02, 0.5)]
    ends = [joint.descend_sharply(place, part * workshop.shift) for place, part in starts]
    # What all records drift in common moves every mode as the modulus does: from wherever, the end is the same.
    costs = [one.cost for one in ends]
    assert max(costs) - min(costs) < 2 * against.target.settings.fitting.little
    ended = ends[0]
    # Nor does it go on from there.
    again = joint.descend_sharply(ended.position, ended.found.shift, ended.found.channels)
    assert abs(again.cost - ended.cost) < 2 * against.target.settings.fitting.little
    channels = ended.found.channels
    assert channels.of_reference == ("x", "y", "level", "drift")
    found = channels.drift_of_pairs() / std
    # What all records share may be the modulus', and what all levels share that of the other side.
    assert torch.allclose(found - found.mean(), (drift - drift.mean()).expand(2, 4), atol=0.05)
    pairs = channels.level_of_pairs()
    assert torch.allclose(pairs / pairs.mean(), (1 + 0.01 * level) / (1 + 0.01 * level).mean(), atol=1e-3)
    marginal = joint._beside(ended.position, ended.found.shift, channels)
    rest = twin.off(
        against.predict(workshop.specimens.at(ended.found.shift, channels), against.given.space.to_si(ended.position)),
        marginal.about,
    )
    # χ²/n of some 8,000 numbers scatters by 1.6 %; resonances that are found leave a little.
    assert float(marginal.whitened(marginal.residual(rest)).square().mean()) < 1.1


@torch.no_grad()
@pytest.mark.check
def test_columns_of_the_specimen_are_not_held_while_the_next_are_made(workshop, monkeypatch, collect):
    """Each as long as all FRFs: of 121 of them they are 55 MiB. After the way none are held at all."""
    made = fitted_at_once.specimen_columns
    n_off, n = len(workshop.specimens.names), 2 * workshop.frf.numel()
    held: list[int] = []

    def n_held() -> int:
        collect()
        every = [one for one in gc.get_objects() if type(one) is torch.Tensor]
        return len({one.untyped_storage().data_ptr() for one in every if one.shape == (n_off, n)})

    def columns(*told, **more):
        held.append(n_held())
        return made(*told, **more)

    before = n_held()
    monkeypatch.setattr(fitted_at_once, "specimen_columns", columns)
    way = Joint(workshop.builder, workshop.builder.given, workshop.specimens, {})
    way.descend_sharply(workshop.builder.given.space.to_cube(TRUTH), 0.5 * workshop.shift)
    assert len(held) > 2
    assert set(held) == {before}
    assert n_held() == before


@torch.no_grad()
def test_columns_are_whitened_some_at_a_time_and_come_out_as_all_at_once(workshop, monkeypatch):
    sharp, position = workshop.builder.target.levels - 1, workshop.builder.given.space.to_cube(TRUTH)
    asked: list[int] = []
    over_noise = Marginal.over_noise

    def counted(own: Marginal, off: torch.Tensor) -> torch.Tensor:
        asked.append(len(off) if off.ndim > 3 else 1)
        return over_noise(own, off)

    def slope() -> torch.Tensor:
        way = Joint(workshop.builder, workshop.builder.given, workshop.specimens, {})
        return way._jacobian(position, workshop.shift, None, sharp, way._beside(position, workshop.shift, None))

    monkeypatch.setattr(Marginal, "over_noise", counted)
    found = slope()
    assert max(asked) <= fitted_at_once.AT_ONCE < len(workshop.specimens.names)
    monkeypatch.setattr(fitted_at_once, "AT_ONCE", len(workshop.specimens.names))
    assert torch.allclose(slope(), found, rtol=1e-9, atol=1e-9 * float(found.abs().max()))


@torch.no_grad()
def test_a_basis_is_that_of_the_specimen_as_far_as_it_is_known(workshop):
    builder, specimens, shift = workshop.builder, workshop.specimens, 3.0 * workshop.shift
    spread = torch.eye(len(shift), dtype=torch.float64)
    whole = builder.given.projected(torch.eye(len(builder.mesh.free_dof), dtype=torch.float64))
    wanted = builder.target.specimens(whole, TRUTH).at(shift).frf(TRUTH, LINES)
    off, bases = [], []
    # Nothing known of it; the specimen; and one that is so near to it that its basis is taken again.
    for about in (None, Found(shift, spread), Found(shift + 0.02, spread)):
        plain = builder.reduced(builder.given, TRUTH[None], about=about)
        bases.append(plain.assembly.basis)
        found = builder.target.specimens(plain, TRUTH).at(shift).frf(TRUTH, LINES)
        off.append(float((found - wanted).norm() / wanted.norm()))
    assert off[1] < 0.2 * off[0]
    assert off[2] == off[1]
    assert bases[2] is bases[1]
    assert len(shift) > specimens.n_term == n_terms(builder.target.wandering)


@pytest.mark.check
def test_a_descent_all_of_whose_steps_are_refused_goes_on_with_more_damping(workshop, monkeypatch):
    """Peaks several widths off, a section that leans the other way: undamped steps land where nothing is better."""
    position = workshop.builder.given.space.to_cube(TRUTH * torch.tensor([0.95, 1.0], dtype=torch.float64))
    shift, sharp = -1.5 * workshop.shift, workshop.builder.target.levels - 1
    marginal, _ = workshop.joint._judged(position, shift, None)
    values, moved = [], []
    for n_refused in (0, SETTINGS.fitting.n_refused):
        monkeypatch.setattr(workshop.joint, "settings", replace(SETTINGS.fitting, n_refused=n_refused))
        *end, value = workshop.joint.descend(position, shift, sharp, 3, 1e-9, marginal)
        values.append(value)
        moved.append(max(float((end[0] - position).abs().max()), float((end[1] - shift).abs().max())))
    assert moved[0] < 1e-9
    assert moved[1] > 1e-2
    assert values[1] < 0.99 * values[0]
