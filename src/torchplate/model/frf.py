"""Frequency response functions: the modal sum with a low-rank correction, and the direct solve that referees it.

With mass-normalised modes of (K, M) and damping in proportion to both, Z(s) is diagonal in modal coordinates,

    d_r(s) = ω_r² (1 + iβ + sb) + iη + sa + s²,

so α_jk = Σ_r φ_jr φ_kr / d_r (seed paper, Eq. 19–20; Ewins, Modal Testing, section 2.4). Dashpots at places make it
d + s Uᵀ C U; they are attached one after the other, exactly: see `modal_sum`. s = iω on the frequency axis; s = iω + σ
for a record windowed by exp(−σt).
"""

from collections.abc import Callable, Iterator, Sequence

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.effects import SensorChain
from torchplate.model.attach import attach, lines_last
from torchplate.model.modal_sum import LINES_AT_ONCE, modal_sum
from torchplate.plate import Proportional, System, is_vmapped

KINDS = ("receptance", "mobility", "accelerance", "transmissibility")
DERIVATIVE = {"receptance": 0, "mobility": 1, "accelerance": 2}
# Impedances solved at once, so that they stay in the cache [bytes].
IN_CACHE = 4 * 2**20
# What stands for 0 Hz: its square is below rounding beside any elastic mode's.
LOWEST = 1e-9
# Dofs up to which batches of complex matrices are seen to be right with any number of threads.
SOLVED_TOGETHER = 100
# Responses with a mass that go together: of the receptances among them the driving points alone are wanted.
RESPONSES_AT_ONCE = 8


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
    eigenvalue: Float[Tensor, "*#batch n_mode"],
    proportional: Proportional,
    laplace: Complex[Tensor, "*#batch n_frequency"],
    left: Float[Tensor, "*#batch n_left n_mode"],
    right: Float[Tensor, "*#batch n_right n_mode"],
) -> Complex[Tensor, "*batch n_frequency n_left n_right"]:
    """Σ_r left_r right_r / d_r(s) [m/N]: one real matrix product for all lines and pairs."""
    real, imaginary = modal_denominator(eigenvalue, proportional, laplace)
    scale = 1 / (real**2 + imaginary**2)
    inverse = torch.stack([real * scale, -imaginary * scale], dim=-3)
    pairs = (left[..., :, None, :] * right[..., None, :, :]).flatten(-3, -2)
    total = inverse @ pairs[..., None, :, :].mT
    total = total.unflatten(-1, (left.shape[-2], right.shape[-2]))
    return torch.complex(total[..., 0, :, :, :], total[..., 1, :, :, :])


def receptance(
    eigenvalue: Float[Tensor, "*#batch n_mode"],
    proportional: Proportional,
    laplace: Complex[Tensor, "*#batch n_frequency"],
    response: Float[Tensor, "*#batch n_response n_mode"],
    reference: Float[Tensor, "*#batch n_reference n_mode"],
    dashpot: Float[Tensor, "*#batch n_dashpot n_mode"],
    force: Complex[Tensor, "*#batch n_dashpot n_frequency"],
    hysteretic: Float[Tensor, "*#batch n_mode n_mode"] | None = None,
) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
    """Receptance α [m/N] from modes, exact in all damping terms.

    Args:
        eigenvalue: ω_r² [rad²/s²].
        proportional: damping in proportion to K and M.
        laplace: s [1/s].
        response: modal deflections at the responses [1/√kg].
        reference: modal deflections at the references [1/√kg].
        dashpot: modal deflections at the dashpots and sprung masses [1/√kg].
        force: their dynamic stiffness at every line [N/m].
        hysteretic: ΦᵀHΦ of elements with a loss of their own; where it couples the modes, complex modes are solved
            for, or each line.
    """
    if hysteretic is not None:
        return _solve_modal(eigenvalue, proportional, laplace, response, reference, dashpot, force, hysteretic)
    left, right = stack_rows(dashpot, response), stack_rows(dashpot, reference)
    parts = []
    for s, tied in _stretches(laplace, force):
        kappa, mu = proportional.at(s)
        flexibility, sizes = 1 / kappa, (eigenvalue.shape[:-1], left.shape[:-2], right.shape[:-2], tied.shape[:-2])
        shape = torch.broadcast_shapes(*sizes, kappa.shape[:-1], mu.shape[:-1])
        found = modal_sum(eigenvalue, left, right, (-mu * flexibility).expand(*shape, s.shape[-1]))
        parts.append(attach(found, lines_last(tied, len(shape)) * flexibility) * flexibility)
    return joined(parts, -1).movedim((0, 1), (-2, -1))


