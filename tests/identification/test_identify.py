"""`tp.identify`: what `run` does, in Python."""

import dataclasses
import json
import math

import pytest
import torch

import torchplate as tp
from torchplate.effects import HystereticDamping, Orthotropy, Plate, Searched
from torchplate.identification import Result, basis_check
from torchplate.measurement import SI_UNIT, Channel, Measurement, MeasurementError
from torchplate.plate import Mesh
from torchplate.search import LeastSquares

SEARCHED = ["plate.youngs_modulus", "wires.stiffness"]
# Thickness [m] and shear factor of the plate of wood.
WOOD = [5.7e-3, 0.52]
# A strategy that settles in few generations.
SEARCH = tp.DifferentialEvolution(strategy="best/1/bin", n_member=10, differential_weight=0.6, crossover_rate=0.9)


@pytest.fixture(scope="module")
def found(bench) -> Result:
    return tp.identify(bench.plate(SEARCHED), bench.exact_frfs(), search=SEARCH, seed=1, n_generation=6, polish=True)


def test_the_truth_of_exact_frfs_is_found(found, bench):
    assert list(found.parameters) == SEARCHED
    for name, value in found.parameters.items():
        # Least squares ends where a step moves no parameter by 1e-10 of its interval.
        assert value.value == pytest.approx(bench.truth[name], rel=1e-6)
        assert not value.at_bound
    assert found.parameters["wires.stiffness"].unit == "N/m"
    assert found.objective == pytest.approx(0.0, abs=1e-6)
    assert found.theta.tolist() == [value.value for value in found.parameters.values()]


def test_what_takes_minutes_on_a_very_fine_mesh_is_said_before_it_is_begun(bench, monkeypatch):
    told = []

    def look() -> None:
        tp.identify(bench.plate(SEARCHED), bench.exact_frfs(), search=SEARCH, seed=1, n_generation=1, say=told.append)

    look()
    assert not any("takes minutes" in line for line in told)
    told.clear()
    monkeypatch.setattr(basis_check, "LARGE", 10)
    monkeypatch.setattr(basis_check, "reduce", lambda *_, **__: told.append("begun"))
    look()
    assert "takes minutes" in told[0]
    assert told[1] == "begun"


@pytest.fixture(scope="module")
def wood() -> tuple[tp.PlateModel, Measurement]:
    """A plate of unknown wood, of which no small basis is right at all ends of all intervals; and its exact FRFs."""
    known = {"plate.youngs_modulus": 3e9, "plate.poisson_ratio": 0.1, "plate.density": 500.0}
    known |= {"grain.young_ratio": 0.08, "loss.stiffness_loss_factor": 0.004}
    searched = {"plate.thickness": Searched(2.8e-3, 1.12e-2, True), "grain.shear_factor": Searched(0.2, 1.25, True)}
    effects = {"plate": Plate(), "grain": Orthotropy(), "loss": HystereticDamping()}
    channels = {"response": [[0.05, 0.1]], "reference": [[0.9, 0.8]], "kind": "accelerance"}
    model = tp.PlateModel(Mesh(0.58, 0.22, 6, 4), effects, known, searched, **channels)
    lines = torch.linspace(38.0, 200.0, 60, dtype=torch.float64)
    measured = Measurement(
        frequency=lines,
        frf=model.frf(WOOD, lines),
        measured=torch.ones(1, 1, dtype=torch.bool),
        response=(Channel(0, coordinate=(0.029, 0.022, 0.0)),),
        reference=(Channel(0, coordinate=(0.522, 0.176, 0.0)),),
        kind="accelerance",
        unit=SI_UNIT["accelerance"],
    )
    return model, measured


@pytest.mark.check
def test_a_wide_box_is_searched_in_a_rough_basis_that_is_held_against_all_dofs(wood, monkeypatch):
    told: list[str] = []
    search = tp.DifferentialEvolution(n_member=30)
    budget = {"search": search, "seed": 2, "n_generation": 15, "polish": True, "objective": "log_amplitude"}
    found = tp.identify(*wood, say=told.append, **budget)
    assert any("held against all dofs" in line for line in told)
    assert found.theta.tolist() == pytest.approx(WOOD, rel=1e-4)
    assert found.basis_error is not None
    assert found.basis_error <= basis_check.TOLERANCE
    # Where it is wrong at the best, what was found is finished in all dofs.
    monkeypatch.setattr(basis_check, "TOLERANCE", 0.0)
    finished = tp.identify(*wood, **budget)
    assert finished.basis_error is None
    assert finished.theta.tolist() == pytest.approx(WOOD, rel=1e-8)
    # Without the finish all dofs are searched.
    told.clear()
    tp.identify(*wood, say=told.append, **budget | {"polish": False, "n_generation": 0})
    assert not any("vectors" in line for line in told)


def test_a_model_on_any_device_is_searched_there_and_found(bench, found, device):
    model = bench.plate(SEARCHED).to(device)
    there = tp.identify(model, bench.exact_frfs().to(device), search=SEARCH, seed=1, n_generation=6, polish=True)
    assert model.known.device.type == device.type
    for name, value in there.parameters.items():
        assert value.value == pytest.approx(found.parameters[name].value, rel=1e-6)


