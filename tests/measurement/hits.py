"""Time records of hits on a structure with two known modes, for the tests of everything that reads them."""

import numpy as np
from scipy.signal import fftconvolve

RATE = 2048.0
MODES = ((61.0, 0.02), (143.0, 0.015))  # Hz, damping ratio
SHAPES = {7: (0.9, -0.4), 2: (-0.5, 0.8), 12: (0.7, 0.6)}  # node → mass-normalised deflection


def impulse_response(response: int, reference: int, n: int) -> np.ndarray:
    """Acceleration after a unit impulse, the impulse itself left out."""
    time = np.arange(n) / RATE
    total = np.zeros(n)
    for (f, z), a, b in zip(MODES, SHAPES[response], SHAPES[reference], strict=True):
        pole = 2 * np.pi * f * complex(-z, np.sqrt(1 - z**2))
        total += a * b * (pole**2 * np.exp(pole * time)).imag / pole.imag
    total[0] += sum(a * b for a, b in zip(SHAPES[response], SHAPES[reference], strict=True)) * RATE
    return total


def hit(
    reference: int,
    responses: tuple[int, ...] = (7, 2),
    n: int = 4096,
    start: int = 60,
    peak: float = 40.0,
    bounce: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
) -> np.ndarray:
    """One hit: force, then the responses, [channel, sample]."""
    pulse = peak * np.sin(np.pi * np.arange(1, 6) / 6)
    force = np.zeros(n)
    force[start : start + 5] = pulse
    force[start + 80 : start + 85] += bounce * pulse
    rows = [fftconvolve(force, impulse_response(node, reference, n) / RATE)[:n] for node in responses]
    channels = np.stack([force, *rows])
    random = np.random.default_rng(seed)
    scale = np.abs(channels).max(axis=1, keepdims=True)
    return channels + noise * scale * random.standard_normal(channels.shape)
