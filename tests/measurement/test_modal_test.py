"""The virtual modal test against the FRF of the plate it hits."""

import math
from dataclasses import replace

import pytest
import torch

from torchplate.effects import HystereticDamping, Plate, Searched, SupportSpring, ViscousDamping
from torchplate.measurement import PERFECT, Imperfections, simulate
from torchplate.measurement.measurement import SI_UNIT, Measurement
from torchplate.measurement.virtual.analyser import ANALYSERS, Analyser
from torchplate.measurement.virtual.hammer_test import Hammer, Hits, hammer_test
from torchplate.model import PlateModel
from torchplate.plate import Mesh

KNOWN = torch.zeros(0, dtype=torch.float64)
# Nothing disturbs this one; 20 samples before the trigger hold all that the filter rings ahead.
IDEAL = Analyser(span=400.0, n_line=400, n_average=2, n_pre_trigger=20, bits=None)
STEADY = Hammer(length_scatter=0.0, force_scatter=0.0)
ALUMINIUM = {
    "plate.youngs_modulus": 70e9,
    "plate.poisson_ratio": 0.33,
    "plate.density": 2700.0,
    "plate.thickness": 0.004,
    "mounts.stiffness": 2e4,
    "mounts.viscous_damping": 15.0,
}
STEEL = {"plate.youngs_modulus": 200e9, "plate.poisson_ratio": 0.3, "plate.density": 7860.0, "plate.thickness": 0.0027}
PLATES = {
    "aluminium rectangle": PlateModel(
        Mesh(0.35, 0.25, 4, 3),
        {"plate": Plate(), "mounts": SupportSpring(nodes=(2, 4, 16, 20)), "loss": HystereticDamping()},
        ALUMINIUM | {"loss.stiffness_loss_factor": 0.02},
    ),
    "steel square": PlateModel(
        Mesh(0.48, 0.48, 3, 3, refine=2),
        {"plate": Plate(), "wires": SupportSpring(nodes=(2, 3, 14, 15)), "loss": HystereticDamping()},
        STEEL | {"wires.stiffness": 1171.0, "wires.viscous_damping": 30.0, "loss.stiffness_loss_factor": 0.03},
    ),
}
RECTANGLE = PLATES["aluminium rectangle"]
# As lightly damped as the paper's: no record of Table 2 holds its ringing.
LIVELY = PlateModel(
    Mesh(0.48, 0.48, 5, 5),
    {"plate": Plate(), "wires": SupportSpring(nodes=(2, 5, 32, 35)), "loss": HystereticDamping()},
    STEEL | {"wires.stiffness": 1171.0, "wires.viscous_damping": 0.8, "loss.stiffness_loss_factor": 2e-3},
)


def run(
    model: PlateModel = RECTANGLE,
    analyser: Analyser = IDEAL,
    hammer: Hammer = STEADY,
    kind: str = "accelerance",
    seed: int = 0,
    **points,
) -> Measurement:
    points = {"response": [3, (0.13, 0.42)], "reference": [1, 8, 12]} | points
    generator = torch.Generator().manual_seed(seed)
    return hammer_test(model, KNOWN, analyser=analyser, hammer=hammer, generator=generator, kind=kind, **points)


def gap(measurement: Measurement, model: PlateModel = RECTANGLE, decay: float = 0.0, low: float = 5.0) -> float:
    """Largest ‖measured − model‖ / ‖measured‖ over the pairs, without the lines below `low` Hz."""
    kept = measurement.band(low, 400.0)
    nodes = ([c.node or (0.13, 0.42) for c in channels] for channels in (kept.response, kept.reference))
    expected = model.frf(KNOWN, kept.frequency, *nodes, kept.kind, decay=decay)
    return float(((kept.frf - expected).norm(dim=0) / expected.norm(dim=0)).max())


@pytest.mark.parametrize("plate", PLATES)
def test_quiet_long_test_reads_the_models_frf(plate):
    # 4 s: the slowest mode's decay of 6 /s leaves e^−24. What remains is the filter's ringing cut at both ends of the
    # record, 1e-4 of the pulse.
    measurement = run(PLATES[plate], replace(IDEAL, n_line=1600))
    assert gap(measurement, PLATES[plate]) < 5e-4


