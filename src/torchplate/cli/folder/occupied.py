"""A folder that one command at a time works in."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torchplate.cli.config import InputError

try:
    import fcntl
except ImportError:  # Windows has none, and no lock here
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"


@contextmanager
def occupied(folder: Path) -> Iterator[None]:
    """Make the folder, and keep other commands out of it for as long as this lasts; a killed process keeps none out.

    Raises:
        InputError: if it cannot be written to, or another command is at work in it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = _lock(folder)
    except BlockingIOError:
        raise InputError(
            f"--out {folder}: Expected a folder that no other command works in, got one in use. Wait until that one "
            "has ended, or name another folder."
        ) from None
    except OSError as error:
        raise InputError(
            f"--out {folder}: Expected a folder that can be written to, got '{error.strerror}'. Name another place, or "
            "change its rights."
        ) from None
    try:
        yield
    finally:
        (folder / LOCK).unlink(missing_ok=True)
        os.close(lock)


def _lock(folder: Path) -> int:
    """The descriptor that holds the lock.

    Raises:
        BlockingIOError: if another process holds it.
    """
    path = folder / LOCK
    while True:
        lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if fcntl is None:
                return lock
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Whoever held it may have removed the file between the two lines above: then this lock keeps nobody out.
            if path.exists() and os.path.samestat(os.fstat(lock), path.stat()):
                return lock
        except BaseException:
            os.close(lock)
            raise
        os.close(lock)
