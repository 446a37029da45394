"""Mutated files into every reader: no traceback, no hang over 10 s, no more than 1 GiB, no code, nothing written.

    python tests/trust/fuzzing.py --mutations 20000

Each case takes a small whole file, changes it (bits, bytes, lines, numbers, lengths; in archives also arrays, names and
kinds), and gives it to every reader of its suffix, and what can be read to what `new`, `frf` and `modes` make of it, in
a process with a limit of memory. A reader returns, or raises one of the package's errors with one sentence of one line.
Everything else is a finding, told with the number of its case.
"""

import argparse
import ctypes
import io
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

# It is run as a script, beside which its neighbour lies; where tests are collected, that is on no path.
sys.path.insert(0, str(Path(__file__).parent))
import figures
import universal

os.environ.setdefault("OMP_NUM_THREADS", "1")

SECONDS, ROOM = 10.0, 2**30
BATCH = 250
WORDS = [
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e308",
    b"-1e-320",
    b"9" * 30,
    b"99999999",
    b"-7",
    b"",
    b"\x00",
    b"\xff\xfe",
    b"D+99",
]
YAML_WORDS = [
    b"&a ",
    b"*a",
    b"!!python/object/apply:os.system ['true']",
    b"<<: *a",
    b"{",
    b"[",
    b"[" * 400,
    b"? ",
    b": ",
    b"- ",
    b"2001-99-99",
    b".inf",
    b".nan",
    b"null",
    b"~",
    b"0o8",
    b"1:99:99",
    b"!!binary x",
    b"|",
    b"\t",
    b"'",
    b'"',
    b"1e999",
    b"true",
]


class Hang(BaseException):
    """A reader took longer than it may."""


