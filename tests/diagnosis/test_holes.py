"""A hole or a notch that nobody drew: what is tried of it, and that it is found."""

import pytest
import torch

from torchplate.diagnosis import diagnose
from torchplate.diagnosis.candidates.candidate import Candidate, distance, place_of
from torchplate.diagnosis.candidates.catalogue import candidates, channels_of
from torchplate.diagnosis.candidates.trials import as_large, holes_all_over, spread_at
from torchplate.diagnosis.selection.screen import _moved
from torchplate.effects import CATALOGUE
from torchplate.measurement import PERFECT
from torchplate.model import PlateModel, Searched
from torchplate.model.discretisation.extrapolation import extrapolate
from torchplate.plate import Mesh

NOTHING = torch.zeros(0, dtype=torch.float64)
SIDES = (0.4, 0.3)
NUMBERS = {"youngs_modulus": 7.0e10, "poisson_ratio": 0.33, "density": 2700.0, "thickness": 0.003}
RESPONSE, REFERENCE = (1, 7, 41, 45), (63, 30, 19)
# On lines of the mesh, and between them: on lines of one of 40 × 30 elements.
HOLES = {
    "on lines": ((8, 6, 4), (0.5, 2 / 6, 0.625, 0.5)),
    "between": ((40, 30, 1), (0.525, 11 / 30, 0.65, 16 / 30)),
}


def plate(searched=None, cells=(8, 6, 1), cut=()):
    effects = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"]()}
    numbers = {f"plate.{name}": value for name, value in NUMBERS.items()} | {"loss.stiffness_loss_factor": 1e-2}
    numbers = {key: value for key, value in numbers.items() if key not in (searched or {})}
    response, reference = (Mesh(*SIDES, 8, 6).places(labels).tolist() for labels in (RESPONSE, REFERENCE))
    mesh = Mesh(*SIDES, *cells, cut=cut)
    return PlateModel(mesh, effects, numbers, searched, response, reference, kind="accelerance")


def hole() -> Candidate:
    model = plate()
    (one,) = [one for one in candidates(model, NOTHING, channels_of(model)) if one.name == "cut_out"]
    return one


def area(corners):
    return (corners["x1"] - corners["x0"]) * (corners["y1"] - corners["y0"])


def test_holes_and_notches_all_over_the_plate_are_tried():
    one = hole()
    assert one.is_hole
    assert one.is_local
    for trial in (*one.far, *one.near):
        assert 0 < trial.lowest < 1 < trial.highest
        assert all(0 <= value <= 1 for value in trial.values.values())
        assert area(trial.values) > 0
    places = [place_of(trial.values) for trial in one.far]
    assert len(places) == 50
    assert {round(max(place), 1) for place in places} == {0.1, 0.3, 0.5, 0.7, 0.9}
    assert sum(trial.values["x1"] == 1.0 for trial in one.far) >= 5


@pytest.mark.parametrize("alpha", [0.04, 0.5, 1.6])
def test_a_hole_that_changes_more_is_larger_and_a_notch_stays_at_its_edge(alpha):
    inside = {"x0": 0.4, "y0": 0.3, "x1": 0.5, "y1": 0.6}
    moved = _moved(hole(), dict(inside), alpha)
    assert area(moved) == pytest.approx(alpha * area(inside))
    assert distance(moved, inside) == pytest.approx(0.0, abs=1e-12)
    notch = as_large({"x0": 0.8, "y0": 0.0, "x1": 1.0, "y1": 0.2}, alpha)
    assert (notch["x1"], notch["y0"]) == (1.0, 0.0)
    assert area(notch) == pytest.approx(alpha * 0.04)


def test_at_a_place_holes_of_all_sizes_are_tried():
    every = spread_at(hole(), 0.3, 0.6, 32)
    assert len(every) == 32
    assert all(one["x0"] < 0.3 < one["x1"] and one["y0"] < 0.6 < one["y1"] for one in every)
    areas = sorted(map(area, every))
    assert areas[0] < 0.01 < 0.06 < areas[-1]


def test_holes_and_notches_of_all_sizes_are_tried_where_frequencies_alone_are_known():
    every = holes_all_over(128)
    areas = sorted(map(area, every))
    assert areas[0] < 0.005 < 0.02 < areas[64] < 0.1
    # As many places in each quarter of the plate, and some at each edge.
    for x in (0, 1):
        for y in (0, 1):
            there = [one for one in every if (place_of(one)[0] > 0.5) == x and (place_of(one)[1] > 0.5) == y]
            assert 26 <= len(there) <= 38
    for end in ({"x0": 0.0}, {"x1": 1.0}, {"y0": 0.0}, {"y1": 1.0}):
        assert sum(end.items() <= one.items() for one in every) >= 5


@pytest.mark.check
@pytest.mark.parametrize("name", [pytest.param("on lines", marks=pytest.mark.proof), "between"])
def test_a_hole_is_named(lab, name):
    cells, corners = HOLES[name]
    line = torch.arange(20.0, 500.0, 2.0, dtype=torch.float64)
    exact = extrapolate(plate(cells=cells, cut=(corners,)), 500.0).model.frf(NOTHING, line)
    measured = lab.measured(line, exact + lab.noise_of(lab.true_std(exact, 0.005, "mixed"), 3), RESPONSE, REFERENCE)
    believed = plate(searched={"plate.youngs_modulus": Searched(5e10, 9e10)})
    result = diagnose(believed, measured, imperfections=PERFECT)
    (named,) = [one for one in result.effects if one.name != "mesh_discretisation"]
    assert (result.verdict, named.name) == ("explained", "cut_out")
    found = {key: value.value for key, value in named.parameters.items()}
    (x0, x1), (y0, y1) = (sorted((found[f"{axis}0"], found[f"{axis}1"])) for axis in "xy")
    assert (x0, y0, x1, y1) == pytest.approx(corners, abs=0.002)
