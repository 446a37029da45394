"""What holds for every effect of the catalogue, present and future."""

import pytest
import torch

from torchplate.effects import CATALOGUE, Effect, HystereticDamping, Plate, find_effect, options
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

MESH = Mesh(0.52, 0.37, 5, 4)
BARE = {
    "plate.youngs_modulus": 69e9,
    "plate.poisson_ratio": 0.31,
    "plate.density": 2710.0,
    "plate.thickness": 0.0031,
    "loss.stiffness_loss_factor": 0.004,
}
LINES = torch.linspace(20.0, 420.0, 61, dtype=torch.float64)
THETA = torch.zeros(0, dtype=torch.float64)


def _model(effect: type[Effect], fixed: dict, value: dict[str, float], searched: dict | None = None) -> PlateModel:
    """A slightly damped rectangle with the effect added, or with the plate itself replaced."""
    label = "plate" if effect is Plate else "added"
    effects = {"plate": Plate(), "loss": HystereticDamping(), label: effect(**fixed)}
    known = BARE | {f"{label}.{name}": number for name, number in value.items()}
    intervals = {f"{label}.{name}": interval for name, interval in (searched or {}).items()}
    return PlateModel(MESH, effects, {key: known[key] for key in known if key not in intervals}, intervals)


def _frf(model: PlateModel, theta: torch.Tensor = THETA) -> torch.Tensor:
    return model.frf(theta, LINES, response=[(0.13, 0.22)], reference=[8, (0.71, 0.64)], kind="accelerance")


def _distance(first: torch.Tensor, second: torch.Tensor) -> float:
    return float((first - second).norm() / second.norm())


BARE_FRF = _frf(_model(Plate, {}, {}))


def test_neutral_value_leaves_the_model_as_it_was(effect, example):
    neutral = {name: p.neutral for name, p in effect.parameters.items() if p.neutral is not None}
    if not neutral:
        pytest.skip("every parameter must be given")
    given = {name: number for name, number in example.value.items() if name not in neutral}
    # A parameter without a neutral value (a stiffness that must be given) is switched off instead.
    off = {name: 0.0 for name in given if effect.parameters[name].unit in ("N/m", "kg")}
    model = _model(effect, example.options, given | off | neutral)
    assert _distance(_frf(model), BARE_FRF) < 1e-9  # rounding of two eigenproblems


def test_every_parameter_is_seen_in_the_frf(effect, example):
    whole = _frf(_model(effect, example.options, example.value))
    for name, parameter in effect.parameters.items():
        number = example.value[name]
        other = number * 0.9 if number * 0.9 in parameter.allowed else number * 1.1
        moved = _frf(_model(effect, example.options, example.value | {name: other}))
        assert _distance(moved, whole) > 1e-5, f"{effect.name}.{name} changes nothing"


def test_modal_sum_agrees_with_the_direct_solve(effect, example):
    model = _model(effect, example.options, example.value)
    direct = model.frf_direct(THETA, LINES, [(0.13, 0.22)], [8, (0.71, 0.64)], "accelerance")
    assert _distance(_frf(model), direct) < 1e-8  # the bound between the two formulations


def test_searched_members_equal_models_with_the_numbers_known(effect, example):
    searched = {
        name: Searched(min(0.8 * number, number - 1e-9), 1.2 * number + 1e-9)
        for name, number in example.value.items()
        if 1.2 * number + 1e-9 in effect.parameters[name].allowed
    }
    model = _model(effect, example.options, example.value, searched)
    generator = torch.Generator().manual_seed(7)
    theta = model.space.to_si(torch.rand(3, len(model.names), dtype=torch.float64, generator=generator))
    together = _frf(model, theta)
    for member, row in zip(together, theta.tolist(), strict=True):
        numbers = dict(zip((name.split(".")[1] for name in model.names), row, strict=True))
        alone = _frf(_model(effect, example.options, example.value | numbers))
        assert _distance(member, alone) < 1e-9  # rounding of two eigenproblems


def test_a_value_outside_the_physical_range_is_refused_by_name(effect, example):
    for name, parameter in effect.parameters.items():
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
