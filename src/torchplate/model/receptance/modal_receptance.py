"""Receptances from modes: the modal sum with a low-rank correction, exact in all damping terms.

With mass-normalised modes of (K, M) and damping in proportion to both, Z(s) is diagonal in modal coordinates,

    d_r(s) = ω_r² (1 + iβ + sb) + iη + sa + s²,

so α_jk = Σ_r φ_jr φ_kr / d_r (seed paper, Eq. 19–20; Ewins, Modal Testing, section 2.4). Dashpots at places make it
d + s Uᵀ C U; they are attached one after the other, exactly: see `modal_sum`. s = iω on the frequency axis; s = iω + σ
for a record windowed by exp(−σt).
"""

from collections.abc import Iterator
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.model.receptance.attach import attach, lines_last, pulls
from torchplate.model.receptance.batched import joined, solve_each, stack_rows
from torchplate.model.receptance.complex_modes import complex_modes
from torchplate.model.receptance.modal_sum import LINES_AT_ONCE, modal_sum, pairs_of, reciprocal
from torchplate.plate import Proportional, common_shape, is_vmapped

# Impedances solved at once, so that they stay in the cache [bytes].
IN_CACHE = 4 * 2**20
# Attached places times what one side has of rows beyond the other, over the rows of the latter, up to which all pairs
# of rows cost less than to carry these rows to the modes, which takes as long as so many products.
CARRIED = 30
# Lines of all members together whose uncoupled modes are summed at once: of few members, fewer steps cost less than
# what leaves the cache.
LINES_OF_ALL = 2400


class ModalSystem(NamedTuple):
    """A plate in the coordinates of its modes, at some lines: Z(s) = diag d_r(s) + Uᵀ D U + iH.

    Attributes:
        eigenvalue: ω_r² [rad²/s²].
        proportional: damping in proportion to K and M.
        laplace: s [1/s].
        dashpot: U, modal deflections at the dashpots and sprung masses [1/√kg].
        force: D, their dynamic stiffness at every line [N/m].
        hysteretic: H = ΦᵀHΦ of elements with a loss of their own [rad²/s²].
    """

    eigenvalue: Float[Tensor, "*#batch n_mode"]
    proportional: Proportional
    laplace: Complex[Tensor, "*#batch n_frequency"]
    dashpot: Float[Tensor, "*#batch n_dashpot n_mode"]
    force: Complex[Tensor, "*#batch n_dashpot n_frequency"]
    hysteretic: Float[Tensor, "*#batch n_mode n_mode"] | None = None

    def split(self, at_once: int) -> "Iterator[ModalSystem]":
        """The same, at so many of its lines at a time."""
        lines = zip(self.laplace.split(at_once, dim=-1), self.force.split(at_once, dim=-1), strict=True)
        return (self._replace(laplace=s, force=force) for s, force in lines)

    def stretches(self) -> "Iterator[ModalSystem]":
        """The same, at lines that stay in the cache together."""
        return self.split(LINES_AT_ONCE if self.laplace.device.type == "cpu" else self.laplace.shape[-1])

    def denominator(
        self,
    ) -> tuple[Float[Tensor, "*batch n_frequency n_mode"], Float[Tensor, "*batch n_frequency n_mode"]]:
        """Real and imaginary part of d_r(s) [rad²/s²]."""
        return modal_denominator(self.eigenvalue, self.proportional, self.laplace)


def modal_denominator(
    eigenvalue: Float[Tensor, "*#batch n_mode"],
    proportional: Proportional,
    laplace: Complex[Tensor, "*#batch n_frequency"],
) -> tuple[Float[Tensor, "*batch n_frequency n_mode"], Float[Tensor, "*batch n_frequency n_mode"]]:
    """Real and imaginary part of d_r(s) [rad²/s²].

    Real arithmetic throughout: complex division costs several times as much, and this is the largest array of all.
    """
    kappa, mu = (part[..., None] for part in proportional.at(laplace))
    square = eigenvalue[..., None, :]
    real, imaginary = torch.broadcast_tensors(square * kappa.real + mu.real, square * kappa.imag + mu.imag)
    return real, imaginary


