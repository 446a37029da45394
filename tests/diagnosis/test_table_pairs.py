"""Tables: long patches and their mesh error, pairs far from the given model, and slopes that lean the other way."""

import dataclasses

import pytest
import torch

from torchplate.diagnosis.integral import Integral
from torchplate.diagnosis.table import comparison, diagnose_table
from torchplate.diagnosis.table.comparison import Comparing, Comparison, Weighed
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.found import Found
from torchplate.diagnosis.table.hypotheses import Hypothesis, is_simpler, single, tried, visible
from torchplate.diagnosis.table.plates import MeshKind, Plates
from torchplate.diagnosis.table.posterior import Entry, Posterior
from torchplate.diagnosis.table.refit import Problem
from torchplate.diagnosis.table.settings import SETTINGS
from torchplate.diagnosis.table.summary import _estimates
from torchplate.effects import CATALOGUE
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel, Searched
from torchplate.model.discretisation.fine_mesh import SparseModel
from torchplate.plate import Mesh

NUMBERS = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003}
YOUNG = {"plate.youngs_modulus": Searched(1.8e11, 2.4e11)}
NOBODY = torch.zeros(0, dtype=torch.float64)
LONG = ("stiffness_loss", {}, {"x": 0.68, "y": 0.37, "size": 0.3, "factor": 0.35, "aspect": 2.2})
TAPER = ("thickness_taper", {}, {"slope_x": -0.22, "slope_y": 0.1})
EDGE = ("edge_spring", {"edge": "x0"}, {"stiffness": 7e5, "rotational_stiffness": 400.0})
Hidden = tuple[str, dict[str, str], dict[str, float]]


def plate(refine: int, *hidden: Hidden, searched: bool = False) -> PlateModel:
    effects, known = {"plate": CATALOGUE["plate"]()}, dict(NUMBERS)
    for k, (name, chosen, values) in enumerate(hidden):
        effects[f"hidden {k}"] = CATALOGUE[name](**chosen)
        known |= {f"hidden {k}.{key}": value for key, value in values.items()}
    known |= {} if searched else {"plate.youngs_modulus": 2.1e11}
    return PlateModel(Mesh(0.55, 0.363, 10, 10, refine), effects, known, YOUNG if searched else {})


def bench(kind: MeshKind, refine: int, scatter: float, *hidden: Hidden, n: int = 14) -> Comparing:
    """What is compared on one mesh, of frequencies that hold no scatter themselves."""
    with torch.no_grad():
        truth = SparseModel(plate(refine, *hidden), NOBODY).modes(n + 3).frequency[3 : n + 3]
    table = NaturalFrequencies(torch.arange(4, n + 4), truth, scatter * truth)
    plates = Plates(plate(1, searched=True), TableEvidence.of(table, SETTINGS), kind, SETTINGS, 100)
    return Comparing(plates, {}, SETTINGS, lambda _: None)


def alone(comparing: Comparing, name: str) -> Weighed:
    """One effect, refitted from its starts."""
    baseline, fitted = comparing.baseline()
    candidate = next(one for one in visible(comparing.plates, baseline.theta) if one.name == name)
    return comparing.refitted(single(fitted, tried(comparing.plates, fitted, 0, candidate, SETTINGS), SETTINGS))


@torch.no_grad()
@pytest.mark.check
def test_a_table_finds_how_long_a_patch_is():
    """Square ones leave several times the scatter of a patch that is twice as long as wide."""
    comparing = bench("given", 1, 3e-4, LONG)
    found = comparing.rebuilt(alone(comparing, "stiffness_loss"))
    values = dict(zip(found.model.names, found.theta.tolist(), strict=True))
    assert found.best.chi_square < 1.0
    assert values["stiffness_loss_1.aspect"] == pytest.approx(2.2, rel=0.1)


@torch.no_grad()
@pytest.mark.check
def test_the_mesh_error_of_a_patch_is_taken_off_where_it_was_found():
    """Of the even plate it is another: what stays of it is a tenth of a per cent, several times this scatter."""
    comparing = bench("corrected", 6, 2e-4, LONG)
    first = alone(comparing, "stiffness_loss")
    found = comparing.rebuilt(first)
    limit = comparing.plates.evidence.limit(found.best.n_effective, SETTINGS.level)
    assert found.best.chi_square < limit < first.best.chi_square


