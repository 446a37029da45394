"""What every test has is not named, what it would have to be is said, and what ails single channels bends nothing."""

import pytest
import torch

import torchplate as tp
from torchplate.diagnosis.holdout import held_out
from torchplate.diagnosis.remarks import would_take
from torchplate.diagnosis.selection import forward
from torchplate.diagnosis.selection.criterion import excessive, is_noise
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.selection.screen import screen
from torchplate.diagnosis.selection.starts import beside_what_was_told
from torchplate.diagnosis.target import FrfTarget
from torchplate.effects import CATALOGUE
from torchplate.measurement import PERFECT, Imperfections
from torchplate.measurement.assessment.noise import noise_level
from torchplate.model import PlateModel, Searched, extrapolate
from torchplate.plate import Mesh

SIDES = (0.43, 0.3)
LINES = torch.linspace(20.0, 275.0, 120, dtype=torch.float64)
RESPONSE = (3, 17)
REFERENCE = (7, 9, 14)
MANY = (1, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15, 16, 18, 20, 2, 10, 19, 3, 17)
TRUE = {"plate.youngs_modulus": 2.05e11, "loss.stiffness_loss_factor": 1e-2}
KNOWN = {
    "plate.poisson_ratio": 0.3,
    "plate.density": 7850.0,
    "plate.thickness": 0.003,
    "wires.stiffness": 1500.0,
    "wires.viscous_damping": 0.7,
}
BOX = {
    "plate.youngs_modulus": Searched(1.7e11, 2.4e11),
    "loss.stiffness_loss_factor": Searched(1e-3, 5e-2, True),
}
# Over a millimetre deflections change by a hundredth, as much as the noise: beyond that the second order counts.
TOLD = Imperfections(position_std=1e-3, frequency_drift=0.0, calibration_std=0.01, damping_scatter=0.0)


def plate(known, searched, response, reference, refine=1, **more) -> PlateModel:
    effects = {
        "plate": CATALOGUE["plate"](),
        "loss": CATALOGUE["hysteretic_damping"](),
        "wires": CATALOGUE["support_spring"](nodes=(2, 10, 19)),
        **more,
    }
    return PlateModel(Mesh(*SIDES, 4, 3, refine), effects, known, searched, response, reference, "accelerance")


