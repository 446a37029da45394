"""Arrays of an .npz archive and text of a header, whoever wrote them."""

import errno
import re
import tokenize
import zipfile
from pathlib import Path
from typing import Final

import numpy as np

from torchplate.notation import shortened

SWELLS: Final = 200
ROOM: Final = 2**28
"""An archive may grow to this many times its size, or to so many bytes; FRFs grow to ten times theirs at most."""
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    """All arrays by name; none of them a pickled object.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no such archive, or a small one that would take a great deal of memory.
    """
    # Through a handle: NumPy leaves a broken archive open.
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as packed:
                whole = sum(one.file_size for one in packed.infolist())
        except (zipfile.BadZipFile, NotImplementedError) as error:
            raise ValueError(f"not an archive: {error}") from error
        if whole > max(ROOM, SWELLS * path.stat().st_size):
            raise ValueError(f"{path.stat().st_size} bytes that say they hold {whole:.3g}")
        file.seek(0)
        with np.load(file, allow_pickle=False) as archive:
            try:
                return {key: archive[key] for key in archive.files}
            except (MemoryError, OverflowError) as error:
                raise ValueError("an array larger than the memory") from error
            except (SyntaxError, tokenize.TokenError, RecursionError) as error:
                raise ValueError("an array whose head does not parse") from error
            except OSError as error:
                # Where bytes are missing, an array is said to lie before the file's beginning.
                if error.errno != errno.EINVAL:
                    raise
                raise ValueError("an array that is not where the archive says") from error


def quoted(text: str, most: int = 200) -> str:
    """Text that somebody else wrote, as a sentence may quote it: one line, without control characters, cut where long.

    Args:
        text: of a file, or of what read it.
        most: characters that are left [-].
    """
    return shortened(plain(" ".join(text.split())), most)


def plain(text: str) -> str:
    """Text without the control characters that move a terminal."""
    return _CONTROL.sub("�", text)
