"""What a diagnosis that was stopped goes on from: the ends of the descents it had made, in their order.

Everything else that it had computed follows from these and is computed again, to the same last digit.
"""

import hashlib
import io
import json
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from torchplate.cli.config import InputError, dump
from torchplate.cli.config.build import Run
from torchplate.cli.folder.writing import write_bytes
from torchplate.search import Descent

EVERY = 2.0
"""Seconds of work at most that a diagnosis loses; the file is written anew each time."""
PARTS = ("start", "position", "objective")
"""The tensors of a descent."""


class DescentFile:
    """The descents of one diagnosis, kept in its folder as it goes on.

    Args:
        path: the file.
        told: what the diagnosis depends on; see `depends_on`.
        every: seconds between writings; `EVERY` if left out.
    """

    def __init__(self, path: Path, told: dict[str, Any], every: float | None = None) -> None:
        self.path, self.told = path, told
        self.every = EVERY if every is None else every
        self._written = -float("inf")

    def keep(self, descents: Sequence[Descent]) -> None:
        """Write them, unless that was done a moment ago."""
        if not descents or time.monotonic() - self._written < self.every:
            return
        # Laid end to end: hundreds of small tensors take a hundred times as long to write.
        content = {part: torch.cat([getattr(one, part).flatten() for one in descents]) for part in PARTS}
        content["shape"] = torch.tensor([list(one.start.shape) for one in descents])
        content["n_evaluation"] = torch.tensor([one.n_evaluation for one in descents])
        content["told"] = torch.tensor(list(json.dumps(self.told).encode()), dtype=torch.uint8)
        packed = io.BytesIO()
        torch.save(content, packed)
        write_bytes(self.path, packed.getvalue())
        self._written = time.monotonic()

    def read(self) -> list[Descent]:
        """What an interrupted diagnosis has left; nothing where it was stopped before it had left something.

        Raises:
            InputError: if the file is broken, or that of a diagnosis which would not make the same descents.
        """
        if not self.path.exists():
            return []
        packed = self.path.read_bytes()
        try:
            content = torch.load(io.BytesIO(packed), weights_only=True, map_location="cpu")
            told = json.loads(bytes(content["told"].tolist()))
            found = _taken_apart(content)
        except Exception as error:  # whatever torch says of a file that is none of its own
            raise InputError(
                f"--resume: Expected the descents of a diagnosis in {self.path}, got another file. Give --force "
                "instead to begin anew."
            ) from error
        for key, now in self.told.items():
            if told.get(key) != now:
                shown = "" if len(str(now)) > 60 else f", {told.get(key)} before and {now} now"
                raise InputError(
                    f"--resume: Expected the {key} that {self.path} was made with, got another{shown}. Set it back, or "
                    "give --force instead to begin anew."
                )
        return found


def _taken_apart(content: dict[str, torch.Tensor]) -> list[Descent]:
    """The descents of a file.

    Raises:
        RuntimeError: if the parts do not fit together.
        ValueError: likewise.
    """
    shape, cost = content["shape"].tolist(), content["n_evaluation"].tolist()
    size = {part: [n if part == "objective" else n * k for n, k in shape] for part in PARTS}
    start, position, objective = (content[part].split(size[part]) for part in PARTS)
    return [
        Descent(begun.reshape(n, k), ended.reshape(n, k), value, int(spent))
        for (n, k), begun, ended, value, spent in zip(shape, start, position, objective, cost, strict=True)
    ]


def depends_on(recipe: Run, device: str) -> dict[str, Any]:
    """All that the last digit of a diagnosis depends on."""
    config = {key: value for key, value in recipe.raw.items() if key != "log"}
    return {
        "config": hashlib.sha256(dump(config).encode()).hexdigest(),
        "measurement": _digest(_inputs(recipe)),
        "version of torchplate": _digest(sorted(Path(__file__).parents[2].rglob("*.py"))),
        "version of torch": torch.__version__,
        "device": device,
        "processor": f"{platform.machine()} {torch.backends.cpu.get_cpu_capability()}",
        "number of threads": torch.get_num_threads(),
    }


def _inputs(recipe: Run) -> list[Path]:
    measurement = recipe.config.measurement
    modal = measurement.modal_model
    given = (measurement.file, measurement.nodes, None if modal is None else modal.file)
    return [recipe.path.parent / one for one in given if one is not None]


def _digest(paths: Sequence[Path]) -> str:
    found = hashlib.sha256()
    for path in paths:
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()
