"""Files that are written whole or not at all: under another name beside, onto the disk, and then renamed."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Where to write a file; it takes its name once it is whole and on the disk.

    An interruption, or an error on the way, leaves what had that name before.

    Raises:
        OSError: if it cannot be written; it names the file.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        yield partial
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        # A disk that is full does not say which file it was.
        error.filename = str(path)
        raise
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """A text file, whole or not at all."""
    write_bytes(path, text.encode())


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Files by their paths in a folder, which are made; each whole or not at all."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / name, content)


def write_bytes(path: Path, content: bytes) -> None:
    """A file, whole or not at all."""
    with whole(path) as partial:
        partial.write_bytes(content)
