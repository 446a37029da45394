"""What models are held against: weighed by what is not known, and wide enough to be found from afar."""

import pytest
import torch

from torchplate.diagnosis import target as module
from torchplate.diagnosis.target import FrequencyTarget, FrfTarget
from torchplate.discrepancy.measure import Measured
from torchplate.discrepancy.norms import relative_frf_norm
from torchplate.effects import CATALOGUE
from torchplate.measurement import NaturalFrequencies
from torchplate.measurement.noise import Noise
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

TRUE = 2.05e11
RESPONSE, REFERENCE = (3, 17), (7, 9, 14)
LINES = torch.linspace(10.0, 340.0, 170, dtype=torch.float64)


@pytest.fixture(scope="module")
def plate() -> PlateModel:
    """Young's modulus is searched from half to twice the true one."""
    effects = {
        "plate": CATALOGUE["plate"](),
        "wires": CATALOGUE["support_spring"](nodes=[2, 10, 19]),
        "loss": CATALOGUE["hysteretic_damping"](),
    }
    known = {
        "plate.poisson_ratio": 0.3,
        "plate.density": 7850.0,
        "plate.thickness": 0.003,
        "wires.stiffness": 1500.0,
        "wires.viscous_damping": 0.7,
        "loss.stiffness_loss_factor": 2.5e-2,
    }
    young = {"plate.youngs_modulus": Searched(0.5 * TRUE, 2 * TRUE)}
    return PlateModel(Mesh(0.43, 0.3, 4, 3), effects, known, young, list(RESPONSE), list(REFERENCE), "accelerance")


def predicted(plate, *parts: float):
    return plate.frf(TRUE * torch.tensor(parts, dtype=torch.float64)[:, None], LINES)


@pytest.fixture(scope="module")
def true(plate):
    return predicted(plate, 1.0)[0]


def told(lab, std, frf) -> Noise:
    return Noise(std, lab.true_floor(std, frf), (), torch.zeros_like(std))


def target(lab, frf, share=0.01, heldout=((0, 2),), seed=None, **others) -> FrfTarget:
    std = lab.true_std(frf, share, "mixed")
    noise = 0 if seed is None else lab.noise_of(std, seed)
    measured = lab.measured(LINES, frf + noise, RESPONSE, REFERENCE)
    which = torch.zeros(2, 3, dtype=torch.bool)
    for pair in heldout:
        which[pair] = True
    return FrfTarget(measured, told(lab, std, frf), which, **others)


def test_nothing_is_left_at_the_truth_at_any_level(lab, plate, true):
    here = target(lab, true)
    for level in range(here.levels):
        residual = here.residual(true, level)
        assert float(residual.abs().max()) == 0
        assert float(here.residual(predicted(plate, 1.1)[0], level).abs().max()) > 0.01


def test_model_and_measurement_are_smoothed_by_the_same_operator(lab, plate, true):
    here, (one, other) = target(lab, true), predicted(plate, 0.9, 1.2)
    for level in range(here.levels):
        # What the measurement leaves of one model is linear in that model.
        left, right, mixed = (here.residual(frf, level) for frf in (one, other, 0.3 * one + 0.7 * other))
        assert torch.allclose(mixed, 0.3 * left + 0.7 * right, rtol=1e-9, atol=1e-12)


def test_held_out_frfs_are_in_no_residual(lab, plate, true):
    here, frf = target(lab, true), predicted(plate, 1.1)[0]
    changed = frf.clone()
    changed[:, 0, 2] *= 3
    for level in range(here.levels):
        assert torch.equal(here.residual(changed, level), here.residual(frf, level))
    assert float(here.misfit(changed).heldout) > float(here.misfit(frf).heldout)
    assert torch.equal(here.misfit(changed).fitted, here.misfit(frf).fitted)
    changed[:, 1, 2] *= 3
    assert float(here.misfit(changed).fitted) > float(here.misfit(frf).fitted)
    here.hold_out(torch.zeros(2, 3, dtype=torch.bool))
    assert here.misfit(frf).n_fitted == 2 * 6 * len(LINES)
    assert here.misfit(frf).n_heldout == 0
    assert bool(here.gap(frf, heldout=True).isnan())


