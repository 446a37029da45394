"""One member in sparse matrices says what the dense model says."""

import pytest
import scipy.sparse
import scipy.sparse.linalg
import torch

from torchplate.effects import Absorber
from torchplate.model import SparseModel, extrapolate, ritz_basis
from torchplate.model.discretisation import fine_mesh
from torchplate.model.discretisation.direct_solves import solver as direct_solver
from torchplate.model.discretisation.fine_mesh import SHIFT
from torchplate.plate import Mesh

# 324 to about 630 dofs.
MESHES = {
    "rectangle": Mesh(0.51, 0.33, 8, 11, edges={}),
    "refined": Mesh(0.51, 0.33, 4, 3, 4, {"y1": "simply_supported"}),
    "square": Mesh(0.42, 0.42, 13, 13),
}
FREQUENCY = torch.tensor([3.0, 71.0, 160.0, 311.0], dtype=torch.float64)


@pytest.fixture(params=MESHES)
def model(plates, request):
    mesh = MESHES[request.param]
    known = plates.damping_of_every_kind(mesh, metal="brass") | {"wires.stiffness": 2500.0, "lump.mass": 0.11}
    points = {"response": [3, (0.4, 0.77)], "reference": [2, (0.91, 0.23)], "kind": "mobility"}
    return plates.build(mesh, known, metal="brass", **points)


def test_its_modes_are_the_dense_ones(model, plates):
    sparse, dense = SparseModel(model, plates.nothing).modes(12), model.modes(plates.nothing)
    n = len(sparse.eigenvalue)
    assert n >= 13
    # Rounding of the whole spectrum, which reaches 1e5 times as far as these modes.
    assert torch.allclose(sparse.eigenvalue, dense.eigenvalue[:n], rtol=1e-7, atol=0)
    gram = sparse.shape.mT @ SparseModel(model, plates.nothing).times_mass(sparse.shape)
    assert torch.allclose(gram, torch.eye(n, dtype=torch.float64), atol=1e-8)


def test_both_of_its_solvers_agree(model, plates):
    one = SparseModel(model, plates.nothing)
    sparse, dense = one.modes(12), one.modes(12, dense=True)
    assert len(dense.eigenvalue) == model.assembly.size
    assert torch.allclose(sparse.eigenvalue, dense.eigenvalue[: len(sparse.eigenvalue)], rtol=1e-7, atol=0)


def test_few_modes_of_a_small_mesh_are_not_solved_for_with_all_others(model, plates, monkeypatch):
    """A basis is made of some dozens; all modes of a thousand dofs take several times as long as these."""
    one = SparseModel(model, plates.nothing)
    # Off a mode, so that rounding does not decide whether it counts.
    few, many = (1.001 * float(one.modes(n).frequency[n - 1]) for n in (12, 100))
    assert not one.is_sooner_dense(1, few)
    assert one.is_sooner_dense(1, many)
    asked = []
    plain = SparseModel.modes
    monkeypatch.setattr(
        SparseModel,
        "modes",
        lambda self, n, top, dense=False, **more: asked.append(dense) or plain(self, n, top, dense, **more),
    )
    of_all, lines = {}, torch.tensor([few / 5, 0.37 * few], dtype=torch.float64)
    for whole in (fine_mesh.WHOLE, model.assembly.size):
        monkeypatch.setattr(fine_mesh, "WHOLE", whole)
        basis = ritz_basis(model, plates.nothing[None], torch.tensor([few / 2], dtype=torch.float64), 0, 2.0)
        of_all[whole] = model.projected(basis).frf(plates.nothing, lines)
    assert asked == [False, True]
    sparse, dense = of_all.values()
    # Eigenvalues of both agree to 1e-10, and the peaks of a loss of a per cent are a hundred times as sensitive.
    assert torch.allclose(sparse, dense, rtol=1e-7, atol=0)


def test_modes_reach_the_frequency_asked_for_and_one_beyond(model, plates):
    every = model.natural_frequencies(plates.nothing, 60)
    for hertz in (float(every[30]) * 1.001, float(every[47]) * 1.001):
        found = SparseModel(model, plates.nothing).modes(1, hertz).frequency
        assert float(found[-1]) > hertz
        assert torch.allclose(found, model.natural_frequencies(plates.nothing, len(found)), rtol=1e-7, atol=0)


