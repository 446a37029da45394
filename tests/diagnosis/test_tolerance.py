"""A number that a ruler or a scale has told may move as far as the ruler's lines are apart, and pays for it."""

import math

import pytest
import torch

from torchplate.diagnosis.fit import fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Problem
from torchplate.diagnosis.target import FrfTarget
from torchplate.diagnosis.tolerance import measured, with_tolerances
from torchplate.effects import CATALOGUE
from torchplate.measurement.assessment.noise import Noise
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

SIDES = 0.43, 0.3
RESPONSE, REFERENCE = (3, 17), (7, 9, 14)
LINES = torch.linspace(10.0, 340.0, 140, dtype=torch.float64)
KNOWN = {
    "plate.youngs_modulus": 2.05e11,
    "plate.poisson_ratio": 0.3,
    "plate.density": 7850.0,
    "plate.thickness": 0.003,
    "wires.stiffness": 1500.0,
    "wires.viscous_damping": 0.7,
    "loss.stiffness_loss_factor": 8e-3,
}
RULER = {"mesh.length_x": 5e-4, "mesh.length_y": 5e-4}


def plate(searched=None, sides=SIDES, **known) -> PlateModel:
    searched = searched or {}
    effects = {
        "plate": CATALOGUE["plate"](),
        "wires": CATALOGUE["support_spring"](nodes=[2, 10, 19]),
        "loss": CATALOGUE["hysteretic_damping"](),
    }
    numbers = {key: value for key, value in (KNOWN | known).items() if key not in searched}
    channels = list(RESPONSE), list(REFERENCE)
    return PlateModel(Mesh(*sides, 4, 3), effects, numbers, searched, *channels, "accelerance")


def bench_of(lab, held, true: PlateModel) -> ModelBuilder:
    frf = true.frf(lab.nobody, LINES)
    std = lab.true_std(frf, 0.01, "mixed")
    measured = lab.measured(LINES, frf + lab.noise_of(std, 2), RESPONSE, REFERENCE)
    target = FrfTarget(
        measured, Noise(std, lab.true_floor(std, frf), (), torch.zeros_like(std)), torch.zeros(2, 3, dtype=torch.bool)
    )
    # Model and data on one mesh: nothing but the tolerances is at stake here.
    return ModelBuilder(held.model, target, as_given=True)


def test_what_is_not_uncertain_stays():
    model = plate()
    held = with_tolerances(model, {})
    assert held.model is model
    assert held.prior == {}
    assert with_tolerances(model, {"plate.density": 0.0}).model is model


@pytest.mark.parametrize("name", ["plate.density", "plate.thickness", "loss.stiffness_loss_factor"])
def test_a_number_moves_within_a_few_of_its_deviations(name):
    std = 0.01 * KNOWN[name]
    held = with_tolerances(plate(), {name: std})
    assert held.model.names == (name,)
    assert held.prior == {name: (KNOWN[name], std)}
    low, high = float(held.model.space.low), float(held.model.space.high)
    assert 3 * std < KNOWN[name] - low < 10 * std
    assert high - KNOWN[name] == pytest.approx(KNOWN[name] - low)
    # Where it is by_noise to be, nothing has changed.
    theta = torch.tensor([KNOWN[name]], dtype=torch.float64)
    assert torch.allclose(held.model.frf(theta, LINES), plate().frf(theta[:0], LINES), rtol=1e-10)


def test_a_number_that_may_be_anything_down_to_nothing_stays_physical():
    held = with_tolerances(plate(), {"wires.viscous_damping": 0.3, "wires.stiffness": 900.0})
    assert float(held.model.space.low.min()) >= 0
    held = with_tolerances(plate(), {"plate.thickness": 0.001})
    assert float(held.model.space.low) > 0


def test_a_side_cannot_become_two_per_cent_longer():
    held = with_tolerances(plate(), RULER)
    ratio = held.model.names.index("sides.ratio")
    low, high = float(held.model.space.low[ratio]), float(held.model.space.high[ratio])
    # A ratio is off by what either side is, 1.2e-3 and 1.7e-3.
    spread = math.hypot(5e-4 / SIDES[0], 5e-4 / SIDES[1])
    assert held.prior["sides.ratio"] == (1.0, pytest.approx(spread))
    assert 1 - 0.02 < low < 1 - 2 * spread
    assert 1 + 2 * spread < high < 1 + 0.02
    # The mass of the plate goes with its area.
    assert held.prior["plate.density"] == (KNOWN["plate.density"], pytest.approx(spread * KNOWN["plate.density"]))


def test_a_density_that_is_searched_takes_the_area_along():
    held = with_tolerances(plate({"plate.density": Searched(7e3, 8.5e3)}), RULER)
    assert set(held.prior) == {"sides.ratio"}
    assert set(held.model.names) == {"sides.ratio", "plate.density"}
    assert float(held.model.space.high.max()) == 8.5e3