def direct_receptance(
    system: System,
    laplace: Complex[Tensor, "*#batch n_frequency"],
    response: Float[Tensor, "*#batch n_response n"],
    reference: Float[Tensor, "*#batch n_reference n"],
) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
    """Receptance [m/N] by solving Z(s) at every line, with no mode at all: slow, and the referee of `receptance`."""
    columns, (kappa, mu) = [], system.proportional.at(laplace)
    force, attached = system.force(laplace), system.attached.to(laplace)
    for index in range(laplace.shape[-1]):
        k, m = (part[..., min(index, part.shape[-1] - 1), None, None] for part in (kappa, mu))
        impedance = system.stiffness * k + system.mass * m
        impedance = impedance + attached.mT @ (force[..., index, None] * attached)
        if system.hysteretic is not None:
            impedance = impedance + 1j * system.hysteretic
        columns.append(response.to(impedance) @ solve_each(impedance, reference.mT.to(impedance)))
    return torch.stack(columns, dim=-3)


def solve_each(
    matrix: Complex[Tensor, "*batch n n"], right: Complex[Tensor, "*#batch n n_right"]
) -> Complex[Tensor, "*batch n n_right"]:
    """matrix⁻¹ right for a batch; large matrices one at a time.

    A batch of them comes out wrong, or never, where several threads of oneMKL share it (torch 2.13: ZLASWP is given
    pivots of another matrix).
    """
    # Under vmap torch broadcasts the batches of the two wrongly.
    right = right.expand(*matrix.shape[:-2], *right.shape[-2:])
    if matrix.shape[-1] <= SOLVED_TOGETHER or matrix.ndim == 2:
        return torch.linalg.solve(matrix, right)
    pairs = zip(matrix.flatten(0, -3), right.flatten(0, -3), strict=True)
    return torch.stack([torch.linalg.solve(*pair) for pair in pairs]).unflatten(0, matrix.shape[:-2])


def laplace_lines(
    frequency: Float[Tensor, " n_frequency"], decay: float | Float[Tensor, " n_frequency"]
) -> Complex[Tensor, " n_frequency"]:
    """S = iω + σ [1/s] at frequencies in Hz.

    At 0 Hz a free plate has no receptance: what stands there is close to the limit, the accelerance of a rigid body.
    """
    if isinstance(decay, Tensor):
        return torch.complex(decay.to(frequency), 2 * torch.pi * frequency)
    shown = frequency.clamp(min=LOWEST) if decay == 0 else frequency
    return torch.complex(torch.full_like(frequency, decay), 2 * torch.pi * shown)


def sensor_chain(
    laplace: Complex[Tensor, " n_frequency"],
    response: Float[Tensor, "n_response 2"],
    reference: Float[Tensor, "n_reference 2"] | None,
) -> SensorChain:
    """A chain that reports what is there: sensors at their labels, readings that are the FRFs."""
    n_reference = 1 if reference is None else len(reference)
    one = torch.ones_like(laplace)[:, None, None].expand(-1, len(response), n_reference)
    return SensorChain(laplace, response, one, response, reference)


def as_kind(
    value: Complex[Tensor, "*#batch n_frequency n_response n_reference"], chain: SensorChain, kind: str
) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
    """From receptance to the kind asked for, as the sensor chain reports it."""
    s = chain.laplace[..., None, None]
    if chain.reading is not None:
        value = value.flatten(-2)[..., chain.reading]
    if kind == "transmissibility":
        return chain.factor * (1 - s**2 * value)
    # The value first: where its lines lie side by side in memory, they still do afterwards.
    return value * (chain.factor * s ** DERIVATIVE[kind]).to(value.dtype)


