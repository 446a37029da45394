"""The function of theta that a search minimises, and its residuals for least squares."""

from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.discrepancy.covariance import Rows
from torchplate.discrepancy.measure import Measured, check_suits, find_objective
from torchplate.discrepancy.modal_evidence import ModalEvidence
from torchplate.discrepancy.natural_frequency import mode_weight, natural_frequency_error
from torchplate.discrepancy.norms import relative_frf_norm
from torchplate.measurement import Measurement, NaturalFrequencies
from torchplate.model import PlateModel


@dataclass(frozen=True)
class Evidence:
    """What was measured, as an objective sees it.

    Args:
        measurement: FRFs, already cut to their band; or None.
        natural_frequencies: a table, or None.
        gain_is_unknown: the level of the FRFs carries no unit, and one factor for all of them is fitted.
        n_average: records behind each FRF, > 1, with which its coherence says how noisy it is; None if not known.
        modal_model: natural frequencies with their mode shapes, instead of a table; or None.

    Raises:
        ValueError: if all are None, there are both a table and a modal model, or n_average is 1, at which every
            coherence is 1.
    """

    measurement: Measurement | None = None
    natural_frequencies: NaturalFrequencies | None = None
    gain_is_unknown: bool = False
    n_average: int | None = None
    modal_model: ModalEvidence | None = None

    def __post_init__(self) -> None:
        if self.natural_frequencies is not None and self.modal_model is not None:
            raise ValueError(
                "Expected natural_frequencies or a modal_model, which has its own, got both. Take one of them out."
            )
        if self.measurement is None and self.natural_frequencies is None and self.modal_model is None:
            raise ValueError("Expected FRFs or natural frequencies to compare with, got neither. Give a measurement.")
        if self.n_average is not None and self.n_average < 2:
            raise ValueError(
                f"Expected n_average of 2 or more, got {self.n_average}: the coherence of a single record is always 1. "
                "Leave it out."
            )


