"""What a diagnosis did, descent by descent, in a few bytes each: where two of them part is found in their files."""

import hashlib
import platform
from pathlib import Path
from typing import Any

import torch


def of(tensor: torch.Tensor) -> str:
    """Of the bytes of a tensor."""
    return hashlib.sha256(tensor.contiguous().numpy().tobytes()).hexdigest()[:16]


def written_to(path: Path) -> None:
    """From here on each descent of this process adds a line: digests of its start and its end, and what it found."""
    from torchplate.search import Recall

    own = Recall.next

    def following(self: Recall, start: torch.Tensor, descend: Any) -> Any:
        found, known = own(self, start, descend)
        least = float(found.objective.min())
        with path.open("a") as file:
            file.write(f"{of(start.cpu())} {of(found.position.cpu())} {least!r}\n")
        return found, known

    Recall.next = following  # type: ignore[method-assign]


def parted(one: Path, other: Path) -> str:
    """Where two diagnoses part, in a sentence."""
    rows = [path.read_text().splitlines() if path.exists() else [] for path in (one, other)]
    for place, (mine, theirs) in enumerate(zip(*rows, strict=False)):
        if mine != theirs:
            how = "end elsewhere from one start" if mine.split()[0] == theirs.split()[0] else "start elsewhere"
            return f"they {how} at descent {place}: {mine} against {theirs}"
    return f"they share their first {min(map(len, rows))} descents; one made {len(rows[0])}, the other {len(rows[1])}"


def machine() -> str:
    """What rounding hangs on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    name = next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )
    return f"{name}, {torch.backends.cpu.get_cpu_capability()}, {torch.get_num_threads()} threads"
