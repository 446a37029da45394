"""Mutation testing: one fault at a time in plate, effects, model and the criterion, and whether a test fails.

    python tests/trust/mutating.py --mutants 400 --seed 1

A mutant is one place of the source with another operator, comparison, number, sign, truth value or condition, or
without a call that was made for its effect. The package is copied to a scratch folder, the mutant is written there, and
the fast tests that call its function are run until one fails: first those of the file that is named after the module,
then those of its room, then others, the shortest first, as far as they take `SECONDS` of the processor together. Which
test calls which function is found by running all of them once. A mutant that every test lets pass survives: a test is
missing, or the mutant changes nothing that anyone could see, which docs/mutations.md says of each.

Operators: as mutmut and cosmic-ray have them. What stands in annotations, decorators and messages is left alone.
"""

import argparse
import ast
import copy
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import ceil
from pathlib import Path
from types import FrameType

# It is run as a script, beside which its neighbour lies; where tests are collected, that is on no path.
sys.path.insert(0, str(Path(__file__).parent))
import figures

os.environ.setdefault("OMP_NUM_THREADS", "1")

ROOT = Path(__file__).parents[2]
PAGE, ARGUMENTS = ROOT / "docs" / "mutations.md", Path(__file__).with_name("survivors.json")
# What is mutated, and the tests that are asked.
ROOMS = ("plate", "effects", "model", "diagnosis/selection/criterion.py")
TESTS = ("tests/plate", "tests/effects", "tests/model", "tests/diagnosis/test_criterion.py")
# The tests of one mutant, undisturbed; a mutant that takes three times as long and this much more is one that hangs.
# These are seconds of the processor, which others on the machine do not lengthen; so many times as long it may wait.
SECONDS, PATIENCE, WAITING = 25.0, 10.0, 20.0
MEMORY = 12 * 2**30

OTHER: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.And: ast.Or, ast.Or: ast.And,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One fault.

    Attributes:
        file: below src/torchplate.
        function: the outermost function or method it is in; "" in the body of a module or class.
        line: counted from 1.
        begin, end: what is replaced, in bytes of the file.
        before, after: the code.
    """

    file: str
    function: str
    line: int
    begin: int
    end: int
    before: str
    after: str

    @property
    def room(self) -> str:
        """Where it belongs."""
        return next(room for room in ROOMS if self.file.startswith(room))

    @property
    def key(self) -> str:
        """What an argument is filed under: without the line, which moves."""
        return f"{self.file} {self.function or 'body'}: {self.before} → {self.after}"


def changed(node: ast.AST) -> Iterator[ast.AST]:
    """What a place becomes."""
    if isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp) and type(node.op) in OTHER:
        other = copy.deepcopy(node)
        other.op = OTHER[type(node.op)]()
        yield other
    if isinstance(node, ast.Compare):
        for place, one in enumerate(node.ops):
            other = copy.deepcopy(node)
            other.ops[place] = OTHER[type(one)]()
            yield other
    if isinstance(node, ast.UnaryOp) and not isinstance(node.op, ast.UAdd):
        yield node.operand
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield ast.Constant(node.value + 1)
    if isinstance(node, ast.If | ast.IfExp | ast.While) and not isinstance(node.test, ast.Compare | ast.UnaryOp):
        yield ast.UnaryOp(ast.Not(), node.test)
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield ast.Pass()
    if isinstance(node, ast.Break | ast.Continue):
        yield ast.Continue() if isinstance(node, ast.Break) else ast.Break()


def parts(node: ast.AST) -> Iterator[ast.AST]:
    """What a node holds that is code: no annotation, no decorator, no message."""
    left_out: set[int] = set()
    for name in ("annotation", "returns", "decorator_list", "bases"):
        of = getattr(node, name, None)
        left_out |= {id(one) for one in (of if isinstance(of, list) else [of])}
    for one in ast.iter_child_nodes(node):
        if id(one) not in left_out and not isinstance(one, ast.JoinedStr | ast.Raise | ast.Import | ast.ImportFrom):
            yield one


def mutants(source: bytes, file: str) -> list[Mutant]:
    """All of a file, in its order."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []

    def walk(node: ast.AST, function: str, inside: bool) -> None:
        if isinstance(node, ast.ClassDef) and not inside:
            function = f"{function}.{node.name}".lstrip(".")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not inside:
            function, inside = f"{function}.{node.name}".lstrip("."), True
        of = node.test if isinstance(node, ast.If | ast.IfExp | ast.While) else node
        for other in changed(node):
            begin = starts[of.lineno - 1] + of.col_offset
            end = starts[of.end_lineno - 1] + of.end_col_offset
            named = function if inside else ""
            found.append(Mutant(file, named, of.lineno, begin, end, ast.unparse(of), ast.unparse(other)))
        for one in parts(node):
            walk(one, function, inside)

    walk(ast.parse(source), "", False)
    return found


