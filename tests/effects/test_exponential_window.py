"""A windowed response record."""

import math

import pytest
import torch

from torchplate.effects import ExponentialWindow, HystereticDamping, Plate
from torchplate.model import PlateModel
from torchplate.plate import Mesh


@pytest.mark.parametrize("rate", [0.5, 3.0])
def test_it_widens_a_peak_by_the_rate_over_pi(rate):
    known = {
        "plate.youngs_modulus": 70e9,
        "plate.poisson_ratio": 0.33,
        "plate.density": 2700.0,
        "plate.thickness": 0.003,
    }
    beta, none = 0.01, torch.zeros(0, dtype=torch.float64)
    effects = {"plate": Plate(), "loss": HystereticDamping(), "window": ExponentialWindow()}
    known |= {"loss.stiffness_loss_factor": beta, "window.rate": rate}
    model = PlateModel(Mesh(0.4, 0.31, 4, 3), effects, known)
    natural = float(model.natural_frequencies(none, 4)[3])
    lines = torch.linspace(0.97 * natural, 1.03 * natural, 4001, dtype=torch.float64)
    power = model.frf(none, lines, [1], [1])[:, 0, 0].abs() ** 2
    above = lines[power > 0.5 * power.max()]
    # Half-power width of a mode: β f of its own, 2σ/2π from the window; the other modes tilt it by a percent or so.
    assert float(above[-1] - above[0]) == pytest.approx(beta * natural + rate / math.pi, rel=0.02)
