"""The command line. Exit status 0: done; 2: the input cannot be used; 1: a defect of ours; above 128: stopped."""

import argparse
import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

from torchplate.cli.arguments import VERBS
from torchplate.nearest import did_you_mean

# What the machine may refuse, and what the user can do about it.
OUTSIDE = {
    errno.EACCES: "Change its rights, or name another place",
    errno.EPERM: "Change its rights, or name another place",
    errno.EROFS: "Name a place that can be written to",
    errno.ENOSPC: "Make room on that disk, or name another place; a search goes on with --resume",
    errno.EDQUOT: "Make room on that disk, or name another place; a search goes on with --resume",
    errno.EFBIG: "Raise the limit on the size of files, or name another place; a search goes on with --resume",
    errno.ENOMEM: "Close other programs, or take a coarser mesh or fewer members",
    errno.EIO: "Look after that disk, or name another place; a search goes on with --resume",
    errno.EISDIR: "Name a file",
    errno.EEXIST: "Name a folder, or another place",
    errno.ENOTDIR: "Correct the path",
    errno.ENAMETOOLONG: "Shorten the path",
    errno.ELOOP: "Correct the links on the path",
}


# Who names a number of threads means it, for OpenBLAS too.
COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS")
# Turns of a loop that a thread of GNU's library waits for before it sleeps: by its source about 100,000 a millisecond.
SPINS = "1000"
# Verbs that evaluate no population.
ONE_BY_ONE = ("diagnose", "plan", "simulate")


class _Version(argparse.Action):
    """Asks for the version only when the user does."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from torchplate.cli.machine.installed import version_of

        print(f"torchplate {version_of('torchplate-fem')}")
        parser.exit()


class _Terminated(BaseException):
    """SIGTERM came: not an Exception, so that nothing on the way takes it for a failed evaluation."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit status."""
    try:
        with _sigterm_raises(), _writers_are_quiet():
            return _told(sys.argv[1:] if arguments is None else list(arguments))
    except BrokenPipeError:
        return _unread()
    except SystemExit as error:
        # So rich ends where a pipe was closed, with the status of a defect.
        if not isinstance(error.__context__, BrokenPipeError):
            raise
        return _unread()
    except (KeyboardInterrupt, _Terminated) as error:
        print(
            "Stopped. What was computed is in the run's folder; a population search and a diagnosis go on with "
            "--resume.",
            file=sys.stderr,
        )
        return 128 + (signal.SIGTERM if isinstance(error, _Terminated) else signal.SIGINT)


def _told(given: list[str]) -> int:
    """Run one verb; what was printed is out before this ends, and what the machine refuses is said."""
    try:
        try:
            status = _main(given)
        except SystemExit:  # of the parser, which has said what there is to say
            _flush()
            raise
        _flush()
        return status
    except OSError as error:
        if error.errno not in OUTSIDE:
            raise
        where = error.filename or "What is printed, or a file of the run"
        what = f"{where}: Expected a place that can be read and written, got '{error.strerror}'."
        print(f"{what} {OUTSIDE[error.errno]}.", file=sys.stderr)
        if error.filename is None:
            _forget_output()
        return 2


def _flush() -> None:
    """Write what is still held of the output, which may have been closed from the start."""
    if sys.stdout is not None and not sys.stdout.closed:
        sys.stdout.flush()


def _unread() -> int:
    """Status where whoever read the output has gone, as `head` does: that of any command that so ends in a shell."""
    _forget_output()
    return 128 + getattr(signal, "SIGPIPE", 13)  # Windows has no such signal