def written(source: bytes, mutant: Mutant) -> bytes:
    """The file with the fault in it."""
    try:
        ast.parse(mutant.after, mode="eval")
        new = f"({mutant.after})"
    except SyntaxError:
        new = mutant.after  # a statement
    return source[: mutant.begin] + new.encode() + source[mutant.end :]


def spent() -> float:
    """Seconds of the processor that this process and those it waited for have taken."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class Calls:
    """A plugin of pytest: which test calls which function of the package, and how long it takes."""

    def __init__(self, package: Path) -> None:
        self.package = f"{package}/"
        self.callers: dict[str, list[str]] = defaultdict(list)
        self.seconds: dict[str, float] = {}
        self.seen: set[object] = set()
        self.began = 0.0

    def _heard(self, frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            self.seen.add(frame.f_code)

    def pytest_runtest_logstart(self) -> None:
        self.seen, self.began = set(), spent()
        sys.setprofile(self._heard)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        sys.setprofile(None)
        self.seconds[nodeid] = spent() - self.began
        for code in self.seen:
            if code.co_filename.startswith(self.package):
                name = code.co_qualname.split(".<locals>")[0]
                self.callers[f"{code.co_filename.removeprefix(self.package)} {name}"].append(nodeid)


class Asked:
    """A plugin of pytest: these tests in this order, and which of them failed first."""

    def __init__(self, order: list[str]) -> None:
        self.place = {name: place for place, name in enumerate(order)}
        self.failed = ""

    def pytest_collection_modifyitems(self, items: list) -> None:
        if self.place:
            known = [one for one in items if one.nodeid in self.place]
            items[:] = sorted(known, key=lambda one: self.place[one.nodeid])

    def pytest_runtest_logreport(self, report) -> None:
        if report.failed:
            self.failed = self.failed or report.nodeid

    def pytest_collectreport(self, report) -> None:
        if report.failed:
            self.failed = self.failed or f"{report.nodeid} (as it is read)"


class Driver:
    """A scratch copy of the package, and tests run on it in forked processes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("src", "tests", "configs"):
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        shutil.copy(ROOT / "pyproject.toml", folder)
        self.package = folder / "src" / "torchplate"
        self.moment = 1_000_000_000
        # What tests import beside the package, once for all processes.
        import pytest  # noqa: F401
        import scipy.signal
        import scipy.sparse.linalg
        import scipy.stats  # noqa: F401
        import skfem  # noqa: F401
        import torch
        import torch.func

        torch.set_num_threads(1)

    def put(self, file: str, content: bytes) -> None:
        """Write a file of the package; its time is another each time, by which compiled code is known."""
        (self.package / file).write_bytes(content)
        self.moment += 10
        os.utime(self.package / file, (self.moment, self.moment))

    def forked(self, words: list[str], plugin: object, of: list[str], seconds: float) -> tuple[str, dict]:
        """Run pytest in a process of its own: "0", "1", .. or "time", and some attributes of its plugin."""
        answer = self.folder / "answer.json"
        answer.unlink(missing_ok=True)
        child = os.fork()
        if child == 0:
            status = 70
            try:
                os.chdir(self.folder)
                resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
                resource.setrlimit(resource.RLIMIT_CPU, (ceil(seconds), ceil(seconds) + 5))
                sink = os.open(self.folder / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                os.dup2(sink, 1)
                os.dup2(sink, 2)
                sys.dont_write_bytecode, sys.pycache_prefix = False, str(self.folder / "compiled")
                sys.path.insert(0, str(self.folder / "src"))
                import pytest

                status = int(pytest.main(["-q", "--no-header", "-p", "no:cacheprovider", *words], plugins=[plugin]))
                answer.write_text(json.dumps({name: getattr(plugin, name) for name in of}))
            finally:
                os._exit(status)
        until = time.monotonic() + WAITING * seconds
        while True:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                break
            if time.monotonic() > until:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return "time", {}
            time.sleep(0.02)
        if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU:
            return "time", {}
        told = json.loads(answer.read_text()) if answer.exists() else {}
        return str(os.waitstatus_to_exitcode(status)), told

    def calls(self) -> dict:
        """Which test calls which function; every test has to pass."""
        status, told = self.forked([*TESTS], Calls(self.package), ["callers", "seconds"], 1800.0)
        assert status == "0", f"Without a mutant the tests end with {status}:\n{(self.folder / 'said.txt').read_text()}"
        return told

    def asked(self, mutant: Mutant, calls: dict) -> list[str]:
        """The tests for a mutant, in their order."""
        seconds = calls["seconds"]
        own, room = f"/test_{Path(mutant.file).stem}.py::", f"tests/{mutant.file.split('/')[0]}/"
        if mutant.function:
            tests = calls["callers"].get(f"{mutant.file} {mutant.function}", [])
        else:
            # What stands in the body of a module or a class is read without a call: all tests of its room.
            tests = [one for name, some in calls["callers"].items() if name.startswith(mutant.file) for one in some]
            tests += [one for one in seconds if one.startswith(room)]
        order = sorted(set(tests), key=lambda one: (own not in one, not one.startswith(room), seconds[one], one))
        taken, total = [], 0.0
        for one in order:
            if total + seconds[one] <= SECONDS or not taken:
                taken.append(one)
                total += seconds[one]
        return taken

    def outcome(self, mutant: Mutant, calls: dict, whole: list[str]) -> str:
        """Which test kills a mutant: its name, "time", or "" where it survives.

        Args:
            mutant: the fault.
            calls: which test calls which function.
            whole: files of tests to ask instead.
        """
        tests = [] if whole else self.asked(mutant, calls)
        if not tests and not whole:
            return ""
        source = (ROOT / "src" / "torchplate" / mutant.file).read_bytes()
        self.put(mutant.file, written(source, mutant))
        try:
            usual = sum(calls["seconds"][one] for one in tests) if tests else SECONDS
            files = whole or sorted({one.split("::")[0] for one in tests})
            status, told = self.forked(["-x", *files], Asked(tests), ["failed"], 3 * usual + PATIENCE)
        finally:
            self.put(mutant.file, source)
        if status == "0":
            return ""
        return "time" if status == "time" else told.get("failed") or f"ended with {status}"


def every() -> list[Mutant]:
    """All mutants, in the order of their files and places."""
    package, found = ROOT / "src" / "torchplate", []
    for room in ROOMS:
        files = [package / room] if room.endswith(".py") else sorted((package / room).rglob("*.py"))
        for path in files:
            if path.name != "__init__.py":
                found += mutants(path.read_bytes(), path.relative_to(package).as_posix())
    return found


def sample(found: list[Mutant], n_mutant: int, seed: int) -> list[Mutant]:
    """Some of them, drawn evenly over all; more of them go on where fewer ended."""
    drawn = list(found)
    random.Random(seed).shuffle(drawn)
    return drawn[:n_mutant]


def report(results: list[dict], n_every: dict[str, int], seed: int, seconds: float) -> str:
    """Score and survivors in Markdown."""
    why = json.loads(ARGUMENTS.read_text()) if ARGUMENTS.exists() else {}
    lines = [
        f"{len(results)} of {sum(n_every.values())} mutants, seed {seed}, of the code at {figures.commit()}, in "
        f"{seconds / 60:.0f} minutes of one core.",
        "",
        "| room | mutants | tried | killed | survived | killed, those argued to be the same left out |",
        "|---|---|---|---|---|---|",
    ]
    rows = [(f"`{room}`", [one for one in results if one["room"] == room], n_every[room]) for room in ROOMS]
    for room, some, n_all in [*rows, ("all", results, sum(n_every.values()))]:
        killed = sum(bool(one["by"]) for one in some)
        same = sum(why.get(one["key"], "").startswith("same:") for one in some if not one["by"])
        told = f"{killed} ({100 * killed / max(1, len(some)):.1f} %)"
        share = f"{100 * killed / (len(some) - same):.1f} %" if len(some) > same else "–"
        lines.append(f"| {room} | {n_all} | {len(some)} | {told} | {len(some) - killed} | {share} |")
    lines += ["", "| where | before | after | why no fast test sees it |", "|---|---|---|---|"]
    for one in sorted((one for one in results if not one["by"]), key=lambda one: (one["file"], one["line"])):
        cells = [f"`{one['file']}` {one['function']}", f"`{one['before']}`", f"`{one['after']}`"]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in [*cells, why.get(one["key"], "")]) + " |")
    return "\n".join(lines)


