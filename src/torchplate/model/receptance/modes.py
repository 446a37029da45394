"""Natural frequencies and mode shapes of a whole population in one `torch.linalg.eigh` call."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

# Motions without strain that a plate has: one translation and two rotations.
N_RIGID = 3
# An eigenvalue below this many units of rounding of the highest is one of them. Rounding leaves up to 1.2 of them on
# free plates of 1 × 1 to 18 × 18 elements and strips of 40:1, and no digit of a support that gives as little.
RIGID = 8.0


class Modes(NamedTuple):
    """Undamped modes, lowest first, with φᵀ M φ = 1.

    A rigid-body mode's eigenvalue is exactly zero.
    """

    eigenvalue: Float[Tensor, "*batch n_mode"]  # ω² [rad²/s²]
    shape: Float[Tensor, "*batch n n_mode"]  # [1/√kg] for deflections

    @property
    def frequency(self) -> Float[Tensor, "*batch n_mode"]:
        """Natural frequencies [Hz]."""
        return natural_frequencies(self.eigenvalue)


def natural_frequencies(eigenvalue: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """√ω² / 2π [Hz], zero where rounding leaves a rigid-body mode below zero, and its derivative is then zero too."""
    positive = eigenvalue > 0
    # The root's slope at zero is infinite, and even a discarded infinity turns into NaN in the backward.
    return torch.where(positive, torch.where(positive, eigenvalue, 1.0).sqrt(), 0.0) / (2 * torch.pi)


def whiten(
    stiffness: Float[Tensor, "*#batch n n"], mass: Float[Tensor, "*#batch n n"]
) -> tuple[Float[Tensor, "*batch n n"], Float[Tensor, "*#batch n n"]]:
    """The standard problem L⁻¹ K L⁻ᵀ of the pencil (K, M), M = L Lᵀ, and L⁻¹.

    Raises:
        torch.linalg.LinAlgError: if a mass matrix is not positive definite.
    """
    lower = torch.linalg.cholesky(mass)
    # The mass is often the same for all members: then one inverse serves the population.
    inverse = torch.linalg.solve_triangular(lower, _one(lower), upper=False)
    white = inverse @ stiffness @ inverse.mT
    return 0.5 * (white + white.mT), inverse


def solve_modes(stiffness: Float[Tensor, "*#batch n n"], mass: Float[Tensor, "*#batch n n"]) -> Modes:
    """All modes of K φ = ω² M φ, one `eigh` for the whole batch.

    Raises:
        ArithmeticError: if the eigenvectors are not orthonormal even member by member.
    """
    white, inverse = whiten(stiffness, mass)
    eigenvalue, vector = torch.linalg.eigh(white)
    # Some releases of torch return vectors of a batch that are not orthonormal; such members are solved again alone.
    suspect = _orthonormality_error(vector) > _tolerance(vector)
    if bool(suspect.any()):
        flat, matrices = vector.reshape(-1, *vector.shape[-2:]).clone(), white.reshape(-1, *white.shape[-2:])
        values = eigenvalue.reshape(-1, eigenvalue.shape[-1]).clone()
        for member in torch.nonzero(suspect.flatten()).flatten().tolist():
            values[member], again = torch.linalg.eigh(matrices[member].clone())
            # Vectors of the rigid-body modes have been seen 1e-10 from orthonormal, which LAPACK leaves: a step of
            # Newton and Schulz takes an error e to e², and no broken vector to a whole one.
            flat[member] = again @ (1.5 * _one(again) - 0.5 * again.mT @ again)
        eigenvalue, vector = values.reshape(eigenvalue.shape), flat.reshape(vector.shape)
        if bool((_orthonormality_error(vector) > _tolerance(vector)).any()):
            raise ArithmeticError(
                "Expected orthonormal eigenvectors from torch.linalg.eigh, got a violation above "
                f"{_tolerance(vector):.0e} for a single matrix. Check the torch installation, or use float64."
            )
    return Modes(_rigid_at_zero(eigenvalue), inverse.mT @ vector)


def solve_eigenvalues(
    stiffness: Float[Tensor, "*#batch n n"], mass: Float[Tensor, "*#batch n n"]
) -> Float[Tensor, "*batch n"]:
    """The eigenvalues ω² of `solve_modes` alone, at half its cost [rad²/s²]."""
    return _rigid_at_zero(torch.linalg.eigvalsh(whiten(stiffness, mass)[0]))


def _rigid_at_zero(eigenvalue: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
    """Zero where only rounding kept a rigid-body mode from it.

    Far below the first bending this rounding, over ω², would be most of the FRF: 1e-4 of it at a thousandth on a strip
    of 13:1, all of it at a hundred-thousandth.
    """
    level = RIGID * torch.finfo(eigenvalue.dtype).eps * eigenvalue[..., -1:].abs()
    rigid = (eigenvalue.abs() <= level) & (torch.arange(eigenvalue.shape[-1], device=eigenvalue.device) < N_RIGID)
    return eigenvalue.masked_fill(rigid, 0.0)


def _orthonormality_error(vector: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch"]:
    error = vector.mT @ vector
    error.diagonal(dim1=-2, dim2=-1).sub_(1.0)
    return error.abs_().amax((-2, -1))


def _one(matrix: Float[Tensor, "*batch n n"]) -> Float[Tensor, "n n"]:
    return torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)


def _tolerance(vector: Tensor) -> float:
    """Rounding grows with the size, divide and conquer has been seen to leave 110 n eps; a broken batch is off by 1."""
    return 2000 * vector.shape[-1] * torch.finfo(vector.dtype).eps
