"""The two-channel analyser of an impact test: settings, windows, digitising, averaged spectra.

Sources: Stanford Research Systems, SR785 operating manual (spans, 2.56 samples per hertz of span, windows); seed paper,
Table 2; Fladung, Windows Used for Impact Testing (IMAC 1997); Brandt, Noise and Vibration Analysis (2011), chapter 13;
Ewins, Modal Testing (2000), section 3.10.
"""

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

Estimator = Literal["H1", "H2"]

# Samples per hertz of span: the room between span and half the rate takes what the filter lets through.
RATE_PER_SPAN: Final = 2.56


@dataclass(frozen=True)
class Analyser:
    """Settings of one impact measurement with a force channel and any number of response channels.

    The record lasts n_line / span and holds 2.56 n_line samples; the lines run from 0 to span, both included. A pair
    is (force channel, response channels). Both windows start where the record starts, before the trigger: so the
    exponential window also lowers the level by exp(−t_c/τ), t_c the time of the pulse in the record. As on the SR785
    with Table 2's settings, the force channel gets no exponential window of its own.

    All hits weigh the same. Table 2's exponential averaging over 5000 weighs each older hit 1 − 1/5000 of the next:
    over the hits that a person makes at one point that is equal weights to 0.1 %.

    Args:
        span: highest line [Hz], > 0.
        n_line: lines above 0 Hz, a multiple of 25 so that the samples are a whole number.
        force_window: time from the start of the record after which the force counts as zero [s]; a rectangle with
            hard edges. None for no window.
        exponential_window: time constant τ of exp(−t/τ) on the responses [s]. None for no window.
        n_average: hits at each reference, ≥ 1.
        estimator: H1 = G_fx / G_ff (unbiased by noise on the responses) or H2 = G_xx / G_xf (by noise on the force).
        trigger_level: share of the force channel's full scale at which the record is triggered [-], 0 to 1.
        n_pre_trigger: samples in the record before the trigger, 0 to n_line. Below four, the record cuts what the
            anti-alias filter rings ahead of the pulse, and the FRFs are off by several percent.
        headroom: full scale over the peak of an average hit, as auto-range sets it [-], > 0. Below 1 most hits clip.
        full_scale: fixed full scales [N, unit of the response] instead of auto-range.
        bits: of the converters, sign included, 2 to 32; None for no quantisation and no clipping.
        noise_floor: rms of the white noise in each record over full scale [-], ≥ 0.
        sensor_noise: rms of the sensors' white noise [N, unit of the response], ≥ 0, added to the former in power.
        overload_reject: a hit that exceeds a full scale is thrown away and made again; else it is clipped and kept.

    Raises:
        ValueError: if a setting is outside its range.
    """

    span: float = 400.0
    n_line: int = 800
    force_window: float | None = None
    exponential_window: float | None = None
    n_average: int = 5
    estimator: Estimator = "H1"
    trigger_level: float = 0.05
    n_pre_trigger: int = 4
    headroom: float = 1.6
    full_scale: tuple[float, float] | None = None
    bits: tuple[int, int] | None = (16, 16)
    noise_floor: tuple[float, float] = (0.0, 0.0)
    sensor_noise: tuple[float, float] = (0.0, 0.0)
    overload_reject: bool = True

    def __post_init__(self) -> None:
        _require(self.span > 0, "span above 0 Hz", self.span, "Give the highest frequency")
        _require(
            self.n_line > 0 and self.n_line % 25 == 0,
            "n_line as a positive multiple of 25",
            self.n_line,
            "Take 100, 200, 400 or 800",
        )
        for name in ("force_window", "exponential_window"):
            window = getattr(self, name)
            _require(window is None or window > 0, f"{name} above 0 s or none", window, "Leave it out for none")
        _require(self.n_average >= 1, "n_average of at least 1", self.n_average, "Make one hit or more")
        _require(self.estimator in ("H1", "H2"), "estimator H1 or H2", self.estimator, "Name one of these")
        _require(0 < self.trigger_level < 1, "trigger_level between 0 and 1", self.trigger_level, "Take 0.05")
        _require(
            0 <= self.n_pre_trigger <= self.n_line,
            f"n_pre_trigger from 0 to n_line, {self.n_line}",
            self.n_pre_trigger,
            "Take 4",
        )
        _require(self.headroom > 0, "headroom above 0", self.headroom, "Take 1.6")
        _require(
            self.full_scale is None or min(self.full_scale) > 0,
            "full_scale above 0 or none",
            self.full_scale,
            "Leave it out for auto-range",
        )
        _require(
            self.bits is None or (min(self.bits) >= 2 and max(self.bits) <= 32),
            "bits from 2 to 32 or none",
            self.bits,
            "Take 16",
        )
        for name in ("noise_floor", "sensor_noise"):
            _require(min(getattr(self, name)) >= 0, f"{name} of at least 0", getattr(self, name), "Take 0 for none")

    @property
    def record(self) -> float:
        """Length of one record [s]."""
        return self.n_line / self.span

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return RATE_PER_SPAN * self.span

    @property
    def n_sample(self) -> int:
        """Samples of one record."""
        return self.n_line * 64 // 25

    @property
    def frequency(self) -> Float[Tensor, " n_frequency"]:
        """The n_line + 1 lines [Hz], from 0 to span."""
        return torch.arange(self.n_line + 1, dtype=torch.float64) * (self.span / self.n_line)

    def low_pass(self, frequency: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
        """Anti-alias filter of linear phase, its delay taken out: 1 up to span, 0 from 1.56 span, a cosine between.

        From 1.56 span = sample_rate − span on, sampling would fold into the lines; what passes below that folds above
        them.
        """
        edge = ((frequency / self.span - 1) / (RATE_PER_SPAN - 2)).clamp(0, 1)
        return 0.5 + 0.5 * (torch.pi * edge).cos()

    def windows(self) -> tuple[Float[Tensor, " n_sample"], Float[Tensor, " n_sample"]]:
        """Window of the force channel and of the responses over the samples of a record [-]."""
        time = torch.arange(self.n_sample, dtype=torch.float64) / self.sample_rate
        force, response = torch.ones_like(time), torch.ones_like(time)
        if self.force_window is not None:
            # Half a sample of slack: Table 2's 8.78906 ms is nine samples, rounded.
            force = (time < self.force_window - 0.5 / self.sample_rate).to(time)
        if self.exponential_window is not None:
            response = (-time / self.exponential_window).exp()
        return force, response

    def with_noise(
        self,
        clean: Float[Tensor, "*batch n_sample"],
        full_scale: Float[Tensor, "*batch"],
        channel: int,
        generator: torch.Generator,
    ) -> Float[Tensor, "*batch n_sample"]:
        """The record with new white noise of the analyser and the sensor; channel 0 is the force, 1 a response."""
        white = torch.randn(clean.shape, generator=generator, dtype=clean.dtype, device=generator.device)
        rms = torch.hypot(self.noise_floor[channel] * full_scale, full_scale.new_tensor(self.sensor_noise[channel]))
        return clean + rms[..., None] * white.to(clean.device)

    def digitise(
        self, signal: Float[Tensor, "*batch n_sample"], full_scale: Float[Tensor, "*batch"], channel: int
    ) -> Float[Tensor, "*batch n_sample"]:
        """The signal in steps of 2 full_scale / 2^bits, clipped at full scale.

        The converter is taken to run at the record's own rate. A real one runs faster and averages some of its
        rounding out, so its floor lies lower than that of the same number of bits here.
        """
        if self.bits is None:
            return signal
        half = 2.0 ** (self.bits[channel] - 1)
        step = full_scale[..., None] / half
        return (signal / step).round().clamp(-half, half - 1) * step


def _require(holds: bool, expected: str, came: object, action: str) -> None:
    if not holds:
        raise ValueError(f"Expected an analyser with {expected}, got {came}. {action}.")


# Table 2 of the seed paper. What it does not print is ours: four samples before the trigger put the pulse in the middle
# of the force window's nine, and −80 dB of noise stands for analyser (−90 dB), ICP sensors and room together.
ANALYSERS: Final = {
    "sr785": Analyser(
        span=400.0,
        n_line=800,
        force_window=8.78906e-3,
        exponential_window=1.0,
        n_average=5,
        noise_floor=(1e-4, 1e-4),
    ),
}


class Spectra(NamedTuple):
    """Sums over hits of auto and cross spectra; their common scale drops out of FRF and coherence."""

    force: Float[Tensor, "n_reference n_frequency"]  # Σ |F|²
    response: Float[Tensor, "n_reference n_response n_frequency"]  # Σ |X|²
    cross: Complex[Tensor, "n_reference n_response n_frequency"]  # Σ F* X

    @classmethod
    def zeros(cls, analyser: Analyser, n_reference: int, n_response: int, device: torch.device) -> "Spectra":
        """No hit yet."""
        shape = (n_reference, n_response, analyser.n_line + 1)
        real = torch.zeros(shape, dtype=torch.float64, device=device)
        return cls(real[:, 0].clone(), real, torch.zeros_like(real, dtype=torch.complex128))

    def add(
        self,
        analyser: Analyser,
        hit_reference: Tensor,
        force: Float[Tensor, "n_hit n_sample"],
        response: Float[Tensor, "n_hit n_response n_sample"],
    ) -> "Spectra":
        """With the digitised records of more hits, each at the reference of that index; they are windowed here."""
        if len(hit_reference) == 0:
            # MKL refuses an FFT of nothing.
            return self
        window, response_window = (window.to(force) for window in analyser.windows())
        kept = slice(0, analyser.n_line + 1)
        f = torch.fft.rfft(force * window)[:, kept]
        x = torch.fft.rfft(response * response_window)[..., kept]
        return Spectra(
            self.force.index_add(0, hit_reference, f.abs() ** 2),
            self.response.index_add(0, hit_reference, x.abs() ** 2),
            self.cross.index_add(0, hit_reference, f.conj()[:, None] * x),
        )

    def frf(self, estimator: Estimator) -> Complex[Tensor, "n_reference n_response n_frequency"]:
        """H1 = Σ F*X / Σ |F|² or H2 = Σ |X|² / Σ X*F; 0 where nothing was read."""
        if estimator == "H1":
            return self.cross / _positive(self.force[:, None])
        return self.response * self.cross / _positive(self.cross.abs() ** 2)

    def coherence(self) -> Float[Tensor, "n_reference n_response n_frequency"]:
        """γ² = |Σ F*X|² / (Σ |F|² Σ |X|²), 0 to 1; 0 where nothing was read, and 1 for a single hit."""
        return (self.cross.abs() ** 2 / _positive(self.force[:, None] * self.response)).clamp(max=1.0)


def _positive(value: Tensor) -> Tensor:
    return value.clamp(min=torch.finfo(value.dtype).tiny)
