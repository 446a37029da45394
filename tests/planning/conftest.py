"""Plates that two effects explain alike in closed form, tested once; and what a further test of them would read."""

import dataclasses
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from torchplate.diagnosis.rivals import Doubt, Rival
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.settings import SETTINGS, Meshes
from torchplate.diagnosis.settings.fitting import Fineness
from torchplate.diagnosis.target import FrfTarget
from torchplate.effects import CATALOGUE
from torchplate.measurement import SI_UNIT, Channel, Imperfections, Measurement
from torchplate.measurement.assessment.noise import noise_level
from torchplate.model import PlateModel, Searched
from torchplate.planning.bench import Bench
from torchplate.plate import Mesh

SIDES = (0.43, 0.3)
LINES = torch.linspace(40.0, 260.0, 100, dtype=torch.float64)
# Where the plate moves on its wires as a whole.
LOW = torch.linspace(4.0, 110.0, 100, dtype=torch.float64)
RESPONSE, REFERENCE = (3, 17), (7, 9, 26)
YOUNG, DENSITY, WIRE = 2.05e11, 7850.0, 2000.0
SHARE = 0.01
TOLD = Imperfections(position_std=1e-3, frequency_drift=1e-4, calibration_std=0.01, damping_scatter=0.0)
BASE: dict[str, Any] = {
    "plate": {"youngs_modulus": YOUNG, "poisson_ratio": 0.3, "density": DENSITY, "thickness": 0.003},
    "loss": {"stiffness_loss_factor": 1e-2},
    "wires": {"stiffness": WIRE, "viscous_damping": 0.7},
}
BOX = {
    "plate.youngs_modulus": Searched(1.6e11, 2.5e11),
    "loss.stiffness_loss_factor": Searched(1e-3, 5e-2, True),
    "wires.stiffness": Searched(500.0, 5000.0, True),
}
# Plate and hypotheses have the same mesh, so that the given one does.
COARSE = dataclasses.replace(SETTINGS, meshes=Meshes(searching=Fineness(24, 0.02, 3e-5, 1.0, 2.5e-3)))
NODES = (2, 8, 29, 33)
# The place of the third.
AT = (0.0, 1.0)

PAIRS = ("level", "support", "damping")
Odd = tuple[Mapping[str, Any], Mapping[str, float], Mapping[str, Searched]]


def twins_of(pair: str, size: float) -> dict[str, Odd]:
    """Name → what the effect is, what else of the model is then other, and what of the effect is searched.

    Args:
        pair: one of PAIRS.
        size: of the effect, times what it usually is here.
    """
    heavier, tighter, rate = 1 + 0.08 * size, 0.8 * size, 1.5 * size
    if pair == "level":
        # Without anything to the ground M times a factor is H over it, where E takes the factor too.
        young = {"plate.youngs_modulus": YOUNG / heavier}
        return {
            "density": ({"value": heavier * DENSITY}, {}, {"value": Searched(6e3, 1e4)}),
            "sensor_gain": ({"gain": 1 / heavier}, young, {"gain": Searched(0.5, 2.0)}),
        }
    if pair == "support":
        # A tighter wire is a spring to the ground beside it.
        factors = {"factor_1": 1.0, "factor_2": 1.0, "factor_3": 1 + tighter, "factor_4": 1.0}
        spring = {"x": AT[0], "y": AT[1], "stiffness": tighter * WIRE}
        return {
            "support_asymmetry": ({"nodes": NODES} | factors, {}, {"factor_3": Searched(0.0, 4.0)}),
            "ground_spring": (spring, {}, {"stiffness": Searched(1.0, 1e4, True)}),
        }
    # (s + r)² is s² + 2 r s, but for r².
    viscous = {"mass_coefficient": 2 * rate, "stiffness_coefficient": 0.0}
    return {
        "exponential_window": ({"rate": rate}, {}, {"rate": Searched(0.0, 10.0)}),
        "viscous_damping": (viscous, {}, {"mass_coefficient": Searched(0.0, 20.0)}),
    }


def given(pair: str) -> PlateModel:
    """The model as it is believed."""
    # An accelerance tells a window by its phase, since the analyser takes the window for motion.
    hung, kind = pair != "level", "receptance" if pair == "damping" else "accelerance"
    effects = {
        "plate": CATALOGUE["plate"](),
        "loss": CATALOGUE["hysteretic_damping"](),
        "wires": CATALOGUE["support_spring"](nodes=NODES),
    }
    if not hung:
        effects.pop("wires")
    known = {f"{label}.{key}": value for label in effects for key, value in BASE[label].items()}
    box = {key: ends for key, ends in BOX.items() if key.split(".")[0] in effects}
    known = {key: value for key, value in known.items() if key not in box}
    channels = list(RESPONSE), list(REFERENCE)
    return PlateModel(Mesh(*SIDES, 6, 4), effects, known, box, *channels, kind)


