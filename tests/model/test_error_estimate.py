"""The estimated error of a reduced model, member by member, beside the true one."""

import copy

import numpy as np
import pytest
import torch

from torchplate.model import Searched, SparseModel, basis_error, estimated_error, extrapolate
from torchplate.model.discretisation import error_estimate, fine_mesh
from torchplate.model.discretisation.error_estimate import Full, _importance
from torchplate.model.discretisation.reduced_basis import ritz_basis
from torchplate.plate import Mesh

BOX = {
    "plate.youngs_modulus": Searched(5.8e10, 8.3e10),
    "plate.poisson_ratio": Searched(0.28, 0.36),
    "wires.stiffness": Searched(300.0, 4000.0, True),
    "loss.stiffness_loss_factor": Searched(2e-3, 2e-2),
}
N_LINE = 80
MESHES = {"rectangle": Mesh(0.7, 0.4, 8, 6), "square": Mesh(0.48, 0.48, 7, 7)}


def made(plates, mesh: Mesh, kind: str = "accelerance", margin: float = 1.3, loss: float | None = None):
    known = {} if loss is None else {"field.base": loss}
    points = {"response": [3, (0.61, 0.37)], "reference": None if kind == "transmissibility" else [8, 12]}
    model = plates.build(mesh, known, BOX, loss_field=loss is not None, kind=kind, **points)
    frequency = torch.linspace(0.3, 7.0, N_LINE, dtype=torch.float64) * plates.first_bending(mesh)
    middle = model.space.to_si(torch.full((1, len(model.names)), 0.5, dtype=torch.float64))
    reduced = model.projected(ritz_basis(model, middle, frequency, 0, margin))
    generator = torch.Generator().manual_seed(3)
    theta = model.space.to_si(torch.rand(4, len(model.names), generator=generator, dtype=torch.float64))
    return model, reduced, theta, frequency


def true_error(model, reduced, theta, frequency) -> torch.Tensor:
    """Of each member's worst FRF, against a direct solve at every line."""
    full = model.frf_direct(theta, frequency)
    return ((reduced.frf(theta, frequency) - full).norm(dim=1) / full.norm(dim=1)).amax((-2, -1))


@pytest.mark.parametrize(
    ("name", "kind", "margin"),
    [("rectangle", "receptance", 1.1), ("rectangle", "accelerance", 2.0), ("square", "accelerance", 1.1)],
)
@pytest.mark.check
def test_the_estimate_is_of_the_size_of_the_error(plates, name: str, kind: str, margin: float) -> None:
    model, reduced, theta, frequency = made(plates, MESHES[name], kind, margin)
    ratio = estimated_error(model, reduced, theta, frequency) / true_error(model, reduced, theta, frequency)
    # The nominal plate's static flexibility stands for that of every member and line: E differs by 1.2 either way, and
    # modes just above the band are up to 1 / (1 − 1 / margin²) more flexible than their statics say.
    assert float(ratio.min()) > 0.3
    assert float(ratio.max()) < 3.0


def test_a_shaken_plate_has_an_estimate_too(plates) -> None:
    mesh = Mesh(0.7, 0.4, 8, 6, edges={"x0": "clamped"})
    model, reduced, theta, frequency = made(plates, mesh, "transmissibility", 1.1)
    ratio = estimated_error(model, reduced, theta, frequency) / true_error(model, reduced, theta, frequency)
    assert float(ratio.min()) > 0.3
    assert float(ratio.max()) < 3.0


def test_members_far_from_what_the_basis_was_built_for_stand_out(plates) -> None:
    model, reduced, theta, frequency = made(plates, MESHES["rectangle"], margin=2.0)
    estimate, true = estimated_error(model, reduced, theta, frequency), true_error(model, reduced, theta, frequency)
    assert int(estimate.argmax()) == int(true.argmax())


@pytest.mark.parametrize("dense", [1000, 10])
@pytest.mark.check
def test_the_measured_error_is_the_worst_of_the_members(plates, monkeypatch, dense: int) -> None:
    monkeypatch.setattr(fine_mesh, "DENSE", dense)
    monkeypatch.setattr(error_estimate, "N_LINE_CHECKED", N_LINE)
    model, reduced, theta, frequency = made(plates, MESHES["square"])
    found = basis_error(model, reduced, theta, frequency)
    # Modal sum and sparse solves agree with the direct solve to 1e-8.
    assert found == pytest.approx(float(true_error(model, reduced, theta, frequency).max()), rel=1e-4)


def test_the_estimate_knows_elements_with_a_loss_of_their_own(plates) -> None:
    model, reduced, theta, frequency = made(plates, MESHES["rectangle"], margin=2.0, loss=0.02)
    ratio = estimated_error(model, reduced, theta, frequency) / true_error(model, reduced, theta, frequency)
    # As where all elements lose alike.
    assert float(ratio.min()) > 0.3
    assert float(ratio.max()) < 3.0


def test_nearly_all_of_the_error_is_where_the_plate_moves_most(plates, monkeypatch) -> None:
    """Of some more lines than modes, and of none that stand for the rest, most of it is seen."""
    model, reduced, theta, frequency = made(plates, MESHES["rectangle"], margin=2.0)
    whole = estimated_error(model, reduced, theta, frequency)
    monkeypatch.setattr(error_estimate, "N_PEAK", 12)
    monkeypatch.setattr(error_estimate, "_spread", lambda _: torch.zeros(0, dtype=torch.int64))
    assert float((estimated_error(model, reduced, theta, frequency) / whole).min()) > 0.5


