"""Plates whose FRFs are measured with a noise that is known."""

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.candidates.catalogue import candidates, channels_of
from torchplate.diagnosis.fit import fit
from torchplate.diagnosis.judged import Fit, judged_at
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.selection.criterion import Hypothesis
from torchplate.diagnosis.selection.ranking import Ranking
from torchplate.diagnosis.selection.trace import State
from torchplate.diagnosis.target import FrfTarget
from torchplate.effects import CATALOGUE, Effect
from torchplate.measurement import Channel, Measurement
from torchplate.measurement.assessment.noise import Noise
from torchplate.model import PlateModel, Searched
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


SMALL_LINES = torch.linspace(10.0, 300.0, 100, dtype=torch.float64)
SMALL_RESPONSE, SMALL_REFERENCE = (3, 17), (7, 9, 21)
SPOT = (0.31, 0.62)
NUMBERS = {"youngs_modulus": 2.05e11, "poisson_ratio": 0.3, "density": 7850.0, "thickness": 0.003}
BOX = {"plate.youngs_modulus": Searched(1.8e11, 2.3e11), "loss.stiffness_loss_factor": Searched(1e-3, 5e-2, True)}


def small_plate(
    searched=None, gain=1.0, mass=0.0, wire=(), patch=1.0, ratio=1.0, aspect=1.0, loss=1e-2, along=()
) -> PlateModel:
    """A free plate with ten modes below 300 Hz; a gain, a mass, a wire, a soft patch, a grain or losses are in it."""
    effects = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"]()}
    known = {f"plate.{name}": value for name, value in NUMBERS.items()} | {"loss.stiffness_loss_factor": loss}
    if gain != 1.0:
        effects["amplifier"] = CATALOGUE["sensor_gain"]()
        known["amplifier.gain"] = gain
    if mass:
        effects["lump"] = CATALOGUE["point_mass"]()
        known |= {"lump.x": SPOT[0], "lump.y": SPOT[1], "lump.mass": mass}
    if wire:
        effects["wire"] = CATALOGUE["support_spring"](at=(SPOT,))
        known |= {"wire.stiffness": wire[0], "wire.viscous_damping": wire[1]}
    if ratio != 1.0:
        effects["grain"] = CATALOGUE["orthotropy"]()
        known |= {"grain.young_ratio": ratio, "grain.shear_factor": 1.0}
    if along:
        effects["own"] = CATALOGUE["directional_damping"]()
        known |= dict(zip(("own.loss_x", "own.loss_y", "own.loss_xy"), along, strict=True))
    if patch != 1.0:
        effects["patch"] = CATALOGUE["stiffness_loss"]()
        known |= {
            "patch.x": SPOT[0],
            "patch.y": SPOT[1],
            "patch.size": 0.3,
            "patch.factor": patch,
            "patch.aspect": aspect,
        }
    known = {key: value for key, value in known.items() if key not in (searched or {})}
    return PlateModel(
        Mesh(0.43, 0.3, 4, 4), effects, known, searched, list(SMALL_RESPONSE), list(SMALL_REFERENCE), "accelerance"
    )


def leaving(fit: Fit, square: float) -> Fit:
    """The same fit, as if it left such a sum of squares."""
    judged = fit.judged._replace(white=square / fit.judged.n, cost=fit.judged.cost + square - fit.square)
    return fit._replace(judged=judged, by_noise=True, prior=0.0)


class Scene:
    """A baseline beside FRFs whose level is 10 % too high, with a noise of a hundredth, unless told otherwise."""

    def __init__(self, young=None, hidden=None, lines=SMALL_LINES, box=None, share=0.01, prior=None):
        with torch.no_grad():
            frf = small_plate(**(hidden or {"gain": 1.1})).frf(NOBODY, lines)
        std = true_std(frf, share, "signal")
        noise = Noise(std, true_floor(std, frf), (), torch.zeros_like(std))
        frfs = measured(lines, frf + noise_of(std, 4), SMALL_RESPONSE, SMALL_REFERENCE)
        # Ten modes in the band, and no mesh error: the data come from the same mesh.
        target = FrfTarget(frfs, noise, torch.zeros(2, 3, dtype=torch.bool))
        target = target.with_mesh_error(torch.zeros_like(lines), 0.0, 10)
        self.builder = ModelBuilder(small_plate(BOX | (box or {})), target, as_given=True)
        model = self.builder.given
        self.ranking = Ranking(self.builder, prior or {}, channels_of(model), lambda _: None)
        begin = {"plate.youngs_modulus": young or 2.05e11, "loss.stiffness_loss_factor": 1e-2}
        begin |= {name: mean for name, (mean, _) in (prior or {}).items()}
        theta = torch.tensor([begin[name] for name in model.names], dtype=torch.float64)
        if young is None:
            self.fit = fit(self.builder, model, model.space.to_cube(theta)[None], prior, wide=False)
        else:
            start = model.space.to_cube(theta)
            self.fit = judged_at(self.builder, fit(self.builder, model, start[None], wide=False), {}, start)
            self.fit = self.fit._replace(theta=theta)
        self.state = State(model, self.fit)

    def candidate(self, name: str) -> Candidate:
        """The effect as it may be missing."""
        every = candidates(self.state.model, self.fit.theta, self.ranking.channels)
        return next(one for one in every if one.name == name)

    def hypothesis(self, name: str, start=0.5, state: State | None = None, idle=()) -> Hypothesis:
        """The effect in the model, fitted from there; without those of its numbers that are said to do nothing."""
        model = (state or self.state).model
        candidate = self.candidate(name).without(idle)
        whole = with_candidate(model, f"{name}_1", candidate)
        place = torch.zeros(1, len(whole.names), dtype=torch.float64) + torch.as_tensor(start, dtype=torch.float64)
        return Hypothesis(candidate, f"{name}_1", fit(self.builder, whole, place, wide=False))


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
        Scene=Scene,
        leaving=leaving,
        spot=SPOT,
        small_plate=small_plate,
        SMALL_LINES=SMALL_LINES,
    )
