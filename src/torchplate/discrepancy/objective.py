"""How wide the gap is: registered measures, and the function of theta that a search minimises.

A measure takes FRFs of the model [*batch, n_frequency, n_response, n_reference] and of the measurement, and which pairs
were measured; it returns one number for each member.
"""

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.measurement import Measurement, NaturalFrequencies
from torchplate.model import PlateModel

Comparison = Callable[[Tensor, Tensor, Tensor], Tensor]


class Measure(NamedTuple):
    """How the gap is measured, and how a level without a unit is fitted first: both from (model, measured, pairs)."""

    gap: Comparison
    gain: Comparison


OBJECTIVES: dict[str, Measure] = {}


def register(gain: Comparison) -> Callable[[Comparison], Comparison]:
    """Enter a measure under its name, with the gain that suits it."""

    def enter(gap: Comparison) -> Comparison:
        OBJECTIVES[gap.__name__] = Measure(gap, gain)
        return gap

    return enter


def complex_gain(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"],
    measured: Complex[Tensor, "n_frequency n_response n_reference"],
    pairs: Bool[Tensor, "n_response n_reference"],
) -> Float[Tensor, "*batch"]:
    """The real level g that minimises Σ_r ‖H_measured,r − g H_model,r‖² / ‖H_measured,r‖², not below 0."""
    return _projected((model.conj() * measured).real, model, measured, pairs).clamp(min=0.0)


def amplitude_gain(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"],
    measured: Complex[Tensor, "n_frequency n_response n_reference"],
    pairs: Bool[Tensor, "n_response n_reference"],
) -> Float[Tensor, "*batch"]:
    """The level g that minimises Σ_r ‖|H_measured,r| − g |H_model,r|‖² / ‖H_measured,r‖²."""
    return _projected(model.abs() * measured.abs(), model, measured, pairs)


def log_gain(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"],
    measured: Complex[Tensor, "n_frequency n_response n_reference"],
    pairs: Bool[Tensor, "n_response n_reference"],
) -> Float[Tensor, "*batch"]:
    """The level g that minimises Σ (ln |H_measured| − ln g |H_model|)²: the geometric mean of the ratios."""
    kept = pairs & (measured != 0) & (model != 0)
    ratio = torch.where(kept, (measured / torch.where(kept, model, 1.0)).abs(), 1.0)
    return (ratio.log().sum((-3, -2, -1)) / kept.sum((-3, -2, -1))).exp()


def _projected(cross: Tensor, model: Tensor, measured: Tensor, pairs: Tensor) -> Tensor:
    """Σ cross / Σ |model|², each FRF weighed by one over its squared norm."""
    weight = torch.where(pairs, 1 / measured.abs().square().sum(0), 0.0)
    own = (model.abs().square().sum(-3) * weight).sum((-2, -1))
    return (cross.sum(-3) * weight).sum((-2, -1)) / own


@register(complex_gain)
def relative_frf_norm(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"],
    measured: Complex[Tensor, "n_frequency n_response n_reference"],
    pairs: Bool[Tensor, "n_response n_reference"],
) -> Float[Tensor, "*batch"]:
    """Σ_r ‖H_measured,r − H_model,r‖ / ‖H_measured,r‖ over the FRFs r, complex [-]. Source: seed paper, Eq. 22."""
    return _relative(model - measured, measured, pairs)


@register(amplitude_gain)
def relative_amplitude_norm(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"],
    measured: Complex[Tensor, "n_frequency n_response n_reference"],
    pairs: Bool[Tensor, "n_response n_reference"],
) -> Float[Tensor, "*batch"]:
    """Σ_r ‖|H_measured,r| − |H_model,r|‖ / ‖H_measured,r‖ [-]. Source: seed paper, Eq. 22 on amplitudes."""
    return _relative(model.abs() - measured.abs(), measured, pairs)


@register(log_gain)
def log_amplitude(
    model: Complex[Tensor, "*batch n_frequency n_response n_reference"],
    measured: Complex[Tensor, "n_frequency n_response n_reference"],
    pairs: Bool[Tensor, "n_response n_reference"],
) -> Float[Tensor, "*batch"]:
    """Root mean square of ln |H_model| − ln |H_measured| over lines and FRFs [Np]; peaks and valleys weigh alike.

    Lines at which either is exactly zero (an accelerance at 0 Hz) say nothing and are left out. Source: Balmès,
    "Frequency domain identification of structural dynamics using the pole/residue parametrization", IMAC (1996),
    logarithmic cost.
    """
    kept = pairs & (measured != 0) & (model != 0)
    reference = torch.where(kept, measured, 1.0)
    difference = torch.where(kept, (model / reference).abs(), 1.0).log()
    return (difference.square().sum((-3, -2, -1)) / kept.sum((-3, -2, -1))).sqrt()


def natural_frequency_error(
    model: Float[Tensor, "*batch n_mode"], measured: Float[Tensor, " n_mode"]
) -> Float[Tensor, "*batch"]:
    """√(mean over modes of ((f_model − f_measured) / f_measured)²) [-]. Source: Friswell, Mottershead (1995)."""
    return (model / measured - 1).square().mean(-1).sqrt()