@pytest.mark.check
@torch.no_grad()
def test_a_pair_begins_where_one_of_it_has_ended(monkeypatch):
    """A held edge moves every mode: changes beside the given model, added, lead to no taper beside it."""
    comparing = bench("given", 1, 5e-4, TAPER, EDGE)
    every = comparison.visible

    def two(plates: Plates, theta: torch.Tensor):
        return [one for one in every(plates, theta) if one.name == "thickness_taper" or one.options == {"edge": "x0"}]

    monkeypatch.setattr(comparison, "visible", two)
    found: Comparison = comparing.with_pairs(comparing.singles(*comparing.baseline()))
    best = min(found.weighed, key=lambda one: one.best.chi_square)
    assert set(best.names) == {"thickness_taper", "edge_spring"}
    assert best.best.chi_square < comparing.plates.evidence.limit(best.best.n_effective, SETTINGS.level)


def named(comparing: Comparing, monkeypatch: pytest.MonkeyPatch, *effects: str) -> tuple[Comparison, Entry]:
    """Some effects and their pairs weighed on one mesh, and the hypothesis to name."""
    every = comparison.visible

    def some(plates: Plates, theta: torch.Tensor):
        return [one for one in every(plates, theta) if one.name in effects and one.options in ({}, {"edge": "x0"})]

    monkeypatch.setattr(comparison, "visible", some)
    found = comparing.with_pairs(comparing.singles(*comparing.baseline()))
    return found, Posterior.of([found], SETTINGS).best()


@pytest.mark.check
@torch.no_grad()
@pytest.mark.parametrize("others", [(), (EDGE,)], ids=["alone", "beside an edge"])
def test_an_absorber_that_stays_with_the_plate_is_a_mass(monkeypatch, others):
    """It is refitted where the absorber has ended, and counts; the absorber takes no more than chance beyond it."""
    comparing = bench("given", 1, 5e-4, ("point_mass", {}, {"x": 0.1, "y": 0.91, "mass": 0.08}), *others)
    found, best = named(comparing, monkeypatch, "point_mass", "absorber", *(name for name, *_ in others))
    assert sorted(best.names) == sorted(["point_mass", *(name for name, *_ in others)])
    alike = [one for one in found.weighed if "absorber" in one.names and len(one.names) == len(best.names)]
    assert alike
    assert not [one for one in found.counted(SETTINGS.level) if one in alike and "point_mass" not in one.names]


@pytest.mark.check
@torch.no_grad()
def test_a_tuned_absorber_is_no_mass(monkeypatch):
    """Its resonance lies in the band, below it a mass and above it a spring."""
    values = {"x": 0.2, "y": 0.8, "mass": 0.2, "stiffness": 2e5, "viscous_damping": 1.0}
    found, best = named(bench("given", 1, 5e-4, ("absorber", {}, values)), monkeypatch, "point_mass", "absorber")
    assert "absorber" in best.names
    assert any(one.names == ("absorber",) for one in found.counted(SETTINGS.level))


@pytest.mark.check
@torch.no_grad()
def test_a_mass_that_ended_elsewhere_is_found_where_an_absorber_has_ended():
    comparing = bench("given", 1, 5e-4, ("point_mass", {}, {"x": 0.1, "y": 0.91, "mass": 0.08}))
    baseline, fitted = comparing.baseline()
    seen = {one.name: one for one in visible(comparing.plates, baseline.theta)}
    mass, absorber = (
        single(fitted, tried(comparing.plates, fitted, k, seen[name], SETTINGS), SETTINGS)
        for k, name in enumerate(("point_mass", "absorber"))
    )
    # In the middle of the plate the way to the corner is not down.
    far = torch.tensor([[0.5, 0.5, 0.9, *mass.starts[0, 3:].tolist()]], dtype=torch.float64)
    mass = dataclasses.replace(mass, starts=far)
    assert comparing.refitted(mass).best.chi_square > 1e3
    every = comparing._with_simpler([comparing.refitted(absorber)], [mass, absorber], 1e9)
    found = next(one for one in every if one.names == ("point_mass",))
    assert found.best.chi_square < 1.0