def rival(model: PlateModel, name: str, odd: Odd) -> Rival:
    """One of a pair, where it is exactly right; of its precision nothing is known yet."""
    told, other, wanted = odd
    kind = CATALOGUE[name]
    options = {key: told[key] for key in ("nodes",) if key in told}
    effects = {**model.effects, "odd": kind(**options)}
    values = {f"{label}.{key}": value for label in model.effects for key, value in BASE[label].items()}
    values |= {f"odd.{key}": value for key, value in told.items() if key not in options} | dict(other)
    searched = model.searched | {f"odd.{key}": ends for key, ends in wanted.items()}
    whole = model.replaced(effects=effects, known=values, searched=searched)
    position = whole.space.to_cube(torch.tensor([values[key] for key in whole.names], dtype=torch.float64))
    precision = 1e6 * torch.eye(len(position), dtype=torch.float64)
    return Rival(name, "odd", 0.5, effects, whole.known_values, whole.searched, position, precision)


def measured(frf: torch.Tensor, seed: int, kind: str = "accelerance", lines: torch.Tensor = LINES) -> Measurement:
    """FRFs with a noise of one per cent, half in proportion to them."""
    generator = torch.Generator().manual_seed(seed)
    std = SHARE * (0.25 * (frf.abs().square() + frf.abs().square().mean(0))).sqrt()
    noise = torch.view_as_complex(torch.randn(*frf.shape, 2, generator=generator, dtype=torch.float64)) * std
    n_response, n_reference = frf.shape[1:]
    return Measurement(
        lines,
        frf + noise,
        torch.ones(n_response, n_reference, dtype=torch.bool),
        tuple(Channel(RESPONSE[k] if n_response == len(RESPONSE) else 1) for k in range(n_response)),
        tuple(Channel(REFERENCE[k] if n_reference == len(REFERENCE) else 1) for k in range(n_reference)),
        kind,
        SI_UNIT[kind],
    )


class Twins:
    """A pair on a plate that was tested once, as a diagnosis of that test leaves it."""

    @torch.no_grad()
    def __init__(self, pair: str, seed: int = 5, size: float = 1.0) -> None:
        self.model, self.lines = given(pair), LOW if pair == "support" else LINES
        bare = [rival(self.model, name, odd) for name, odd in twins_of(pair, size).items()]
        first = bare[0].model(self.model)
        self.frf = first.frf(first.space.to_si(bare[0].position), self.lines)
        self.measurement = measured(self.frf, seed, self.model.kind, self.lines)
        noise = noise_level(self.measurement)
        target = FrfTarget(
            self.measurement, noise, torch.zeros(2, 3, dtype=torch.bool), imperfections=TOLD, settings=COARSE
        )
        self.builder = ForwardSelection.of(self.model, target, {}, lambda _: None).builder
        self.target = self.builder.target
        rivals = [self._known_so_well(one) for one in bare]
        self.doubt = Doubt("odd", tuple(rivals), 1.0, 1.0, True, SHARE)

    def _known_so_well(self, one: Rival) -> Rival:
        """With what the first test says of its parameters, beside a uniform prior."""
        whole, std = one.model(self.model), self.target.noise.std

        def frf(position):
            found = whole.frf(whole.space.to_si(position), self.lines) / std
            return torch.view_as_real(found).flatten(-4)

        step = 1e-5 * torch.eye(len(one.position), dtype=torch.float64)
        slope = (frf(one.position + step) - frf(one.position - step)).mT / 2e-5
        return dataclasses.replace(one, precision=12.0 * torch.eye(len(step)).to(slope) + slope.mT @ slope)

    def bench(self, proposal=None) -> list[Bench]:
        """Both, where a proposal reads or attaches something."""
        own = () if proposal is None else (*proposal.places, *(proposal.response or ()), *(proposal.reference or ()))
        return [Bench(self.builder, one, list(own)) for one in self.doubt.rivals]


@pytest.fixture(scope="session")
def lab() -> SimpleNamespace:
    """All of the above, and each pair made once."""
    made: dict[str, Twins] = {}

    def twins(pair: str) -> Twins:
        if pair not in made:
            made[pair] = Twins(pair)
        return made[pair]

    return SimpleNamespace(twins=twins, TOLD=TOLD, given=given, measured=measured, LINES=LINES, COARSE=COARSE)