def minima(value) -> list[int]:
    inner = (value[1:-1] < value[:-2]) & (value[1:-1] < value[2:])
    return (inner.nonzero().flatten() + 1).tolist()


def test_the_wide_level_has_its_minimum_at_the_truth_where_the_sharp_one_has_several(lab, plate, true):
    here = target(lab, true, seed=3)
    parts = torch.linspace(0.6, 1.6, 101, dtype=torch.float64)
    frf = predicted(plate, *parts.tolist())
    wide, sharp = (here.residual(frf, level).square().sum(-1) for level in (0, here.levels - 1))
    (only,) = [index for index in minima(wide) if 0.75 < float(parts[index]) < 1.35]
    assert float(parts[only]) == pytest.approx(1.0, abs=0.011)
    assert float(parts[wide.argmin()]) == pytest.approx(1.0, abs=0.011)
    assert len(minima(sharp)) > 2
    assert float(parts[sharp.argmin()]) == pytest.approx(1.0, abs=0.006)


def test_noise_alone_leaves_one_for_each_number(lab, true):
    here = target(lab, true, seed=4)
    misfit = here.misfit(true)
    # 1700 and 340 numbers: 3.4 and 7.7 % of scatter.
    assert float(misfit.fitted) / misfit.n_fitted == pytest.approx(1.0, abs=0.14)
    assert float(misfit.heldout) / misfit.n_heldout == pytest.approx(1.0, abs=0.3)
    assert float(here.residual(true, here.levels - 1).square().sum()) == pytest.approx(float(misfit.fitted))


def test_what_is_left_of_the_mesh_error_stands_beside_the_noise_at_the_peaks(lab, plate, true):
    here = target(lab, true)
    plain = here.variance.clone()
    more = []
    for shift in (2e-4, 2e-3):
        here.set_model_error(torch.full_like(LINES, shift))
        more.append((here.variance - plain) / here.measured.abs().square())
        assert bool((here.variance >= plain).all())
    assert bool((more[1] >= more[0]).all())
    # Where the FRF is steep the shift of a mode shows, on its plateaus it does not.
    steep = (true.diff(dim=0) / true[1:]).abs()
    ratio = (more[1] - more[0])[1:]
    for j, k in ((0, 0), (1, 1)):
        order = steep[:, j, k].argsort()
        assert float(ratio[order[-10:], j, k].median()) > 30 * float(ratio[order[:60], j, k].median())
    # A mode that has moved by this much is then no coincidence, nor is one that has moved by less.
    for part in (1.002, 1.004):
        moved = here.misfit(predicted(plate, part)[0])
        assert float(moved.fitted) < 3 * moved.n_fitted


def test_where_the_gain_is_unknown_the_level_of_the_measurement_does_not_matter(lab, plate, true):
    theta = TRUE * torch.tensor([[0.95], [1.0], [1.07]], dtype=torch.float64)
    left, gaps = [], []
    for factor in (1.0, 7.3):
        here = target(lab, factor * true, seed=5, gain_is_unknown=True)
        found = here.predict(plate, theta)
        left.append([here.residual(found, level) for level in range(here.levels)])
        gaps.append(torch.stack([here.gap(found), here.gap(found, heldout=True)]))
    for one, other in zip(*left, strict=True):
        assert torch.allclose(one, other, rtol=1e-7, atol=1e-9)
    assert torch.allclose(*gaps, rtol=1e-9)
    # The true plate is still the nearest, and the level that is fitted to it is right.
    assert int(gaps[0][0].argmin()) == 1
    assert float((found[1] / true).abs().median()) == pytest.approx(7.3, rel=0.01)
    # A level that is known is part of what is compared.
    known = target(lab, 7.3 * true)
    assert float(known.gap(known.predict(plate, theta))[1]) == pytest.approx(1 - 1 / 7.3)