def corpus(folder: Path) -> dict[str, bytes]:
    """Small whole files by name."""
    import numpy as np
    import torch
    from scipy.io import savemat, wavfile

    from torchplate.cli.config.build import load_run
    from torchplate.cli.folder.descents import DescentFile
    from torchplate.cli.progress.log import save_checkpoint
    from torchplate.measurement import SI_UNIT, Channel, Measurement, ModalModel, write_modal_model, write_uff
    from torchplate.search import Descent, DifferentialEvolution, minimize

    # Two modes, on as many lines as an estimate of them needs.
    frequency = torch.arange(1, 33, dtype=torch.float64) * 2.5
    draw = torch.Generator().manual_seed(1)
    squared, pole = (frequency**2)[:, None], torch.tensor([22.0, 51.0], dtype=torch.float64) ** 2 * (1 + 0.04j)
    shape = torch.tensor([[1.0, -0.7], [0.6, 1.1]], dtype=torch.float64)
    frf = torch.einsum("jr,kr,fr->fjk", *[shape.to(pole)] * 2, -squared / (pole - squared))
    ends = tuple(Channel(node, "w", (0.1 * node, 0.05 * node**2, 0.0)) for node in (1, 4))
    measurement = Measurement(
        frequency, frf, torch.ones(2, 2, dtype=torch.bool), ends, ends, "accelerance", SI_UNIT["accelerance"],
        coherence=torch.full((32, 2, 2), 0.9, dtype=torch.float64),
    )  # fmt: skip
    measurement.to_npz(folder / "frf.npz")
    write_uff(measurement, folder / "ascii.uff")
    write_uff(measurement, folder / "binary.uff", binary=True)
    modes = ModalModel(
        torch.tensor([11.0, 29.0], dtype=torch.float64), torch.tensor([0.01, 0.02], dtype=torch.float64),
        torch.randn(2, 2, generator=draw, dtype=torch.float64), ends,
    )  # fmt: skip
    for name in ("modes.uff", "modes.csv"):
        write_modal_model(modes, folder / name)
    (folder / "systems.uff").write_bytes(universal.geometry_and_modes())
    (folder / "hits.uff").write_bytes(universal.hits())
    hit = np.zeros((64, 3))
    hit[10:14, 0] = 0.4, 1.0, 0.6, 0.1  # a level top would be an overload
    hit[10:, 1:] = np.sin(np.arange(54) * 0.7)[:, None]
    lines, one = frequency.numpy(), frf[:, :, 0].numpy()
    savemat(folder / "frf.mat", {"freq": lines[:, None], "H": one, "coherence": np.full(one.shape, 0.9)})
    np.savez(folder / "frfs.npz", f=lines, H_real=one.real, H_imag=one.imag)
    polar = np.stack([lines, np.abs(one[:, 0]), np.degrees(np.angle(one[:, 0]))], axis=1)
    table = [";".join(f"{x:.7g}".replace(".", ",") for x in row) for row in polar]
    (folder / "frf.csv").write_text("Frequency [Hz];Magnitude [m/s2/N];Phase [deg]\n" + "\n".join(table) + "\n")
    np.savez(folder / "hit.npz", force=hit[:, 0], response=hit[:, 1:], fs=512.0)
    savemat(folder / "hit.mat", {"force": hit[:, 0], "acc": hit[:, 1:], "fs": 512.0})
    wavfile.write(folder / "hit.wav", 512, (hit * 2e4).astype(np.int16))
    rows = [",".join(f"{x:.6g}" for x in (place / 512, *row)) for place, row in enumerate(hit)]
    (folder / "hit.csv").write_text("time,force,a\n" + "\n".join(rows))
    (folder / "nodes.csv").write_text("node,x,y,z\n1,0.1,0.2,0\n4,0.3,0.4,0\n")
    head = ["LabVIEW Measurement", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
            "Multi_Headings\tNo", "X_Columns\tNo", "Time_Pref\tAbsolute", "***End_of_Header***", "", "Channels\t3",
            "Samples\t64\t64\t64", "Date\t2020/01/01\t2020/01/01\t2020/01/01", "Time\t1:1:1\t1:1:1\t1:1:1",
            "X_Dimension\tTime\tTime\tTime", "X0\t0\t0\t0", "Delta_X\t0.002\t0.002\t0.002", "***End_of_Header***",
            "X_Value\tforce\ta\tb\tComment"]  # fmt: skip
    body = ["\t".join(["", *(f"{x:.6f}" for x in row)]) for row in hit]
    (folder / "hit.lvm").write_text("\n".join([*head, *body]) + "\n")
    raw = {
        "mesh": {"length_x": 0.4, "length_y": 0.3, "n_x": 3, "n_y": 2},
        "measurement": {"file": "frf.npz", "band": [5.0, 70.0]},
        "effects": {"plate": {"effect": "plate", "youngs_modulus": [1.5e11, 2.6e11], "poisson_ratio": 0.3,
                              "density": 7800.0, "thickness": {"value": 0.003, "std": 1e-5}},
                    "wires": {"effect": "support_spring", "nodes": [1, 4], "stiffness": 900.0}},
        "search": {"optimizer": "differential_evolution", "n_member": 6, "n_generation": 3, "seed": 1},
    }  # fmt: skip
    import yaml

    (folder / "plate.yaml").write_text(yaml.safe_dump(raw, sort_keys=False))
    (folder / "config.yaml").write_text(yaml.safe_dump(raw, sort_keys=False))
    load_run(folder / "plate.yaml")
    kept: list[dict[str, torch.Tensor]] = []
    minimize(
        lambda x: x.square().sum(-1), DifferentialEvolution(n_member=6), n_dimension=1, batch_shape=(1,),
        generator=torch.Generator().manual_seed(1), n_generation=2, on_generation=lambda p: kept.append(p.checkpoint()),
    )  # fmt: skip
    save_checkpoint(kept[-1], folder / "checkpoint.pt")
    start = torch.rand(2, 1, generator=draw, dtype=torch.float64)
    DescentFile(folder / "descents.pt", {"config": "a"}).keep([Descent(start, start, start[:, 0], 3)])
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.name != "config.yaml"}