@torch.no_grad()
def test_what_a_hypothesis_becomes_begins_where_that_has_ended():
    """Of two absorbers one becomes a mass: it sits where that one sat, and the other stays where it was."""
    comparing = bench("given", 1, 1e-3, ("point_mass", {}, {"x": 0.23, "y": 0.31, "mass": 0.15}))
    baseline, fitted = comparing.baseline()
    both = [one for one in visible(comparing.plates, baseline.theta) if one.name in ("point_mass", "absorber")]
    parts = [tried(comparing.plates, fitted, k, one, SETTINGS) for k, one in enumerate(both)]
    mass, absorber = sorted(parts, key=lambda one: one.name, reverse=True)
    nobody = torch.zeros(1, 0, dtype=torch.float64)
    larger, simpler = Hypothesis((absorber, absorber), nobody, 0.0), Hypothesis((mass, absorber), nobody, 0.0)
    assert is_simpler(simpler, larger)
    assert not is_simpler(larger, simpler)
    model = comparing.plates.with_effects([one.candidate for one in larger.parts], larger.labels)
    position = torch.linspace(0.1, 0.9, len(model.names), dtype=torch.float64)
    n = len(position)
    at = {"position": position, "precision": torch.eye(n).double(), "at_bound": torch.zeros(n).bool()}
    end = dataclasses.replace(baseline.best, **at, images=position[None])
    ended = Weighed(larger, model, (end,), 0.0)
    small = comparing.plates.with_effects([one.candidate for one in simpler.parts], simpler.labels)
    start = comparison._at_the_end(simpler, small, larger, ended)
    values = small.as_dict(small.space.to_si(start))
    there = model.as_dict(ended.theta)
    assert values["plate.youngs_modulus"] == pytest.approx(there["plate.youngs_modulus"])
    for key in ("x", "y", "mass"):
        assert values[f"absorber_1.{key}"] == pytest.approx(there[f"absorber_1.{key}"])
        assert values[f"point_mass_1.{key}"] == pytest.approx(there[f"absorber_2.{key}"])


@pytest.mark.check
@torch.no_grad()
def test_a_taper_that_leans_the_other_way_is_the_same_plate_turned_over():
    comparing = bench("given", 1, 1e-3, TAPER)
    found = comparing.rebuilt(alone(comparing, "thickness_taper"))
    names = found.model.names
    slopes = found.model.space.to_si(found.best.images)[:, [names.index(f"thickness_taper_1.slope_{k}") for k in "xy"]]
    assert {tuple(row) for row in slopes.sign().tolist()} == {(1, 1), (1, -1), (-1, 1), (-1, -1)}


@torch.no_grad()
def test_on_a_square_a_patch_that_is_long_along_x_is_one_that_is_long_along_y():
    mesh = Mesh(0.4, 0.4, 6, 6)
    known = NUMBERS | {"plate.youngs_modulus": 2.1e11}
    searched = {f"patch.{key}": Searched(0.1, 0.9) for key in ("x", "y", "size", "factor")}
    searched["patch.aspect"] = Searched(1 / 3, 3.0, logarithmic=True)
    effects = {"plate": CATALOGUE["plate"](), "patch": CATALOGUE["stiffness_loss"]()}
    plates = Plates(
        PlateModel(mesh, effects, known, searched),
        TableEvidence.of(NaturalFrequencies(torch.arange(4, 10), 10.0 * torch.arange(4, 10).double()), SETTINGS),
        "given",
        SETTINGS,
        1,
    )
    plates.at(plates.model.space.to_si(torch.full((5,), 0.5, dtype=torch.float64)))
    problem = Problem(plates.reduced(plates.model), plates.evidence, {}, SETTINGS)
    place = torch.tensor([0.3, 0.6, 0.35, 0.4, 0.8], dtype=torch.float64)
    every = torch.stack([place, *problem.turned(place)])
    exact = torch.stack([plates.exactly(plates.model, plates.model.space.to_si(one)) for one in every])
    assert len(every) == 8
    assert exact == pytest.approx(exact[:1].expand_as(exact), rel=1e-8)


@pytest.mark.check
@torch.no_grad()
@pytest.mark.parametrize("on", [0.0, 1.0])
def test_an_interval_begins_at_the_bound_that_its_number_sits_on(on):
    """Of draws spread evenly over the box nine tenths are from there on; the number is in its own interval."""
    comparing = bench("given", 1, 1e-3, TAPER)
    baseline, fitted = comparing.baseline()
    compared = Comparison(comparing.plates, baseline, fitted, (), (), (), 0)
    taper, n = alone(comparing, "thickness_taper"), 1001
    names, best = taper.model.names, taper.best
    slope = names.index("thickness_taper_1.slope_x")
    places = torch.full((n, len(names)), 0.5, dtype=torch.float64)
    places[:, slope] = torch.linspace(0, 1, n).double()
    position, at_bound = best.position.clone(), torch.zeros_like(best.at_bound)
    position[slope], at_bound[slope] = on, True
    there = dataclasses.replace(best, position=position, at_bound=at_bound)
    drawn = Integral(0.0, 50.0, places, torch.full((n,), 1 / n).double())
    one = dataclasses.replace(taper, minima=(there,), drawn=drawn)
    entry = Entry(compared, one, 1.0)
    found = _estimates(Found((compared,), Posterior((entry,), SETTINGS), {}, SETTINGS), entry)[names[slope]]
    assert found.low <= found.value <= found.high
    low, high = (float(end[slope]) for end in (one.model.space.low, one.model.space.high))
    expected = (low, low + 0.9 * (high - low)) if on == 0.0 else (high - 0.9 * (high - low), high)
    # Three standard deviations of that quantile of so many draws.
    by_chance = 3 * (0.9 * 0.1 / SETTINGS.n_draw) ** 0.5
    assert (found.low, found.high) == pytest.approx(expected, abs=by_chance * (high - low))


