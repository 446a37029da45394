"""The verification page of the documentation, whose tables stand between marks that commands find them by."""

import re
import subprocess
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "verification.md"


def between(text: str, ends: tuple[str, str]) -> str:
    """What stands between two marks of the page."""
    return _parts(text, ends)[1]


def put(text: str, ends: tuple[str, str], new: str) -> str:
    """The page with something else between two marks."""
    before, _, after = _parts(text, ends)
    return f"{before}{ends[0]}\n{new}\n{ends[1]}{after}"


def commit(at: Path = Path(__file__).parent) -> str:
    """What is measured: the commit of this package; "-dirty" where files differ from it, "" outside of a repository.

    Those of the documentation, where figures go, may differ: else the second command of two would measure another code.

    Args:
        at: a folder of the repository.
    """
    asked = (
        ["git", "describe", "--always", "--exclude=*"],
        ["git", "status", "--porcelain", "--untracked-files=no", "--", ":(top)", ":(top,exclude)docs"],
    )
    done = [subprocess.run(words, cwd=at, capture_output=True, text=True, check=False) for words in asked]
    found, differs = (one.stdout.strip() for one in done)
    return f"{found}-dirty" if found and differs else found


def _parts(text: str, ends: tuple[str, str]) -> tuple[str, str, str]:
    found = re.fullmatch(f"(.*){ends[0]}\n(.*)\n{ends[1]}(.*)", text, flags=re.DOTALL)
    if found is None:
        raise ValueError(f"Expected the page to hold {ends[0]} and {ends[1]}, got a page without them. Put them there.")
    return found[1], found[2], found[3]