@pytest.mark.parametrize("kind", ["accelerance", "mobility", "receptance"])
def test_every_kind_reads_the_models_frf(kind):
    # Viscous: a hysteretic receptance answers before it is hit, with a tail of β / (πω_r t), which no record holds.
    effects = {"plate": Plate(), "mounts": RECTANGLE.effects["mounts"], "loss": ViscousDamping()}
    known = ALUMINIUM | {"loss.mass_coefficient": 10.0, "loss.stiffness_coefficient": 1e-5}
    model = PlateModel(RECTANGLE.mesh, effects, known)
    measurement = run(model, replace(IDEAL, n_line=1600), kind=kind)
    assert (measurement.kind, measurement.unit) == (kind, SI_UNIT[kind])
    assert gap(measurement, model) < 1e-3


@pytest.mark.parametrize("plate", PLATES)
def test_exponential_window_shifts_the_frf_to_s_plus_one_over_tau(plate):
    model, tau = PLATES[plate], 0.25
    measurement = run(model, replace(IDEAL, n_line=1600, exponential_window=tau))
    # The window is at exp(−t/τ) when the pulse comes: half a pulse after the trigger's 20 samples, give or take one.
    time = 20 / IDEAL.sample_rate + STEADY.pulse_length / 2
    level = math.exp(-time / tau)
    levelled = replace(measurement, frf=measurement.frf / level)
    # One sample of time is 0.4 % of level.
    assert gap(levelled, model, decay=1 / tau) < 6e-3
    assert gap(levelled, model) > 0.04


def test_exponential_window_adds_one_over_tau_to_a_modes_decay():
    # Lightly damped, so that the modes stand apart: at 0.01 and 4 /s or more, a record of 4 s still leaves e^−16.
    known = ALUMINIUM | {"mounts.viscous_damping": 2.0, "loss.stiffness_loss_factor": 0.01}
    model = PlateModel(RECTANGLE.mesh, RECTANGLE.effects, known)
    tau, analyser = 0.1, replace(IDEAL, n_line=1600)
    decays = []
    for window in (None, tau):
        measured_with = replace(analyser, exponential_window=window)
        measurement = run(model, measured_with, kind="receptance", reference=[8])
        band = (measurement.frequency > 130) & (measurement.frequency < 250)
        magnitude = measurement.frf[:, 0, 0].abs() * band
        near = slice(int(magnitude.argmax()) - 8, int(magnitude.argmax()) + 9)
        # One mode and the slowly varying rest, H = (a + b s) / (s − p): a line of unknowns in H s = p H + a + b s.
        s, read = 2j * torch.pi * measurement.frequency[near], measurement.frf[near, 0, 0]
        unknown = torch.linalg.lstsq(
            torch.stack([read, torch.ones_like(s), s], dim=1), (read * s)[:, None], driver="gelsd"
        ).solution
        decays.append(-float(unknown[0, 0].real))
    # The rest is not quite a line: 0.3 % seen.
    assert decays[1] - decays[0] == pytest.approx(1 / tau, rel=0.01)


def test_computing_longer_blocks_changes_nothing(monkeypatch):
    # What wraps round is 1e-6 of a mode that does not decay; that H is not analytic across 0 Hz costs about as much.
    quiet = replace(IDEAL, n_average=1, exponential_window=0.5)
    usual = run(LIVELY, quiet)
    monkeypatch.setattr("torchplate.measurement.virtual.hammer_test.N_RECORD_PER_BLOCK", 32)
    longer = run(LIVELY, quiet)
    assert float((usual.frf - longer.frf).norm() / longer.frf.norm()) < 1e-5


def test_table_2_leaves_leakage_of_a_few_percent_and_a_large_apparent_damping():
    quiet = replace(ANALYSERS["sr785"], bits=None, noise_floor=(0.0, 0.0))
    points = {"response": [3], "reference": [8, 14, 29]}
    table_2 = run(LIVELY, quiet, **points)
    assert 0.005 < gap(table_2, LIVELY, decay=1.0) < 0.05
    assert gap(table_2, LIVELY) > 0.15


