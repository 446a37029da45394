"""Files that are written whole or not at all: under another name beside, then renamed; and which of them are kept."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from torchplate.cli.config import InputError

FORCE = "--force"


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


@contextmanager
def asked_for(path: Path, *, force: bool, option: str = FORCE) -> Iterator[Path]:
    """Where to write the file that a verb was asked for, in a folder that is made; whole or not at all.

    Raises:
        InputError: if it would be lost; see `check_kept`.
        OSError: if it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as partial:
        yield partial
        check_kept({path: partial.read_bytes()}, force=force, option=option)


def check_kept(files: Mapping[Path, bytes], *, force: bool, option: str = FORCE) -> None:
    """Whether files can be written without a loss: a command that is repeated as it was makes the same, and may.

    Args:
        files: what is to stand in each.
        force: the user wants it in any case.
        option: by which that is said.

    Raises:
        InputError: if one is there and holds something else.
    """
    for path, content in files.items():
        if not force and path.exists() and path.read_bytes() != content:
            raise would_be_lost(path, option)


def would_be_lost(path: Path, option: str = FORCE) -> InputError:
    """What is said where a file is there and holds something else than a command would write."""
    return InputError(
        f"--out {path}: Expected a new file, or the one that this very command has made before, got one that exists "
        f"and holds something else. Give {option} to write over it, or name another."
    )


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
