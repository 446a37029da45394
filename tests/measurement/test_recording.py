"""Hits are found, cut, and thrown away where they are double or clipped; FRFs of them are those of pyFRF."""

import contextlib
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from torchplate.measurement import Cutting, MeasurementError, Recording, Windows, cut, estimate, frf_of_hits

_spec = importlib.util.spec_from_file_location("hits", Path(__file__).with_name("hits.py"))
assert _spec
assert _spec.loader
made = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(made)


def recording(channels: np.ndarray, reference: int = 12, source: str = "test") -> Recording:
    return Recording(
        made.RATE, channels[0], channels[1:], reference, (7, 2)[: len(channels) - 1], "acceleration", True, source
    )


def several(n: int = 4, noise: float = 0.003) -> list[Recording]:
    return [recording(made.hit(12, peak=30.0 + 7 * i, noise=noise, seed=i)) for i in range(n)]


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
def test_the_estimators_agree_with_pyfrf_to_a_thousandth(estimator):
    import pyFRF

    hits = cut(several(noise=0.02), Cutting(duration=1.5))
    ours = estimate(hits, estimator=estimator)
    # Accelerance is asked for as if the responses were displacements: pyFRF then leaves the spectra as they are.
    theirs = pyFRF.FRF(int(made.RATE), hits.force[:, None], hits.response, resp_type="d", frf_estimator=estimator)
    expected = theirs.get_FRF(frf_estimator=estimator)[:, 0].T
    band = (ours.frequency > 20) & (ours.frequency < 250)
    np.testing.assert_allclose(ours.frf[band], expected[band], rtol=1e-3)
    np.testing.assert_allclose(ours.coherence[band], theirs.get_coherence().T[band], atol=1e-3)


def test_the_frf_is_that_of_the_structure():
    measurement = frf_of_hits([recording(made.hit(12)), recording(made.hit(12, peak=25.0))])
    frequency = measurement.frequency.numpy()
    s = 2j * np.pi * frequency
    expected = np.zeros(len(s), dtype=complex)
    for (f, z), a, b in zip(made.MODES, made.SHAPES[7], made.SHAPES[12], strict=True):
        w = 2 * np.pi * f
        expected += a * b * s**2 / (w**2 + 2 * z * w * s + s**2)
    band = (frequency > 30) & (frequency < 200)
    j = [c.node for c in measurement.response].index(7)
    found = measurement.frf[:, j, 0].numpy()[band]
    # The sampled impulse response is aliased: 2 % of the level at a tenth of the rate.
    assert np.linalg.norm(found - expected[band]) < 0.02 * np.linalg.norm(expected[band])
    assert float(frequency[-1]) <= made.RATE / 2.56


def test_an_exponential_window_adds_the_damping_that_the_effect_takes_off():
    tau = 0.35
    hits = cut([recording(made.hit(12, start=30))], Cutting(pre_trigger=0.01))
    found = estimate(hits, Windows(exponential=tau))
    s = 2j * np.pi * found.frequency + 1 / tau
    expected = np.zeros(len(s), dtype=complex)
    for (f, z), a, b in zip(made.MODES, made.SHAPES[7], made.SHAPES[12], strict=True):
        w = 2 * np.pi * f
        expected += a * b * s**2 / (w**2 + 2 * z * w * s + s**2)
    band = (found.frequency > 30) & (found.frequency < 200)
    assert np.linalg.norm((found.frf[:, 0] - expected)[band]) < 0.02 * np.linalg.norm(expected[band])


def test_a_force_window_keeps_the_noise_after_the_pulse_out():
    noisy = [recording(made.hit(12, noise=0.01, seed=i)) for i in range(3)]
    hits = cut(noisy, Cutting(double_hit=None))
    clean = estimate(cut([recording(made.hit(12))], Cutting()))
    band = (clean.frequency > 30) & (clean.frequency < 200)
    quiet = estimate(hits, Windows(force=0.03)).frf - clean.frf
    loud = estimate(hits).frf - clean.frf
    assert np.linalg.norm(quiet[band]) < 0.8 * np.linalg.norm(loud[band])


