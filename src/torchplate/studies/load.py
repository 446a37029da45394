"""`python -m torchplate.studies.load`: time and memory of large work, each line in a process of its own.

It prints the lines of the table of load on docs/verification.md; `--write` puts each there as soon as it is measured,
and leaves the others. `--only NAME` measures some lines alone, `--runs` and `--evaluations` take less where a machine
is slow; the table says of how many. Seconds are of the processor, which others on the machine do not lengthen. Peak
memory is that of the whole process, Python and torch included.
"""

import argparse
import gc
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import torch
from rich.console import Console

from torchplate.bench import (
    KNOWN,
    LINES,
    PAGE,
    SEARCHED,
    TRUTH,
    between,
    commit,
    members,
    paper_model,
    peak_memory,
    put,
)
from torchplate.cli.verbs.run import run
from torchplate.diagnosis import diagnose
from torchplate.effects import Effect, HystereticDamping, Plate, PointMass, SupportSpring
from torchplate.measurement import SI_UNIT, Channel, Measurement
from torchplate.model import PlateModel, extrapolate, reduce, ritz_basis
from torchplate.notation import percent
from torchplate.plate import Mesh

ENDS = ("<!-- load -->", "<!-- end of load -->")
N_RUN, N_EVALUATION, N_MEMBER = 200, 1_000_000, 4096
EVERY_NODE, WIRES = 121, (2, 10, 112, 120)
# Elements of the plate that is tested for each of the model's, along a side; and up to which multiple of the band's end
# its modes are kept, their mesh error taken off.
FINER, FAR = 4, 5.0
FINE_LINES = torch.arange(1, 3201, dtype=torch.float64) * 0.125
# Runs after which memory is taken to have come to its level: caches fill, and the allocator keeps what it was given.
N_WARM = 20
# By how much memory may have grown over the runs that follow [-].
FLAT = 0.05


class Line(NamedTuple):
    """What was measured of one kind of work.

    Attributes:
        what: was done.
        seconds: of the processor that it took, preparation included.
        peak_gib: the most memory that the process held [GiB].
        kept: what it was to keep to, and whether it did.
        held: whether it did.
    """

    what: str
    seconds: float
    peak_gib: float
    kept: str
    held: bool

    def cells(self, at: str) -> str:
        """The line in Markdown, of the code at that commit."""
        held = "kept" if self.held else "**not kept**"
        return f"| {self.what} | {self.seconds:.3g} | {self.peak_gib:.2f} | {self.kept}: {held} | {at} |"


