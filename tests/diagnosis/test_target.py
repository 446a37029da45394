"""What models are held against: weighed by what is not known, and wide enough to be found from afar."""

import math
from dataclasses import replace

import pytest
import torch

from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Problem
from torchplate.diagnosis.settings import SETTINGS
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy.measure import Measured
from torchplate.discrepancy.norms import relative_frf_norm
from torchplate.effects import CATALOGUE
from torchplate.measurement import PERFECT, Imperfections
from torchplate.measurement.assessment.noise import Noise, noise_level
from torchplate.measurement.assessment.resonances import Resonances
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


FOUND: dict[bytes, Resonances | None] = {}


def resonances_of(measured) -> Resonances | None:
    """What the estimator finds in these FRFs; many tests are of the same ones, and it takes most of their time."""
    key = measured.frf.numpy().tobytes()
    return FOUND[key] if key in FOUND else FOUND.setdefault(key, noise_level(measured).resonances)


def target(lab, frf, share=0.01, heldout=((0, 2),), seed=None, **others) -> FrfTarget:
    std = lab.true_std(frf, share, "mixed")
    noise = 0 if seed is None else lab.noise_of(std, seed)
    measured = lab.measured(LINES, frf + noise, RESPONSE, REFERENCE)
    which = torch.zeros(2, 3, dtype=torch.bool)
    for pair in heldout:
        which[pair] = True
    # Resonances as the estimator of noise finds them, noise as it is.
    told_noise = replace(told(lab, std, frf), resonances=resonances_of(measured))
    return FrfTarget(measured, told_noise, which, **others)


def seen(here: FrfTarget, plate, level, *parts: float):
    """What models of these parts of the true modulus say at a level."""
    return here.predict(plate, TRUE * torch.tensor(parts, dtype=torch.float64)[:, None], level)


HERE = torch.tensor([TRUE], dtype=torch.float64)


def left(here: FrfTarget, plate, prediction, level):
    """Residuals at a level: at the sharp one over the noise, beside the true model."""
    if level < here.levels - 1:
        return here.residual(prediction, level)
    marginal = here.marginal(plate, HERE)
    return marginal.whitened(marginal.over_noise(here.off(prediction)))


def square(here: FrfTarget, plate, prediction) -> float:
    """Sum of squares at the sharp level."""
    return float(left(here, plate, prediction, here.levels - 1).square().sum())


def test_nothing_is_left_at_the_truth_at_any_level(lab, plate, true):
    here = target(lab, true)
    for level in range(here.levels):
        at, off = (left(here, plate, frf, level).norm() for frf in seen(here, plate, level, 1.0, 1.1))
        # Where the resonances are found, and the smooth rest is not quite a polynomial.
        assert float(at) <= (1e-2 * float(off) if level < here.levels - 1 else 0.0)
        assert float(off) > 1.0


def test_too_few_lines_for_resonances_are_still_seen_from_afar(lab, plate, true):
    """Poisson's integral over every eighth line: the minimum is near the truth, and no resonance was asked for."""
    some = slice(None, None, 8)
    std = lab.true_std(true[some], 0.01, "mixed")
    measured = lab.measured(LINES[some], true[some], RESPONSE, REFERENCE)
    noise = noise_level(measured)
    assert noise.resonances is None
    here = FrfTarget(measured, told(lab, std, true[some]), torch.zeros(2, 3, dtype=torch.bool))
    parts = torch.linspace(0.6, 1.6, 51, dtype=torch.float64).tolist()
    value = here.residual(seen(here, plate, 0, *parts), 0).square().sum(-1)
    assert parts[int(value.argmin())] == pytest.approx(1.0, abs=0.05)


AS_MEASURED = replace(SETTINGS, wide=replace(SETTINGS.wide, as_measured=True))


@pytest.mark.parametrize("band", [(2.0, 200.0), (20.0, 200.0)])
@pytest.mark.parametrize("n_line", [80, 3200])
def test_no_line_beside_the_axis_counts_more_than_what_was_measured_there(lab, band, n_line):
    """Below the lowest modes twenty lines may lie between two that were measured."""
    frequency = torch.linspace(*band, n_line, dtype=torch.float64)
    std = torch.full((n_line, 1, 1), 0.1, dtype=torch.float64)
    measured = lab.measured(frequency, torch.ones_like(std).to(torch.complex128), [1], [2])
    pole = torch.tensor([900.0 + 9.0j, 1e4 + 100.0j], dtype=torch.complex128)
    part = torch.ones(2, 1, 1, dtype=torch.complex128)
    resonances = Resonances(pole, part, part, band, torch.ones(2, dtype=torch.bool))
    noise = Noise(std, 0.1, (), torch.zeros_like(std), resonances)
    here = FrfTarget(measured, noise, torch.zeros(1, 1, dtype=torch.bool), settings=AS_MEASURED)
    step = (band[1] - band[0]) / (n_line - 1)
    for level in here.smoothing.levels:
        for low in torch.linspace(band[0], 0.9 * band[1], 12).tolist():
            high = low + max(3 * step, 0.1 * low)
            inside = (level.frequency >= low) & (level.frequency <= high)
            assert float(level.stands_for[inside].sum()) <= (high - low) / step + 1.5
        if n_line == 3200:
            # Nearly everywhere the lines that were measured are denser.
            assert float((level.stands_for == 1).double().mean()) > 0.7