@pytest.mark.parametrize("hung", [False, True])
def test_modes_are_found_from_those_of_a_similar_plate(model, plates, monkeypatch, hung):
    """A little softer, heavier at a place, and with a mass on a spring or without one."""
    effects = {"absorber": Absorber()} if hung else {}
    values = {"x": 0.3, "y": 0.6, "mass": 0.01, "stiffness": 4e3, "viscous_damping": 1.0}
    more = {f"absorber.{key}": value for key, value in values.items()} if hung else {}
    known = model.known_values | {"plate.youngs_modulus": 0.997 * model.known_values["plate.youngs_modulus"]} | more
    other = model.replaced(effects={**model.effects, **effects}, known=known | {"lump.mass": 0.113})
    top = 1.001 * float(model.natural_frequencies(plates.nothing, 24)[-1])
    near = ritz_basis(model, plates.nothing[None], torch.tensor([top / 3]).to(model.known), 0, 3.0)
    sparse = SparseModel(other, plates.nothing)
    expected = sparse.modes(1, top)
    monkeypatch.delattr(scipy.sparse.linalg, "eigsh")
    found = SparseModel(other, plates.nothing).modes(1, top, near=near)
    n = int((expected.frequency <= top).sum())
    assert n >= 24
    assert int((found.frequency <= top).sum()) == n
    assert float(found.frequency[-1]) > top
    # Half as exact as squares of shapes; those of a third of the frequency to more digits.
    assert torch.allclose(found.frequency[:n], expected.frequency[:n], rtol=1e-6, atol=1e-3)
    low = expected.frequency <= top / 3
    assert torch.allclose(found.frequency[: len(low)][low[: len(found.frequency)]], expected.frequency[low], rtol=1e-9)
    gram = found.shape.mT @ sparse.times_mass(found.shape)
    assert hung or torch.allclose(gram, torch.eye(len(gram), dtype=torch.float64), atol=1e-9)


def test_no_mode_is_missed_that_the_space_it_starts_from_has_nothing_of(plates):
    mesh = Mesh(0.42, 0.42, 13, 13)
    model = plates.build(mesh, plates.damping_of_every_kind(mesh))
    whole = SparseModel(model, plates.nothing)
    every = whole.modes(30)
    top = 1.001 * float(every.frequency[24])
    without = every.shape[:, [index for index in range(30) if index not in (7, 11, 20)]]
    found = whole.modes(1, top, near=without)
    assert torch.allclose(found.frequency[:25], every.frequency[:25], rtol=1e-6, atol=1e-3)


