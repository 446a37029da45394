"""What natural frequencies say is missing, where peaks of FRFs do not overlap."""

import math

import pytest
import torch

from torchplate.diagnosis.fit import NOBODY
from torchplate.diagnosis.holdout import held_out
from torchplate.diagnosis.selection.by_frequencies import paired, sharp
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.table import Asked
from torchplate.diagnosis.target import FrfTarget
from torchplate.effects import CATALOGUE
from torchplate.measurement import PERFECT, NaturalFrequencies, noise_level
from torchplate.model import PlateModel, Searched, SparseModel, extrapolate, reduce
from torchplate.plate import Mesh

MODES = torch.tensor([30.0, 41.0, 55.0, 72.0, 77.0, 101.0, 128.0], dtype=torch.float64)
NOTHING = torch.zeros(0, dtype=torch.float64)
SIDES = (0.4, 0.3)
NUMBERS = {"youngs_modulus": 7.0e10, "poisson_ratio": 0.33, "density": 2700.0, "thickness": 0.003}
RESPONSE, REFERENCE = (1, 7, 41, 45), (63, 30, 19)
# At an edge, on lines of 40 × 30 elements.
NOTCH = (5 / 40, 24 / 30, 9 / 40, 1.0)


@pytest.mark.parametrize(
    ("missed", "more"), [((), []), ((0,), []), ((3,), []), ((1, 4), []), ((), [64.0]), ((0,), [64.0])]
)
def test_each_measured_frequency_has_its_mode_though_the_test_missed_some(missed, more):
    kept = [k for k in range(len(MODES)) if k not in missed]
    off = 1 + 0.02 * torch.tensor([1.0, -1.0, 0.5, -0.5, 1.0, 0.0, -1.0], dtype=torch.float64)
    seen, order = torch.cat([(MODES * off)[kept], torch.tensor(more, dtype=torch.float64)]).sort()
    here, mode = paired(seen, MODES, 0.05, 0.1)
    assert mode.tolist() == kept
    # What is none of them stays alone.
    assert order[here].tolist() == list(range(len(kept)))


def test_where_one_has_nothing_nothing_is_paired():
    for measured, modes in ((MODES[:0], MODES), (MODES, MODES[:0]), (MODES[:0], MODES[:0])):
        assert [len(one) for one in paired(measured, modes, 0.05, 0.1)] == [0, 0]


def test_a_pole_that_stands_for_what_is_smooth_beside_another_is_no_mode():
    frequency = torch.tensor([50.0, 60.0, 61.0, 300.0, 312.0], dtype=torch.float64)
    loss = torch.tensor([0.01, 0.02, 0.03, 0.008, 0.06], dtype=torch.float64)
    pole = torch.complex(frequency.square(), frequency.square() * loss)
    # Two that overlap are both modes; one of 19 Hz beside one of 2 Hz is none.
    torch.testing.assert_close(sharp(pole.flip(0)), frequency[:4])


def plate(searched=None, cells=(8, 6, 1), cut=()):
    effects = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"]()}
    numbers = {f"plate.{name}": value for name, value in NUMBERS.items()} | {"loss.stiffness_loss_factor": 5e-3}
    numbers = {key: value for key, value in numbers.items() if key not in (searched or {})}
    response, reference = (Mesh(*SIDES, 8, 6).places(labels).tolist() for labels in (RESPONSE, REFERENCE))
    return PlateModel(
        Mesh(*SIDES, *cells, cut=cut), effects, numbers, searched, response, reference, kind="accelerance"
    )


@pytest.mark.check
@torch.no_grad()
def test_a_notch_in_a_table_ends_where_it_is():
    """In the modes of the whole plate, which bend at its edge, it ends elsewhere."""
    fine = extrapolate(plate(cells=(40, 30, 1), cut=(NOTCH,)), 700.0).model
    frequency = SparseModel(fine, NOTHING).modes(17).frequency[3:17]
    table = NaturalFrequencies(torch.arange(4, 18), frequency, 5e-4 * frequency)
    every = Asked(plate(searched={"plate.youngs_modulus": Searched(5e10, 9e10)}), table, {}).singles
    best = every[0]
    # Each edge is an effect of its own.
    edges = [one.options[0]["edge"] for one in every if one.names == ("edge_spring",)]
    assert len(edges) > 1
    assert len({*edges}) == len(edges)
    assert best.names == ("cut_out",)
    assert best.left < 1e-3
    # Frequencies do not tell it from its mirror images.
    ends = {axis: sorted((best.own[0][f"{axis}0"], best.own[0][f"{axis}1"])) for axis in "xy"}
    for axis, true in (("x", NOTCH[::2]), ("y", NOTCH[1::2])):
        mirrored = [1 - one for one in reversed(ends[axis])]
        assert min(math.dist(one, true) for one in (ends[axis], mirrored)) < 0.005
    assert best.others["plate.youngs_modulus"] == pytest.approx(7e10, rel=2e-3)


