"""What a test is not perfect in: how far places, levels, frequencies and damping scatter from what the sheet says.

Every test has these and nobody wants them named. A config tells how large they are (`measurement.position_std` and so
on); where it says nothing, the default of a careful test stands, and how well that is known is said with it.
"""

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Imperfections:
    """Standard deviations of what is not perfect; None where nobody told, 0 where there is none.

    Args:
        position_std: of each hit and each sensor from its mark, along each side [m].
        frequency_drift: of all natural frequencies from record to record, relative [-]: temperature, mounting.
        calibration_std: of the level of each channel, relative [-].
        damping_scatter: of each mode's damping from the law that the model has for it, relative [-].
        thickness_scatter: of the plate's thickness from place to place about its mean, relative [-]. It is of the plate
            and not of the test, so that a world without imperfections of a test may have it or not.

    Raises:
        ValueError: if one is negative or not finite.
    """

    position_std: float | None = None
    frequency_drift: float | None = None
    calibration_std: float | None = None
    damping_scatter: float | None = None
    thickness_scatter: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and not 0 <= value < float("inf"):
                raise ValueError(f"Expected {field.name} of 0 or more, got {value:g}. Give a standard deviation.")

    def told(self, name: str) -> bool:
        """Whether somebody said how large it is."""
        return getattr(self, name) is not None

    def std(self, name: str) -> float:
        """What was told, or the default of a careful test."""
        value = getattr(self, name)
        return float(getattr(CAREFUL, name) if value is None else value)


# A hit within a millimetre of its mark; half a kelvin of drift in a metal (d ln f / dT about -2e-4 per kelvin);
# transducers calibrated to a per cent; damping that no law hits better than a tenth; a thickness that cold rolling
# keeps to half a per cent within a sheet.
CAREFUL = Imperfections(
    position_std=1e-3, frequency_drift=1e-4, calibration_std=0.01, damping_scatter=0.1, thickness_scatter=5e-3
)
PERFECT = Imperfections(0.0, 0.0, 0.0, 0.0)