def test_coherence_is_one_without_noise():
    measurement = run(hammer=Hammer(), analyser=replace(IDEAL, n_line=1600, n_average=6)).band(5.0, 400.0)
    assert measurement.coherence is not None
    # Pulses of different length leave different cut ends, 1e-4 of the pulse: 1 % of the deepest antiresonance.
    assert float(measurement.coherence.min()) > 1 - 5e-4
    assert float(measurement.coherence.median()) > 1 - 1e-7


def test_noise_takes_coherence_where_the_plate_hardly_answers():
    analyser = replace(IDEAL, n_average=10, noise_floor=(0.0, 0.003))
    measurement = run(analyser=analyser, hammer=Hammer()).band(5.0, 400.0)
    magnitude, coherence = measurement.frf.abs(), measurement.coherence
    assert coherence is not None
    weak, strong = magnitude.quantile(0.05), magnitude.quantile(0.95)
    assert float(coherence[magnitude < weak].median()) < 0.9
    assert float(coherence[magnitude > strong].min()) > 0.98


def test_noise_on_the_force_takes_coherence_where_the_pulse_has_no_power():
    # A pulse of 5 ms has its first zero at 300 Hz.
    analyser = replace(IDEAL, n_average=10, noise_floor=(0.003, 0.0))
    measurement = run(analyser=analyser, hammer=Hammer(pulse_length=5e-3, length_scatter=0.0))
    assert measurement.coherence is not None
    at = (measurement.frequency - 300).abs() < 5
    below = (measurement.frequency > 20) & (measurement.frequency < 200)
    assert float(measurement.coherence[at].median()) < 0.8
    assert float(measurement.coherence[below].median()) > 0.99


def test_analysers_estimator_is_the_one_that_is_used():
    noisy = replace(IDEAL, n_average=20, noise_floor=(0.0, 0.01), headroom=3.0)
    h1, h2 = (run(analyser=replace(noisy, estimator=name)) for name in ("H1", "H2"))
    assert h1.coherence is not None
    # By definition |H1| = γ² |H2|, with the same noise in both.
    torch.testing.assert_close(h1.frf, h1.coherence * h2.frf, rtol=1e-9, atol=0.0)
    assert float(h1.coherence.min()) < 0.5


def test_error_of_a_noisy_test_is_the_one_its_coherence_predicts():
    n_hit = 20
    noisy = replace(IDEAL, n_average=n_hit, noise_floor=(0.0, 0.01), headroom=3.0)
    # The same seed draws the same hits: the two differ by the noise alone.
    quiet = run(analyser=replace(noisy, noise_floor=(0.0, 0.0))).band(5.0, 400.0)
    measurement = run(analyser=noisy).band(5.0, 400.0)
    assert measurement.coherence is not None
    error = (measurement.frf / quiet.frf - 1).abs().square() / 2
    ratio = error / ((1 - measurement.coherence) / (2 * n_hit * measurement.coherence))
    trusted = quiet.frf.abs() > quiet.frf.abs().quantile(0.3)
    # n − 1 free complex numbers in the residual: n / (n − 2) on average. 1700 squares of complex normal numbers: 2.5 %;
    # three times that.
    assert float(ratio[trusted].mean()) == pytest.approx(n_hit / (n_hit - 2), abs=0.08)


def test_two_bits_less_raise_the_floor_by_twelve_decibels():
    gaps = [gap(run(analyser=replace(IDEAL, n_line=800, n_average=8, bits=bits))) for bits in ((8, 8), (10, 10))]
    # Rounding of a decaying signal is not quite white noise: a quarter of slack.
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.25)


def test_double_hit_leaves_the_frf_alone_unless_the_force_window_cuts_it():
    bouncing = replace(STEADY, double_hit=1.0, double_hit_delay=0.03, double_hit_ratio=0.5)
    long = replace(IDEAL, n_line=1600, headroom=4.0)
    assert gap(run(analyser=long, hammer=bouncing)) < 2e-3
    cut = replace(long, force_window=0.04)
    assert gap(run(analyser=cut)) < 5e-3
    # Half the force is missing from the spectrum, in and out of phase as frequency goes.
    assert gap(run(analyser=cut, hammer=bouncing)) > 0.3