@dataclass(frozen=True)
class Evidence:
    """What was measured, as an objective sees it.

    Args:
        measurement: FRFs, already cut to their band; or None.
        natural_frequencies: a table, or None.
        gain_is_unknown: the level of the FRFs carries no unit, and one factor for all of them is fitted.

    Raises:
        ValueError: if both are None.
    """

    measurement: Measurement | None = None
    natural_frequencies: NaturalFrequencies | None = None
    gain_is_unknown: bool = False

    def __post_init__(self) -> None:
        if self.measurement is None and self.natural_frequencies is None:
            raise ValueError("Expected FRFs or natural frequencies to compare with, got neither. Give a measurement.")


class Objective:
    """The gap as a function of theta: what a search minimises.

    Args:
        model: whose searched parameters theta holds; its responses and references are those of the measurement.
        evidence: what was measured. A table of natural frequencies adds its own error to that of the FRFs.
        kind: a key of OBJECTIVES; only FRFs have a choice.

    Raises:
        KeyError: if no measure has that name.
    """

    def __init__(self, model: PlateModel, evidence: Evidence, kind: str = "relative_frf_norm") -> None:
        self.model, self.evidence, self.kind = model, evidence, kind
        self.measure = find_objective(kind)
        if evidence.measurement is not None:
            self._frequency = evidence.measurement.frequency.to(model.known)
            self._frf = evidence.measurement.frf.to(model.known.device)
            self._pairs = evidence.measurement.measured.to(model.known.device)
        if evidence.natural_frequencies is not None:
            self._mode = evidence.natural_frequencies.mode.to(model.known.device) - 1
            self._table = evidence.natural_frequencies.frequency.to(model.known)

    def __call__(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """The gap of each member."""
        total = theta.new_zeros(theta.shape[:-1])
        if self.evidence.measurement is not None:
            total = total + self.measure.gap(self.frf(theta), self._frf, self._pairs)
        if self.evidence.natural_frequencies is not None:
            total = total + natural_frequency_error(self.natural_frequencies(theta), self._table)
        return total

    def frf(self, theta: Float[Tensor, "*batch n_parameter"]) -> Complex[Tensor, "*batch n_f n_response n_reference"]:
        """What the model predicts for the measured FRFs, at the fitted level where the gain is unknown."""
        frf = self.model.frf(theta, self._frequency)
        if not self.evidence.gain_is_unknown:
            return frf
        return self.measure.gain(frf, self._frf, self._pairs)[..., None, None, None] * frf

    def gain(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """The fitted level of the readings over SI units."""
        return self.measure.gain(self.model.frf(theta, self._frequency), self._frf, self._pairs)

    def natural_frequencies(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n_mode"]:
        """What the model predicts for the measured natural frequencies [Hz]."""
        return self.model.natural_frequencies(theta, int(self._mode.max()) + 1)[..., self._mode]

    def gap(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """Mean over FRFs of ‖measured − model‖ / ‖measured‖ [-]; without FRFs the natural-frequency error."""
        if self.evidence.measurement is None:
            return self(theta)
        return relative_frf_norm(self.frf(theta), self._frf, self._pairs) / self._pairs.sum()

    def residual(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n_residual"]:
        """Every relative deviation as a real number: of FRFs (real and imaginary part), then of natural frequencies.

        Each FRF is divided by its own norm, each natural frequency by the measured one, so that the sum of squares is
        that of what `relative_frf_norm` and `natural_frequency_error` sum.
        """
        parts = []
        if self.evidence.measurement is not None:
            scale = torch.where(self._pairs, 1 / self._frf.abs().square().sum(0).sqrt(), 0.0)
            relative = (self.frf(theta) - self._frf) * scale
            kept = relative.flatten(-2)[..., self._pairs.flatten()].flatten(-2)
            parts += [kept.real, kept.imag]
        if self.evidence.natural_frequencies is not None:
            parts.append(self.natural_frequencies(theta) / self._table - 1)
        return torch.cat(parts, dim=-1)


def find_objective(kind: str) -> Measure:
    """The measure of that name.

    Raises:
        KeyError: if there is none, with the nearest name.
    """
    if kind not in OBJECTIVES:
        near = difflib.get_close_matches(kind, OBJECTIVES, n=1)
        guess = f" Did you mean '{near[0]}'?" if near else ""
        raise KeyError(f"No objective named '{kind}'.{guess} There are: {', '.join(OBJECTIVES)}.")
    return OBJECTIVES[kind]


def _relative(difference: Tensor, measured: Tensor, pairs: Tensor) -> Tensor:
    """Σ over measured pairs of ‖difference‖ / ‖measured‖, norms over the lines."""
    norm = measured.abs().square().sum(0).sqrt()
    ratio = difference.abs().square().sum(-3).sqrt() / torch.where(pairs, norm, 1.0)
    return torch.where(pairs, ratio, 0.0).sum((-2, -1))
