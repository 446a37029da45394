"""The strata: what the clean one drew before it draws now, and what the others hold."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from blind import noise, tables, workshop
from blind.cases import draw
from blind.detect import needed, seen
from blind.effects import Hidden
from blind.fisher import Marginal
from blind.nuisances import CLEAN, WORKSHOP, spoil
from blind.plates import ALUMINIUM, draw_specimen
from blind.response import Chain, Damping, Test, frf
from blind.ritz import Patch, modes
from blind.strata import STRATA
from blind.suite import chosen
from blind.test_ritz import PLATE
from torchplate.cli.config.build import load_run

# The truth of a benchmark that only `make blind` runs.
pytestmark = pytest.mark.check


@pytest.mark.parametrize(
    ("index", "level", "norm", "parameters"),
    [
        (
            17,
            0.0098693888270056,
            2593.4302605770786,
            {"slope_x": -0.14055298108060438, "slope_y": -0.22829753137774705},
        ),
        (69, 0.014480689166525684, 1950.3029060362962, None),
        (110, 0.005386006238940028, 894.0373495316269, {"x": 0.30183475240316326, "y": 0.7148520149489324}),
    ],
)
def test_the_clean_stratum_draws_what_it_always_drew(index, level, norm, parameters):
    case = draw("A", index)
    assert case.noise == pytest.approx(level, rel=1e-12)
    # The FRFs come through an eigensolver: to rounding, times what a light damping makes of it.
    assert float(torch.linalg.vector_norm(case.measurement.frf)) == pytest.approx(norm, rel=1e-6)
    if parameters is not None:
        drawn = case.truth[0].parameters
        assert {name: drawn[name] for name in parameters} == pytest.approx(parameters, rel=1e-12)
    assert CLEAN.items() <= case.config["measurement"].items()


def test_each_stratum_holds_what_it_says():
    count = {name: Counter(slot.kind for slot in stratum.suite()) for name, stratum in STRATA.items()}
    assert count["workshop"] == {"none": 40, "beyond": 20, "two": 30, "one": 110}
    assert count["tables"] == {"none": 50, "two": 40, "one": 110}
    assert len(chosen("0:", "none", "tables")) == 50
    alone = Counter(slot.names[0] for slot in workshop.suite() if slot.kind == "one")
    assert set(alone) == {name for slot in STRATA["clean"].suite() if slot.kind == "one" for name in slot.names}
    assert min(alone.values()) >= 4


def index_of(stratum, kind, turn=0):
    return [i for i, slot in enumerate(STRATA[stratum].suite()) if slot.kind == kind][turn]


@pytest.mark.parametrize("stratum", ["workshop", "tables"])
def test_a_case_is_the_same_whenever_it_is_drawn_and_torchplate_reads_it(stratum, tmp_path):
    index = index_of(stratum, "none")
    first, again, other = (STRATA[stratum].case(seed, index, None) for seed in ("A", "A", "B"))
    assert first.record() == again.record()
    assert first.record()["noise"] != other.record()["noise"]
    path = first.write(tmp_path)
    assert yaml.safe_load(path.read_text()) == first.config
    run = load_run(path)
    run.objective(run.model())
    assert first.record()["stratum"] == stratum


def test_layouts_are_of_all_sizes_and_no_case_is_too_large():
    rng = np.random.default_rng(3)
    perfect = draw_specimen(rng, ALUMINIUM, False, frozenset())
    tests = [workshop.with_layout(rng, perfect, 1).test for _ in range(200)]
    n_frf = np.array([len(t.response) * len(t.reference) for t in tests])
    n_line = np.array([len(t.frequency) for t in tests])
    assert (n_frf.min(), n_frf.max() > 80) == (1, True)
    assert ((n_frf >= 6) & (n_frf <= 40)).mean() > 0.6
    assert n_line.min() < 120
    assert n_line.max() > 1200
    assert ((n_line >= 200) & (n_line <= 1200)).mean() > 0.6
    assert (n_frf * n_line).max() <= 1.1 * workshop.N_DATA


@pytest.mark.parametrize("shape", noise.SHAPES)
def test_noise_of_every_shape_is_as_large_as_asked_for(shape):
    rng = np.random.default_rng(4)
    test = Test([(0.25, 0.375)], [(0.75, 0.875), (0.1, 0.3)], np.linspace(5.0, 400.0, 3000), "mobility")
    clean = frf(PLATE, Damping(0.004), Chain(), test)
    read, sigma, coherence, n = noise.spoil(rng, clean, test, 0.02, shape)
    # Few large peaks carry noise in proportion to |H|, so that the norm of the noise itself scatters.
    for found in (sigma, read - clean):
        np.testing.assert_allclose(np.linalg.norm(found, axis=0) / np.linalg.norm(clean, axis=0), 0.02, rtol=0.35)
    assert (coherence is None) == (n is None) == (shape != "few_averages")
    if coherence is not None:
        said = np.abs(read) ** 2 * (1 - coherence) / ((n - 1) * coherence)
        assert np.sqrt(said.mean() / (sigma**2).mean()) == pytest.approx(1.0, rel=0.1)


def test_drift_and_calibration_are_those_of_each_record_and_channel():
    test = Test([(0.25, 0.375), (0.9, 0.2)], [(0.75, 0.875), (0.1, 0.3)], np.linspace(5.0, 200.0, 200), "accelerance")
    gain = np.array([[1.01, 0.99], [1.02, 1.0]])
    read = frf(PLATE, Damping(0.01), Chain(calibration=gain, drift=np.array([0.0, 1e-3])), test)
    plain = frf(PLATE, Damping(0.01), Chain(), test)
    np.testing.assert_allclose(read[:, :, 0], gain[:, 0] * plain[:, :, 0], rtol=1e-12)
    # All stiffness, damping in proportion to it included, grows by (1 + δ)²; dashpots hardly matter.
    stiffer = replace(PLATE, young=PLATE.young * 1.001**2, springs=[(x, y, k * 1.001**2) for x, y, k in PLATE.springs])
    exact = gain[:, 1] * frf(stiffer, Damping(0.01), Chain(), test)[:, :, 1]
    assert np.linalg.norm(read[:, :, 1] - exact) < 2e-3 * np.linalg.norm(exact)
    assert np.linalg.norm(plain[:, :, 1] - exact) > 0.02 * np.linalg.norm(exact)


def test_a_mode_with_twice_the_damping_peaks_at_half_the_height():
    bare = replace(PLATE, dashpots=[])
    top = modes(bare).frequency[3:6]
    test = Test([(0.02, 0.03)], [(0.02, 0.03)], top, "accelerance")
    plain, scattered = (
        frf(bare, Damping(1e-3, scatter=f), Chain(), test)[:, 0, 0] for f in ((), (1, 1, 1, 2.0, 1, 0.5))
    )
    np.testing.assert_allclose(np.abs(scattered / plain), [0.5, 1.0, 2.0], rtol=0.02)


SHEET = frozenset(["length_x", "length_y", "thickness", "density"])


@pytest.fixture(scope="module")
def spoilt():
    """An aluminium plate with nuisances of its own, its noise, and what its FRFs are judged by."""
    rng = np.random.default_rng(11)
    perfect = draw_specimen(rng, ALUMINIUM, False, frozenset())
    nodes = (20, 40), (31, 57, 77)
    places = [[perfect.place(node) for node in own] for own in nodes]
    test = Test(*places, np.arange(5.0, 200.0, 1.0), "accelerance")
    drawn = spoil(rng, replace(perfect, test=test, response=nodes[0], reference=nodes[1]), WORKSHOP, frozenset(), True)
    truth = workshop.with_all(drawn, [])
    sigma = 0.01 * noise.levels(truth.frf(), test, "two_component")
    return drawn, truth, Marginal(truth, 4, sigma, WORKSHOP, SHEET), sigma


def test_what_is_searched_and_nothing_at_all_cost_nothing(spoilt):
    _, truth, marginal, _ = spoilt
    assert marginal.left(truth) < 1e-9
    stiffer = replace(truth, plate=replace(truth.plate, young=1.02 * truth.plate.young))
    # A tenth of what the cheapest effect needs.
    assert marginal.left(stiffer) < 0.1 * needed(1)


def test_a_nuisance_of_one_standard_deviation_costs_one(spoilt):
    _, truth, marginal, _ = spoilt
    grain = replace(truth, plate=replace(truth.plate, young_ratio=truth.plate.young_ratio * 1.01))
    gained = replace(truth, chain=replace(truth.chain, gain=1.01))
    # The grain may be had of other nuisances for less; two gains share one that is common to all: 2 · 3 / (2 + 3).
    assert marginal.left(grain) < 1.5
    assert marginal.left(gained) < 1.3
    damped = replace(truth, damping=replace(truth.damping, scatter=tuple(1.15 * f for f in truth.damping.scatter)))
    assert marginal.left(damped) < 3.0


def test_a_mass_shows_the_more_the_heavier_it_is_and_the_less_noise_hides_it(spoilt):
    drawn, truth, marginal, sigma = spoilt
    light, heavy = (
        workshop.with_all(drawn, [Hidden("point_mass", {}, {"x": 0.31, "y": 0.72, "mass": mass})])
        for mass in (0.0002, 0.004)
    )
    assert seen(marginal.left(light), 3) == "no"
    shown = marginal.left(heavy)
    assert seen(shown, 3) == "yes"
    # Were noise all that hides it, λ would fall to a hundredth.
    noisy = Marginal(truth, 4, 10 * sigma, WORKSHOP, SHEET).left(heavy)
    assert 0.005 * shown < noisy < 0.5 * shown


def test_a_fall_is_seen_where_19_of_20_tests_see_enough():
    bound = needed(3)
    # 2 ln 30 + 3 · 2 ln (10 / √(2π)).
    assert bound == pytest.approx(15.1, abs=0.1)
    scatter = np.random.default_rng(5).standard_normal(20_000)
    for fall in np.linspace(0.1, 80.0, 60):
        above = float(((fall + 2 * np.sqrt(fall) * scatter) > bound).mean())
        assert (seen(fall, 3) == "yes") == (above > 0.95) or abs(above - 0.95) < 0.01
        assert (seen(fall, 3) == "no") == (above < 0.05) or abs(above - 0.05) < 0.01


def test_a_table_holds_flexible_modes_as_printed():
    case = STRATA["tables"].case("A", index_of("tables", "none"), None)
    table = case.config["measurement"]["natural_frequencies"]
    values = {mode: value["value"] if isinstance(value, dict) else value for mode, value in table.items()}
    true = modes(case.specimen.plate).frequency
    assert 10 <= len(values) <= 20
    assert min(values) >= 4
    for mode, value in values.items():
        # Four standard deviations of the scatter, and half a unit of the coarsest print.
        assert abs(value - true[mode - 1]) < 4 * case.noise * true[mode - 1] + 0.5
    assert set(tables.ALONE) >= {slot.names[0] for slot in tables.suite() if slot.kind == "one"}


PLATES = {
    "plain": PLATE,
    "mass": replace(PLATE, masses=[(0.31, 0.62, 0.06)]),
    "patch of any aspect": replace(PLATE, patches=[Patch(0.33, 0.61, 0.25, 0.4, aspect=2.2)]),
    "edge": replace(PLATE, edge_springs=[("x0", 1e5, 1e3)]),
    "all that wanders": replace(
        PLATE, taper=(0.1, -0.2), young_ratio=1.02, thickness_wander=(0.005, -0.004, 0.006, 0.003, -0.005),
        modulus_wander=(0.005, 0.004, -0.006, 0.003, 0.005), aspect_ratio=1.03, masses=[(0.2, 0.3, 0.003)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PLATES)
def test_both_truths_have_the_same_natural_frequencies(name):
    one, other = (modes(replace(PLATES[name], by=by)) for by in ("ritz", "spectral"))
    in_band = one.frequency < 400
    assert in_band.sum() > 10
    # The least width of a peak is 1.5e-3 of its frequency; the issue's own measure of agreement.
    np.testing.assert_allclose(other.frequency[: in_band.sum()], one.frequency[in_band], rtol=1e-4)


def test_both_truths_have_the_same_frfs_with_a_lossy_patch():
    plate = replace(PLATES["all that wanders"], patches=[Patch(0.4, 0.55, 0.25, 0.7, 0.3, 0.6)])
    test = Test([(0.25, 0.375), (1.0, 0.25)], [(0.75, 0.875)], np.arange(5.0, 400.0), "accelerance")
    damping = Damping(2e-3, scatter=(1.0, 0.9, 1.1, 1.2, 0.8, 1.3))
    one, other = (frf(replace(plate, by=by), damping, Chain(), test) for by in ("ritz", "spectral"))
    # 1e-5 of a frequency is 1e-5 / 2e-3 of a peak's width.
    assert np.linalg.norm(one - other) < 0.01 * np.linalg.norm(one)


@pytest.mark.parametrize("at", [(0.4, 0.3), (0.1, 0.0)])
def test_both_truths_have_the_same_frfs_with_a_mass_that_moves_with_the_sensor(at):
    """And both those of a plate that carries it there."""
    plate, mass = replace(PLATE, young_ratio=1.02), 0.02 * PLATE.mass
    test = Test([at, (0.8, 0.7)], [(0.75, 0.875)], np.arange(5.0, 400.0), "accelerance")
    one, other = (
        frf(replace(plate, by=by), Damping(2e-3), Chain(sensor_mass=mass), test) for by in ("ritz", "spectral")
    )
    carried = frf(replace(plate, masses=[(*at, mass)]), Damping(2e-3), Chain(), test)
    # A third of the least noise.
    for found, wanted in ((other, one), (one[:, 0], carried[:, 0])):
        assert np.linalg.norm(found - wanted) < 1e-3 * np.linalg.norm(wanted)