def readers(name: str) -> list[Callable[[Path], object]]:
    """All that a file of this name may be given to."""
    import torch

    from torchplate.cli.config.build import load_run
    from torchplate.cli.folder.descents import DescentFile
    from torchplate.cli.folder.opening import read_checkpoint
    from torchplate.cli.verbs.new_draft import Wishes, drafted
    from torchplate.measurement import (
        Layout,
        MeasurementError,
        assess,
        describe,
        frf_of_hits,
        frfs_of_tables,
        modes,
        read_frf_table,
        read_geometry,
        read_measurement,
        read_modal_model,
        read_nodes,
        read_recordings,
    )
    from torchplate.search import minimize

    def config(path: Path) -> None:
        load_run(path).optimizer()

    def checkpoint(path: Path) -> None:
        recipe = load_run(path.parent / "config.yaml")
        found = read_checkpoint(recipe, path.parent, torch.device("cpu"), 1)
        minimize(
            lambda x: x.square().sum(-1), recipe.optimizer(), n_dimension=1, batch_shape=(1,),
            generator=torch.Generator(), n_generation=int(found["generation"]) + 1, resume=found,
        )  # fmt: skip

    def judged(path: Path) -> None:
        assess(read_measurement(path))

    # What the verbs `new`, `modes` and `frf` make of a file that could be read.
    def draft(path: Path) -> None:
        drafted(path, Wishes())

    def analysed(path: Path) -> None:
        modes(read_measurement(path))

    def estimated(path: Path) -> None:
        frf_of_hits([replace(one, reference=one.reference or 1) for one in read_recordings(path)])

    def tabled(path: Path) -> None:
        table = read_frf_table(path)
        if table is None:
            raise MeasurementError("no table of FRFs")
        one_response = table.frf[:, 0] if table.frf.ndim == 3 else table.frf
        nodes = range(4, 4 + one_response.shape[1])
        assess(frfs_of_tables([path], [table], Layout(responses=(1,), motion="acceleration"), list(nodes)))

    suffix = Path(name).suffix
    if name == "checkpoint.pt":
        return [checkpoint]
    if name == "descents.pt":
        return [lambda path: DescentFile(path, {"config": "a"}).read()]
    return {
        ".uff": [judged, read_geometry, describe, estimated, read_modal_model, read_nodes, draft, analysed],
        ".npz": [judged, estimated, draft, analysed, tabled],
        ".csv": [estimated, read_nodes, read_modal_model, tabled],
        ".mat": [estimated, tabled],
        ".yaml": [config],
    }.get(suffix, [estimated])


def mutated(name: str, files: dict[str, bytes], draw: random.Random) -> bytes:
    """A file changed in one to four places."""
    suffix = Path(name).suffix
    content = files[name]
    if suffix in (".npz", ".pt") and draw.random() < 0.75:
        return (_archive if suffix == ".npz" else _tensors)(content, draw)
    for _ in range(draw.randint(1, 4)):
        content = _changed(content, files, suffix, draw)
    return content


def _changed(content: bytes, files: dict[str, bytes], suffix: str, draw: random.Random) -> bytes:
    import re

    data = bytearray(content)
    at, n = draw.randrange(len(data) + 1), len(data)
    end = min(n, at + draw.choice([1, 2, 8, 40, 400]))
    kind = draw.randrange(10)
    if kind == 0 and n:
        data[min(at, n - 1)] ^= 1 << draw.randrange(8)
    elif kind == 1:
        data[at:end] = draw.randbytes(end - at)
    elif kind == 2:
        del data[at:end]
    elif kind == 3:
        data[at:at] = data[at:end] * draw.choice([1, 2, 50])
    elif kind == 4:
        del data[at:]
    elif kind == 5:
        other = files[draw.choice([one for one in files if Path(one).suffix == suffix])]
        data[at:end] = other[draw.randrange(len(other) + 1) :][: draw.choice([10, 100, 10_000])]
    elif kind == 6:
        lines = bytes(data).split(b"\n")
        one, two = draw.randrange(len(lines)), draw.randrange(len(lines))
        if draw.random() < 0.5:
            lines[one], lines[two] = lines[two], lines[one]
        else:
            del lines[one]
        data = bytearray(b"\n".join(lines))
    elif kind == 7 and suffix == ".yaml":
        data[at:at] = draw.choice(YAML_WORDS)
    else:
        numbers = list(re.finditer(rb"[-+]?\d[\d.]*(?:[eE][-+]?\d+)?", bytes(data)))
        if numbers:
            found = draw.choice(numbers)
            data[found.start() : found.end()] = draw.choice([*WORDS, str(draw.randint(-99, 3000)).encode()])
    return bytes(data)


