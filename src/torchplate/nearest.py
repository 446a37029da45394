"""The name that was probably meant, said the same way by every room."""

import difflib
from collections.abc import Iterable
from typing import Final

LIKENESS: Final = 0.4
"""Least share of letters in common, in the same order: `mass` for `mas`, but also `n_member` for `members`."""


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name most like this one, or with these initials; None if none is like it."""
    # Letter case is what people forget most, and difflib counts it as another letter.
    folded = {other.casefold(): other for other in known}
    # DE for differential_evolution.
    letters = {"".join(word[:1] for word in other.split("_")): name for other, name in folded.items() if "_" in other}
    if name.casefold() in letters and name.casefold() not in folded:
        return letters[name.casefold()]
    near = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=LIKENESS)
    return folded[near[0]] if near else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The question for the end of a sentence, with the blank before it; empty where no name is near.

    >>> did_you_mean("point_mas", ["plate", "point_mass"])
    " Did you mean 'point_mass'?"
    """
    near = nearest(name, known)
    return f" Did you mean '{near}'?" if near else ""
