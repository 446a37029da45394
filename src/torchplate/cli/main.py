"""The command line. Exit status 0: done; 2: the user's input cannot be used; 1: a defect of ours."""

import argparse
import errno
import sys
from collections.abc import Sequence

from torchplate.cli.verbs import VERBS

# What the machine may refuse, and what the user can do about it.
OUTSIDE = {
    errno.EACCES: "Change its rights, or name another place",
    errno.EPERM: "Change its rights, or name another place",
    errno.EROFS: "Name a place that can be written to",
    errno.ENOSPC: "Make room on that disk, or name another place; a search goes on with --resume",
    errno.EDQUOT: "Make room on that disk, or name another place; a search goes on with --resume",
    errno.EIO: "Look after that disk, or name another place; a search goes on with --resume",
    errno.EISDIR: "Name a file",
    errno.ENOTDIR: "Correct the path",
    errno.ENAMETOOLONG: "Shorten the path",
    errno.ELOOP: "Correct the links on the path",
}


class _Version(argparse.Action):
    """Asks for the version only when the user does."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"torchplate {version('torchplate-fem')}")
        parser.exit()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit status."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    # The others need not be asked what they take.
    verb = next((word for word in given if not word.startswith("-")), "")
    parsed = parser(verb).parse_args(given)

    from torchplate.cli.config import InputError
    from torchplate.cli.ranks import Ended
    from torchplate.measurement import MeasurementError

    try:
        VERBS[parsed.verb].call(parsed)
    except (InputError, MeasurementError) as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        if error.errno not in OUTSIDE or error.filename is None:
            raise
        what = f"{error.filename}: Expected a place that can be read and written, got '{error.strerror}'."
        print(f"{what} {OUTSIDE[error.errno]}.", file=sys.stderr)
        return 2
    except Ended as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(
            "Stopped. What was computed is in the run's folder; a population search goes on with --resume.",
            file=sys.stderr,
        )
        return 130
    return 0


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
