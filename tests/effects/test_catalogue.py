"""What holds for every effect of the catalogue, present and future."""

import math

import pytest
import torch
from tests.effects.conftest import BARE, REFERENCE, RESPONSE, WIRES

from torchplate.effects import (
    CATALOGUE,
    Effect,
    HystereticDamping,
    Interval,
    Orthotropy,
    Parameter,
    Plate,
    Prior,
    SupportSpring,
    find_effect,
    options,
)
from torchplate.effects.parameter import PLATE_SCALE
from torchplate.model import PlateModel, Searched, reduce
from torchplate.plate import Mesh

MESHES = {"rectangle": Mesh(0.52, 0.37, 5, 4), "square": Mesh(0.43, 0.43, 5, 5, edges={"x0": "simply_supported"})}
PLATE = ("plate.youngs_modulus", "plate.density")
LINES = torch.linspace(20.0, 420.0, 61, dtype=torch.float64)
THETA = torch.zeros(0, dtype=torch.float64)


@pytest.fixture(params=["rectangle", pytest.param("square", marks=pytest.mark.check)])
def mesh(request: pytest.FixtureRequest) -> Mesh:
    return MESHES[request.param]


def _model(
    effect: type[Effect],
    fixed: dict,
    value: dict[str, float],
    searched: dict | None = None,
    mesh: Mesh = MESHES["rectangle"],
    also: dict[str, tuple[float, float]] | None = None,
) -> PlateModel:
    """A slightly damped plate on two wires with the effect added, or with the plate itself replaced."""
    label = "plate" if effect is Plate else "added"
    effects = {"plate": Plate(), "wires": SupportSpring(at=WIRES), "loss": HystereticDamping(), "grain": Orthotropy()}
    effects |= {label: effect(**fixed)}
    known = BARE | {f"{label}.{name}": number for name, number in value.items()}
    intervals = {f"{label}.{name}": interval for name, interval in (searched or {}).items()}
    intervals |= {name: Searched(*ends) for name, ends in (also or {}).items()}
    known = {key: known[key] for key in known if key not in intervals}
    return PlateModel(mesh, effects, known, intervals, RESPONSE, REFERENCE, "accelerance")


def _searched(effect: type[Effect], example, width: float = 0.2) -> dict[str, Searched]:
    """Intervals about the example, where they make sense."""
    parameters = effect(**example.options).parameters
    ends = {
        name: (number - width * abs(number), number + width * abs(number)) for name, number in example.value.items()
    }
    return {
        name: Searched(*pair) for name, pair in ends.items() if all(end in parameters[name].allowed for end in pair)
    }


