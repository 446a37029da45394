"""A run searches in a basis that it can trust, confirms its best member, and gives a wrong basis up."""

import csv
import importlib

import pytest

from torchplate.identification import basis_check as basis

identification = importlib.import_module("torchplate.identification.identify")
evaluation = importlib.import_module("torchplate.identification.evaluation")
# Poisson's ratio makes every plate's modes its own; on this mesh a basis needs few of its 72 dofs up to 150 Hz.
SEARCHED = ["plate.youngs_modulus", "plate.poisson_ratio"]
SETTINGS = {
    "mesh": {"length_x": 0.41, "length_y": 0.29, "n_x": 6, "n_y": 4},
    "measurement.band": [8.0, 150.0],
    "search.n_generation": 6,
    "effects.plate.poisson_ratio": [0.25, 0.36],
    "search.basis": "auto",
    "effects.wires.nodes": [2, 8, 30],
}


@pytest.fixture
def in_a_basis(bench):
    def go(name: str, **changes):
        return bench.run(["plate.youngs_modulus"], SETTINGS | changes, out=name)

    return go


@pytest.mark.check
def test_the_error_at_the_best_and_in_the_population_is_written_down(in_a_basis):
    result = in_a_basis("trusted").result
    assert 0 < result["basis_error"] <= basis.TOLERANCE
    assert 0 < result["basis_error_of_population"] <= basis.TOLERANCE


@pytest.mark.check
def test_a_search_by_shared_modes_ends_where_one_on_all_dofs_does(bench):
    searched = ["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"]
    shared, full = (
        bench.run(searched, {"search.basis": name, "search.polish": True}, out=name).result for name in ("auto", "full")
    )
    assert "basis_error" in shared
    assert "basis_error" not in full
    for name in searched:
        assert shared["parameters"][name]["value"] == pytest.approx(full["parameters"][name]["value"], rel=1e-6)


def test_residuals_of_a_basis_of_all_modes_are_not_taken(bench, monkeypatch):
    """Rounding alone is wrong of it; they took longer than the search of a plate of 867 dofs."""

    def refuse(*_):
        raise AssertionError

    monkeypatch.setattr(basis, "estimated_error", refuse)
    result = bench.run(["plate.youngs_modulus"], {"search.basis": "auto", "search.n_generation": 1}).result
    assert 0 < result["basis_error_of_population"] == result["basis_error"] <= basis.TOLERANCE


@pytest.mark.check
def test_a_basis_that_is_wrong_at_the_best_takes_it_in(in_a_basis, monkeypatch, capsys):
    measured = []
    sound = basis.basis_error

    def wrong_at_first(*arguments):
        measured.append(sound(*arguments))
        return 1.0 if len(measured) == 1 else measured[-1]

    monkeypatch.setattr(basis, "basis_error", wrong_at_first)
    result = in_a_basis("enriched").result
    assert len(measured) == 2
    # Its own modes and static residuals are in the basis now; what is left is the dynamics of its higher modes.
    assert measured[1] < 0.9 * measured[0]
    assert result["basis_error"] == pytest.approx(measured[1], rel=1e-3)


@pytest.mark.check
def test_a_basis_that_stays_wrong_is_given_up(in_a_basis, monkeypatch):
    monkeypatch.setattr(basis, "basis_error", lambda *_: 1.0)
    monkeypatch.setattr(evaluation, "basis_error", lambda *_: 1.0)
    result = in_a_basis("refused").result
    assert "basis_error" not in result


@pytest.mark.check
def test_a_search_in_single_precision_finds_the_same_and_says_it_in_double(bench):
    searched = ["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"]
    single, double = (
        bench.run(searched, {"search.basis": "auto", "search.precision": name}, out=name)
        for name in ("single", "double")
    )
    # The same members are drawn; rounding may turn a few comparisons of nearly equal ones.
    for name in searched:
        value = single.result["parameters"][name]["value"]
        assert value == pytest.approx(double.result["parameters"][name]["value"], rel=1e-2)
    # What the search saw is rounded; what it found is said in double precision.
    with (single.folder / "history.csv").open(newline="") as file:
        seen = float(list(csv.DictReader(file))[-1]["best_objective"])
    found = single.result["objective"]
    assert seen == pytest.approx(found, rel=1e-4)
    # The history has ten digits.
    assert seen != pytest.approx(found, rel=1e-9)
    again = bench.run(searched, {"search.basis": "auto", "search.precision": "single", "search.polish": True}, out="p")
    assert again.result["objective"] <= single.result["objective"]
    path = single.folder / "config.yaml"
    assert "precision: single" in path.read_text()


