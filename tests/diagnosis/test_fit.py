"""A fit finds the parameters from afar, and says how well the noise lets them be known."""

from dataclasses import replace

import pytest
import torch

from torchplate.diagnosis import model_builder
from torchplate.diagnosis import problem as problem_module
from torchplate.diagnosis.fit import fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Problem
from torchplate.diagnosis.settings import Fineness
from torchplate.diagnosis.target import FrfTarget
from torchplate.effects import CATALOGUE
from torchplate.measurement.assessment.noise import Noise
from torchplate.model import PlateModel, Searched
from torchplate.model.discretisation.extrapolation import extrapolate
from torchplate.plate import Mesh

RESPONSE, REFERENCE = (3, 17), (7, 9, 14)
LINES = torch.linspace(10.0, 340.0, 150, dtype=torch.float64)
TRUTH = {
    "plate.youngs_modulus": 2.05e11,
    "wires.stiffness": 1500.0,
    "loss.stiffness_loss_factor": 8e-3,
}
KNOWN = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003, "wires.viscous_damping": 0.7}
BOX = {
    "plate.youngs_modulus": Searched(1.2e11, 2.6e11),
    "wires.stiffness": Searched(300.0, 6000.0, True),
    "loss.stiffness_loss_factor": Searched(1e-3, 5e-2, True),
}
SHARE = 0.02
N_DRAW = 12


@pytest.fixture(scope="module")
def plate() -> PlateModel:
    effects = {
        "plate": CATALOGUE["plate"](),
        "wires": CATALOGUE["support_spring"](nodes=[2, 10, 19]),
        "loss": CATALOGUE["hysteretic_damping"](),
    }
    return PlateModel(Mesh(0.43, 0.3, 4, 3), effects, KNOWN, BOX, list(RESPONSE), list(REFERENCE), "accelerance")


@pytest.fixture(scope="module")
def truth(plate):
    return torch.tensor([TRUTH[name] for name in plate.names], dtype=torch.float64)


def measured(lab, frf, seed) -> FrfTarget:
    std = lab.true_std(frf, SHARE, "signal")
    heldout = torch.zeros(2, 3, dtype=torch.bool)
    heldout[1, 1] = True
    noise = Noise(std, lab.true_floor(std, frf), (), torch.zeros_like(std))
    return FrfTarget(lab.measured(LINES, frf + lab.noise_of(std, seed), RESPONSE, REFERENCE), noise, heldout)


@pytest.fixture(scope="module")
def builder(lab, plate, truth) -> ModelBuilder:
    """The mesh of the data is that of the model: what is left is noise alone."""
    with torch.no_grad():
        return ModelBuilder(plate, measured(lab, plate.frf(truth, LINES), 0), as_given=True)


# Moduli from far below and far above, whose peaks overlap with none of the true ones.
FAR = ([[0.03, 0.5, 0.5]], [[0.97, 0.05, 0.1]], [[0.05, 0.95, 0.95], [0.9, 0.8, 0.2]])


@pytest.fixture(scope="module")
def found(builder):
    """From far away, also where the first of two starts leads nowhere."""
    return [fit(builder, builder.given, torch.tensor(starts, dtype=torch.float64)) for starts in FAR]


def test_an_frf_that_is_held_out_is_in_nothing_by_which_fits_are_compared(found, builder):
    target = builder.target
    other = replace(target.measurement, frf=target.measurement.frf * torch.where(target.heldout, 3.0, 1.0))
    blind = ModelBuilder(builder.given, replace(target, measurement=other), as_given=True)
    one, again = found[0], fit(blind, blind.given, torch.tensor(FAR[0], dtype=torch.float64))
    assert (again.gap, again.left, again.square) == (one.gap, one.left, one.square)


def test_the_truth_is_found_from_far_starts(found, plate, truth):
    for one in found:
        std = one.covariance.diagonal().sqrt()
        # Three parameters: 4 standard errors are passed once in five thousand times.
        assert bool(((one.theta - truth).abs() < 4 * std).all())
        assert bool((std < 0.03 * truth).all())
        assert one.reduced_misfit == pytest.approx(1.0, abs=0.12)
        assert one.model.names == plate.names
    # They end at the same place.
    assert all(torch.allclose(one.theta, found[0].theta, rtol=1e-3) for one in found)


