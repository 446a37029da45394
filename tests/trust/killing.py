"""`kill -9` at random moments of `run` and `diagnose`, and whether anything is lost by it.

    python tests/trust/killing.py --verb run --kills 50

Each time a command is killed at a moment drawn evenly over the seconds of the processor it takes, or, every third
time, inside the writing of a file: half of it written, or all of it and not yet on the disk. It is then resumed, which
every second time is killed again, until it ends. Counted are: whether it ended as the undisturbed one, to the last
digit; what was left in the folder, where every file has to be whole; and whatever was said otherwise. `--write` puts
the figures onto docs/verification.md.
"""

import argparse
import csv
import io
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType

# Before torch is imported, which reads it once.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# It is run as a script, beside which its neighbour lies; where tests are collected, that is on no path.
sys.path.insert(0, str(Path(__file__).parent))
import digests
import figures

PLATE = {
    "effects": {
        "plate": {"effect": "plate", "poisson_ratio": 0.31, "density": 7700.0, "thickness": 0.0031},
        "wires": {"effect": "support_spring", "nodes": [2, 5, 11], "stiffness": 1310.0, "viscous_damping": 0.83},
        "loss": {"effect": "hysteretic_damping", "stiffness_loss_factor": 6.2e-3},
    },
    "mesh": {"length_x": 0.41, "length_y": 0.29, "n_x": 3, "n_y": 2},
}
# What a diagnosis may find here, the mass among it.
KEPT = {
    "point_mass",
    "ground_spring",
    "stiffness_loss",
    "damping_patch",
    "thickness_taper",
    "time_delay",
    "channel_polarity",
}
# What a diagnosis is to find.
HIDDEN = {"hidden": {"effect": "point_mass", "x": 0.31, "y": 0.68, "mass": 0.03}}
# References, end of the band [Hz] and lines. A diagnosis of four FRFs at few lines still descends, settles on a finer
# mesh and writes its report.
WHOLE, DIAGNOSED = ((1, 6, 10), 300.0, 60), ((1, 10), 150.0, 24)
PERFECT = ("position_std", "frequency_drift", "calibration_std", "damping_scatter")
TRUTH, INTERVAL = 2.04e11, [1.5e11, 2.6e11]
SEARCHES = {
    "differential_evolution": {"n_member": 10, "n_generation": 120, "n_repeat": 2},
    "artificial_bee_colony": {"n_member": 6, "n_generation": 80},
}


@dataclass
class Trial:
    """One command that was killed, once or more.

    Attributes:
        kills: how often.
        in_writing: how many of them inside the writing of a file.
        same: whether it ended as the undisturbed one.
        went_on: how each resumption began.
        wrong: what ought not to be, a sentence each.
    """

    kills: int = 0
    in_writing: int = 0
    same: bool = False
    went_on: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


