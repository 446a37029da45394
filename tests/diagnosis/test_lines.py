"""Which lines of a large test are looked at."""

from dataclasses import replace

import pytest
import torch

from torchplate.diagnosis import SETTINGS
from torchplate.diagnosis.before_and_after import at_all_lines, gap_of, location_of, overlay_of, step_of
from torchplate.diagnosis.judged import unfitted
from torchplate.diagnosis.lines import about_peaks, every_nth
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.target import FrfTarget
from torchplate.measurement import Channel, Measurement, Noise
from torchplate.measurement.assessment.resonances import Resonances


def a_test(n_line: int, n_reference: int) -> Measurement:
    frequency = torch.linspace(5, 400, n_line, dtype=torch.float64)
    frf = torch.ones(n_line, 1, n_reference, dtype=torch.complex128)
    measured = torch.ones(1, n_reference, dtype=torch.bool)
    references = tuple(Channel(node) for node in range(2, 2 + n_reference))
    return Measurement(frequency, frf, measured, (Channel(1),), references, "receptance", "m/N")


def resonances_of(test: Measurement, n_resonance: int, loss: float = 0.01) -> Resonances:
    place = torch.linspace(20, 380, n_resonance + 1, dtype=torch.float64)
    pole = torch.complex(place.square(), loss * place.square())
    parts = torch.ones(n_resonance + 1, *test.frf.shape[1:], dtype=torch.complex128)
    # The last of them is a line that stands out alone.
    resonates = torch.arange(n_resonance + 1) < n_resonance
    return Resonances(pole, 1e3 * parts, 0 * parts[:2], (5.0, 400.0), resonates)


def noise_of(test: Measurement, resonances: Resonances | None) -> Noise:
    std = 0.01 * test.frf.abs()
    return Noise(std, 0.01, (), torch.zeros_like(std), resonances)


@pytest.mark.parametrize(
    ("n_line", "n_reference", "n_resonance", "n_mode", "kept"),
    [
        (300, 10, 12, 12, 300),
        (677, 15, 16, 16, 333),
        (3200, 6, 16, 16, 833),
        (3200, 121, 16, 16, 160),
        # Ten for each mode are kept, and as many as forty need where no resonance is known.
        (677, 15, 40, 40, 400),
        (3200, 121, 60, 60, 600),
        (3200, 121, None, 16, 400),
        (3200, 121, 0, 16, 400),
        # Records that drift have each mode at two frequencies; and of some modes there is nothing to see.
        (520, 32, 39, 20, 200),
        (520, 32, 13, 40, 156),
    ],
)
def test_as_many_numbers_are_looked_at_as_any_test_counts(n_line, n_reference, n_resonance, n_mode, kept):
    test = a_test(n_line, n_reference)
    resonances = None if n_resonance is None else resonances_of(test, n_resonance)
    found = about_peaks(FrfTarget(test, noise_of(test, resonances), torch.zeros_like(test.measured)), n_mode)
    assert kept <= len(found.frequency) <= 1.1 * kept
    assert found.noise.std.shape[0] == len(found.frequency)
    assert float(found.share.sum()) == n_line


@pytest.mark.parametrize("loss", [1e-4, 1e-3, 1e-2])
def test_every_peak_keeps_lines_however_sharp_it_is(loss):
    """At the same step everywhere a peak that is narrower than the step falls between two lines."""
    test = a_test(3200, 60)
    resonances = resonances_of(test, 16, loss)
    found = about_peaks(FrfTarget(test, noise_of(test, resonances), torch.zeros_like(test.measured)), 16)
    step = float(test.frequency[1] - test.frequency[0])
    for place in resonances.pole.real.sqrt()[:-1].tolist():
        near = max(1.5 * step, loss * place)
        beside = (found.frequency - place).abs()
        there = (test.frequency - place).abs()
        # The nearest line of all, and what says how broad it is.
        assert float(beside.min()) == float(there.min())
        assert int((beside <= near).sum()) >= min(3, int((there <= near).sum()))
    # No part of the band is left out.
    assert float(found.frequency.diff().max()) < 8 * step * len(test.frequency) / len(found.frequency)
    assert (float(found.frequency[0]), float(found.frequency[-1])) == (5.0, 400.0)


@pytest.mark.parametrize(("n_reference", "close"), [(6, 0.01), (15, 0.05), (60, 0.2)])
def test_the_gap_is_nearly_that_of_all_lines(n_reference, close):
    """Lines about the peaks count for themselves, those between for all that they stand for."""
    plain = a_test(3200, n_reference)
    resonances = resonances_of(plain, 16)
    frf = resonances.at(plain.frequency, torch.zeros_like(plain.frequency))
    test = replace(plain, frf=frf)
    whole = FrfTarget(test, noise_of(test, resonances), torch.zeros_like(test.measured))
    thin = about_peaks(whole, 16)
    assert len(thin.frequency) < len(whole.frequency) / 3
    # Off at the peaks, and off everywhere.
    shifted = resonances.at(1.005 * plain.frequency, torch.zeros_like(plain.frequency))
    at = torch.searchsorted(whole.frequency, thin.frequency)
    for model in (shifted, 0.9 * frf + 0.1 * frf.abs().mean()):
        assert float(thin.gap(model[at])) == pytest.approx(float(whole.gap(model)), rel=close)
    level = thin.smoothing.around / whole.smoothing.around[at]
    assert float(level.log().abs().median()) < 2 * close