def test_the_basis_at_the_end_says_what_the_full_model_says(found, plate, relative_error_of):
    for one in found:
        assert one.reduced.assembly.size < plate.assembly.size
        assert relative_error_of(one.prediction, plate.frf(one.theta, LINES)) < 1e-3


# Forward mode loads its rules by torch.jit.script, which warns of itself.
@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
@torch.enable_grad()
def test_what_data_say_of_each_parameter_is_that_of_exact_derivatives(found, builder):
    """Against forward mode: where a peak is a hundredth of an interval wide, steps of 6e-6 are off by (6e-4)² of it.

    One-sided ones are off by ten times as much.
    """
    one = found[0]
    model, marginal = one.reduced, one.marginal
    position = model.space.to_cube(one.theta)
    slopes = torch.func.jacfwd(lambda where: torch.view_as_real(model.frf(model.space.to_si(where), LINES)))(position)
    rows = marginal.over_noise(torch.view_as_complex(slopes.movedim(-1, 0).contiguous()))
    exact = marginal.precision(rows, one.judged)
    assert float((one.information - exact).abs().max()) < 3.6e-7 * float(exact.abs().max())


@pytest.fixture
def relative_error_of():
    return lambda one, other: float(((one - other).norm(dim=0) / other.norm(dim=0)).max())


@pytest.mark.check
def test_noise_scatters_the_parameters_as_the_covariance_says(lab, plate, truth, found):
    with torch.no_grad():
        frf = plate.frf(truth, LINES)
        start = plate.space.to_cube(truth)[None]
        builder = ModelBuilder(plate, measured(lab, frf, 1), as_given=True)
        ends = []
        for seed in range(N_DRAW):
            beside = builder.against(measured(lab, frf, 100 + seed))
            ends.append(fit(beside, builder.given, start, wide=False).theta)
    scatter = torch.stack(ends)
    std = found[0].covariance.diagonal().sqrt()
    # The standard deviation of 12 draws is good to 21 %.
    assert (scatter.std(0) / std).tolist() == pytest.approx([1.0] * 3, abs=0.6)
    # And they scatter about the truth.
    assert bool(((scatter.mean(0) - truth).abs() < 4 * std / N_DRAW**0.5).all())
    told = torch.corrcoef(scatter.mT)
    claimed = found[0].covariance / std[:, None] / std
    assert torch.allclose(told, claimed, atol=0.8)


def test_what_is_known_beforehand_pulls_as_it_weighs(builder, plate, truth, found):
    name = "plate.youngs_modulus"
    index = plate.names.index(name)
    free = found[0]
    own = float(free.covariance[index, index].sqrt())
    ends = {}
    for weight in (0.02, 1.0, 50.0):
        # The other way by six standard errors, known `weight` times as well.
        mean, std = float(free.theta[index]) + 6 * own, own / weight
        pulled = fit(builder, builder.given, plate.space.to_cube(free.theta)[None], {name: (mean, std)}, wide=False)
        ends[weight] = (float(pulled.theta[index]) - float(free.theta[index])) / own
        assert pulled.prior == pytest.approx(((float(pulled.theta[index]) - mean) / std) ** 2, rel=1e-6, abs=1e-6)
        assert pulled.cost == pytest.approx(pulled.judged.cost + pulled.prior)
    # Two normal distributions multiplied: 6 w² / (1 + w²).
    assert ends[0.02] == pytest.approx(0.0, abs=0.1)
    assert ends[1.0] == pytest.approx(3.0, abs=0.3)
    assert ends[50.0] == pytest.approx(6.0, abs=0.2)


def test_without_parameters_there_is_nothing_to_fit(lab, plate, truth):
    model = PlateModel(plate.mesh, plate.effects, KNOWN | TRUTH, {}, plate.response, plate.reference, plate.kind)
    with torch.no_grad():
        builder = ModelBuilder(model, measured(lab, plate.frf(truth, LINES), 3), as_given=True)
        seen = fit(builder, builder.given, torch.zeros(1, 0, dtype=torch.float64))
    assert seen.theta.shape == (0,)
    assert seen.covariance.shape == (0, 0)
    assert seen.reduced_misfit == pytest.approx(1.0, abs=0.12)