class Killing:
    """A config, what it ends in when nobody disturbs it, and the trials.

    Args:
        verb: run or diagnose.
        folder: where everything is written.
        seed: of the moments.
        n_generation: of the searches; as many as they have if left out.
    """

    def __init__(self, verb: str, folder: Path, seed: int, n_generation: int | None = None) -> None:
        self.verb, self.folder, self.draw, self.n_generation = verb, folder, random.Random(seed), n_generation
        self.spent = 0.0
        status, said = self._forked(self._measure)
        assert status == 0, said
        self.configs = [self._config(name) for name in (SEARCHES if verb == "run" else ["differential_evolution"])]
        self.whole, self.seconds, self.writings = {}, {}, {}
        for config in self.configs:
            out = folder / f"whole_{config.stem}"
            counts = folder / f"writings_{config.stem}"
            status, said = self.command(config, out, armed=counted(counts))
            assert status == 0, said
            self.writings[config] = counts.stat().st_size
            self.whole[config], self.seconds[config] = ending(verb, out), self.spent

    def _measure(self) -> int:
        """Write the measurement: the true plate's exact FRFs; for a diagnosis a mass is hidden on it."""
        import torch

        from torchplate.cli.config.build import load_model
        from torchplate.measurement import SI_UNIT, Channel, Measurement

        # The same measurement, to the last digit, however many threads its command will have.
        torch.set_num_threads(1)
        truth = json.loads(json.dumps(PLATE))
        truth["effects"]["plate"]["youngs_modulus"] = TRUTH
        if self.verb == "diagnose":
            truth["effects"] |= HIDDEN
            truth["mesh"] |= {"n_x": 4, "n_y": 3, "refine": 4, "extrapolate": True}
            truth["measurement"] = {"band": [0.0, 400.0]}
        path = self.folder / "truth.yaml"
        path.write_text(json.dumps(truth))
        model, response = load_model(path), (4, 7)
        reference, last, n_line = WHOLE if self.verb == "run" else DIAGNOSED
        frequency = torch.linspace(8.0, last, n_line, dtype=torch.float64)
        frf = model.frf(model.known.new_zeros(0), frequency, list(response), list(reference), "accelerance")
        noise = torch.view_as_complex(torch.randn(*frf.shape, 2, generator=torch.Generator().manual_seed(3)).double())
        Measurement(
            frequency=frequency,
            frf=frf + 0.01 * frf.abs() * noise,
            measured=torch.ones(frf.shape[1:], dtype=torch.bool),
            response=tuple(map(Channel, response)),
            reference=tuple(map(Channel, reference)),
            kind="accelerance",
            unit=SI_UNIT["accelerance"],
        ).to_npz(self.folder / "plate.npz")
        return 0

    def _config(self, optimizer: str) -> Path:
        searched = json.loads(json.dumps(PLATE)) | {"measurement": {"file": "plate.npz"}, "log": {"n_figure": 0}}
        searched["effects"]["plate"]["youngs_modulus"] = INTERVAL
        if self.verb == "run":
            searched["effects"]["wires"]["stiffness"] = [700.0, 2000.0]
        else:
            searched["mesh"] |= {"n_x": 4, "n_y": 3}
            # What an imperfect test may hide takes twenty times as long to tell; it is descents all the same.
            searched["measurement"] |= dict.fromkeys(PERFECT, 0.0)
        searched["search"] = {"optimizer": optimizer, "seed": 4, "tolerance": None, "basis": "full"}
        searched["search"] |= SEARCHES[optimizer]
        if self.n_generation is not None:
            searched["search"]["n_generation"] = self.n_generation
        path = self.folder / f"{optimizer}.yaml"
        path.write_text(json.dumps(searched))
        return path

    def command(
        self, config: Path, out: Path, *others: str, killed_after: float | None = None, armed: Callable[[], None] = int
    ) -> tuple[int, str]:
        """The command line in a process of its own: its exit status (-9 if it was killed), and what it said."""
        from torchplate.cli.main import main

        words = [self.verb, str(config), "--out", str(out), *others]
        # A resumed diagnosis recalls from the first descent on, and one that is run again makes them anew.
        self.trail(out).unlink(missing_ok=True)

        def call() -> int:
            digests.written_to(self.trail(out))
            armed()
            return main(words)

        return self._forked(call, killed_after)

    def trail(self, out: Path) -> Path:
        """Where the descents of a command are told."""
        return self.folder / f"{out.name}.descents"

    def _forked(self, call: Callable[[], int], killed_after: float | None = None) -> tuple[int, str]:
        said, began = self.folder / "said.txt", time.monotonic()
        child = os.fork()
        if child == 0:
            status = 1
            try:
                with said.open("w") as file, redirect_stdout(file), redirect_stderr(file):
                    status = call()
            except BaseException as error:
                with said.open("a") as file:
                    file.write(f"Traceback: {error!r}\n")
            finally:
                os._exit(status)
        ended = 0
        while killed_after is not None and not ended:
            if spent_by(child, began) >= killed_after:
                os.kill(child, signal.SIGKILL)
                break
            time.sleep(0.02)
            ended = os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        _, status, used = os.wait4(child, 0)
        self.spent = used.ru_utime + used.ru_stime
        return os.waitstatus_to_exitcode(status), said.read_text()

    def trial(self, place: int) -> Trial:
        """Kill one command and resume it until it ends."""
        config = self.configs[place % len(self.configs)]
        out, found = self.folder / f"trial_{place}", Trial()
        others: list[str] = []
        while True:
            last = found.kills > 1 or (found.kills == 1 and place % 2 == 0)
            moment, armed = None, int
            if not last and place % 3 == 2:
                armed = in_a_write(self.draw.randint(1, self.writings[config]), self.draw.random() < 0.5)
            elif not last:
                moment = self.draw.uniform(0.0, self.seconds[config])
            status, said = self.command(config, out, *others, killed_after=moment, armed=armed)
            if others:
                found.went_on.append(how(said))
            if "Traceback" in said:
                found.wrong.append(said[said.index("Traceback") :])
                break
            found.kills += status == -signal.SIGKILL
            found.in_writing += status == -signal.SIGKILL and moment is None
            found.wrong += not_whole(out)
            if status == 0:
                break
            if status == 2 and others and "Leave --resume out" in said and not (out / "versions.json").exists():
                others = []
                continue
            if status != -signal.SIGKILL:
                found.wrong.append(f"status {status}: {said}")
                break
            others = ["--resume"]
        found.same = not found.wrong and ending(self.verb, out) == self.whole[config]
        if found.same:
            shutil.rmtree(out)
            self.trail(out).unlink(missing_ok=True)
        elif self.verb == "diagnose" and not found.wrong:
            apart = digests.parted(self.trail(self.folder / f"whole_{config.stem}"), self.trail(out))
            found.wrong.append(f"ended elsewhere than the undisturbed one; {apart}. Now: {digests.machine()}")
        return found


