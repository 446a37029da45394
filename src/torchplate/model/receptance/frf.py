"""Frequency response functions as a sensor chain reports them; and the direct solve that referees the modal sum."""

from collections.abc import Callable

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.effects import SensorChain
from torchplate.model.receptance.batched import joined, solve_each, stack_rows
from torchplate.model.receptance.modal_receptance import has_complex_modes
from torchplate.plate import System

KINDS = ("receptance", "mobility", "accelerance", "transmissibility")
DERIVATIVE = {"receptance": 0, "mobility": 1, "accelerance": 2}
# What stands for 0 Hz: its square is below rounding beside any elastic mode's.
LOWEST = 1e-9
# Responses with a mass that go together: of the receptances among them the driving points alone are wanted.
RESPONSES_AT_ONCE = 8


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
    if system.hysteretic is not None and not has_complex_modes(system.proportional):
        numbers += 6 * n_mode**2
    if torch.is_grad_enabled():
        numbers += 20 * min(left.shape[-2], right.shape[-2]) * n_mode
    return max(1, memory // (n_member * left.element_size() * numbers))