def _archive(content: bytes, draw: random.Random) -> bytes:
    import numpy as np

    arrays = dict(np.load(io.BytesIO(content)))
    for _ in range(draw.randint(1, 3)):
        key = draw.choice(sorted(arrays))
        one = arrays[key]
        deeds: list[Callable[[], object]] = [
            lambda one=one: one.astype(draw.choice(["f2", "f8", "i1", "u8", "c16", "U3", "S5", "?"]), casting="unsafe"),
            lambda one=one: one.reshape(draw.choice([(-1,), (1, -1), (-1, 1), (1, 1, -1), one.shape[::-1]])),
            lambda one=one: one[: draw.randrange(max(1, len(one)))],
            lambda one=one: np.where(
                np.arange(one.size).reshape(one.shape) % 3 == 0, draw.choice([np.nan, np.inf, -1, 0, 1e300]), one
            ),
            lambda one=one: one[::-1],
            lambda: np.array(draw.choice([0, "x", "\x1b[2J", np.nan, 10**9, -5])),
            lambda one=one: np.concatenate([one, one]),
            lambda: np.zeros(0),
            lambda one=one: np.array([{"a": one}], dtype=object),
        ]
        deed = draw.randrange(len(deeds) + 2)
        if deed == len(deeds):
            del arrays[key]
            if not arrays:
                break
        elif deed == len(deeds) + 1:
            arrays[draw.choice(["time", "fs", "frf", "kind", "unit", "notes", "x" * 50])] = arrays.pop(key)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    arrays[key] = np.asarray(deeds[deed]())
                except (TypeError, ValueError, IndexError):
                    continue
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    if draw.random() < 0.1:  # a head that promises more than there is
        return _promising(packed.getvalue(), draw)
    return packed.getvalue()


def _promising(content: bytes, draw: random.Random) -> bytes:
    import re

    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if draw.random() < 0.4:
                shape = draw.choice([b"(99999999999,)", b"(0, 9)", b"(-1,)", b"(1e9,)", b"(((", b"(4,)"])
                data = re.sub(rb"\([\d, ]*\)", lambda _, shape=shape: shape, data, count=1)
            new.writestr(name, data)
    return out.getvalue()


def _tensors(content: bytes, draw: random.Random) -> bytes:
    import torch

    held = torch.load(io.BytesIO(content), weights_only=True)
    for _ in range(draw.randint(1, 3)):
        key = draw.choice(sorted(held))
        one = held[key]
        if not isinstance(one, torch.Tensor):
            continue
        deed = draw.randrange(9)
        if deed == 0:
            del held[key]
        elif deed == 1:
            held[key] = one.to(draw.choice([torch.float16, torch.int8, torch.complex64, torch.bool, torch.float64]))
        elif deed == 2:
            held[key] = one[None]
        elif deed == 3:
            held[key] = one.flatten()[: draw.randrange(one.numel() + 1)]
        elif deed == 4:
            held[key] = torch.full_like(one, draw.choice([0, 1, 77, 100]))
        elif deed == 5 and one.is_floating_point():
            held[key] = one * draw.choice([float("nan"), float("inf"), -1.0, 1e300])
        elif deed == 6:
            held[key] = draw.choice(["text", None, 3, [one], {"a": one}])
        elif deed == 7:
            held[draw.choice(["generation", "state.population", "told", "start", "x"])] = one
        else:
            held[key] = torch.cat([one.flatten(), one.flatten()])
        if not held:
            break
    packed = io.BytesIO()
    torch.save(held, packed)
    return packed.getvalue()


