"""The truths of the shapes stratum against the catalogue's own, and what the stratum draws."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse.linalg
import torch
import yaml

from blind.response import Chain, Damping, Test, frf
from blind.ritz import RitzPlate, modes
from blind.shapes import NAMES, apply, draw, draw_hidden, shaped, suite
from blind.test_ritz import PLATE
from torchplate.cli.config.build import load_run
from torchplate.effects import find_effect
from torchplate.model import PlateModel, SparseModel
from torchplate.plate import Mesh

# The truth of a benchmark that only `make blind` runs.
pytestmark = pytest.mark.check

GRAIN = {"young_ratio": 0.6, "shear_factor": 1.1}
BARE = replace(shaped(PLATE), **GRAIN)
HIDDEN = {
    "grain_angle": ({"angle": 0.35}, {"grain_angle": 0.35}),
    "rib": (
        {"x0": 0.1, "y0": 0.4, "x1": 0.8, "y1": 0.4, "bending": 18.0, "torsion": 6.0, "mass_per_length": 0.03},
        {"ribs": ((0.1, 0.4, 0.8, 0.4, 18.0, 6.0, 0.03),)},
    ),
    "cut_out": ({"x0": 0.3, "y0": 0.25, "x1": 0.5, "y1": 0.5}, {"cuts": ((0.3, 0.25, 0.5, 0.5),)}),
}
NONE = torch.zeros(0, dtype=torch.float64)


def model(name: str, parameters: dict[str, float], refine: int = 1, **more) -> PlateModel:
    wires = [spring[:2] for spring in PLATE.springs]
    effects = {
        "plate": find_effect("plate")(), "grain": find_effect("orthotropy")(),
        "wires": find_effect("support_spring")(at=wires), "loss": find_effect("hysteretic_damping")(),
        "hidden": find_effect(name)(),
    }  # fmt: skip
    known = {
        "plate.youngs_modulus": PLATE.young, "plate.poisson_ratio": PLATE.poisson, "plate.density": PLATE.density,
        "plate.thickness": PLATE.thickness, "wires.stiffness": 900.0, "wires.viscous_damping": 0.6,
        "loss.stiffness_loss_factor": 0.01,
    }  # fmt: skip
    known |= {f"grain.{key}": value for key, value in GRAIN.items()}
    known |= {f"hidden.{key}": value for key, value in parameters.items()}
    return PlateModel(Mesh(0.6, 0.36, 10, 8, refine=refine), effects, known, **more)


@pytest.mark.parametrize("name", list(HIDDEN))
def test_its_truth_has_the_natural_frequencies_of_the_catalogues_effect(name):
    parameters, changed = HIDDEN[name]
    expected = modes(replace(BARE, **changed), 12).frequency[3:15]
    coarse, fine = (SparseModel(model(name, parameters, k), NONE).modes(15).frequency[3:15].numpy() for k in (2, 4))
    # Measured 0.01 % of the grain, 0.03 % of the rib and 0.12 % of the hole, whose corners are singular in both.
    np.testing.assert_allclose((4 * fine - coarse) / 3, expected, rtol=2e-3 if name == "cut_out" else 1e-3)


def test_its_mass_on_a_spring_answers_as_the_catalogues_does():
    # A force of the truth's own on the catalogue's plate: the mesh is not in question.
    parameters = {"x": 0.3, "y": 0.62, "mass": 0.04, "stiffness": 2e4, "viscous_damping": 1.0}
    lines = np.linspace(20.0, 300.0, 57)
    places = [(0.3, 0.62), (0.25, 0.375), (0.75, 0.875)]
    both = model("absorber", parameters | {"mass": 0.0}, response=places, reference=places)
    alpha = both.frf(NONE, lines).numpy()
    where, force = replace(BARE, absorbers=((*parameters.values(),),)).forces(2j * np.pi * lines)
    assert where == [(0.3, 0.62)]
    found = alpha - alpha[:, :, :1] * (force / (1 + force * alpha[:, 0, :1]))[:, :, None] * alpha[:, :1]
    expected = model("absorber", parameters, response=places, reference=places).frf(NONE, lines).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())
    # And in the truth's own FRFs it makes a difference.
    test = Test(places[1:2], places[2:], lines, "accelerance")
    damping = Damping(0.01)
    with_it = frf(replace(BARE, absorbers=((*parameters.values(),),)), damping, Chain(), test, 10)
    assert np.linalg.norm(with_it - frf(BARE, damping, Chain(), test, 10)) > 0.1 * np.linalg.norm(with_it)


def test_under_its_mass_on_a_spring_the_plate_gives_as_much_as_on_a_fine_mesh():
    """The deflection goes with r² log r there: splines that are no finer there give too little."""
    at = (0.45, 0.5)
    truth = replace(BARE, absorbers=((*at, 0.04, 5e4, 1.0),)).own_matrices()
    own = truth.rows([at])[0]
    given = own @ np.linalg.solve(truth.stiffness, own)
    fine = model("absorber", {"x": 0.3, "y": 0.6, "mass": 0.0, "stiffness": 1.0, "viscous_damping": 0.0}, refine=8)
    row = fine.mesh.deflection_at(torch.tensor([at], dtype=torch.float64))[:, fine.mesh.free_dof].numpy()[0]
    expected = row @ scipy.sparse.linalg.spsolve(SparseModel(fine, NONE).stiffness.tocsc(), row)
    # In squares of an element of 12 × 8 over the rigidity: splines that are no finer there miss five times as much.
    square = PLATE.length_x * PLATE.length_y / 96 * 12 * (1 - PLATE.poisson**2) / (PLATE.young * PLATE.thickness**3)
    assert abs(given - expected) < 0.002 * square


def test_without_a_shape_it_is_the_plate_of_the_other_strata():
    plain = RitzPlate(**{name: getattr(BARE, name) for name in RitzPlate.__dataclass_fields__})
    np.testing.assert_allclose(modes(BARE, 8).frequency[:20], modes(plain, 8).frequency[:20], rtol=1e-8)


def test_each_effect_is_hidden_ten_times_and_nothing_eight_times():
    count = Counter(slot.names[0] if slot.names else "nothing" for slot in suite())
    assert count == dict.fromkeys(NAMES, 10) | {"nothing": 8}


@pytest.mark.parametrize("name", ["grain_angle", "absorber"])
def test_a_case_is_the_same_whenever_it_is_drawn_and_torchplate_reads_it(name, tmp_path):
    index = next(i for i, slot in enumerate(suite()) if slot.names == (name,))
    case, again = draw("test", index), draw("test", index)
    assert torch.equal(case.measurement.frf, again.measurement.frf)
    assert [one.effect for one in case.truth] == [name]
    assert case.shows[0] >= 0.5 * case.noise
    path = case.write(tmp_path)
    assert name not in yaml.safe_dump(yaml.safe_load(path.read_text())["effects"])
    assert load_run(path).model().names
    assert set(case.truth[0].parameters) == set(find_effect(name).parameters)


@pytest.mark.parametrize("name", [*NAMES, "thickness_field"])
def test_what_is_hidden_has_the_parameters_of_the_catalogue_and_changes_the_truth(name):
    rng = np.random.default_rng(5)
    case = draw("test", next(i for i, slot in enumerate(suite()) if not slot.names))
    from blind.effects import bare

    hidden = draw_hidden(rng, name, case.specimen, 1)
    assert list(hidden.parameters) == list(find_effect(name).parameters)
    for key, value in hidden.parameters.items():
        assert value in find_effect(name).parameters[key].allowed
    assert apply(bare(case.specimen), hidden).plate != case.specimen.plate
