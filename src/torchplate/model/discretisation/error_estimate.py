"""How wrong a reduced model is: measured against the full one, or estimated member by member from what it leaves over.

With Z x̂ = f + residual, Z symmetric and x̂ from Galerkin's projection, the error of a receptance is a product of two
residuals, δα_jk = r_jᵀ Z⁻¹ r_k: the residuals are orthogonal to the basis, so that Z x̂_j drops out (the dual weighted
residual: Becker and Rannacher, Acta Numerica 10 (2001) 1). What the basis lacks are high modes, on which Z is nearly
the static stiffness: K⁻¹ of the nominal plate, factored once, stands for Z⁻¹. So the estimate needs matrices of the
member but no solve with them.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.model.discretisation import fine_mesh
from torchplate.model.discretisation.fine_mesh import SparseModel
from torchplate.model.plate_model import PlateModel

# Lines over the band at which a fine mesh is checked against the full model, or a residual is taken.
N_LINE_CHECKED = 8
# Lines of the highest motion at which a residual is taken.
N_PEAK, N_PEAK_FINE = 32, 8


class Full(NamedTuple):
    """What the full model says of some members; reduced ones are held against it.

    Attributes:
        theta: the members.
        frequency: lines of the FRFs [Hz].
        frf: at these lines; None if none are wanted.
        natural: so many lowest natural frequencies [Hz]; None if none are wanted.
    """

    theta: Float[Tensor, "n_member n_parameter"]
    frequency: Float[Tensor, " n_frequency"] | None
    frf: Complex[Tensor, "n_member n_frequency n_response n_reference"] | None
    natural: Float[Tensor, "n_member n_mode"] | None

    def error(self, reduced: PlateModel) -> float:
        """Greatest error of a reduced model: of FRFs in relative norm, of natural frequencies over themselves."""
        errors = [0.0]
        if self.frf is not None:
            errors.append(float(_relative(reduced.frf(self.theta, self.frequency), self.frf).max()))
        if self.natural is not None:
            small = reduced.natural_frequencies(self.theta, self.natural.shape[-1])
            # Rigid-body modes of a free plate are zero up to rounding: held to the first frequency that is not.
            floor = self.natural[self.natural > 1e-3 * self.natural.max()].min()
            errors.append(float(((small - self.natural).abs() / self.natural.clamp(min=float(floor))).max()))
        return max(errors)


@torch.no_grad()
def full_model(
    model: PlateModel,
    theta: Float[Tensor, "n_member n_parameter"],
    frequency: Float[Tensor, " n_frequency"] | None = None,
    n_mode: int = 0,
) -> Full:
    """What a model says of some members, without a basis.

    On a mesh of more than `fine_mesh.DENSE` dofs the FRFs are solved for at `N_LINE_CHECKED` lines over the band.

    Args:
        model: the full one.
        theta: the members.
        frequency: lines [Hz]; None if no FRFs are wanted.
        n_mode: number of natural frequencies.
    """
    frf = natural = None
    if model.assembly.size <= fine_mesh.DENSE:
        frf = None if frequency is None else model.frf(theta, frequency)
        natural = model.natural_frequencies(theta, n_mode) if n_mode else None
        return Full(theta, frequency, frf, natural)
    if frequency is not None:
        frequency = frequency[_spread(len(frequency)).to(frequency.device)]
        frf = torch.stack([SparseModel(model, member).frf(frequency) for member in theta])
    if n_mode:
        natural = torch.stack([SparseModel(model, member).modes(n_mode).frequency[:n_mode] for member in theta])
    return Full(theta, frequency, frf, natural)


@torch.no_grad()
def basis_error(
    model: PlateModel,
    reduced: PlateModel,
    theta: Float[Tensor, "n_member n_parameter"],
    frequency: Float[Tensor, " n_frequency"] | None = None,
    n_mode: int = 0,
) -> float:
    """Greatest error of the reduced model: of FRFs in relative norm, of natural frequencies relative to themselves.

    See `full_model`.
    """
    return full_model(model, theta, frequency, n_mode).error(reduced)


@torch.no_grad()
def estimated_error(
    model: PlateModel,
    reduced: PlateModel,
    theta: Float[Tensor, "n_member n_parameter"],
    frequency: Float[Tensor, " n_frequency"],
) -> Float[Tensor, " n_member"]:
    """Estimated relative error of each member's worst FRF, from residuals of the full dynamic stiffness [-].

    The residuals are taken at the `N_PEAK` lines where the member moves most, and at others spread over the band that
    stand for all the rest. No full model is solved: the cost is that of the member's sparse matrices, and of solves
    with the nominal one's.

    Args:
        model: the full model.
        reduced: the same in a basis, from `reduce` or `projected`.
        theta: searched parameters in SI units.
        frequency: lines [Hz].
    """
    middle = model.space.to_si(torch.full((len(model.names),), 0.5).to(model.known))
    nominal, errors = SparseModel(model, middle), []
    n_peak = N_PEAK if model.assembly.size <= fine_mesh.DENSE else N_PEAK_FINE
    for member, frf in zip(theta, reduced.frf(theta, frequency), strict=True):
        order = _importance(frf).argsort(descending=True)
        peaks, rest = order[:n_peak], order[n_peak:].sort().values
        some = rest[_spread(len(rest)).to(rest)]
        lines = torch.cat([peaks, some])
        own = SparseModel(model, member)
        solve = functools.partial(_corrected, own, nominal, reduced)
        off = (frf[lines] - own.observed(frequency[lines], solve)).abs().square()
        total = off[: len(peaks)].sum(0) + off[len(peaks) :].sum(0) * (len(rest) / max(1, len(some)))
        errors.append((total / frf.abs().square().sum(0)).sqrt().max())
    return torch.stack(errors)


def _corrected(
    own: SparseModel,
    nominal: SparseModel,
    reduced: PlateModel,
    laplace: Complex[Tensor, " n_frequency"],
    response: Float[Tensor, "n_response n"],
    reference: Float[Tensor, "n_reference n"],
) -> Complex[Tensor, "n_frequency n_response n_reference"]:
    """Receptances of the reduced model, with the estimate of their error taken off."""
    assert reduced.assembly.basis is not None
    basis = reduced.assembly.basis.double().cpu().numpy()
    # By reciprocity it is enough to solve for the residuals of the fewer side.
    turned = len(response) < len(reference)
    few, many = (rows.double().cpu().numpy() for rows in ((response, reference) if turned else (reference, response)))
    parts, weight = own.impedance_parts(laplace)
    times = [part @ basis for part in parts]
    times = [part + more for part, more in zip(times, own.lacking(basis), strict=True)]
    small = sum(w[:, None, None] * (basis.T @ part) for part, w in zip(times, weight, strict=True))
    motion_few, motion_many = (_motion(small, basis.T @ rows.T) for rows in (few, many))
    # What all parts of Z do to the basis, side by side; each part's weight goes to the motions.
    whole = np.concatenate(times, axis=1)
    moved_few, moved_many = (_weighted(motion, weight) for motion in (motion_few, motion_many))
    left_over = few.T[:, None] - _product(whole, np.moveaxis(moved_few, 0, 1))
    flexible = _product(nominal.solve, left_over)
    # r_manyᵀ K⁻¹ r_few, with r_many = f − S c: its residuals at all lines would take more memory than all else here.
    felt, seen = (np.moveaxis(_product(rows, flexible), 0, 1) for rows in (many, whole.T))
    found = (many @ basis) @ motion_few + felt - np.swapaxes(moved_many, 1, 2) @ seen
    return torch.from_numpy(np.swapaxes(found, 1, 2).copy() if turned else found).to(laplace)


def _motion(small: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Motions in the basis under the same loads at every line, [n_frequency, n_basis, n_load]."""
    found: np.ndarray = np.linalg.solve(small, np.broadcast_to(load, (len(small), *load.shape)))
    return found


