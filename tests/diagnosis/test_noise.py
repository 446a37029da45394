"""The noise that is found is the noise that was added."""

import dataclasses
import math

import pytest
import torch

from torchplate.effects import CATALOGUE
from torchplate.measurement.assessment.noise import noise_level, of_mains
from torchplate.measurement.assessment.rational_fit import RationalFit

HIDDEN = {
    "oblong": {},
    "square, modes repeated": {"sides": (0.48, 0.48)},
    "windowed": {"hidden": {"window": (CATALOGUE["exponential_window"](), {"rate": 3.0})}},
    "late": {"hidden": {"delay": (CATALOGUE["time_delay"](), {"delay": 4e-4})}},
    "receptance": {"kind": "receptance"},
}


def measurement(lab, frf, std, seed, n_response=1, **others):
    noise = lab.noise_of(std, seed)
    step = 395.0 / (len(frf) - 1)
    nodes = lab.nodes
    return lab.measured(lab.lines(step), frf + noise, nodes[:n_response], nodes[: frf.shape[2]], **others), noise


EXACT = {}


def without_noise(lab, plate, loss, step):
    """FRFs of twelve references, computed once."""
    key = plate, loss, step
    if key not in EXACT:
        model = lab.plate(loss, **HIDDEN[plate])
        EXACT[key] = model.frf(lab.nobody, lab.lines(step), lab.nodes[:1], lab.nodes[1:13])
    return EXACT[key]


KINDS = [(1.5e-3, 1.0, 0.003), (3e-3, 0.5, 0.03), (8e-3, 1.0, 0.01)]
# All kinds on one plate, and each other plate once.
CASES = [("oblong", *kind) for kind in KINDS]
CASES += [(plate, *KINDS[index % 3]) for index, plate in enumerate(HIDDEN) if plate != "oblong"]
HOW = ("signal", "sensor", "mixed")
# `make check` has each plate with each noise, `make test` each noise on the first plate and each other plate once.
SHORT = {(index, index % 3) for index in range(len(CASES))}
CASES = [
    pytest.param(*case, how, marks=() if (index, turn) in SHORT else pytest.mark.check)
    for index, case in enumerate(CASES)
    for turn, how in enumerate(HOW)
]


@pytest.mark.parametrize(("plate", "loss", "step", "share", "how"), CASES)
@pytest.mark.check
def test_the_floor_of_many_frfs_is_found(lab, plate, loss, step, share, how):
    # At 1.5e-3 and 1 Hz most peaks are far narrower than the line spacing.
    frf = without_noise(lab, plate, loss, step)
    std = lab.true_std(frf, share, how)
    given, noise = measurement(lab, frf, std, seed=len(plate) + int(1e4 * loss))
    found = noise_level(given)
    # 12 FRFs of 400 lines: 1.3 % of scatter; b of the mixed case hangs on the few lines at the peaks, of receptances on
    # the one peak of the plate swinging on its wires.
    within = 0.05 if how != "mixed" else 0.12
    assert found.floor == pytest.approx(lab.true_floor(std, frf), rel=within)
    assert float((noise.abs() / found.std).square().mean()) / 2 == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("how", ["signal", "sensor"])
