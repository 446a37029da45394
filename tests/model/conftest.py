"""Plates to test on, and an effect that gives single elements a loss of their own."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pytest
import torch

from torchplate.effects import CATALOGUE, Effect, HystereticDamping, Parameter, Plate, SupportSpring, ViscousDamping
from torchplate.model import PlateModel, Searched
from torchplate.plate import Local, Mesh, Section

# Young's modulus [Pa], Poisson's ratio, density [kg/m³].
METALS = {
    "steel": (2.1e11, 0.3, 7860.0),
    "aluminium": (7.0e10, 0.33, 2700.0),
    "magnesium": (4.5e10, 0.29, 1740.0),
    "brass": (1.0e11, 0.35, 8500.0),
    "titanium": (1.14e11, 0.32, 4430.0),
}


@dataclass(frozen=True)
class LossField(Effect):
    """Every element has another hysteretic loss factor: base (1 + x + 2 y²)."""

    parameters = {"base": Parameter("-", "loss factor at the corner", neutral=0.0)}
    acts_on = frozenset({"damping"})
    shows = "Only the tests use it."
    source = "none"

    def section(self, mesh: Mesh, section: Section, value: Mapping[str, torch.Tensor]) -> Section:
        x, y = mesh.element_place.to(value["base"]).unbind(-1)
        return section._replace(loss_factor=(value["base"][..., None] * (1 + x + 2 * y**2))[..., None])


@dataclass(frozen=True)
class Lump(Effect):
    """A mass at a fixed place."""

    at: tuple[float, float] = (0.37, 0.81)

    parameters = {"mass": Parameter("kg", "mass", neutral=0.0)}
    acts_on = frozenset({"mass"})
    shows = "Only the tests use it."
    source = "none"

    def local(self, mesh: Mesh, value: Mapping[str, torch.Tensor]) -> Local:
        return Local(
            mesh.deflection_at(mesh.places([self.at]).to(value["mass"])),
            mass=value["mass"][..., None].expand(*value["mass"].shape, 1),
        )


# The catalogue is what users see, and what other tests draw their cases from.
for effect in (LossField, Lump):
    del CATALOGUE[effect.name]


def build(
    mesh: Mesh,
    known: Mapping[str, float] | None = None,
    searched: Mapping[str, Searched] | None = None,
    *,
    metal: str = "aluminium",
    thickness: float = 0.003,
    wires: Sequence[int | tuple[float, float]] = ((0.21, 0.0), (0.9, 0.13), (0.66, 0.94)),
    lump: tuple[float, float] = (0.37, 0.81),
    loss_field: bool = False,
    **options: Any,
) -> PlateModel:
    """A plate on wires with a lump and all kinds of damping, neutral where `known` and `searched` are silent."""
    young, poisson, density = METALS[metal]
    effects: dict[str, Effect] = {
        "plate": Plate(),
        "wires": SupportSpring(at=wires),
        "loss": HystereticDamping(),
        "rayleigh": ViscousDamping(),
        "lump": Lump(lump),
    }
    if loss_field:
        effects["field"] = LossField()
    values = {
        "plate.youngs_modulus": young,
        "plate.poisson_ratio": poisson,
        "plate.density": density,
        "plate.thickness": thickness,
        "wires.stiffness": 0.0,
        **(known or {}),
    }
    searched = dict(searched or {})
    return PlateModel(
        mesh, effects, {key: value for key, value in values.items() if key not in searched}, searched, **options
    )


def damping_of_every_kind(
    mesh: Mesh, *, metal: str = "aluminium", thickness: float = 0.003, size: float = 1.0
) -> dict[str, float]:
    """Known values that damp the model in every way, by an amount the plate can feel."""
    pulse = first_bending(mesh, metal=metal, thickness=thickness) * 2 * math.pi
    return {
        "wires.viscous_damping": 0.1 * size * impedance(metal=metal, thickness=thickness),
        "loss.stiffness_loss_factor": 0.01 * size,
        "loss.mass_loss_factor": 0.02 * size * pulse**2,
        "rayleigh.mass_coefficient": 0.01 * size * pulse,
        "rayleigh.stiffness_coefficient": 0.003 * size / pulse,
    }


def first_bending(mesh: Mesh, *, metal: str = "aluminium", thickness: float = 0.003) -> float:
    """About where bending begins: 22.4 √(D/ρh) / L² of the longer side [Hz]."""
    young, poisson, density = METALS[metal]
    flexural = young * thickness**3 / (12 * (1 - poisson**2))
    return 22.4 * math.sqrt(flexural / (density * thickness)) / max(mesh.length_x, mesh.length_y) ** 2 / (2 * math.pi)


def impedance(*, metal: str = "aluminium", thickness: float = 0.003) -> float:
    """Driving-point impedance of the infinite plate, 8 √(D ρh) [N s/m]: a dashpot of this size takes the most power."""
    young, poisson, density = METALS[metal]
    return 8 * math.sqrt(young * thickness**3 / (12 * (1 - poisson**2)) * density * thickness)


class Plates:
    """What the tests of this folder share."""

    metals = METALS
    build = staticmethod(build)
    damping_of_every_kind = staticmethod(damping_of_every_kind)
    first_bending = staticmethod(first_bending)
    impedance = staticmethod(impedance)
    nothing = torch.zeros(0, dtype=torch.float64)


@pytest.fixture(scope="session")
def plates() -> type[Plates]:
    return Plates


@pytest.fixture(scope="session")
def relative_error() -> Callable[[torch.Tensor, torch.Tensor], float]:
    """Largest ‖found − expected‖ / ‖expected‖ over the FRFs, norms over the lines."""

    def error(found: torch.Tensor, expected: torch.Tensor) -> float:
        assert found.shape == expected.shape
        return ((found - expected).norm(dim=-3) / expected.norm(dim=-3)).max().item()

    return error