def _weighted(motion: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Motions times the weight of each part of Z, one part under the other, [n_frequency, n_part n_basis, n_load]."""
    found: np.ndarray = (weight.T[:, :, None, None] * motion[:, None]).reshape(len(motion), -1, motion.shape[-1])
    return found


def _product(real: np.ndarray | Callable[[np.ndarray], np.ndarray], many: np.ndarray) -> np.ndarray:
    """A real matrix, or a solve with one, times complex columns [n, ...], which it takes as twice as many real ones."""
    columns = np.stack([many.real, many.imag], axis=-1).reshape(len(many), -1)
    found = real @ columns if isinstance(real, np.ndarray) else real(columns)
    found = found.reshape(len(found), *many.shape[1:], 2)
    return found[..., 0] + 1j * found[..., 1]


def _importance(frf: Complex[Tensor, "n_frequency n_response n_reference"]) -> Float[Tensor, " n_frequency"]:
    """How much of some FRF each line holds; a line on a resonance, which an error shifts, before all others."""
    square = frf.abs().square().flatten(1)
    share = (square / square.sum(0).clamp(min=1e-300)).amax(1)
    around = torch.nn.functional.pad(share, (1, 1))
    return share + ((share >= around[:-2]) & (share >= around[2:])).to(share)


def relative_error(
    found: Complex[Tensor, "n_member n_frequency n_response n_reference"],
    full: Complex[Tensor, "n_member n_frequency n_response n_reference"],
) -> Float[Tensor, " n_member"]:
    """Relative norm of the difference of each member's worst FRF [-]."""
    return _relative(found, full).flatten(1).amax(1)


def _relative(found: Tensor, full: Tensor) -> Tensor:
    return (found - full).norm(dim=-3) / full.norm(dim=-3)


def _spread(n_frequency: int) -> Tensor:
    """Indices of `N_LINE_CHECKED` lines at most, over the whole band."""
    return torch.linspace(0, max(0, n_frequency - 1), min(N_LINE_CHECKED, n_frequency)).round().long()
