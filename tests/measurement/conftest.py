"""A small measurement with known modes, UFF records by hand, and the way to the really measured files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from torchplate.measurement import SI_UNIT, Channel, Kind, Measurement

REAL = Path(__file__).parents[2].parent / "shared" / "data"

# Two modes of an uneven three-node chain, mass-normalised; loss factors differ so that no symmetry hides a mistake.
NODES = (3, 17, 8)
SHAPES = np.array([[0.7, 1.1, -0.4], [0.9, -0.3, 1.6]])
RESONANCES = np.array([41.0, 93.0])
LOSS = np.array([0.02, 0.05])
PLACES = {3: (0.05, 0.02, 0.0), 17: (0.11, 0.19, 0.0), 8: (0.233, 0.07, 0.001)}


def receptance(frequency: np.ndarray, responses: list[int], references: list[int]) -> np.ndarray:
    omega = 2 * np.pi * frequency[:, None, None, None]
    pole = (2 * np.pi * RESONANCES) ** 2 * (1 + 1j * LOSS)
    j = [NODES.index(n) for n in responses]
    k = [NODES.index(n) for n in references]
    residue = np.einsum("rj,rk->jkr", SHAPES[:, j], SHAPES[:, k])
    return (residue / (pole - omega**2)).sum(axis=-1)


@pytest.fixture
def make_measurement() -> Callable[..., Measurement]:
    def make(
        frequency: np.ndarray | None = None,
        kind: Kind = "accelerance",
        responses: tuple[int, ...] = (3, 17),
        references: tuple[int, ...] = (17, 3, 8),
        coordinates: bool = True,
        coherence: bool = False,
        missing: tuple[tuple[int, int], ...] = (),
    ) -> Measurement:
        lines = np.arange(20.0, 150.25, 0.25) if frequency is None else frequency
        frf = receptance(lines, list(responses), list(references))
        power = {"receptance": 0, "mobility": 1, "accelerance": 2, "transmissibility": 2}[kind]
        frf = frf * (2j * np.pi * lines[:, None, None]) ** power
        measured = torch.ones(frf.shape[1:], dtype=torch.bool)
        for j, k in missing:
            measured[j, k] = False
        places = PLACES if coordinates else {}
        gamma = torch.linspace(0.6, 0.99, frf.size, dtype=torch.float64).reshape(frf.shape)
        return Measurement(
            frequency=torch.from_numpy(lines),
            frf=torch.from_numpy(frf),
            measured=measured,
            response=tuple(Channel(n, "w", places.get(n)) for n in responses),
            reference=tuple(Channel(n, "w", places.get(n)) for n in references),
            kind=kind,
            unit=SI_UNIT[kind],
            coherence=gamma if coherence else None,
            source="chain",
        )

    return make


@pytest.fixture
def real_file() -> Callable[[str], Path]:
    def find(name: str) -> Path:
        path = REAL / name
        if not path.is_file():
            pytest.skip(f"{path} is absent: the measured files are not part of the project")
        return path

    return find


@pytest.fixture
def record_58() -> Callable[..., bytes]:
    """Write one dataset 58 by the columns of the format's own text, record by record."""

    def write(
        values: list[str],
        *,
        n_point: int,
        ordinate_type: int = 6,
        even: bool = True,
        start: float = 5.0,
        step: float = 0.5,
        function_type: int = 4,
        response: tuple[int, int] = (4, 3),
        reference: tuple[int, int] = (9, 3),
        numerator: tuple[int, str] = (12, "m/s2"),
        denominator: tuple[int, str] = (13, "N"),
        text: str = "measured by hand",
        identity: str = "    58",
        body: bytes | None = None,
    ) -> bytes:
        def quantity(specifier: int, label: str) -> str:
            return f"{specifier:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {label:20s}"

        header = [
            "    -1",
            f"{identity:80s}",
            *(f"{line:80s}" for line in (text, "NONE", "21-NOV-26 07:32:11", "NONE", "NONE")),
            f"{function_type:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{response[0]:10d}{response[1]:4d}"
            f" {'NONE':10s}{reference[0]:10d}{reference[1]:4d}",
            f"{ordinate_type:10d}{n_point:10d}{int(even):10d}"
            f"{start if even else 0.0:13.5E}{step if even else 0.0:13.5E}{0.0:13.5E}",
            quantity(18, "Hz"),
            quantity(*numerator),
            quantity(*denominator),
            quantity(0, "NONE"),
        ]
        lines = "".join(f"{line}\n" for line in header).encode()
        if body is not None:
            return lines + body + b"    -1\n"
        return lines + "".join(f"{line}\n" for line in [*values, "    -1"]).encode()

    return write
