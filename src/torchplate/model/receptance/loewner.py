"""The gradient of receptances with respect to whole matrices, for little more than the receptances themselves.

With Z = κ (A − z B) + Uᵀ D U at A = diag λ, B = 1, every motion is a mix of few rows over the same denominators:
x_k = Σ_b p_kb e_b / κ(λ − z), y_j likewise with q_ja, where the rows e are those of the dashpots (p_kt = −D_t u_t·x_k
are the forces they exert), of the responses and of the references. So the gradient of Re Σ w̄ α (w the incoming
gradient) needs only, for each pair of rows and each mode,

    S_ab(λ) = Σ_s v_ab(s) / (λ − z(s)),    v_ab = Σ_jk w̄_jk q_ja p_kb / κ,

and with 1 / (λ_r − z)(λ_q − z) = −(1/(λ_r − z) − 1/(λ_q − z)) / (λ_r − λ_q) the gradient of A is a Loewner matrix of
divided differences,

    ∂A_rq = Re Σ_ab e_ar e_bq S_ab[λ_r, λ_q],    ∂B_rq = −Re Σ_ab e_ar e_bq (λ S_ab)[λ_r, λ_q]

(Antoulas, Approximation of Large-Scale Dynamical Systems, 2005, section 4.5). Where two λ are so close that their
difference has no digits, the divided difference is the derivative. No array of [line, row, mode, mode] is ever made.
S is a modal sum with the parts of λ and z exchanged: where λ is far from a block of lines, the same series serves it.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchplate.model.receptance.attach import lines_last, weights
from torchplate.model.receptance.batched import stack_rows
from torchplate.model.receptance.impedance import Impedance, conjugate
from torchplate.model.receptance.modal_sum import LINES_AT_ONCE, Disc, Stretch, as_real, pairs_of, times_complex
from torchplate.plate import common_shape

# Eigenvalues closer than this part of their distance to the nearest line: rounding costs 1e-16 / CLOSE of a difference,
# and the derivative is CLOSE² off.
CLOSE = 1e-5


def receptance_gradient(
    z: Impedance, left: Tensor, right: Tensor, grad: Tensor, needed: Any
) -> tuple[Tensor | None, ...]:
    """Gradients of Re Σ conj(grad) α with respect to left, right and all of the impedance, in this order.

    Args:
        z: the impedance, without losses of single elements.
        left: modal deflections at the responses [*batch, n_response, n].
        right: at the references.
        grad: incoming, [*batch, n_frequency, n_response, n_reference].
        needed: for left, right and each part of the impedance, whether its gradient is wanted.
    """
    need = dict(zip(("left", "right", *Impedance._fields), needed, strict=True))
    rows, columns = stack_rows(z.dashpot, left), stack_rows(z.dashpot, right)
    weight = conjugate(grad).movedim((-2, -1), (0, 1))
    total, of_lines = None, []
    at_once = LINES_AT_ONCE // 2 if grad.device.type == "cpu" else grad.shape[-3]
    for first, own in zip(range(0, z.laplace.shape[-1], at_once), weight.split(at_once, dim=-1), strict=True):
        part, of_line = _block(z.at(slice(first, first + at_once)), rows, columns, own, need)
        total = part if total is None else total.plus(part)
        of_lines.append(of_line)
    assert total is not None
    n_dashpot = z.dashpot.shape[-2]
    to_columns = (total.level * rows[..., :, None, :]).sum(-3)
    to_rows = (total.level * columns[..., None, :, :]).sum(-2)
    grads: dict[str, Tensor | None] = dict.fromkeys(need)
    grads["left"], grads["right"] = to_rows[..., n_dashpot:, :], to_columns[..., n_dashpot:, :]
    grads["dashpot"] = to_rows[..., :n_dashpot, :] + to_columns[..., :n_dashpot, :]
    if need["stiffness"] or need["mass"]:
        across = (total.slope * rows[..., :, None, :]).sum(-3), (total.slope * columns[..., None, :, :]).sum(-2)
        divided = _Divided(z.eigenvalue, total.nearest, rows, columns)
        grads["stiffness"] = divided(to_columns, to_rows, *across) if need["stiffness"] else None
        if need["mass"]:
            times = z.eigenvalue[..., None, :]
            level = to_columns * times, to_rows * times
            grads["mass"] = -divided(*level, to_columns + across[0] * times, to_rows + across[1] * times)
    strain, inertia, motion = (torch.cat(parts, dim=-1) for parts in zip(*of_lines, strict=True))
    s = z.laplace
    grads["stiffness_loss_factor"], grads["stiffness_coefficient"] = strain.imag.sum(-1), -(s * strain).real.sum(-1)
    grads["mass_loss_factor"], grads["mass_coefficient"] = inertia.imag.sum(-1), -(s * inertia).real.sum(-1)
    grads["dispersion"] = -conjugate(strain)
    grads["force"] = -conjugate(motion)
    if need["laplace"]:
        rate = z.stiffness_coefficient[..., None] * strain + (z.mass_coefficient[..., None] + 2 * s) * inertia
        grads["laplace"] = -conjugate(rate)
    return tuple(
        found.sum_to_size(given.shape) if wanted and found is not None and given is not None else None
        for found, given, wanted in zip(grads.values(), (left, right, *z), needed, strict=True)
    )


class _Sums(NamedTuple):
    """What a block of lines adds up to, for each pair of rows and each mode."""

    level: Tensor  # Re S [*batch, n_row, n_column, n]
    slope: Tensor  # Re dS/dλ
    nearest: Tensor  # distance of each λ to the nearest z [*batch, n]

    def plus(self, other: "_Sums") -> "_Sums":
        return _Sums(self.level + other.level, self.slope + other.slope, torch.minimum(self.nearest, other.nearest))


def _block(
    z: Impedance, rows: Tensor, columns: Tensor, weight: Tensor, need: dict[str, bool]
) -> tuple[_Sums, tuple[Tensor, Tensor, Tensor]]:
    """The sums of a block of lines; and at each line Σ w̄ yᵀAx, Σ w̄ yᵀx, and Σ w̄ (u·y)(u·x) of each dashpot."""
    shape = rows.shape[-2], columns.shape[-2]
    kappa, mu = z.proportional.at(z.laplace)
    flexibility = 1 / kappa
    pole = -mu * flexibility
    sizes = (part.shape[:-1] for part in (z.eigenvalue, pole, z.force[..., 0], rows[..., 0, :], columns[..., 0, :]))
    pole = pole.expand(*common_shape(*sizes, weight.shape[2:-1]), pole.shape[-1])
    # Features are [*batch, feature, line] here: of near modes, and of a series for all others, as in the modal sum.
    stretch = Stretch.around(Disc.around(pole, z.eigenvalue), z.eigenvalue)
    n_near, feature = stretch.last - stretch.first, stretch.features(z.eigenvalue, pole)
    counted = stretch.weights(pairs_of(rows, columns))
    alone = times_complex(counted, feature).movedim(-2, 0).unflatten(0, shape)
    force = lines_last(z.force, pole.ndim - 1) * flexibility
    value, motion = weights(alone, force.expand(len(force), *alone.shape[2:]), weight)
    value = value * flexibility
    flat = value.flatten(0, 1).movedim(0, -2)

    def gathered(feature: Tensor) -> Tensor:
        """Re Σ v f over the lines [*batch, pair, feature]."""
        return as_real(flat) @ as_real(conjugate(feature)).mT

    def of_modes(near: Tensor, slow: Tensor, series: Tensor) -> Tensor:
        far = slow @ series.mT
        whole = torch.cat([far[..., : stretch.first], near, far[..., stretch.last :]], dim=-1)
        return whole.unflatten(-2, shape)

    once = gathered(feature)
    near, slow = once[..., :n_near], once[..., n_near:]
    level = slope = near.unflatten(-2, shape) if stretch.series is None else of_modes(near, slow, stretch.series)
    if need["stiffness"] or need["mass"]:
        near = -gathered(feature[..., :n_near, :].square())
        slope = near.unflatten(-2, shape)
        if stretch.series is not None:
            slope = of_modes(near, slow, stretch.slopes(z.eigenvalue))
    inertia, strain = torch.zeros_like(pole), torch.zeros_like(pole)
    if any(need[name] for name in (*Impedance._fields[4:8], "laplace", "dispersion")):
        inertia = stretch.slope(feature, times_complex(stretch.sloped(counted).mT, flat), pole) * flexibility
        strain = (value * alone).sum((0, 1)) * flexibility + pole * inertia
    motion = (-motion * flexibility.square()).movedim(0, -2)
    return _Sums(level, slope, _nearest(z.eigenvalue, pole, stretch)), (strain, inertia, motion)


def _nearest(eigenvalue: Tensor, pole: Tensor, stretch: Stretch) -> Tensor:
    """The distance of each mode to the nearest z [*batch, n]; of far ones, at least so much."""
    apart = torch.complex(stretch.near(eigenvalue)[..., None] - pole.real[..., None, :], pole.imag[..., None, :])
    near = apart.abs().amin(-1)
    if stretch.disc is None or stretch.series is None:
        return near
    far = ((eigenvalue - stretch.disc.centre).abs() - stretch.disc.half).expand(*near.shape[:-1], -1)
    return torch.cat([far[..., : stretch.first], near, far[..., stretch.last :]], dim=-1)


class _Divided(NamedTuple):
    """Divided differences of what is known of S at every mode, summed over all pairs of rows."""

    eigenvalue: Tensor
    nearest: Tensor
    rows: Tensor
    columns: Tensor

    def __call__(self, first: Tensor, second: Tensor, of_first: Tensor, of_second: Tensor) -> Tensor:
        """Gradient [*batch, n, n].

        Args:
            first: Σ_a e_a S_ab for each column b, at each mode.
            second: Σ_b S_ab e_b for each row a.
            of_first: the same of S'.
            of_second: likewise.
        """
        difference = self.eigenvalue[..., :, None] - self.eigenvalue[..., None, :]
        close = difference.abs() < CLOSE * torch.minimum(self.nearest[..., :, None], self.nearest[..., None, :])
        apart = (first.mT @ self.columns - self.rows.mT @ second) / torch.where(close, 1.0, difference)
        together = 0.5 * (of_first.mT @ self.columns + self.rows.mT @ of_second)
        return torch.where(close, together, apart)
