"""What is said at the end follows from what was found."""

import dataclasses
from dataclasses import replace

import pytest
import torch

from torchplate.diagnosis.before_and_after import verdict_of
from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.fit import fit
from torchplate.diagnosis.judged import Fit, judged_at
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.naming import _chance, as_named
from torchplate.diagnosis.remarks import (
    all_remarks,
    faults_of,
    missing_still,
    nothing_but_chance,
    of_the_uniform_plate,
)
from torchplate.diagnosis.selection.criterion import Choice, Hypothesis, is_explained
from torchplate.diagnosis.selection.screen import Scored
from torchplate.diagnosis.selection.trace import Naming, Ranked, State, Trace
from torchplate.diagnosis.summary import _finer_mesh, _on_symmetry, _table
from torchplate.diagnosis.target import FrfTarget
from torchplate.effects import CATALOGUE
from torchplate.measurement.assessment.noise import noise_level
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

LINES = torch.linspace(20.0, 330.0, 90, dtype=torch.float64)


def plate(response=(3, 17), reference=(7, 9)) -> PlateModel:
    known = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003}
    effects = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"]()}
    searched = {"plate.youngs_modulus": Searched(1.5e11, 2.5e11)}
    known["loss.stiffness_loss_factor"] = 0.01
    channels = list(response), list(reference)
    return PlateModel(Mesh(0.43, 0.3, 4, 4), effects, known, searched, *channels, "accelerance")


class Ended:
    """A fit that is off by a part of what was measured, with a noise of a hundredth."""

    def __init__(self, lab, off: float = 0.0, young: float = 2.05e11, n_named: int = 0):
        model, theta = plate(), torch.tensor([young], dtype=torch.float64)
        frf = model.frf(theta, LINES)
        std = lab.true_std(frf, 0.01, "signal")
        measured = lab.measured(LINES, frf * (1 + off) + lab.noise_of(std, 4), (3, 17), (7, 9))
        self.noise = noise_level(measured)
        target = FrfTarget(measured, self.noise, torch.zeros(2, 2, dtype=torch.bool))
        self.builder = ModelBuilder(model, target, as_given=True)
        position = model.space.to_cube(theta)
        anywhere = fit(self.builder, self.builder.given, position[None], wide=False, hopeless=0.0)
        fitted = judged_at(self.builder, anywhere._replace(theta=theta), {}, position)
        one = Hypothesis(Candidate(CATALOGUE["density"](), {}, {}, {}), "one", fitted)
        self.state = State(model, fitted, (Naming(one, Choice(one, (), None, 1.0), fitted),) * n_named)


@pytest.mark.parametrize(
    ("off", "n_named", "expected"),
    [(0.0, 0, "consistent"), (0.0, 1, "explained"), (0.2, 0, "unexplained"), (0.2, 2, "partly_explained")],
)
def test_the_verdict_follows_from_what_is_left(lab, off, n_named, expected):
    ended = Ended(lab, off, n_named=n_named)
    assert verdict_of(bool(n_named), is_explained(ended.state.fit, ended.builder.target)) == expected
    said = missing_still(ended.builder, ended.noise, ended.state, expected)
    if off:
        # 0.2 of what the model says is 0.2 / 1.2 of what was measured.
        gap = float(said[0].removeprefix("A gap of ").split(" %")[0])
        assert gap == pytest.approx(16.7, abs=0.3)
        assert "noise alone makes" in said[0]
        # How large noise would have to be, to explain it alone.
        assert "would take noise" in said[1]
        assert len(said) > 2
    else:
        assert said == ()


@pytest.mark.check
@pytest.mark.parametrize("what", ["distorted", "loud"])
def test_frfs_that_hold_nothing_of_the_plate_are_said_where_the_rest_is_noise(lab, what):
    ended, which = Ended(lab), torch.tensor([[False, False], [True, True]])
    assert faults_of(ended.builder, ended.noise) == ()
    noise = dataclasses.replace(ended.noise, **{what: which})
    (said,) = missing_still(ended.builder, noise, ended.state, "unexplained")
    assert said.startswith("FRFs 17w/7w, 17w/9w scatter over the lines")
    assert (said,) == faults_of(ended.builder, noise)


@pytest.mark.check
def test_a_parameter_on_the_edge_of_its_interval_is_said(lab):
    for young, said in ((2.4999e11, True), (1.50001e11, True), (2.05e11, False)):
        ended = Ended(lab, young=young)
        sentences = all_remarks(ended.noise, ended.state, {})
        assert sentences[: len(ended.noise.sentences)] == tuple(ended.noise.sentences)
        assert any("plate.youngs_modulus sits on the edge" in one for one in sentences) == said