def test_a_space_far_from_the_modes_is_left_for_the_eigensolver(model, plates):
    sparse = SparseModel(model, plates.nothing)
    expected = sparse.modes(12)
    far = torch.rand(len(expected.shape), 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = sparse.modes(12, near=far)
    assert torch.equal(found.eigenvalue, expected.eigenvalue)


def test_a_plate_on_springs_has_its_modes_in_one_go(plates, monkeypatch):
    solved = []
    solver = scipy.sparse.linalg.eigsh
    monkeypatch.setattr(
        scipy.sparse.linalg, "eigsh", lambda *own, **more: solved.append(own[1]) or solver(*own, **more)
    )
    for sides in ((0.48, 0.48), (1.2, 0.3)):
        model = plates.build(Mesh(*sides, 12, 12, refine=2), plates.damping_of_every_kind(Mesh(*sides, 12, 12)))
        every = SparseModel(model, plates.nothing).modes(60).frequency
        solved.clear()
        found = SparseModel(model, plates.nothing).modes(1, float(every[40]))
        assert len(solved) == 1
        # Nor many more than asked for.
        assert 41 < len(found.frequency) < 60


@pytest.mark.parametrize("loss_field", [False, True])
def test_its_frfs_are_the_dense_ones(plates, relative_error, loss_field):
    mesh = MESHES["refined"]
    known = plates.damping_of_every_kind(mesh) | {"wires.stiffness": 2500.0, "lump.mass": 0.11}
    if loss_field:
        known["field.base"] = 0.02
    for kind in ("receptance", "accelerance", "transmissibility"):
        reference = None if kind == "transmissibility" else [2, (0.91, 0.23)]
        model = plates.build(
            mesh, known, response=[3, (0.4, 0.77)], reference=reference, kind=kind, loss_field=loss_field
        )
        found = SparseModel(model, plates.nothing).frf(FREQUENCY)
        # Both solve the same dynamic stiffness, in another order.
        assert relative_error(found, model.frf_direct(plates.nothing, FREQUENCY)) < 1e-8


@pytest.mark.parametrize("n_more", [0, 3])
def test_each_line_is_solved_for_the_side_of_fewer_channels(plates, relative_error, monkeypatch, n_more):
    mesh, columns = MESHES["rectangle"], []
    places = [2, (0.91, 0.23), 17, (0.4, 0.77), 33]
    points = {"response": places[: 1 + n_more], "reference": places[-4 + n_more :]}
    model = plates.build(mesh, plates.damping_of_every_kind(mesh), **points)
    solver = fine_mesh.solver

    def counted(matrix):
        solve = solver(matrix)
        return lambda right: columns.append(right.shape[1]) or solve(right)

    monkeypatch.setattr(fine_mesh, "solver", counted)
    found = SparseModel(model, plates.nothing).frf(FREQUENCY)
    assert columns == [1] * len(FREQUENCY)
    # Both solve the same dynamic stiffness, in another order.
    assert relative_error(found, model.frf_direct(plates.nothing, FREQUENCY)) < 1e-8


def test_residuals_are_orthogonal_to_the_modes_in_the_mass(model, plates):
    sparse = SparseModel(model, plates.nothing)
    shape = sparse.modes(12).shape
    forces = model.assembly.rows(model.mesh.deflection_at(model.mesh.places([4, (0.3, 0.61)])))
    residual = sparse.residual(shape, forces)
    assert residual.shape == (model.assembly.size, 2)
    weighted = sparse.times_mass(residual)
    cosine = (shape.mT @ weighted) / (residual * weighted).sum(0).sqrt()
    # Modes have unit mass; what is left is the rounding of the eigenvectors.
    assert float(cosine.abs().max()) < 1e-8


def test_residuals_are_what_the_modes_leave_of_a_static_force(model, plates):
    sparse, system = SparseModel(model, plates.nothing), model.system(plates.nothing)
    modes = model.modes(plates.nothing)
    forces = model.assembly.rows(model.mesh.deflection_at(model.mesh.places([4, (0.3, 0.61)])))
    moved = torch.linalg.solve(system.stiffness + SHIFT * system.mass, forces.mT)
    low = modes.shape[:, :9]
    kept = low @ ((low.mT @ forces.mT) / (modes.eigenvalue[:9, None] + SHIFT))
    residual = sparse.residual(low, forces)
    # K + shift M has a condition of 1e8 or so.
    assert float((residual - (moved - kept)).norm() / residual.norm()) < 1e-6


def test_its_frfs_are_the_dense_ones_where_the_mesh_error_is_taken_off(model, plates):
    corrected = extrapolate(model, 300.0).model
    found, dense = (
        SparseModel(corrected, plates.nothing).frf(FREQUENCY),
        corrected.frf_direct(plates.nothing, FREQUENCY),
    )
    # Springs, dashpots and masses pull where the corrected deflection is: without that they are 1e-3 apart. Rounding of
    # two direct solves.
    assert torch.allclose(found, dense, rtol=1e-7, atol=1e-9 * float(dense.abs().max()))


@pytest.mark.parametrize("name", ["rectangle", "square"])
def test_the_mesh_error_is_taken_off_what_elements_lose_too(plates, relative_error, name):
    mesh = MESHES[name]
    known = plates.damping_of_every_kind(mesh) | {"wires.stiffness": 2500.0, "lump.mass": 0.11, "field.base": 0.2}
    points = {"response": [3, (0.4, 0.77)], "reference": [2, (0.91, 0.23)]}
    corrected = extrapolate(plates.build(mesh, known, loss_field=True, **points), 300.0).model
    sparse, columns = SparseModel(corrected, plates.nothing), torch.eye(corrected.assembly.size, dtype=torch.float64)
    lacking = torch.from_numpy(sparse.lacking(columns.numpy())[-1] + sparse.hysteretic.toarray())
    dense = corrected.system(plates.nothing).hysteretic
    assert torch.allclose(lacking, dense, rtol=1e-9, atol=1e-9 * float(dense.abs().max()))
    # Rounding of two direct solves.
    assert relative_error(sparse.frf(FREQUENCY), corrected.frf_direct(plates.nothing, FREQUENCY)) < 1e-8


def test_what_its_matrices_lack_is_what_the_dense_ones_have_more(model, plates):
    corrected = extrapolate(model, 300.0).model
    sparse = SparseModel(corrected, plates.nothing)
    system = corrected.system(plates.nothing)
    columns = torch.randn(corrected.assembly.size, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    viscous = system.dashpot.mT @ (system.viscous[:, None] * system.dashpot)
    dense = (system.stiffness, system.mass, viscous)
    lacking = sparse.lacking(columns.numpy())
    for whole, part, more in zip(dense, (sparse.stiffness, sparse.mass, sparse.viscous), lacking, strict=True):
        found = part @ columns.numpy() + more
        assert torch.allclose(torch.from_numpy(found), whole @ columns, rtol=1e-9, atol=1e-9 * float(whole.abs().max()))


def test_a_solve_that_needs_pivots_finds_them():
    # The first pivot is zero: without an exchange there is no factor at all, or one of rounding.
    for corner in (0.0, 1e-17):
        matrix = scipy.sparse.csc_array([[corner, 1.0, 0.0], [1.0, 1.0, 2.0], [0.0, 2.0, 0.5]], dtype=complex)
        right = torch.tensor([[1.0], [2.0], [3.0]], dtype=torch.complex128).numpy()
        found = torch.from_numpy(direct_solver(matrix)(right))
        exact = torch.linalg.solve(torch.from_numpy(matrix.toarray()), torch.from_numpy(right))
        assert torch.allclose(found, exact, rtol=1e-12, atol=1e-12)
