"""How noisy a measurement is, from the measurement alone: no model of the plate is asked.

What is smooth in frequency, but for resonances, is signal; what is not is noise: `rational_fit` parts them, and
`noise_regression` tells the two components of what is left, σ² = a g(f) + b |H|². g is flat in what the sensor reads,
which need not be what the FRF says: an accelerometer's floor falls with f⁻⁴ in the power of a receptance. Displacement,
velocity and acceleration are tried, and the likelihood decides. The coherence, with the number of averages, is a second
opinion.

Sources: Pintelon and Schoukens, System Identification (2012), ch. 7, for noise from smoothness; Bendat and Piersol,
Random Data (2010), Table 9.6, for the coherence.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import torch
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor

from torchplate.measurement.assessment.outliers import lone_lines, without_outliers
from torchplate.measurement.assessment.quality import line_noise, reciprocity
from torchplate.measurement.assessment.rational_fit import N_LOCAL, RationalFit
from torchplate.measurement.assessment.resonances import Resonances
from torchplate.measurement.measurement import Measurement
from torchplate.notation import counted, percent

# Chance that a line of usual noise anywhere in a test passes for one that stands out.
CHANCE: Final = 0.05
# Frequencies of the mains of the world [Hz].
MAINS: Final = (50.0, 60.0)
# Part of the FRFs in which a line stands out if it is no resonance, which all show but those on its nodal lines [-].
FEW: Final = 1 / 3
# Fewer lines than this cannot part poles from noise; neighbours then have to do.
LEAST_LINE: Final = 24
# Power of the frequency by which a sensor's floor goes in the FRF's own kind, where it is flat in one of three motions.
MOTIONS: Final = ("displacement", "velocity", "acceleration")
ORDER: Final = {"receptance": 0, "mobility": 1, "accelerance": 2}
# A coherence-based noise is not believed if it is below the scatter over the lines by more than this factor.
DISAGREEMENT: Final = 2.0
# Part of an FRF's energy that scatter takes where no resonance can be told in it.
MOSTLY: Final = 0.5
# Times the others' that the noise of a sound channel is at most: sensors of one test are read in one range or the next.
APART: Final = 10.0


@dataclass(frozen=True)
class Noise:
    """The noise of a measurement.

    Attributes:
        std: standard deviation of the real and of the imaginary part, in the unit of the FRFs; 0 where not measured.
        floor: mean over FRFs of √(Σ 2 std²) / ‖H‖ [-]: what noise alone makes the gap.
        sentences: where the numbers come from.
        slope: |dH/df| of the resonances found, between lines too [unit of the FRFs per Hz]; 0 where none were sought.
        resonances: these, with what stands out at a line or two alone; None where none were sought.
        distorted: FRFs that scatter over the lines by far more than their records differ, where the others do not;
            None where that is not known.
        loud: FRFs that scatter many times as much as the others do; None where that is not known.
    """

    std: Float[Tensor, "n_frequency n_response n_reference"]
    floor: float
    sentences: tuple[str, ...]
    slope: Float[Tensor, "n_frequency n_response n_reference"]
    resonances: Resonances | None = None
    distorted: Bool[Tensor, "n_response n_reference"] | None = None
    loud: Bool[Tensor, "n_response n_reference"] | None = None

    def at_lines(self, index: Int[Tensor, " n_kept"]) -> "Noise":
        """Of some of the lines."""
        said = f"Of {len(self.std)} lines {len(index)} are looked at: this many FRFs say no more with all of them."
        return replace(self, std=self.std[index], slope=self.slope[index], sentences=(*self.sentences, said))


def noise_level(measurement: Measurement, n_average: int | None = None) -> Noise:
    """Estimate the noise of every FRF at every line.

    Args:
        measurement: at least 24 lines, or the estimate is only what the neighbours of each line say.
        n_average: records that each FRF is averaged over, ≥ 2, where known; it gives the coherence its level.

    Raises:
        ValueError: if `n_average` is below 2.
    """
    if n_average is not None and n_average < 2:
        raise ValueError(f"Expected n_average of 2 or more, got {n_average}. Leave it out where it is not known.")
    kept = measurement.measured
    frf = measurement.frf[:, kept]
    frf = frf.to(torch.complex128)
    norm = frf.norm(dim=0)
    alive = norm > 0
    variance, steep = torch.zeros_like(frf.real), torch.zeros_like(frf.real)
    sentences: list[str] = []
    resonances: Resonances | None = None
    distorted = torch.zeros_like(measurement.measured)
    if bool(alive.any()):
        scatter = _from_smoothness(measurement, frf[:, alive], alive)
        variance[:, alive], steep[:, alive] = scatter.variance, scatter.slope
        sentences.append(scatter.sentence)
        if scatter.fractions is not None:
            sound, whole = (_of_all(measurement, one, alive) for one in scatter.fractions)
            resonances = replace(sound, whole=whole)
        if measurement.coherence is not None:
            coherence = measurement.coherence[:, kept][:, alive].to(variance)
            second = _from_coherence(scatter, coherence, n_average)
            variance[:, alive] = second.variance
            sentences.append(second.sentence)
            every = torch.zeros_like(alive)
            every[alive] = second.distorted
            distorted[kept] = every
    else:
        sentences.append("Every FRF is zero at every line: there is nothing to tell noise from.")
    floors = (2 * variance.sum(0)).sqrt() / torch.where(alive, norm, 1.0)
    floor = float(floors[alive].mean()) if bool(alive.any()) else 0.0
    sentences.append(_of_reciprocity(measurement, floor))
    std = torch.zeros_like(measurement.frf.real)
    slope = torch.zeros_like(std)
    std[:, kept], slope[:, kept] = variance.sqrt().to(std), steep.to(std)
    loud = torch.zeros_like(measurement.measured)
    loud[kept] = _loud(variance, frf)
    said = tuple(sentence for sentence in sentences if sentence)
    return Noise(std, floor, said, slope, resonances, distorted, loud & ~distorted)


def _loud(variance: Float[Tensor, "n_line n_frf"], frf: Complex[Tensor, "n_line n_frf"]) -> Bool[Tensor, " n_frf"]:
    """FRFs that scatter many times as much as others, as such and as a part of what they hold.

    A sensor on a nodal line holds more scatter for its part, and where noise goes with |H| one that moves much scatters
    more; neither does both. Beside FRFs that scatter much themselves, what is mostly scatter is told by that.
    """
    power, energy = 2 * variance.sum(0), frf.abs().square().sum(0)
    part = power / torch.where(energy > 0, energy, 1.0)
    mostly = (energy > 0) & (part >= MOSTLY)
    sound = (energy > 0) & ~mostly
    if int(sound.sum()) < int(mostly.sum()) or not bool(sound.any()):
        return torch.zeros_like(mostly)
    by_part = mostly | (part > APART**2 * part[sound].median())
    return (energy > 0) & by_part & (power > APART**2 * power[sound].median())


class _Fractions(NamedTuple):
    """Poles, their residues, coefficients of the smooth part, and whether a pole is wide enough to be a resonance."""

    pole: Complex[Tensor, " n_pole"]
    residue: Complex[Tensor, "n_pole n_frf"]
    smooth: Complex[Tensor, "n_smooth n_frf"]
    has_width: Bool[Tensor, " n_pole"]


class _Scatter(NamedTuple):
    """The noise as the lines show it.

    Attributes:
        variance: of each part.
        smooth: the FRFs without their noise.
        slope: |dH/df| of their resonances.
        sentence: where the numbers come from.
        times: how many times a variance's expectation the scatter is.
        cost: −2 ln of the likelihood of a variance.
        fractions: of the resonances, and with what stands out at a line or two alone; None where none were sought.
    """

    variance: Float[Tensor, "n_line n_frf"]
    smooth: Complex[Tensor, "n_line n_frf"]
    slope: Float[Tensor, "n_line n_frf"]
    sentence: str
    times: Callable[[Tensor], Tensor]
    cost: Callable[[Tensor], Tensor]
    fractions: tuple[_Fractions, _Fractions] | None = None


def _from_smoothness(
    measurement: Measurement, frf: Complex[Tensor, "n_line n_frf"], alive: Bool[Tensor, " n_measured"]
) -> _Scatter:
    if len(frf) < LEAST_LINE:
        share = line_noise(measurement)[measurement.measured][alive].to(frf.real)
        level = share * frf.abs().median(dim=0).values
        few = f"{counted(len(frf), 'line')} {'is' if len(frf) == 1 else 'are'} too few for more"
        said = f"The noise is an upper bound from the neighbours of each line: {few}."
        crude = (0.5 * level.square()).expand(len(frf), -1)
        return _Scatter(
            crude,
            frf,
            torch.zeros_like(crude),
            said,
            lambda other: (crude / other.clamp(min=1e-300)).mean(0),
            lambda other: torch.zeros_like(other[0]),
        )
    scale = frf.abs().square().mean(0).sqrt()
    line = measurement.frequency.to(frf.real)
    fit, motion = RationalFit.likeliest(line, frf / scale, _floors(measurement.kind, line))
    sensor, signal = fit.level.unbind(-1)
    smooth = fit.smooth
    variance = 0.5 * (sensor * fit.flat + signal * smooth.abs().square()) * scale.square()
    kinds = (
        f"{percent(math.sqrt(float(sensor.mean())))} of each FRF's root mean square at every line"
        f"{f', flat in {motion},' if motion else ''} and "
        f"{percent(math.sqrt(float(signal.mean())))} of |H| itself"
    )
    sound = without_outliers(fit, variance / scale.square())
    n_seen = int(sound.has_width.sum())
    n_alone = len(fit.pole) - n_seen
    alone = "" if not n_alone else f", {n_alone} lines that stand out alone"
    out = 0.5 * (smooth - sound.smooth).abs().square() * scale.square()
    of_lines = _of_lone_lines(out, variance, lone_lines(fit, sound), of_mains(line))
    variance = variance + of_lines
    if n_noisy := int((of_lines > 0).sum()):
        alone += f" (there {counted(n_noisy, 'number')} {'is' if n_noisy == 1 else 'are'} noise)"
    own = "" if not fit.n_own else f"; {fit.n_own} of {frf.shape[1]} FRFs have a noise of their own"
    said = (
        f"The noise is what {n_seen} resonances common to all FRFs{alone} and a smooth rest leave of "
        f"{len(frf)} lines: {kinds}{own}."
    )
    return _Scatter(
        variance,
        smooth * scale,
        fit.slope * scale,
        said,
        lambda other: fit.times(2 * other / scale.square()),
        lambda other: fit.cost(2 * other / scale.square()),
        (_fractions(sound, scale), _fractions(fit, scale)),
    )


def _of_lone_lines(
    out: Float[Tensor, "n_line n_frf"],
    variance: Float[Tensor, "n_line n_frf"],
    lone: Bool[Tensor, " n_line"],
    hums: Bool[Tensor, " n_line"],
) -> Float[Tensor, "n_line n_frf"]:
    """Variance that lines have beside the others', where few FRFs stand out alone, or the mains hum in all of them.

    Args:
        out: half the squares of what stands out at a line or two alone.
        variance: of the other lines.
        lone: lines where something stands out alone.
        hums: lines of the mains.
    """
    stands = lone[:, None] & (out > variance * math.log(variance.numel() / CHANCE))
    few = stands.double().mean(dim=1, keepdim=True) <= FEW
    return torch.where(stands & (few | hums[:, None]), out, 0.0)


def of_mains(line: Float[Tensor, " n_line"]) -> Bool[Tensor, " n_line"]:
    """The lines nearest to a multiple of what the mains have; none where any line might be one by chance.

    Args:
        line: frequencies, rising evenly [Hz].
    """
    half = 0.5 * float(line[-1] - line[0]) / max(1, len(line) - 1)
    found = torch.zeros_like(line, dtype=torch.bool)
    if sum(2 * half / own for own in MAINS) > CHANCE:
        return found
    for own in MAINS:
        number = (line / own).round()
        found |= (number > 0) & ((line - number * own).abs() <= half)
    return found


class _Second(NamedTuple):
    """What the coherence makes of the noise.

    Attributes:
        variance: of each part.
        sentence: what was believed.
        distorted: FRFs that scatter over the lines by far more than their records differ, where the others do not.
    """

    variance: Float[Tensor, "n_line n_frf"]
    sentence: str
    distorted: Bool[Tensor, " n_frf"]


def _floors(kind: str, line: Float[Tensor, " n_line"]) -> dict[str, Float[Tensor, " n_line"]]:
    """Course over the lines, of mean 1, of a sensor's floor of power that is flat in another motion than the FRF's."""
    if kind not in ORDER:
        return {}
    place = line.clamp(min=float(line[min(1, len(line) - 1)]))
    powers = {motion: 2.0 * (ORDER[kind] - order) for order, motion in enumerate(MOTIONS) if order != ORDER[kind]}
    courses = {motion: (place / place[-1]) ** power for motion, power in powers.items()}
    return {motion: course / course.mean() for motion, course in courses.items()}


def _fractions(fit: RationalFit, scale: Float[Tensor, " n_frf"]) -> _Fractions:
    """Those of FRFs that were divided by a scale."""
    pole, residue, polynomial = fit.fractions
    return _Fractions(pole, residue * scale, polynomial * scale, fit.has_width)


def _of_all(measurement: Measurement, fractions: _Fractions, alive: Bool[Tensor, " n_measured"]) -> Resonances:
    """The partial fractions of those FRFs that say something, in their places; zero elsewhere."""
    kept = measurement.measured.clone()
    kept[measurement.measured] = alive
    wholes = []
    for part in (fractions.residue, fractions.smooth):
        whole = part.new_zeros(len(part), *kept.shape)
        whole[:, kept] = part
        wholes.append(whole)
    line = measurement.frequency
    return Resonances(fractions.pole, wholes[0], wholes[1], (float(line[0]), float(line[-1])), fractions.has_width)


def _from_coherence(scatter: _Scatter, coherence: Float[Tensor, "n_line n_frf"], n_average: int | None) -> _Second:
    """Variance of each part where the coherence has a say, σ² = |H|² (1 − γ²) / (2 (n_average − 1) γ²), and a sentence.

    Over the scatter's own curve it is smoothed along the lines, because the coherence of few averages scatters itself.
    """
    known = (coherence > 0) & (coherence < 1)  # NaN is neither
    safe = torch.where(known, coherence, 0.5)
    said = scatter.smooth.abs().square() * (1 - safe) / (2 * safe * ((n_average or 2) - 1))
    own = scatter.variance.clamp(min=1e-300)
    ratio = torch.where(known, said / own, 0.0)
    count = _moving_sum(known.to(own))
    # Where no line near has a coherence, as on the whole.
    local = torch.where(
        count > 0.5, _moving_sum(ratio) / count.clamp(min=1.0), ratio.sum(0) / known.sum(0).clamp(min=1)
    )
    variance = own * local
    usable = (known.to(own).mean(0) > 0.9) & (variance > 0).all(0)
    times = scatter.times(torch.where(usable, variance, own))
    least = scatter.cost(own)
    none = torch.zeros_like(usable)
    if n_average is None:
        if not bool(usable.any()):
            return _Second(scatter.variance, "The coherence is 1 or missing at many lines and was not used.", none)
        # That of few averages is near 1 by chance at some lines.
        usable &= scatter.cost(torch.where(usable, variance * times, own)) <= least
        if not bool(usable.any()):
            told = "The scatter over the lines is likelier without the coherence's course."
            return _Second(scatter.variance, told, none)
        shaped = torch.where(usable, variance * times, scatter.variance)
        told = (
            "The coherence gives the noise its course over the lines, the scatter its level: the number of averages is "
            "not known."
        )
        return _Second(shaped, told, none)
    believed = usable & (times <= DISAGREEMENT**2)
    if not bool(believed.any()):
        told = "The coherence claims less than half of the scatter that the lines show, or is 1: the scatter counts."
        return _Second(scatter.variance, told, none)
    # Where half of the FRFs bear the coherence out, as with one sound sensor of two, the others hold what every record
    # repeats: a wrong number of averages would part from the scatter in all of them.
    borne_out = 2 * int(believed.sum()) >= int(usable.sum())
    distorted = usable & ~believed if borne_out else none
    believed &= scatter.cost(torch.where(believed, variance, own)) <= least
    n = int(believed.sum())
    if n == 0:
        told = f"The scatter over the lines is likelier than what the coherence makes of it over {n_average} averages."
        return _Second(scatter.variance, told, distorted)
    over = 1 / math.sqrt(float(times[believed].mean()))
    told = (
        f"The noise of {n} of {len(believed)} FRFs is that of their coherence over {n_average} averages, {over:.2f} "
        "times what the scatter over the lines says."
    )
    return _Second(torch.where(believed, variance, scatter.variance), told, distorted)


def _moving_sum(values: Float[Tensor, "n_line n_frf"]) -> Float[Tensor, "n_line n_frf"]:
    """Over N_LOCAL lines around each."""
    window = values.new_ones(1, 1, N_LOCAL)
    return torch.nn.functional.conv1d(values.mT[:, None].contiguous(), window, padding=N_LOCAL // 2)[:, 0].mT


def _of_reciprocity(measurement: Measurement, floor: float) -> str:
    """A sentence where FRFs exist both ways round: two of them differ by √2 times their noise at least."""
    exchanged = reciprocity(measurement)
    if not exchanged:
        return ""
    usual = sorted(pair.difference for pair in exchanged)[len(exchanged) // 2] / math.sqrt(2)
    if usual < 0.7 * floor:
        return (
            f"FRFs measured both ways round differ by {percent(usual)} each, less than the noise of {percent(floor)} "
            "found: the noise may be common to both, or overestimated."
        )
    beyond = " That is more than noise: places, mounting or non-linearity." if usual > 2 * floor else ""
    return (
        f"FRFs measured both ways round differ by {percent(usual)} each, the noise found is {percent(floor)}.{beyond}"
    )