def test_double_hits_come_as_often_as_asked():
    # Seen through the force window above: some hits bounce, so the averaged FRF is spoiled less and loses coherence.
    cut = replace(IDEAL, n_line=800, n_average=12, headroom=4.0, force_window=0.04)
    seldom = run(analyser=cut, hammer=replace(STEADY, double_hit=0.3, double_hit_delay=0.03))
    always = run(analyser=cut, hammer=replace(STEADY, double_hit=1.0, double_hit_delay=0.03))
    assert 0.02 < gap(seldom) < 0.7 * gap(always)
    assert seldom.coherence is not None
    assert always.coherence is not None
    assert float(seldom.coherence.median()) < 0.99 < float(always.coherence.median())


def hits(**value: float) -> Hits:
    settings = {"peak": 30.0, "length": 2e-3, "start": 0.01, "bounce": 0.0, "delay": 0.02} | value
    return Hits(torch.tensor([0]), *(torch.tensor([number], dtype=torch.float64) for number in settings.values()))


@pytest.mark.parametrize("bounce", [0.0, 0.4])
@pytest.mark.check
def test_force_spectrum_is_the_laplace_transform_of_half_sines(bounce):
    s = torch.complex(torch.full((400,), 1.7, dtype=torch.float64), torch.arange(400, dtype=torch.float64) * 8)
    n = 20000
    time = (torch.arange(n, dtype=torch.float64) + 0.5) * (2e-3 / n)
    half_sine = 30.0 * (torch.pi * time / 2e-3).sin()
    expected = sum(
        scale * torch.exp(-s[:, None] * (time + start)) @ half_sine.to(s) * (2e-3 / n)
        for start, scale in ((0.01, 1.0), (0.03, bounce))
    )
    # The midpoint rule with 20000 steps is good to 1e-9.
    torch.testing.assert_close(hits(bounce=bounce).spectrum(s)[0], expected, rtol=1e-8, atol=1e-12)


def test_force_spectrum_holds_the_energy_of_the_pulse():
    # ∫ f² dt = peak² length / 2 = 2 ∫ |F|² df (Parseval).
    step = 0.5
    frequency = (torch.arange(40000, dtype=torch.float64) + 0.5) * step
    spectrum = hits().spectrum(torch.complex(torch.zeros_like(frequency), 2 * torch.pi * frequency))
    assert 2 * float(spectrum.abs().square().sum()) * step == pytest.approx(30.0**2 * 2e-3 / 2, rel=1e-6)


def test_default_pulse_reaches_the_end_of_the_span_and_a_bounce_ripples_it():
    line = torch.arange(0, 401, dtype=torch.float64)
    s = torch.complex(torch.zeros_like(line), 2 * torch.pi * line)
    single = hits(length=Hammer().pulse_length).spectrum(s)[0].abs()
    assert float(20 * (single[-1] / single[0]).log10()) > -4
    ripple = hits(length=Hammer().pulse_length, bounce=0.4).spectrum(s)[0].abs() / single
    # One over the delay of 20 ms is 50 Hz from crest to crest.
    assert ripple[[0, 25, 50, 75]].tolist() == pytest.approx([1.4, 0.6, 1.4, 0.6], rel=1e-6)


def test_same_seed_same_numbers_another_seed_other_noise():
    analyser = replace(IDEAL, n_line=100, noise_floor=(1e-3, 1e-3))
    first, second, other = (run(analyser=analyser, hammer=Hammer(), seed=seed) for seed in (4, 4, 5))
    assert torch.equal(first.frf, second.frf)
    assert first.coherence is not None
    assert second.coherence is not None
    assert torch.equal(first.coherence, second.coherence)
    assert not torch.allclose(first.frf, other.frf, rtol=1e-6)


def test_few_hits_at_once_read_the_same_as_many():
    analyser = replace(IDEAL, n_line=800, n_average=3)
    many = run(analyser=analyser)
    few = run(analyser=analyser, memory=1)
    # Only the pulse's place between two samples differs, and with it the cut ends.
    assert float((many.frf - few.frf).norm() / many.frf.norm()) < 1e-3