class Objective:
    """The gap as a function of theta: what a search minimises.

    Args:
        model: whose searched parameters theta holds; its responses and references are those of the measurement.
        evidence: what was measured. A table of natural frequencies, or a modal model, adds its own error to that of
            the FRFs.
        kind: a key of OBJECTIVES; only FRFs have a choice.
        natural_frequency_weight: factor on the error of the natural frequencies, or of the modal model, > 0.

    Raises:
        KeyError: if no measure has that name.
        ValueError: if the measure can say nothing of these FRFs; see `measure.check_suits`.
    """

    def __init__(
        self,
        model: PlateModel,
        evidence: Evidence,
        kind: str = "relative_frf_norm",
        natural_frequency_weight: float = 1.0,
    ) -> None:
        self.model, self.evidence, self.kind = model, evidence, kind
        self.natural_frequency_weight = natural_frequency_weight
        self.measure = find_objective(kind)
        if evidence.measurement is not None:
            check_suits(kind, evidence.measurement)
            self._frequency = evidence.measurement.frequency.to(model.known)
            self._measured = Measured.of(evidence.measurement.to(model.known.device))
        if evidence.natural_frequencies is not None:
            table = evidence.natural_frequencies.to(model.known.device)
            self._mode, self._table, self._mode_weight = table.mode - 1, table.frequency, mode_weight(table)
        modal = evidence.modal_model
        self._modal = None if modal is None else modal.to(model.known.device)

    def of(self, model: PlateModel) -> "Objective":
        """The same objective of another model."""
        return Objective(model, self.evidence, self.kind, self.natural_frequency_weight)

    def on(self, device: torch.device | str) -> "Objective":
        """The same objective with its tensors on `device`; this one's stay where they are."""
        return self.of(self.model.on(device))

    def __call__(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """The gap of each member."""
        total = theta.new_zeros(theta.shape[:-1])
        if self.evidence.measurement is not None:
            total = total + self.measure.gap(self.frf(theta), self._measured)
        if self.evidence.natural_frequencies is not None:
            total = total + self.natural_frequency_weight * self._natural_frequency_error(theta)
        if self._modal is not None:
            total = total + self.natural_frequency_weight * self._modal.error(self.model, theta)
        return total

    def _natural_frequency_error(self, theta: Tensor) -> Tensor:
        return natural_frequency_error(self.natural_frequencies(theta), self._table, self._mode_weight)

    def frf(self, theta: Float[Tensor, "*batch n_parameter"]) -> Complex[Tensor, "*batch n_f n_response n_reference"]:
        """What the model predicts for the measured FRFs, at the fitted level where the gain is unknown."""
        frf = self.model.frf(theta, self._frequency)
        if not self.evidence.gain_is_unknown:
            return frf
        return self.measure.gain(frf, self._measured)[..., None, None, None] * frf

    def gain(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """The fitted level of the readings over SI units."""
        return self.measure.gain(self.model.frf(theta, self._frequency), self._measured)

    def natural_frequencies(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n_mode"]:
        """What the model predicts for the measured natural frequencies [Hz]."""
        return self.model.natural_frequencies(theta, int(self._mode.max()) + 1)[..., self._mode]

    def gap(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """Mean over FRFs of ‖measured − model‖ / ‖measured‖ [-]; without FRFs the natural-frequency error."""
        if self.evidence.measurement is None and self._modal is not None:
            return self._modal.frequency_error(self.model, theta)
        if self.evidence.measurement is None:
            return self._natural_frequency_error(theta)
        return relative_frf_norm(self.frf(theta), self._measured) / self._measured.pairs.sum()

    def turned_gap(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """The gap to FRFs of the other sign [-]; 1 where the level that is fitted then is none."""
        frf = self.model.frf(theta, self._frequency)
        level = self.measure.gain(-frf, self._measured) if self.evidence.gain_is_unknown else frf.new_ones(()).real
        return relative_frf_norm(-level[..., None, None, None] * frf, self._measured) / self._measured.pairs.sum()

    def mirrored_gap(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """The gap to FRFs whose phases are mirrored, as of the time dependence exp(−iωt) [-]."""
        frf = self.model.frf(theta, self._frequency).conj().resolve_conj()
        level = self.measure.gain(frf, self._measured) if self.evidence.gain_is_unknown else frf.new_ones(()).real
        return relative_frf_norm(level[..., None, None, None] * frf, self._measured) / self._measured.pairs.sum()

    def residual(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n_residual"]:
        """Deviations as real numbers, for least squares: of FRFs, line by line, then of natural frequencies and shapes.

        FRFs deviate as the measure says (`measure.deviation`); each natural frequency by
        natural_frequency_weight · w (f_model − f_measured) / f_measured, w of `mode_weight`; a modal model as
        `modal_evidence` says.
        """
        parts = []
        if self.evidence.measurement is not None:
            deviation = self.measure.deviation.residual(self.frf(theta), self._measured)
            kept = deviation.flatten(-3, -2)[..., self._measured.pairs.flatten(), :]
            parts.append(kept.flatten(-3))
        if self.evidence.natural_frequencies is not None:
            weight = self.natural_frequency_weight * self._mode_weight
            parts.append(weight * (self.natural_frequencies(theta) / self._table - 1))
        if self._modal is not None:
            parts.append(self.natural_frequency_weight * self._modal.residual(self.model, theta))
        return torch.cat(parts, dim=-1)

    def rows(self, theta: Float[Tensor, " n_parameter"]) -> Rows:
        """What each residual belongs to, and what the measurement says of its noise.

        An FRF's noise in the real and in the imaginary part is known where its coherence γ² and the number of averages
        are: σ² = |H|² (1 − γ²) / (2 (n_average − 1) γ²). With the γ² of these very averages, n_average − 1 makes it the
        unbiased estimate, where Bendat and Piersol's Table 9.6 has the γ² of infinitely many and n_average.

        Where the same coherence also weighs the lines (`coherence_weighted`), lines that seem quiet by chance weigh
        more: the variance of the estimate is then (n_average − 1) / (n_average − 3) times as large, for a weight 1/σ²
        has E[1/σ²] = m/(m − 1) and E[1/σ⁴] = m²/((m − 1)(m − 2)) with m = n_average − 1 (gamma distribution).
        """
        groups: list[Tensor] = []
        slopes: list[Tensor] = []
        amplitudes: list[Tensor] = []
        variances: list[Tensor] = []
        n_group = 0
        if self.evidence.measurement is not None:
            pairs, n_group = self._measured.pairs, int(self._measured.pairs.sum())
            frf, slope = self.frf(theta)[:, pairs], self.measure.deviation.slope(self._measured)[:, pairs]
            n_part = self.measure.deviation.residual(frf.new_zeros(self._measured.frf.shape), self._measured).shape[-1]
            for whole, part in (
                (groups, torch.arange(n_group, device=frf.device).expand(len(frf), n_group)),
                (slopes, slope),
                (amplitudes, frf.abs()),
                (variances, slope.square() * self._frf_variance()[:, pairs]),
            ):
                whole.append(part[..., None].expand(*part.shape, n_part).flatten())
        if (table := self.evidence.natural_frequencies) is not None:
            scale = self.natural_frequency_weight * self._mode_weight
            std = torch.full_like(scale, torch.nan) if table.std is None else table.std.to(scale)
            groups.append(torch.full_like(self._mode, n_group))
            slopes.append(scale)
            amplitudes.append(torch.zeros_like(scale))
            variances.append((scale * std / self._table).square())
        if self._modal is not None:
            variance, group = self._modal.variance()
            groups.append(n_group + group)
            slopes.append(torch.full_like(variance, self.natural_frequency_weight))
            amplitudes.append(torch.zeros_like(variance))
            variances.append(self.natural_frequency_weight**2 * variance)
        return Rows(*(torch.cat(parts) for parts in (groups, slopes, amplitudes, variances)))

    def _frf_variance(self) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Variance of the real and of the imaginary part of each measured FRF; NaN where it is not known."""
        n_average, precision = self.evidence.n_average, self._measured.precision
        weighed = self.measure.needs_coherence
        if precision is None or n_average is None or (weighed and n_average < 4):
            return torch.full_like(self._measured.frf.real, torch.nan)
        variance = 1 / (2 * (n_average - 1) * torch.where(precision > 0, precision, torch.nan))
        return variance * (n_average - 1) / (n_average - 3) if weighed else variance

    def estimating_weight(self, residual: Float[Tensor, " n_residual"], rows: Rows) -> Float[Tensor, " n_residual"]:
        """W of the equations Jᵀ W r = 0 that hold where this objective is least, up to a factor.

        A norm ‖r‖ has the gradient Jᵀr / ‖r‖, so a sum of norms weighs the residuals of each by one over it; a measure
        without residuals of its own counts as least squares, W = 1.
        """
        if self.measure.norm == "other":
            return torch.ones_like(residual)
        n_pair = 0 if self.evidence.measurement is None else int(self._measured.pairs.sum())
        # Frequencies and shapes of a modal model are one norm.
        joined = rows.group.clamp(max=n_pair)
        if self.measure.norm == "joint":
            joined = joined.clamp(min=n_pair - 1)
        square = residual.new_zeros(n_pair + 1).index_add(0, joined, residual.square())
        norm = square.sqrt()
        if self.evidence.natural_frequencies is not None:
            norm[-1] = norm[-1] * len(self._mode) ** 0.5
        if self._modal is not None:
            norm[-1] = norm[-1] * len(self._modal.modal.frequency) ** 0.5
        # Residuals that are all zero leave no weight to choose.
        return 1 / norm.clamp(min=1e-12 * float(norm.max()) or 1.0)[joined]