def test_a_gap_of_a_uniform_plate_is_said_beside_that_of_the_plate_as_it_was_found(lab, monkeypatch):
    ended = Ended(lab, n_named=1)
    (naming,), measured = ended.state.named, ended.builder.target.measured

    def gone(before, after):
        """From fits that leave so much beside the plate as it was found, to fits that do."""
        fits = [ended.state.fit._replace(expected=measured * (1 - one)) for one in (before, after)]
        return replace(naming, before=fits[0]), replace(ended.state, fit=fits[1])

    def said(gaps):
        begun, last = gone(0.172, 0.0093)
        # Another one before it, as two of a kind are alike.
        return as_named(ended.builder, begun, replace(last, named=(replace(begun), begun)), gaps).evidence

    # The plate is uniform: there is one gap.
    assert of_the_uniform_plate(ended.builder, ended.state) == ()
    assert "takes the gap from 43.4 % to 56.7 % (" in said((0.434, 0.567))
    monkeypatch.setattr(Fit, "about", property(lambda _: "somewhere"))
    grown, shrunk = said((0.434, 0.567)), said((0.434, 0.0201))
    assert "takes the gap beside the plate as it was found to wander from 17.2 % to 0.93 %; that of a uniform" in grown
    assert "takes the gap from 43.4 % to 2.01 %" in shrunk
    assert ", and from 17.2 % to 0.93 % beside the plate as it was found to wander" in shrunk
    (remark,) = of_the_uniform_plate(ended.builder, gone(0.172, 0.0093)[1])
    assert "It is 0.93 % beside the plate" in remark


def test_sensors_on_a_line_of_symmetry_are_seen():
    # Nodes 11 to 15 lie on y = 1/2; 3, 8, 13, 18 and 23 on x = 1/2.
    assert not _on_symmetry(plate())
    assert _on_symmetry(plate((3, 18), (13, 23)))
    assert _on_symmetry(plate((11, 14), (12,)))
    # A force off the line tells a place from its mirror image.
    assert not _on_symmetry(plate((3, 18), (7, 22)))
    assert not _on_symmetry(plate((3, 18), (11, 14)))


def test_a_finer_mesh_is_named_by_the_model_that_lacks_nothing_else(lab):
    before, after = Ended(lab, 0.2), Ended(lab, 0.0, n_named=1)
    (naming,) = after.state.named
    final, ranked = after.state.fit, (Ranked((), (naming.hypothesis,)),)
    worse = final._replace(judged=before.state.fit.judged)
    # The baselines differ as little as may be: only the last models say whether the mesh shows.
    for unrefined, n_named in ((worse, 1), (final, 0)):
        seen = Trace(after.builder, after.noise, final, after.state, after.state, ranked, {}, unrefined)
        named = _finer_mesh(seen)
        assert len(named) == n_named
        assert all("the last model's misfit is" in one.evidence for one in named)


def test_what_stayed_far_above_the_best_is_not_said_to_promise_too_little(lab):
    ended = Ended(lab)
    effects = [CATALOGUE[name]() for name in ("density", "thickness")]
    promises = [
        Scored(Candidate(one, {}, {}, {}), "one", ended.state.model, 0.5, {}, torch.zeros(1, 1),
                torch.eye(2, dtype=torch.float64)[k], torch.zeros(0, dtype=torch.float64))
        for k, one in enumerate(effects)
    ]  # fmt: skip
    rows = _table(Ranked(tuple(promises), (), 0.0, frozenset({"density"})), (), ended.builder)
    assert [one.remark for one in rows] == [
        "rejected: fitted to smoothed FRFs, it stays far above the best",
        "rejected: promises too little",
    ]


@pytest.mark.check
def test_what_chance_would_take_is_said_beside_what_a_name_takes(lab):
    before, after = Ended(lab, 0.2), Ended(lab, 0.0, n_named=1)
    (naming,) = after.state.named
    naming = replace(naming, before=before.state.fit, by_chance=123.4)
    fall = before.state.fit.cost - naming.hypothesis.fit.cost
    assert _chance(naming) == (
        f"; it takes {fall:.3g} from −2 ln L, and chance lets it take 123: of a hundred tests in which nothing is "
        "missing, one has an effect that takes more"
    )
    # Where far more is left than chance makes, it was not asked.
    assert _chance(replace(naming, by_chance=0.0)) == ""
    best = naming.hypothesis
    for by_chance, n_sentences in ((123.4, 1), (0.0, 0)):
        ranked = Ranked((), (best,), by_chance)
        seen = Trace(after.builder, after.noise, best.fit, before.state, before.state, (ranked,), {})
        said = nothing_but_chance(seen)
        assert len(said) == n_sentences
        assert all("density, would take" in one and "chance lets it take 123:" in one for one in said)
    named = Trace(after.builder, after.noise, best.fit, before.state, after.state, (ranked,), {})
    assert nothing_but_chance(named) == ()
    # Where it was scored on a finer mesh, nothing was refitted.
    nothing = torch.zeros(0, dtype=torch.float64)
    promise = Scored(best.candidate, best.label, before.state.model, 0.02, {}, nothing[None], nothing, nothing)
    told = ["density, promises to take 20 from", "take 123:"]
    for promises, square, expected in (((promise,), 1000.0, told), ((), 1000.0, []), ((promise,), 0.0, [])):
        ranked = Ranked(promises, (), 123.4, square=square)
        said = nothing_but_chance(replace(seen, rankings=(ranked,)))
        assert len(said) == bool(expected)
        assert all(word in said[0] for word in expected)
