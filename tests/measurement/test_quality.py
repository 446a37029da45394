"""What is said of a measurement alone is true of measurements whose faults are known."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from torchplate.measurement import Channel, Measurement, assess
from torchplate.measurement.assessment.quality import line_noise


def changed(measurement: Measurement, j: int, k: int, factor) -> Measurement:
    frf = measurement.frf.clone()
    frf[:, j, k] = frf[:, j, k] * factor
    return replace(measurement, frf=frf)


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_a_sound_chain_takes_power_at_its_driving_points_and_is_reciprocal(kind, make_measurement):
    quality = assess(make_measurement(kind=kind))
    assert [p.label for p in quality.driving_points] == ["3w/3w", "17w/17w"]
    assert all(p.negative_lines == 0 and p.negative_power == 0 for p in quality.driving_points)
    (exchange,) = quality.reciprocity
    assert (exchange.label, exchange.exchanged) == ("3w/17w", "17w/3w")
    assert exchange.difference < 1e-12
    assert quality.suspicions == ()


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_a_turned_sensor_shows_at_its_driving_point_only(kind, make_measurement):
    quality = assess(changed(make_measurement(kind=kind), 0, 1, -1.0))
    points = {p.label: p.negative_power for p in quality.driving_points}
    assert points == {"3w/3w": 1.0, "17w/17w": 0.0}
    (suspicion,) = quality.suspicions
    assert suspicion.label == "3w/3w"
    assert "wrong sign" in suspicion.reason


def test_a_channel_of_another_gain_breaks_reciprocity_by_its_amount(make_measurement):
    (exchange,) = assess(changed(make_measurement(), 1, 1, 1.2)).reciprocity
    assert exchange.difference == pytest.approx(0.2 / 1.1, rel=1e-12)


def test_driving_points_are_found_by_place_before_node_number(make_measurement):
    whole = make_measurement(responses=(3,), references=(3, 8))
    # Two node numbers at one place, and one number at two places.
    moved = replace(whole, response=(Channel(3, "w", (0.233, 0.07, 0.00105)),))
    assert [p.label for p in assess(moved).driving_points] == ["3w/8w"]


@pytest.mark.parametrize(("scale", "n"), [(1.0, 0), (1e3, 1)])
def test_coordinates_of_hundreds_of_metres_are_suspicious(scale, n, make_measurement):
    right = make_measurement()
    moved = [replace(one, coordinate=tuple(scale * x for x in one.coordinate)) for one in right.response]
    found = [one for one in assess(replace(right, response=tuple(moved))).suspicions if one.label == "coordinates"]
    assert len(found) == n
    assert all("mm that are read as m" in one.reason for one in found)


@pytest.mark.parametrize(("factor", "word"), [(0.0, "dead"), (10**2.5, r"level \+47 dB"), (10**-2.5, "level -52 dB")])
def test_dead_channels_and_wrong_levels_are_named(factor, word, make_measurement):
    # This channel is 2 to 3 dB under the median channel before it is changed by 50 dB either way.
    (suspicion,) = assess(changed(make_measurement(), 1, 2, factor)).suspicions
    assert suspicion.label == "17w/8w"
    assert re.match(word, suspicion.reason)


def test_a_constant_channel_is_named(make_measurement):
    whole = make_measurement()
    frf = whole.frf.clone()
    frf[:, 1, 2] = 3.5 - 1.0j
    (suspicion,) = assess(replace(whole, frf=frf)).suspicions
    assert (suspicion.label, suspicion.reason[:8]) == ("17w/8w", "constant")


@pytest.mark.parametrize("uneven", [False, True])
def test_line_noise_finds_the_noise_that_was_put_in(uneven, make_measurement):
    lines = np.arange(20.0, 150.0, 0.02)
    if uneven:
        lines = lines[np.random.default_rng(5).random(len(lines)) < 0.7]
    whole = make_measurement(lines, responses=(3,))
    draw = torch.randn(whole.frf.shape, generator=torch.Generator().manual_seed(7), dtype=whole.frf.dtype)
    level = whole.frf.abs().median(dim=0).values
    share = torch.tensor([[0.02, 0.05, 0.1]], dtype=torch.float64)
    found = line_noise(replace(whole, frf=whole.frf + draw * share * level))
    # The residue's modulus is Rayleigh: its median is √ln 2 = 0.83 of its rms. 5 % for 4,000 to 6,500 lines.
    torch.testing.assert_close(found, share * 0.8326, rtol=0.05, atol=0.0)


def test_a_noisy_channel_is_named(make_measurement):
    whole = make_measurement()
    draw = torch.randn(len(whole.frequency), generator=torch.Generator().manual_seed(3), dtype=whole.frf.dtype)
    frf = whole.frf.clone()
    frf[:, 0, 2] += 0.3 * frf[:, 0, 2].abs().mean() * draw
    (suspicion,) = assess(replace(whole, frf=frf)).suspicions
    assert suspicion.label == "3w/8w"
    assert suspicion.reason.startswith("noisy")


def test_peaks_are_the_resonances(make_measurement):
    # Loss factors of 2 and 5 % move a peak by η²/8 of its frequency and the other mode's tail a little: a line or two.
    assert assess(make_measurement()).peaks == pytest.approx([41.0, 93.0], abs=0.5)


def test_a_dead_measurement_and_two_lines_have_no_peaks(make_measurement):
    whole = make_measurement()
    assert assess(replace(whole, frf=torch.zeros_like(whole.frf))).peaks == ()
    assert assess(make_measurement(np.array([20.0, 41.0]))).peaks == ()


def test_coherence_is_summed_up_by_pair(make_measurement):
    whole = make_measurement(responses=(3,), references=(3, 8), coherence=True, missing=((0, 0),))
    assert whole.coherence is not None
    coherence = whole.coherence.clone()
    n = len(whole.frequency)
    coherence[:, 0, 1] = 0.95
    coherence[: n // 4, 0, 1] = 0.7
    (summary,) = assess(replace(whole, coherence=coherence)).coherence
    low = (n // 4) / n
    assert summary.label == "3w/8w"
    assert (summary.median, summary.share_low) == (pytest.approx(0.95), pytest.approx(low))
    assert summary.mean == pytest.approx(0.95 - 0.25 * low)


def test_a_transmissibility_has_neither_driving_points_nor_reciprocity(make_measurement):
    quality = assess(make_measurement(kind="transmissibility"))
    assert (quality.driving_points, quality.reciprocity) == ((), ())
    assert quality.band == (20.0, 150.0)


def test_a_straight_line_is_no_noise_on_uneven_lines(make_measurement):
    lines = np.array([20.0, 21.0, 25.0, 26.5, 40.0, 41.0])
    whole = make_measurement(lines, responses=(3,), references=(8,))
    straight = (0.3 - 0.2j) * torch.from_numpy(lines)[:, None, None] + 4.0j
    # Rounding of float64 leaves parts of 1e-16.
    assert float(line_noise(replace(whole, frf=straight))[0, 0]) < 1e-14


def test_an_frf_that_is_not_reciprocal_is_named_with_its_exchange(make_measurement):
    # 1.3 in one of the two: 0.3 / 1.15 = 26 % apart; 1.1 leaves 10 %, which hammer positions alone explain.
    (suspicion,) = assess(changed(make_measurement(), 1, 1, 1.3)).suspicions
    assert (suspicion.label, suspicion.reason) == ("3w/17w", "not reciprocal: 26 % away from 17w/3w")
    assert assess(changed(make_measurement(), 1, 1, 1.1)).suspicions == ()


def test_a_phase_that_drifts_at_a_driving_point_is_named(make_measurement):
    whole = make_measurement()
    delay = torch.exp(-2j * torch.pi * whole.frequency * 0.25 / whole.frequency.max())
    (suspicion,) = assess(changed(whole, 0, 1, delay)).suspicions
    assert suspicion.label == "3w/3w"
    assert suspicion.reason.startswith("phase? At a driving point ")