@pytest.mark.parametrize("share", [0.003, 0.03])
@pytest.mark.parametrize("loss", [1.5e-3, 8e-3])
def test_the_floor_of_a_single_frf_is_found(lab, loss, share, how):
    frf = lab.plate(loss).frf(lab.nobody, lab.lines(1.0), [3], [61])
    std = lab.true_std(frf, share, how)
    given, noise = measurement(lab, frf, std, seed=5)
    found = noise_level(given)
    # 400 lines less two numbers for each of 17 poles: 2.7 % of scatter.
    assert found.floor == pytest.approx(lab.true_floor(std, frf), rel=0.1)
    assert float((noise.abs() / found.std).square().mean()) / 2 == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("kind", "power", "motion"),
    [pytest.param("receptance", -2, "acceleration", marks=pytest.mark.check), ("mobility", 1, "displacement")],
)
@pytest.mark.check
def test_a_floor_that_is_flat_in_another_motion_is_told_from_its_course(lab, kind, power, motion):
    """An accelerometer's beside receptances, a distance sensor's beside mobilities: std in proportion to f^power."""
    line = lab.lines(0.5)
    frf = lab.plate(3e-3, kind=kind).frf(lab.nobody, line, lab.nodes[:1], lab.nodes[1:7])
    course = (line / line[-1]) ** power
    std = (course[:, None, None] / course.norm() * 0.01 * frf.norm(dim=0) / math.sqrt(2)).expand(frf.shape)
    given, noise = measurement(lab, frf, std, seed=8, kind=kind)
    found = noise_level(given)
    assert f"flat in {motion}" in found.sentences[0]
    # 6 FRFs of 800 lines: 1.4 % of scatter on the whole, 5 % over a tenth of the lines.
    ratio = (noise.abs() / found.std).square() / 2
    assert all(float(part.mean()) == pytest.approx(1.0, abs=0.15) for part in ratio.split(79))


@pytest.mark.check
def test_poles_do_not_take_on_a_floor_that_rises(lab, monkeypatch):
    """An accelerometer's beside mobilities: where narrow poles took on the noise, what is left no longer shows it."""
    line = lab.lines(1.0)
    frf = lab.plate(6e-4, kind="mobility").frf(lab.nobody, line, lab.nodes[:4], lab.nodes[4:8])
    course = 1 / line
    std = (course[:, None, None] / course.norm() * 5e-4 * frf.norm(dim=0) / math.sqrt(2)).expand(frf.shape)
    given = lab.measured(line, frf + lab.noise_of(std, 8), lab.nodes[:4], lab.nodes[4:8], kind="mobility")
    monkeypatch.setattr(RationalFit, "flattest", lambda *_: "")
    found = noise_level(given)
    assert "flat in acceleration" in found.sentences[0]
    ratio = (found.std / std).square().flatten(1).mean(1)
    assert all(float(part.mean()) == pytest.approx(1.0, abs=0.1) for part in ratio.split(40))


def test_few_lines_for_many_resonances_still_tell_noise_from_signal(lab):
    """Sixty lines over sixteen modes: less than four lines for each, most of them far from any peak."""
    line = lab.lines(395.0 / 59)
    frf = lab.plate(3e-3).frf(lab.nobody, line, lab.nodes[:2], lab.nodes[2:6])
    std = lab.true_std(frf, 0.01, "mixed")
    given, _ = measurement(lab, frf, std, seed=4, n_response=2)
    found = noise_level(given)
    assert len(found.resonances.pole) > 60 // 6
    # 8 FRFs of some 35 free lines: 4 % of scatter; what a mode that was missed leaves goes on top.
    assert found.floor == pytest.approx(lab.true_floor(std, frf), rel=0.4)


def test_a_floor_that_is_flat_as_it_is_read_needs_no_other_motion(lab):
    frf = without_noise(lab, "receptance", 3e-3, 0.5)
    given, _ = measurement(lab, frf, lab.true_std(frf, 0.01, "mixed"), seed=3, kind="receptance")
    assert "flat in" not in noise_level(given).sentences[0]


def test_the_kind_of_noise_is_told_from_its_course(lab):
    frf = lab.plate().frf(lab.nobody, lab.lines(1.0), [3], lab.nodes[1:9])
    for how, expected in (("signal", (0.0, 0.02)), ("sensor", (0.02, 0.0))):
        given, _ = measurement(lab, frf, lab.true_std(frf, 0.02, how), seed=1)
        std = noise_level(given).std / frf.abs().square().mean(0).sqrt()
        low = std.quantile(0.05, dim=0) * math.sqrt(2)
        # In a deep valley only the sensor's noise is left.
        assert float(low.mean()) == pytest.approx(expected[0], abs=0.002)


