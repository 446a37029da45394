"""The analyser's windows, converters and estimators, each against what theory says of it."""

import math
from dataclasses import replace

import pytest
import torch

from torchplate.measurement.virtual.analyser import ANALYSERS, Analyser, Spectra

CPU = torch.device("cpu")
SMALL = Analyser(span=250.0, n_line=100)


def white(*shape: int, seed: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def averaged(analyser: Analyser, force: torch.Tensor, response: torch.Tensor) -> Spectra:
    empty = Spectra.zeros(analyser, 1, response.shape[1], CPU)
    return empty.add(analyser, torch.zeros(len(force), dtype=torch.int64), force, response)


def test_sr785_is_table_2_of_the_paper():
    analyser = ANALYSERS["sr785"]
    force, response = analyser.windows()
    assert (analyser.record, analyser.sample_rate, analyser.n_sample) == (2.0, 1024.0, 2048)
    assert analyser.frequency[[0, 1, -1]].tolist() == [0.0, 0.5, 400.0]
    # Nine samples at 1024 Hz last 8.78906 ms.
    assert force.tolist() == [1.0] * 9 + [0.0] * 2039
    # Rounded up it lasts as long.
    assert torch.equal(replace(analyser, force_window=8.7891e-3).windows()[0], force)
    # One time constant of 1 s.
    assert response[[0, 1024]].tolist() == pytest.approx([1.0, math.exp(-1)], rel=1e-12)


def test_filter_passes_the_span_and_nothing_that_folds_into_it():
    line = SMALL.frequency
    assert torch.equal(SMALL.low_pass(line), torch.ones_like(line))
    # Half of the slope's cosine is rounding: 1e-16, not 0.
    assert float(SMALL.low_pass(SMALL.sample_rate - line).max()) < 1e-15
    assert float(SMALL.low_pass(torch.tensor(1.28 * SMALL.span))) == pytest.approx(0.5)


def test_each_bit_lowers_the_rounding_floor_by_six_decibels():
    signal = 0.9 * (2 * torch.rand(1, 256, generator=torch.Generator().manual_seed(3), dtype=torch.float64) - 1)
    full_scale = torch.tensor([1.0], dtype=torch.float64)
    errors = []
    for bits in (6, 8, 12):
        analyser = replace(SMALL, bits=(bits, 16))
        errors.append(float((analyser.digitise(signal, full_scale, 0) - signal).square().mean().sqrt()))
    # Uniform rounding: step / √12. 256 samples estimate an rms to 3 %; three times that.
    expected = [2 / 2**bits / math.sqrt(12) for bits in (6, 8, 12)]
    assert errors == pytest.approx(expected, rel=0.1)


def test_converter_clips_at_full_scale_and_each_channel_has_its_bits():
    signal = torch.tensor([[-3.0, -0.3, 0.3, 3.0]], dtype=torch.float64)
    analyser = replace(SMALL, n_line=25, bits=(2, 3))
    full_scale = torch.tensor([1.0], dtype=torch.float64)
    assert analyser.digitise(signal, full_scale, 0).tolist() == [[-1.0, -0.5, 0.5, 0.5]]
    assert analyser.digitise(signal, full_scale, 1).tolist() == [[-1.0, -0.25, 0.25, 0.75]]
    assert torch.equal(replace(analyser, bits=None).digitise(signal, full_scale, 0), signal)


def test_noise_of_analyser_and_sensor_add_in_power():
    analyser = replace(SMALL, noise_floor=(0.03, 0.0), sensor_noise=(0.4, 2.0))
    clean = torch.zeros(200, 256, dtype=torch.float64)
    full_scale = torch.full((200,), 10.0, dtype=torch.float64)
    generator = torch.Generator().manual_seed(5)
    force = analyser.with_noise(clean, full_scale, 0, generator)
    response = analyser.with_noise(clean, full_scale, 1, generator)
    # 51200 samples estimate an rms to 0.3 %; three times that.
    assert float(force.square().mean().sqrt()) == pytest.approx(0.5, rel=0.01)
    assert float(response.square().mean().sqrt()) == pytest.approx(2.0, rel=0.01)
    assert float(force[0] @ force[1]) / 256 < 0.1


@pytest.mark.parametrize(
    ("noisy", "h1", "h2"),
    [("force", 1 / 1.25, 1.0), ("response", 1.0, 1.25)],
)
def test_noise_on_the_force_lowers_h1_and_noise_on_the_response_raises_h2(noisy, h1, h2):
    # A gain of 3 with noise of a quarter of the power on one channel; the other estimator stays at 3.
    force = white(4000, SMALL.n_sample, seed=1)
    response = 3 * force[:, None]
    noise = white(4000, SMALL.n_sample, seed=2)
    if noisy == "force":
        force = force + 0.5 * noise
    else:
        response = response + 1.5 * noise[:, None]
    spectra = averaged(SMALL, force, response)
    # 4000 records over 100 lines: a scatter of 1e-3 in the mean, five times that.
    assert float(spectra.frf("H1").abs().mean()) / 3 == pytest.approx(h1, rel=0.005)
    assert float(spectra.frf("H2").abs().mean()) / 3 == pytest.approx(h2, rel=0.005)
    assert float(spectra.coherence().mean()) == pytest.approx(1 / 1.25, rel=0.005)


def test_h1_scatters_as_its_coherence_says():
    # Bendat and Piersol, Random Data: var |H| / |H|² = (1 − γ²) / (2 n γ²), and as much again in the phase.
    n_hit, ratios = 50, []
    for seed in range(10):
        force = torch.zeros(n_hit, SMALL.n_sample, dtype=torch.float64)
        force[:, 3] = 7.0
        response = force[:, None] + 0.4 * white(n_hit, 3, SMALL.n_sample, seed=seed)
        spectra = averaged(SMALL, force, response)
        error = (spectra.frf("H1") - 1)[..., 1:]
        coherence = spectra.coherence()[..., 1:]
        expected = (1 - coherence) / (2 * n_hit * coherence)
        ratios.append(torch.stack([error.real.square() / expected, error.imag.square() / expected]))
    # The residual of n hits has n − 1 free complex numbers, so the mean of one over it is n / (n − 2) too high.
    # 3000 squares of normal numbers: √(2/3000) = 2.6 %. Two and a half times that.
    mean = torch.stack(ratios).mean((0, 2, 3, 4))
    assert mean.tolist() == pytest.approx([n_hit / (n_hit - 2)] * 2, abs=0.065)


def test_sums_keep_the_references_apart():
    force = white(4, SMALL.n_sample, seed=1)
    response = torch.stack([force, -2 * force], dim=1) * torch.tensor([1.0, 5.0, 1.0, 5.0])[:, None, None]
    empty = Spectra.zeros(SMALL, 2, 2, CPU)
    spectra = empty.add(SMALL, torch.tensor([0, 1, 0, 1]), force, response)
    expected = torch.tensor([[1.0, -2.0], [5.0, -10.0]], dtype=torch.complex128)
    for estimator in ("H1", "H2"):
        torch.testing.assert_close(spectra.frf(estimator), expected[..., None].expand(-1, -1, 101))
    torch.testing.assert_close(spectra.coherence(), torch.ones(2, 2, 101, dtype=torch.float64))


def test_dead_channel_reads_zero_with_no_coherence():
    force = white(3, SMALL.n_sample, seed=1)
    spectra = averaged(SMALL, force, torch.zeros(3, 1, SMALL.n_sample, dtype=torch.float64))
    for value in (spectra.frf("H1"), spectra.frf("H2"), spectra.coherence()):
        assert bool((value == 0).all())


@pytest.mark.parametrize(
    "setting",
    [
        {"span": 0.0},
        {"n_line": 90},
        {"n_line": 0},
        {"force_window": 0.0},
        {"exponential_window": -1.0},
        {"n_average": 0},
        {"trigger_level": 1.0},
        {"n_pre_trigger": -1},
        {"n_pre_trigger": 801},
        {"headroom": 0.0},
        {"full_scale": (1.0, 0.0)},
        {"bits": (1, 16)},
        {"bits": (16, 33)},
        {"noise_floor": (-1e-9, 0.0)},
        {"sensor_noise": (0.0, -1.0)},
    ],
    ids=str,
)
def test_setting_outside_its_range_is_refused_with_what_to_do(setting):
    name, value = next(iter(setting.items()))
    with pytest.raises(ValueError, match=r"^Expected an analyser with .*, got .*\. [A-Z].*\.$") as caught:
        Analyser(**setting)
    assert str(value).strip("()") in str(caught.value)
    assert name.split("_")[0] in str(caught.value)
