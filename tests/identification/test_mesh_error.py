"""A search that ends at another kind of plate than the middle of its box, against FRFs of a much finer mesh."""

import dataclasses

import pytest
import torch

import torchplate as tp
from torchplate.discrepancy import Evidence
from torchplate.effects import CATALOGUE
from torchplate.identification import PlateState, States
from torchplate.measurement import SI_UNIT, Channel, Measurement, NaturalFrequencies
from torchplate.model import PlateModel, Searched, SparseModel, extrapolate, retaken
from torchplate.plate import Mesh
from torchplate.search import LeastSquares

MESH = Mesh(0.5, 0.36, 10, 7)
RESPONSE, REFERENCE = [(0.13, 0.22), (0.81, 0.64)], [(0.07, 0.9)]
VALUES = {
    "plate.youngs_modulus": 7e10,
    "plate.poisson_ratio": 0.3,
    "plate.density": 2700.0,
    "plate.thickness": 0.003,
    "loss.stiffness_loss_factor": 0.01,
}
# What is true, what is searched, and the end of the band [Hz]. The middle of each box is another kind of plate.
POISSON = (
    VALUES | {"plate.poisson_ratio": 0.08},
    {"plate.youngs_modulus": (6e10, 8e10), "plate.poisson_ratio": (0.02, 0.48)},
    400.0,
)
GRAIN = (
    VALUES | {"grain.young_ratio": 0.08, "grain.shear_factor": 1.1},
    {"plate.youngs_modulus": (6.5e10, 7.5e10), "grain.young_ratio": (0.04, 0.6), "grain.shear_factor": (1.0, 1.2)},
    250.0,
)
SIDES = (
    VALUES | {"sides.ratio": 0.95},
    {"plate.youngs_modulus": (6.5e10, 7.5e10), "sides.ratio": (0.94, 1.4)},
    400.0,
)
NAMES = {"loss": "hysteretic_damping", "grain": "orthotropy", "sides": "aspect_ratio"}


def build(values: dict[str, float], box: dict[str, tuple[float, float]], mesh: Mesh = MESH) -> PlateModel:
    known = {name: value for name, value in values.items() if name not in box}
    labels = dict.fromkeys(name.partition(".")[0] for name in values)
    effects = {label: CATALOGUE[NAMES.get(label, label)]() for label in labels}
    searched = {name: Searched(*ends) for name, ends in box.items()}
    return PlateModel(mesh, effects, known, searched, RESPONSE, REFERENCE, "accelerance")


def finely(values: dict[str, float]) -> SparseModel:
    """The true plate on elements a sixth as long."""
    return SparseModel(build(values, {}, dataclasses.replace(MESH, refine=6)), torch.zeros(0, dtype=torch.float64))


def measured(values: dict[str, float], top: float) -> Measurement:
    frequency = torch.linspace(30.0, top, 120, dtype=torch.float64)
    frf = finely(values).frf(frequency)

    def at(places: list[tuple[float, float]]) -> tuple[Channel, ...]:
        return tuple(Channel(0, coordinate=(x * MESH.length_x, y * MESH.length_y, 0.0)) for x, y in places)

    return Measurement(
        frequency=frequency,
        frf=frf,
        measured=torch.ones(frf.shape[1:], dtype=torch.bool),
        response=at(RESPONSE),
        reference=at(REFERENCE),
        kind="accelerance",
        unit=SI_UNIT["accelerance"],
    )


def coarse(case) -> PlateModel:
    """The plate on its mesh, the error of that taken off at the middle of the box."""
    values, box, top = case
    return extrapolate(build(values, box), top).model


def off(case, result) -> dict[str, float]:
    """How far the found values are off, relative."""
    return {name: abs(one.value / case[0][name] - 1) for name, one in result.parameters.items()}