def test_pairs_and_channels_are_those_of_the_test_sheet():
    measurement = run(analyser=replace(IDEAL, n_line=100))
    assert measurement.frf.shape == (101, 2, 3)
    assert [channel.node for channel in measurement.response] == [3, 0]
    assert measurement.response[1].coordinate == pytest.approx((0.13 * 0.35, 0.42 * 0.25, 0.0))
    assert [channel.label for channel in measurement.reference] == ["1w", "8w", "12w"]
    # Node 8 is the third of the second row.
    assert measurement.reference[1].coordinate == pytest.approx((0.35 / 2, 0.25 / 3, 0.0))


def test_auto_range_rejects_the_strong_hits_and_makes_them_again():
    strict = replace(IDEAL, n_line=1600, n_average=4, headroom=1.0)
    measurement = run(analyser=strict, hammer=Hammer())
    assert " 0 more" not in measurement.notes[0]
    assert gap(measurement) < 1e-3


def test_clipped_hits_are_kept_when_nobody_rejects_them():
    strict = replace(IDEAL, n_line=1600, headroom=0.6, bits=(16, 16), overload_reject=False)
    assert gap(run(analyser=strict)) > 0.05
    assert gap(run(analyser=replace(strict, headroom=1.6))) < 2e-3


def test_hits_that_always_clip_or_never_trigger_are_an_error_with_a_way_out():
    # Samples of the force exceed 20 N, those of the response 1 m/s²: each channel alone, then a level never reached.
    for settings in ({"full_scale": (20.0, 1e6)}, {"full_scale": (100.0, 1.0)}, {"full_scale": (1e4, 1e6)}):
        with pytest.raises(ValueError, match=r"at reference 8\. Raise the analyser's headroom"):
            run(analyser=replace(IDEAL, n_line=25, n_average=1, n_pre_trigger=4, **settings), reference=[8])


def test_fixed_ranges_replace_auto_range():
    # 6 bits over a range a hundred times too wide leave a coarse record.
    coarse = replace(IDEAL, n_line=400, bits=(12, 12), trigger_level=0.001)
    assert gap(run(analyser=replace(coarse, full_scale=(80.0, 2e4)))) > 5 * gap(run(analyser=coarse))


@pytest.mark.parametrize(
    ("kind", "theta", "message"),
    [
        ("transmissibility", KNOWN, "got transmissibility, which has no force. Name one of the three"),
        ("compliance", KNOWN, "got 'compliance'. Name one of these"),
        ("accelerance", KNOWN[None], "Test one member at a time"),
    ],
)
def test_what_a_hammer_cannot_measure_is_refused(kind, theta, message):
    with pytest.raises(ValueError, match=message):
        hammer_test(
            RECTANGLE,
            theta,
            response=[3],
            reference=[1],
            analyser=IDEAL,
            hammer=STEADY,
            generator=torch.Generator(),
            kind=kind,
        )


@pytest.mark.parametrize(
    "setting",
    [
        {"pulse_length": 0.0},
        {"peak_force": -1.0},
        {"double_hit_delay": 0.0},
        {"length_scatter": -0.1},
        {"force_scatter": -0.1},
        {"double_hit_ratio": -0.1},
        {"double_hit": 1.1},
    ],
    ids=str,
)
def test_hammer_outside_its_range_is_refused_with_what_to_do(setting):
    name, value = next(iter(setting.items()))
    with pytest.raises(ValueError, match=rf"^Expected a hammer with {name}.*got {value}\. [A-Z]"):
        Hammer(**setting)


def line_of(measurement: Measurement) -> torch.Tensor:
    return measurement.band(20.0, 390.0).frf


def test_a_perfect_test_stays_as_it_was():
    assert torch.equal(run(imperfections=PERFECT).frf, run().frf)
    assert torch.equal(run(imperfections=Imperfections()).frf, run().frf)