def hammered(lab, seed=0, imperfections=PERFECT, response=RESPONSE, reference=REFERENCE):
    """A measurement with one draw of what is not perfect: places of hits and sensors, levels of channels."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    nodes = Mesh(*SIDES, 4, 3)
    points = []
    for labels in (response, reference):
        off = imperfections.std("position_std") / torch.tensor(SIDES, dtype=torch.float64)
        # What would miss the plate lands on its edge.
        moved = (nodes.places(list(labels)) + off * normal(len(labels), 2)).clamp(0, 1)
        points.append([tuple(one) for one in moved.tolist()])
    exact = extrapolate(plate(KNOWN | TRUE, {}, *points, refine=4), float(LINES[-1])).model.frf(lab.nobody, LINES)
    level = imperfections.std("calibration_std")
    frf = exact * (1 + level * normal(len(response), 1)) * (1 + level * normal(1, len(reference)))
    noise = lab.noise_of(lab.true_std(frf, 1e-2, "mixed"), 70 + seed)
    return lab.measured(LINES, frf + noise, response, reference)


def given(response=RESPONSE, reference=REFERENCE) -> PlateModel:
    """The model as it is believed."""
    return plate(KNOWN, BOX, list(response), list(reference))


def selection_of(measurement, model, imperfections=PERFECT) -> ForwardSelection:
    """Where a diagnosis begins."""
    noise = noise_level(measurement)
    target = FrfTarget(measurement, noise, held_out(measurement.measured), imperfections=imperfections)
    return ForwardSelection.of(model, target, {}, lambda _: None)


@pytest.mark.check
def test_a_test_as_imperfect_as_it_was_told_is_consistent(lab):
    measured = hammered(lab, 0, TOLD)
    found = tp.diagnose(given(), measured, imperfections=TOLD)
    assert found.verdict == "consistent"
    assert [one.name for one in found.effects if one.name != "mesh_discretisation"] == []
    assert found.missing == ()
    # Far more than noise is left, and no more than noise and nuisances make.
    assert found.gap.final > 2 * found.gap.noise_floor
    assert found.gap.expected is not None
    assert found.gap.final < found.gap.expected
    for name, true in TRUE.items():
        one = found.parameters[name]
        assert one.value == pytest.approx(true, abs=4 * one.std)


@pytest.mark.check
@torch.no_grad()
def test_how_large_a_nuisance_would_have_to_be_is_said(lab):
    # Hits and sensors 3 mm off, where a quarter of a millimetre was told.
    measured = hammered(lab, 3, Imperfections(3e-3, 0.0, 0.0, 0.0))
    selection = selection_of(measured, given(), Imperfections(2.5e-4, 0.0, 0.0, 0.0))
    baseline = selection.baseline()
    large = excessive(baseline.fit)
    # Twelve places along two sides: a size is good to a fifth; and the prior holds it back.
    assert large["position_std"] == pytest.approx(12.0, rel=0.5)
    assert not is_noise(baseline.fit)
    (said,) = would_take(baseline.fit)
    assert f"hits and sensors off their marks {large['position_std']:.1f} times as large as was said" in said
    # Where that was told, nothing more is needed.
    enough = selection_of(measured, given(), Imperfections(3e-3, 0.0, 0.0, 0.0)).baseline()
    assert excessive(enough.fit) == {}
    assert would_take(enough.fit) == ()


@torch.no_grad()
def softened(lab):
    """Where a diagnosis of a plate with a large soft patch begins, its test told to be a careful one, and the truth."""
    patch = {"weak.x": 0.7, "weak.y": 0.35, "weak.size": 0.4, "weak.factor": 0.7}
    soft = plate(KNOWN | TRUE | patch, {}, [*RESPONSE], [*REFERENCE], 4, weak=CATALOGUE["stiffness_loss"]())
    exact = extrapolate(soft, float(LINES[-1])).model.frf(lab.nobody, LINES)
    noise = lab.noise_of(lab.true_std(exact, 1e-2, "mixed"), 5)
    measured = lab.measured(LINES, exact + noise, RESPONSE, REFERENCE)
    return selection_of(measured, given(), Imperfections()), patch


@torch.no_grad()
@pytest.mark.check
def test_candidates_are_scored_beside_the_plate_as_it_was_told(lab):
    """Where a thickness and a modulus that wander by many times what plates have took on a soft patch."""
    selection, _ = softened(lab)
    baseline = selection.baseline()
    assert {"thickness", "modulus"} <= excessive(baseline.fit).keys()
    here = beside_what_was_told(selection.builder, selection.prior, baseline)
    assert here.fit.about is None
    base, everyone = selection.ranking.catalogue_beside(here)
    promised = screen(selection.builder, base, here.fit.theta, everyone, selection.prior)
    assert max(promised, key=lambda one: one.drop).candidate.name == "stiffness_loss"
    # Where it is no larger than plates have, it stays what it was.
    assert beside_what_was_told(selection.builder, selection.prior, here) is here


@torch.no_grad()
@pytest.mark.check
def test_dampings_that_took_on_a_window_are_put_back_and_the_section_is_kept(lab):
    """No peak moves with them: beside their law the window promises most, and its refit ends where it is."""
    window = {"window": CATALOGUE["exponential_window"]()}
    clear = plate(KNOWN | TRUE | {"window.rate": 12.0}, {}, [*RESPONSE], [*REFERENCE], 4, **window)
    exact = extrapolate(clear, float(LINES[-1])).model.frf(lab.nobody, LINES)
    measured = lab.measured(LINES, exact + lab.noise_of(lab.true_std(exact, 3e-3, "mixed"), 5), RESPONSE, REFERENCE)
    selection = selection_of(measured, given(), Imperfections())
    baseline = selection.baseline()
    assert excessive(baseline.fit).keys() == {"damping_scatter"}
    here, about = beside_what_was_told(selection.builder, selection.prior, baseline), baseline.fit.about
    assert about is not None
    known = here.fit.about
    assert known is not None
    damped = torch.tensor([name == "damping_scatter" for name in about.names])
    assert 0 < int(damped.sum()) < len(damped)
    assert torch.equal(known.shift, torch.where(damped, 0.0, about.shift))
    assert torch.equal(known.spread, about.spread)
    assert bool(about.shift[damped].abs().max() > 1.0)
    ranked = selection.ranking.at(baseline)
    best = min(ranked.hypotheses, key=lambda one: one.cost)
    assert best.name in ("exponential_window", "viscous_damping")
    assert is_noise(best.fit)


@pytest.mark.check
@torch.no_grad()
def test_what_large_nuisances_took_on_is_found_where_it_is(lab):
    selection, patch = softened(lab)
    best = min(selection.ranking.at(selection.baseline()).hypotheses, key=lambda one: one.fit.cost)
    assert best.name == "stiffness_loss"
    assert is_noise(best.fit)
    for name, true in patch.items():
        assert best.own[name.removeprefix("weak.")] == pytest.approx(true, abs=0.02)


@torch.no_grad()
@pytest.mark.check
def test_a_fit_that_is_judged_again_costs_what_it_did(lab):
    """Else hypotheses would be compared with a baseline that is judged beside nuisances of another size."""
    selection = selection_of(hammered(lab, 1, TOLD), given(), TOLD)
    baseline = selection.baseline()
    again = selection.here(baseline)
    # But for the way to the unit cube and back.
    torch.testing.assert_close(again.fit.theta, baseline.fit.theta, rtol=1e-12, atol=0.0)
    assert again.fit.cost == pytest.approx(baseline.fit.cost, abs=1.0)


@pytest.mark.check
@torch.no_grad()
def test_frfs_that_turn_out_to_agree_are_taken_in_again(lab, monkeypatch):
    """Or every effect would be held against a baseline that was not fitted to them."""
    selection = selection_of(hammered(lab, 1, TOLD), given(), TOLD)
    baseline = selection.baseline()
    asked = []

    def first_odd(measured, misfit):
        asked.append(misfit)
        odd = torch.zeros_like(measured)
        odd[0, :2] = len(asked) == 1
        return odd

    fitted, again = [], forward.ForwardSelection.again

    def watched(self, state):
        fitted.append(int(self.builder.target.fitted.sum()))
        return again(self, state)

    monkeypatch.setattr(forward, "outliers", first_odd)
    monkeypatch.setattr(forward.ForwardSelection, "again", watched)
    robust, taken = selection.robust_baseline(baseline)
    assert len(asked) == 2
    # Without the two, then with them.
    every = int(robust.builder.target.fitted.sum())
    assert fitted == [every - 2, every]
    assert is_noise(taken.fit)


@pytest.mark.check
@torch.no_grad()
def test_two_swapped_references_among_twenty_bend_neither_modulus_nor_loss(lab):
    measured = hammered(lab, 5, response=RESPONSE[:1], reference=MANY)
    # As unlike as two places are: what they do to the fit is largest.
    measured.frf[..., [0, 13]] = measured.frf[..., [13, 0]]
    selection = selection_of(measured, given(RESPONSE[:1], MANY))
    bent = selection.baseline()
    robust, baseline = selection.robust_baseline(bent)
    value = dict(zip(baseline.model.names, baseline.fit.theta.tolist(), strict=True))
    std = dict(zip(baseline.model.names, baseline.fit.covariance.diagonal().sqrt().tolist(), strict=True))
    for name, true in TRUE.items():
        # What is left of the mesh error, and what noise leaves.
        assert value[name] == pytest.approx(true, rel=2e-3, abs=4 * std[name])
    # Every fit sees both from here on; and then they are named.
    target = robust.builder.target
    assert bool(target.fitted[0, [0, 13]].all())
    ended, _ = robust.add_effects(baseline, 1)
    (one,) = ended.named
    assert one.hypothesis.name == "channel_swap"
    assert one.hypothesis.candidate.options == {"channels": ((None, MANY[0]), (None, MANY[13]))}
    assert one.choice.confidence > 0.95
    assert is_noise(ended.fit)