def beside(lab, exact, line):
    """Forward selection beside FRFs with noise, and its baseline."""
    box = {"plate.youngs_modulus": Searched(5e10, 9e10), "loss.stiffness_loss_factor": Searched(1e-4, 5e-2, True)}
    frfs = lab.measured(line, exact + lab.noise_of(lab.true_std(exact, 0.003, "mixed"), 3), RESPONSE, REFERENCE)
    target = FrfTarget(frfs, noise_level(frfs, None), held_out(frfs.measured, 0), False, PERFECT)
    forward = ForwardSelection.of(plate(searched=box), target, {}, lambda _: None)
    return forward, forward.baseline()


@pytest.mark.check
@torch.no_grad()
def test_a_notch_is_found_by_them_and_its_mirror_image_by_the_frfs(lab):
    line = torch.arange(20.0, 700.0, 2.0, dtype=torch.float64)
    fine = reduce(extrapolate(plate(cells=(40, 30, 1), cut=(NOTCH,)), 700.0).model, line)
    assert fine is not None
    forward, state = beside(lab, fine[0].frf(NOTHING, line), line)
    asked = forward.ranking.by_frequencies
    _, everyone = forward.ranking.catalogue_beside(state)
    assert state.fit.reduced_misfit > 100
    best = min(asked.of(state, [], everyone, math.inf, NOBODY), key=lambda one: one.fit.cost)
    assert best.name == "cut_out"
    (x0, x1), (y0, y1) = (sorted((best.own[f"{axis}0"], best.own[f"{axis}1"])) for axis in "xy")
    assert (x0, y0, x1, y1) == pytest.approx(NOTCH, abs=0.01)
    assert best.fit.square < 0.01 * state.fit.square
    # Where something leaves little, nobody asks them.
    assert best.fit.reduced_misfit < 12
    assert asked.of(state, [best], everyone, math.inf, NOBODY) == []


@pytest.mark.check
@torch.no_grad()
def test_two_effects_are_found_where_neither_alone_leaves_little(lab):
    """Beside a Poisson's ratio that is wrong no peak is where a mass moves it, and the other way round."""
    line = torch.arange(20.0, 600.0, 0.5, dtype=torch.float64)
    numbers = {f"plate.{name}": value for name, value in (NUMBERS | {"poisson_ratio": 0.22}).items()}
    numbers |= {"loss.stiffness_loss_factor": 5e-3, "mass.x": 0.95, "mass.y": 0.55, "mass.mass": 0.08}
    true = extrapolate(plate(cells=(24, 18, 1)), 700.0).model
    true = true.replaced(effects=true.effects | {"mass": CATALOGUE["point_mass"]()}, known=numbers)
    forward, state = beside(lab, true.frf(NOTHING, line), line)
    asked = forward.ranking.by_frequencies
    _, everyone = forward.ranking.catalogue_beside(state)
    assert state.fit.reduced_misfit > 100
    table = Asked(state.model, asked.table(state), {})
    assert table.pairs[0].left < 0.01 < 0.1 < table.singles[0].left
    both = asked.both(state, [], everyone)
    assert {both.first.name, both.second.name} == {"point_mass", "poisson_ratio"}
    assert both.second.fit.reduced_misfit < 1.5
    # The first as it is beside the second, which it lacks.
    values = both.second.fit.model.as_dict(both.second.fit.theta)
    beside_it = {key: values[f"{both.first.label}.{key}"] for key in both.first.own}
    assert both.first.own == pytest.approx(beside_it)
    assert both.first.fit.reduced_misfit > 100
    found = both.first.own | both.second.own
    assert (found["x"], found["y"]) == pytest.approx((0.95, 0.55), abs=0.01)
    assert (found["mass"], found["value"]) == pytest.approx((0.08, 0.22), rel=0.03)
    # Where one that was fitted leaves as little, two are not asked for.
    assert asked.both(state, [both.second], everyone) is None
    # The search names both, though each fit of one alone comes nowhere near.
    final, _ = forward.add_effects(state, 2)
    assert {one.hypothesis.name for one in final.named} == {"point_mass", "poisson_ratio"}
    assert final.fit.reduced_misfit < 1.5