def test_a_long_recording_is_cut_into_its_hits():
    long = np.concatenate([made.hit(12, n=3000, start=200 + 40 * i, peak=20.0 + i) for i in range(4)], axis=1)
    hits = cut([recording(long)], Cutting(duration=1.2))
    assert len(hits.force) == 4
    # Each begins the pre-trigger before it crosses the threshold.
    lead = round(0.01 * made.RATE)
    for force in hits.force:
        assert np.flatnonzero(force > 0.1 * long[0].max())[0] == lead


def test_a_hit_that_bounced_is_thrown_away_and_named():
    good, double = made.hit(12), made.hit(12, bounce=0.4)
    hits = cut([recording(good), recording(double, source="second")], Cutting())
    assert len(hits.force) == 1
    assert hits.rejected == ("second, hit 1: the hammer hit twice",)
    assert len(cut([recording(good), recording(double)], Cutting(double_hit=None)).force) == 2


@pytest.mark.parametrize(("channel", "words"), [(0, "force channel"), (2, "response channel")])
def test_a_clipped_channel_is_thrown_away_and_named(channel, words):
    clipped = made.hit(12)
    limit = 0.6 * np.abs(clipped[channel]).max()
    clipped[channel] = clipped[channel].clip(-limit, limit)
    hits = cut([recording(made.hit(12)), recording(clipped, source="loud")], Cutting(overload=2))
    assert len(hits.rejected) == 1
    assert words in hits.rejected[0]


def test_a_test_without_one_good_hit_is_refused():
    with pytest.raises(MeasurementError, match=r"the hammer hit twice.*--keep-all"):
        cut([recording(made.hit(12, bounce=0.4))], Cutting())


def test_a_hammer_wired_the_other_way_round_is_found_all_the_same():
    channels = made.hit(12)
    channels[0] *= -1
    assert len(cut([recording(channels)], Cutting()).force) == 1


def test_references_are_averaged_apart_and_put_together():
    records = [recording(made.hit(node, peak=20.0 + i), node) for node in (12, 7) for i in range(2)]
    measurement = frf_of_hits(records)
    assert [c.node for c in measurement.reference] == [7, 12]
    assert [c.node for c in measurement.response] == [2, 7]
    assert bool(measurement.measured.all())
    assert measurement.coherence is not None
    # H is reciprocal: hit at 7 and read at 2, against the pair's own shapes.
    low = measurement.frequency < 100
    peak = int(measurement.frf[low, 0, 0].abs().argmax())
    assert float(measurement.frequency[peak]) == pytest.approx(61.0, abs=1.0)
    assert float(measurement.frf[peak, 0, 0].imag) * made.SHAPES[2][0] * made.SHAPES[7][0] > 0


def test_a_single_hit_has_no_coherence():
    assert frf_of_hits([recording(made.hit(12))]).coherence is None


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"trigger": 1.5}, "trigger"), ({"pre_trigger": -1.0}, "pre-trigger"), ({"duration": 0.0}, "duration")],
)
def test_settings_outside_their_range_are_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        Cutting(**settings)


@pytest.mark.parametrize("rate", [1e-320, 1e308])
def test_a_rate_that_no_clock_has_makes_a_record_or_a_sentence(rate):
    hit = made.hit(12)
    slow = Recording(rate, hit[0], hit[1:], 12, (7, 2), "acceleration", True, "test")
    with contextlib.suppress(MeasurementError):
        frf_of_hits([slow])
    with pytest.raises(MeasurementError, match="the record ends before the hit has"):
        cut([recording(hit)], Cutting(duration=1e300))


def test_a_flat_force_channel_is_refused():
    channels = made.hit(12)
    channels[0] = 0
    with pytest.raises(MeasurementError, match="got a flat one"):
        cut([recording(channels)], Cutting())