def in_sequence(n_run: int) -> Line:
    """So many runs of a small plate in one process: memory after the last against that after the first ones."""
    plate = {"effect": "plate", "youngs_modulus": 2.04e11, "poisson_ratio": 0.31, "density": 7700.0, "thickness": 3e-3}
    truth = {"mesh": {"length_x": 0.41, "length_y": 0.29, "n_x": 4, "n_y": 3}, "effects": {"plate": plate}}
    began, levels = time.process_time(), []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plate.yaml"
        path.write_text(json.dumps(truth))
        hertz = run(path, Path(folder) / "truth", console=_nobody()).result["natural_frequencies_hz"]
        searched = truth | {
            "effects": {"plate": plate | {"youngs_modulus": [1.5e11, 2.6e11]}},
            "measurement": {"natural_frequencies": {mode: hertz[mode - 1] for mode in (4, 5, 6, 7)}},
            "search": {"n_member": 8, "n_generation": 5, "tolerance": None},
            "log": {"n_figure": 0},
        }
        path.write_text(json.dumps(searched))
        for turn in range(n_run):
            run(path, Path(folder) / "out", console=_nobody(), force=turn > 0)
            gc.collect()
            levels.append(_resident())
    warm = levels[min(N_WARM, n_run // 2)]
    grown = levels[-1] / warm - 1
    what = f"{n_run} runs in one process, report and TensorBoard log each"
    runs = f"from run {min(N_WARM, n_run // 2)} to run {n_run}"
    kept = f"memory {percent(grown, decimals=1, signed=True)} {runs}, {percent(FLAT)} allowed"
    return Line(what, time.process_time() - began, peak_memory(), kept, grown <= FLAT)


@torch.no_grad()
def evaluations(n: int) -> Line:
    """So many evaluations of the paper's problem, in populations of 1,000."""
    model = _reduced(paper_model(), LINES)
    began, done, warm, level = time.process_time(), 0, 0, 0.0
    while done < n:
        model.frf(members(model, min(1000, n - done), seed=done), LINES)
        done += min(1000, n - done)
        if done <= max(1000, min(1000 * N_WARM, n // 2)):
            warm, level = done, peak_memory()
    grown = peak_memory() / level - 1
    kept = f"peak {percent(grown, decimals=1, signed=True)} after the first {warm:,}, {percent(FLAT)} allowed"
    what = f"{n:,} evaluations of 6 FRFs × 800 lines"
    return Line(what, time.process_time() - began, peak_memory(), kept, grown <= FLAT)


@torch.no_grad()
def at_once() -> Line:
    """All members of a large population in one call: what a model may take of memory, and the result, hold it."""
    model = _reduced(paper_model(), LINES)
    before, began = peak_memory(), time.process_time()
    frf = model.frf(members(model, N_MEMBER), LINES)
    return _budgeted(f"{N_MEMBER:,} members at once, 6 FRFs × 800 lines", model, frf, before, began)


@torch.no_grad()
def every_frf() -> Line:
    """All nodes of the paper's test at 3,200 lines."""
    grid = Mesh(0.48, 0.48, 10, 10)
    model = _plate(grid, [3], list(range(1, EVERY_NODE + 1)))
    before, began = peak_memory(), time.process_time()
    frf = model.frf(torch.zeros(0, dtype=torch.float64), FINE_LINES)
    return _budgeted(f"{EVERY_NODE} FRFs × {len(FINE_LINES):,} lines", model, frf, before, began)


@torch.no_grad()
def fine_mesh() -> Line:
    """The paper's problem on 100 × 100 elements: its basis, and a generation in that."""
    began, model = time.process_time(), paper_model(100)
    before = peak_memory()
    frf = _reduced(model, LINES).frf(members(model), LINES)
    return _budgeted(
        f"100 × 100 elements, {model.assembly.size:,} dofs, a basis and 32 members", model, frf, before, began
    )


def diagnosis_of_every_frf() -> Line:
    """A mass of 24 g hidden from a diagnosis of the paper's 121 FRFs, which a finer mesh makes, its error taken off."""
    grid, nodes = Mesh(0.48, 0.48, 10, 10), list(range(1, EVERY_NODE + 1))
    lines = torch.arange(60, 801, dtype=torch.float64) * 0.5
    hidden = {"hidden.x": 0.27, "hidden.y": 0.68, "hidden.mass": 0.024}
    plate = Mesh(0.48, 0.48, FINER * grid.n_x, FINER * grid.n_y)
    known, finer = KNOWN | dict(zip(SEARCHED, TRUTH, strict=True)) | hidden, {"hidden": PointMass()}
    made = [[_same(node, grid, plate) for node in some] for some in ([3], nodes, WIRES)]
    truth, none = PlateModel(plate, _effects(made[2]) | finer, known, {}, made[0], made[1], "accelerance"), lines[:0]
    truth = extrapolate(truth, float(lines[-1]), margin=FAR).model
    with torch.no_grad():
        frf = truth.projected(ritz_basis(truth, none[None], lines[-1:], 0, FAR)).frf(none, lines)
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(frf.shape, dtype=frf.dtype, generator=generator)
    measurement = Measurement(
        lines,
        frf + 0.01 * noise * frf.abs().square().mean(0).sqrt(),
        torch.ones(frf.shape[1:], dtype=torch.bool),
        (Channel(3),),
        tuple(map(Channel, nodes)),
        "accelerance",
        SI_UNIT["accelerance"],
    )
    model = PlateModel(grid, _effects(), KNOWN, SEARCHED, [3], nodes, "accelerance")
    before, began = peak_memory(), time.process_time()
    found = diagnose(model, measurement, say=lambda told: print(told, file=sys.stderr, flush=True))
    names = [one.name for one in found.effects if one.name != "mesh_discretisation"]
    line = _budgeted(f"diagnosis of {EVERY_NODE} FRFs × {len(lines)} lines", model, frf, before, began)
    return line._replace(what=f"{line.what}: {found.verdict}, {', '.join(names) or 'no name'}")


def _plate(mesh: Mesh, response: list[int], reference: list[int]) -> PlateModel:
    """The paper's plate in numbers."""
    known = KNOWN | dict(zip(SEARCHED, TRUTH, strict=True))
    return PlateModel(mesh, _effects(), known, {}, response, reference, "accelerance")


def _effects(wires: Sequence[int] = WIRES) -> dict[str, Effect]:
    return {"plate": Plate(), "wires": SupportSpring(nodes=tuple(wires)), "loss": HystereticDamping()}


def _same(node: int, mesh: Mesh, finer: Mesh) -> int:
    """The node of a finer mesh at the place of one."""
    row, column = divmod(node - 1, mesh.n_x + 1)
    return row * (finer.n_y // mesh.n_y) * (finer.n_x + 1) + column * (finer.n_x // mesh.n_x) + 1


def _reduced(model: PlateModel, lines: torch.Tensor) -> PlateModel:
    found = reduce(model, lines)
    assert found is not None, "the paper's problem has a reduced basis"
    return found[0]


def _budgeted(what: str, model: PlateModel, frf: torch.Tensor, before: float, began: float) -> Line:
    """Whether what was taken is within the model's own budget, the result beside it."""
    taken, allowed = peak_memory() - before, (model.memory + frf.nbytes) / 2**30
    kept = f"{taken:.2f} GiB beyond the start, {allowed:.2f} allowed"
    return Line(what, time.process_time() - began, peak_memory(), kept, taken <= allowed)


def _nobody() -> Console:
    return Console(file=StringIO())


def _resident() -> float:
    """Memory that the process holds now [GiB]; the most it has held where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return peak_memory()
    return pages * 4096 / 2**30


PARTS: dict[str, Callable[[argparse.Namespace], Line]] = {
    "runs": lambda told: in_sequence(told.runs),
    "evaluations": lambda told: evaluations(told.evaluations),
    "members": lambda _: at_once(),
    "frfs": lambda _: every_frf(),
    "mesh": lambda _: fine_mesh(),
    "diagnose": lambda _: diagnosis_of_every_frf(),
}


def measured(name: str, told: argparse.Namespace) -> Line:
    """One line, measured in a process of its own."""
    words = ["--part", name, "--runs", str(told.runs), "--evaluations", str(told.evaluations)]
    done = subprocess.run([sys.executable, "-m", __spec__.name, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"Expected the part '{name}' to end with 0, got {done.returncode}:\n{done.stderr}")
    return Line(**json.loads(done.stdout.splitlines()[-1]))


def with_line(page: str, line: Line, at: str) -> str:
    """The page with one line anew, whatever its numbers were; those of other work stay.

    Args:
        page: as it was.
        line: of which the row is.
        at: the commit that was measured.
    """
    head = ["| work | seconds of the processor | peak [GiB] | held against | at |", "|---|---|---|---|---|"]
    rows = between(page, ENDS).splitlines()[len(head) :]
    new = line.cells(at)
    kept = [new if _work(row) == _work(new) else row for row in rows]
    return put(page, ENDS, "\n".join([*head, *kept, *([] if new in kept else [new])]))


def _work(row: str) -> str:
    """What a row is of, without its numbers and what was found."""
    return re.sub(r"[\d,]+", "", row.split("|")[1].split(":")[0])


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, and write where asked for; 1 if a line is beyond what it is held against."""
    words = argparse.ArgumentParser(prog="python -m torchplate.studies.load", description=__doc__)
    words.add_argument("--only", choices=PARTS, nargs="+", default=list(PARTS), help="these lines alone")
    words.add_argument("--runs", type=int, default=N_RUN, help=f"in sequence (default: {N_RUN})")
    words.add_argument("--evaluations", type=int, default=N_EVALUATION, help=f"default: {N_EVALUATION}")
    words.add_argument("--write", action="store_true", help=f"put each line into {PAGE.name}")
    words.add_argument("--part", choices=PARTS, help=argparse.SUPPRESS)
    told = words.parse_args(arguments)
    if told.part is not None:
        print(json.dumps(PARTS[told.part](told)._asdict()))
        return 0
    lines, at = [], commit()
    for name in told.only:
        lines.append(measured(name, told))
        print(lines[-1].cells(at), flush=True)
        if told.write:
            PAGE.write_text(with_line(PAGE.read_text(), lines[-1], at))
    return 0 if all(line.held for line in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
