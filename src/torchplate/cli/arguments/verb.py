"""A verb of the command line, as the parser takes it."""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ArgumentParser = argparse.ArgumentParser
Parsed = argparse.Namespace
OVERWRITE = "--overwrite"


def number(text: str) -> float:
    """A number on the command line; what has a unit or a comma is answered with how it is written."""
    try:
        found = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"expected a number alone, in SI units, without the unit and with a decimal point, got '{text}'"
        ) from None
    if not math.isfinite(found):
        raise argparse.ArgumentTypeError(f"expected a finite number, got '{text}'")
    return found


def place(text: str) -> Path:
    """A file or a folder on the command line; no text, as of a variable that is empty, is not the folder here."""
    if not text.strip():
        raise argparse.ArgumentTypeError("expected a file or a folder, got no text. Name one, . for the one here")
    return Path(text)


def overwriting(parser: ArgumentParser, what: str, *, force_is_a_channel: bool = False) -> None:
    """The option that lets a verb write over what is there: one rule for all of them, and one word that all take.

    Args:
        parser: of the verb.
        what: is written over.
        force_is_a_channel: `--force` has another meaning for this verb.
    """
    names = [OVERWRITE] if force_is_a_channel else ["--force", OVERWRITE]
    parser.add_argument(*names, dest="overwrite", action="store_true", help=f"write over {what}")


@dataclass(frozen=True)
class Verb:
    """One word of the command line.

    Args:
        summary: what it does, half a line.
        examples: command lines that show it; a remark may follow a #.
        arguments: adds what it takes to its parser.
        call: does it.
    """

    summary: str
    examples: tuple[str, ...]
    arguments: Callable[[ArgumentParser], None]
    call: Callable[[Parsed], None]

    @property
    def epilog(self) -> str:
        """The examples as `--help` ends with them."""
        return "\n  ".join([f"example{'s' * (len(self.examples) > 1)}:", *self.examples])
