"""What a measure of the gap between FRFs is, and the registry of them all.

A measure compares FRFs of the model [*batch, n_frequency, n_response, n_reference] with what was measured, and gives
one number for each member. Beside the number it has a level (the gain of a measurement without a unit), and residuals
for least squares.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.measurement import Measurement
from torchplate.nearest import did_you_mean

# A coherence above 1 − this is not believed: what is then left is not noise, and one line would outweigh all others.
INCOHERENT = 1e-4


class Measured(NamedTuple):
    """Measured FRFs, as a measure sees them.

    Attributes:
        frf: zero where a pair was not measured.
        pairs: which were.
        precision: γ² / ((1 − γ²) |H|²), by which the coherence γ² weighs a line: its inverse is in proportion to the
            variance of H. Zero where there is no coherence or no FRF; None where the measurement holds none at all.
    """

    frf: Complex[Tensor, "n_frequency n_response n_reference"]
    pairs: Bool[Tensor, "n_response n_reference"]
    precision: Float[Tensor, "n_frequency n_response n_reference"] | None = None

    @classmethod
    def of(cls, measurement: Measurement) -> "Measured":
        """What a measure needs of a measurement.

        Precision is that of an H1 estimate, var |H| / |H|² = (1 − γ²) / (2 n_average γ²). Source: Bendat and Piersol,
        Random Data (2010), Table 9.6. A coherence above 0.9999 counts as 0.9999.
        """
        # Lines side by side in memory, as the model's FRFs have them: in a search they are compared again and again.
        frf = measurement.frf.movedim(0, -1).contiguous().movedim(-1, 0)
        if measurement.coherence is None:
            return cls(frf, measurement.measured)
        coherence = measurement.coherence.to(measurement.frf.real.dtype).clamp(max=1 - INCOHERENT)
        power = measurement.frf.abs().square()
        known = measurement.measured & (coherence > 0) & (power > 0)  # NaN is not above 0
        safe = torch.where(known, coherence, 0.5)
        precision = safe / ((1 - safe) * torch.where(known, power, 1.0))
        return cls(frf, measurement.measured, torch.where(known, precision, 0.0))


Comparison = Callable[[Tensor, Measured], Tensor]


class Deviation(NamedTuple):
    """The residuals of a measure.

    Attributes:
        residual: (model, measured) → [*batch, n_frequency, n_response, n_reference, n_part], zero at unmeasured pairs.
        slope: measured → [n_frequency, n_response, n_reference]: by how much a residual moves with its FRF; noise of
            standard deviation σ in the real and in the imaginary part of H has slope · σ in each residual.
    """

    residual: Comparison
    slope: Callable[[Measured], Tensor]


class Measure(NamedTuple):
    """How the gap is measured.

    Attributes:
        gap: (model, measured) → the number that is minimised.
        gain: (model, measured) → the level that is fitted first where it carries no unit.
        deviation: the residuals that a least-squares fit makes small.
        norm: what the gap is of the residuals' norms: "each" sums one for each FRF, "joint" takes one over all, "other"
            is a measure without residuals of its own; its least-squares fit takes the complex relative ones.
        sees_level: False where a factor on the model's FRFs changes nothing.
        least_frf: number of FRFs below which the measure says nothing.
        needs_coherence: whether every FRF needs one.
    """

    gap: Comparison
    gain: Comparison
    deviation: Deviation
    norm: Literal["each", "joint", "other"]
    sees_level: bool = True
    least_frf: int = 1
    needs_coherence: bool = False


OBJECTIVES: dict[str, Measure] = {}


def register(
    gain: Comparison,
    deviation: Deviation,
    norm: Literal["each", "joint", "other"],
    *,
    sees_level: bool = True,
    least_frf: int = 1,
    needs_coherence: bool = False,
) -> Callable[[Comparison], Comparison]:
    """Enter a measure under its name; see `Measure`."""

    def enter(gap: Comparison) -> Comparison:
        OBJECTIVES[gap.__name__] = Measure(gap, gain, deviation, norm, sees_level, least_frf, needs_coherence)
        return gap

    return enter


def find_objective(kind: str) -> Measure:
    """The measure of that name.

    Raises:
        KeyError: if there is none, with the nearest name.
    """
    if kind not in OBJECTIVES:
        raise KeyError(
            f"No objective named '{kind}'.{did_you_mean(kind, OBJECTIVES)} There are: {', '.join(OBJECTIVES)}."
        )
    return OBJECTIVES[kind]


def check_suits(kind: str, measurement: Measurement) -> None:
    """Whether a measure can say something of these FRFs.

    Raises:
        ValueError: if there are too few, or one of them lacks the coherence that the measure needs.
    """
    measure = find_objective(kind)
    if (n_frf := len(measurement.pairs)) < measure.least_frf:
        raise ValueError(
            f"Expected at least {measure.least_frf} FRFs for {kind}, got {n_frf}: over a single FRF the criterion is 1 "
            "at every line, whatever the model. Measure more, or take relative_frf_norm or frac."
        )
    if not measure.needs_coherence:
        return
    advice = "Export the coherence with the FRFs, or take relative_frf_norm."
    if measurement.coherence is None:
        raise ValueError(f"Expected FRFs with a coherence for {kind}, got none in the measurement. {advice}")
    for j, k in measurement.pairs:
        if not bool((measurement.coherence[:, j, k] > 0).any()):
            label = measurement.pair_label(j, k)
            raise ValueError(f"Expected a coherence for every FRF for {kind}, got none for {label}. {advice}")