def modal_receptance(
    system: ModalSystem, left: Float[Tensor, "*#batch n_left n_mode"], right: Float[Tensor, "*#batch n_right n_mode"]
) -> Complex[Tensor, "*batch n_frequency n_left n_right"]:
    """Σ_r left_r right_r / d_r(s) [m/N], nothing attached: one real matrix product for all lines and pairs."""
    real, imaginary = system.denominator()
    scale = 1 / (real**2 + imaginary**2)
    inverse = torch.stack([real * scale, -imaginary * scale], dim=-3)
    pairs = (left[..., :, None, :] * right[..., None, :, :]).flatten(-3, -2)
    total = inverse @ pairs[..., None, :, :].mT
    total = total.unflatten(-1, (left.shape[-2], right.shape[-2]))
    return torch.complex(total[..., 0, :, :, :], total[..., 1, :, :, :])


def receptance(
    system: ModalSystem,
    response: Float[Tensor, "*#batch n_response n_mode"],
    reference: Float[Tensor, "*#batch n_reference n_mode"],
) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
    """Receptance α [m/N] from modes, exact in all damping terms.

    Args:
        system: where its parts with a loss of their own couple the modes, complex modes are solved for, or each line.
        response: modal deflections at the responses [1/√kg].
        reference: modal deflections at the references [1/√kg].
    """
    if system.hysteretic is not None:
        return _with_own_loss(system, system.hysteretic, response, reference)
    left, right = stack_rows(system.dashpot, response), stack_rows(system.dashpot, reference)
    parts = []
    for part in system.stretches():
        kappa, mu = part.proportional.at(part.laplace)
        batches = (part.eigenvalue.shape[:-1], left.shape[:-2], right.shape[:-2], part.force.shape[:-2])
        shape = common_shape(*batches, kappa.shape[:-1], mu.shape[:-1])
        flexibility = 1 / kappa
        z = (-mu * flexibility).expand(*shape, part.laplace.shape[-1])
        found = modal_sum(part.eigenvalue, left, right, z)
        parts.append(attach(found, lines_last(part.force, len(shape)) * flexibility) * flexibility)
    return joined(parts, -1).movedim((0, 1), (-2, -1))


def has_complex_modes(proportional: Proportional, *matrices: Tensor) -> bool:
    """Whether the same complex modes serve all lines: K is times one number at all of them."""
    varying = proportional.stiffness_coefficient, proportional.loss_exponent
    if torch.is_grad_enabled() or is_vmapped(*varying, *matrices):
        return False
    return not any(bool(torch.as_tensor(part).any()) for part in varying)