def keep(path: Path, seconds: float, results: list[dict]) -> None:
    """What was found so far, whole under its name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps({"seconds": seconds, "results": results}, ensure_ascii=False, indent=1))
    partial.replace(path)


def main() -> int:
    """Try, count, print, and write where asked for; 1 if a survivor has no argument."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=400, help="drawn of all (default: 400)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="of the processor: begin no mutant after these (default: 60)"
    )
    parser.add_argument(
        "--again", type=Path, metavar="RESULTS", help="begin with this file, and try its survivors again"
    )
    parser.add_argument("--resume", action="store_true", help="go on from what --results holds of the same commit")
    parser.add_argument("--room", choices=ROOMS, help="with --again: of this room alone")
    parser.add_argument("--files", nargs="+", default=[], help="with --again: in these files of the package alone")
    parser.add_argument("--tests", nargs="+", default=[], help="with --again: ask these files of tests, whole")
    parser.add_argument("--results", type=Path, default=Path("runs/mutants.json"), help="where each outcome is kept")
    parser.add_argument("--write", action="store_true", help="put score and survivors into docs/mutations.md")
    given = parser.parse_args()
    already, found = spent(), every()
    drawn = sample(found, given.mutants, given.seed)
    source = given.again or (given.results if given.resume and given.results.exists() else None)
    kept = json.loads(source.read_text()) if source else {"seconds": 0.0, "results": []}
    # Some faults have one key: two numbers of one function that are alike. They are told apart by their order.
    before: dict[str, list[str]] = defaultdict(list)
    for one in [] if given.resume else kept["results"]:
        before[one["key"]].append(one["by"])
    results: list[dict] = kept["results"] if given.resume else []
    assert [one["key"] for one in results] == [one.key for one in drawn[: len(results)]], "another commit or seed"
    folder = Path(tempfile.mkdtemp(prefix="mutating_"))
    try:
        driver = Driver(folder)
        calls = {} if given.tests or not given.minutes else driver.calls()
        print(f"{len(found)} mutants; {spent() - already:.0f} s", flush=True)
        for mutant in drawn[len(results) :]:
            late, by = spent() - already > 60 * given.minutes, (before[mutant.key] or [None]).pop(0)
            elsewhere = given.room not in (None, mutant.room) or (given.files and mutant.file not in given.files)
            if (late and not given.again) or (given.again and by is None):
                break
            if not by and not late and not elsewhere:
                by = driver.outcome(mutant, calls, given.tests)
                print(f"{by or 'survives'}: {mutant.file}:{mutant.line} {mutant.key}", flush=True)
            results.append({**asdict(mutant), "room": mutant.room, "key": mutant.key, "by": by})
            keep(given.results, kept["seconds"] + spent() - already, results)
    finally:
        shutil.rmtree(folder)
    seconds = kept["seconds"] + spent() - already
    keep(given.results, seconds, results)
    told = report(results, Counter(one.room for one in found), given.seed, seconds)
    print(told)
    if given.write:
        from torchplate.bench.marked_page import put

        PAGE.write_text(put(PAGE.read_text(), ("<!-- mutants -->", "<!-- end of mutants -->"), told))
    return int(any(line.endswith("|  |") for line in told.splitlines()))


if __name__ == "__main__":
    sys.exit(main())
