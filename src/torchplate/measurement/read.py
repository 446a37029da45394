"""One way in for every measurement file: the suffix chooses the reader."""

from pathlib import Path
from typing import Final

from torchplate.measurement.formats.parsing import reads
from torchplate.measurement.measurement import Measurement, MeasurementError
from torchplate.measurement.modal.model import ModalModel, read_modal_table
from torchplate.measurement.uff.frfs import read_uff
from torchplate.measurement.uff.modes import read_modal_uff, write_modal_uff

UFF_SUFFIX: Final = (".uff", ".unv", ".uf")
FRF_SUFFIX: Final = (*UFF_SUFFIX, ".npz")
"""What FRFs are read from and written to."""
TABLE_SUFFIX: Final = (".csv", ".txt")
MODAL_SUFFIX: Final = (*UFF_SUFFIX, ".csv")
"""What a modal model is written to."""


_HITS = "Time records of hits become FRFs by `torchplate frf`"
_OF_NATURAL_FREQUENCIES = (
    "natural frequencies go into a config, as measurement: {natural_frequencies: {1: 41.3, 2: 77.9}}"
)
_FRFS = (
    "FRFs in columns get their nodes by torchplate frf FILE --response 3 --reference 28 102 --out FRFS.uff, or are "
    "exported as UFF 58"
)
_TABLE = f"{_HITS}; {_FRFS}; {_OF_NATURAL_FREQUENCIES}"
WAY_ON: Final = {
    ".csv": _TABLE,
    ".txt": _TABLE,
    **dict.fromkeys((".yaml", ".yml"), "That is a config, which torchplate run and torchplate diagnose take"),
    **dict.fromkeys((".gz", ".zip", ".7z", ".rar"), "Unpack it"),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), f"Save the sheet as CSV. {_FRFS}"),
    **dict.fromkeys((".h5", ".hdf5", ".npy"), f"Save it by numpy.savez, with the frequencies. {_FRFS}"),
    ".tdms": f"Export it as LVM or CSV. {_HITS}",
    ".wav": _HITS,
    ".lvm": _HITS,
    ".mat": f"{_HITS}; {_FRFS}",
}
"""What a file of another kind is good for."""


@reads("a measurement")
def read_measurement(path: Path, kind: str | None = None, normal: int = 3) -> Measurement:
    """Read a universal file (.uff, .unv, .uf) or a NumPy archive (.npz).

    Args:
        path: The file.
        kind: "receptance", "mobility", "accelerance" or "transmissibility"; overrides what the file says.
        normal: The axis of a universal file that points out of the plate, 1 to 3.

    Raises:
        MeasurementError: The file is absent, has another suffix, or cannot be used.
    """
    suffix = path.suffix.lower()
    if path.is_dir():
        raise MeasurementError(f"{path}: expected a measurement file, got a folder. Name a .uff or .npz file in it.")
    if suffix not in (*UFF_SUFFIX, ".npz", *WAY_ON) and _begins_as_uff(path):
        raise MeasurementError(f"{path}: expected a universal file to end in .uff, got one without. Rename it.")
    if suffix not in (*UFF_SUFFIX, ".npz"):
        raise MeasurementError(
            f"{path}: expected a measurement in a {', '.join(UFF_SUFFIX)} or .npz file, got the suffix "
            f"{path.suffix or 'none'!r}. {WAY_ON.get(suffix, 'Export it as UFF 58, or name it by its format')}."
        )
    if not path.is_file():
        raise MeasurementError(f"{path}: expected a measurement file, got none there. Check the path.")
    return Measurement.from_npz(path, kind) if suffix == ".npz" else read_uff(path, kind, normal)


def _begins_as_uff(path: Path) -> bool:
    """Whether a file has the first line of a universal file: -1 in the fifth and sixth column."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return [line.rstrip() for line in file.read(82).splitlines()[:1]] == [b"    -1"]


@reads("a modal model")
def read_modal_model(path: Path, normal: int = 3) -> ModalModel:
    """Read natural frequencies, damping and mode shapes: a universal file with datasets 55 or 2414, or a table (.csv).

    Args:
        path: The file.
        normal: The axis of a universal file that points out of the plate, 1 to 3.

    Raises:
        MeasurementError: The file is absent, has another suffix, or cannot be used.
    """
    suffix = path.suffix.lower()
    if suffix not in (*UFF_SUFFIX, *TABLE_SUFFIX):
        raise MeasurementError(
            f"{path}: expected a modal model in a {', '.join((*UFF_SUFFIX, *TABLE_SUFFIX))} file, got the suffix "
            f"{path.suffix or 'none'!r}. Export it as UFF 55, or write a table."
        )
    if not path.is_file():
        raise MeasurementError(f"{path}: expected a modal model, got no file there. Check the path.")
    return read_modal_uff(path, normal) if suffix in UFF_SUFFIX else read_modal_table(path)


def write_modal_model(model: ModalModel, path: Path, suffix: str | None = None) -> None:
    """Write a modal model as datasets 55 (.uff, .unv, .uf) or as a table (.csv); its notes are not written.

    Args:
        model: The modes.
        path: The file; one that exists is replaced.
        suffix: Names the format; that of the path if left out.

    Raises:
        MeasurementError: Another suffix, or a node that is given two places.
    """
    suffix = (suffix or path.suffix).lower()
    if suffix not in MODAL_SUFFIX:
        raise MeasurementError(f"{path}: expected a name that ends in .csv or .uff, got '{path.suffix}'. Rename it.")
    if suffix == ".csv":
        path.write_text(model.to_csv(), encoding="utf-8")
    else:
        write_modal_uff(model, path)