@pytest.mark.check
def test_a_noisy_frf_keeps_its_noise_to_itself(lab):
    frf = lab.plate().frf(lab.nobody, lab.lines(1.0), [3], lab.nodes[1:9])
    share = torch.full((8,), 0.01, dtype=torch.float64)
    share[5] = 0.08
    std = lab.true_std(frf, 1.0, "signal") * share
    given, _ = measurement(lab, frf, std, seed=2)
    found = noise_level(given)
    gap = math.sqrt(2) * found.std.norm(dim=0)[0] / frf.norm(dim=0)[0]
    assert gap.tolist() == pytest.approx(share.tolist(), rel=0.12)
    assert "1 of 8 FRFs" in found.sentences[0]


@pytest.mark.check
def test_lines_that_stand_out_alone_are_no_resonances(lab):
    """A drift of the record moves the peaks, and no line that was hit by something else."""
    frf = without_noise(lab, "oblong", 3e-3, 0.5)
    std = lab.true_std(frf, 0.01, "mixed")
    clean, _ = measurement(lab, frf, std, 5)
    lines = torch.arange(60, len(frf) - 40, 97)
    hit = lab.noise_of(std, 6)[lines]
    dirty = clean.frf.clone()
    dirty[lines] += 40 * std[lines] * hit / hit.abs()
    found = [noise_level(one).resonances for one in (clean, dataclasses.replace(clean, frf=dirty))]
    assert int(found[1].resonates.sum()) <= int(found[0].resonates.sum()) + 1

    def moved(resonances, drift):
        return resonances.moved(clean.frequency, torch.full(frf.shape[1:], drift).to(std))

    # As large as between records of a careful test, and in proportion to it.
    small, large = (moved(found[1], drift) for drift in (2e-5, 2e-4))
    assert float((large - 10 * small).norm()) < 0.2 * float(large.norm())
    assert float((large - moved(found[0], 2e-4)).norm()) < 0.2 * float(large.norm())


@pytest.mark.parametrize("loss", [pytest.param(1.5e-3, marks=pytest.mark.check), 8e-3])
def test_a_line_that_stands_out_in_one_frf_is_noise_of_that_line(lab, loss):
    """Something else was hit: no plate has such a peak, and no other line is less sure for it."""
    frf = without_noise(lab, "oblong", loss, 1.0)
    std = lab.true_std(frf, 0.01, "mixed")
    clean, _ = measurement(lab, frf, std, 5)
    out = [(70, 0), (171, 5), (304, 9)]
    dirty = clean.frf.clone()
    for line, one in out:
        dirty[line, 0, one] += 40 * std[line, 0, one]
    before, after = (noise_level(one) for one in (clean, dataclasses.replace(clean, frf=dirty)))
    for line, one in out:
        assert float(after.std[line, 0, one]) > 20 * float(std[line, 0, one])
        after.std[line, 0, one] = before.std[line, 0, one]
    # Resonances show in all FRFs, and stay as sure as they were, however narrow.
    assert float((after.std / before.std).max()) < 1.15
    assert float((before.std / std).max()) < 1.6


@pytest.mark.check
@pytest.mark.parametrize("hums", [True, False])
def test_the_mains_are_noise_in_all_frfs_and_no_other_line_is(lab, hums):
    """What all FRFs show at one line may be a resonance; not where the mains are."""
    frf = without_noise(lab, "oblong", 8e-3, 1.0)
    std, line = lab.true_std(frf, 0.01, "mixed"), lab.lines(1.0)
    clean, _ = measurement(lab, frf, std, 5)
    place = [int((line - (at if hums else at + 3)).abs().argmin()) for at in (100.0, 150.0, 240.0)]
    dirty = clean.frf.clone()
    dirty[place] += 40 * std[place] * torch.exp(1j * torch.arange(std[place].numel()).reshape(std[place].shape))
    before, after = (noise_level(one) for one in (clean, dataclasses.replace(clean, frf=dirty)))
    raised = float((after.std[place] / std[place]).median())
    assert (raised > 20) if hums else (raised < 3)
    others = torch.ones(len(line), dtype=torch.bool)
    others[place] = False
    assert float((after.std / before.std)[others].max()) < 1.3


def test_lines_far_apart_are_not_taken_for_the_mains():
    """Of 4 Hz one line in seven is nearest to one."""
    assert of_mains(torch.arange(10.0, 400.0, 0.5)).sum() == 12
    assert not of_mains(torch.arange(10.0, 400.0, 4.0)).any()


