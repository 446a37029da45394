"""Rows of the verification page that take long to make: what `make blind` and `torchplate bench` wrote last."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

RUNS = Path(__file__).parents[3] / "runs"
# What a table counts that should not be; of 90 % intervals nine in ten should hold the truth, and all else is wanted.
UNWANTED = ("a false name", "a twin named", "named, and falsely", "crashes")


class Count(NamedTuple):
    """So many of so many cases.

    Attributes:
        case: what is counted.
        source: the table it stands in, and the commit it was made at.
        ours: how many.
        of: how many there are.
    """

    case: str
    source: str
    ours: int
    of: int

    @property
    def value(self) -> float:
        """How many there should be."""
        if "90 % intervals" in self.case:
            return 0.9 * self.of
        return 0.0 if any(word in self.case for word in UNWANTED) else float(self.of)

    def cells(self) -> str:
        """The line in Markdown."""
        off = self.ours - self.value
        told = f"{off:+.3g} of {self.of}".replace("-", "−") if off else "none"
        return f"| {self.case} | {self.source} | {self.value:.3g} of {self.of} | {self.ours} of {self.of} | {told} |"


class Time(NamedTuple):
    """Seconds of ours beside those of SciPy.

    Attributes:
        case: what is timed.
        source: whose seconds are the value.
        value: theirs [s].
        ours: ours [s].
    """

    case: str
    source: str
    value: float
    ours: float

    def cells(self) -> str:
        """The line in Markdown."""
        told = f"{self.value / self.ours:.3g} × as fast"
        return f"| {self.case} | {self.source} | {self.value:.3g} s | {self.ours:.3g} s | {told} |"


class Limit(NamedTuple):
    """What is to be at most so much.

    Attributes:
        case: what is measured.
        source: by which command.
        value: at most.
        ours: as measured.
        unit: of both.
    """

    case: str
    source: str
    value: float
    ours: float
    unit: str

    def cells(self) -> str:
        """The line in Markdown."""
        told = "within" if self.ours <= self.value else "above"
        most, ours = (f"{number:.4g} {self.unit}" for number in (self.value, self.ours))
        return f"| {self.case} | {self.source} | at most {most} | {ours} | {told} |"


def blind(folder: Path = RUNS / "blind") -> Iterator[Count]:
    """The rates of every table of plates with hidden effects."""
    for path in sorted(folder.rglob("table.md")):
        text = path.read_text()
        # Some cases may have been run at one commit, and the others at a later one.
        commit = " and ".join(re.findall(r"at commit (\w+)", text))
        source = f"`runs/{path.relative_to(folder.parent).as_posix()}`" + (f", {commit}" if commit else "")
        for stratum, table in re.findall(r"### (\w+): rates\n(.*?)\n\n(?=#|\Z)", text, flags=re.DOTALL):
            for what, n, of in re.findall(r"^\| +([^|]+?) \| (\d+) \| (\d+) \|", table, flags=re.MULTILINE):
                yield Count(f"{stratum}: {what}", source, int(n), int(of))


def speed(path: Path = RUNS / "bench" / "bench.json") -> Iterator[Time]:
    """One generation of the paper's problem, and its whole identification, on one thread and on two."""
    told = json.loads(path.read_text())
    for part, name in (("generation", "one generation"), ("identification", "the whole identification")):
        seconds = {(row["name"], n): row["seconds"] for n, found in told[part].items() for row in found["rows"]}
        # Theirs at its best: SciPy's threads wait for each other.
        theirs = min((one for one in seconds if one[0].startswith("SciPy")), key=seconds.__getitem__)
        source = f"{theirs[0]}, {_threads(theirs[1])}"
        for ours in sorted((one for one in seconds if not one[0].startswith("SciPy")), key=lambda one: one[1]):
            yield Time(f"{name}: {ours[0]}, {_threads(ours[1])}", source, seconds[theirs], seconds[ours])


def air(path: Path = RUNS / "bench" / "bench.json") -> Iterator[Limit]:
    """What the air costs: to prepare, and in a search, in CPU seconds."""
    told = json.loads(path.read_text())["air"]["1"]
    source = "`torchplate bench --part air`"
    for sides, seconds in told["prepared_s"].items():
        yield Limit(f"mass of the air, prepared once: sides {sides}", source, 1.0, seconds, "s")
    for way, ratio in told["search"].items():
        yield Limit(f"one generation with air over one without: {way}", source, 1.1, ratio, "times")


def _threads(n: str) -> str:
    return "1 thread" if n == "1" else f"{n} threads"
