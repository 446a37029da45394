"""A sensor chain that is wrong multiplies: by one gain and delay for all channels, or by a factor for one of them."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.localisation.misfit import Misfit
from torchplate.diagnosis.settings import SETTINGS
from torchplate.measurement import Measurement

# Delays that are tried at once, each turn around the best of the last: numerics of a line search.
N_DELAY = 1001


class Factor(NamedTuple):
    """A factor on channels.

    Attributes:
        part: of the misfit that it explains.
        gain: real.
        delay: [s].
        channel: which; empty for all.
        alone: what the gain alone and the delay alone explain.
    """

    part: float
    gain: float
    delay: float = 0.0
    channel: str = ""
    alone: tuple[float, float] = (0.0, 0.0)


def common_factor(misfit: Misfit, frequency: Float[Tensor, " n_frequency"]) -> Factor:
    """The gain and delay, measured = gain exp(−iωτ) predicted, that explain most, over all channels."""
    omega = 2 * torch.pi * frequency
    cross = (misfit.predicted.conj() * misfit.measured).sum((-2, -1))
    power = max(float(misfit.predicted.abs().square().sum()), 1e-300)
    whole = float(misfit.measured.abs().square().sum())

    def matched(delay: Tensor) -> Tensor:
        """Σ Re(cross exp(iωτ)), by τ."""
        angle = omega * delay[:, None]
        return angle.cos() @ cross.real - angle.sin() @ cross.imag

    delay, span = omega.new_zeros(()), SETTINGS.localising.longest_delay
    for _ in range(5):
        tried = delay + torch.linspace(-span, span, N_DELAY, dtype=omega.dtype, device=omega.device)
        # A sign of all channels is a gain of −1.
        delay = tried[matched(tried).abs().argmax()]
        span *= 4 / N_DELAY
    at = float(matched(delay[None]))
    still = float(cross.real.sum())
    gain_alone = misfit.part(whole - still**2 / power)
    delay_alone = misfit.part(whole - 2 * at + power)
    part = misfit.part(whole - at**2 / power)
    if gain_alone >= part - SETTINGS.localising.near:
        return Factor(gain_alone, still / power, alone=(gain_alone, delay_alone))
    return Factor(part, at / power, float(delay), alone=(gain_alone, delay_alone))


def own_factor(misfit: Misfit, measurement: Measurement) -> Factor:
    """The real factor on one FRF, one response or one reference that explains most; on none where all are one."""
    cross = (misfit.predicted.conj() * misfit.measured).real.sum(0)
    power = misfit.predicted.abs().square().sum(0)
    before = misfit.residual.abs().square().sum(0)
    whole = misfit.measured.abs().square().sum(0)
    sides = [
        (lambda value: value.flatten(), [measurement.pair_label(j, k) for j, k in _all_pairs(measurement)]),
        (lambda value: value.sum(1), [f"all of response {one.label}" for one in measurement.response]),
        (lambda value: value.sum(0), [f"all of reference {one.label}" for one in measurement.reference]),
    ]
    best = Factor(0.0, 1.0)
    for gather, labels in sides:
        if len(labels) < 2:
            continue
        own_cross, own_power = gather(cross), gather(power).clamp(min=1e-300)
        fall = gather(before) - (gather(whole) - own_cross.square() / own_power)
        index = int(fall.argmax())
        part = misfit.part(misfit.total - float(fall[index]))
        # A single FRF comes first: a row of one FRF is that FRF.
        if part > best.part + 1e-9:
            best = Factor(part, float(own_cross[index] / own_power[index]), channel=labels[index])
    return best


def _all_pairs(measurement: Measurement) -> list[tuple[int, int]]:
    return [(j, k) for j in range(len(measurement.response)) for k in range(len(measurement.reference))]
