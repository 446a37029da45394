"""Plates with known numbers, and measurements made from them."""

from collections.abc import Sequence

import pytest
import torch

from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.measurement import SI_UNIT, Channel, Measurement
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

# True value and interval; the truth is not in the middle.
BOX = {
    "plate.youngs_modulus": (6.6e10, (5.0e10, 9.0e10)),
    "plate.density": (2750.0, (2400.0, 3300.0)),
    "wires.stiffness": (2100.0, (1000.0, 4000.0)),
    "wires.viscous_damping": (0.7, (0.0, 2.0)),
    "loss.stiffness_loss_factor": (8.0e-3, (1.0e-3, 3.0e-2)),
    "loss.mass_loss_factor": (0.0, (0.0, 900.0)),
}
KNOWN = {"plate.poisson_ratio": 0.33, "plate.thickness": 0.004}


class Bench:
    box = BOX

    @staticmethod
    def model(searched: Sequence[str], *, wires: bool = True, sides: tuple[float, float] = (0.5, 0.32)) -> PlateModel:
        effects = {"plate": Plate(), "loss": HystereticDamping()}
        if wires:
            effects["wires"] = SupportSpring(nodes=(2, 5, 11))
        known = KNOWN | {
            name: truth for name, (truth, _) in BOX.items() if name not in searched and (wires or "wires" not in name)
        }
        boxes = {name: Searched(*BOX[name][1]) for name in searched}
        return PlateModel(Mesh(*sides, 3, 2), effects, known, boxes, [4, 7], [1, 6], "accelerance")

    @staticmethod
    def fine_model(searched: Sequence[str]) -> PlateModel:
        """Four by three elements, well damped, one sensor and two forces."""
        known = KNOWN | {name: truth for name, (truth, _) in BOX.items() if name not in searched}
        boxes = {name: Searched(*BOX[name][1]) for name in searched}
        effects = {"plate": Plate(), "wires": SupportSpring(nodes=(2, 9, 18)), "loss": HystereticDamping()}
        return PlateModel(Mesh(0.5, 0.32, 4, 3), effects, known, boxes, [4], [1, 18], "accelerance")

    @staticmethod
    def truth(model: PlateModel) -> torch.Tensor:
        return torch.tensor([BOX[name][0] for name in model.names], dtype=torch.float64)

    @staticmethod
    def measurement(
        model: PlateModel,
        theta: torch.Tensor,
        noise: float = 0.0,
        seed: int = 0,
        frequency: torch.Tensor | None = None,
    ) -> Measurement:
        """Its FRFs with white noise, `noise` times each FRF's rms in real and imaginary part alike."""
        if frequency is None:
            frequency = torch.linspace(6.0, 330.0, 82, dtype=torch.float64)
        frf = model.frf(theta, frequency)
        generator = torch.Generator().manual_seed(seed)
        white = torch.complex(*torch.randn(2, *frf.shape, generator=generator, dtype=torch.float64))
        frf = frf + noise * white * frf.abs().square().mean(0).sqrt()
        return Measurement(
            frequency=frequency,
            frf=frf,
            measured=torch.ones(frf.shape[1:], dtype=torch.bool),
            response=tuple(Channel(node) for node in model.response),
            reference=tuple(Channel(node) for node in model.reference),
            kind="accelerance",
            unit=SI_UNIT["accelerance"],
        )


@pytest.fixture(scope="session")
def bench() -> type[Bench]:
    return Bench
