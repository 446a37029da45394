"""A plate that is not square, with known numbers, and its FRFs without any error."""

import dataclasses
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
    "wires.stiffness": (2100.0, (1000.0, 4000.0)),
    "loss.stiffness_loss_factor": (8.0e-3, (1.0e-3, 3.0e-2)),
}
KNOWN = {"plate.density": 2750.0, "plate.poisson_ratio": 0.33, "plate.thickness": 0.004, "wires.viscous_damping": 0.7}
RESPONSE, REFERENCE = (4, 7), (1, 6)


def plate(searched: Sequence[str], response: Sequence[int] | None = None) -> PlateModel:
    """The plate; without responses it is one that no measurement has told where its channels are."""
    effects = {"plate": Plate(), "wires": SupportSpring(nodes=(2, 5, 11)), "loss": HystereticDamping()}
    known = KNOWN | {name: truth for name, (truth, _) in BOX.items() if name not in searched}
    boxes = {name: Searched(*BOX[name][1]) for name in searched}
    return PlateModel(Mesh(0.5, 0.32, 3, 2), effects, known, boxes, response)


def exact_frfs(kind: str = "accelerance") -> Measurement:
    model, frequency = plate(()), torch.linspace(5.0, 300.0, 61, dtype=torch.float64)
    frf = model.frf(model.known.new_zeros(0), frequency, RESPONSE, REFERENCE, kind)
    return Measurement(
        frequency=frequency,
        frf=frf,
        measured=torch.ones(frf.shape[1:], dtype=torch.bool),
        response=tuple(Channel(node) for node in RESPONSE),
        reference=tuple(Channel(node) for node in REFERENCE),
        kind=kind,  # type: ignore[arg-type]
        unit=SI_UNIT[kind],  # type: ignore[index]
    )


class Bench:
    truth = {name: value for name, (value, _) in BOX.items()}
    known = KNOWN
    plate = staticmethod(plate)
    exact_frfs = staticmethod(exact_frfs)

    @staticmethod
    def nameless(measurement: Measurement) -> Measurement:
        """The same, its channels without a node or a place."""
        response, reference = (
            tuple(Channel(0) for _ in ends) for ends in (measurement.response, measurement.reference)
        )
        return dataclasses.replace(measurement, response=response, reference=reference)


@pytest.fixture(scope="session")
def bench() -> type[Bench]:
    return Bench