@pytest.mark.check
def test_beside_noise_of_heavy_tails_a_drift_moves_resonances_alone(lab):
    """Student's t of three degrees of freedom: lines beside a peak that it hit are worth a pole to the fit."""
    frf, drift, worst = without_noise(lab, "oblong", 3e-3, 0.5), 2e-4, []
    std = lab.true_std(frf, 0.01, "signal")
    clean, _ = measurement(lab, frf, std, 5)
    higher = lab.lines(0.5) * (1 + drift)
    exact = lab.plate(3e-3, **HIDDEN["oblong"]).frf(lab.nobody, higher, lab.nodes[:1], lab.nodes[1:13]) - frf
    for seed in range(5):
        generator = torch.Generator().manual_seed(seed)
        normal = torch.randn(*frf.shape, 2, generator=generator, dtype=torch.float64)
        square = torch.randn(*frf.shape, 1, 3, generator=generator, dtype=torch.float64).square().mean(-1)
        heavy = torch.view_as_complex((normal / square.sqrt()).contiguous())
        found = noise_level(dataclasses.replace(clean, frf=frf + std * heavy)).resonances
        moved = found.moved(clean.frequency, torch.full(frf.shape[1:], drift).to(std))
        worst.append(float(((moved - exact).abs() / std).max()))
    # In the middle of five tests, at the worst of some 9,000 numbers.
    assert sorted(worst)[2] < 10.0


@pytest.mark.parametrize(
    ("square", "first"),
    [
        (0.0, 40),
        (350.0**2, 40),
        # Where the band begins at the first or second line of all, below 0 Hz² is below it, too.
        *(pytest.param(-(900.0**2), first, marks=pytest.mark.check) for first in (1, 2, 40)),
    ],
)
def test_what_lies_outside_the_band_moves_with_the_record(lab, square, first):
    """Fractions of huge residues beside the band cancel in it: a drift that moves some of them alone is none."""
    frequency = 0.5 * torch.arange(first, 600, dtype=torch.float64)
    frf = lab.plate(3e-3).frf(lab.nobody, frequency, [3], lab.nodes[1:3])[:, 0] / 1e3
    fit = RationalFit(frequency, frf)
    square = torch.tensor([square, 100.0**2], dtype=torch.float64)
    fit.pole = torch.complex(square, 1e-9 * square.clamp(min=1.0))
    assert fit.has_width.tolist() == [True, False]


@pytest.mark.check
def test_without_noise_next_to_none_is_found(lab):
    frf = lab.plate(8e-3).frf(lab.nobody, lab.lines(0.5), [3], lab.nodes[1:5])
    given, _ = measurement(lab, frf, torch.zeros_like(frf.real), seed=3)
    assert noise_level(given).floor < 2e-3


@pytest.mark.check
def test_what_was_not_measured_has_no_noise(lab):
    frf = lab.plate().frf(lab.nobody, lab.lines(1.0), lab.nodes[:2], lab.nodes[2:6])
    pairs = torch.ones(2, 4, dtype=torch.bool)
    pairs[1, 2] = False
    std = lab.true_std(frf, 0.01, "sensor")
    given, _ = measurement(lab, frf, std, seed=4, n_response=2, measured=pairs)
    found = noise_level(given)
    assert bool((found.std[:, pairs] > 0).all())
    assert bool((found.std[:, ~pairs] == 0).all())
    assert found.floor == pytest.approx(0.01, rel=0.06)


def test_a_dead_frf_is_passed_over(lab):
    frf = lab.plate().frf(lab.nobody, lab.lines(1.0), [3], lab.nodes[1:4]).clone()
    frf[:, 0, 1] = 0
    std = lab.true_std(frf, 0.01, "signal")
    given, _ = measurement(lab, frf, std, seed=6)
    found = noise_level(given)
    assert float(found.std[:, 0, 1].abs().max()) == 0
    assert found.floor == pytest.approx(0.01, rel=0.1)
    none = lab.measured(lab.lines(1.0), torch.zeros_like(frf), [3], lab.nodes[:3])
    assert noise_level(none).floor == 0


