"""From what was hidden and what was named to verdicts, tables and Wilson intervals."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import sqrt
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

from blind.field import NEAR, field_of
from blind.place import numbers, place_error, size_error, which_is_right
from blind.twins import MESH, Judge, right, sure_of_twin

# 90 % of a normal distribution lies within this many standard deviations.
Z90 = 1.6448536
YOUNG_WITHIN = 0.003
GAP_WITHIN = 1.2
BINS = (0.0, 0.5, 0.7, 0.85, 0.95, 1.0001)
Record = dict[str, Any]


@dataclass(frozen=True)
class Verdict:
    """What is right and wrong of one diagnosis.

    Args:
        right: the one word for the case.
        named: names in the order given, a finer mesh left out.
        why: in a few words, if wrong.
        members: of the set that holds the true name, for each effect found.
        errors: place, size and gap errors of effects found [-].
        confidence: of each named effect, and whether its set holds a hidden one.
        covered: effect, parameter, and whether its 90 % interval holds the truth, of right names.
        false_name: whether an answer's set holds no hidden effect.
        seen: "yes", "no" or "either" of each hidden effect, as its Fisher information says.
    """

    right: bool
    named: tuple[str, ...]
    why: str = ""
    found: tuple[str, ...] = ()
    members: tuple[int, ...] = ()
    place: tuple[float, ...] = ()
    size: tuple[tuple[str, float], ...] = ()
    young: float | None = None
    gap: float | None = None
    which: tuple[bool, ...] = ()
    confidence: tuple[tuple[float, bool], ...] = ()
    twin_as_sure: bool = False
    covered: tuple[tuple[str, str, bool], ...] = ()
    false_name: bool = False
    seen: tuple[str, ...] = ()


def wilson(n_right: int, n: int) -> tuple[float, float]:
    """The 90 % interval of a rate, by Wilson's score: (p + z²/2n ± z √(p(1-p)/n + z²/4n²)) / (1 + z²/n).

    Source: Wilson, J. American Statistical Association 22 (1927) 209.
    """
    if n == 0:
        return 0.0, 1.0
    p, z2 = n_right / n, Z90**2
    middle, half = p + z2 / (2 * n), Z90 * sqrt(p * (1 - p) / n + z2 / (4 * n**2))
    return max(0.0, (middle - half) / (1 + z2 / n)), min(1.0, (middle + half) / (1 + z2 / n))


def verdict(record: Record, judge: Judge | None = None) -> Verdict:
    """Judge one line of results.jsonl."""
    case, diagnosis = record["truth"], record.get("diagnosis")
    if diagnosis is None:
        return Verdict(False, (), f"crash: {record.get('error', 'no diagnosis')}")
    answers = [answer for answer in diagnosis["effects"] if answer["name"] != MESH]
    named = tuple(answer["name"] for answer in answers)
    word = diagnosis["verdict"]
    words = case.get("detectable") or ["yes"] * len(case["hidden"])
    pairs_seen = [(one, word) for one, word in zip(case["hidden"], words, strict=True) if one["effect"] != MESH]
    hidden, seen = [one for one, _ in pairs_seen], tuple(word for _, word in pairs_seen)
    names = {one["effect"] for one in hidden}
    holds = [bool(names & {answer["name"], *answer.get("equivalent", [])}) for answer in answers]
    confidence = tuple((answer["confidence"], held) for answer, held in zip(answers, holds, strict=True))
    false_name = not all(holds)
    young = _young_error(case, record)
    if case["kind"] == "none" or not hidden:
        # A mesh that is too coarse may be named, or mended without a word.
        good = not answers and word in ("consistent", "explained")
        why = "" if good else f"{word}: {', '.join(named)}"
        return Verdict(good, named, why, young=young, confidence=confidence, false_name=false_name)
    if case["kind"] == "beyond":
        good = word in ("unexplained", "partly_explained") or (seen[0] != "yes" and word == "consistent")
        why = "" if good else f"{word}: {', '.join(named)}"
        return Verdict(good, named, why, confidence=confidence, false_name=false_name, seen=seen)
    pairs = [(one, next((a for a in answers if right(one["effect"], a, case, judge)), None)) for one in hidden]
    found = [(one, answer) for one, answer in pairs if answer is not None]
    too_many = len(answers) > len([word for word in seen if word != "no"])
    missed = [
        one["effect"] for (one, answer), word in zip(pairs, seen, strict=True) if answer is None and word == "yes"
    ]
    sizes, places, which, covered = [], [], [], []
    model = record.get("model", {})
    for one, answer in found:
        if answer["name"] != one["effect"]:
            continue
        got = numbers(answer)
        named_entry = model.get(answer.get("label", ""), {})
        if (it := which_is_right(one["effect"], one["options"], named_entry, case)) is not None:
            which.append(it)
        if (place := place_error(one["parameters"], got, case["sides"])) is not None:
            places.append(place)
        if (off := size_error(one["effect"], one["parameters"], got, case["stated"])) is not None:
            sizes.append((one["effect"], off))
        covered += [(one["effect"], name, inside) for name, inside in coverage(one, answer)]
    # Where nothing that must be seen is hidden, silence is right.
    silent = not answers and word == "consistent"
    good = not missed and not too_many and (silent or (bool(found) and word == "explained"))
    why = "" if good else (f"missed {', '.join(missed)}" if missed else "too many" if too_many else word)
    left, floor = (diagnosis["gap"].get(key) for key in ("heldout_final", "noise_floor"))
    # Of a table of natural frequencies nothing is held out.
    gap = left / floor if found and left and floor else None
    sure = any(sure_of_twin(one["effect"], answer, case) for one in hidden for answer in answers)
    return Verdict(
        good, named, why, tuple(one["effect"] for one, _ in found),
        tuple(1 + len(set(answer["equivalent"]) - {MESH}) for _, answer in found), tuple(places), tuple(sizes), young,
        gap, tuple(which), confidence, sure, tuple(covered), false_name, seen,
    )  # fmt: skip


# A patch of another shape is no square: only its place has a true value.
SQUARE = (0.8, 1.25)


def coverage(hidden: Record, answer: Record) -> list[tuple[str, bool]]:
    """Whether the 90 % interval of each parameter holds the true value.

    The interval is `low` to `high`, else the value ± 1.645 std. Left out: factors of wires, which count up to their
    common spring, and numbers without a std.
    """
    if hidden["effect"] == "support_asymmetry":
        return []
    true = hidden["parameters"]
    shape = true.get("aspect", 1.0)
    kept = true if SQUARE[0] <= shape <= SQUARE[1] else {name: true[name] for name in ("x", "y")}
    found = []
    for name, entry in answer.get("parameters", {}).items():
        ends = entry.get("low"), entry.get("high")
        if None in ends and entry.get("std"):
            ends = entry["value"] - Z90 * entry["std"], entry["value"] + Z90 * entry["std"]
        if name in kept and None not in ends:
            found.append((name, bool(ends[0] <= kept[name] <= ends[1])))
    return found


def _young_error(case: Record, record: Record) -> float | None:
    """|E − truth| / truth; None where the truth has a twin that E hides behind, or the model gives no number."""
    found = record.get("youngs_modulus")
    if not case["young_is_seen"] or not isinstance(found, int | float):
        return None
    return abs(found / case["youngs_modulus"] - 1)


@dataclass
class Score:
    """All verdicts of a suite."""

    records: Sequence[Record]
    judge: Judge | None = None
    verdicts: list[Verdict] = field(init=False)

    def __post_init__(self) -> None:
        self.verdicts = [verdict(record, self.judge) for record in self.records]

    def of(self, *kinds: str) -> list[tuple[Record, Verdict]]:
        """The cases of some kinds."""
        pairs = zip(self.records, self.verdicts, strict=True)
        return [pair for pair in pairs if pair[0]["truth"]["kind"] in kinds]

    def rates(self) -> list[tuple[str, int, int]]:
        """Name, how many, of how many."""
        one = [pair for pair in self.of("one") if pair[0]["truth"]["hidden"][0]["effect"] != MESH]
        named = [pair for pair in one if _seen(pair) == ["yes"]]
        hid, between = ([pair for pair in one if _seen(pair) == [word]] for word in ("no", "either"))
        mesh = [pair for pair in self.of("one") if pair[0]["truth"]["hidden"][0]["effect"] == MESH]
        nothing = self.of("none")
        beyond = [pair for pair in self.of("beyond") if _seen(pair) == ["yes"]]
        two = [pair for pair in self.of("two") if _seen(pair) == ["yes", "yes"]]
        known = [pair for pair in self.of("none", "one", "two") if pair[0].get("diagnosis")]
        inside = [within for v in self.verdicts for _, _, within in v.covered]
        found = [v for _, v in (*named, *two) if v.gap is not None and v.right]
        fields = [field for pair in beyond if (field := field_of(pair[0])) is not None]
        placed = [off for _, off in fields if off is not None]
        which = [w for v in self.verdicts for w in v.which]
        young = [v.young for v in self.verdicts if v.young is not None and v.right]
        rows = [
            ("one effect, named right (of the detectable)", sum(v.right for _, v in named), len(named)),
            ("  the name alone is in the answer", sum(bool(v.found) for _, v in named), len(named)),
            ("  a twin named as if sure", sum(v.twin_as_sure for _, v in named), len(named)),
            ("one effect, undetectable, not named", sum(not v.named for _, v in hid), len(hid)),
            ("  named, and falsely", sum(v.false_name for _, v in hid), len(hid)),
            ("one effect, between the two, right or silent", sum(v.right for _, v in between), len(between)),
            ("coarse mesh, nothing else named", sum(v.right for _, v in mesh), len(mesh)),
            ("nothing hidden, called consistent", sum(v.right for _, v in nothing), len(nothing)),
            ("a false name on nothing hidden", sum(bool(v.named) for _, v in nothing), len(nothing)),
            ("a false name, all but beyond", sum(v.false_name for _, v in known), len(known)),
            ("beyond the catalogue, not called explained", sum(v.right for _, v in beyond), len(beyond)),
            ("  the field without a name: kind right", sum(right for right, _ in fields), len(fields)),
            (f"  the field: place within {100 * NEAR:.0f} %", sum(off <= NEAR for off in placed), len(placed)),
            ("  of right names, the right edge, sensor or channel", sum(which), len(which)),
            ("two effects, both right (of two detectable)", sum(v.right for _, v in two), len(two)),
            ("two effects, at least one", sum(bool(v.found) for _, v in two), len(two)),
            ("90 % intervals of right names hold the truth", sum(inside), len(inside)),
            (
                f"held-out gap within {GAP_WITHIN} noise floors",
                sum(v.gap <= GAP_WITHIN for v in found if v.gap),
                len(found),
            ),
            (f"E within {100 * YOUNG_WITHIN:.1f} %, where seen", sum(y <= YOUNG_WITHIN for y in young), len(young)),
            ("crashes", sum(record.get("diagnosis") is None for record in self.records), len(self.records)),
        ]
        return [(name, count, n) for name, count, n in rows if n]

    def coverage(self) -> list[tuple[str, int, int]]:
        """Effect, how many 90 % intervals hold the truth, of how many."""
        found: dict[str, list[bool]] = {}
        for own in self.verdicts:
            for effect, _, inside in own.covered:
                found.setdefault(effect, []).append(inside)
        return [(effect, sum(inside), len(inside)) for effect, inside in sorted(found.items())]

    def confusion(self) -> Counter[tuple[str, str]]:
        """True effect, named effect: how often, over cases of one effect or none."""
        found: Counter[tuple[str, str]] = Counter()
        for record, own in self.of("one", "none", "beyond"):
            truth = record["truth"]["hidden"][0]["effect"] if record["truth"]["hidden"] else "nothing"
            word = record["diagnosis"]["verdict"] if record.get("diagnosis") else "crash"
            for name in own.named or (f"({word})",):
                found[truth, name] += 1
        return found

    def calibration(self) -> tuple[list[tuple[str, int, float, float]], float]:
        """Bins of confidence with their number, mean confidence and rate of right ones; and Brier's mean square."""
        pairs = [pair for own in self.verdicts for pair in own.confidence]
        rows = []
        for low, high in pairwise(BINS):
            own = [pair for pair in pairs if low <= pair[0] < high]
            if own:
                mean = sum(c for c, _ in own) / len(own)
                rows.append((f"{low:.2f}-{min(high, 1.0):.2f}", len(own), mean, sum(r for _, r in own) / len(own)))
        return rows, sum((c - r) ** 2 for c, r in pairs) / len(pairs) if pairs else float("nan")


