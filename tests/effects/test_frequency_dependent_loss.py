"""A loss factor that goes with a power of the frequency, and the modulus that causality ties to it."""

import math

import numpy as np
import pytest
import torch

from torchplate.effects import FrequencyDependentLoss, HystereticDamping, Plate, SupportSpring, ViscousDamping
from torchplate.model import PlateModel, Searched, SparseModel, reduce
from torchplate.plate import Mesh
from torchplate.plate.power_law import FADES, LOWEST_FREQUENCY, REFERENCE_FREQUENCY, power_law

NONE = torch.zeros(0, dtype=torch.float64)
LINES = torch.linspace(20.0, 400.0, 61, dtype=torch.float64)
WOOD = {"plate.youngs_modulus": 3e9, "plate.poisson_ratio": 0.28, "plate.density": 430.0, "plate.thickness": 0.003}
MESH = Mesh(0.5, 0.3, 8, 6)
BETA = 0.02


def build(exponent: float = 0.0, searched: dict | None = None, **more: float) -> PlateModel:
    effects = {
        "plate": Plate(),
        "wires": SupportSpring(at=((0.21, 0.0), (0.66, 0.94))),
        "loss": HystereticDamping(),
        "law": FrequencyDependentLoss(),
        "rayleigh": ViscousDamping(),
    }
    known = WOOD | {"wires.stiffness": 200.0, "wires.viscous_damping": 0.4, "loss.stiffness_loss_factor": BETA}
    known |= {"law.exponent": exponent} | {f"rayleigh.{name}": value for name, value in more.items()}
    known = {key: value for key, value in known.items() if key not in (searched or {})}
    return PlateModel(MESH, effects, known, searched, [3, (0.6, 0.7)], [8], "accelerance")


def distance(first: torch.Tensor, second: torch.Tensor) -> float:
    return float((first - second).norm() / second.norm())


def law(exponent: float, frequency: np.ndarray) -> np.ndarray:
    s = torch.from_numpy(2j * np.pi * frequency)
    return power_law(torch.tensor(exponent, dtype=torch.float64), s).numpy()


@pytest.mark.parametrize("exponent", [-0.6, 0.3, 0.8])
def test_the_loss_goes_with_a_power_of_the_frequency(exponent: float):
    frequency = np.array([3.0, REFERENCE_FREQUENCY, 700.0])
    np.testing.assert_allclose(law(exponent, frequency).imag, (frequency / REFERENCE_FREQUENCY) ** exponent, rtol=1e-12)
    assert law(exponent, frequency)[1] == pytest.approx(1j)


@pytest.mark.parametrize("exponent", [-0.6, 0.8])
def test_below_the_lowest_frequency_the_law_is_held_as_it_is_there(exponent: float):
    below, at = law(exponent, np.array([LOWEST_FREQUENCY / 30, LOWEST_FREQUENCY]))
    assert below == pytest.approx(at, rel=1e-12)
    assert at.imag == pytest.approx((LOWEST_FREQUENCY / REFERENCE_FREQUENCY) ** exponent, rel=1e-12)


@pytest.mark.parametrize("exponent", [-0.5, 0.15, 0.5, 0.8])
def test_the_modulus_is_that_of_kramers_and_kronig(exponent: float):
    # With exp(+iωt) Re(ω) − Re(ω₀) = −2/π ⨍ Ω Im(Ω) (1/(Ω² − ω²) − 1/(Ω² − ω₀²)) dΩ, here over u = ln Ω/ω₀ with the
    # points evenly about both poles.
    step = 2e-3
    u = step * (np.arange(-60_000, 60_000) + 0.5)
    omega, at = np.exp(u), step * np.array([-700, 500])
    loss = np.exp(exponent * u)
    for place in at:
        kernel = 1 / (omega**2 - np.exp(2 * place)) - 1 / (omega**2 - 1)
        expected = -2 / math.pi * step * (omega**2 * loss * kernel).sum()
        found = law(exponent, REFERENCE_FREQUENCY * np.exp(np.array([place]))).real[0]
        # The modulus of an exponent near zero fades in: by (0.01 / n)².
        assert found == pytest.approx(expected, rel=1e-3 + 1.01 * (FADES / exponent) ** 2)


