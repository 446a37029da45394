"""A hypothesis over all its values, held against sums over a grid of the whole box."""

import dataclasses
import functools
import math
import weakref

import pytest
import torch

from torchplate.diagnosis.table import refit
from torchplate.diagnosis.table.comparison import Comparing, Weighed
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.hypotheses import Fitted, single, tried, visible
from torchplate.diagnosis.table.plates import Plates
from torchplate.diagnosis.table.refit import Problem
from torchplate.diagnosis.table.settings import SETTINGS
from torchplate.diagnosis.table.whole_box import over_the_box, sample
from torchplate.diagnosis.usual import Usual
from torchplate.effects import CATALOGUE
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

NUMBERS = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003}
NOBODY = torch.zeros(0, dtype=torch.float64)
# Three standard errors of −2 ln Z from so many effective draws.
NEAR = 3 * 2 / math.sqrt(SETTINGS.drawing.n_effective)


def plate(
    mass: float | None = None, young: Searched | float = 2.1e11, grain: tuple[float, float] | None = None
) -> PlateModel:
    effects, known = {"plate": CATALOGUE["plate"]()}, dict(NUMBERS)
    if mass is not None:
        effects["hidden"] = CATALOGUE["point_mass"]()
        known |= {"hidden.x": 0.21, "hidden.y": 0.34, "hidden.mass": mass}
    if grain is not None:
        effects["hidden"] = CATALOGUE["orthotropy"]()
        known |= {"hidden.young_ratio": grain[0], "hidden.shear_factor": grain[1]}
    searched = {"plate.youngs_modulus": young} if isinstance(young, Searched) else {}
    known |= {} if searched else {"plate.youngs_modulus": young}
    return PlateModel(Mesh(0.55, 0.363, 8, 8), effects, known, searched)


