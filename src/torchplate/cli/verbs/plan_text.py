"""What a plan says: in a sentence, and as a config with what to do in the lab beside it."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from torchplate.cli.config import dump
from torchplate.diagnosis import Doubt
from torchplate.planning import Plan

# The file that somebody has to make.
TO_BE_MEASURED = "TO BE MEASURED.uff"
# What a test that is made in the same way has in common with the one before.
OF_ONE_LAB = (
    "nodes",
    "frame",
    "band",
    "kind",
    "gain",
    "n_average",
    "position_std",
    "frequency_drift",
    "calibration_std",
    "damping_scatter",
    "thickness_scatter",
)


def in_words(doubts: Sequence[Doubt]) -> str:
    """What is open."""
    parts = []
    for doubt in doubts:
        ranked = sorted(doubt.probability.items(), key=lambda pair: -pair[1])
        parts.append(" or ".join(f"{name or 'nothing is missing'} ({p:.2f})" for name, p in ranked))
    return "; ".join(parts)


def compose(raw: Mapping[str, Any], found: Plan) -> str:
    """The config of the measured and of the proposed state.

    Args:
        raw: the config as it was diagnosed, its paths as seen from the plan's folder.
        found: the plan.
    """
    first = found.proposed
    given = raw["measurement"]
    states = list(given) if isinstance(given, list) else [{"name": "measured"} | dict(given)]
    last = states[-1]
    name = _free("proposed", [str(one.get("name", "")) for one in states])
    proposed = {"name": name, "file": TO_BE_MEASURED} | {key: last[key] for key in OF_ONE_LAB if key in last}
    proposed |= first.proposal.body(raw["effects"])
    head = [
        f"Written by `torchplate plan`. Open: {in_words([found.doubt])}.",
        f"Next: {first.proposal.title}.",
        _expected(found),
        f"When it is measured, put the name of its file in place of '{TO_BE_MEASURED}' (paths count from this folder), "
        "and diagnose this config.",
    ]
    before = {key: value for key, value in raw.items() if key != "measurement"}
    return (
        "".join(_comment(sentence) for sentence in head)
        + dump(before)
        + dump({"measurement": states})
        + _comment(first.proposal.instruction)
        + dump({"measurement": [proposed]}).partition("\n")[2]
    )


def _expected(found: Plan) -> str:
    first = found.proposed
    if found.needed:
        return (
            f"The right name is expected to have a probability of {first.probability:.2f} then; now the most probable "
            f"one has {max(found.before.values()):.2f}."
        )
    return (
        "No further test is needed for the name; this one narrows its numbers most, to "
        f"{first.narrowing:.2f} times their standard deviations on the mean."
    )


def _comment(sentence: str) -> str:
    return textwrap.fill(sentence, 118, initial_indent="# ", subsequent_indent="# ") + "\n"


def _free(name: str, taken: Sequence[str]) -> str:
    k = 2
    found = name
    while found in taken:
        found, k = f"{name}_{k}", k + 1
    return found
