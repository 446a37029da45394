"""Whole diagnoses of what people get wrong: a number written down wrongly, and very little data."""

import pytest
import torch

import torchplate as tp
from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel, Searched, extrapolate

pytestmark = pytest.mark.check

RESPONSE, REFERENCE = (28, 95), (3, 52, 109)
NOBODY = torch.zeros(0, dtype=torch.float64)
BOX = {
    "plate.youngs_modulus": Searched(1.7e11, 2.4e11),
    "wires.stiffness": Searched(600.0, 2500.0),
    "wires.viscous_damping": Searched(0.1, 2.0),
    "loss.stiffness_loss_factor": Searched(1e-4, 5e-2, True),
}


def hammered(lab, lines, hidden=None):
    """FRFs of a finer mesh, its error taken off, with a noise of a hundredth."""
    truth = lab.plate(hidden=hidden)
    effects = truth.effects | {"mesh": CATALOGUE["mesh_discretisation"](refine=2)}
    points = (list(RESPONSE), list(REFERENCE))
    fine = PlateModel(truth.mesh, effects, truth.as_dict(NOBODY), {}, *points, "accelerance")
    with torch.no_grad():
        frf = extrapolate(fine, 400.0).model.frf(NOBODY, lines)
    return lab.measured(lines, frf + lab.noise_of(lab.true_std(frf, 0.01, "mixed"), 5), RESPONSE, REFERENCE)


def believed(lab, changed=None, searched=BOX):
    known = {key: value for key, value in lab.plate().as_dict(NOBODY).items() if key not in searched}
    plain = lab.plate()
    return PlateModel(
        plain.mesh, plain.effects, known | (changed or {}), searched, list(RESPONSE), list(REFERENCE), "accelerance"
    )


def test_a_thickness_that_was_written_down_wrongly_is_named(lab):
    """1.8 ± 0.01 mm in the config, 2.7 mm on the bench: no Young's modulus of steel makes up for that."""
    model = believed(lab, {"plate.thickness": 1.8e-3})
    found = tp.diagnose(model, hammered(lab, lab.lines(2.0)), tolerance={"plate.thickness": 1e-5})
    first = found.effects[1] if found.effects[0].name == "mesh_discretisation" else found.effects[0]
    assert "thickness" in (first.name, *first.equivalent)
    assert found.verdict in ("explained", "partly_explained")


def test_a_light_mass_is_found_in_sixty_lines(lab, device):
    hidden = {"lump": (CATALOGUE["point_mass"](), {"x": 0.27, "y": 0.68, "mass": 0.024})}
    lines = torch.linspace(5.0, 400.0, 60, dtype=torch.float64)
    found = tp.diagnose(believed(lab).to(device), hammered(lab, lines, hidden).to(device))
    (named,) = [one for one in found.effects if one.name != "mesh_discretisation"]
    assert named.name == "point_mass"
    assert named.parameters["mass"].low <= 0.024 <= named.parameters["mass"].high
    assert named.confidence > 0.9
    assert found.verdict == "explained"
