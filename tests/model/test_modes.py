"""Natural frequencies and mode shapes."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.linalg
import torch

from torchplate.model import Searched
from torchplate.model.receptance.modes import solve_eigenvalues, solve_modes
from torchplate.plate import Mesh

MESHES = {
    "rectangle": Mesh(0.7, 0.4, 5, 3),
    "square": Mesh(0.4, 0.4, 4, 4),
    "cantilever": Mesh(0.7, 0.4, 5, 3, edges={"x0": "clamped"}),
}
INTERVALS = {"plate.youngs_modulus": Searched(5e10, 9e10), "lump.mass": Searched(0.0, 0.4)}


def members(model, n_member: int, seed: int) -> torch.Tensor:
    shape = (n_member, len(model.names))
    return model.space.to_si(torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64))


@pytest.mark.parametrize("name", list(MESHES))
def test_modes_are_mass_normalised_and_stiffness_orthogonal(plates, name: str) -> None:
    model = plates.build(MESHES[name], {"wires.stiffness": 900.0}, INTERVALS)
    theta = members(model, 3, seed=1)
    modes, system = model.modes(theta), model.system(theta)
    assert modes.eigenvalue.shape == (3, model.assembly.size)
    identity = torch.eye(model.assembly.size, dtype=torch.float64).expand(3, -1, -1)
    # Rounding of the whitening, times the condition of the mass matrix (some 1e4 here).
    torch.testing.assert_close(modes.shape.mT @ system.mass @ modes.shape, identity, rtol=0, atol=1e-11)
    highest = modes.eigenvalue.max().item()
    torch.testing.assert_close(
        modes.shape.mT @ system.stiffness @ modes.shape,
        torch.diag_embed(modes.eigenvalue),
        rtol=0,
        atol=1e-11 * highest,
    )
    assert bool((modes.eigenvalue.diff() >= 0).all())


@pytest.mark.parametrize("name", list(MESHES))
def test_natural_frequencies_are_those_of_scipys_generalised_problem(plates, name: str) -> None:
    model = plates.build(MESHES[name], {"wires.stiffness": 900.0, "lump.mass": 0.2})
    system = model.system(plates.nothing)
    expected = scipy.linalg.eigh(system.stiffness.numpy(), system.mass.numpy(), eigvals_only=True)
    found = model.natural_frequencies(plates.nothing, n_mode=12)
    assert found.shape == (12,)
    # Rounding of the highest eigenvalue, some 1e6 to 1e9 times these.
    np.testing.assert_allclose((2 * np.pi * found.numpy()) ** 2, expected[:12], rtol=1e-10, atol=1e-15 * expected.max())


def test_a_square_plate_has_pairs_of_modes(plates) -> None:
    found = plates.build(MESHES["square"]).natural_frequencies(plates.nothing, n_mode=12)
    # Modes 7 and 8 are the first pair of the free square (Leissa: λ = 34.8 twice).
    assert found[6].item() == pytest.approx(found[7].item(), rel=1e-11)
    assert found[5].item() < 0.9 * found[6].item()
    rectangle = plates.build(MESHES["rectangle"]).natural_frequencies(plates.nothing, n_mode=12)
    assert (rectangle[4:].diff() / rectangle[4:-1]).min() > 1e-3


@pytest.mark.parametrize("name", list(MESHES))
def test_a_batch_of_models_vibrates_as_its_members_do(plates, name: str) -> None:
    model = plates.build(MESHES[name], {"wires.stiffness": 900.0}, INTERVALS)
    theta = members(model, 6, seed=2).reshape(2, 3, 2)
    together = model.natural_frequencies(theta, n_mode=9)
    assert together.shape == (2, 3, 9)
    for row in range(2):
        for column in range(3):
            alone = model.natural_frequencies(theta[row, column], n_mode=9)
            # The supported rigid modes lose most: rounding at the scale of the highest eigenvalue.
            torch.testing.assert_close(together[row, column], alone, rtol=1e-8, atol=0)


@pytest.mark.parametrize("name", list(MESHES))
def test_eigenvalues_alone_are_those_of_the_modes(plates, name: str) -> None:
    model = plates.build(MESHES[name], {"wires.stiffness": 900.0}, INTERVALS)
    theta = members(model, 2, seed=3)
    system, modes = model.system(theta), model.modes(theta)
    alone = solve_eigenvalues(system.stiffness, system.mass)
    # Two algorithms, each backward stable: rounding at the scale of the highest.
    torch.testing.assert_close(alone, modes.eigenvalue, rtol=0, atol=1e-14 * alone.max().item())
    torch.testing.assert_close(model.natural_frequencies(theta, n_mode=9), modes.frequency[..., :9], rtol=1e-7, atol=0)


def test_one_mass_matrix_serves_a_batch_of_stiffnesses(plates) -> None:
    model = plates.build(MESHES["rectangle"], {"lump.mass": 0.2})
    system = model.system(plates.nothing)
    factor = torch.tensor([0.5, 1.0, 3.0], dtype=torch.float64)
    modes = solve_modes(factor[:, None, None] * system.stiffness, system.mass)
    expected = factor[:, None] * solve_modes(system.stiffness, system.mass).eigenvalue
    # Rounding at the scale of the highest.
    torch.testing.assert_close(modes.eigenvalue, expected, rtol=0, atol=1e-14 * expected.max().item())
    gram = modes.shape.mT @ system.mass @ modes.shape
    torch.testing.assert_close(gram, torch.eye(len(system.mass)).to(gram).expand_as(gram), rtol=0, atol=1e-11)


def test_a_point_mass_shifts_no_mode_up_and_a_spring_none_down(plates) -> None:
    mesh = MESHES["rectangle"]
    bare = plates.build(mesh).natural_frequencies(plates.nothing)
    loaded = plates.build(mesh, {"lump.mass": 0.3}).natural_frequencies(plates.nothing)
    hung = plates.build(mesh, {"wires.stiffness": 5e4}).natural_frequencies(plates.nothing)
    # Rayleigh: one more rank-one term moves every mode in one direction; below it, rounding of the zeros.
    assert bool((loaded <= bare + 1e-3).all())
    assert bool((loaded[3:8] < 0.999 * bare[3:8]).any())
    assert bool((hung >= bare - 1e-3).all())
    assert hung[0] > 1.0


def test_more_modes_than_dofs_are_refused(plates) -> None:
    model = plates.build(MESHES["square"])
    with pytest.raises(ValueError, match=r"at most 75 modes, got 76\. Refine the mesh"):
        model.natural_frequencies(plates.nothing, n_mode=76)


def break_first_calls(monkeypatch: pytest.MonkeyPatch, n_broken: int) -> Callable[[], int]:
    """From now on, the second member of `torch.linalg.eigh` (or the only one) has a vector twice; `n_broken` times."""
    sound = torch.linalg.eigh
    calls = []

    def eigh(matrix: torch.Tensor, *args: object, **options: object) -> tuple[torch.Tensor, torch.Tensor]:
        value, vector = sound(matrix, *args, **options)
        calls.append(matrix.shape)
        if len(calls) <= n_broken:
            vector = vector.clone()
            broken = vector[1] if vector.ndim == 3 else vector
            broken[:, 4] = broken[:, 5]
        return value, vector

    monkeypatch.setattr(torch.linalg, "eigh", eigh)
    return lambda: len(calls)


def test_a_broken_batch_of_eigenvectors_is_solved_again(plates, monkeypatch: pytest.MonkeyPatch) -> None:
    model = plates.build(MESHES["rectangle"], {"wires.stiffness": 900.0}, INTERVALS)
    theta = members(model, 3, seed=4)
    expected = model.modes(theta)
    n_call = break_first_calls(monkeypatch, 1)
    found = model.modes(theta)
    # Once for the batch, once for the member that came back broken.
    assert n_call() == 2
    system = model.system(theta)
    gram = found.shape.mT @ system.mass @ found.shape
    torch.testing.assert_close(gram, torch.eye(gram.shape[-1]).to(gram).expand_as(gram), rtol=0, atol=1e-11)
    torch.testing.assert_close(
        found.eigenvalue, expected.eigenvalue, rtol=0, atol=1e-14 * expected.eigenvalue.max().item()
    )


def test_eigenvectors_that_stay_broken_are_an_error(plates, monkeypatch: pytest.MonkeyPatch) -> None:
    model = plates.build(MESHES["rectangle"], {"wires.stiffness": 900.0}, INTERVALS)
    theta = members(model, 3, seed=5)
    break_first_calls(monkeypatch, 10)
    with pytest.raises(ArithmeticError, match=r"Expected orthonormal eigenvectors.*Check the torch installation"):
        model.modes(theta)


def test_eigenvectors_that_are_off_by_rounding_alone_are_taken(plates, monkeypatch: pytest.MonkeyPatch) -> None:
    model = plates.build(MESHES["rectangle"], {"wires.stiffness": 900.0}, INTERVALS)
    theta = members(model, 3, seed=6)
    sound, calls = torch.linalg.eigh, []

    def eigh(matrix: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        calls.append(matrix.shape)
        value, vector = sound(matrix)
        # 1.42e-12 at 58 unknowns, as LAPACK's divide and conquer was seen to leave it: 110 n eps.
        return value, vector * (1 + 0.5 * 110 * matrix.shape[-1] * torch.finfo(matrix.dtype).eps)

    monkeypatch.setattr(torch.linalg, "eigh", eigh)
    model.modes(theta)
    assert len(calls) == 1


def test_eigenvectors_that_lapack_leaves_a_little_oblique_are_straightened(plates, monkeypatch) -> None:
    model = plates.build(MESHES["rectangle"], {"wires.stiffness": 900.0}, INTERVALS)
    theta = members(model, 3, seed=7)
    sound = torch.linalg.eigh

    def eigh(matrix: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        value, vector = sound(matrix)
        # 1.5e-10 between two rigid-body modes of a free plate of 40 × 20 elements in its reduced basis, each time.
        vector = vector.clone()
        vector[..., 1] += 1.5e-8 * vector[..., 2]
        return value, vector

    monkeypatch.setattr(torch.linalg, "eigh", eigh)
    found = model.modes(theta)
    gram = found.shape.mT @ model.system(theta).mass @ found.shape
    torch.testing.assert_close(gram, torch.eye(gram.shape[-1]).to(gram).expand_as(gram), rtol=0, atol=1e-11)
