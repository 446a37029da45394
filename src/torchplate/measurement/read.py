"""One way in for every measurement file: the suffix chooses the reader."""

from pathlib import Path
from typing import Final

from torchplate.measurement.measurement import Measurement, MeasurementError
from torchplate.measurement.uff import read_uff

UFF_SUFFIX: Final = (".uff", ".unv", ".uf")


def read_measurement(path: Path | str, kind: str | None = None, normal: int = 3) -> Measurement:
    """Read a universal file (.uff, .unv, .uf) or a NumPy archive (.npz).

    Args:
        path: The file.
        kind: "receptance", "mobility", "accelerance" or "transmissibility"; overrides what the file says.
        normal: The axis of a universal file that points out of the plate, 1 to 3.

    Raises:
        MeasurementError: The file is absent, has another suffix, or cannot be used.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (*UFF_SUFFIX, ".npz"):
        raise MeasurementError(
            f"{path}: expected a measurement in a {', '.join(UFF_SUFFIX)} or .npz file, got the suffix "
            f"{path.suffix or 'none'!r}. Export it as UFF 58, or name it by its format."
        )
    if not path.is_file():
        raise MeasurementError(f"{path}: expected a measurement file, got none there. Check the path.")
    return Measurement.from_npz(path, kind) if suffix == ".npz" else read_uff(path, kind, normal)