@pytest.mark.parametrize("name", ["position_std", "frequency_drift", "calibration_std", "damping_scatter"])
@pytest.mark.check
def test_what_is_not_perfect_changes_the_frfs_as_its_seed_says(name):
    std = Imperfections(**{name: {"position_std": 2e-3, "frequency_drift": 1e-3}.get(name, 0.1)})
    one, again, other = (line_of(run(imperfections=std, seed=seed)) for seed in (1, 1, 2))
    assert torch.equal(one, again)
    # Of the noiseless test the seed decides nothing else but where a pulse falls between two samples: below 5e-4.
    for seed, found in ((1, one), (2, other)):
        plain = line_of(run(seed=seed))
        assert float((found - plain).norm() / plain.norm()) > 5e-3
    assert float((one - other).norm() / one.norm()) > 5e-3


def test_a_calibration_is_one_gain_for_each_channel():
    ratio = line_of(run(imperfections=Imperfections(calibration_std=0.1), seed=3)) / line_of(run(seed=3))
    # The same hits only where none are drawn before them: what is left is where each pulse falls.
    gain = ratio.real.median(dim=0).values
    assert float((ratio - gain).abs().median()) < 2e-3
    # Of rank one: every pair has the gain of its response times that of its reference.
    assert float(torch.linalg.svdvals(gain)[1] / torch.linalg.svdvals(gain)[0]) < 1e-3
    assert float((gain - 1).abs().max()) > 0.02


def test_a_mode_with_another_damping_peaks_as_much_lower():
    effects = {"plate": Plate(), "loss": HystereticDamping()}
    known = {key: value for key, value in ALUMINIUM.items() if key.startswith("plate")}
    model = PlateModel(RECTANGLE.mesh, effects, known | {"loss.stiffness_loss_factor": 2e-3})
    eigen = model.natural_frequencies(KNOWN, 8)
    assert float(eigen[3] / eigen[4]) < 0.99
    factor = torch.tensor([1.0, 1.0, 1.0, 2.0, 0.5], dtype=torch.float64)
    plain, scattered = (
        m.frf(KNOWN, eigen[3:5], [1], [1], "accelerance") for m in (model, model.with_damping_factors(factor))
    )
    # Neighbours add a hundredth or so to a peak of a quality of 500.
    torch.testing.assert_close((scattered / plain).abs().flatten(), 1 / factor[3:5], rtol=0.02, atol=0.0)


class TestSimulate:
    """In one call from Python, as `torchplate simulate` makes it."""

    YOUNG = 70e9
    ANALYSER = Analyser(span=400.0, n_line=50, n_average=1, n_pre_trigger=20, bits=None)

    def plate(self) -> PlateModel:
        known = ALUMINIUM | {"loss.stiffness_loss_factor": 0.02}
        del known["plate.youngs_modulus"]
        searched = {"plate.youngs_modulus": Searched(5e10, 9e10)}
        return PlateModel(RECTANGLE.mesh, RECTANGLE.effects, known, searched)

    def test_it_hits_the_plate_of_these_values(self):
        model, points = self.plate(), {"response": [3], "reference": [1, (0.7, 0.6)]}
        found = simulate(model, [self.YOUNG], analyser=self.ANALYSER, without_mesh=False, seed=7, **points)
        by_hand = hammer_test(
            RECTANGLE, KNOWN, analyser=self.ANALYSER, hammer=Hammer(), generator=torch.Generator().manual_seed(7),
            **points,
        )  # fmt: skip
        # The basis holds to 1e-6 of an FRF's norm on its lines.
        assert (found.frf - by_hand.frf).norm() < 1e-5 * by_hand.frf.norm()
        # A mesh of 4 × 3 elements is off by more than a per cent; the caller's model is left alone.
        better = simulate(model, [self.YOUNG], analyser=self.ANALYSER, seed=7, **points)
        assert (better.frf - by_hand.frf).norm() > 1e-2 * by_hand.frf.norm()
        assert model.response is None

    def test_what_is_no_plate_or_no_analyser_is_refused_with_a_way_out(self):
        model, points = self.plate(), {"response": [3], "reference": [1]}
        with pytest.raises(ValueError, match=r"plate\.youngs_modulus, got none.*Give theta"):
            simulate(model, **points)
        with pytest.raises(ValueError, match=r"shape \(2, 1\).*one member at a time"):
            simulate(model, torch.full((2, 1), self.YOUNG), **points)
        with pytest.raises(ValueError, match=r"analyser of .*sr785.*got 'b'"):
            simulate(model, [self.YOUNG], analyser="b", **points)