def with_sensor_mass(
    solve: Callable[[Tensor, Tensor, Tensor], Tensor],
    chain: SensorChain,
    left: Float[Tensor, "*#batch n_response n"],
    right: Float[Tensor, "*#batch n_reference n"],
    with_base: bool,
) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
    """Receptances of a plate that carries the sensor's mass m at the response of each record, and nowhere else.

    Exact from those without it (Sherman and Morrison, 1950): H'_rj = H_rj / (1 + s² m H_rr).

    Args:
        solve: from s, response rows and reference rows to receptances without the mass.
        chain: with the masses.
        left: response rows.
        right: reference rows.
        with_base: whether the base moves instead of a force: its motion then loads the mass, too.
    """
    assert chain.mass is not None
    square = (chain.laplace**2)[..., None, None]
    parts = []
    for rows, mass in zip(
        left.split(RESPONSES_AT_ONCE, dim=-2), chain.mass.split(RESPONSES_AT_ONCE, dim=-1), strict=True
    ):
        n_response, n_reference = rows.shape[-2], right.shape[-2]
        both = solve(chain.laplace, rows, stack_rows(right, rows))
        found, among = both.split([n_reference, n_response], dim=-1)
        driving = among.diagonal(dim1=-2, dim2=-1)[..., None]
        inertia = mass[..., None, :, None]
        pushed = found + inertia * driving if with_base else found
        parts.append((pushed / (1 + square * inertia * driving)).to(found.dtype))
    return joined(parts, -2)


