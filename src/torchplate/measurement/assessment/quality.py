"""What can be said of a measurement alone, before any model is asked.

Source: Ewins, Modal Testing (2000), checks of measured FRFs: driving-point properties, reciprocity, coherence.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.measurement.measurement import Channel, Measurement
from torchplate.notation import percent

SAME_PLACE: Final = 1e-4
"""Two coordinates closer than this [m] are one place: a tenth of a millimetre, less than a hammer tip."""
# Energy of impulse responses before time zero over that after it. Noise in a single FRF of 32 lines comes to ten times
# with a probability of 1e-7; the energy of a peak as wide as a line falls by e^π within the time that the lines span.
BACKWARDS: Final = 10.0
# No plate that is hung up and hit is larger [m].
LARGEST: Final = 20.0
CONJUGATE: Final = "time runs backwards in the FRFs, as where exp(−iωt) is meant for exp(+iωt)"


@dataclass(frozen=True)
class DrivingPoint:
    """An FRF whose force and response are at one place and direction; there the plate can only take power.

    Args:
        label: The pair, such as "3w/3w".
        negative_lines: Share of lines [-] with Re(mobility) < 0: noise between resonances puts some there.
        negative_power: Share of Σ|Re(mobility)| [-] on those lines: near 0 for a sound point, near 1 where one
            channel carries the wrong sign.
    """

    label: str
    negative_lines: float
    negative_power: float


@dataclass(frozen=True)
class Reciprocity:
    """Two FRFs with force and response exchanged, and ‖H_jk − H_kj‖ over the mean of both norms [-]."""

    label: str
    exchanged: str
    difference: float


@dataclass(frozen=True)
class CoherenceSummary:
    """Coherence γ² of one pair over the lines: mean, median and the share of lines under 0.8, all [-]."""

    label: str
    mean: float
    median: float
    share_low: float


@dataclass(frozen=True)
class Suspicion:
    """A channel pair to look at, and why, in one sentence."""

    label: str
    reason: str


@dataclass(frozen=True)
class Quality:
    """The findings of `assess`.

    Args:
        band: First and last line [Hz].
        step: Line spacing [Hz], None where uneven.
        n_line: Number of lines.
        driving_points: Pairs at one place and direction.
        reciprocity: Pairs that exist both ways round.
        coherence: One per pair that has a coherence.
        line_noise: Noise between lines over level [-] by pair label; see `line_noise`.
        peaks: Frequencies [Hz] of the resonance peaks of all pairs together; see `peaks`.
        suspicions: Pairs that look wrong.
    """

    band: tuple[float, float]
    step: float | None
    n_line: int
    driving_points: tuple[DrivingPoint, ...]
    reciprocity: tuple[Reciprocity, ...]
    coherence: tuple[CoherenceSummary, ...]
    line_noise: dict[str, float]
    peaks: tuple[float, ...]
    suspicions: tuple[Suspicion, ...]


def assess(measurement: Measurement) -> Quality:
    """Run every check that needs no model."""
    m = measurement.to("cpu")
    points = driving_points(m)
    noise, exchanged = line_noise(m), reciprocity(m)
    return Quality(
        band=(float(m.frequency[0]), float(m.frequency[-1])),
        step=m.step,
        n_line=len(m.frequency),
        driving_points=points,
        reciprocity=exchanged,
        coherence=coherence_summary(m),
        line_noise={m.pair_label(j, k): float(noise[j, k]) for j, k in m.pairs},
        peaks=tuple(peaks(m)),
        suspicions=suspicions(m, points, exchanged),
    )


def same_place(one: Channel, other: Channel) -> bool:
    """Tell whether two channels are at one place and direction: by coordinates where both have them, else by node."""
    if one.direction != other.direction:
        return False
    if one.coordinate is None or other.coordinate is None:
        return one.node == other.node
    return math.dist(one.coordinate, other.coordinate) <= SAME_PLACE


def mobility(measurement: Measurement) -> Float[Tensor, "n_frequency n_response n_reference 2"]:
    """FRFs as mobility [m/(N s)], real and imaginary part last: H iω, H or H/(iω). A line at 0 Hz gives 0.

    Raises:
        ValueError: For a transmissibility, which has no force to be a mobility of.
    """
    if measurement.kind == "transmissibility":
        raise ValueError("Expected an FRF over a force, got a transmissibility, which has no mobility.")
    omega = 2 * torch.pi * measurement.frequency[:, None, None]
    if measurement.kind == "receptance":
        value = measurement.frf * 1j * omega
    elif measurement.kind == "mobility":
        value = measurement.frf
    else:
        safe = torch.where(omega > 0, omega, torch.ones_like(omega))
        value = torch.where(omega > 0, measurement.frf / (1j * safe), torch.zeros_like(measurement.frf))
    return torch.view_as_real(value.resolve_conj().contiguous())


def driving_points(measurement: Measurement) -> tuple[DrivingPoint, ...]:
    """Find the driving points and check that the plate only takes power there: Re(mobility) ≥ 0.

    The same as Im(receptance) ≤ 0 and Im(accelerance) ≥ 0, with time dependence exp(+iωt). Empty for a
    transmissibility.
    """
    if measurement.kind == "transmissibility":
        return ()
    real = mobility(measurement)[..., 0]
    found = []
    for j, k in measurement.pairs:
        if same_place(measurement.response[j], measurement.reference[k]):
            values = real[:, j, k]
            negative, total = values.clamp(max=0).abs().sum(), values.abs().sum()
            power = float(negative / total) if float(total) > 0 else 0.0
            share = float((values < 0).double().mean())
            found.append(DrivingPoint(measurement.pair_label(j, k), share, power))
    return tuple(found)


def reciprocity(measurement: Measurement) -> tuple[Reciprocity, ...]:
    """Compare H_jk with H_kj wherever both were measured. Empty for a transmissibility."""
    if measurement.kind == "transmissibility":
        return ()
    response, reference = measurement.response, measurement.reference
    force_at = {j: [k for k, c in enumerate(reference) if same_place(r, c)] for j, r in enumerate(response)}
    sensor_at = {k: [j for j, r in enumerate(response) if same_place(r, c)] for k, c in enumerate(reference)}
    found = []
    for j, k in measurement.pairs:
        for p in sensor_at[k]:
            for q in force_at[j]:
                # j < p takes each exchange once and leaves out the driving points, which exchange with themselves.
                if j < p and bool(measurement.measured[p, q]):
                    one, other = measurement.frf[:, j, k], measurement.frf[:, p, q]
                    level = 0.5 * float(one.norm() + other.norm())
                    difference = float((one - other).norm()) / level if level > 0 else 0.0
                    labels = (measurement.pair_label(j, k), measurement.pair_label(p, q))
                    found.append(Reciprocity(*labels, difference))
    return tuple(found)


def coherence_summary(measurement: Measurement) -> tuple[CoherenceSummary, ...]:
    """Mean, median and share under 0.8 of the coherence, pair by pair."""
    if measurement.coherence is None:
        return ()
    found = []
    for j, k in measurement.pairs:
        values = measurement.coherence[:, j, k]
        values = values[torch.isfinite(values)]
        if len(values):
            numbers = (float(values.mean()), float(values.median()), float((values < 0.8).double().mean()))
            found.append(CoherenceSummary(measurement.pair_label(j, k), *numbers))
    return tuple(found)


def line_noise(measurement: Measurement) -> Float[Tensor, "n_response n_reference"]:
    """Estimate the noise from line to line over the level [-], without coherence.

    Each line is compared with the straight line through its neighbours; white noise of standard deviation σ per
    line (real and imaginary part together) leaves a residue of variance 1.5 σ². The median over the lines keeps
    resonances, which curve, from counting; where the lines are too coarse for the resonances, this is an upper
    bound. Uneven spacing is allowed for. 0 with fewer than three lines, or for a dead channel.
    """
    f, h = measurement.frequency, measurement.frf
    if len(f) < 3:
        return torch.zeros(measurement.measured.shape, dtype=f.dtype)
    weight = ((f[1:-1] - f[:-2]) / (f[2:] - f[:-2]))[:, None, None]
    residue = (h[1:-1] - (1 - weight) * h[:-2] - weight * h[2:]).abs()
    scale = (1 + (1 - weight) ** 2 + weight**2).sqrt()
    level = h.abs().median(dim=0).values
    noise = (residue / scale).median(dim=0).values
    return torch.where(level > 0, noise / level.clamp(min=torch.finfo(level.dtype).tiny), torch.zeros_like(level))


def summed_amplitude(measurement: Measurement) -> Float[Tensor, " n_frequency"]:
    """Root of the sum of |H|² over all pairs, each over its own root mean square, so that none drowns the rest.

    Like the largest singular value of the FRF matrix (CMIF), without needing the matrix complete.
    """
    power = measurement.frf.abs().square()
    mean = power.mean(dim=0)
    scaled = torch.where(mean > 0, power / mean.clamp(min=torch.finfo(mean.dtype).tiny), torch.zeros_like(power))
    return scaled.sum(dim=(1, 2)).sqrt()


def peaks(measurement: Measurement, prominence: float = 3.0) -> list[float]:
    """Find peaks [Hz] of the amplitude summed over all pairs: resonances, and noise where it stands out as far.

    Args:
        measurement: At least three lines, or there is no peak.
        prominence: By how much a peak stands over the higher of its two flanking valleys [dB], > 0.
    """
    from scipy.signal import find_peaks  # here: half of what importing this package takes

    amplitude = summed_amplitude(measurement)
    # A floor 200 dB down keeps a dead line from becoming an infinite valley.
    decibel = 20 * torch.log10(amplitude.clamp(min=1e-10 * max(float(amplitude.max()), 1e-300)))
    index, _ = find_peaks(decibel.numpy(), prominence=prominence)
    return [float(measurement.frequency[int(i)]) for i in index]


def peak_width(measurement: Measurement, prominence: float = 12.0) -> float | None:
    """The median width of the clear peaks between half their power [Hz]; None with fewer than three of them.

    Args:
        measurement: lines finer than its peaks, or the width is that of the lines.
        prominence: as for `peaks`, at least twice the 3 dB that a width is read at.
    """
    from scipy.signal import find_peaks, peak_widths

    power = summed_amplitude(measurement).square().numpy()
    decibel = 10 * np.log10(np.clip(power, 1e-20 * max(float(power.max()), 1e-300), None))
    index, _ = find_peaks(decibel, prominence=prominence)
    if len(index) < 3:
        return None
    # At half of each peak's own height, not of its prominence.
    own = (power[index], np.zeros(len(index), dtype=int), np.full(len(index), len(power) - 1))
    _, _, left, right = peak_widths(power, index, rel_height=0.5, prominence_data=own)
    lines = np.arange(len(power))
    ends = (np.interp(side, lines, measurement.frequency.numpy()) for side in (right, left))
    return float(np.median(np.subtract(*ends)))


def runs_backwards(measurement: Measurement) -> bool:
    """Whether the impulse responses come before their hits, as where exp(−iωt) was meant for exp(+iωt).

    What follows a hit dies away, and lies in the first half of the time that the lines span; of FRFs that are complex
    conjugate, in the second. Peaks that are narrower than the lines fill both halves alike, and nothing is said.

    Args:
        measurement: evenly spaced, 32 lines and more, or the answer is no.
    """
    n = len(measurement.frequency)
    if measurement.step is None or n < 32:
        return False
    # Ends of the band would ring in both directions of time.
    window = torch.hann_window(n, periodic=False, dtype=torch.float64)[:, None, None]
    power = torch.fft.ifft(window * measurement.frf, dim=0).abs().square()
    power = power / power.sum(dim=0).clamp(min=torch.finfo(power.dtype).tiny)
    # The window is as wide as a few samples in time, which belong to neither half.
    edge = 4
    after, before = (float(half.sum()) for half in (power[edge : n // 2], power[n // 2 + 1 : n - edge + 1]))
    return before > BACKWARDS * after


def suspicions(
    measurement: Measurement, points: Sequence[DrivingPoint], exchanged: Sequence[Reciprocity]
) -> tuple[Suspicion, ...]:
    """Name the pairs that look wrong: dead, constant, off in level, noisier, of the wrong sign, or not reciprocal.

    Level and noise are held against the median over the pairs, which takes three pairs at least.
    """
    found: list[Suspicion] = []
    if runs_backwards(measurement):
        found.append(Suspicion("all FRFs", f"{CONJUGATE}: take the complex conjugate"))
    places = torch.tensor([one.coordinate for one in (*measurement.response, *measurement.reference) if one.coordinate])
    if len(places) and (span := float((places.amax(0) - places.amin(0)).max())) > LARGEST:
        found.append(
            Suspicion("coordinates", f"{span:.4g} m apart: mm that are read as m, since the file has no unit?")
        )
    level = measurement.frf.abs().square().mean(dim=0).sqrt()
    spread = (measurement.frf - measurement.frf.mean(dim=0)).abs().square().mean(dim=0).sqrt()
    noise = line_noise(measurement)
    alive = measurement.measured & (level > 0)
    compare = int(alive.sum()) >= 3
    usual, usual_noise = (float(level[alive].median()), float(noise[alive].median())) if compare else (0.0, 0.0)
    for j, k in measurement.pairs:
        label, own = measurement.pair_label(j, k), float(level[j, k])
        if own == 0:
            found.append(Suspicion(label, "dead: every line is zero"))
            continue
        if len(measurement.frequency) > 2 and float(spread[j, k]) <= 1e-9 * own:
            found.append(Suspicion(label, "constant: every line has the same value"))
            continue
        if not compare:
            continue
        decibel = 20 * math.log10(own / usual)
        # 40 dB: a sensor near a nodal line loses 10 to 20 dB over a wide band, a wrong unit (mV, g, mm) more.
        if abs(decibel) > 40:
            found.append(Suspicion(label, f"level {decibel:+.0f} dB against the median channel: unit or cable?"))
        if float(noise[j, k]) > max(5 * usual_noise, 0.05):
            share = f"{percent(float(noise[j, k]), 2)} of its level from line to line"
            found.append(Suspicion(label, f"noisy: {share}, the median channel {percent(usual_noise, 2)}"))
    for point in points:
        share = f"{percent(point.negative_power, 2)} of the power runs out of the plate"
        if point.negative_power > 0.5:
            found.append(Suspicion(point.label, f"wrong sign? At a driving point {share}"))
        # A sound point of a noisy test stays below a few per cent; a delay or a drifting phase does not.
        elif point.negative_power > 0.1:
            found.append(Suspicion(point.label, f"phase? At a driving point {share}: a delay, or compare amplitudes"))
    for pair in exchanged:
        # Hammer positions off by some millimetres and unequal mounting make a tenth or so.
        if pair.difference > 0.2:
            away = f"{percent(pair.difference, 2)} away from {pair.exchanged}"
            found.append(Suspicion(pair.label, f"not reciprocal: {away}"))
    return tuple(found)
