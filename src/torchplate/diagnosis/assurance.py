"""The assurance criteria of the field, one by one: FRAC of each FRF, CSAC and CSF of each line, FDAC of pairs of lines.

The formulas are those of `discrepancy.assurance`, which takes their means: each FRF, each line and each pair of lines
stands here as a measurement of its own.
"""

from typing import Final

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.discrepancy import Measured, csac, csf, frac
from torchplate.measurement import Measurement

# Lines along each side of an FDAC, at most: more cannot be told apart on paper.
N_LINE: Final = 200


def frac_by_channel(
    measurement: Measurement, predicted: Complex[Tensor, "n_frequency n_response n_reference"]
) -> Float[Tensor, "n_response n_reference"]:
    """Frequency response assurance criterion of every FRF [-], 0 to 1: 1 where its course is right, whatever its level.

    FRAC = |Σ H_measured* H_model|² / (Σ |H_measured|² Σ |H_model|²), sums over the lines. 0 where an FRF was not
    measured.

    Args:
        measurement: what was measured.
        predicted: the model's FRFs, in its unit.

    Source: `discrepancy.assurance.frac`.
    """
    measured, modelled = (frf.movedim(0, -1)[..., None, None] for frf in (measurement.frf, predicted))
    return 1 - frac(modelled, Measured(measured, measurement.measured.new_ones(1, 1)))


def csac_by_line(
    measurement: Measurement, predicted: Complex[Tensor, "n_frequency n_response n_reference"]
) -> Float[Tensor, " n_frequency"]:
    """Cross signature assurance criterion of every line [-], 0 to 1: 1 where the operating shape is right.

    CSAC = |Hᴴ_measured H_model|² / (‖H_measured‖² ‖H_model‖²), products over the measured FRFs at one line: the level
    does not count, and with a single FRF it is always 1. 0 at a line where either is exactly zero.

    Args:
        measurement: what was measured.
        predicted: the model's FRFs, in its unit.

    Source: `discrepancy.assurance.csac`.
    """
    return 1 - csac(predicted[:, None], Measured(measurement.frf[:, None], measurement.measured))


def csf_by_line(
    measurement: Measurement, predicted: Complex[Tensor, "n_frequency n_response n_reference"]
) -> Float[Tensor, " n_frequency"]:
    """Cross signature scale factor of every line [-], 0 to 1: 1 where the operating shape and its level are right.

    CSF = 2 |Hᴴ_measured H_model| / (‖H_measured‖² + ‖H_model‖²), products over the measured FRFs at one line. 0 at a
    line where either is exactly zero.

    Args:
        measurement: what was measured.
        predicted: the model's FRFs, in its unit.

    Source: `discrepancy.assurance.csf`.
    """
    return 1 - csf(predicted[:, None], Measured(measurement.frf[:, None], measurement.measured))


def fdac(
    measurement: Measurement, predicted: Complex[Tensor, "n_frequency n_response n_reference"]
) -> Float[Tensor, "n_line_model n_line_measured"]:
    """Frequency domain assurance criterion of every line of the model with every measured one [-], 0 to 1.

    FDAC(ω_a, ω_e) = |H_model(ω_a)ᴴ H_measured(ω_e)|² / (‖H_model(ω_a)‖² ‖H_measured(ω_e)‖²), products over the measured
    FRFs. Its diagonal is the CSAC. Where the model has the right shapes at wrong frequencies, the ridge of ones leaves
    the diagonal for those at which it has them. With a single FRF it is always 1.

    Args:
        measurement: what was measured.
        predicted: the model's FRFs, in its unit, at its lines.

    Returns:
        The criterion at the lines of `fdac_frequency`, the model's first.

    Source: Pascual, Golinval and Razeto, "A frequency domain correlation technique for model correlation and updating",
    IMAC (1997), there for one column of FRFs at a time.
    """
    measured = Measured(measurement.frf[_kept(measurement), None], measurement.measured)
    # Row by row: all at once would hold every FRF at every pair of lines.
    rows = [csac(line.expand_as(measured.frf), measured) for line in predicted[_kept(measurement)]]
    return 1 - torch.stack(rows)


def fdac_frequency(measurement: Measurement) -> Float[Tensor, " n_line"]:
    """Lines of `fdac` [Hz]: all, or every second, third, ... of them, so that no more than 200 are left."""
    return measurement.frequency[_kept(measurement)]


def _kept(measurement: Measurement) -> slice:
    """Evenly thinned lines."""
    return slice(None, None, -(-len(measurement.frequency) // N_LINE))
