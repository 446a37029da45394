"""Names that only the mesh tells apart."""

import pytest
import torch

from torchplate.diagnosis import diagnose
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.effects import CATALOGUE, HystereticDamping, Plate
from torchplate.measurement import Imperfections
from torchplate.model import PlateModel, Searched, extrapolate, ritz_basis
from torchplate.plate import Mesh

KNOWN = {
    "plate.youngs_modulus": 2e11, "plate.poisson_ratio": 0.3, "plate.density": 7860.0, "plate.thickness": 0.0027,
    "loss.stiffness_loss_factor": 6e-3,
}  # fmt: skip
MASS = 0.0255
NOTHING = torch.zeros(0, dtype=torch.float64)
RESPONSE, REFERENCE = [46], [4, 13, 21, 27, 34, 48, 69, 75, 81, 93, 107, 120]


def plate(refine: int, searched=None, **more) -> PlateModel:
    effects = {"plate": Plate(), "loss": HystereticDamping(), **{name: CATALOGUE[name]() for name in more}}
    known = KNOWN | {f"{name}.{key}": value for name, own in more.items() for key, value in own.items()}
    known = {name: value for name, value in known.items() if name not in (searched or {})}
    mesh = Mesh(0.48, 0.48, 10, 10, refine=refine)
    return PlateModel(mesh, effects, known, searched or {}, RESPONSE, REFERENCE, "accelerance")


@torch.no_grad()
@pytest.mark.check
def test_of_one_response_a_mass_that_moves_with_the_sensor_is_named_where_a_mass_nearby_stands_in_for_the_mesh(lab):
    """A mass of the plate may sit a tenth of a millimetre off, and so make up for what the mesh gives under it."""
    frequency = torch.linspace(20.0, 400.0, 191, dtype=torch.float64)
    truth = extrapolate(plate(7, roving_mass={"mass": MASS}), 400.0).model
    basis = ritz_basis(truth, NOTHING[None], torch.tensor([400.0], dtype=torch.float64), 0, 3.0)
    exact = truth.projected(basis).frf(NOTHING, frequency)
    frf = exact + lab.noise_of(lab.true_std(exact, 0.004, "signal"), 5)
    box = {"plate.youngs_modulus": Searched(1.8e11, 2.2e11), "loss.stiffness_loss_factor": Searched(1e-3, 5e-2, True)}
    measurement = lab.measured(frequency, frf, RESPONSE, REFERENCE)
    found = diagnose(plate(1, box), measurement, imperfections=Imperfections(0.0, 0.0, 0.0, 0.0))
    assert [one.name for one in found.effects if one.name != "mesh_discretisation"] == ["roving_mass"]
    mass = found.effects[-1].parameters["mass"]
    assert mass.low < MASS < mass.high


@torch.no_grad()
@pytest.mark.check
def test_what_a_hypothesis_puts_on_the_plate_is_not_in_the_mesh_error_that_others_share(lab):
    target = lab.Scene().builder.target
    heavy = {"x": 0.4, "y": 0.7, "mass": 0.5}

    def seen(first: PlateModel) -> torch.Tensor:
        builder = ModelBuilder(plate(1), target)
        builder.corrected(builder.adopt(first), NOTHING)
        corrected = builder.corrected(builder.given, NOTHING).model
        return builder.reduced(corrected, NOTHING[None]).natural_frequencies(NOTHING)[3:12]

    torch.testing.assert_close(seen(plate(1, point_mass=heavy)), seen(plate(1)), rtol=1e-9, atol=0.0)