class Watch:
    """What a reader does beside reading: it may open files for reading, and nothing else."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.seen, self.on = str(folder), list[str](), False
        sys.addaudithook(self._heard)

    def _heard(self, event: str, told: tuple[object, ...]) -> None:
        if not self.on:
            return
        writes = event == "open" and isinstance(told[1], str) and set(told[1]) & set("wax+")
        writes = writes or event in ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "shutil.rmtree")
        runs = event in (
            "subprocess.Popen",
            "os.system",
            "os.exec",
            "os.posix_spawn",
            "pickle.find_class",
            "socket.connect",
            "socket.bind",
        )
        if writes or runs:
            self.seen.append(f"{event} {told[:1]}")


class Memory:
    """What a reading takes of the machine's memory at its peak, beyond what the process had as it began.

    Torch and NumPy take theirs past Python's own count, so the kernel is asked: it forgets its high-water mark before
    each reading. Blocks of 64 KiB and more go back to it when they are freed, else a reading would be given those of
    the one before.
    """

    MMAP_THRESHOLD = -3  # of mallopt(3)

    def __init__(self) -> None:
        ctypes.CDLL(None).mallopt(self.MMAP_THRESHOLD, 2**16)
        self.peak = 0

    def begin(self) -> None:
        """A reading begins."""
        Path("/proc/self/clear_refs").write_text("5")
        self.before = self._told("VmRSS")

    def end(self) -> None:
        """It has ended."""
        self.peak = max(self.peak, self._told("VmHWM") - self.before)

    def _told(self, key: str) -> int:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{key}:"))


def batch(names: list[str], files: dict[str, bytes], first: int, seed: int, folder: Path, report: Path) -> None:
    """Some cases in this process, which ends with them; each case is told before and after."""
    from torchplate.cli.config import InputError
    from torchplate.measurement import MeasurementError

    def alarm(*_: object) -> None:
        raise Hang

    def size() -> int:
        return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()

    signal.signal(signal.SIGALRM, alarm)
    resource.setrlimit(resource.RLIMIT_AS, (size() + ROOM, size() + ROOM))
    watch, memory = Watch(folder), Memory()
    warnings.simplefilter("ignore")
    with report.open("a", buffering=1) as told:
        for number in range(first, first + BATCH):
            draw = random.Random(seed * 1_000_003 + number)
            name = names[number % len(names)]
            path = folder / name
            path.write_bytes(mutated(name, files, draw))
            told.write(json.dumps({"begun": number, "name": name}) + "\n")
            for read in readers(name):
                memory.begin()
                began, outcome, watch.seen = time.monotonic(), "read", []
                try:
                    signal.setitimer(signal.ITIMER_REAL, SECONDS)
                    watch.on = True
                    read(path)
                except (InputError, MeasurementError) as error:
                    outcome = "refused"
                    if "\n" in str(error) or len(str(error)) > 1500 or any(ord(sign) == 27 for sign in str(error)):
                        outcome = f"finding: no sentence of one line: {str(error)[:300]!r}"
                except Hang:
                    outcome = f"finding: hung for {SECONDS:g} s"
                except BaseException as error:
                    where = traceback.extract_tb(error.__traceback__)
                    own = [one for one in where if "torchplate" in one.filename] or where
                    place = f"{Path(own[-1].filename).name}:{own[-1].lineno}"
                    outcome = f"finding: {type(error).__name__} in {place}: {str(error)[:150]}"
                finally:
                    watch.on = False
                    signal.setitimer(signal.ITIMER_REAL, 0.0)
                memory.end()
                if watch.seen:
                    outcome = f"finding: did {watch.seen[:3]}"
                line = {"case": number, "outcome": outcome, "seconds": time.monotonic() - began}
                told.write(json.dumps(line) + "\n")
    with report.open("a") as told:
        told.write(json.dumps({"peak": memory.peak}) + "\n")


def main() -> int:
    """Mutate, read, count and print; 1 if there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutations", type=int, default=20_000, help="at least so many files (default: 20000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", help="names of the corpus")
    parser.add_argument("--write", action="store_true", help="put the figures onto docs/verification.md")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    folder = Path(tempfile.mkdtemp(prefix="fuzzing_"))
    files = corpus(folder)
    names = given.only or sorted(files)
    report = folder / "report.jsonl"
    lost = []
    for first in range(0, given.mutations, BATCH):
        child = os.fork()
        if child == 0:
            status = 1
            try:
                batch(names, files, first, given.seed, folder, report)
                status = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(status)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code:
            last = [json.loads(line) for line in report.read_text().splitlines() if "begun" in line][-1]
            lost.append(f"finding: the process ended with {code} at case {last['begun']}, {last['name']}")
    lines = [json.loads(line) for line in report.read_text().splitlines()]
    named = {line["begun"]: line["name"] for line in lines if "begun" in line}
    cases = [line for line in lines if "case" in line]
    findings = Counter(f"{named[line['case']]}: {line['outcome']}" for line in cases if "finding" in line["outcome"])
    findings.update(lost)
    where = {
        f"{named[line['case']]}: {line['outcome']}": line["case"] for line in cases if "finding" in line["outcome"]
    }
    for finding, count in findings.most_common():
        print(f"  {count} × {finding} (case {where.get(finding)})")
    kinds = Counter("finding" if "finding" in line["outcome"] else line["outcome"] for line in cases)
    peak = max((line["peak"] for line in lines if "peak" in line), default=0)
    slowest = max((line["seconds"] for line in cases), default=0.0)
    told = (
        f"{len(named)} mutated files, {len(cases)} readings: {kinds['refused']} refused in one sentence, "
        f"{kinds['read']} read, {sum(findings.values())} findings; slowest {slowest:.2f} s, "
        f"a reading takes {peak / 2**20:.0f} MiB at most"
    )
    print(told)
    if given.write:
        command = f"tests/trust/fuzzing.py --mutations {given.mutations} --seed {given.seed}"
        figures.put("mutated files", command, told)
    return int(bool(findings))


if __name__ == "__main__":
    sys.exit(main())