def test_few_lines_are_told_from_their_neighbours(lab):
    frequency = torch.linspace(200.0, 210.0, 11, dtype=torch.float64)
    frf = lab.plate(8e-3).frf(lab.nobody, frequency, [3], lab.nodes[1:13])
    std = lab.true_std(frf, 0.2, "sensor")
    given = lab.measured(frequency, frf + lab.noise_of(std, 7), [3], lab.nodes[1:13])
    found = noise_level(given)
    # An upper bound, and eleven lines of twelve FRFs.
    assert 0.8 * 0.2 < found.floor < 1.6 * 0.2
    assert "too few" in found.sentences[0]


def averaged(lab, frf, std, n_average, seed):
    """FRF and coherence of `n_average` records at unit force, each √n_average as noisy as their mean."""
    records = frf + lab.noise_of((math.sqrt(n_average) * std).expand(n_average, *frf.shape), seed)
    mean = records.mean(0)
    return mean, mean.abs().square() / records.abs().square().mean(0)


@pytest.mark.check
def test_the_coherence_tells_where_the_noise_is(lab):
    frequency = lab.lines(0.5)
    frf = lab.plate().frf(lab.nobody, frequency, [3], lab.nodes[1:5])
    humming = ((frequency > 140) & (frequency < 200))[:, None, None]
    std = lab.true_std(frf, 0.01, "signal") * torch.where(humming, 6.0, 1.0)
    mean, coherence = averaged(lab, frf, std, 16, seed=8)
    given = lab.measured(frequency, mean, [3], lab.nodes[1:5], coherence=coherence)
    inside = humming.expand_as(std)
    for n_average in (16, None):
        ratio = noise_level(given, n_average).std / std
        # The edges of the band are smeared over the lines of the local mean.
        assert float(ratio[inside].median()) == pytest.approx(1.0, rel=0.1)
        assert float(ratio[~inside].median()) == pytest.approx(1.0, rel=0.1)
    plain = noise_level(lab.measured(frequency, mean, [3], lab.nodes[1:5])).std / std
    assert float(plain[inside].median()) < 0.8


@pytest.mark.check
@pytest.mark.parametrize("n_average", [3, None])
def test_a_coherence_of_few_averages_makes_no_line_too_sure(lab, n_average):
    """By chance it is near 1 at some lines: residuals there would be many times their noise."""
    frequency = lab.lines(0.5)
    frf = lab.plate().frf(lab.nobody, frequency, [3], lab.nodes[1:9])
    std = lab.true_std(frf, 0.02, "sensor")
    # Three hits of different strength: H1, and its coherence.
    generator = torch.Generator().manual_seed(13)
    force = torch.exp(0.3 * torch.randn(3, 1, 1, frf.shape[2], generator=generator, dtype=torch.float64))
    response = frf * force + lab.noise_of((math.sqrt(3) * std).expand(3, *frf.shape), 13)
    both, power = (force * response).sum(0), force.square().sum(0)
    coherence = both.abs().square() / (power * response.abs().square().sum(0))
    given = lab.measured(frequency, both / power, [3], lab.nodes[1:9], coherence=coherence)
    ratio = (given.frf - frf).abs().square() / (2 * noise_level(given, n_average).std.square())
    assert float(ratio.mean()) == pytest.approx(1.0, rel=0.1)
    # One in a thousand of exponential numbers is above 6.9.
    assert float(ratio.quantile(0.999)) < 8.0


@pytest.mark.check
def test_a_coherence_that_claims_too_little_noise_is_not_believed(lab):
    frequency = lab.lines(1.0)
    frf = lab.plate().frf(lab.nobody, frequency, [3], lab.nodes[1:5])
    std = lab.true_std(frf, 0.02, "signal")
    mean, coherence = averaged(lab, frf, std, 8, seed=9)
    without = noise_level(lab.measured(frequency, mean, [3], lab.nodes[1:5]))
    for unreal in (torch.ones_like(coherence), 1 - (1 - coherence) / 100):
        found = noise_level(lab.measured(frequency, mean, [3], lab.nodes[1:5], coherence=unreal), 8)
        assert torch.equal(found.std, without.std)
    believed = noise_level(lab.measured(frequency, mean, [3], lab.nodes[1:5], coherence=coherence), 8)
    assert believed.floor == pytest.approx(0.02, rel=0.08)
    assert not torch.equal(believed.std, without.std)