def test_which_lines_count_hangs_on_no_unit(plates) -> None:
    model, _, theta, frequency = made(plates, MESHES["rectangle"])
    frf = model.frf(theta, frequency)[0]
    # Receptances of a stiff plate in m/N are below 1e-6; here smaller ones, and some larger.
    for unit in (1e-12, 1e9):
        torch.testing.assert_close(_importance(unit * frf), _importance(frf), rtol=1e-9, atol=0)


def test_the_estimate_knows_what_elements_lose_on_a_mesh_whose_error_is_taken_off(plates) -> None:
    model, _, theta, frequency = made(plates, MESHES["rectangle"], loss=0.2)
    corrected = extrapolate(model, float(frequency[-1])).model
    middle = model.space.to_si(torch.full((1, len(model.names)), 0.5, dtype=torch.float64))
    reduced = corrected.projected(ritz_basis(corrected, middle, frequency, 0, 2.0))
    ratio = estimated_error(corrected, reduced, theta, frequency) / true_error(corrected, reduced, theta, frequency)
    # As without a correction.
    assert float(ratio.min()) > 0.3
    assert float(ratio.max()) < 3.0


def test_the_estimate_is_the_same_where_responses_and_references_change_places(plates, monkeypatch) -> None:
    made_of, columns = made(plates, MESHES["rectangle"]), []
    solve = SparseModel.solve
    monkeypatch.setattr(SparseModel, "solve", lambda own, right: columns.append(right[0].size) or solve(own, right))
    model, _, theta, frequency = made_of
    estimates = []
    for one, others in ((model.response[:1], [8, 12, (0.61, 0.37)]), ([8, 12, (0.61, 0.37)], model.response[:1])):
        twin = copy.copy(model)
        twin.response, twin.reference = list(one), list(others)
        middle = twin.space.to_si(torch.full((1, len(twin.names)), 0.5, dtype=torch.float64))
        # Residuals of all channels are in it: the basis is the same one.
        reduced = twin.projected(ritz_basis(twin, middle, frequency, 0, 1.3))
        columns.clear()
        estimates.append(estimated_error(twin, reduced, theta, frequency))
        # The real and the imaginary part of one channel, at the lines of highest motion and at those between.
        n_line = error_estimate.N_PEAK + error_estimate.N_LINE_CHECKED
        assert columns == [2 * n_line] * len(theta)
    # Reciprocity, of the estimate too; rounding of the bases' columns in another order.
    torch.testing.assert_close(*estimates, rtol=1e-5, atol=0)


@pytest.mark.parametrize("turned", [False, True])
def test_the_correction_is_what_the_static_flexibility_makes_of_both_residuals(plates, turned: bool) -> None:
    """δα = r_jᵀ K⁻¹ r_k, the residuals laid out; beside the flexibility of another plate no term of it vanishes."""
    model, reduced, theta, frequency = made(plates, MESHES["rectangle"], margin=1.1)
    own, nominal = SparseModel(model, theta[0]), SparseModel(model, theta[3])
    laplace = 2j * torch.pi * frequency[::20].to(torch.complex128)
    basis = reduced.assembly.basis.numpy()
    generator = torch.Generator().manual_seed(5)
    rows = [
        torch.randn(n, len(basis), generator=generator, dtype=torch.float64) for n in ((2, 3) if turned else (3, 2))
    ]
    found = error_estimate._corrected(own, nominal, reduced, laplace, *rows).numpy()

    parts, weight = own.impedance_parts(laplace)
    flexible = nominal.solve(np.eye(len(basis)))
    plain = np.empty_like(found)
    expected = np.empty_like(found)
    for line, factor in enumerate(weight.T):
        stiffness = sum(one * part.toarray() for one, part in zip(factor, parts, strict=True))
        motion = [basis @ np.linalg.solve(basis.T @ stiffness @ basis, basis.T @ row.numpy().T) for row in rows]
        left = [row.numpy().T - stiffness @ x for row, x in zip(rows, motion, strict=True)]
        plain[line] = rows[0].numpy() @ motion[1]
        expected[line] = plain[line] + left[0].T @ flexible @ left[1]
    # Rounding of solves with a stiffness of condition 1e8.
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected - plain).max()


def test_the_measured_error_is_of_natural_frequencies_too(plates) -> None:
    """Rigid-body modes, zero up to rounding, are held to the first that is not."""
    mesh = MESHES["rectangle"]
    model = plates.build(mesh, {"wires.stiffness": 0.0}, {"plate.youngs_modulus": BOX["plate.youngs_modulus"]})
    theta = torch.tensor([[7.1e10], [7.7e10]], dtype=torch.float64)
    natural = model.natural_frequencies(theta, 8)
    assert Full(theta, None, None, natural).error(model) < 1e-4
    natural[1, 5] *= 1.02
    assert Full(theta, None, None, natural).error(model) == pytest.approx(0.02 / 1.02, rel=1e-3)