def test_a_density_that_was_not_measured_is_not_taken_for_it_where_sides_were():
    tolerance = {**RULER, "plate.thickness": 1e-5}
    held = with_tolerances(plate(), tolerance)
    assert set(held.prior) == {"sides.ratio", "plate.density", "plate.thickness"}
    assert measured(held.prior, tolerance) == {"sides.ratio", "plate.thickness"}
    weighed = {**tolerance, "plate.density": 20.0}
    assert measured(with_tolerances(plate(), weighed).prior, weighed) == {*held.prior}


def test_an_unknown_name_is_said():
    for name in ("plate.densty", "plates.density", "mesh.length_z"):
        with pytest.raises(ValueError, match=f"'{name}'.*Correct"):
            with_tolerances(plate(), {name: 1.0})
    # What is searched is no number that something is known of.
    with pytest.raises(ValueError, match=r"plate\.density"):
        with_tolerances(plate({"plate.density": Searched(7e3, 8.5e3)}), {"plate.density": 10.0})


def test_leaving_the_number_costs_the_square_of_its_deviations(lab):
    held = with_tolerances(plate(), {"plate.density": 20.0, "plate.thickness": 1e-5})
    builder = bench_of(lab, held, plate())
    middle = builder.given.space.to_si(torch.full((2,), 0.5, dtype=torch.float64))
    reduced = builder.reduced(builder.given, middle[None])
    marginal = builder.target.marginal(reduced, middle)
    problem = Problem(builder, reduced, held.prior, marginal)
    names = held.model.names
    theta = torch.tensor([KNOWN[name] for name in names], dtype=torch.float64)
    theta[names.index("plate.density")] += 3 * 20.0
    theta[names.index("plate.thickness")] -= 0.5e-5
    told = dict(zip(held.prior, problem.told(theta).tolist(), strict=True))
    assert told == {"plate.density": pytest.approx(3.0), "plate.thickness": pytest.approx(-0.5)}
    sharp = builder.target.levels - 1
    position = problem.model.space.to_cube(theta)
    assert len(problem.residual(position, sharp)) == 2 * 6 * len(LINES) + 2
    alone = Problem(builder, problem.model, {}, marginal)
    # At the wide levels, which are not weighed by the noise, what is known weighs a part of all that was measured.
    assert len(problem.residual(position, 0)) == len(alone.residual(position, 0)) + 2
    difference = problem.residual(position, sharp).square().sum() - alone.residual(position, sharp).square().sum()
    assert float(difference) == pytest.approx(9.25)


@pytest.mark.parametrize("longer", [1.0, 1.02])
def test_what_a_ruler_says_is_not_given_up_for_the_sake_of_a_fit(lab, longer):
    """A plate that is 2 % longer than the ruler said 0.5 mm about is not fitted by making it longer."""
    true = plate(sides=(longer * SIDES[0], SIDES[1]))
    held = with_tolerances(plate({"plate.youngs_modulus": Searched(1.8e11, 2.3e11)}), RULER)
    builder = bench_of(lab, held, true)
    start = torch.full((1, len(held.model.names)), 0.5, dtype=torch.float64)
    found = fit(builder, builder.given, start, held.prior)
    value = dict(zip(found.model.names, found.theta.tolist(), strict=True))
    spread = held.prior["sides.ratio"][1]
    assert abs(value["sides.ratio"] - 1) < 5.01 * spread < 0.011
    if longer == 1.0:
        assert value["sides.ratio"] == pytest.approx(1.0, abs=spread)
        assert value["plate.youngs_modulus"] == pytest.approx(KNOWN["plate.youngs_modulus"], rel=2e-3)
        assert found.prior < 4
        assert found.reduced_misfit < 1.15
    else:
        # It costs what it must, and the misfit stays to be explained.
        assert found.prior > 10
        assert found.reduced_misfit > 3


@torch.no_grad()
def test_along_a_valley_of_the_data_what_is_known_decides(lab):
    """E h³ and ρ h are all that a plate shows: a density 3 standard deviations off fits as well as the true one."""
    box = {"plate.youngs_modulus": Searched(1.5e11, 3e11), "plate.thickness": Searched(0.0026, 0.0034)}
    held = with_tolerances(plate(box), {"plate.density": 200.0})
    builder = bench_of(lab, held, plate())
    density = 7250.0
    thickness = 0.003 * 7850.0 / density
    values = {"plate.density": density, "plate.thickness": thickness}
    values["plate.youngs_modulus"] = 2.05e11 * (0.003 / thickness) ** 3
    theta = torch.tensor([values[name] for name in held.model.names], dtype=torch.float64)
    found = fit(builder, builder.given, held.model.space.to_cube(theta)[None], held.prior, wide=False)
    ended = dict(zip(found.model.names, found.theta.tolist(), strict=True))
    assert ended["plate.density"] == pytest.approx(7850.0, abs=10.0)
    assert ended["plate.thickness"] == pytest.approx(0.003, rel=3e-3)
