"""How wrong a reduced model is: measured against the full one, or estimated member by member from what it leaves over.

With Z x̂ = f + residual, Z symmetric and x̂ from Galerkin's projection, the error of a receptance is a product of two
residuals, δα_jk = r_jᵀ Z⁻¹ r_k: the residuals are orthogonal to the basis, so that Z x̂_j drops out (the dual weighted
residual: Becker and Rannacher, Acta Numerica 10 (2001) 1). What the basis lacks are high modes, on which Z is nearly
the static stiffness: K⁻¹ of the nominal plate, factored once, stands for Z⁻¹. So the estimate needs matrices of the
member but no solve with them.
"""

import functools

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.model import fine_mesh
from torchplate.model.fine_mesh import SparseModel
from torchplate.model.plate_model import PlateModel

# Lines over the band at which a fine mesh is checked against the full model, or a residual is taken.
N_LINE_CHECKED = 8
# Lines of the highest motion at which a residual is taken.
N_PEAK, N_PEAK_FINE = 32, 8


@torch.no_grad()
def basis_error(
    model: PlateModel,
    reduced: PlateModel,
    theta: Float[Tensor, "n_member n_parameter"],
    frequency: Float[Tensor, " n_frequency"] | None = None,
    n_mode: int = 0,
) -> float:
    """Greatest error of the reduced model: of FRFs in relative norm, of natural frequencies relative to themselves.

    On a mesh of more than `fine_mesh.DENSE` dofs the FRFs are compared at `N_LINE_CHECKED` lines over the band.
    """
    errors = [0.0]
    fine = model.assembly.size > fine_mesh.DENSE
    if frequency is not None:
        if fine:
            frequency = frequency[_spread(len(frequency)).to(frequency.device)]
            full = torch.stack([SparseModel(model, member).frf(frequency) for member in theta])
        else:
            full = model.frf(theta, frequency)
        errors.append(float(_relative(reduced.frf(theta, frequency), full).max()))
    if n_mode:
        if fine:
            full = torch.stack([SparseModel(model, member).modes(n_mode).frequency[:n_mode] for member in theta])
        else:
            full = model.natural_frequencies(theta, n_mode)
        small = reduced.natural_frequencies(theta, n_mode)
        # Rigid-body modes of a free plate are zero up to rounding; they are held to the first frequency that is not.
        floor = full[full > 1e-3 * full.max()].min()
        errors.append(float(((small - full).abs() / full.clamp(min=float(floor))).max()))
    return max(errors)


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
    forces = torch.cat([response, reference]).double().cpu().numpy().T
    moved, weight = own.impedance_parts(laplace)
    times = [part @ basis for part in moved]
    lacking = own.lacking(basis)
    times[: len(lacking)] = [part + more for part, more in zip(times, lacking, strict=False)]
    small = sum(w[:, None, None] * (basis.T @ part) for part, w in zip(times, weight, strict=True))
    motion = np.linalg.solve(small, np.broadcast_to(basis.T @ forces, (len(laplace), *(basis.T @ forces).shape)))
    left_over = forces - sum(w[:, None, None] * (part @ motion) for part, w in zip(times, weight, strict=True))
    columns = np.moveaxis(left_over, 0, 1)
    flexible = nominal.solve(np.stack([columns.real, columns.imag], axis=-1).reshape(len(forces), -1))
    flexible = np.moveaxis(flexible.reshape(*columns.shape, 2) @ np.array([1, 1j]), 0, 1)
    found = (basis.T @ forces).T @ motion + np.swapaxes(left_over, 1, 2) @ flexible
    return torch.from_numpy(found[:, : len(response), len(response) :].copy()).to(laplace)


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
