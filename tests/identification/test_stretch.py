"""One look at a test tells h√(E/ρ) and the grain, whatever level and loss."""

import math

import pytest
import torch

from torchplate.effects import HystereticDamping, Orthotropy, Plate, Searched, SupportSpring
from torchplate.identification import stretched
from torchplate.identification.stretch import _variance_apart
from torchplate.measurement import SI_UNIT, Channel, Measurement, peaks, place
from torchplate.model import PlateModel
from torchplate.plate import Mesh

NUMBERS = {"plate.youngs_modulus": 3e9, "plate.poisson_ratio": 0.1, "plate.density": 430.0, "plate.thickness": 1e-3}
PLACES = {"response": [(0.02, 0.03)], "reference": [(0.97, 0.9), (0.31, 0.62)]}
EDGES = {"free": {}, "clamped": {"x0": "clamped"}}


def hit(sides, edges, kind, thickness, ratio, shear, loss=0.01, mesh=(20, 20), cords=0.0) -> Measurement:
    """The FRFs of a plate, in a level of its own."""
    known = NUMBERS | {"plate.thickness": thickness, "loss.stiffness_loss_factor": loss}
    known |= {"grain.young_ratio": ratio, "grain.shear_factor": shear}
    effects = {"plate": Plate(), "grain": Orthotropy(), "loss": HystereticDamping()}
    effects["cords"] = SupportSpring(at=((0.1, 0.2), (0.8, 0.1), (0.3, 0.9)))
    known |= {"cords.stiffness": cords, "cords.viscous_damping": 0.02}
    model = PlateModel(Mesh(*sides, *mesh, edges=edges), effects, known)
    frequency = torch.arange(4.0, 700.0, 0.5, dtype=torch.float64)
    with torch.no_grad():
        frf = 7.3 * model.frf(model.known[:0], frequency, **PLACES, kind=kind)
    ends = {
        name: tuple(Channel(n, "w", (sides[0] * x, sides[1] * y, 0.0)) for n, (x, y) in enumerate(points, start=1))
        for name, points in PLACES.items()
    }
    measured = torch.ones(frf.shape[1:], dtype=torch.bool)
    return Measurement(frequency, frf, measured, **ends, kind=kind, unit=SI_UNIT[kind])


def models(sides, edges) -> PlateModel:
    searched = {"grain.young_ratio": Searched(0.01, 100.0), "grain.shear_factor": Searched(0.1, 10.0)}
    effects = {"plate": Plate(), "grain": Orthotropy()}
    return PlateModel(Mesh(*sides, 9, 8, edges=edges), effects, NUMBERS, searched)


@pytest.mark.parametrize("edges", EDGES.values(), ids=EDGES)
@pytest.mark.parametrize(("sides", "kind"), [((0.58, 0.22), "accelerance"), ((0.4, 0.4), "mobility")])
@pytest.mark.check
def test_the_grain_of_the_test_leaves_least_and_the_factor_is_its_thickness(sides, kind, edges):
    measurement = hit(sides, edges, kind, thickness=0.0043, ratio=0.09, shear=0.75)
    theta = torch.tensor([[1.0, 1.0], [0.09, 0.75], [1 / 0.09, 0.75]], dtype=torch.float64)
    found = stretched(models(sides, edges), theta, measurement, place(measurement, *sides, 4, 4))
    # A square plate that is turned by a right angle has the same natural frequencies, but not at these places.
    assert int(found.left.argmin()) == 1
    # Loss drawn three times as high, and modes of a coarse mesh, leave less than a tenth.
    assert float(found.left[1]) < 0.15
    # Natural frequencies go with the thickness; a step is 1 %, and the coarse mesh 1 % off.
    assert float(found.factor[1]) == pytest.approx(4.3, rel=0.02)
    assert found.n_peak >= 8


def test_a_plate_that_swings_on_its_cords_is_looked_at_where_it_bends():
    """Its first peaks are no modes of a free plate, whose first was looked for within a factor of eight of them."""
    sides = 0.58, 0.22
    measurement = hit(sides, {}, "accelerance", thickness=0.0083, ratio=0.09, shear=0.75, cords=110.0)
    assert peaks(measurement)[0] < 8 < 70 < peaks(measurement)[3]
    theta = torch.tensor([[1.0, 1.0], [0.09, 0.75], [1 / 0.09, 0.75]], dtype=torch.float64)
    found = stretched(models(sides, {}), theta, measurement, place(measurement, *sides, 4, 4))
    assert int(found.left.argmin()) == 1
    assert float(found.left[1]) < 0.15
    assert float(found.factor[1]) == pytest.approx(8.3, rel=0.02)


@pytest.mark.check
def test_a_test_without_resonances_tells_nothing():
    measurement = hit((0.58, 0.22), {}, "accelerance", thickness=0.04, ratio=0.09, shear=0.75)
    theta = torch.tensor([[1.0, 1.0]], dtype=torch.float64)
    assert stretched(models((0.58, 0.22), {}), theta, measurement, place(measurement, 0.58, 0.22, 4, 4)) is None


@pytest.mark.check
def test_pairs_that_were_not_measured_or_are_dead_are_left_out():
    sides = (0.58, 0.22)
    measurement = hit(sides, {}, "accelerance", thickness=0.0043, ratio=0.09, shear=0.75)
    frf, measured = measurement.frf.clone(), measurement.measured.clone()
    frf[3, 0, 0] = 0
    theta = torch.tensor([[0.09, 0.75]], dtype=torch.float64)
    one = Measurement(
        measurement.frequency, frf, measured, measurement.response, measurement.reference, "accelerance", "(m/s²)/N"
    )
    found = stretched(models(sides, {}), theta, one, place(one, *sides, 4, 4))
    assert math.isfinite(float(found.left[0]))
    assert float(found.factor[0]) == pytest.approx(4.3, rel=0.02)


@pytest.mark.parametrize(("n_grid", "n_line", "n_pair"), [(50, 300, 3), (61, 67, 1), (9, 9, 4)])
def test_what_is_left_wherever_the_test_is_laid_on_a_model_is_the_variance_there(n_grid, n_line, n_pair):
    generator = torch.Generator().manual_seed(5)
    measured = 40 * torch.randn(n_grid, n_pair, generator=generator, dtype=torch.float64) + 90
    level = 30 * torch.randn(n_line, n_pair, generator=generator, dtype=torch.float64) - 200
    # One pair has a force on a nodal line of all modes.
    level[:, 0] -= 6000
    apart = measured.mT - level.unfold(0, n_grid, 1)
    expected = apart.flatten(1).var(1, correction=0)
    # Rounding of squares of 6000 dB beside the 50 dB that are left of one pair.
    torch.testing.assert_close(_variance_apart(measured, level), expected, rtol=1e-11, atol=0)