def test_what_is_known_beforehand_weighs_as_much_of_what_was_measured(lab):
    """A twentieth of all numbers that a wide level has from the test, for a parameter a standard deviation off."""
    plate, frequency = lab.small_plate(), torch.linspace(2.0, 200.0, 80, dtype=torch.float64)
    plate = plate.replaced(
        known={name: value for name, value in plate.known_values.items() if name != "plate.density"},
        searched={"plate.density": Searched(2000.0, 4000.0)},
    )
    theta = torch.tensor([2700.0], dtype=torch.float64)
    frf = plate.frf(theta, frequency)
    measured = lab.measured(frequency, frf, plate.response, plate.reference)
    nobody = torch.zeros(frf.shape[1:], dtype=torch.bool)
    here = FrfTarget(measured, noise_level(measured), nobody, settings=AS_MEASURED)
    problem = Problem(ModelBuilder(plate, here, as_given=True), plate, {"plate.density": (2600.0, 100.0)})
    for level in range(here.levels - 1):
        found = problem.residual(plate.space.to_cube(theta)[None], level)[0]
        mixed = (len(found) - 1) / len(here.smoothing.levels[level].frequency)
        n_measured = mixed * float(here.smoothing.levels[level].stands_for.sum())
        assert float(found[-1]) == pytest.approx(0.05 * n_measured**0.5)
        assert n_measured < 0.8 * (len(found) - 1)


def test_held_out_frfs_are_in_no_residual(lab, plate, true):
    here, frf = target(lab, true), predicted(plate, 1.1)[0]
    changed = frf.clone()
    changed[:, 0, 2] *= 3
    for level in range(here.levels):
        plain = seen(here, plate, level, 1.1)[0]
        other = plain.clone()
        other[:, 0, 2] *= 3
        assert torch.equal(left(here, plate, other, level), left(here, plate, plain, level))
    assert float(here.gap(changed, heldout=True)) > float(here.gap(frf, heldout=True))
    assert torch.equal(here.gap(changed), here.gap(frf))
    changed[:, 1, 2] *= 3
    assert square(here, plate, changed) > square(here, plate, frf)
    # Another choice is another target; the first stays as it was.
    every = here.holding_out(torch.zeros(2, 3, dtype=torch.bool))
    assert every.marginal(plate, HERE).n == 2 * 6 * len(LINES)
    assert here.marginal(plate, HERE).n == 2 * 5 * len(LINES)
    assert bool(every.gap(frf, heldout=True).isnan())
    assert not bool(here.gap(frf, heldout=True).isnan())


def minima(value) -> list[int]:
    inner = (value[1:-1] < value[:-2]) & (value[1:-1] < value[2:])
    return (inner.nonzero().flatten() + 1).tolist()


def test_the_wide_level_has_its_minimum_at_the_truth_where_the_sharp_one_has_several(lab, plate, true):
    here = target(lab, true, seed=3)
    parts = torch.linspace(0.6, 1.6, 101, dtype=torch.float64)
    wide, sharp = (
        left(here, plate, seen(here, plate, level, *parts.tolist()), level).square().sum(-1)
        for level in (0, here.levels - 1)
    )
    (only,) = [index for index in minima(wide) if 0.75 < float(parts[index]) < 1.35]
    assert float(parts[only]) == pytest.approx(1.0, abs=0.011)
    assert float(parts[wide.argmin()]) == pytest.approx(1.0, abs=0.011)
    assert len(minima(sharp)) > 2
    assert float(parts[sharp.argmin()]) == pytest.approx(1.0, abs=0.006)


def test_noise_alone_leaves_one_for_each_number(lab, plate, true):
    here = target(lab, true, seed=4)
    marginal = here.marginal(plate, HERE)
    judged = marginal.judge(marginal.over_noise(here.off(true)))
    # 1700 numbers: 3.4 % of scatter.
    assert judged.n == 1700
    assert judged.white == pytest.approx(1.0, abs=0.14)
    assert judged.noise_scale == pytest.approx(1.0, abs=0.07)
    assert square(here, plate, true) == pytest.approx(judged.white * judged.n)


