"""The dynamic stiffness in modal coordinates: solves with it, its gradient, and its change.

Rows of complex numbers are [*batch n_frequency n_row n]; every product of all lines at once is a real one.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.model.receptance.batched import solve_each, stack_rows
from torchplate.model.receptance.modal_receptance import ModalSystem, modal_receptance
from torchplate.plate import LOWEST_FREQUENCY, REFERENCE_FREQUENCY, Proportional


class Impedance(NamedTuple):
    """Z(s) = A (1 + iβ + δ + sb) + B (iη + sa + s²) + Uᵀ D U + iH in modal coordinates.

    D is s c of a dashpot and another function of s of a mass on a spring; its own derivatives are nobody's business
    here.

    The functions below read only the diagonals of A and B, the rest being zero, and give the gradient of every entry.
    That of the exponent n, and what β and s do in δ, goes through δ = β (power law of n − i): n alone gets none.
    """

    stiffness: Float[Tensor, "*#batch n n"]  # A = ΦᵀKΦ [rad²/s²]
    mass: Float[Tensor, "*#batch n n"]  # B = ΦᵀMΦ [-]
    dashpot: Float[Tensor, "*#batch n_dashpot n"]  # U [1/√kg]
    force: Complex[Tensor, "*#batch n_dashpot n_frequency"]  # D [N/m]
    stiffness_loss_factor: Float[Tensor, "*#batch"]  # β [-]
    mass_loss_factor: Float[Tensor, "*#batch"]  # η [1/s²]
    mass_coefficient: Float[Tensor, "*#batch"]  # a [1/s]
    stiffness_coefficient: Float[Tensor, "*#batch"]  # b [s]
    hysteretic: Float[Tensor, "*#batch n n"] | None  # H = ΦᵀHΦ [rad²/s²]
    laplace: Complex[Tensor, "*#batch n_frequency"]  # s [1/s]
    loss_exponent: Float[Tensor, "*#batch"] | None = None  # n [-]
    dispersion: Complex[Tensor, "*#batch n_frequency"] | None = None  # δ [-]; None without an exponent

    @property
    def eigenvalue(self) -> Float[Tensor, "*batch n"]:
        """ω² [rad²/s²]."""
        return self.stiffness.diagonal(dim1=-2, dim2=-1)

    @property
    def proportional(self) -> Proportional:
        """Damping in proportion to K and M."""
        return Proportional(*self[4:8], loss_exponent=0.0 if self.loss_exponent is None else self.loss_exponent)

    @property
    def modal(self) -> ModalSystem:
        """The same as far as a value needs it: only diagonals of A and B."""
        return ModalSystem(self.eigenvalue, self.proportional, self.laplace, self.dashpot, self.force, self.hysteretic)

    def at(self, lines: slice) -> "Impedance":
        """The same at some of its lines."""
        dispersion = None if self.dispersion is None else self.dispersion[..., lines]
        return self._replace(laplace=self.laplace[..., lines], force=self.force[..., lines], dispersion=dispersion)


Force = Callable[[Complex[Tensor, "*batch n_line"]], Complex[Tensor, "*batch n_dashpot n_line"]]


def own_damping(z: Impedance, force: Force) -> Float[Tensor, "*batch n"]:
    """All that damps each mode at its own frequency [rad²/s²]: β(ω) ω² + η + a ω + b ω³ + Σ u² Im D + H_rr.

    Args:
        z: the impedance.
        force: D at any s.
    """
    square = z.eigenvalue.clamp(min=0.0)
    omega = square.sqrt()
    beta, eta, a, b = (part[..., None] for part in z[4:8])
    if z.loss_exponent is not None:
        # Rigid-body motion has no frequency, and no loss.
        lowest, reference = 2 * torch.pi * LOWEST_FREQUENCY, 2 * torch.pi * REFERENCE_FREQUENCY
        beta = beta * (omega.clamp(min=lowest) / reference) ** z.loss_exponent[..., None]
    own = beta * square + eta + a * omega + b * omega * square
    own = own + (force(1j * omega).imag * z.dashpot.square()).sum(-2)
    return own if z.hysteretic is None else own + z.hysteretic.diagonal(dim1=-2, dim2=-1)


def scattered(z: Impedance, factor: Float[Tensor, " n_factor"], force: Force) -> Impedance:
    """The impedance whose lowest modes have a damping of their own: a hysteretic i (f − 1) d_r is added to each.

    Args:
        z: the impedance.
        factor: f of the lowest modes [-]; d_r is their `own_damping`.
        force: D at any s.
    """
    own = own_damping(z, force)
    n = min(len(factor), own.shape[-1])
    # Of modes beyond the given ones nothing changes.
    excess = torch.cat([factor[:n] - 1, factor.new_zeros(own.shape[-1] - n)])
    added = torch.diag_embed(excess * own)
    return z._replace(hysteretic=added if z.hysteretic is None else z.hysteretic + added)


def solve(z: Impedance, weight: Tensor, rows: Tensor) -> Tensor:
    """Rows x = Z⁻¹ r by line, r = weight · rows; dashpots by the Woodbury identity, as in `receptance`.

    Args:
        z: the impedance.
        weight: complex [*batch n_frequency n_solved n_row].
        rows: real [*batch n_row n].
    """
    real, imaginary = z.modal.denominator()
    gain = z.force.mT[..., None]
    if z.hysteretic is not None:
        impedance = torch.diag_embed(torch.complex(real, imaginary)) + 1j * z.hysteretic[..., None, :, :]
        dashpot = z.dashpot[..., None, :, :].to(impedance)
        return solve_each(impedance + dashpot.mT @ (gain * dashpot), times(weight, rows).mT).mT
    if z.dashpot.shape[-2] > 0:
        # The dashpots' forces are more rows in the mix, so that the many modes are gone through only once.
        felt = modal_receptance(z.modal, stack_rows(rows, z.dashpot), z.dashpot)
        by_rows, own = felt.split([rows.shape[-2], z.dashpot.shape[-2]], dim=-2)
        coupled = torch.eye(own.shape[-1]).to(own) + gain * own
        force = torch.linalg.solve(coupled, gain * (weight @ by_rows).mT).mT
        weight = torch.cat([weight.expand(*force.shape[:-1], weight.shape[-1]), -force], dim=-1)
        rows = stack_rows(rows, z.dashpot)
    scale = 1 / (real**2 + imaginary**2)
    return times(weight, rows) * torch.complex(real * scale, -imaginary * scale)[..., None, :]


def adjoint_gradient(z: Impedance, adjoint: Tensor, moved: Tensor, needed: Any) -> list[Tensor | None]:
    """Gradients of −Re Σ wᵀ Z x over all lines and rows, in the order of `Impedance`.

    Args:
        z: the impedance.
        adjoint: w [*batch n_frequency n_row n].
        moved: x, likewise.
        needed: for each part of the impedance, whether its gradient is wanted.
    """
    grad: dict[str, Tensor | None] = dict.fromkeys(Impedance._fields)
    need = dict(zip(Impedance._fields, needed, strict=True))
    kappa, mu = z.proportional.at(z.laplace)
    s = z.laplace
    for name, weight in (("stiffness", kappa), ("mass", mu), ("hysteretic", torch.full_like(s, 1j))):
        if need[name]:
            grad[name] = -contract(adjoint * weight[..., None, None], moved)
    rate = torch.zeros_like(s)
    if need["stiffness_loss_factor"] or need["stiffness_coefficient"] or need["laplace"] or need["dispersion"]:
        work = _work(adjoint, moved, z.stiffness)
        grad["dispersion"] = -conjugate(work)
        grad["stiffness_loss_factor"] = work.imag.sum(-1)
        grad["stiffness_coefficient"] = -(s * work).real.sum(-1)
        rate = rate - z.stiffness_coefficient[..., None] * work
    if need["mass_loss_factor"] or need["mass_coefficient"] or need["laplace"]:
        work = _work(adjoint, moved, z.mass)
        grad["mass_loss_factor"] = work.imag.sum(-1)
        grad["mass_coefficient"] = -(s * work).real.sum(-1)
        rate = rate - (z.mass_coefficient[..., None] + 2 * s) * work
    if z.dashpot.shape[-2] > 0 and (need["dashpot"] or need["force"]):
        pull, push = (times(rows, z.dashpot.mT) for rows in (adjoint, moved))
        power = (pull * push).sum(-2)
        grad["force"] = -conjugate(power).mT
        if need["dashpot"]:
            gain = z.force.mT[..., None, :]
            grad["dashpot"] = -(contract(gain * push, adjoint) + contract(gain * pull, moved))
    grad["laplace"] = conjugate(rate)
    return [
        value.sum_to_size(part.shape) if need[name] and value is not None and part is not None else None
        for (name, value), part in zip(grad.items(), z, strict=True)
    ]


def change_times(z: Impedance, tangents: Any, moved: Tensor) -> Tensor:
    """Rows dZ x for the change of every part of the impedance; None is no change."""
    change = dict(zip(Impedance._fields, tangents, strict=True))
    kappa, mu = z.proportional.at(z.laplace)
    s = z.laplace
    total = torch.zeros_like(moved)
    for name, weight in (("stiffness", kappa), ("mass", mu), ("hysteretic", torch.full_like(s, 1j))):
        if change[name] is not None:
            total = total + weight[..., None, None] * times(moved, change[name])
    factor, squared = torch.full_like(s, 1j), z.mass_coefficient[..., None] + 2 * s
    proportional = (
        (z.stiffness, "stiffness_loss_factor", "stiffness_coefficient", z.stiffness_coefficient[..., None]),
        (z.mass, "mass_loss_factor", "mass_coefficient", squared),
    )
    for matrix, loss, viscous, rate in proportional:
        parts = [(change[loss], factor), (change[viscous], s)]
        weights = [weight * part[..., None] for part, weight in parts if part is not None]
        if change["laplace"] is not None:
            weights.append(rate * change["laplace"])
        if loss == "stiffness_loss_factor" and change["dispersion"] is not None:
            weights.append(change["dispersion"])
        if weights:
            total = total + sum(weights)[..., None, None] * times(moved, matrix)
    if z.dashpot.shape[-2] == 0:
        return total
    gain, push = z.force.mT[..., None, :], times(moved, z.dashpot.mT)
    if change["dashpot"] is not None:
        total = total + times(gain * push, change["dashpot"])
        total = total + times(gain * times(moved, change["dashpot"].mT), z.dashpot)
    if change["force"] is None:
        return total
    return total + times(change["force"].mT[..., None, :] * push, z.dashpot)


def times(rows: Tensor, matrix: Tensor) -> Tensor:
    """Complex rows by line times a real matrix: one real product for all lines, of which torch would make one each."""
    flat = rows.flatten(-3, -2)
    return torch.complex(flat.real @ matrix, flat.imag @ matrix).unflatten(-2, rows.shape[-3:-1])


def contract(first: Tensor, second: Tensor) -> Tensor:
    """Re Σ a bᵀ over lines and rows, in one real product."""
    left, right = torch.cat([first.real, -first.imag], dim=-2), torch.cat([second.real, second.imag], dim=-2)
    return left.flatten(-3, -2).mT @ right.flatten(-3, -2)


def _work(adjoint: Tensor, moved: Tensor, matrix: Tensor) -> Tensor:
    """Σ wᵀ A x over the rows of each line; A's diagonal says all, unless a further derivative may need its rest."""
    if torch.is_grad_enabled():
        return (adjoint * times(moved, matrix)).sum((-2, -1))
    return ((adjoint * moved).sum(-2) * matrix.diagonal(dim1=-2, dim2=-1)[..., None, :]).sum(-1)


def conjugate(value: Tensor) -> Tensor:
    """The conjugate, written out: vmap has no rule for torch's own once its parts are taken."""
    return torch.complex(value.real, -value.imag)