def _with_own_loss(system: ModalSystem, hysteretic: Tensor, response: Tensor, reference: Tensor) -> Tensor:
    """α where parts have a loss of their own: mode by mode, by complex modes, or by solves, as far as these couple."""
    if _is_diagonal(hysteretic):
        return _by_uncoupled_modes(system, hysteretic.diagonal(dim1=-2, dim2=-1), response, reference)
    if has_complex_modes(system.proportional, system.eigenvalue, hysteretic):
        return _by_complex_modes(system, hysteretic, response, reference)
    tied = system.dashpot[..., None, :, :].to(system.laplace)
    hysteretic, columns = 1j * hysteretic[..., None, :, :], reference.mT[..., None, :, :].to(system.laplace)
    sizes = (system.eigenvalue.shape[:-1], hysteretic.shape[:-3], system.dashpot.shape[:-2], system.force.shape[:-2])
    n_member = common_shape(*sizes).numel()
    parts = []
    for part in system.split(max(1, IN_CACHE // (16 * n_member * system.eigenvalue.shape[-1] ** 2))):
        coupling = tied.mT @ (part.force.mT[..., None] * tied)
        impedance = torch.diag_embed(torch.complex(*part.denominator())) + (hysteretic + coupling)
        parts.append(response[..., None, :, :].to(impedance) @ solve_each(impedance, columns))
    return joined(parts, -3)


def _is_diagonal(hysteretic: Tensor) -> bool:
    """Whether it couples no modes; under `vmap` nobody may look."""
    if is_vmapped(hysteretic):
        return False
    return not bool((hysteretic - torch.diag_embed(hysteretic.diagonal(dim1=-2, dim2=-1))).any())


def _by_uncoupled_modes(system: ModalSystem, own_loss: Tensor, response: Tensor, reference: Tensor) -> Tensor:
    """Z(s) without what is attached at places is diagonal: d_r(s) + i h_r, h what each mode loses by itself.

    All pairs of rows and attached places are summed over the modes, and the places attached. Where one side has many
    more rows, each of the other is carried to the places and to the modes, then to the many: their pairs with the
    places are never made.
    """
    fewer, more, swapped = response, reference, False
    if response.shape[-2] > reference.shape[-2]:
        fewer, more, swapped = reference, response, True
    attached, n_attached = system.dashpot, system.dashpot.shape[-2]
    n_more, n_fewer = more.shape[-2], fewer.shape[-2]
    few_pairs = n_attached * (n_more - n_fewer) <= CARRIED * n_fewer
    left, right = (stack_rows(attached, side) for side in (fewer, more))
    pairs = pairs_of(left, right if few_pairs else attached)
    parts = []
    n_member = common_shape(system.eigenvalue.shape[:-1], own_loss.shape[:-1], pairs.shape[:-2]).numel()
    for part in system.split(max(LINES_AT_ONCE, LINES_OF_ALL // n_member)):
        real, turned = _inverse(part, own_loss)
        if few_pairs:
            found = torch.complex(pairs @ real, -(pairs @ turned))
            parts.append(_with_dashpots(found, left, right, part.force).movedim((0, 1), (-3, -2)))
            continue
        felt = torch.complex(pairs @ real, -(pairs @ turned))
        batch = common_shape(felt.shape[:-2], more.shape[:-2], part.force.shape[:-2])
        felt = felt.expand(*batch, *felt.shape[-2:]).unflatten(-2, (-1, n_attached)).movedim((-3, -2), (0, 1))
        force = lines_last(part.force, len(batch)).expand(n_attached, *felt.shape[2:])
        pull = torch.stack(pulls(felt, force), dim=-2)
        # [row, *batch, mode, line], the imaginary part with its sign turned, as that of 1 / d.
        down = attached.mT
        rows = fewer.expand(*batch, *fewer.shape[-2:]).movedim(-2, 0)[..., None]
        carried = rows - down @ pull.real, down @ pull.imag
        one = more @ torch.addcmul(carried[0] * real, carried[1], turned, value=-1)
        other = more @ torch.addcmul(carried[0] * turned, carried[1], real)
        parts.append(torch.complex(one, -other).movedim(0, -3))
    found = joined(parts, -1)
    # [*batch, line, response, reference]
    return found.movedim(-1, -3).mT if swapped else found.movedim(-1, -3)


def _inverse(system: ModalSystem, own_loss: Float[Tensor, "*#batch n_mode"]) -> tuple[Tensor, Tensor]:
    """1 / d as real part and the negative of its imaginary part, lines side by side in memory [*batch, mode, line].

    Args:
        system: at some lines.
        own_loss: h of each mode.
    """
    kappa, mu = (
        torch.view_as_real(part.resolve_conj()).movedim(-1, 0) for part in system.proportional.at(system.laplace)
    )
    (stiff, lossy), (inert, drag) = (part.contiguous()[..., None, :] for part in (kappa, mu))
    square = system.eigenvalue[..., None]
    real, imaginary = torch.addcmul(inert, square, stiff), torch.addcmul(drag + own_loss[..., None], square, lossy)
    scale = torch.addcmul(imaginary * imaginary, real, real).reciprocal_()
    return real * scale, imaginary * scale


def _by_complex_modes(system: ModalSystem, hysteretic: Tensor, response: Tensor, reference: Tensor) -> Tensor:
    """Z(s) = Λ (1 + iβ) + iH + μ(s), without the dashpots, has the complex modes of Λ (1 + iβ) + iH at every s."""
    beta = system.proportional.stiffness_loss_factor
    beta = beta[..., None] if isinstance(beta, Tensor) else beta
    stiffness = torch.diag_embed(system.eigenvalue * (1 + 1j * beta)) + 1j * hysteretic
    value, shape, inverse = complex_modes(stiffness)
    left, right = stack_rows(system.dashpot, response), stack_rows(system.dashpot, reference)
    rows = left.to(shape) @ shape
    columns = right.to(shape) @ inverse.mT
    pairs = (rows[..., :, None, :] * columns[..., None, :, :]).flatten(-3, -2)
    mu = system.proportional.at(system.laplace)[1]
    found = pairs @ reciprocal(value[..., :, None] + mu[..., None, :])
    return _with_dashpots(found, left, right, system.force).movedim((0, 1), (-2, -1))


def _with_dashpots(found: Tensor, left: Tensor, right: Tensor, force: Tensor) -> Tensor:
    """Receptances of all pairs of rows, [*batch, pair, line], with the dashpots among the rows attached."""
    batch = common_shape(found.shape[:-2], force.shape[:-2])
    found = found.expand(*batch, *found.shape[-2:])
    found = found.unflatten(-2, (left.shape[-2], right.shape[-2])).movedim((-3, -2), (0, 1))
    force = lines_last(force, len(batch))
    return attach(found, force.expand(len(force), *found.shape[2:]))