def test_a_mode_that_the_mesh_may_have_moved_is_no_surprise(lab, plate, true):
    """What is left of the mesh error is among the nuisances: a shift of the modes, and little beside it."""
    here = target(lab, true)
    moved = predicted(plate, 1.004)[0]
    assert square(here, plate, moved) > 15 * 1700
    allowed = here.with_mesh_error(torch.full_like(LINES, 2e-3), 1.0, 8)
    assert square(allowed, plate, moved) < 1700
    # A level 5 % off is no mesh error: shared by five channels it is 0.03² · 2 + 0.02² · 3 over their (1.8e-3)².
    assert square(allowed, plate, 1.05 * true) > 800
    # A target that was not told of any stays as it was.
    assert square(here, plate, moved) > 15 * 1700
    assert bool((allowed.variance >= here.variance).all())
    # Of each of eight modes a frequency, a damping, and a deflection at each of six FRFs.
    assert (allowed.n_mode, allowed.n_modal) == (8, 2.0 * 8 * 7)


def test_an_inflated_model_error_leaves_what_was_said_of_it(lab, plate, true):
    """FRFs then count by what they say of modes, and no longer by every line."""
    here = target(lab, true, seed=3).with_mesh_error(torch.zeros_like(LINES), 1.0, 8)
    wrong = predicted(plate, 1.03)[0]
    assert square(here, plate, wrong) > 100 * 1700
    assert here.trusts_the_noise
    doubted = here.inflated(wrong)
    assert not doubted.trusts_the_noise
    mean = float(((here.off(wrong).abs().square() / doubted.variance)[:, here.fitted]).mean()) / 2
    assert mean == pytest.approx(SETTINGS.selecting.doubtful, rel=0.02)
    assert square(doubted, plate, wrong) == pytest.approx(SETTINGS.selecting.doubtful * here.n_modal, rel=0.05)
    # The first target is as it was.
    assert here.trusts_the_noise
    # What noise and the test make of the gap is asked of these, and not of what the model leaves.
    gaps = [one.expected_gap(plate, HERE, one.marginal(plate, HERE)) for one in (here, doubted)]
    assert gaps[1] == pytest.approx(gaps[0], rel=1e-9)
    assert gaps[0] < 0.05


def test_a_channel_read_the_other_way_round_is_seen_before_anything_fits(lab, plate, true):
    turned = torch.ones(2, 3, dtype=torch.float64)
    turned[1, 0] = turned[0, 2] = -1
    here = target(lab, true * turned, seed=2, heldout=())
    members = TRUE * torch.linspace(0.7, 1.4, 15, dtype=torch.float64)[:, None]
    sign, part = here.signs(here.predict(plate, members, 0))
    assert torch.equal(sign, turned)
    assert part < 0.5
    # Read as that says, nothing is left to be turned.
    sign, part = here.turned(sign).signs(here.predict(plate, members, 0))
    assert bool((sign == 1).all())
    assert part == pytest.approx(1.0)


@pytest.mark.check
def test_where_the_gain_is_unknown_the_level_of_the_measurement_does_not_matter(lab, plate, true):
    theta = TRUE * torch.tensor([[0.95], [1.0], [1.07]], dtype=torch.float64)
    rest, gaps = [], []
    for factor in (1.0, 7.3):
        here = target(lab, factor * true, seed=5, gain_is_unknown=True)
        found = here.predict(plate, theta)
        rest.append([here.residual(here.predict(plate, theta, level), level) for level in range(here.levels - 1)])
        gaps.append(torch.stack([here.gap(found), here.gap(found, heldout=True)]))
    for one, other in zip(*rest, strict=True):
        # Resonances are iterated to 1e-4 of what is left of them.
        assert torch.allclose(one, other, rtol=1e-4, atol=1e-5)
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
        plain = seen(here, plate, level, 1.1)[0]
        other = plain.clone()
        other[:, 1, 2] = 1e6
        assert torch.equal(left(here, plate, other, level), left(here, plate, plain, level))
    assert torch.equal(here.gap(changed), here.gap(frf))
    assert here.marginal(plate, HERE).n == 2 * 5 * len(LINES)


def test_what_was_measured_is_continued_beside_the_axis(lab, plate, true):
    """As the plate itself would be seen there: resonances hold between the lines, and for those narrower than these."""
    here = target(lab, true, seed=9)
    for level in range(here.levels - 1):
        frequency, decay = here.lines(level)
        assert len(frequency) <= here.settings.wide.most
        assert bool((decay == 2 * torch.pi * here.settings.wide.widths[level] * frequency).all())
        there = plate.frf(HERE, frequency, decay=decay)
        away = (here.seen(level) - there).norm(dim=0) / there.norm(dim=0)
        # Noise of 1 %, and a polynomial in the place of what lies beyond the band.
        assert float(away.max()) < 0.03
    read = here.turned(torch.tensor([[1.0, -1.0, 1.0], [1.0, 1.0, -1.0]], dtype=torch.float64))
    assert torch.equal(read.seen(0)[:, 0, 1], -here.seen(0)[:, 0, 1])


