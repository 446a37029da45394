"""What comes from a file stays text, no file runs code, and nothing listens."""

import ast
import functools
import re
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path

import pytest
import torch
from rich.console import Console

import torchplate
from torchplate.cli.verbs.inspect import inspect
from torchplate.cli.verbs.run import run
from torchplate.measurement import Measurement, write_uff

SOURCE = Path(torchplate.__file__).parent
SCRIPT = "<script>alert(1)</script>"
ONE = ["plate.youngs_modulus"]
# Names whose call reads or runs what a file says, and what makes the call safe.
SAFE_IF = {
    "torch.load": ("weights_only", True),
    "np.load": ("allow_pickle", False),
    "numpy.load": ("allow_pickle", False),
    "lvm_read.read": ("read_from_pickle", False),
}
NEVER = re.compile(
    r"^(eval|exec|compile|__import__|os\.(system|popen)|subprocess\..*|pickle\..*|joblib\..*|shelve\..*|marshal\..*|"
    r"yaml\.(load|load_all|unsafe_load|full_load|Loader|UnsafeLoader|FullLoader)|pandas\.read_pickle)$"
)
LISTENS = re.compile(r"(^|\.)(bind|listen|accept|HTTPServer|TCPServer|serve_forever|create_server|start_server)$")
MODULES = ("pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "http.server", "socketserver")
# Processes of one run tell each other the search; rank 0 has written it, in memory.
OWN_PROCESSES = {("cli/machine/ranks.py", "torch.load")}
# Benchmarks and studies start this very Python again, with no word of a file; git is asked for the commit.
BENCHMARK = {
    ("bench/marked_page.py", "subprocess.run"),
    ("bench/scaling.py", "subprocess.run"),
    ("cli/verbs/bench.py", "subprocess.run"),
    ("studies/chairs.py", "subprocess.Popen"),
    ("studies/load.py", "subprocess.run"),
    ("studies/main_job.py", "subprocess.Popen"),
}


@functools.cache
def nodes() -> list[tuple[str, ast.AST]]:
    """Every node of the package's code, and the file it is in."""
    paths = sorted(SOURCE.rglob("*.py"))
    trees = {path.relative_to(SOURCE).as_posix(): ast.parse(path.read_text()) for path in paths}
    return [(file, node) for file, tree in trees.items() for node in ast.walk(tree)]


@functools.cache
def calls() -> list[tuple[str, str, ast.Call]]:
    """Every call in the package: file, what is called, the call."""
    return [(file, ast.unparse(node.func), node) for file, node in nodes() if isinstance(node, ast.Call)]


def test_no_file_is_read_by_a_call_that_may_run_it():
    seen = set()
    for file, name, call in calls():
        assert not NEVER.match(name) or (file, name) in BENCHMARK, f"{file}: {name}"
        if name in SAFE_IF:
            seen.add(name)
            key, value = SAFE_IF[name]
            given = {keyword.arg: getattr(keyword.value, "value", None) for keyword in call.keywords}
            if (file, name) in OWN_PROCESSES and ast.unparse(call.args[0]).startswith("io.BytesIO"):
                continue
            assert given.get(key) is value, f"{file}: {name} without {key}={value}"
    assert {"torch.load", "np.load"} <= seen


def test_nothing_is_pickled_and_nothing_listens():
    for file, node in nodes():
        names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        assert not set(names) & set(MODULES), f"{file}: {names}"
    for file, name, _ in calls():
        assert not LISTENS.search(name), f"{file}: {name}"


class Tags(HTMLParser):
    """Which tags a page has, and the attributes that run something or load from elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.active: list[tuple[str, str | None]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.active += [
            (key, value)
            for key, value in attrs
            if key.startswith("on") or (key in ("src", "href", "xlink:href") and not (value or "").startswith("#"))
        ]


@pytest.fixture
def hostile(bench) -> Path:
    """The plate's measurement as a universal file whose every text is a script tag."""
    path = bench.folder / f"plate{SCRIPT.replace('/', '')}.uff"
    write_uff(Measurement.from_npz(bench.folder / "plate.npz"), path)
    lines = path.read_text().splitlines()
    starts = [at for at, line in enumerate(lines) if line.split() == ["58"]]
    for start in starts:
        for place in range(1, 6):
            lines[start + place] = f"{SCRIPT}\x1b[31m\x1b]0;title\x07"
        for place in range(8, 12):  # axis labels, by columns
            lines[start + place] = (
                lines[start + place][:31] + f"{SCRIPT[:20]:<21}" + "m/s^2" + lines[start + place][57:]
            )
    header = ["    -1", "   151", *[f"{SCRIPT}\x1b[31m\x1b]0;title\x07"] * 7, "    -1"]
    path.write_text("\n".join([*header, *lines]) + "\n")
    return path


@pytest.mark.check
def test_a_header_with_a_script_stays_text_in_the_report(bench, make_config, monkeypatch, hostile):
    monkeypatch.undo()
    label = f"wires{SCRIPT}"
    content = make_config(ONE, {"measurement.file": hostile.name, "search.n_generation": 1})
    content["effects"][label] = content["effects"].pop("wires")
    content["effects"][label]["stiffness"] = [700.0, 2000.0]
    path = bench.write(content, f"plate{SCRIPT.replace('/', '')}.yaml")
    folder = run(path, bench.folder / "out", console=Console(file=StringIO())).folder
    page = (folder / "report.html").read_text()
    found = Tags(page)
    assert not found.tags & {"script", "iframe", "object", "embed", "img", "link", "base", "form"}
    assert found.active == []
    assert "&lt;script&gt;" in page
    assert "<script" not in (folder / "report.md").read_text().replace("```", "").split("torchplate run")[0]


def test_no_sign_of_a_file_moves_the_terminal(hostile, bench):
    said = Console(file=StringIO(), width=300)
    inspect(hostile, bench.folder / "out", console=said)
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", said.file.getvalue())


def test_a_name_with_brackets_is_no_markup(bench, make_config, command):
    content = make_config([], {"search.n_generation": 1})
    content["effects"]["wires[/x]"] = content["effects"].pop("wires")
    content["effects"]["wires[/x]"]["stiffness"] = [1400.0, 2000.0]
    path = bench.write(content, "plate[red].yaml")
    status, stdout, _ = command("run", path, "--out", bench.folder / "out[bold]")
    assert status == 0
    assert "wires[/x].stiffness" in stdout
    assert "plate[red]" in stdout
    assert "out[bold]" in stdout


def test_an_archive_with_an_object_in_it_is_refused_and_does_nothing(bench, make_config, command, tmp_path):
    import numpy as np

    class Deed:
        def __reduce__(self):
            return Path.touch, (tmp_path / "done",)

    whole = dict(np.load(bench.folder / "plate.npz"))
    np.savez(bench.folder / "plate.npz", **whole | {"notes": np.array([Deed()], dtype=object)})
    status, _, stderr = command("run", bench.write(make_config(ONE)), "--out", bench.folder / "out")
    assert status == 2
    assert "pickle" in stderr
    assert not (tmp_path / "done").exists()


def test_a_checkpoint_with_code_in_it_is_refused_and_does_nothing(bench, make_config, command, tmp_path):
    class Deed:
        def __reduce__(self):
            return Path.touch, (tmp_path / "done",)

    bench.run(ONE, {"search.n_generation": 1})
    torch.save({"generator": Deed()}, bench.folder / "out" / "checkpoint.pt")
    status, _, stderr = command("run", bench.folder / "plate.yaml", "--out", bench.folder / "out", "--resume")
    assert status == 2
    assert "checkpoint" in stderr
    assert not (tmp_path / "done").exists()
