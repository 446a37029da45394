"""The truth of the blind benchmark against published values, itself on finer splines, and the catalogue's own words."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import torch

from blind.response import Chain, Damping, Test, complex_modes, frf
from blind.ritz import Patch, RitzPlate, matrices, modes
from torchplate.effects import find_effect
from torchplate.model import PlateModel, extrapolate, ritz_basis
from torchplate.plate import Mesh

# The truth of a benchmark that only `make blind` runs.
pytestmark = pytest.mark.check

SQUARE = RitzPlate(1.0, 1.0, 200e9, 0.3, 8000.0, 0.01)
AT = [(0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9)]
PLATE = RitzPlate(
    0.6, 0.36, 70e9, 0.33, 2700.0, 0.003,
    springs=[(*place, 900.0) for place in AT], dashpots=[(*place, 0.6) for place in AT],
)  # fmt: skip


def parameter(plate: RitzPlate, n_span: int = 14) -> np.ndarray:
    """ω a² √(ρh/D)."""
    rigidity = plate.young * plate.thickness**3 / 12 / (1 - plate.poisson**2)
    scale = plate.length_x**2 * np.sqrt(plate.density * plate.thickness / rigidity)
    return 2 * np.pi * modes(plate, n_span).frequency * scale


@pytest.mark.parametrize(
    ("edges", "first", "published"),
    [
        ({}, 3, [13.4682, 19.5961, 24.2702, 34.8009, 34.8009, 61.0932]),
        ({"x0": "clamped"}, 0, [3.4711, 8.5071, 21.2858, 27.1990, 30.9576, 54.1893]),
        (dict.fromkeys(("x0", "x1", "y0", "y1"), "clamped"), 0, [35.9852, 73.3938, 73.3938, 108.2165]),
        (dict.fromkeys(("x0", "x1", "y0", "y1"), "simply_supported"), 0, np.pi**2 * np.array([2, 5, 5, 8])),
    ],
    ids=["free", "cantilever", "clamped", "simply supported"],
)
def test_frequencies_are_the_published_ones(edges, first, published):
    found = parameter(replace(SQUARE, edges=edges))[first : first + len(published)]
    # Four decimals are published; at the corners of a cantilever's clamp both converge slowly, and from above.
    np.testing.assert_allclose(found, published, rtol=6e-5)


HIDDEN = {
    "patch": replace(PLATE, patches=[Patch(0.33, 0.61, 0.25, 0.4)]),
    "mass": replace(PLATE, masses=[(0.31, 0.62, 0.06)]),
    "spring": replace(PLATE, springs=[*PLATE.springs, (0.31, 0.62, 2e4)]),
    "edge": replace(PLATE, edge_springs=[("x0", 1e5, 1e3)]),
    "hinge": replace(PLATE, hinge=(0.43, 2000.0)),
    "shell": replace(PLATE, curvature=(0.2, 0.05)),
    "taper": replace(PLATE, taper=(0.2, -0.1)),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_four_spans_more_change_no_frequency_in_the_band(name):
    coarse, fine = (modes(HIDDEN[name], n).frequency for n in (14, 18))
    in_band = fine < 400
    assert in_band.sum() > 10
    np.testing.assert_allclose(coarse[: len(fine)][in_band[: len(coarse)]], fine[in_band], rtol=2e-5)


@pytest.mark.parametrize("name", HIDDEN)
def test_four_spans_more_change_no_frf_beyond_a_tenth_of_the_least_noise(name):
    test = Test([(0.25, 0.375), (1.0, 0.25)], [(0.75, 0.875)], np.arange(5.0, 400.0), "accelerance")
    coarse, fine = (frf(HIDDEN[name], Damping(1.5e-3), Chain(), test, n) for n in (14, 18))
    # The least noise is 3e-3, the least damping of the suite is this.
    assert np.linalg.norm(coarse - fine) < 4e-4 * np.linalg.norm(fine)


def test_reciprocity_holds_with_all_damping():
    plate = replace(PLATE, patches=[Patch(0.3, 0.6, 0.2, 0.7, 0.3)], dashpots=[*PLATE.dashpots, (0.2, 0.7, 5.0)])
    places = [(0.25, 0.375), (0.75, 0.875)]
    test = Test(places, places, np.linspace(5, 400, 30), "accelerance")
    H = frf(plate, Damping(0.004, 100.0, 1.0), Chain(rate=1.0), test)
    np.testing.assert_allclose(H[:, 0, 1], H[:, 1, 0], rtol=1e-7)


def test_frfs_are_those_of_the_dynamic_stiffness():
    plate = replace(PLATE, patches=[Patch(0.3, 0.6, 0.3, 0.7, 0.5)], dashpots=[*PLATE.dashpots, (0.2, 0.7, 5.0)])
    test = Test([(0.25, 0.375)], [(0.75, 0.875)], np.linspace(5.0, 400.0, 15), "receptance")
    found = frf(plate, Damping(0.004, 50.0, 0.7), Chain(rate=0.5), test, 10)
    whole = matrices(plate, 10)
    ends = whole.rows([*test.response, *test.reference])
    dashpots = np.array(plate.dashpots)
    rows = whole.rows(dashpots[:, :2])
    viscous = rows.T @ (dashpots[:, 2:] * rows)
    direct = []
    for s in test.laplace(0.5):
        impedance = whole.stiffness * (1 + 0.004j) + whole.mass * (50j + 0.7 * s + s**2) + s * viscous
        direct.append(ends[0] @ np.linalg.solve(impedance + 1j * whole.hysteretic, ends[1]))
    # The least noise of the suite is 3e-3.
    assert np.linalg.norm(found[:, 0, 0] - direct) < 2e-4 * np.linalg.norm(direct)


IN_WORDS_OF_THE_CATALOGUE = {
    "aspect_ratio": ({}, {"ratio": 1.1}, replace(PLATE, aspect_ratio=1.1), Damping(0.06), Chain()),
    "orthotropy": (
        {}, {"young_ratio": 1.3, "shear_factor": 0.8},
        replace(PLATE, young_ratio=1.3, shear_factor=0.8), Damping(0.06), Chain(),
    ),
    "thickness_taper": (
        {}, {"slope_x": 0.1, "slope_y": -0.15}, replace(PLATE, taper=(0.1, -0.15)), Damping(0.06), Chain(),
    ),
    "stiffness_loss": (
        {}, {"x": 1 / 3, "y": 0.625, "size": 0.3, "factor": 0.6},
        replace(PLATE, patches=[Patch(1 / 3, 0.625, 0.3, 0.6)]), Damping(0.06), Chain(),
    ),
    "damping_patch": (
        {}, {"x": 1 / 3, "y": 0.625, "size": 0.2, "loss_factor": 0.2},
        replace(PLATE, patches=[Patch(1 / 3, 0.625, 0.2, 1.0, 0.2)]), Damping(0.06), Chain(),
    ),
    "point_mass": ({}, {"x": 0.31, "y": 0.62, "mass": 0.06}, HIDDEN["mass"], Damping(0.06), Chain()),
    "ground_spring": ({}, {"x": 0.31, "y": 0.62, "stiffness": 2e4}, HIDDEN["spring"], Damping(0.06), Chain()),
    "ground_dashpot": (
        {}, {"x": 0.31, "y": 0.62, "viscous_damping": 5.0},
        replace(PLATE, dashpots=[*PLATE.dashpots, (0.31, 0.62, 5.0)]), Damping(0.06), Chain(),
    ),
    "edge_spring": (
        {"edge": "y1"}, {"stiffness": 5e3, "rotational_stiffness": 200.0},
        replace(PLATE, edge_springs=[("y1", 5e3, 200.0)]), Damping(0.06), Chain(),
    ),
    "viscous_damping": (
        {}, {"mass_coefficient": 9.0, "stiffness_coefficient": 5e-5}, PLATE, Damping(0.06, 0.0, 9.0, 5e-5), Chain(),
    ),
    "exponential_window": ({}, {"rate": 4.0}, PLATE, Damping(0.06), Chain(rate=4.0)),
    "time_delay": ({}, {"delay": 4e-4}, PLATE, Damping(0.06), Chain(delay=4e-4)),
    "air_loading": ({}, {"density": 3.0}, replace(PLATE, air=3.0), Damping(0.06), Chain()),
    "directional_damping": (
        {}, {"loss_x": 0.02, "loss_y": 0.11, "loss_xy": 0.05},
        replace(PLATE, loss=(0.02, 0.11, 0.05)), Damping(0.02), Chain(),
    ),
    "frequency_dependent_loss": ({}, {"exponent": 0.6}, PLATE, Damping(0.06, exponent=0.6), Chain()),
    "roving_mass": ({}, {"mass": 0.03}, PLATE, Damping(0.06), Chain(sensor_mass=0.03)),
    "sensor_position": (
        {"response": [2 / 3, 0.25]}, {"dx": 0.02, "dy": -0.03}, PLATE, Damping(0.06), Chain(offset={1: (0.02, -0.03)}),
    ),
    "channel_polarity": (
        {"channels": [([2 / 3, 0.25], None)]}, {}, PLATE, Damping(0.06), Chain(sign=np.array([[1, 1], [-1, -1]])),
    ),
    "channel_swap": (
        {"channels": [([2 / 3, 0.25], None), ([0.25, 0.375], None)]}, {},
        PLATE, Damping(0.06), Chain(reading=np.array([2, 3, 0, 1])),
    ),
}  # fmt: skip


# Of the section, of a place and of the sensor chain one goes with `make test`; each takes more than a second.
SHORT = ("orthotropy", "point_mass", "sensor_position")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in SHORT else pytest.mark.check) for name in IN_WORDS_OF_THE_CATALOGUE],
)
def test_an_effect_means_here_what_it_means_in_the_catalogue(name):
    options, parameters, plate, damping, chain = IN_WORDS_OF_THE_CATALOGUE[name]
    test = Test([(0.25, 0.375), (2 / 3, 0.25)], [(1 / 12, 0.625), (0.75, 0.875)], np.linspace(8, 200, 7), "accelerance")
    truth = frf(plate, damping, chain, test)
    effects = {
        "plate": find_effect("plate")(),
        "wires": find_effect("support_spring")(at=AT),
        "loss": find_effect("hysteretic_damping")(),
        "hidden": find_effect(name)(**options),
    }
    known = {
        "plate.youngs_modulus": 70e9, "plate.poisson_ratio": 0.33, "plate.density": 2700.0, "plate.thickness": 0.003,
        "wires.stiffness": 900.0, "wires.viscous_damping": 0.6,
        "loss.stiffness_loss_factor": damping.beta, "loss.mass_loss_factor": damping.eta,
    } | {f"hidden.{key}": value for key, value in parameters.items()}  # fmt: skip
    errors = []
    for refine in (1, 2):
        mesh = Mesh(0.6, 0.36, 12, 8, refine=refine)
        model = PlateModel(mesh, effects, known, {}, test.response, test.reference, "accelerance")
        found = model.frf(torch.zeros(1, 0, dtype=torch.float64), torch.from_numpy(test.frequency))[0].numpy()
        errors.append(np.linalg.norm(found - truth) / np.linalg.norm(truth))
    # Elements converge as 1/refine²; across a patch's edge that cuts them only as 1/refine.
    assert errors[1] < (0.65 if name == "stiffness_loss" else 0.3) * errors[0]
    assert errors[1] < 0.03


@pytest.mark.parametrize(
    ("name", "patch"),
    [
        ("damping_patch", {"x": 0.719, "y": 0.325, "size": 0.324, "loss_factor": 0.135, "aspect": 1.49}),
        ("stiffness_loss", {"x": 0.719, "y": 0.325, "size": 0.324, "factor": 0.5, "aspect": 1.49}),
        ("stiffness_loss", {"x": 0.31, "y": 0.57, "size": 0.17, "factor": 0.3, "aspect": 0.8}),
    ],
    ids=["loss", "soft", "softer"],
)
def test_a_patch_whose_edges_cut_elements_moves_modes_as_in_splines(name, patch):
    sides, told = (0.48, 0.475), {"young": 1.94e11, "poisson": 0.3, "density": 7850.0, "thickness": 0.0027}
    under = Patch(patch["x"], patch["y"], patch["size"], patch.get("factor", 1.0), patch.get("loss_factor", 0.0))
    truth = RitzPlate(*sides, *told.values(), patches=[replace(under, aspect=patch["aspect"])])
    known = dict(zip(("youngs_modulus", "poisson_ratio", "density", "thickness"), told.values(), strict=True))
    values = {f"plate.{key}": value for key, value in known.items()}
    effects = {"plate": find_effect("plate")(), "patch": find_effect(name)()}
    model = PlateModel(Mesh(*sides, 14, 14), effects, values | {f"patch.{key}": value for key, value in patch.items()})
    found = modes(truth)
    expected = found.eigenvalue[3:15].astype(complex)
    if under.loss_factor:
        at = found.deflection([(0.1, 0.2)])
        expected = np.sort_complex(complex_modes(found, 1.0, at, at)[0])[3:15]
    whole = extrapolate(model, 400.0).model
    nothing = torch.zeros(1, 0, dtype=torch.float64)
    seen = whole.projected(ritz_basis(whole, nothing, torch.tensor([400.0], dtype=torch.float64), 0, 3.0))
    system = seen.assembly.system(*seen.plan(nothing[0]))
    stiffness = system.stiffness.numpy().astype(complex)
    if system.hysteretic is not None:
        stiffness += 1j * system.hysteretic.numpy()
    value = np.sort_complex(scipy.linalg.eigvals(stiffness, system.mass.numpy()))[3:15]
    # Where laminates were all there was: three ten-thousandths of a frequency, and two thousandths of a loss factor.
    np.testing.assert_allclose(value.real**0.5, expected.real**0.5, rtol=1e-4)
    np.testing.assert_allclose(value.imag / value.real, expected.imag / expected.real, rtol=1e-3, atol=1e-9)