def test_a_told_scatter_of_thickness_is_that_of_the_section_and_is_known_better(plate, lab, true):
    theta = plate.space.to_si(torch.tensor([0.4], dtype=torch.float64))
    default, thick = (target(lab, true, imperfections=Imperfections(thickness_scatter=std)) for std in (None, 0.023))
    assert default.wandering == SETTINGS.wandering
    assert thick.wandering == replace(SETTINGS.wandering, thickness=0.023)
    freedom = [one.marginal(plate, theta).freedom for one in (default, thick)]
    assert "thickness" not in freedom[0]
    assert freedom[1]["thickness"] == SETTINGS.knowledge.told
    # Beside a modulus that wanders as before. The lines are weighed a little otherwise: by the second order, too.
    sizes = []
    for marginal in (one.marginal(plate, theta) for one in (default, thick)):
        square = torch.zeros(len(marginal.names), dtype=torch.float64)
        square.index_add_(0, marginal.group, marginal.gram.diagonal())
        of = dict(zip(marginal.names, square.sqrt().tolist(), strict=True))
        sizes.append(of["thickness"] / of["modulus"])
    assert sizes[1] == pytest.approx(sizes[0] * 0.023 / SETTINGS.wandering.thickness, rel=0.1)


def test_a_plate_may_wander_in_a_test_that_is_perfect(plate, lab, true):
    assert target(lab, true, imperfections=replace(PERFECT, thickness_scatter=0.02)).wandering.thickness == 0.02


def test_what_changes_frfs_changes_the_level_that_is_fitted_to_them(lab, plate, true):
    """Away from the truth, where peaks are elsewhere; the columns of a specimen are made so."""
    here = target(lab, 7.3 * true, seed=5, gain_is_unknown=True)
    part, step = 1.02, 1e-6
    theta = part * HERE
    for level in range(here.levels):
        frequency, decay = here.lines(level)
        plain = [plate.frf(theta * (1 + sign * step), frequency, decay=decay) for sign in (-1, 1)]
        change = (plain[1] - plain[0]) / (2 * step)
        low, high = (seen(here, plate, level, part * (1 + sign * step))[0] for sign in (-1, 1))
        fitted = (high - low) / (2 * step)
        found = here.at_level(plate, theta, change[None], level)[0]
        # Rounding over the step, a millionth.
        assert float((found - fitted).norm() / fitted.norm()) < 2e-5
    # At the sharp level a level that stays where it is would leave more than a quarter of it out.
    held = float(here._gain(here.seen(), plain[0])) * change
    assert float((held - fitted).norm() / fitted.norm()) > 0.25
    known = target(lab, true)
    assert torch.equal(known.at_level(plate, theta, change[None]), change[None])


def test_a_level_without_a_unit_costs_nothing_and_is_not_expected_to_be_of_any_size(lab, plate, true):
    """That which is fitted to peaks of another height is off everywhere between them."""
    known, unknown = (target(lab, true, seed=6, gain_is_unknown=one) for one in (False, True))
    whitened = []
    for here in (known, unknown):
        marginal = here.marginal(plate, HERE)
        whitened.append(float(marginal.whitened(marginal.over_noise(0.1 * true)).square().sum()))
    # A tenth of all FRFs, at a noise of a per cent of each: ten standard deviations of 1700 numbers; or a tenth of one.
    assert whitened[0] > 1e4
    assert whitened[1] == pytest.approx(0.01, rel=0.02)
    gaps = [here.expected_gap(plate, HERE, here.marginal(plate, HERE)) for here in (known, unknown)]
    assert gaps[1] == pytest.approx(gaps[0], rel=0.02)


def test_the_size_of_a_model_error_is_what_is_left(lab, plate, true):
    """Half as much left is half as large an error, and no coincidence that costs anything."""
    here = target(lab, true, seed=3).with_mesh_error(torch.zeros_like(LINES), 1.0, 8)
    marginal = here.inflated(predicted(plate, 1.03)[0]).marginal(plate, HERE)
    whole = marginal.over_noise(here.off(predicted(plate, 1.03)[0]))
    judged = [marginal.judge(part * whole) for part in (1.0, 0.1)]
    assert judged[1].noise_scale == pytest.approx(0.1 * judged[0].noise_scale, rel=1e-6)
    assert judged[0].cost - judged[1].cost == pytest.approx(2 * math.log(10.0) * judged[0].n, rel=1e-6)
    assert judged[0].complexity == pytest.approx(judged[1].complexity, abs=1e-6)
