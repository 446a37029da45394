"""Noise of several shapes on the same FRFs: ‖noise‖ / ‖H‖ of each is what is asked for, whatever the shape.

| shape | standard deviation at a line |
|---|---|
| proportional | in proportion to \\|H\\| |
| constant | the same acceleration per force on all lines |
| two_component | both, equal in power |
| few_averages | H1 of 3 to 6 hits whose strength differs, a constant level on the response; with its coherence |
| heavy_tails | one of the first two, of Student's t with 4 degrees of freedom |
"""

import numpy as np

from blind.plates import Rng
from blind.response import DERIVATIVE, Test

SHAPES = ("proportional", "constant", "two_component", "few_averages", "heavy_tails")
N_AVERAGE = (3, 4, 5, 6)
DEGREES = 4
# Strength of a hit, log-normal; the spectrum of the force has fallen to this at the end of the band.
FORCE_SCATTER, FORCE_END = 0.3, 0.5


def levels(frf: np.ndarray, test: Test, shape: str) -> np.ndarray:
    """Standard deviation over that of the whole, of norm ‖H‖ in each FRF."""
    # A sensor's floor is one of acceleration, whatever the FRF is made into.
    omega = (2 * np.pi * test.frequency) ** (2 - DERIVATIVE[test.kind])
    floor = np.ones_like(np.abs(frf)) / omega[:, None, None]
    power = np.linalg.norm(frf, axis=0)
    own, flat = np.abs(frf) / power, floor / np.linalg.norm(floor, axis=0)
    part = {"proportional": 1.0, "constant": 0.0, "two_component": 0.5, "few_averages": 0.0}[shape]
    return power * np.sqrt(part * own**2 + (1 - part) * flat**2)


def spoil(
    rng: Rng, frf: np.ndarray, test: Test, noise: float, shape: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, int | None]:
    """FRFs as measured, their standard deviation, coherence and number of averages where these are reported."""

    def white(*size: int) -> np.ndarray:
        return (rng.standard_normal(size) + 1j * rng.standard_normal(size)) / np.sqrt(2)

    if shape == "heavy_tails":
        sigma = noise * levels(frf, test, str(rng.choice(["proportional", "constant"])))
        tail = np.sqrt(rng.chisquare(DEGREES, frf.shape) / (DEGREES - 2))
        return frf + sigma * white(*frf.shape) / tail, sigma, None, None
    if shape != "few_averages":
        sigma = noise * levels(frf, test, shape)
        return frf + sigma * white(*frf.shape), sigma, None, None
    n = int(rng.choice(N_AVERAGE))
    pulse = FORCE_END ** ((test.frequency / test.frequency[-1]) ** 2)
    strength = np.exp(FORCE_SCATTER * rng.standard_normal((n, frf.shape[2])))
    force = strength[:, None, None, :] * pulse[None, :, None, None]
    total = (force**2).sum(0)
    # Of H1 = Σ F X / Σ F² with a level on X: level / √ΣF²; scaled to the norm that is asked for.
    level = levels(frf, test, "constant")
    level = level * noise * np.linalg.norm(frf, axis=0) / np.linalg.norm(level / np.sqrt(total), axis=0)
    response = frf * force + level * white(n, *frf.shape)
    cross = (force * response).sum(0)
    coherence = np.abs(cross) ** 2 / (total * (np.abs(response) ** 2).sum(0))
    return cross / total, level / np.sqrt(total), coherence, n