@pytest.mark.check
def test_a_hopeless_fit_ends_with_its_first_basis(builder, plate, monkeypatch):
    bases = []
    reduced = builder.reduced
    monkeypatch.setattr(builder, "reduced", lambda *given, **named: bases.append(1) or reduced(*given, **named))
    start = torch.tensor([[0.3, 0.5, 0.5]], dtype=torch.float64)
    whole = fit(builder, builder.given, start, wide=False)
    n_whole = len(bases)
    assert n_whole > 1
    bases.clear()
    given_up = fit(builder, builder.given, start, wide=False, hopeless=0.0)
    assert len(bases) == 1
    assert given_up.square >= 0.99 * whole.square
    # One that may still be of use goes to its end.
    bases.clear()
    assert torch.equal(fit(builder, builder.given, start, wide=False, hopeless=1e12).theta, whole.theta)
    assert len(bases) == n_whole


@torch.no_grad()
def test_of_several_starts_the_best_goes_to_the_end_alone(builder, plate, truth, monkeypatch):
    marginal = builder.target.marginal(builder.given, truth)
    problem, near = Problem(builder, builder.given, {}, marginal), plate.space.to_cube(truth)
    starts = torch.stack([torch.tensor([0.05, 0.9, 0.9], dtype=torch.float64), near + 0.03, near - 0.15])
    asked = []
    descend = Problem.descend

    def told(self, start, level, n_iteration, *others):
        asked.append((len(start), n_iteration))
        return descend(self, start, level, n_iteration, *others)

    monkeypatch.setattr(Problem, "descend", told)
    before = builder.n_evaluation
    (place,), (value,), n_evaluation = problem.descend_sharply(starts, builder.target.settings.fitting.damping)
    assert asked[0] == (3, builder.target.settings.fitting.n_together)
    assert [count for count, _ in asked] == [3, 1]
    # What it cost is told of the one that goes to the end: for each Jacobian, one for each of three parameters and one.
    assert 4 <= n_evaluation < builder.n_evaluation - before - 3
    (alone,), (least,), _ = problem.descend(starts[1:2], builder.target.levels - 1, 12)
    assert float(value) == pytest.approx(float(least), rel=1e-3)
    assert torch.allclose(place, alone, atol=2e-3)
    # A residual and three differences for each step that is left, and for the start; no Jacobian at the end.
    assert 4 < n_evaluation <= 4 * (1 + asked[1][1]) - 3


@torch.no_grad()
def test_the_mesh_error_is_found_once_for_all_fits(lab, plate, truth, monkeypatch):
    true = plate.frf(truth, LINES)
    builder = ModelBuilder(plate, measured(lab, true, 0))
    asked = []
    monkeypatch.setattr(model_builder, "extrapolate", lambda *given: asked.append(1) or extrapolate(*given))
    start = torch.tensor([[0.55, 0.5, 0.5]], dtype=torch.float64)
    given_up = fit(builder, builder.given, start, wide=False, hopeless=0.0)
    own = fit(builder.against(measured(lab, true, 1)), builder.given, start, wide=False)
    assert len(asked) == 1
    assert own.model.assembly.correction is given_up.model.assembly.correction
    assert own.model.assembly.correction is not None


