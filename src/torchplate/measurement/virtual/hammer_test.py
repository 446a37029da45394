"""A virtual modal test: a plate is hit in the time domain, and an analyser makes FRFs of what its sensors read.

The response comes from the model's own FRF, so that every kind of damping it knows is in it, frequency-domain ones too:
x(t) = exp(σt) · inverse FFT of H(σ + iω) F(σ + iω). The decay σ makes what an inverse FFT wraps round from later blocks
die out before it returns (Wilcox, Numerical Laplace transformation and inversion, Int. J. Elect. Eng. Educ. 15, 1978).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor

from torchplate.measurement.imperfections import PERFECT, Imperfections
from torchplate.measurement.measurement import SI_UNIT, Channel, Measurement, checked_kind
from torchplate.measurement.virtual.analyser import Analyser, Spectra
from torchplate.model import PlateModel

# An inverse FFT over four records, at twice the analyser's rate: room for the filter's slope, which ends at 1.56 span.
N_RECORD_PER_BLOCK: Final = 4
OVERSAMPLING: Final = 2
# What wraps round, relative to the signal. Not smaller: with hysteretic damping H is not analytic across ω = 0, which
# costs about β (σ/ω_r)² exp(σt) / (π ω_r t) of a mode's acceleration; at 1e-6 that is below 1e-5 for modes above 5 Hz.
# On the contour the filter's response to a pulse is ℓ(t) exp(σt) instead of ℓ(t), alike on all channels.
WRAPPED: Final = 1e-6
# Time before a hit that is computed beyond the pre-trigger, in samples: the filter rings ahead of the pulse.
LEAD: Final = 16
N_ATTEMPT: Final = 50


@dataclass(frozen=True)
class Hammer:
    """Half-sine hits: f(t) = peak · sin(πt / length) for 0 ≤ t ≤ length.

    The spectrum first vanishes at 1.5 / length and is 3 dB down at 0.6 / length: 1.5 ms reach 400 Hz. A second pulse
    of a double hit has the length of the first.

    Args:
        pulse_length: median length of contact [s], > 0.
        length_scatter: standard deviation of the length's logarithm [-], ≥ 0.
        peak_force: median peak [N], > 0.
        force_scatter: standard deviation of the peak's logarithm [-], ≥ 0.
        double_hit: probability that the hammer bounces [-], 0 to 1.
        double_hit_delay: from the start of the first pulse to that of the second [s], > 0.
        double_hit_ratio: second peak over the first [-], ≥ 0.

    Raises:
        ValueError: if a setting is outside its range.
    """

    pulse_length: float = 1.5e-3
    length_scatter: float = 0.1
    peak_force: float = 50.0
    force_scatter: float = 0.2
    double_hit: float = 0.0
    double_hit_delay: float = 0.02
    double_hit_ratio: float = 0.4

    def __post_init__(self) -> None:
        for name in ("pulse_length", "peak_force", "double_hit_delay"):
            if getattr(self, name) <= 0:
                raise ValueError(f"Expected a hammer with {name} above 0, got {getattr(self, name)}. Raise it.")
        for name in ("length_scatter", "force_scatter", "double_hit_ratio"):
            if getattr(self, name) < 0:
                raise ValueError(f"Expected a hammer with {name} of 0 or more, got {getattr(self, name)}. Raise it.")
        if not 0 <= self.double_hit <= 1:
            raise ValueError(
                f"Expected a hammer with double_hit, a probability, from 0 to 1, got {self.double_hit}. Correct it."
            )


class Hits(NamedTuple):
    """What differs from hit to hit."""

    reference: Int[Tensor, " n_hit"]  # index of the reference
    peak: Float[Tensor, " n_hit"]  # [N]
    length: Float[Tensor, " n_hit"]  # [s]
    start: Float[Tensor, " n_hit"]  # of the pulse, from the start of the block [s]
    bounce: Float[Tensor, " n_hit"]  # second peak over the first, 0 for a single hit [-]
    delay: Float[Tensor, " n_hit"]  # of the second peak after the first [s]

    def spectrum(self, laplace: Complex[Tensor, " n_line"]) -> Complex[Tensor, "n_hit n_line"]:
        """Laplace transform of the force [N s]: of a half-sine, p r (1 + e^(−sT)) / (s² + r²) with r = π/T."""
        peak, length, start, bounce, delay = (value[:, None] for value in self[1:])
        rate = torch.pi / length
        pulse = peak * rate * (1 + (-laplace * length).exp()) / (laplace**2 + rate**2)
        return pulse * (-laplace * start).exp() * (1 + bounce * (-laplace * delay).exp())


def hammer_test(
    model: PlateModel,
    theta: Float[Tensor, "*batch n_parameter"],
    *,
    response: Sequence[int | Sequence[float]],
    reference: Sequence[int | Sequence[float]],
    analyser: Analyser,
    hammer: Hammer,
    generator: torch.Generator,
    kind: str = "accelerance",
    memory: int = 2**28,
    imperfections: Imperfections = PERFECT,
) -> Measurement:
    """Hit the plate at every reference, `n_average` times each, and estimate its FRFs.

    Give a model on a finer mesh than any identification uses (the same mesh with `refine` raised keeps its node
    labels), or the identification is spared the mesh error it would meet on a real plate. Leave the effect
    `exponential_window` out of it where the analyser has one: here the record itself is windowed.

    The plate is at rest before each hit. The trigger looks at the force without its noise; sampling is not in step
    with the hammer, so the pulse falls anywhere between two samples. Noise is white and new for each record.

    Args:
        model: the plate that is tested.
        theta: its searched parameters in SI units, none for a model without intervals.
        response: sensors: node labels or relative places.
        reference: points that are hit, likewise.
        analyser: settings of the measurement; `ANALYSERS["sr785"]` is Table 2 of the seed paper.
        hammer: the hits.
        generator: source of all randomness; the same state gives the same numbers.
        kind: what the sensors read per force: accelerance, mobility or receptance.
        memory: bytes that the hits computed at once may take. Another value draws other random numbers.
        imperfections: what the test is not perfect in; drawn before any hit, so that a perfect test stays as it was.
            All hits at a mark land at the same place off it; one record of each reference drifts as a whole.

    Returns:
        FRFs and coherence on the lines 0 to span. Coordinates are relative places times the mesh's nominal sides: of
        the marks, not of where the hammer and the sensors were.

    Raises:
        ValueError: if theta is a batch, the kind needs no hammer, or hits keep being rejected at a reference.
    """
    kind = checked_kind(kind, "hammer_test")
    if kind == "transmissibility":
        raise ValueError(
            "Expected a hammer test of kind accelerance, mobility or receptance, got transmissibility, which has no "
            "force. Name one of the three."
        )
    if theta.ndim != 1:
        raise ValueError(
            f"Expected theta of one plate, [n_parameter], got {tuple(theta.shape)}. Test one member at a time."
        )
    setup = _set_up(model, response, reference, imperfections, generator)
    structure = _Structure(setup, theta.detach(), reference, analyser, kind)
    spectra, n_rejected = _run(structure, hammer, generator, memory)
    return Measurement(
        frequency=analyser.frequency,
        frf=spectra.frf(analyser.estimator).permute(2, 1, 0).cpu() * setup.gain,
        measured=torch.ones(len(response), len(reference), dtype=torch.bool),
        response=_channels(model, response),
        reference=_channels(model, reference),
        kind=kind,
        unit=SI_UNIT[kind],
        coherence=spectra.coherence().permute(2, 1, 0).cpu(),
        source="virtual modal test",
        notes=(
            f"Virtual modal test: {analyser.estimator} over {analyser.n_average} hits at each of {len(reference)} "
            f"points; {n_rejected} more were rejected for overload or did not trigger.",
        ),
    )


class _Setup(NamedTuple):
    """The plate as it is mounted and the test as it is made, not as the sheet has them."""

    model: PlateModel
    response: Sequence[int | Sequence[float]]
    reference: Sequence[int | Sequence[float]]
    drift: list[float]  # of all natural frequencies at each reference [-]
    gain: Float[Tensor, "n_response n_reference"]  # of the two channels of each pair [-]


def _set_up(
    model: PlateModel,
    response: Sequence[int | Sequence[float]],
    reference: Sequence[int | Sequence[float]],
    imperfections: Imperfections,
    generator: torch.Generator,
) -> _Setup:
    """One draw of what is not perfect; nothing is drawn of what is.

    Raises:
        ValueError: if damping is to scatter in a model that takes one law for all modes.
    """

    def normal(name: str, *shape: int) -> Tensor | None:
        std = getattr(imperfections, name)
        if not std:
            return None
        return std * torch.randn(shape, generator=generator, dtype=torch.float64, device=generator.device).cpu()

    sides = torch.tensor([model.mesh.length_x, model.mesh.length_y], dtype=torch.float64)

    def moved(points: Sequence[int | Sequence[float]]) -> Sequence[int | Sequence[float]]:
        off = normal("position_std", len(points), 2)
        if off is None:
            return points
        # What would miss the plate lands as far within it.
        places: list[Sequence[float]] = (1 - (1 - (model.mesh.places(points).cpu() + off / sides).abs()).abs()).tolist()
        return places

    sensors, hits = moved(response), moved(reference)
    gain = torch.ones(len(response), len(reference), dtype=torch.float64)
    own = normal("calibration_std", len(response), 1), normal("calibration_std", 1, len(reference))
    for part in own:
        gain = gain if part is None else gain * (1 + part)
    drift = normal("frequency_drift", len(reference))
    scatter = normal("damping_scatter", model.assembly.size)
    if scatter is not None:
        model = model.with_damping_factors(scatter.exp())
    return _Setup(model, sensors, hits, [0.0] * len(reference) if drift is None else drift.tolist(), gain)


class _Structure:
    """The plate as a tested object: its FRF on the damped contour s = σ + iω, and what it answers to hits."""

    def __init__(
        self,
        setup: _Setup,
        theta: Tensor,
        reference: Sequence[int | Sequence[float]],
        analyser: Analyser,
        kind: str,
    ) -> None:
        self.analyser, self.reference = analyser, tuple(reference)
        self.n_block = N_RECORD_PER_BLOCK * OVERSAMPLING * analyser.n_sample
        length = N_RECORD_PER_BLOCK * analyser.record
        decay = -math.log(WRAPPED) / length
        frequency = torch.arange(self.n_block // 2 + 1, dtype=torch.float64, device=theta.device) / length
        # Beyond the filter's slope every line is zero, so none is computed; the inverse FFT pads them.
        frequency = frequency[analyser.low_pass(frequency) > 0]
        frf = _drifted(setup, theta, frequency, kind, decay)
        self.frf = frf.detach().to(torch.complex128).permute(2, 1, 0).contiguous()
        self.laplace = torch.complex(torch.full_like(frequency, decay), 2 * torch.pi * frequency)
        self.low_pass = analyser.low_pass(frequency)
        self.n_pre = analyser.n_pre_trigger
        # A record may start anywhere in the first 2 (LEAD + n_pre) samples.
        self.n_time = 2 * (LEAD + self.n_pre) + analyser.n_sample
        time = torch.arange(self.n_time, dtype=torch.float64, device=theta.device) / analyser.sample_rate
        self.growth = (decay * time).exp() * (OVERSAMPLING * analyser.sample_rate)

    @property
    def lead(self) -> float:
        """Start of the earliest pulse in the block [s]."""
        return (LEAD + self.n_pre) / self.analyser.sample_rate

    def signals(self, hits: Hits) -> tuple[Float[Tensor, "n_hit n_time"], Float[Tensor, "n_hit n_response n_time"]]:
        """Force [N] and responses after the anti-alias filter, at the analyser's rate, from the start of the block."""
        force = hits.spectrum(self.laplace) * self.low_pass
        return self._to_time(force), self._to_time(self.frf[hits.reference] * force[:, None])

    def _to_time(self, spectrum: Complex[Tensor, "*batch n_line"]) -> Float[Tensor, "*batch n_time"]:
        signal = torch.fft.irfft(spectrum, n=self.n_block)
        return signal[..., : OVERSAMPLING * self.n_time : OVERSAMPLING] * self.growth

    def records(
        self,
        force: Float[Tensor, "n_hit n_time"],
        motion: Float[Tensor, "n_hit n_response n_time"],
        level: Float[Tensor, " n_hit"],
    ) -> tuple[Float[Tensor, "n_hit n_sample"], Float[Tensor, "n_hit n_response n_sample"], Bool[Tensor, " n_hit"]]:
        """Both channels from `n_pre` samples before the force first exceeds its level [N], and whether it ever does."""
        last = self.n_time - self.analyser.n_sample + self.n_pre
        above = force[:, self.n_pre : last + 1] > level[:, None]
        first = above.to(torch.uint8).argmax(-1)
        sample = first[:, None] + torch.arange(self.analyser.n_sample, device=first.device)
        spread = sample[:, None].expand(-1, motion.shape[1], -1)
        return force.gather(-1, sample), motion.gather(-1, spread), above.any(-1)