@pytest.mark.parametrize("distorted", [[], [2], [0, 3], [1, 2, 4]])
def test_what_repeats_in_every_record_is_no_noise(lab, distorted):
    """A clipped sensor scatters over the lines alike in all records: their coherence does not see it."""
    frequency = lab.lines(1.0)
    frf = lab.plate().frf(lab.nobody, frequency, [3], lab.nodes[1:7])
    std = lab.true_std(frf, 0.02, "sensor")
    rough = lab.noise_of(4 * std, 21)
    kept = torch.zeros(1, frf.shape[2], dtype=torch.bool)
    kept[0, distorted] = True
    mean, coherence = averaged(lab, frf + rough * kept, std, 8, seed=14)
    found = noise_level(lab.measured(frequency, mean, [3], lab.nodes[1:7], coherence=coherence), 8)
    assert torch.equal(found.distorted, kept)


@pytest.mark.parametrize(
    ("noisy", "times", "loud"),
    [([], 100, []), ([2], 100, [2]), ([0, 4], 100, [0, 4]), ([0, 1, 2, 3], 100, []), ([2], 15, [2]), ([2], 7, [])],
)
@pytest.mark.check
def test_what_scatters_many_times_as_much_as_the_others_is_told(lab, noisy, times, loud):
    """Without a coherence a clipped sensor looks as noisy as what it adds; the others say how noisy the test is."""
    frequency = lab.lines(1.0)
    frf = lab.plate().frf(lab.nobody, frequency, [3], lab.nodes[1:7])
    # One near a nodal line is mostly noise too, and no noisier than the others.
    frf[:, :, 5] *= 1e-3
    # Of one that scatters 15 times as much most is still the plate.
    std = lab.true_std(frf, 0.02 if times == 100 else 0.005, "sensor")
    std[:, :, 5] = std[:, :, 4]
    which = torch.zeros(1, frf.shape[2], dtype=torch.bool)
    which[0, noisy] = True
    given = frf + lab.noise_of(torch.where(which, times, 1.0) * std, 21)
    found = noise_level(lab.measured(frequency, given, [3], lab.nodes[1:7]))
    assert found.loud[0].nonzero().flatten().tolist() == loud


@pytest.mark.check
def test_exchanged_frfs_are_held_against_the_noise(lab):
    frf = lab.plate().frf(lab.nobody, lab.lines(1.0), lab.nodes[:3], lab.nodes[:3])
    std = lab.true_std(frf, 0.02, "signal")
    for factor, said in ((1.0, "both ways round differ by 2.0"), (1.3, "more than noise")):
        uneven = torch.ones(3, 3, dtype=torch.float64)
        uneven[0, 1] = uneven[0, 2] = uneven[1, 2] = factor
        given, _ = measurement(lab, frf * uneven, std, seed=10, n_response=3)
        assert said in noise_level(given).sentences[-1]


def test_one_average_is_refused(lab):
    frf = torch.ones(30, 1, 1, dtype=torch.complex128)
    with pytest.raises(ValueError, match="n_average of 2 or more, got 1"):
        noise_level(lab.measured(torch.linspace(1.0, 30.0, 30, dtype=torch.float64), frf, [3], [5]), 1)


def test_a_pole_is_never_added_twice(lab):
    # Two poles at one place are one: a basis that has both is singular, and its slope without bound.
    frf = lab.plate().frf(lab.nobody, lab.lines(1.0), lab.nodes[:1], lab.nodes[1:9])
    fit = RationalFit(lab.lines(1.0), frf[:, 0] / frf.abs().mean())
    fit.weigh()
    line = torch.tensor([0])
    assert [fit.add(line) for _ in range(4)] == [True, True, True, False]
    assert len({complex(pole) for pole in fit.pole}) == 3
    fit.settle(3)
    assert float(fit.slope.max()) < 1e6