def six_frequencies(mass: float, scatter: float) -> TableEvidence:
    truth = plate(mass).natural_frequencies(NOBODY, 9)[3:]
    noise = torch.randn(6, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    table = NaturalFrequencies(torch.arange(4, 10), truth * (1 + scatter * noise), scatter * truth)
    return TableEvidence.of(table, SETTINGS)


@functools.cache
def weighed(mass: float, scatter: float, prior: bool = False) -> tuple[Weighed, Problem]:
    """A mass beside a free plate, refitted to six frequencies that scatter; E known, or to 1 % beforehand."""
    evidence = six_frequencies(mass, scatter)
    model = plate(young=Searched(1.9e11, 2.3e11)) if prior else plate()
    told = {"plate.youngs_modulus": (2.1e11, 2.1e9)} if prior else {}
    plates = Plates(model, evidence, "given", SETTINGS, 1)
    bench = Comparing(plates, told, SETTINGS, lambda _: None)
    baseline, fitted = bench.baseline()
    assert isinstance(fitted, Fitted)
    candidate = next(one for one in visible(plates, baseline.theta) if one.name == "point_mass")
    part = tried(plates, fitted, 0, candidate, SETTINGS)
    found = bench.rebuilt(bench.refitted(single(fitted, part, SETTINGS)))
    return found, Problem(plates.reduced(found.model, found.modes), evidence, told, SETTINGS)


@functools.cache
def grid(mass: float, scatter: float, n: int = 40) -> tuple[torch.Tensor, torch.Tensor]:
    """The middles of n cells along each parameter, and the cost of each, no mirror image taken for another."""
    problem = weighed(mass, scatter)[1]
    axis = (torch.arange(n, dtype=torch.float64) + 0.5) / n
    places = torch.cartesian_prod(*(axis for _ in range(problem.natural.n_parameter)))
    return places, torch.cat([problem.cost(some) for some in places.split(4096)])


@pytest.mark.parametrize(("mass", "scatter"), [pytest.param(0.02, 4e-3, marks=pytest.mark.check), (0.15, 4e-3)])
@pytest.mark.check
def test_a_mass_counts_for_what_its_likelihood_holds_over_the_whole_plate(mass, scatter):
    """20 g that hardly show may be anywhere; 150 g are on a bent valley of place and size, four times over."""
    with torch.no_grad():
        one, problem = weighed(mass, scatter)
        _, cost = grid(mass, scatter)
        found = over_the_box(problem, one.minima)
    assert found.n_effective >= SETTINGS.drawing.n_effective
    whole = -2 * float((-0.5 * cost).logsumexp(0) - math.log(len(cost)))
    assert found.evidence == pytest.approx(whole, abs=NEAR)


@pytest.mark.check
def test_of_a_prior_with_a_narrow_half_laplace_and_the_whole_box_say_the_same():
    """Half of all plates are of metal, whose directions differ little: that makes a small difference more probable."""
    truth = plate(grain=(0.93, 1.04)).natural_frequencies(NOBODY, 11)[3:]
    evidence = TableEvidence.of(NaturalFrequencies(torch.arange(4, 12), truth, 2e-3 * truth), SETTINGS)
    plates = Plates(plate(), evidence, "given", SETTINGS, 1)
    bench = Comparing(plates, {}, SETTINGS, lambda _: None)
    with torch.no_grad():
        baseline, fitted = bench.baseline()
        candidate = next(one for one in visible(plates, baseline.theta) if one.name == "orthotropy")
        part = tried(plates, fitted, 0, candidate, SETTINGS)
        found = bench.rebuilt(bench.refitted(single(fitted, part, SETTINGS)))
        whole = bench.integrated(found)
        plain = dataclasses.replace(bench._problem(found.model, found.modes, found.hypothesis), usual=Usual())
        without = plain.minima(found.best.position[None])
    assert dict(zip(found.model.names, found.theta.tolist(), strict=True)) == pytest.approx(
        {"orthotropy_1.young_ratio": 0.93, "orthotropy_1.shear_factor": 1.04}, rel=1e-3
    )
    assert found.evidence == pytest.approx(whole.evidence, abs=NEAR)
    assert found.evidence < without[0].evidence - 6


@pytest.mark.check
def test_a_sample_of_the_posterior_has_its_quantiles():
    with torch.no_grad():
        one, problem = weighed(0.15, 4e-3)
        places, cost = grid(0.15, 4e-3)
        drawn = sample(over_the_box(problem, one.minima), 4000)
    weight = (-0.5 * cost).softmax(0)
    for k, name in enumerate(one.model.names):
        order = places[:, k].argsort()
        below = weight[order].cumsum(0)
        for level in (0.05, 0.5, 0.95):
            end = float(places[order][int((below >= level).nonzero()[0]), k])
            share = float((drawn[:, k] <= end + 0.5 / 40).double().mean())
            cell = float(weight[(places[:, k] - end).abs() < 1e-9].sum())
            # As far as a quantile of so many effective draws goes, and a cell of the grid.
            assert share == pytest.approx(level, abs=cell + 3 * 0.5 / math.sqrt(SETTINGS.drawing.n_effective)), name


@pytest.mark.check
def test_what_is_known_beforehand_is_a_density_on_the_box():
    """Over E alone the prior holds 1: with a table that says nothing, Z is the likelihood itself."""
    with torch.no_grad():
        one, problem = weighed(0.15, 4e-3, prior=True)
        deaf = dataclasses.replace(
            problem, evidence=dataclasses.replace(problem.evidence, std=torch.full((6,), 1e9).double())
        )
        places = (
            torch.rand(1, len(one.model.names), generator=torch.Generator().manual_seed(0)).double().repeat(4001, 1)
        )
        places[:, one.model.names.index("plate.youngs_modulus")] = torch.linspace(0, 1, 4001).double()
        density = (-0.5 * (deaf.cost(places) - deaf.evidence.minus_two_log_likelihood(0.0))).exp()
    assert float(torch.trapezoid(density, dx=1 / 4000)) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(("times", "turns"), [(0.5, 1), (2.0, 2)])
def test_a_refit_that_is_hopeless_after_its_first_steps_is_not_followed(monkeypatch, times, turns):
    """It is where the best start leaves more than was allowed; else the best starts go on."""
    with torch.no_grad():
        one, problem = weighed(0.15, 4e-3)
        starts = torch.rand(4, len(one.model.names), generator=torch.Generator().manual_seed(0)).double()
        least = min(float(end.chi_square) for end in problem.minima(starts, SETTINGS.n_first))
        went, descended = [], refit._descended
        monkeypatch.setattr(refit, "_descended", lambda *told: went.append(told[-1]) or descended(*told))
        problem.minima(starts, hopeless=times * least)
    assert went == [SETTINGS.n_first, SETTINGS.n_iteration][:turns]


@torch.no_grad()
@pytest.mark.check
def test_no_basis_of_a_hypothesis_is_kept_beside_what_was_found(monkeypatch, collect):
    """A basis is as large as all elements in it, where these differ: those of all hypotheses were gigabytes."""
    made: list[weakref.ref] = []
    alive: list[int] = []
    reduced = Plates.reduced

    def counted(self: Plates, *given):
        collect()
        alive.append(sum(one() is not None for one in made))
        found = reduced(self, *given)
        made.append(weakref.ref(found))
        return found

    plates = Plates(plate(), six_frequencies(0.15, 4e-3), "given", SETTINGS, 1)
    bench = Comparing(plates, {}, SETTINGS, lambda _: None)
    baseline, fitted = bench.baseline()
    some = [one for one in visible(plates, baseline.theta) if one.name in ("point_mass", "thickness_taper")]
    monkeypatch.setattr(Plates, "reduced", counted)
    parts = [tried(plates, fitted, k, one, SETTINGS) for k, one in enumerate(some)]
    found = [bench.refitted(single(fitted, one, SETTINGS)) for one in parts]
    found += [bench.integrated(bench.rebuilt(one)) for one in found]
    collect()
    assert len(made) >= 4 * len(parts) >= 8
    # Beside the one that is made at most the one of the same candidate before its far members joined.
    assert max(alive) <= 1
    assert all(one() is None for one in made)
    assert all(math.isfinite(one.evidence) for one in found)