def test_an_exponent_of_one_is_a_viscous_loss():
    viscous = build(stiffness_coefficient=BETA / (2 * math.pi * REFERENCE_FREQUENCY))
    viscous = viscous.replaced(known=viscous.known_values | {"loss.stiffness_loss_factor": 0.0})
    assert distance(build(1.0).frf(NONE, LINES), viscous.frf(NONE, LINES)) < 1e-9
    # In the record of a windowed response, too.
    assert distance(build(1.0).frf(NONE, LINES, decay=3.0), viscous.frf(NONE, LINES, decay=3.0)) < 1e-9


def test_around_zero_it_is_smooth_and_at_zero_the_plain_loss():
    plain, near = build().frf(NONE, LINES), build(1e-6).frf(NONE, LINES)
    assert distance(near, plain) < 1e-3
    known = {key: value for key, value in build().known_values.items() if not key.startswith("law")}
    bare = build().replaced(effects={k: v for k, v in build().effects.items() if k != "law"}, known=known)
    assert distance(plain, bare.frf(NONE, LINES)) < 1e-10


def test_a_static_line_stays_finite():
    found = build(-0.7).frf(NONE, [0.0, 1e-4, 5.0], kind="receptance")
    assert bool(found.isfinite().all())


def test_sparse_matrices_answer_as_the_modal_sum_does():
    model = build(0.45)
    assert distance(SparseModel(model, NONE).frf(LINES), model.frf(NONE, LINES)) < 1e-7


def test_plates_that_share_their_modes_share_them_whatever_the_law():
    searched = {"plate.youngs_modulus": Searched(2.5e9, 3.5e9), "law.exponent": Searched(-0.8, 0.8)}
    searched |= {"loss.stiffness_loss_factor": Searched(1e-3, 5e-2, logarithmic=True)}
    model = build(0.0, searched)
    outcome = reduce(model, LINES)
    assert outcome is not None
    small, error = outcome
    assert small.shared_modes is not None
    theta = model.space.to_si(torch.rand(9, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(4)))
    assert distance(small.frf(theta, LINES), model.frf(theta, LINES)) < 5 * max(error, 1e-9)


@pytest.mark.parametrize("exponent", [-0.8, 0.8])
def test_a_mode_whose_damping_scatters_scatters_about_its_own_law(exponent: float):
    factor, slight = 1.4, {"loss.stiffness_loss_factor": 1e-3, "wires.viscous_damping": 0.0}
    plain = build(exponent)
    plain = plain.replaced(known=plain.known_values | slight)
    scattered = plain.with_damping_factors(torch.full((20,), factor, dtype=torch.float64))
    found = plain.natural_frequencies(NONE, 12)
    lowest = found[3]
    assert float(lowest) < 0.7 * REFERENCE_FREQUENCY
    # Around a lone peak the motion is inverse to the damping; where it stands its modulus says.
    lines = torch.linspace(0.99, 1.01, 401, dtype=torch.float64) * lowest
    levels = [one.frf(NONE, lines)[:, 1, 0].abs().max() for one in (plain, scattered)]
    assert float(levels[0] / levels[1]) == pytest.approx(factor, rel=0.02)


def test_one_backward_pass_has_the_gradient_of_the_direct_solve():
    searched = {"plate.youngs_modulus": Searched(2.5e9, 3.5e9), "law.exponent": Searched(-0.8, 0.8)}
    searched |= {"loss.stiffness_loss_factor": Searched(1e-3, 5e-2), "wires.stiffness": Searched(100.0, 300.0)}
    model, gradients = build(0.0, searched), []
    for way in (model.frf, model.frf_direct):
        at = torch.tensor([[0.3, 0.7, 0.4, 0.6]], dtype=torch.float64, requires_grad=True)
        level = way(model.space.to_si(at), LINES[::6]).abs().square().log().sum()
        gradients.append(torch.autograd.grad(level, at)[0][0])
    # Rounding at the scale of the highest eigenvalue.
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-6, atol=1e-6)