@torch.no_grad()
@pytest.mark.check
def test_a_patch_ends_beside_the_mesh_error_of_where_it_is(lab, plate, truth):
    """Two fits of one patch from two sides, each on a mesh whose error is taken off."""
    patch = {"patch.y": 0.4, "patch.size": 0.35, "patch.aspect": 1.0}
    searched = BOX | {"patch.x": Searched(0.1, 0.9), "patch.factor": Searched(0.1, 1.5, True)}
    effects = {**plate.effects, "patch": CATALOGUE["stiffness_loss"]()}
    given = plate.replaced(effects=effects, known=KNOWN | patch, searched=searched)
    fine = ModelBuilder(given, measured(lab, plate.frf(truth, LINES), 0), fineness=Fineness(1200, 0.0, 0.0, 0.0, 0.0))
    values = TRUTH | {"patch.x": 0.6, "patch.factor": 0.3}
    true = torch.tensor([values[name] for name in given.names], dtype=torch.float64)
    frf = fine.corrected(fine.given, true).model.frf(true, LINES)
    builder = ModelBuilder(given, measured(lab, frf, 0))
    off = true[None].repeat(2, 1)
    off[:, given.names.index("patch.x")] = torch.tensor([0.45, 0.7])
    off[:, given.names.index("patch.factor")] = torch.tensor([0.6, 0.5])
    ends = [fit(builder, builder.given, start[None], wide=False) for start in given.space.to_cube(off)]
    for one in ends:
        assert builder.is_right_at(one.model, one.theta)
        assert float(one.theta[given.names.index("patch.x")]) == pytest.approx(0.6, abs=5e-3)
    one, other = ends
    assert one.cost == pytest.approx(other.cost, abs=builder.target.settings.fitting.little)


@torch.no_grad()
def test_plates_that_share_their_modes_are_evaluated_without_an_eigenproblem(builder, truth, monkeypatch):
    reduced = builder.reduced(builder.given, truth[None])
    members = builder.given.space.to_si(torch.rand(5, 3, generator=torch.Generator().manual_seed(2)).double())
    problem, sharp = Problem(builder, reduced, {}), builder.target.levels - 1
    expected = [builder.predict(reduced, members, level) for level in (0, sharp)]
    problem.predict(members, 0)
    monkeypatch.setattr(torch.linalg, "eigh", lambda *_: pytest.fail("an eigenproblem was solved"))
    for level, values in zip((0, sharp), expected, strict=True):
        found = problem.predict(members, level)
        # Digits that the wires take from what is attached by a difference.
        assert float(((found - values).norm(dim=1) / values.norm(dim=1)).max()) < 1e-8


@pytest.mark.check
def test_a_basis_that_holds_the_end_too_is_not_built_anew(lab, plate, truth, monkeypatch):
    """Modes of the bare plate are the same at every modulus, and what wires do to them is in the basis."""
    builder = ModelBuilder(plate, measured(lab, plate.frf(truth, LINES), 0).with_mesh_error(LINES * 0, 0.0, 9))
    built = []
    inner = model_builder.ritz_basis
    monkeypatch.setattr(model_builder, "ritz_basis", lambda *given, **named: built.append(1) or inner(*given, **named))
    start = torch.tensor([[0.56, 0.5, 0.4]], dtype=torch.float64)
    found = fit(builder, builder.given, start, wide=False)
    assert len(built) == 1
    # As the model in all dofs has it, to a tenth of what a basis is taken to leave.
    whole, small = (model.frf(found.theta, LINES) for model in (found.model, found.reduced))
    assert float((whole - small).norm() / whole.norm()) < 5e-5
    # A modulus far from there has fewer of its modes in it.
    fit(builder, builder.given, torch.tensor([[0.1, 0.5, 0.4]], dtype=torch.float64), wide=False)
    assert len(built) > 1


@torch.no_grad()
def test_residuals_of_members_by_parts_are_those_of_all(builder, plate, monkeypatch):
    model = builder.reduced(builder.given, builder.given.space.to_si(torch.full((1, 3), 0.5, dtype=torch.float64)))
    marginal = builder.target.marginal(model, model.space.to_si(torch.full((3,), 0.5, dtype=torch.float64)))
    problem, sharp = Problem(builder, model, {}, marginal), builder.target.levels - 1
    members = torch.rand(2, 3, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    for level in (0, sharp):
        whole = problem.residual(members, level)
        with monkeypatch.context() as patched:
            # Less than the FRFs of one.
            patched.setattr(problem_module, "AT_ONCE", 1)
            parts = problem.residual(members, level)
            squares = problem.squares(members.flatten(0, 1), level)
        torch.testing.assert_close(parts, whole, rtol=1e-9, atol=1e-9 * float(whole.abs().max()))
        torch.testing.assert_close(squares, whole.square().sum(-1).flatten(), rtol=1e-9, atol=0)