def test_the_gap_is_the_contracts_metric(lab, plate, true):
    here, frf = target(lab, true, seed=6, heldout=((0, 2), (1, 0))), predicted(plate, 0.97, 1.2)
    for heldout, pairs in ((False, here.fitted), (True, here.heldout)):
        measured = Measured(torch.where(pairs, here.measured, 0), pairs)
        expected = relative_frf_norm(torch.where(pairs, frf, 0), measured) / int(pairs.sum())
        assert torch.allclose(here.gap(frf, heldout), expected, rtol=1e-12)


def test_a_pair_that_was_not_measured_counts_nowhere(lab, plate, true):
    pairs = torch.ones(2, 3, dtype=torch.bool)
    pairs[1, 2] = False
    std, frf = lab.true_std(true, 0.01, "signal"), predicted(plate, 1.1)[0]
    measured = lab.measured(LINES, true, RESPONSE, REFERENCE, measured=pairs)
    here = FrfTarget(measured, told(lab, std * pairs, true), torch.zeros(2, 3, dtype=torch.bool))
    changed = frf.clone()
    changed[:, 1, 2] = 1e6
    for level in range(here.levels):
        assert torch.equal(here.residual(changed, level), here.residual(frf, level))
    assert torch.equal(here.gap(changed), here.gap(frf))
    assert here.misfit(changed) == here.misfit(frf)


def test_many_lines_are_thinned_where_they_are_smoothed(lab, plate, monkeypatch):
    """Twice as many lines as that takes: a wide level sees every other one, and says the same of the model."""
    monkeypatch.setattr(module, "LEAST_SMOOTHED", 400)
    lines = torch.linspace(10.0, 340.0, 801, dtype=torch.float64)
    theta = TRUE * torch.tensor([[1.0], [1.02], [1.1]], dtype=torch.float64)
    every = plate.frf(theta, lines)
    std = lab.true_std(every[0], 0.01, "mixed")
    measured = lab.measured(lines, every[0], RESPONSE, REFERENCE)
    here = FrfTarget(measured, told(lab, std, every[0]), torch.zeros(2, 3, dtype=torch.bool))
    sharp = here.levels - 1
    assert torch.equal(here.predict(plate, theta, sharp), here.predict(plate, theta))
    assert here.predict(plate, theta).shape[1] == 801
    monkeypatch.setattr(module, "LEAST_SMOOTHED", 801)
    whole = FrfTarget(measured, told(lab, std, every[0]), torch.zeros(2, 3, dtype=torch.bool))
    for level in range(sharp):
        found = here.predict(plate, theta, level)
        assert torch.allclose(found, every[:, ::2], rtol=1e-9)
        thin, full = (one.residual(one.predict(plate, theta, level), level) for one in (here, whole))
        assert float(thin[0].abs().max()) < 1e-9
        # A smooth window over half of the lines says nearly what it says over all of them.
        assert torch.allclose(thin.norm(dim=-1), full.norm(dim=-1), rtol=0.1)


class TestTable:
    def test_a_frequency_counts_in_its_own_uncertainty(self):
        table = NaturalFrequencies.from_mapping({4: 80.0, 6: 140.0}, {4: 0.4})
        here = FrequencyTarget(table, 1e-3)
        found = torch.tensor([80.8, 139.86], dtype=torch.float64)
        assert here.residual(found, 0).tolist() == pytest.approx([-2.0, 1.0])
        assert float(here.misfit(found).fitted) == pytest.approx(5.0)
        assert here.misfit(found).n_heldout == 0
        assert float(here.gap(found)) == pytest.approx((0.5 * (0.01**2 + 0.001**2)) ** 0.5)
        assert bool(here.gap(found, heldout=True).isnan())

    def test_modes_are_counted_from_one(self, plate):
        table = NaturalFrequencies.from_mapping({4: 80.0, 6: 140.0})
        theta = torch.tensor([TRUE], dtype=torch.float64)
        found = FrequencyTarget(table).predict(plate, theta)
        assert torch.allclose(found, plate.natural_frequencies(theta, 6)[[3, 5]], rtol=1e-9)
