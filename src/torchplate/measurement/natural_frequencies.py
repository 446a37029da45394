"""A table of measured natural frequencies, such as Table 5 of the seed paper."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from itertools import pairwise
from typing import Final

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchplate.measurement.measurement import MeasurementError
from torchplate.notation import percent

# How far natural frequencies of a careful test scatter, relative [-]: the grid of the lines, the temperature, what
# hangs on the plate. Repeated tests of one plate by one team agree to about this.
SCATTER: Final = 1e-3
# Nobody prints a frequency with fewer digits.
LEAST_DIGITS: Final = 3


@dataclass(frozen=True, eq=False)
class NaturalFrequencies:
    """Measured natural frequencies by mode number, rigid-body modes included in the count.

    Args:
        mode: Mode numbers, counted from 1, rising. Gaps are modes that were not found.
        frequency: Natural frequencies [Hz], > 0, never falling with the mode number (repeated modes are
            equal).
        std: Standard deviations of the frequencies [Hz], > 0, NaN where a mode has none; None where none has.

    Raises:
        MeasurementError: An empty table, a mode below 1 or named twice, a frequency that is not positive or
            that falls while the mode number rises, a standard deviation that is not positive.
    """

    mode: Int[Tensor, " n_mode"]
    frequency: Float[Tensor, " n_mode"]
    std: Float[Tensor, " n_mode"] | None = None

    def __post_init__(self) -> None:
        where = "Expected in natural_frequencies"
        example = "Write it as {1: 4.5, 6: 70.5}: mode number (from 1, rigid-body modes included): Hz."
        modes, values = self.mode.tolist(), self.frequency.tolist()
        if len(modes) != len(values) or not modes:
            raise MeasurementError(
                f"{where} one frequency per mode, got {len(modes)} modes and {len(values)}. {example}"
            )
        if min(modes) < 1:
            raise MeasurementError(f"{where} mode numbers counted from 1, got {min(modes)}. {example}")
        if any(b <= a for a, b in pairwise(modes)):
            raise MeasurementError(f"{where} each mode once and in rising order, got {modes}. {example}")
        for m, f in zip(modes, values, strict=True):
            if not 0.0 < f < float("inf"):
                raise MeasurementError(f"{where} positive frequencies in Hz, got {f:g} for mode {m}. {example}")
        for i in range(1, len(values)):
            if values[i] < values[i - 1]:
                raise MeasurementError(
                    f"{where} frequencies that rise with the mode number, got {values[i - 1]:g} Hz for mode "
                    f"{modes[i - 1]} and {values[i]:g} Hz for mode {modes[i]}. Exchange or renumber them."
                )
        for m, s in zip(modes, [] if self.std is None else self.std.tolist(), strict=self.std is not None):
            if s <= 0 or s == float("inf"):
                raise MeasurementError(
                    f"{where} positive standard deviations in Hz, got {s:g} for mode {m}. Leave out a std that is not "
                    "known."
                )

    @classmethod
    def from_mapping(cls, table: Mapping[int, float], std: Mapping[int, float] | None = None) -> "NaturalFrequencies":
        """Build the table from {mode number: frequency [Hz]}, in any order; std [Hz] likewise, for some modes."""
        modes = sorted(table)
        values = [float(table[m]) for m in modes]
        spread = torch.tensor([(std or {}).get(m, float("nan")) for m in modes], dtype=torch.float64) if std else None
        return cls(torch.tensor(modes, dtype=torch.int64), torch.tensor(values, dtype=torch.float64), spread)

    def to(self, device: torch.device | str) -> "NaturalFrequencies":
        """Move every tensor to `device`."""
        spread = None if self.std is None else self.std.to(device)
        return replace(self, mode=self.mode.to(device), frequency=self.frequency.to(device), std=spread)


def printed_unit(table: NaturalFrequencies) -> Float[Tensor, " n_mode"]:
    """One unit of the last printed digit of each entry [Hz].

    A table is printed with one number of decimals or one number of digits, and a number that is read has lost the zeros
    at its end. So it has as many decimals as the entry with most, and as many digits, 3 at least; the coarser counts.
    """
    entries = [Decimal(repr(value)).normalize().as_tuple() for value in table.frequency.tolist()]
    decimals = max(0, *(-one.exponent for one in entries if isinstance(one.exponent, int)))
    digits = max(LEAST_DIGITS, *(len(one.digits) for one in entries))
    by_digits = 10.0 ** (table.frequency.log10().floor() - digits + 1)
    return by_digits.clamp(min=10.0**-decimals)


def with_std(table: NaturalFrequencies) -> NaturalFrequencies:
    """The table with a standard deviation for every entry.

    Where none is given: √(s² f² + u² / 12), s = `SCATTER`, u the unit of the last printed digit: rounding leaves half a
    unit at most, evenly spread.
    """
    default = torch.hypot(SCATTER * table.frequency, printed_unit(table) / 12**0.5)
    if table.std is None:
        return replace(table, std=default)
    return replace(table, std=torch.where(table.std.isnan(), default, table.std))


def assumed(table: NaturalFrequencies) -> str:
    """What is assumed of the scatter, in one sentence; empty where every entry has a standard deviation."""
    if table.std is not None and not bool(table.std.isnan().any()):
        return ""
    rounding = float(printed_unit(table).max()) / math.sqrt(12)
    which = "The table gives no standard deviation:" if table.std is None else "Where the table gives none,"
    # Frequencies that were computed have all their digits.
    seen = rounding > SCATTER**2 * float(table.frequency.min())
    rounded = f", and of up to {rounding:.2g} Hz, the rounding to the printed digits" if seen else ""
    return (
        f"{which} a standard deviation of {percent(SCATTER)} is assumed, the scatter of a careful test{rounded}. "
        "Give {value: , std: } where you know better."
    )