def _seen(pair: tuple[Record, Verdict]) -> list[str]:
    """What is to be seen of a case's effects; all of it where nobody says."""
    truth = pair[0]["truth"]
    return list(truth.get("detectable") or ["yes"] * len(truth["hidden"]))


def tables(score: Score, title: str = "rates") -> list[Table]:
    """What is printed."""
    rates = _table(title, "what", "n", "of", "rate", "90 % interval")
    for name, count, n in score.rates():
        low, high = wilson(count, n)
        rates.add_row(name, str(count), str(n), f"{100 * count / n:.0f} %", f"{100 * low:.0f} to {100 * high:.0f} %")
    errors = _table("errors and times", "what", "n", "median", "worst")
    sizes: dict[str, list[float]] = {}
    for own in score.verdicts:
        for effect, value in own.size:
            sizes.setdefault(effect, []).append(value)
    lines: list[tuple[str, list[float], float, str]] = [
        ("place, of √(Lx Ly)", [p for v in score.verdicts for p in v.place], 100, " %"),
        ("size", [s for values in sizes.values() for s in values], 100, " %"),
        ("E, where seen", [v.young for v in score.verdicts if v.young is not None and v.right], 100, " %"),
        ("members of a right set", [float(m) for v in score.verdicts for m in v.members], 1, ""),
        ("seconds", [record["seconds"] for record in score.records if "seconds" in record], 1, " s"),
        (
            "seconds of CPU",
            [record["seconds_of_cpu"] for record in score.records if "seconds_of_cpu" in record],
            1,
            " s",
        ),
        *((f"size of {effect}", values, 100, " %") for effect, values in sorted(sizes.items())),
    ]
    for name, values, factor, unit in lines:
        if values:
            errors.add_row(name, str(len(values)), *(f"{factor * f(values):.2f}{unit}" for f in (median, max)))
    covered = _table("90 % intervals that hold the truth", "effect", "n", "of", "90 % interval")
    for effect, count, n in score.coverage():
        low, high = wilson(count, n)
        covered.add_row(effect, str(count), str(n), f"{100 * low:.0f} to {100 * high:.0f} %")
    confusion = _table("confusion", "hidden", "named", "n")
    for (truth, name), count in sorted(score.confusion().items()):
        confusion.add_row(truth, name if truth != name else f"{name} ✓", str(count))
    rows, brier = score.calibration()
    calibration = _table(f"calibration, Brier {brier:.3f}", "confidence", "n", "mean", "right", "90 % interval")
    for interval, n, mean, rate in rows:
        low, high = wilson(round(rate * n), n)
        calibration.add_row(interval, str(n), f"{mean:.2f}", f"{rate:.2f}", f"{low:.2f} to {high:.2f}")
    wrong = _table("wrong", "case", "hidden", "named", "why", "noise")
    for record, own in zip(score.records, score.verdicts, strict=True):
        if not own.right:
            truth = ", ".join(h["effect"] for h in record["truth"]["hidden"]) or "nothing"
            noise = f"{100 * record['truth']['noise']:.2f} %"
            wrong.add_row(record["truth"]["name"], truth, ", ".join(own.named) or "-", own.why[:80], noise)
    return [rates, errors, covered, confusion, calibration, wrong]


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title)
    for column in columns:
        table.add_column(column)
    return table


def markdown(table: Table) -> str:
    """A rich table as Markdown."""
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    rows = [[str(column.header) for column in table.columns], ["---"] * len(columns), *zip(*columns, strict=True)]
    return f"### {table.title}\n\n" + "\n".join("| " + " | ".join(row) + " |" for row in rows) + "\n"


def read(path: Path) -> list[Record]:
    """The records of a results.jsonl, in the order of the suite; of a case run twice the last."""
    records = [json.loads(line) for line in path.read_text().splitlines() if line.strip()]
    last = {(record.get("stratum", "clean"), record["truth"]["name"]): record for record in records}
    return [last[key] for key in sorted(last)]


def report(folder: Path) -> None:
    """Print the score of a folder, stratum by stratum, and write it to table.md there."""
    strata: dict[str, list[Record]] = {}
    for record in read(folder / "results.jsonl"):
        strata.setdefault(record.get("stratum", "clean"), []).append(record)
    found = [table for name, records in strata.items() for table in tables(Score(records), f"{name}: rates")]
    console = Console()
    for table in found:
        console.print(table)
    (folder / "table.md").write_text("\n".join(markdown(table) for table in found))