@pytest.mark.check
def test_a_plate_of_another_poisson_ratio_is_found_without_its_own_mesh_error():
    """With the mesh error of the middle of the box they were 3.5e-3 and 2.7e-2 off."""
    told: list[str] = []
    values, _, top = POISSON
    search = tp.DifferentialEvolution(strategy="best/1/bin", n_member=10)
    given = measured(values, top)
    found = tp.identify(coarse(POISSON), given, search, 1, n_generation=12, polish=True, say=told.append)
    # Elements a sixth as long have a thirty-sixth of the mesh error themselves.
    errors = off(POISSON, found)
    assert errors["plate.youngs_modulus"] < 3e-4
    assert errors["plate.poisson_ratio"] < 3e-3
    true = finely(values).modes(9).frequency[3:9].tolist()
    assert found.natural_frequencies_hz[3:9] == pytest.approx(true, rel=3e-4)
    assert found.mesh_error_moved is not None
    assert 1e-3 < found.mesh_error_moved < 1e-2
    assert found.to_dict()["mesh_error_moved"] == found.mesh_error_moved
    assert sum("taken off anew" in one for one in told) == 1


def test_where_all_plates_of_the_box_are_alike_nothing_is_done_anew():
    """A modulus, a density, a thickness and a loss: the mesh error goes with the rigidity."""
    box = {
        "plate.youngs_modulus": (6e10, 9e10),
        "plate.density": (2600.0, 2900.0),
        "plate.thickness": (0.0029, 0.0035),
        "loss.stiffness_loss_factor": (5e-3, 2e-2),
    }
    model = extrapolate(build(VALUES, box), 400.0).model
    theta = model.space.to_si(torch.tensor([0.1, 0.9, 0.8, 0.2], dtype=torch.float64))
    assert retaken(model, theta, 400.0) is None
    # Taken off there all the same it is what it was: 1e-7 is what ARPACK leaves.
    again = extrapolate(model, 400.0, theta).model
    assert again.natural_frequencies(theta, 9)[3:] == pytest.approx(model.natural_frequencies(theta, 9)[3:], rel=1e-6)
    before, after = (SparseModel(one, theta).modes(9).frequency[3:9] for one in (build(VALUES, box), again))
    assert float((after / before - 1).abs().max()) > 1e-3


def test_a_model_on_its_mesh_as_it_is_is_searched_as_it_is():
    values, box, top = POISSON
    plain = build(values, box)
    assert retaken(plain, plain.space.to_si(torch.zeros(2, dtype=torch.float64)), top) is None


def table_of(values: dict[str, float]) -> NaturalFrequencies:
    frequency = finely(values).modes(14).frequency.tolist()
    return NaturalFrequencies.from_mapping({mode: frequency[mode - 1] for mode in range(4, 13)})


# With the mesh error of the middle of the box the worst value was 1.6e-2, 1.2e-3 and 7e-3 off, and the objective 7e-4
# to 2.4e-3; the elements of the truth have a thirty-sixth of the mesh error themselves.
@pytest.mark.parametrize(
    ("case", "most"), [(POISSON, 3e-3), (SIDES, 3e-4), (GRAIN, 2e-3)], ids=["poisson_ratio", "sides", "grain"]
)
@pytest.mark.check
def test_a_table_is_met_by_the_plate_that_has_it(case, most):
    values, box, _ = case
    model = extrapolate(build(values, box)).model
    search = LeastSquares(n_member=8)
    found = tp.identify(model, search=search, seed=1, n_generation=20, natural_frequencies=table_of(values))
    assert found.mesh_error_moved is not None
    assert max(off(case, found).values()) < most
    assert found.objective is not None
    assert found.objective < 2e-4


@pytest.mark.check
def test_states_of_a_plate_have_its_own_mesh_error():
    values, box, _ = POISSON
    evidence, model = Evidence(natural_frequencies=table_of(values)), extrapolate(build(values, box)).model
    own = PlateState.of("other", model, evidence, ("plate.youngs_modulus",))
    states = States([PlateState.of("one", model, evidence), own])
    found = tp.identify(states, search=LeastSquares(n_member=4), seed=1, n_generation=20)
    assert found.mesh_error_moved is not None
    for name, one in found.parameters.items():
        assert one.value == pytest.approx(values[name.partition("@")[0]], rel=3e-3)