def _drifted(
    setup: _Setup, theta: Tensor, frequency: Float[Tensor, " n_frequency"], kind: str, decay: float
) -> Complex[Tensor, "n_frequency n_response n_reference"]:
    """The FRF with all natural frequencies times 1 + δ in each record: H(s / (1 + δ)), times (1 + δ)^(d − 2).

    d is how often the motion is differentiated: (1 + δ)² K in place of K makes H(s / (1 + δ)) / (1 + δ)² of a
    receptance.
    """
    model = setup.model
    if not any(setup.drift):
        return model.frf(theta, frequency, setup.response, setup.reference, kind, decay=decay)
    power = {"receptance": -2, "mobility": -1, "accelerance": 0}[kind]
    parts = []
    for point, off in zip(setup.reference, setup.drift, strict=True):
        slower = 1 + off
        own = model.frf(theta, frequency / slower, setup.response, [point], kind, decay=decay / slower)
        parts.append(own * slower**power)
    return torch.cat(parts, dim=-1)


def _run(structure: _Structure, hammer: Hammer, generator: torch.Generator, memory: int) -> tuple[Spectra, int]:
    """Spectra of `n_average` good hits at each reference, and the number of hits thrown away on the way.

    Raises:
        ValueError: if a hit was thrown away `N_ATTEMPT` times.
    """
    analyser = structure.analyser
    n_reference, n_response = structure.frf.shape[:2]
    # Per hit: spectra and signals of all channels, each complex or twice as long as the record.
    size = max(1, memory // (40 * (1 + n_response) * structure.n_block))
    force_scale, motion_scale = _full_scales(structure, hammer, size)
    spectra = Spectra.zeros(analyser, n_reference, n_response, structure.frf.device)
    pending = torch.arange(n_reference, device=structure.frf.device).repeat_interleave(analyser.n_average)
    n_rejected = 0
    for _ in range(N_ATTEMPT):
        again = []
        for index in pending.split(size):
            scales = force_scale[index], motion_scale[index]
            signals = structure.signals(_draw(hammer, structure, index, generator))
            force, motion, good = structure.records(*signals, analyser.trigger_level * scales[0])
            force = analyser.with_noise(force, scales[0], 0, generator)
            motion = analyser.with_noise(motion, scales[1], 1, generator)
            if analyser.overload_reject:
                good &= force.abs().amax(-1) <= scales[0]
                good &= (motion.abs().amax(-1) <= scales[1]).all(-1)
            force, motion = analyser.digitise(force, scales[0], 0), analyser.digitise(motion, scales[1], 1)
            spectra = spectra.add(analyser, index[good], force[good], motion[good])
            again.append(index[~good])
        pending = torch.cat(again)
        if len(pending) == 0:
            return spectra, n_rejected
        n_rejected += len(pending)
    raise ValueError(
        f"Expected hits within the input ranges and above the trigger level, got {N_ATTEMPT} others in a row at "
        f"reference {structure.reference[int(pending[0])]}. Raise the analyser's headroom or full_scale, lower its "
        "trigger_level, or turn overload_reject off."
    )


def _full_scales(
    structure: _Structure, hammer: Hammer, size: int
) -> tuple[Float[Tensor, " n_reference"], Float[Tensor, "n_reference n_response"]]:
    """Input ranges at each reference, from a single hit with the hammer's median peak and length."""
    n_reference, n_response = structure.frf.shape[:2]
    analyser, one = structure.analyser, structure.low_pass.new_ones(n_reference)
    if analyser.full_scale is not None:
        return analyser.full_scale[0] * one, (analyser.full_scale[1] * one)[:, None].repeat(1, n_response)
    peaks = []
    for index in torch.arange(n_reference, device=one.device).split(size):
        unit = one[: len(index)]
        hits = Hits(index, unit * hammer.peak_force, unit * hammer.pulse_length, unit * structure.lead, 0 * unit, unit)
        peaks.append([signal.abs().amax(-1) * analyser.headroom for signal in structure.signals(hits)])
    force, motion = (torch.cat(part) for part in zip(*peaks, strict=True))
    # A sensor on a clamped edge reads nothing; its range must still divide.
    return force, motion.clamp(min=torch.finfo(motion.dtype).tiny)


def _draw(hammer: Hammer, structure: _Structure, reference: Int[Tensor, " n_hit"], generator: torch.Generator) -> Hits:
    n_hit, device = len(reference), reference.device
    normal = torch.randn(2, n_hit, generator=generator, dtype=torch.float64, device=generator.device).to(device)
    uniform = torch.rand(2, n_hit, generator=generator, dtype=torch.float64, device=generator.device).to(device)
    return Hits(
        reference=reference,
        peak=hammer.peak_force * (hammer.force_scatter * normal[0]).exp(),
        length=hammer.pulse_length * (hammer.length_scatter * normal[1]).exp(),
        start=structure.lead + uniform[0] / structure.analyser.sample_rate,
        bounce=hammer.double_hit_ratio * (uniform[1] < hammer.double_hit),
        delay=torch.full_like(normal[0], hammer.double_hit_delay),
    )


def _channels(model: PlateModel, points: Sequence[int | Sequence[float]]) -> tuple[Channel, ...]:
    side = (model.mesh.length_x, model.mesh.length_y)
    places = model.mesh.places(points).tolist()
    return tuple(
        Channel(point if isinstance(point, int) else 0, "w", (x * side[0], y * side[1], 0.0))
        for point, (x, y) in zip(points, places, strict=True)
    )
