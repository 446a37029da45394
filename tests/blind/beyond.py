"""What no effect of the catalogue describes: the answer is that something is missing and nothing listed explains it.

Residual stress, curvature and a hinge change the Ritz plate; the other three change how it responds.

| kind | size |
|---|---|
| residual_stress | amplitude of the Airy function ±0.05 to 0.2 D |
| curvature | 0.08 to 0.25 1/m along x, log, and a part of it along y |
| hinge | across x at 0.25 to 0.75, 2 to 15 D/L, log |
| cubic_spring | k₃ 1e8 to 1e11 N/m³, log, at a force of 1 N |
| frequency_dependent_modulus | ±2 to 10 % a decade |
| clipped_channel | one response at 0.15 to 0.5 of its largest sample |
"""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from blind.effects import Truth
from blind.plates import Rng, log_uniform
from blind.response import Chain, Damping, Test, observe, receptance, recorded, sat
from blind.ritz import RitzPlate, modes

KINDS = ("residual_stress", "curvature", "hinge", "cubic_spring", "frequency_dependent_modulus", "clipped_channel")
# Of these only the Ritz truth knows.
RITZ_ALONE = ("residual_stress", "curvature", "hinge")


def known_by(by: str, names: Iterable[str]) -> str:
    """Which truth makes a case: the one wanted, where it knows what is hidden."""
    return "ritz" if set(names) & set(RITZ_ALONE) else by


def cubic_spring(
    plate: RitzPlate, damping: Damping, chain: Chain, test: Test, place: tuple[float, float], cubic: float, force: float
) -> np.ndarray:
    """FRFs at a force amplitude [N] with a spring f = k₃ w³ [N/m³] to the ground at a place.

    Describing function: k = ¾ k₃ |X|², so |X|² |1 + α_pp ¾ k₃ |X|²|² = |α_pf F|², a cubic in |X|²; where it has three
    roots the smallest is taken, as on a sweep upwards past a softening and downwards past a hardening peak.
    Source: Worden and Tomlinson, Nonlinearity in Structural Dynamics (2001), chapter 2.
    """
    s = test.laplace(chain.rate)
    alpha = receptance(modes(plate), plate, damping, s, [place, *sat(plate, chain, test)], [place, *test.reference])
    own, to, away, rest = alpha[:, 0, 0], alpha[:, 0, 1:], alpha[:, 1:, 0], alpha[:, 1:, 1:]
    factor = 0.75 * cubic
    drive = np.abs(to * force) ** 2
    # u = |X|²: factor² |α|² u³ + 2 factor Re α u² + u - drive = 0, by the companion matrix, in units of the drive.
    third = (factor * np.abs(own))[:, None] ** 2 * drive**2
    second = 2 * factor * own.real[:, None] * drive
    companion = np.zeros((*drive.shape, 3, 3))
    companion[..., 1, 0] = companion[..., 2, 1] = 1.0
    tiny = third < 1e-18
    third = np.where(tiny, 1.0, third)
    companion[..., 0, 2], companion[..., 1, 2], companion[..., 2, 2] = 1 / third, -1 / third, -second / third
    root = np.linalg.eigvals(companion)
    real = np.where((np.abs(root.imag) < 1e-6 * np.abs(root)) & (root.real > 0), root.real, np.inf).min(-1)
    spring = factor * drive * np.where(tiny | ~np.isfinite(real), 1.0, real)
    change = spring / (1 + own[:, None] * spring) * to
    return observe(rest - away[:, :, None] * change[:, None, :], chain, test)


def frequency_dependent_modulus(
    plate: RitzPlate, damping: Damping, chain: Chain, test: Test, slope: float, middle: float
) -> np.ndarray:
    """FRFs of a plate of modulus E (1 + slope log10(f/middle)); the springs keep their stiffness.

    Source: Jones, Handbook of Viscoelastic Vibration Damping (2001): a modulus grows by so much a decade.
    """
    s = test.laplace(chain.rate)
    modulus = 1 + slope * np.log10(test.frequency / middle)
    ends = sat(plate, chain, test)
    return observe(receptance(modes(plate), plate, damping, s, ends, test.reference, modulus), chain, test)


def clipped_channel(
    plate: RitzPlate, damping: Damping, chain: Chain, test: Test, response: int, level: float
) -> np.ndarray:
    """FRFs whose one response was clipped at `level` of its largest sample, under periodic impacts.

    The force is a pulse that has fallen to a tenth at the band's end, repeated every record; record = 1 / line spacing.
    """
    step = float(np.diff(test.frequency[:2])[0])
    top = 1.5 * test.frequency[-1]
    full = Test(test.response, test.reference, np.arange(step, top, step), test.kind)
    s = full.laplace(chain.rate)
    read = observe(receptance(modes(plate), plate, damping, s, sat(plate, chain, full), full.reference), chain, full)
    force = np.exp(-np.log(10) * (full.frequency / test.frequency[-1]) ** 2)[:, None]
    spectrum = np.zeros((len(full.frequency) + 2, len(full.reference)), complex)
    spectrum[1:-1] = read[:, response] * force
    record = np.fft.irfft(spectrum, axis=0)
    limit = level * np.abs(record).max(axis=0)
    clipped = np.fft.rfft(record.clip(-limit, limit), axis=0)[1:-1] / force
    read = read.copy()
    read[:, response] = clipped
    kept = np.round(test.frequency / step).astype(int) - 1
    return read[kept]


def draw(rng: Rng, name: str, truth: Truth) -> tuple[np.ndarray, dict[str, float]]:
    """FRFs of a plate with one of these in it, and its size."""
    plate = truth.plate
    rigidity = plate.young * plate.thickness**3 / (12 * (1 - plate.poisson**2))
    sign = float(rng.choice([-1.0, 1.0]))

    def read(make: Callable[..., np.ndarray], *numbers: object) -> np.ndarray:
        return recorded(lambda chain, test: make(plate, truth.damping, chain, test, *numbers), truth.chain, truth.test)

    if name == "residual_stress":
        stress = sign * rigidity * float(rng.uniform(0.05, 0.2))
        return replace(truth, plate=replace(plate, stress=stress)).frf(), {"airy_amplitude": stress}
    if name == "curvature":
        along_x, part = log_uniform(rng, 0.08, 0.25), float(rng.uniform(-0.5, 0.5))
        curved = replace(plate, curvature=(along_x, part * along_x))
        return replace(truth, plate=curved).frf(), {"along_x": along_x, "along_y": part * along_x}
    if name == "hinge":
        place, rotational = float(rng.uniform(0.25, 0.75)), rigidity / plate.length_x * log_uniform(rng, 2.0, 15.0)
        hinged = replace(plate, hinge=(place, rotational))
        return replace(truth, plate=hinged).frf(), {"x": place, "rotational_stiffness": rotational}
    if name == "cubic_spring":
        cubic, x, y = log_uniform(rng, 1e8, 1e11), float(rng.uniform(0.1, 0.9)), float(rng.uniform(0.1, 0.9))
        return read(cubic_spring, (x, y), cubic, 1.0), {"cubic": cubic, "x": x, "y": y}
    if name == "frequency_dependent_modulus":
        slope = sign * float(rng.uniform(0.02, 0.10))
        return read(frequency_dependent_modulus, slope, 100.0), {"slope": slope}
    if name == "clipped_channel":
        index, level = int(rng.integers(len(truth.test.response))), float(rng.uniform(0.15, 0.5))
        return read(clipped_channel, index, level), {"response": index, "level": level}
    raise KeyError(name)