def spent_by(child: int, began: float) -> float:
    """Seconds of the processor that a process has taken; where no system tells them, those of the clock."""
    try:
        words = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return time.monotonic() - began
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def in_a_write(nth: int, half: bool) -> Callable[[], None]:
    """Kills its own process in the nth writing of a file: with half of it written, or before it takes its name."""
    count = iter(range(1, 1_000_000))

    def killed(path: Path, content: bytes) -> None:
        if next(count) == nth:
            with _writing().whole(path) as partial:
                partial.write_bytes(content[: len(content) // 2] if half else content)
                os.kill(os.getpid(), signal.SIGKILL)

    return lambda: _before_each_write(killed)


def counted(file: Path) -> Callable[[], None]:
    """Adds a byte to a file for each writing of another."""

    def one_more(*_: object) -> None:
        with file.open("ab") as counts:
            counts.write(b".")

    return lambda: _before_each_write(one_more)


def _before_each_write(act: Callable[[Path, bytes], None]) -> None:
    own = _writing().write_bytes

    def write_bytes(path: Path, content: bytes) -> None:
        act(path, content)
        own(path, content)

    for name in ("folder.writing", "progress.log", "folder.descents"):
        module = __import__(f"torchplate.cli.{name}", fromlist=["write_bytes"])
        module.write_bytes = write_bytes


def _writing() -> ModuleType:
    from torchplate.cli.folder import writing

    return writing


def how(said: str) -> str:
    """How a resumed command began."""
    if "Leave --resume out" in said:
        return "nothing was there yet: run again"
    if "begins anew" in said:
        return "began anew and said so"
    if "has ended" in said:
        return "had ended"
    return "went on from what was kept"


def ending(verb: str, out: Path) -> object:
    """What must be the same to the last digit."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    if verb == "diagnose":
        found = json.loads((out / "diagnosis.json").read_text())
        del found["seconds"]
        return found, (out / "model.yaml").read_text()
    curve = EventAccumulator(str(out), size_guidance={"scalars": 0}).Reload().Scalars("search/best_objective")
    rows = list(csv.reader(io.StringIO((out / "history.csv").read_text())))
    return json.loads((out / "result.json").read_text()), rows, [(point.step, point.value) for point in curve]


def not_whole(out: Path) -> list[str]:
    """Files of a folder that are not whole under their own names."""
    import torch
    import yaml

    readers: dict[str, Callable[[Path], object]] = {
        ".json": lambda path: json.loads(path.read_text()),
        ".yaml": lambda path: yaml.safe_load(path.read_text())["effects"],
        ".pt": lambda path: torch.load(path, weights_only=True),
        ".html": lambda path: path.read_text().rindex("</html>"),
    }
    found = []
    for path in sorted(out.rglob("*")) if out.exists() else []:
        if path.name.startswith(".") or path.suffix not in readers:
            continue
        try:
            readers[path.suffix](path)
        except Exception as error:
            found.append(f"{path.name} is not whole: {error!r}")
    return found


def often_kept() -> None:
    """A diagnosis of seconds keeps its descents as often as one of minutes: after each."""
    from torchplate.cli.folder import descents

    descents.EVERY = 0.0


def of_fewer_effects() -> None:
    """A diagnosis goes through all its steps, over seven effects on meshes of few elements: seconds, not minutes."""
    from torchplate.diagnosis.candidates import catalogue
    from torchplate.diagnosis.settings import SETTINGS
    from torchplate.effects import CATALOGUE

    catalogue.NEVER = catalogue.NEVER | (set(CATALOGUE) - KEPT)
    for name, least in (("searching", 48), ("settling", 192)):
        mesh = replace(getattr(SETTINGS.meshes, name), least=least)
        object.__setattr__(SETTINGS.meshes, name, mesh)


def without_rendering() -> None:
    """Figures are made and not rendered, which takes most of the time of a run so small."""
    import torchplate.cli.progress.log
    import torchplate.cli.verbs.diagnose
    import torchplate.cli.verbs.run
    import torchplate.report.diagnosis
    import torchplate.report.forms.page
    import torchplate.report.run

    torchplate.report.diagnosis.png = lambda *_: b"\x89PNG\r\n\x1a\n"  # type: ignore[assignment]
    torchplate.report.run.png = lambda *_: b"\x89PNG\r\n\x1a\n"  # type: ignore[assignment]
    torchplate.report.forms.page._picture = lambda _: ""  # type: ignore[assignment]
    torchplate.cli.progress.log.log_figures = lambda *_: {}  # type: ignore[assignment]


def main() -> int:
    """Kill, count and print; 1 if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--verb", choices=["run", "diagnose"], default="run")
    parser.add_argument("--kills", type=int, default=50, help="at least so many (default: 50)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help="put the figures onto docs/verification.md")
    parser.add_argument("--generations", type=int, help="of the searches (default: 120 and 80)")
    given = parser.parse_args()
    without_rendering()
    often_kept()
    of_fewer_effects()
    import warnings

    warnings.simplefilter("ignore")
    folder = Path(tempfile.mkdtemp(prefix="killing_"))
    killing = Killing(given.verb, folder, given.seed, given.generations)
    times = ", ".join(
        f"{config.stem} {seconds:.1f} s of the processor, {killing.writings[config]} files written"
        for config, seconds in killing.seconds.items()
    )
    print(f"{given.verb}, undisturbed: {times}; {digests.machine()}", flush=True)
    trials: list[Trial] = []
    while sum(trial.kills for trial in trials) < given.kills:
        trials.append(killing.trial(len(trials)))
        for sentence in trials[-1].wrong:
            print(f"  trial {len(trials) - 1}: {sentence}", flush=True)
    kills, same = sum(trial.kills for trial in trials), sum(trial.same for trial in trials)
    print(f"{kills} kills of {len(trials)} commands: {same} ended as the undisturbed one, to the last digit")
    for what, count in sorted(Counter(one for trial in trials for one in trial.went_on).items()):
        print(f"  {count} resumptions: {what}")
    if given.write:
        in_writing = sum(trial.in_writing for trial in trials)
        command = f"tests/trust/killing.py --verb {given.verb} --kills {given.kills} --seed {given.seed}"
        found = f"{kills} kills of {len(trials)} commands, {in_writing} of them inside the writing of a file: {same}"
        figures.put(f"killing of `{given.verb}`", command, f"{found} ended as the undisturbed one, to the last digit")
    if same == len(trials):
        shutil.rmtree(folder)
        return 0
    print(f"  What differs is in {folder}")
    return 1


if __name__ == "__main__":
    sys.exit(main())