@pytest.mark.check
def test_what_is_said_is_said_of_all_lines(lab):
    """Gaps, curves and the gap of each FRF, whichever lines were looked at; one FRF is held out, one read as −H."""
    frequency = torch.linspace(10.0, 300.0, 3200, dtype=torch.float64)
    plain, heavy = lab.small_plate(), lab.small_plate(mass=0.02)
    response, reference = plain.response, plain.reference
    clean = heavy.frf(lab.nobody, frequency)
    std = lab.true_std(clean, 0.01, "mixed")
    test = lab.measured(frequency, clean + lab.noise_of(std, 1), response, reference)
    heldout = torch.zeros_like(test.measured)
    heldout[1, 2] = True
    sign = torch.ones_like(heldout, dtype=frequency.dtype)
    sign[0, 1] = -1.0
    noise = Noise(std, lab.true_floor(std, clean), (), torch.zeros_like(std), None)
    thin = about_peaks(FrfTarget(test, noise, torch.zeros_like(heldout)), 10)
    target = thin.holding_out(heldout).turned(sign)
    assert len(target.frequency) < len(frequency) / 2
    without, with_it = (unfitted(ModelBuilder(model, target, as_given=True), model) for model in (plain, heavy))
    found = gap_of(target, without, with_it)
    # Models are evaluated in a basis, which is right to some hundred-thousandths of the smaller gaps.
    curves = [model.frf(lab.nobody, frequency) for model in (plain, heavy)]
    each = [(sign * test.frf - curve).norm(dim=0) / test.frf.norm(dim=0) for curve in curves]
    assert (found.baseline, found.final) == pytest.approx(tuple(float(one[~heldout].mean()) for one in each), rel=1e-4)
    assert (found.heldout_baseline, found.heldout_final) == pytest.approx(
        tuple(float(one[1, 2]) for one in each), rel=1e-4
    )
    step = step_of(target, "+ point_mass", with_it)
    assert (step.gap, step.heldout) == (found.final, found.heldout_final)
    # Of the lines that were looked at alone it would be another.
    assert abs(float(target.gap(without.prediction)) - found.baseline) > 1e-4
    drawn = overlay_of(target, without, with_it)
    assert torch.equal(drawn.measured.frf, test.frf)
    assert torch.equal(drawn.noise, std)
    for shown, curve in zip((drawn.before, drawn.after), curves, strict=True):
        assert float((shown - curve).norm() / curve.norm()) < 1e-4
    size = test.frf.norm(dim=0)
    for one in location_of(target, without, with_it).channels:
        pair = (response.index(int(one.response[:-1])), reference.index(int(one.reference[:-1])))
        gaps = [float((test.frf - curve).norm(dim=0)[pair] / size[pair]) for curve in curves]
        assert (one.before, one.after) == pytest.approx(gaps, rel=1e-4)
        assert one.heldout == bool(heldout[pair])


def test_a_fit_beside_fewer_lines_than_a_target_of_all_is_asked_for_all_of_them(lab):
    """On another mesh fewer modes may be in the band, and lines left out that are looked at here."""
    plate, frequency = lab.small_plate(), lab.SMALL_LINES
    frf = plate.frf(lab.nobody, frequency)
    noise = Noise(0.01 * frf.abs(), 0.01, (), torch.zeros_like(frf.abs()), None)
    test = lab.measured(frequency, frf, plate.response, plate.reference)
    whole = FrfTarget(test, noise, torch.zeros_like(test.measured))
    fit = unfitted(ModelBuilder(plate, every_nth(whole, 2), as_given=True), plate)
    assert len(fit.prediction) < len(frequency)
    # In a basis.
    assert float((at_all_lines(whole, fit) - frf).norm() / frf.norm()) < 1e-4


def test_a_specimen_that_is_known_is_what_is_said_of_all_lines(lab):
    """Of a plate that a reference test told, each damping has its own number: a uniform one would leave a gap."""
    frequency = torch.linspace(10.0, 300.0, 3200, dtype=torch.float64)
    plate = lab.small_plate()
    factor = torch.linspace(0.5, 2.0, 8, dtype=torch.float64)
    odd = plate.with_damping_factors(factor)
    frf = odd.frf(lab.nobody, frequency)
    test = lab.measured(frequency, frf, plate.response, plate.reference)
    std = 0.01 * frf.abs()
    whole = FrfTarget(test, Noise(std, 0.01, (), torch.zeros_like(std), None), torch.zeros_like(test.measured))
    thin = about_peaks(whole, 10)
    fit = unfitted(ModelBuilder(plate, thin, as_given=True), plate)
    fit = fit._replace(reduced=fit.reduced.with_damping_factors(factor))
    uniform, known = (gap_of(thin, fit, fit._replace(as_found=which)).final for which in (False, True))
    assert known < 1e-3 < 0.05 < uniform


def test_no_test_counts_more_numbers():
    assert SETTINGS.lines.most_numbers == pytest.approx(1 / SETTINGS.comparison.misspecified)
