"""Plates whose FRFs are measured with a noise that is known."""

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchplate.effects import CATALOGUE, Effect
from torchplate.measurement import Channel, Measurement
from torchplate.model import PlateModel
from torchplate.plate import Mesh

NODES = (3, 17, 28, 36, 45, 52, 61, 74, 88, 95, 101, 109, 13, 25, 33, 58, 66, 79, 82, 120)
NOBODY = torch.zeros(0, dtype=torch.float64)


def plate(
    loss: float = 3e-3,
    hidden: Mapping[str, tuple[Effect, Mapping[str, float]]] | None = None,
    sides: tuple[float, float] = (0.48, 0.4),
    kind: str = "accelerance",
) -> PlateModel:
    """A steel plate on four wires, 17 modes below 400 Hz, and whatever is hidden in it."""
    effects: dict[str, Effect] = {
        "plate": CATALOGUE["plate"](),
        "wires": CATALOGUE["support_spring"](nodes=[2, 10, 112, 120]),
        "loss": CATALOGUE["hysteretic_damping"](),
    }
    known = {
        "plate.youngs_modulus": 2.05e11,
        "plate.poisson_ratio": 0.3,
        "plate.density": 7860.0,
        "plate.thickness": 0.0027,
        "wires.stiffness": 1300.0,
        "wires.viscous_damping": 0.5,
        "loss.stiffness_loss_factor": loss,
    }
    for label, (effect, values) in (hidden or {}).items():
        effects[label] = effect
        known |= {f"{label}.{name}": value for name, value in values.items()}
    return PlateModel(Mesh(*sides, 10, 10), effects, known, kind=kind)


def lines(step: float = 1.0) -> Tensor:
    """From 5 to 400 Hz."""
    return torch.arange(5.0, 400.0 + 1e-9, step, dtype=torch.float64)


def true_std(frf: Tensor, share: float, how: str) -> Tensor:
    """Standard deviation of each part: in proportion to |H|, to its root mean square, or half and half of the power."""
    mean = frf.abs().square().mean(0, keepdim=True)
    signal = {"signal": 1.0, "sensor": 0.0, "mixed": 0.5}[how]
    return share * (0.5 * (signal * frf.abs().square() + (1 - signal) * mean)).sqrt()


def noise_of(std: Tensor, seed: int) -> Tensor:
    """Complex noise of these standard deviations."""
    generator = torch.Generator().manual_seed(seed)
    parts = torch.randn(*std.shape, 2, generator=generator, dtype=torch.float64)
    return torch.view_as_complex(parts) * std


def true_floor(std: Tensor, frf: Tensor) -> float:
    """The gap that noise of these standard deviations makes."""
    return float((math.sqrt(2) * std.norm(dim=0) / frf.norm(dim=0)).mean())


def measured(
    frequency: Tensor, frf: Tensor, response: Sequence[int], reference: Sequence[int], **others: Any
) -> Measurement:
    """A measurement of these FRFs, all pairs unless told otherwise."""
    fields: dict[str, Any] = {
        "measured": torch.ones(frf.shape[1:], dtype=torch.bool),
        "kind": "accelerance",
        "unit": "m/(N s²)",
    }
    return Measurement(
        frequency,
        frf,
        response=tuple(Channel(node) for node in response),
        reference=tuple(Channel(node) for node in reference),
        **(fields | others),
    )


@pytest.fixture(scope="session")
def lab() -> SimpleNamespace:
    """All of the above."""
    return SimpleNamespace(
        nodes=NODES,
        nobody=NOBODY,
        plate=plate,
        lines=lines,
        true_std=true_std,
        noise_of=noise_of,
        true_floor=true_floor,
        measured=measured,
    )