@pytest.mark.parametrize(
    "search",
    [tp.ArtificialBeeColony(n_member=5), tp.LShade(n_member=10), tp.Sade(n_member=10), LeastSquares(n_member=2)],
    ids=lambda search: type(search).__name__,
)
def test_every_search_runs_on_any_device(bench, search, device):
    model = bench.plate(SEARCHED).to(device)
    told = []
    for more in ({"precision": "single"}, {"basis": "full"}):
        measured = bench.exact_frfs()
        table = model.on("cpu").natural_frequencies(torch.tensor([bench.truth[name] for name in SEARCHED]), 8)
        given = {4: float(table[3]), 6: float(table[5])}
        there = tp.identify(
            model, measured, search=search, n_generation=2, natural_frequencies=given, on_generation=told.append, **more
        )
        assert math.isfinite(there.objective)
        assert there.theta.device.type == "cpu"
    assert {part.device.type for one in told for part in (one.best_position, *one.checkpoint().values())} == {"cpu"}


def test_to_dict_has_the_keys_of_result_json(found):
    content = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert content["schema"] == "torchplate.result/1"
    assert list(content["parameters"]) == SEARCHED
    assert set(content["parameters"]["wires.stiffness"]) == {"value", "std", "unit", "at_bound"}
    assert len(content["natural_frequencies_hz"]) == 20
    assert content["optimizer"] == content["search"]["optimizer"] == "differential_evolution"
    assert content["seed"] == content["search"]["seed"] == 1
    assert content["n_generation"] == 6
    assert content["n_evaluation"] == found.n_evaluation > 6 * SEARCH.n_member


def test_the_seed_repeats_it_and_another_does_not(bench):
    model, frfs = bench.plate(SEARCHED), bench.exact_frfs()
    one, again, other = (
        tp.identify(model, frfs, search=SEARCH, seed=seed, n_generation=1).objective for seed in (3, 3, 4)
    )
    assert one == again
    assert one != other


def test_a_table_of_natural_frequencies_serves_alone_and_as_a_mapping(bench):
    measured = bench.plate(()).natural_frequencies(bench.plate(()).known.new_zeros(0), 8).tolist()
    table = {4: measured[3], 6: measured[5]}
    found = tp.identify(bench.plate(SEARCHED[:1]), natural_frequencies=table, search=SEARCH, n_generation=20)
    assert found.objective_kind == "natural_frequencies"
    # One parameter: 20 generations of ten narrow its interval to far below this.
    assert found.parameters[SEARCHED[0]].value == pytest.approx(bench.truth[SEARCHED[0]], rel=1e-3)


def test_a_model_without_an_interval_is_evaluated(bench):
    found = tp.identify(bench.plate(()), bench.exact_frfs())
    assert found.parameters == {}
    assert found.objective == pytest.approx(0.0, abs=1e-9)  # its own FRFs
    assert found.n_evaluation == 1


def test_channels_that_carry_no_place_are_the_models_own(bench):
    frfs = bench.nameless(bench.exact_frfs())
    model = bench.plate(())
    with pytest.raises(ValueError, match="place on the plate for each of the measurement's 2 response channels"):
        tp.identify(model, frfs)
    model.response, model.reference = [4, 7], [1, 6]
    assert tp.identify(model, frfs).objective == pytest.approx(0.0, abs=1e-9)


def test_where_the_measurement_says_its_channels_are_the_models_own_do_not_count(bench):
    model = bench.plate((), response=[1, 2])
    assert tp.identify(model, bench.exact_frfs()).objective == pytest.approx(0.0, abs=1e-9)
    assert model.response == [1, 2]


def test_a_channel_off_the_plate_and_no_measurement_at_all_are_refused(bench):
    small = tp.PlateModel(type(bench.plate(()).mesh)(0.5, 0.32, 1, 1), {"plate": tp.CATALOGUE["plate"]()}, {
        "plate.youngs_modulus": 6e10, "plate.density": 2750.0, "plate.poisson_ratio": 0.33, "plate.thickness": 0.004,
    })  # fmt: skip
    with pytest.raises(MeasurementError, match="7"):
        tp.identify(small, bench.exact_frfs())
    with pytest.raises(ValueError, match="got neither"):
        tp.identify(bench.plate(SEARCHED))


def test_it_goes_on_from_a_checkpoint_to_the_identical_result(bench):
    model, frfs, kept = bench.plate(SEARCHED), bench.exact_frfs(), []
    whole = tp.identify(model, frfs, SEARCH, n_generation=4, on_generation=lambda p: kept.append(p.checkpoint()))
    rest = tp.identify(model, frfs, SEARCH, n_generation=4, resume=kept[2])
    assert rest.to_dict() == whole.to_dict()


def test_a_model_without_an_interval_is_held_against_the_full_one_once(bench, monkeypatch):
    from torchplate.identification import basis_check
    from torchplate.model.discretisation import error_estimate, fine_mesh, reduced_basis

    model = bench.plate(())
    calls = []

    def counted(*arguments, **options):
        calls.append(arguments)
        return measured(*arguments, **options)

    measured = reduced_basis.full_model
    for module in (reduced_basis, error_estimate):
        monkeypatch.setattr(module, "full_model", counted)
    # As if its mesh were fine: a basis serves it then, though nothing is searched.
    for module in (basis_check, fine_mesh):
        monkeypatch.setattr(module, "DENSE", 40)
    fine = type(model)(dataclasses.replace(model.mesh, refine=4), model.effects, bench.known | bench.truth)
    found = tp.identify(fine, bench.exact_frfs())
    assert found.basis_error is not None
    assert found.basis_error < 1e-4
    # Each comparison takes a factorisation of the whole matrix at every line.
    assert len(calls) == 1