def _forget_output() -> None:
    """What Python still holds for the reader is not tried again as it ends.

    Source: the note on SIGPIPE in Python's documentation of the module signal.
    """
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _sigterm_raises() -> Iterator[None]:
    """SIGTERM ends the command as Ctrl-C does, for as long as this lasts."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def terminated(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        raise _Terminated

    before = signal.signal(signal.SIGTERM, terminated)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _writers_are_quiet() -> Iterator[None]:
    """A thread that cannot write for want of room prints no traceback: the command meets the same error and says it."""
    before = threading.excepthook

    def said(told: threading.ExceptHookArgs) -> None:
        if not (isinstance(told.exc_value, OSError) and told.exc_value.errno in OUTSIDE):
            before(told)

    threading.excepthook = said
    try:
        yield
    finally:
        threading.excepthook = before


def _main(given: list[str]) -> int:
    """Run one verb; what it cannot use is said."""
    if (odd := next((word for word in given if "\0" in word or not _is_utf8(word)), None)) is not None:
        shown = odd.encode(errors="surrogateescape").decode(errors="replace").replace("\0", "\N{REPLACEMENT CHARACTER}")
        print(f"{shown}: Expected a name in UTF-8, got other bytes where � stands. Rename it.", file=sys.stderr)
        return 2
    # The others need not be asked what they take.
    verb = next((word for word in given if not word.startswith("-")), "")
    # Before any parser imports torch. What is timed has the threads that it is told.
    if verb != "bench":
        _threads_as_matrices_want(os.environ, verb)
    whole = parser(verb)
    if verb and verb not in VERBS:
        if verb.endswith((".yaml", ".yml")):
            whole.error(f"expected a verb before a file, got '{verb}'. Write torchplate run {verb}, say.")
        whole.error(f"no verb '{verb}'.{did_you_mean(verb, VERBS)} There are: {', '.join(VERBS)}.")
    parsed, left = whole.parse_known_args(given)
    # What follows `--set search.seed` belongs to it: the verb says how it is written.
    if left and all("=" in override for override in getattr(parsed, "set", [])):
        whole.error(_not_taken(left, parsed))

    from torchplate.cli.config import InputError
    from torchplate.cli.machine.ranks import Ended
    from torchplate.measurement import MeasurementError, plain

    try:
        VERBS[parsed.verb].call(parsed)
    except (InputError, MeasurementError) as error:
        print(plain(str(error)), file=sys.stderr)
        return 2
    except (MemoryError, RuntimeError) as error:
        if not _is_out_of_memory(error):
            raise
        print(
            "Expected memory enough for this mesh and so many members, got an allocator that has no more to give. "
            "Lower mesh.n_x and mesh.n_y, mesh.refine or search.n_member, or close other programs.",
            file=sys.stderr,
        )
        return 2
    except Ended as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _is_utf8(word: str) -> bool:
    """Whether a word of the command line can be written to a file; a name of a file may hold any bytes."""
    try:
        word.encode()
    except UnicodeEncodeError:
        return False
    return True


def _not_taken(left: Sequence[str], parsed: argparse.Namespace) -> str:
    """What is wrong with words that a verb does not take, and how they are written."""
    from torchplate.cli.schema import SearchConfig

    first, *rest = left
    name = first.lstrip("-").partition("=")[0].replace("-", "_")
    text = f"unrecognized arguments: {' '.join(left)}"
    if hasattr(parsed, "set") and first.startswith("-") and name in SearchConfig.model_fields:
        value = first.partition("=")[2] or (rest[0] if rest else "VALUE")
        return f"{text}. Write --set search.{name}={value}."
    if hasattr(parsed, "set") and not first.startswith("-"):
        return f"{text}. torchplate {parsed.verb} takes one config: run them one after the other."
    return f"{text}. torchplate {parsed.verb} --help shows what it takes."


def _threads_as_matrices_want(environment: MutableMapping[str, str], verb: str) -> None:
    """Matrices here are small, and threads that wait for the next one keep a core busy which others need.

    OpenBLAS, which SciPy calls, gets one thread; torch keeps all of its own, which sleep between two pieces of work.
    They wait some 10 µs before they do: an eigenproblem is thousands of pieces that follow one another at once, and to
    wake a thread for each of them takes several times as long as one thread alone. A diagnosis takes one model at a
    time, of a few dozen modes: more threads than one make it slower, and cost more. One plate that is simulated gains
    nothing by them either, and its file is the same on any number of cores.
    The libraries read this once, as they are imported. What the user has set stays.
    """
    if not any(name in environment for name in COUNTS):
        environment["OPENBLAS_NUM_THREADS"] = "1"
        if verb in ONE_BY_ONE:
            environment["OMP_NUM_THREADS"] = "1"
    if "OMP_WAIT_POLICY" not in environment:
        environment["OMP_WAIT_POLICY"] = "PASSIVE"
        environment.setdefault("GOMP_SPINCOUNT", SPINS)


def _is_out_of_memory(error: Exception) -> bool:
    """Whether the machine's or the GPU's memory is spent; torch says so of the machine's in words alone."""
    import torch

    spent = isinstance(error, MemoryError | torch.OutOfMemoryError)
    return spent or "DefaultCPUAllocator: can't allocate memory" in str(error)


def parser(only: str | None = None) -> argparse.ArgumentParser:
    """The parser of the command line.

    Args:
        only: the verb that is asked what it takes; all if left out.
    """
    whole = argparse.ArgumentParser(
        "torchplate",
        description="Model updating of plates from measured vibration.",
        epilog="torchplate VERB --help shows what a verb takes, with an example.",
    )
    whole.add_argument("--version", action=_Version)
    verbs = whole.add_subparsers(required=True, metavar="VERB", dest="verb")
    for name, verb in VERBS.items():
        own = verbs.add_parser(
            name,
            help=verb.summary,
            description=verb.summary[0].upper() + verb.summary[1:] + ".",
            epilog=verb.epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if only in (None, name):
            verb.arguments(own)
    return whole
