"""A force at one place of whatever law: found to its place, and none where something else is missing."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from torchplate.diagnosis import diagnose
from torchplate.diagnosis.field.aside import worth
from torchplate.diagnosis.field.forced_model import ForcedModel
from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.field.infer import force_alone, infer_field
from torchplate.diagnosis.field.one_force import one_force, with_one_force
from torchplate.diagnosis.fit import fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.result import ONE_FORCE
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.selection.trace import Ranked, State
from torchplate.diagnosis.settings import SETTINGS
from torchplate.diagnosis.target import FrfTarget
from torchplate.measurement import Noise
from torchplate.model import PlateModel, Searched

BOX = {"plate.youngs_modulus": Searched(1.8e11, 2.3e11), "loss.stiffness_loss_factor": Searched(1e-3, 5e-2, True)}
RESPONSE, REFERENCE = [3, 17, 7, 13], [9, 21]
# Of the sides; no node is there.
PLACE = (0.37, 0.81)


def cord(lines):
    """The stiffness of a cord with three resonances of its own in the band, lossy."""
    return 2e4 / torch.tan((0.02 - 4e-4j) * (lines + 40.0))


def absorber(lines, mass=0.012, hertz=130.0, damping=0.5):
    """The stiffness of a mass on a spring and a dashpot: of 12 g, tuned to 130 Hz, unless told otherwise."""
    s = 2j * torch.pi * lines
    spring = mass * (2 * torch.pi * hertz) ** 2 + s * damping
    return s**2 * mass * spring / (spring + s**2 * mass)


def read(plate: PlateModel, kind: str, reference: list[int], refine: int = 1) -> PlateModel:
    """The plate with four sensors and these hits."""
    return PlateModel(
        replace(plate.mesh, refine=refine), plate.effects, plate.known_values, plate.searched, RESPONSE, reference, kind
    )


def scene(lab, law, kind="accelerance", differ=0.6, refine=1, reference=REFERENCE) -> SimpleNamespace:
    """What is attached at the place pulls back by a stiffness for each hit and line [N/m]."""
    true = read(lab.small_plate(), kind, reference, refine)
    lines = lab.SMALL_LINES
    power = {"receptance": 0, "accelerance": 2}[kind]
    with torch.no_grad():
        alpha = true.frf(lab.nobody, lines, [*RESPONSE, PLACE], [*reference, PLACE], "receptance")
        own = alpha[:, -1:, -1]
        pull = law(lines)[:, None] * (1 + differ * torch.arange(len(reference)))
        force = -pull / (1 + pull * own) * alpha[:, -1, :-1]
        s = 2j * torch.pi * lines
        frf = s[:, None, None] ** power * (alpha[:, :-1, :-1] + alpha[:, :-1, -1:] * force[:, None])
        std = lab.true_std(frf, 0.01, "signal")
        noise = Noise(std, lab.true_floor(std, frf), (), torch.zeros_like(std))
        unit = {"receptance": "m/N", "accelerance": "m/(N s²)"}[kind]
        frfs = lab.measured(lines, frf + lab.noise_of(std, 4), RESPONSE, reference, kind=kind, unit=unit)
        target = FrfTarget(frfs, noise, torch.zeros(4, len(reference), dtype=torch.bool))
        target = target.with_mesh_error(torch.zeros_like(lines), 0.0, 10)
        builder = ModelBuilder(read(lab.small_plate(BOX), kind, reference), target, as_given=True)
        start = torch.full((1, 2), 0.5, dtype=torch.float64)
        fitted = fit(builder, builder.given, start, wide=False)
    apart = torch.zeros(4, len(reference), dtype=torch.bool)
    apart[1, 0] = True
    return SimpleNamespace(builder=builder, fit=fitted, apart=apart, grid=Grid(7, 5, False))


def found(one: SimpleNamespace):
    with torch.no_grad():
        return one_force(one.builder, one.fit, {}, one.apart, one.grid)


@pytest.mark.check
@pytest.mark.parametrize("kind", ["accelerance", "receptance"])
def test_its_place_is_found_whatever_its_law(lab, kind):
    """A stiffness that grows with frequency and differs from hit to hit: no spring, dashpot or mass is that."""
    one = scene(lab, lambda lines: 3e4 + 200.0 * lines, kind)
    force = found(one)
    assert force is not None
    off = (force.place - torch.tensor(PLACE, dtype=torch.float64)).abs()
    assert bool((off < 4 * torch.tensor(force.std) + 1e-3).all())
    assert max(force.std) < 0.02
    assert force.left < SETTINGS.comparison.noise_limit
    assert force.without > 10 * force.left
    # The model's own numbers come back beside it.
    assert float(force.theta[0]) == pytest.approx(2.05e11, rel=2e-3)
    assert abs(float(one.fit.theta[0]) / 2.05e11 - 1) > 5e-3
    target = one.builder.target
    with torch.no_grad():
        assert float(target.gap(with_one_force(one.builder, one.fit, force))) < 0.02
    nearest = int(torch.tensor(force.map).argmax())
    assert float((one.grid.place[nearest] - force.place).abs().max()) < 0.2


@pytest.mark.check
def test_something_else_is_no_force_at_a_place(lab):
    """A plate that is softer everywhere in one direction; and noise alone."""
    one = scene(lab, lambda lines: 0.0 * lines)
    assert found(one) is None
    grained = lab.Scene(hidden={"ratio": 1.5})
    with torch.no_grad():
        apart = torch.zeros(2, 3, dtype=torch.bool)
        apart[0, 1] = True
        assert one_force(grained.builder, grained.fit, {}, apart, Grid(7, 5, False)) is None


@pytest.mark.parametrize("n_response", [pytest.param(4, marks=pytest.mark.check), 1])
def test_what_is_linear_pulls_alike_in_all_hits_and_one_sensor_finds_it(lab, n_response):
    """A cord with three resonances of its own in the band, lossy."""

    one = scene(lab, cord, differ=0.0, reference=[9, 21, 1, 19, 12, 25][: 8 - n_response])
    if n_response == 1:
        seen = torch.zeros_like(one.apart)
        seen[1] = True
        one.builder = one.builder.against(one.builder.target.holding_out(~seen))
        one.fit = fit(one.builder, one.builder.given, torch.full((1, 2), 0.5, dtype=torch.float64), wide=False)
    force = found(one)
    assert force is not None
    assert force.alike
    places = torch.tensor([force.place.tolist(), *force.others])
    assert float((places - torch.tensor(PLACE)).abs().amax(-1).min()) < 0.01
    assert float(force.theta[0]) == pytest.approx(2.05e11, rel=2e-3)


@pytest.mark.check
def test_what_larger_errors_would_do_is_no_force(lab):
    """Where noise and nuisances may be so many times what was said of them, these do as well."""
    one = scene(lab, lambda lines: 3e4 + 200.0 * lines)
    without = found(one).without
    assert without > SETTINGS.comparison.size_limit**2
    settings = replace(SETTINGS, comparison=replace(SETTINGS.comparison, size_limit=1.1 * without**0.5))
    one.builder = one.builder.against(replace(one.builder.target, settings=settings))
    assert found(one) is None


@pytest.mark.check
def test_a_place_is_less_sure_where_what_is_left_is_worth_fewer_numbers(lab, monkeypatch):
    one = scene(lab, lambda lines: 3e4 + 200.0 * lines)
    sure = found(one).std
    monkeypatch.setattr("torchplate.diagnosis.field.one_force.worth", lambda target, _: worth(target, _) / 100)
    assert max(found(one).std) > 5 * max(sure)


@pytest.mark.check
def test_a_law_that_differs_from_hit_to_hit_shows_in_the_fitted_frfs(lab):
    """By 0.2 % of what pulls there: the FRF put aside alone would not tell."""
    force = found(scene(lab, lambda lines: 3e4 + 200.0 * lines + cord(lines), differ=2e-3, reference=[9, 21, 1, 19]))
    assert force is not None
    assert not force.alike


def test_of_one_hit_nobody_says_that_it_is_linear(lab):
    force = found(scene(lab, cord, reference=[9]))
    assert force is not None
    assert not force.alike


@pytest.mark.check
def test_a_mass_on_a_spring_to_the_ground_is_left_to_the_catalogue(lab):
    scene_of_mass = scene(lab, lambda lines: 3e4 - 0.05 * (2 * torch.pi * lines) ** 2, differ=0.0)
    assert found(scene_of_mass) is None


def test_one_response_says_nothing_of_the_force_of_a_hit(lab):
    """Each hit is a record of its own then: whatever force there was, it explains it."""
    one = scene(lab, lambda lines: 3e4 + 0.0 * lines)
    one.builder = one.builder.against(one.builder.target.holding_out(torch.tensor([[False] * 2] + [[True] * 2] * 3)))
    one.apart = torch.tensor([[True, False]] + [[False] * 2] * 3)
    assert found(one) is None


@pytest.mark.parametrize("alike", [True, False])
@torch.no_grad()
def test_what_is_left_has_nothing_of_a_force_at_that_place(lab, alike):
    """Variable projection: any force there changes nothing of what is left."""
    one = scene(lab, lambda lines: 3e4 + 0.0 * lines)
    model = ForcedModel(one.builder, one.fit, {}, one.builder.target.fitted, alike)
    place = torch.tensor([PLACE], dtype=torch.float64)
    seen = model.at(one.fit.theta, place)
    pushed = seen._replace(off=seen.off + seen.reach[0] * (0.3 - 2j))
    fitted = one.builder.target.fitted
    assert torch.allclose(pushed.left(fitted), seen.left(fitted), atol=1e-8 * float(pushed.off.abs().max()))


@pytest.mark.check
def test_it_is_told_as_what_it_is_and_costs_no_fields(lab):
    one = scene(lab, lambda lines: 3e4 + 200.0 * lines)
    said: list[str] = []
    force = force_alone(one.builder, one.fit, {}, said.append)
    inferred = infer_field(one.builder, one.fit, {}, said.append, force)
    field = inferred.found
    assert (field.kind, field.form, field.unit) == ("support", ONE_FORCE, "N/N")
    assert not any("nodes" in line for line in said)
    assert "Something is attached at x 0.3" in field.sentences[0]
    assert "a contact that rattles" in field.sentences[1]
    assert field.gap_after < 0.1 * field.gap_before
    assert field.to_dict()["probability"] == {"support": 1.0}
    assert len(field.values) == field.n_x * field.n_y
    # The model that is written has the numbers beside it, and no field.
    assert not inferred.model.names
    assert inferred.model.known_values["plate.youngs_modulus"] == pytest.approx(2.05e11, rel=2e-3)
    assert "field" not in inferred.model.effects


@pytest.mark.check
@pytest.mark.proof
def test_what_a_force_accounts_for_is_not_named(lab):
    """A spring to the ground was named, whatever was left beside it."""
    one = scene(lab, lambda lines: 3e4 + 200.0 * lines, refine=8)
    target = one.builder.target
    answer = diagnose(one.builder.given, target.measurement, imperfections=target.imperfections)
    assert answer.verdict == "unexplained"
    assert not {effect.name for effect in answer.effects} - {"mesh_discretisation"}
    assert answer.field.form == ONE_FORCE
    assert answer.field.place == pytest.approx(PLACE, abs=5e-3)
    assert answer.field.gap_after < 0.1 * answer.field.gap_before


def attached(one: SimpleNamespace, force) -> tuple[State, Ranked] | None:
    """What the catalogue has at the place of a force; the mesh is that of the truth, and none is finer."""
    selection = ForwardSelection(one.builder, {}, lambda _: None)
    selection.begun = State(one.builder.given, one.fit)
    selection.settling.ended = lambda state, _: state
    with torch.no_grad():
        return selection.attached([Ranked((), ())], force.theta, force.place, force.law)


@pytest.mark.check
def test_an_absorber_at_the_place_of_a_force_is_named(lab):
    one = scene(lab, absorber, differ=0.0)
    state, _ = attached(one, found(one))
    assert [naming.hypothesis.name for naming in state.named] == ["absorber"]
    own = state.named[0].hypothesis.own
    assert (own["x"], own["y"]) == pytest.approx(PLACE, abs=2e-3)
    assert own["mass"] == pytest.approx(0.012, rel=0.02)
    assert own["viscous_damping"] == pytest.approx(0.5, rel=0.05)
    assert state.fit.reduced_misfit < SETTINGS.comparison.noise_limit


@pytest.mark.check
@pytest.mark.parametrize(("mass", "hertz", "damping"), [(0.003, 240.0, 0.05), (0.1, 60.0, 0.2)])
def test_how_a_force_pulls_says_which_absorber_it_is(lab, mass, hertz, damping):
    one = scene(lab, lambda lines: absorber(lines, mass, hertz, damping), differ=0.0)
    state, _ = attached(one, found(one))
    own = state.named[0].hypothesis.own
    assert own["mass"] == pytest.approx(mass, rel=0.05)
    assert (own["stiffness"] / own["mass"]) ** 0.5 / (2 * torch.pi) == pytest.approx(hertz, rel=0.01)
    assert state.fit.reduced_misfit < SETTINGS.comparison.noise_limit


@torch.no_grad()
def test_the_law_of_a_force_is_that_of_what_pulls(lab):
    """Beside the true plate, y = −D / (1 + D α); and D alone is off by nothing but noise."""
    one = scene(lab, absorber, differ=0.0)
    true = one.fit.model.space.low.new_tensor([2.05e11, 1e-2])
    model = ForcedModel(one.builder, one.fit, {}, one.builder.target.fitted, alike=True)
    law = model.law(true, torch.tensor(PLACE, dtype=torch.float64))
    stiffness = absorber(law.laplace.imag / (2 * torch.pi))
    off = law.off(stiffness)
    assert off.shape == (2 * len(law.laplace),)
    assert float(off.square().mean()) == pytest.approx(1.0, abs=0.3)
    assert float(law.off(1.1 * stiffness).square().mean()) > 3
    assert float(law.off(0 * stiffness).square().mean()) > 100


@pytest.mark.check
def test_a_cord_at_that_place_is_none_of_the_catalogue(lab):
    one = scene(lab, cord, differ=0.0)
    assert attached(one, found(one)) is None


@pytest.mark.check
def test_a_diagnosis_asks_the_catalogue_at_the_place_of_a_force(lab, monkeypatch):
    """However little an absorber promised where nobody knew its place."""

    def nothing_found(self: ForwardSelection, state: State, _: int) -> tuple[State, list[Ranked]]:
        self.begun = state
        return state, [Ranked((), ())]

    monkeypatch.setattr(ForwardSelection, "add_effects", nothing_found)
    one = scene(lab, absorber, differ=0.0, refine=8)
    target = one.builder.target
    answer = diagnose(one.builder.given, target.measurement, imperfections=target.imperfections)
    assert answer.verdict == "explained"
    assert answer.field is None
    assert {effect.name for effect in answer.effects} - {"mesh_discretisation"} == {"absorber"}
