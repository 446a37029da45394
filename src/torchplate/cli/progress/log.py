"""What a run writes while it goes on: TensorBoard, the history table, checkpoints. The only file with tensorboard."""

import csv
import io
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from torchplate.cli.folder.writing import whole, write_bytes
from torchplate.cli.progress.layout import BEST, GAP, of_a_diagnosis, of_a_search, problem_tag, quartiles
from torchplate.diagnosis import Diagnosis
from torchplate.report import lay_out, log_figures, step_tags
from torchplate.search import Progress

_EVENTS = "events.out.tfevents."
_DIAGNOSIS = ".diagnosis"
# A folder for each of several searches, with the number of its rows in the history.
REPEAT = "search_"
HISTORY = ("search", "generation", "n_evaluation", "best_objective", "mean_objective", "spread")


class RunLog:
    """Writes one run's folder; scalars are plotted over the number of evaluations.

    Args:
        folder: the run's folder, made if it is not there.
        names: searched parameters, "label.parameter".
        keep: continue the history of a run that was interrupted, up to this generation.
        problem: what is solved; runs of one problem lie over each other. The folder's name if left out.
    """

    def __init__(
        self, folder: Path, names: tuple[str, ...], keep: int | None = None, problem: str | None = None
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.names, self.problem = folder, names, problem or folder.name
        if keep is None:
            # TensorBoard would draw a run that was in this folder before over the new one.
            for pattern in (f"{_EVENTS}*", f"{REPEAT}*/{_EVENTS}*"):
                for path in folder.glob(pattern):
                    path.unlink()
        else:
            let_later_ones_follow(folder)
        rows = read_history(folder) if keep is not None else []
        self._rows = [row for row in rows if int(row["generation"]) <= (keep or 0)]
        purge = 1 + max((int(row["n_evaluation"]) for row in self._rows), default=-1)
        self._purge = purge if keep is not None else None
        # The end of the curve so far: what is there is not written again.
        self.step = purge - 1
        self._writer = SummaryWriter(str(folder), purge_step=self._purge)
        self._writer.add_custom_scalars(of_a_search(self.problem, names))
        self._repeats: list[SummaryWriter] = []
        with whole(self._history) as partial, partial.open("w", newline="") as file:
            writer = csv.DictWriter(file, [*HISTORY, *names])
            writer.writeheader()
            writer.writerows(self._rows)

    @property
    def _history(self) -> Path:
        return self.folder / "history.csv"

    def generation(self, progress: Progress, theta: Tensor) -> None:
        """One generation: a row for each search, scalars of the best of them, a checkpoint if it can resume.

        Args:
            progress: where the searches stand.
            theta: best values in SI units [n_search, n_parameter].
        """
        columns = [progress.n_evaluation, progress.best_objective, progress.mean_objective, progress.spread]
        with self._history.open("a", newline="") as file:
            writer = csv.writer(file)
            for search, (numbers, values) in enumerate(
                zip(zip(*(column.tolist() for column in columns), strict=True), theta.tolist(), strict=True)
            ):
                writer.writerow(
                    [search, progress.generation, numbers[0], *(f"{n:.10g}" for n in [*numbers[1:], *values])]
                )
        best = int(progress.best_objective.argmin())
        step = int(progress.n_evaluation[best])
        for tag, column in zip(HISTORY[3:], columns[1:], strict=True):
            self._writer.add_scalar(f"search/{tag}", float(column[best]), step)
        self._writer.add_scalar("search/generation", progress.generation, step)
        self._curves(progress)
        for name, value in zip(self.names, theta[best].tolist(), strict=True):
            self._writer.add_scalar(f"parameter/{name}", value, step)
        self._over_seeds(progress, theta)
        self.step = step
        if progress.snapshot:
            # A curve has no hole where the search goes on from here.
            for events in (self._writer, *self._repeats):
                events.flush()
            save_checkpoint(progress.checkpoint(), self.folder / "checkpoint.pt")

    def _curves(self, progress: Progress) -> None:
        """Where several searches run at once, a curve for each: TensorBoard lays runs of one tag over each other."""
        n_search = len(progress.best_objective)
        if n_search == 1:
            return
        if not self._repeats:
            self._repeats = [
                SummaryWriter(str(self.folder / f"{REPEAT}{search}"), purge_step=self._purge)
                for search in range(n_search)
            ]
        columns = (progress.best_objective, progress.mean_objective, progress.spread)
        for search, writer in enumerate(self._repeats):
            for tag, column in zip(HISTORY[3:], columns, strict=True):
                writer.add_scalar(f"search/{tag}", float(column[search]), int(progress.n_evaluation[search]))

    def _over_seeds(self, progress: Progress, theta: Tensor) -> None:
        """Median and quartiles over the searches: what lies over another search's of the same problem."""
        step = int(progress.n_evaluation.double().median())
        columns = {BEST: progress.best_objective} | dict(zip(self.names, theta.T, strict=True))
        for quantity, values in columns.items():
            for name, value in quartiles(self.problem, quantity, values).items():
                self._writer.add_scalar(name, value, step)

    def gap(self, gap: float, step: int) -> None:
        """The gap of the best values so far; of the first ones and the last at least, so that it is a curve."""
        self._writer.add_scalar("gap/baseline", gap, step)
        self._writer.add_scalar(problem_tag(self.problem, GAP), gap, step)

    def end(self, objective: float, step: int) -> None:
        """The objective of the result, where the search's own curve ends before it: least squares have followed."""
        if step > self.step:
            self._writer.add_scalar("search/best_objective", objective, step)

    def figure(self, tag: str, figure: Figure, step: int) -> None:
        """One figure, as an image."""
        lay_out(figure)
        self._writer.add_figure(tag, figure, step, close=False)

    def settings(
        self, settings: Mapping[str, Any], results: Mapping[str, float], superset: Mapping[str, Any] | None = None
    ) -> None:
        """Settings and results for the HParams page, in this folder (`add_hparams` would open one more).

        TensorBoard takes its columns from whichever run it meets first: so each names those of all searches, and fills
        in its own. The results are the ends of curves that are there already, by their tags.
        """
        writer = self._writer._get_file_writer()
        columns, _, _ = hparams(_plain(dict(superset or {}) | dict(settings)), dict(results))
        _, begun, ended = hparams(_plain(settings), dict(results))
        for summary in (columns, begun, ended):
            writer.add_summary(summary)

    def close(self) -> None:
        """Flush and close."""
        for writer in (self._writer, *self._repeats):
            writer.close()


def let_later_ones_follow(folder: Path) -> None:
    """Rename the event files of a run so that one that is begun now is read after them.

    TensorBoard reads them in the order of their names: the second of the clock, and then, as text, the host, the
    process and a count, so that the 11th of a process stands before its 8th of the same second.
    """
    now = int(time.time())
    for home in (folder, *folder.glob(f"{REPEAT}*")):
        there = sorted(path for path in home.glob(f"{_EVENTS}*") if path.name[len(_EVENTS) :].split(".")[0].isdigit())
        late = [path for path in there if int(path.name[len(_EVENTS) :].split(".")[0]) >= now - 1]
        for place, path in enumerate(late):
            *_, process, count = path.name.split(".")
            path.rename(home / f"{_EVENTS}{now - 1:010d}.{place:06d}.{process}.{count}")


def _plain(settings: Mapping[str, Any]) -> dict[str, bool | int | float | str]:
    """What TensorBoard takes for a setting."""
    return {key: value if isinstance(value, bool | int | float) else str(value) for key, value in settings.items()}


def log_diagnosis(folder: Path, diagnosis: Diagnosis) -> None:
    """Write a diagnosis for TensorBoard: the gap of each step, FRFs before and after, the assurance criteria, the map.

    A gap is a level from the first evaluation to the last, so that those of all models lie over each other. An earlier
    diagnosis in the folder is written over; what a search has logged there stays.

    Args:
        folder: where the event file goes, made if it is not there.
        diagnosis: what was found.
    """
    for path in folder.glob(f"{_EVENTS}*{_DIAGNOSIS}"):
        path.unlink()
    with SummaryWriter(str(folder), filename_suffix=_DIAGNOSIS) as writer:
        writer.add_custom_scalars(of_a_diagnosis())
        for name, step in step_tags(diagnosis.steps):
            for n_evaluation in (0, diagnosis.n_evaluation):
                writer.add_scalar(f"gap/{name}", step.gap, n_evaluation)
                if step.heldout is not None:
                    writer.add_scalar(f"gap/heldout/{name}", step.heldout, n_evaluation)
        for tag, figure in log_figures(diagnosis).items():
            writer.add_figure(tag, figure, diagnosis.n_evaluation, close=False)


def read_history(folder: Path) -> list[dict[str, str]]:
    """Rows of a run's history; none where there is no history.

    A row that an interruption has cut short is left out.
    """
    path = folder / "history.csv"
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return [row for row in csv.DictReader(file) if None not in row.values()]


def save_checkpoint(content: Mapping[str, Tensor], path: Path) -> None:
    """Write a checkpoint so that an interruption leaves the old one whole."""
    packed = io.BytesIO()
    torch.save(dict(content), packed)
    write_bytes(path, packed.getvalue())