@torch.no_grad()
@pytest.mark.check
def test_intervals_are_those_of_all_hypotheses_that_have_what_is_named():
    """What is less probable says another number, with its part of the draws; what has another effect says none."""
    comparing = bench("given", 1, 1e-3, TAPER)
    baseline, fitted = comparing.baseline()
    compared = Comparison(comparing.plates, baseline, fitted, (), (), (), 0)

    def at(one: Weighed, value: float) -> Weighed:
        places = torch.full((50, len(one.model.names)), value, dtype=torch.float64)
        return dataclasses.replace(one, drawn=Integral(0.0, 50.0, places, torch.full((50,), 0.02).double()))

    taper = alone(comparing, "thickness_taper")
    entries = [
        Entry(compared, at(taper, 0.3), 0.6),
        Entry(compared, at(taper, 0.7), 0.2),
        Entry(compared, at(alone(comparing, "point_mass"), 0.1), 0.15),
        Entry(compared, at(baseline, 0.9), 0.05),
    ]
    found = Found((compared,), Posterior(tuple(entries), SETTINGS), {}, SETTINGS)
    slope = _estimates(found, entries[0])["thickness_taper_1.slope_x"]
    assert (slope.low, slope.high) == pytest.approx((-0.12, 0.12))
    young = _estimates(found, entries[3])["plate.youngs_modulus"]
    assert (young.low, young.high) == pytest.approx((2.34e11, 2.34e11))


@torch.no_grad()
@pytest.mark.check
def test_on_the_second_mesh_refits_begin_where_those_on_the_first_have_ended(monkeypatch):
    comparing = bench("given", 1, 1e-3, ("point_mass", {}, {"x": 0.23, "y": 0.31, "mass": 0.15}))
    table = comparing.plates.evidence
    begun: dict[tuple[str, ...], list[int]] = {}
    every, minima = comparison.visible, Problem.minima

    def counted(self: Problem, starts: torch.Tensor, n_iteration: int | None = None, *more, **told):
        if n_iteration is None and len(self.natural.model.names) > 1:
            begun.setdefault(self.natural.model.names, []).append(len(starts))
        return minima(self, starts, n_iteration, *more, **told)

    monkeypatch.setattr(Problem, "minima", counted)
    monkeypatch.setattr(comparison, "visible", lambda *told: [one for one in every(*told) if one.name == "point_mass"])
    found = diagnose_table(
        plate(1, searched=True), NaturalFrequencies(table.mode + 1, table.frequency, table.scatter), tolerance={}
    )
    assert [one.name for one in found.effects] == ["point_mass"]
    (counted_alone,) = (counts for names, counts in begun.items() if "point_mass_2.x" not in names)
    first, second = counted_alone
    assert first == SETTINGS.n_start
    assert second <= SETTINGS.n_onward + 1


@torch.no_grad()
@pytest.mark.check
def test_a_mirror_image_that_is_the_same_plate_but_for_its_wires_is_tried_too():
    """Wires near two sides of a square tell along from across; a refit that ends in the one finds the other."""
    mesh = Mesh(0.4, 0.4, 8, 8)
    known = NUMBERS | {"plate.youngs_modulus": 2.1e11, "wires.stiffness": 5e3, "wires.viscous_damping": 0.0}
    searched = {f"patch.{key}": Searched(0.1, 0.9) for key in ("x", "y", "size", "factor")}
    searched["patch.aspect"] = Searched(1 / 3, 3.0, logarithmic=True)
    wires = CATALOGUE["support_spring"](nodes=[2, 8, 74, 80])
    effects = {"plate": CATALOGUE["plate"](), "wires": wires, "patch": CATALOGUE["stiffness_loss"]()}
    model = PlateModel(mesh, effects, known, searched)
    place = torch.tensor([0.3, 0.6, 0.35, 0.4, 0.8], dtype=torch.float64)
    truth = model.natural_frequencies(model.space.to_si(place), 15)[3:]
    table = NaturalFrequencies(torch.arange(4, 16), truth, 1e-3 * truth)
    plates = Plates(model, TableEvidence.of(table, SETTINGS), "given", SETTINGS, 1)
    plates.at(model.space.to_si(place))
    problem = Problem(plates.reduced(model), plates.evidence, {}, SETTINGS)
    across = next(one for one in problem.turned(place) if one[:2].tolist() == [0.6, 0.3])
    minima = problem.minima(across[None])
    assert minima[0].chi_square < 1e-3
    assert minima[0].position.tolist() == pytest.approx(place.tolist(), abs=0.02)