def lines_at_once(memory: int, n_member: int, left: Tensor, right: Tensor, system: System) -> int:
    """Lines that fit the memory [bytes]."""
    n_dashpot, n_mode = system.attached.shape[-2:]
    pairs = (left.shape[-2] + n_dashpot) * (right.shape[-2] + n_dashpot)
    numbers = 6 * n_mode + 6 * pairs
    if system.hysteretic is not None and not _has_complex_modes(system.proportional):
        numbers += 6 * n_mode**2
    if torch.is_grad_enabled():
        numbers += 20 * min(left.shape[-2], right.shape[-2]) * n_mode
    return max(1, memory // (n_member * left.element_size() * numbers))


def joined(parts: Sequence[Tensor], dim: int) -> Tensor:
    """Chunks put together; a single one is not copied."""
    return parts[0] if len(parts) == 1 else torch.cat(list(parts), dim=dim)


def stack_rows(
    first: Float[Tensor, "*#batch n_first n"], second: Float[Tensor, "*#batch n_second n"]
) -> Float[Tensor, "*batch n_both n"]:
    """Rows under rows, whatever batch each has."""
    batch = torch.broadcast_shapes(first.shape[:-2], second.shape[:-2])
    return torch.cat([rows.expand(*batch, *rows.shape[-2:]) for rows in (first, second)], dim=-2)


def _solve_modal(
    eigenvalue: Tensor,
    proportional: Proportional,
    laplace: Tensor,
    response: Tensor,
    reference: Tensor,
    dashpot: Tensor,
    force: Tensor,
    hysteretic: Tensor,
) -> Tensor:
    """α where parts have a loss of their own: mode by mode, by complex modes, or by solves, as far as these couple."""
    if _is_diagonal(hysteretic):
        own_loss = hysteretic.diagonal(dim1=-2, dim2=-1)
        return _by_uncoupled_modes(eigenvalue, proportional, laplace, response, reference, dashpot, force, own_loss)
    if _has_complex_modes(proportional, eigenvalue, hysteretic):
        return _by_complex_modes(eigenvalue, proportional, laplace, response, reference, dashpot, force, hysteretic)
    tied = dashpot[..., None, :, :].to(laplace)
    hysteretic, columns = 1j * hysteretic[..., None, :, :], reference.mT[..., None, :, :].to(laplace)
    sizes = (eigenvalue.shape[:-1], hysteretic.shape[:-3], dashpot.shape[:-2], force.shape[:-2])
    n_member = torch.broadcast_shapes(*sizes).numel()
    at_once = max(1, IN_CACHE // (16 * n_member * eigenvalue.shape[-1] ** 2))
    parts = []
    for s, own in zip(laplace.split(at_once, dim=-1), force.split(at_once, dim=-1), strict=True):
        diagonal = torch.complex(*modal_denominator(eigenvalue, proportional, s))
        coupling = tied.mT @ (own.mT[..., None] * tied)
        impedance = torch.diag_embed(diagonal) + (hysteretic + coupling)
        parts.append(response[..., None, :, :].to(impedance) @ solve_each(impedance, columns))
    return joined(parts, -3)


def _is_diagonal(hysteretic: Tensor) -> bool:
    """Whether it couples no modes; under `vmap` nobody may look."""
    if is_vmapped(hysteretic):
        return False
    return not bool((hysteretic - torch.diag_embed(hysteretic.diagonal(dim1=-2, dim2=-1))).any())


def _has_complex_modes(proportional: Proportional, *matrices: Tensor) -> bool:
    """Whether the same complex modes serve all lines: K is times one number at all of them."""
    varying = proportional.stiffness_coefficient, proportional.loss_exponent
    if torch.is_grad_enabled() or is_vmapped(*varying, *matrices):
        return False
    return not any(bool(torch.as_tensor(part).any()) for part in varying)


def _by_uncoupled_modes(
    eigenvalue: Tensor,
    proportional: Proportional,
    laplace: Tensor,
    response: Tensor,
    reference: Tensor,
    dashpot: Tensor,
    force: Tensor,
    own_loss: Tensor,
) -> Tensor:
    """Z(s) without the dashpots is diagonal: d_r(s) + i h_r, h what each mode loses by itself."""
    left, right = stack_rows(dashpot, response), stack_rows(dashpot, reference)
    pairs = (left[..., :, None, :] * right[..., None, :, :]).flatten(-3, -2)
    parts = []
    for s, tied in _stretches(laplace, force):
        real, imaginary = modal_denominator(eigenvalue, proportional, s)
        imaginary = imaginary + own_loss[..., None, :]
        scale = 1 / torch.addcmul(imaginary * imaginary, real, real)
        found = torch.complex(pairs @ (real * scale).mT, -(pairs @ (imaginary * scale).mT))
        parts.append(_with_dashpots(found, left, right, tied))
    return joined(parts, -1).movedim((0, 1), (-2, -1))


def _by_complex_modes(
    eigenvalue: Tensor,
    proportional: Proportional,
    laplace: Tensor,
    response: Tensor,
    reference: Tensor,
    dashpot: Tensor,
    force: Tensor,
    hysteretic: Tensor,
) -> Tensor:
    """Z(s) = Λ (1 + iβ) + iH + μ(s), without the dashpots, has the complex modes of Λ (1 + iβ) + iH at every s."""
    beta = proportional.stiffness_loss_factor
    beta = beta[..., None] if isinstance(beta, Tensor) else beta
    stiffness = torch.diag_embed(eigenvalue * (1 + 1j * beta)) + 1j * hysteretic
    value, shape = torch.linalg.eig(stiffness)
    left, right = stack_rows(dashpot, response), stack_rows(dashpot, reference)
    rows = left.to(shape) @ shape
    columns = torch.linalg.solve(shape, right.mT.to(shape)).mT
    pairs = (rows[..., :, None, :] * columns[..., None, :, :]).flatten(-3, -2)
    mu = proportional.at(laplace)[1]
    found = pairs @ (1 / (value[..., :, None] + mu[..., None, :]))
    return _with_dashpots(found, left, right, force).movedim((0, 1), (-2, -1))


def _stretches(laplace: Tensor, force: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """Lines that stay in the cache together, and what is attached there."""
    at_once = LINES_AT_ONCE if laplace.device.type == "cpu" else laplace.shape[-1]
    return zip(laplace.split(at_once, dim=-1), force.split(at_once, dim=-1), strict=True)


def _with_dashpots(found: Tensor, left: Tensor, right: Tensor, force: Tensor) -> Tensor:
    """Receptances of all pairs of rows, [*batch, pair, line], with the dashpots among the rows attached."""
    found = found.unflatten(-2, (left.shape[-2], right.shape[-2])).movedim((-3, -2), (0, 1))
    force = lines_last(force, found.ndim - 3)
    return attach(found, force.expand(len(force), *found.shape[2:]))