@pytest.mark.check
def test_a_search_goes_on_in_the_precision_it_began_in(bench, command, monkeypatch):
    monkeypatch.chdir(bench.folder)
    bench.run(["plate.youngs_modulus"], {"search.precision": "single", "search.n_generation": 2})
    more = ["--set", "search.n_generation=3"]
    status, _, said = command(
        "run", "plate.yaml", "--out", "out", "--resume", *more, "--set", "search.precision=double"
    )
    assert status == 2
    assert "search.precision" in said
    assert command("run", "plate.yaml", "--out", "out", "--resume", *more)[0] == 0


@pytest.mark.check
def test_what_single_precision_found_is_polished_from_its_objective_in_double(bench, monkeypatch):
    begun = []
    own = identification.polished

    def spy(searched, outcome, say):
        again = searched(searched.model.space.to_si(outcome.best_position))
        begun.append((outcome.best_objective.tolist(), again.tolist()))
        return own(searched, outcome, say)

    monkeypatch.setattr(identification, "polished", spy)
    settings = {"search.basis": "auto", "search.precision": "single", "search.polish": True}
    bench.run(["plate.youngs_modulus", "wires.stiffness"], settings)
    ((given, again),) = begun
    assert given == pytest.approx(again, rel=1e-12)


@pytest.mark.check
def test_a_fine_mesh_without_a_basis_says_what_takes_the_time(bench, make_config, command, monkeypatch):
    monkeypatch.setattr(basis, "reduce", lambda *_, **__: None)
    monkeypatch.setattr(basis, "DENSE", 30)
    bench.write(make_config(["plate.youngs_modulus"], SETTINGS | {"search.n_generation": 1}))
    status, out, _ = command("run", bench.folder / "plate.yaml", "--out", bench.folder / "out")
    assert status == 0
    said = " ".join(out.split())
    assert "all 105 dofs, since no smaller basis is right over the whole box" in said
    assert "narrower intervals, a lower end of the band or a coarser mesh take less" in said


@pytest.mark.parametrize("name", ["differential_evolution", "least_squares"])
@pytest.mark.check
def test_a_mesh_error_that_was_taken_off_anew_stands_in_the_result_and_the_report(bench, name):
    """And one half of the way after the other ends where all of it does."""
    search = {"search.optimizer": name, "search.n_generation": 6, "search.basis": "full"}
    if name == "least_squares":
        search |= dict.fromkeys(("search.strategy", "search.differential_weight", "search.crossover_rate"), ...)
        search["search.n_member"] = 3
    finer = {"mesh.refine": 2, "mesh.extrapolate": True, "measurement.band": [8.0, 150.0]}
    changes = finer | search | {"effects.plate.poisson_ratio": [0.05, 0.35]}
    whole = bench.run(["plate.youngs_modulus"], changes, "whole")
    assert 1e-5 < whole.result["mesh_error_moved"] < 1e-2
    assert "taken off anew there" in (whole.folder / "report.md").read_text()
    if name == "differential_evolution":
        bench.run(["plate.youngs_modulus"], changes | {"search.n_generation": 3}, "parts")
        parts = bench.run(["plate.youngs_modulus"], changes, "parts", ["search.n_generation=6"], resume=True)
        assert parts.result["parameters"] == whole.result["parameters"]
    alike = bench.run(["plate.youngs_modulus"], finer | search, "alike")
    assert "mesh_error_moved" not in alike.result
    assert "anew" not in (alike.folder / "report.md").read_text()
