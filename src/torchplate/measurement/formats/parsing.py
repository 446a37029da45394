"""Files that come from elsewhere: what a parser meets in a broken one is said in one sentence."""

import functools
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Concatenate, Final, ParamSpec, TypeVar

from torchplate.measurement.formats.archive import plain
from torchplate.measurement.measurement import MeasurementError

BROKEN: Final = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
"""What Python, NumPy, SciPy and pyuff raise over content that is not what its head promises."""

Given = ParamSpec("Given")
Read = TypeVar("Read")


def reads(
    what: str,
) -> Callable[[Callable[Concatenate[Path, Given], Read]], Callable[Concatenate[Path | str, Given], Read]]:
    """A reader that raises a `MeasurementError` for every file that does not parse.

    Args:
        what: The reader is for, with its article.
    """

    def wrapped(read: Callable[Concatenate[Path, Given], Read]) -> Callable[Concatenate[Path | str, Given], Read]:
        @functools.wraps(read)
        def safely(path: Path | str, /, *arguments: Given.args, **settings: Given.kwargs) -> Read:
            try:
                return read(Path(path), *arguments, **settings)
            except MeasurementError:
                raise
            except MemoryError as error:
                raise MeasurementError(
                    f"{path}: expected {what} that fits the memory, got one that says it holds more. Export it again, "
                    "or in parts."
                ) from error
            except BROKEN as error:
                reason = plain(" ".join(str(error).split()))[:120]
                raise MeasurementError(
                    f"{path}: expected {what}, got one that does not parse ({reason}). Export it again."
                ) from error

        return safely

    return wrapped