def _members(model: PlateModel, *batch: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(7)
    return model.space.to_si(torch.rand(*batch, len(model.names), dtype=torch.float64, generator=generator))


def _distance(first: torch.Tensor, second: torch.Tensor) -> float:
    return float((first - second).norm() / second.norm())


def _bare(mesh: Mesh) -> torch.Tensor:
    return _model(Plate, {}, {}, mesh=mesh).frf(THETA, LINES)


def test_neutral_value_leaves_the_model_as_it_was(effect, example, mesh):
    parameters = effect(**example.options).parameters
    neutral = {name: p.neutral for name, p in parameters.items() if p.neutral is not None}
    if not neutral:
        pytest.skip("it has no neutral value: every parameter must be given, or it has none")
    given = {name: number for name, number in example.value.items() if name not in neutral}
    # A parameter without a neutral value (a stiffness that must be given) is switched off instead.
    off = {name: 0.0 for name in given if parameters[name].unit in ("N/m", "kg")}
    model = _model(effect, example.options, given | off | neutral, mesh=mesh)
    assert _distance(model.frf(THETA, LINES), _bare(mesh)) < 1e-9  # rounding of two eigenproblems


def test_the_example_is_seen_in_the_frf(effect, example, mesh):
    model = _model(effect, example.options, example.value, mesh=mesh)
    assert _distance(model.frf(THETA, LINES), _bare(mesh)) > 1e-3


def test_every_parameter_is_seen_in_the_frf(effect, example, mesh):
    parameters = effect(**example.options).parameters
    assert set(example.value) == set(parameters)
    whole = _model(effect, example.options, example.value, mesh=mesh).frf(THETA, LINES)
    for name, parameter in parameters.items():
        number = example.value[name]
        other = number * 0.9 if number * 0.9 in parameter.allowed else number * 1.1
        moved = _model(effect, example.options, example.value | {name: other}, mesh=mesh).frf(THETA, LINES)
        assert _distance(moved, whole) > 1e-5, f"{effect.name}.{name} changes nothing"


def test_modal_sum_agrees_with_the_direct_solve(effect, example, mesh):
    model = _model(effect, example.options, example.value, mesh=mesh)
    lines = LINES[::5]
    assert _distance(model.frf(THETA, lines), model.frf_direct(THETA, lines)) < 1e-8  # the bound between the two


def test_searched_members_equal_models_with_the_numbers_known(effect, example, mesh):
    model = _model(effect, example.options, example.value, _searched(effect, example), mesh)
    theta = _members(model, 3)
    together = model.frf(theta, LINES)
    for member, row in zip(together, theta.tolist(), strict=True):
        numbers = dict(zip((name.split(".")[1] for name in model.names), row, strict=True))
        alone = _model(effect, example.options, example.value | numbers, mesh=mesh).frf(THETA, LINES)
        assert _distance(member, alone) < 1e-9  # rounding of two eigenproblems


def test_any_batch_shape_and_vmap_give_the_same_members(effect, example, mesh):
    model = _model(effect, example.options, example.value, _searched(effect, example), mesh)
    if not model.names:
        pytest.skip("it has no parameter to search")
    theta, lines = _members(model, 2, 3), LINES[::9]
    together = model.frf(theta, lines)
    assert together.shape == (2, 3, len(lines), len(RESPONSE), len(REFERENCE))
    assert together.dtype == torch.complex128
    for found in (
        model.frf(theta.flatten(0, 1), lines).unflatten(0, (2, 3)),
        model.frf_direct(theta, lines),
        torch.func.vmap(lambda row: model.frf(row, lines))(theta),
        torch.func.vmap(torch.func.vmap(lambda row: model.frf_direct(row, lines)))(theta),
    ):
        assert _distance(found, together) < 1e-8  # between the modal sum and the direct solve


@pytest.mark.parametrize(
    "alone",
    [
        pytest.param(True, id="the effect alone", marks=pytest.mark.check),
        pytest.param(False, id="beside the plate"),
    ],
)
def test_the_reduced_basis_holds_where_it_is_offered(effect, example, mesh, alone):
    plate = {} if alone or effect is Plate else {name: (0.9 * BARE[name], 1.1 * BARE[name]) for name in PLATE}
    model = _model(effect, example.options, example.value, _searched(effect, example, 0.05), mesh, plate)
    found = reduce(model, LINES, tolerance=1e-4)
    if found is None:
        return
    small, error = found
    assert error <= 1e-4
    theta = _members(model, 4)
    # Ten times what the checked members have: see tests/model/test_reduced_basis.py.
    assert _distance(small.frf(theta, LINES), model.frf(theta, LINES)) < 1e-3


def test_a_value_outside_the_physical_range_is_refused_by_name(effect, example):
    for name, parameter in effect(**example.options).parameters.items():
        if parameter.allowed.low > float("-inf"):
            with pytest.raises(ValueError, match=name):
                _model(effect, example.options, example.value | {name: parameter.allowed.low - 1.0})


def test_it_says_what_it_shows_and_where_it_is_from(effect):
    assert effect.__doc__
    assert effect.shows.endswith(".")
    assert effect.source
    assert effect.acts_on
    for name, parameter in effect.parameters.items():
        assert parameter.meaning, name
        assert parameter.unit, name


def test_it_says_where_a_search_looks_for_it(effect, example):
    plan = _model(Plate, {}, {}).plan(THETA)
    every = effect(**example.options).parameters
    if every and all(parameter.prior is None for parameter in every.values()):
        pytest.skip("a search never looks for it: none of its parameters has a prior")
    for name, parameter in every.items():
        assert parameter.prior is not None, name
        assert parameter.prior.describe(parameter.unit), name
        found = parameter.prior_interval(plan.section, plan.geometry)
        assert isinstance(found, Searched)
        assert found.logarithmic == parameter.prior.logarithmic, name
        assert found.low in parameter.allowed, name
        assert found.high in parameter.allowed, name
        assert found.low <= example.value[name] <= found.high, f"a search would never meet {effect.name}.{name}"
        if parameter.prior.relative_to in Plate.parameters:
            # What is taken as known may be right.
            assert parameter.prior.low < 1 < parameter.prior.high, name
        if parameter.neutral is not None and not parameter.prior.logarithmic:
            assert found.low <= parameter.neutral <= found.high, name


def test_the_plate_has_one_scale_in_each_unit():
    plan = _model(Plate, {}, {}).plan(THETA)
    mass = 2710.0 * 0.0031 * 0.52 * 0.37
    # D₁₁ of the grain that all these plates have.
    rigidity = 69e9 * 0.0031**3 / (12 * (1 - 0.31**2)) / math.sqrt(0.6)
    length = math.sqrt(0.52 * 0.37)
    expected = {
        "kg": mass,
        "m": length,
        "s": math.sqrt(mass * length**2 / rigidity),
        "1/s": math.sqrt(rigidity / (mass * length**2)),
        "1/s²": rigidity / (mass * length**2),
        "N/m": rigidity / length**2,
        "N s/m": math.sqrt(rigidity * mass) / length,
        "N/m²": rigidity / length**3,
        "N/rad": rigidity / length,
        "N m²": rigidity * length,
        "kg/m": mass / length,
    }
    assert set(expected) == set(PLATE_SCALE)
    for unit, value in expected.items():
        parameter = Parameter(unit, "any", prior=Prior(0.2, 0.7, relative_to="plate"))
        found = parameter.prior_interval(plan.section, plan.geometry)
        assert (found.low, found.high) == pytest.approx((0.2 * value, 0.7 * value), rel=1e-12)


def test_a_poisson_ratio_below_zero_has_a_prior_too_and_one_of_zero_is_not_looked_for():
    effect = CATALOGUE["poisson_ratio"]
    plan = _model(Plate, {}, {}).plan(THETA)
    below = plan.section._replace(poisson_ratio=torch.full_like(plan.section.poisson_ratio, -0.02))
    found = effect.parameters["value"].prior_interval(below, plan.geometry)
    assert (found.low, found.high) == pytest.approx((-0.03, -0.01))
    assert effect.may_be_missing(below)
    assert not effect.may_be_missing(below._replace(poisson_ratio=torch.zeros_like(below.poisson_ratio)))


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_where_an_effect_is_looked_for_is_told_of_every_number_that_is(name):
    for parameter in CATALOGUE[name].parameters.values():
        told = parameter.looked_for
        assert bool(told) == (parameter.prior is not None)
        assert told.endswith("once the effect was found") == (parameter.prior is not None and parameter.detail)
        if parameter.prior is not None:
            assert told.startswith(f"{parameter.prior.low:.3g} to {parameter.prior.high:.3g}")


def test_a_prior_is_cut_to_what_is_allowed():
    plan = _model(Plate, {}, {}).plan(THETA)
    poisson = Parameter("-", "ν", Interval(-0.99, 0.4), prior=Prior(0.5, 1.5, relative_to="poisson_ratio"))
    found = poisson.prior_interval(plan.section, plan.geometry)
    assert (found.low, found.high) == pytest.approx((0.155, 0.4))
    with pytest.raises(ValueError, match="Expected a prior"):
        Parameter("-", "ν").prior_interval(plan.section, plan.geometry)


def test_names_are_those_of_the_classes_in_snake_case():
    assert CATALOGUE["hysteretic_damping"] is HystereticDamping
    assert options(CATALOGUE["support_spring"]) == ("nodes", "at")


def test_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(KeyError, match="Did you mean 'plate'"):
        find_effect("plat")


def test_an_effect_that_says_nothing_of_its_source_is_refused():
    with pytest.raises(TypeError, match="says nothing of its parameters"):
        type("Nameless", (Effect,), {})
    assert "nameless" not in CATALOGUE


def test_natural_frequencies_see_neither_damping_nor_the_sensor_chain():
    seen = {name for name, kind in CATALOGUE.items() if kind.moves_natural_frequencies()}
    blind = {"sensor_gain", "time_delay", "hysteretic_damping", "damping_patch", "ground_dashpot", "viscous_damping"}
    assert not seen & blind
    assert {"point_mass", "ground_spring", "orthotropy", "aspect_ratio", "rib", "air_loading"} <= seen
