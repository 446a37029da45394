"""Modes estimated from FRFs that a model made are the model's; what cannot be estimated is said."""

import importlib
import inspect

import numpy as np
import pytest
import torch

from torchplate.discrepancy import mac
from torchplate.effects import HystereticDamping, Plate
from torchplate.measurement import SI_UNIT, Channel, Measurement, MeasurementError, modes
from torchplate.model import PlateModel, modes_at
from torchplate.plate import Mesh

KNOWN = {
    "plate.youngs_modulus": 2.04e11,
    "plate.poisson_ratio": 0.3,
    "plate.density": 7860.0,
    "plate.thickness": 0.003,
    "loss.stiffness_loss_factor": 0.006,
    "loss.mass_loss_factor": 0.0,
}
NODES = list(range(1, 36))


@pytest.fixture(scope="module")
def plate() -> PlateModel:
    effects = {"plate": Plate(), "loss": HystereticDamping()}
    return PlateModel(Mesh(0.41, 0.29, 6, 4), effects, KNOWN, {}, [1], NODES, "accelerance")


def measured(plate: PlateModel, kind: str, n_response: int = 1) -> Measurement:
    """A hammer that roves over all nodes; a third of a percent of noise."""
    frequency = torch.arange(20.0, 450.0, 0.5, dtype=torch.float64)
    response = NODES[:n_response]
    frf = plate.frf(plate.known.new_zeros(0), frequency, response, NODES, kind)
    noise = torch.randn(frf.shape, dtype=frf.dtype, generator=torch.Generator().manual_seed(3))
    frf = frf + 0.003 * frf.abs().square().mean().sqrt() * noise
    ends = (tuple(Channel(node) for node in nodes) for nodes in (response, NODES))
    return Measurement(frequency, frf, torch.ones(frf.shape[1:], dtype=torch.bool), *ends, kind, SI_UNIT[kind])


@pytest.fixture
def package():
    return pytest.importorskip("sdypy.EMA", reason="sdypy-EMA is an extra: pip install 'torchplate-fem[modal]'")


@pytest.mark.parametrize("kind", ["accelerance", "mobility", "receptance"])
def test_the_modes_of_simulated_frfs_are_those_of_the_model(plate, kind, package):
    found = modes(measured(plate, kind), lowest=50.0)
    true = modes_at(plate, plate.known.new_zeros(0), plate.mesh.places(NODES), 11)
    flexible = true.frequency[(true.frequency > 50) & (true.frequency < 440)]
    assert len(found.model.frequency) == len(flexible)
    # Frequencies of a hysteretic plate are those of the undamped one; its ratio is half the loss factor.
    torch.testing.assert_close(found.model.frequency, flexible, rtol=1e-3, atol=0)
    torch.testing.assert_close(found.model.damping_ratio, torch.full_like(flexible, 0.003), rtol=0.05, atol=0)
    assert [one.node for one in found.model.point] == NODES
    alike = mac(found.model.shape, true.shape[3 : 3 + len(flexible)]).diagonal()
    assert float(alike.min()) > 0.99


def test_of_several_references_the_shapes_are_those_of_the_longer_side(plate, package):
    whole = measured(plate, "accelerance", n_response=2)
    one = modes(whole, lowest=50.0).model
    turned = Measurement(
        whole.frequency, whole.frf.mT, whole.measured.mT, whole.reference, whole.response, whole.kind, whole.unit
    )
    other = modes(turned, lowest=50.0).model
    assert one.shape.shape[1] == other.shape.shape[1] == len(NODES)
    assert float(mac(one.shape, other.shape).diagonal().min()) > 0.999


def test_a_single_frf_says_that_its_shapes_tell_nothing(plate, package):
    whole = measured(plate, "accelerance")
    single = Measurement(
        whole.frequency,
        whole.frf[..., :1],
        whole.measured[:, :1],
        whole.response,
        whole.reference[:1],
        "accelerance",
        "",
    )
    found = modes(single, lowest=50.0)
    assert len(found.model.frequency) >= 5
    assert "1 point only" in found.model.notes[0]


def test_frfs_without_a_mode_are_refused(plate, package):
    whole = measured(plate, "accelerance")
    with pytest.raises(MeasurementError, match="got 3"):
        modes(whole, 100.0, 101.0)
    with pytest.raises(MeasurementError, match="rises"):
        modes(whole, 200.0, 100.0)
    uneven = Measurement(
        whole.frequency**1.01, whole.frf, whole.measured, whole.response, whole.reference, "accelerance", ""
    )
    with pytest.raises(MeasurementError, match="evenly spaced"):
        modes(uneven)
    noise = torch.from_numpy(np.random.default_rng(0).standard_normal(whole.frf.shape)).to(whole.frf)
    silent = Measurement(whole.frequency, noise, whole.measured, whole.response, whole.reference, "accelerance", "")
    with pytest.raises(MeasurementError, match="order after order"):
        modes(silent)


def test_without_the_package_one_sentence_says_how_to_get_it(plate, monkeypatch):
    def absent(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(MeasurementError, match=r"pip install 'torchplate-fem\[modal\]'"):
        modes(measured(plate, "accelerance"))


@pytest.mark.parametrize("given", ["plate", "test.uff"])
def test_what_holds_no_frfs_is_refused_by_its_name(plate, given):
    # Outside the tests nothing checks the types of arguments.
    unchecked = inspect.unwrap(modes)
    with pytest.raises(MeasurementError, match="expected measured FRFs") as told:
        unchecked(plate if given == "plate" else given)
    for words in ("PlateModel" if given == "plate" else "str", "tp.read_measurement(FILE)", "model.modes(theta)"):
        assert words in str(told.value)
