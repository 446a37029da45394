"""Numbers that are known as well as a ruler or a scale knows them: fitted too, and held by what is known of them.

A number with a standard deviation is neither fixed nor free. It is searched within a few of them, and its deviation
over its standard deviation is one more residual of the sharp level. Two sides with their own deviations are an aspect
ratio, and an area that makes the plate heavier: the mass of the plate is all that the FRFs see of that, since its
stiffness goes with Young's modulus.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.settings import SETTINGS
from torchplate.effects import AspectRatio
from torchplate.model import PlateModel, Searched

SIDES = "sides"
MESH = ("mesh.length_x", "mesh.length_y")


class Held(NamedTuple):
    """A model whose uncertain numbers are searched, and what holds them.

    Attributes:
        model: the model.
        prior: "label.parameter" → mean and standard deviation.
    """

    model: PlateModel
    prior: Prior


def with_tolerances(model: PlateModel, tolerance: Mapping[str, float]) -> Held:
    """Let uncertain numbers move.

    Args:
        model: with the numbers as they are believed.
        tolerance: "label.parameter", "mesh.length_x" or "mesh.length_y" → standard deviation in SI units.

    Raises:
        ValueError: if there is no number of that name.
    """
    known = model.known_values
    own = {key: std for key, std in tolerance.items() if not key.startswith("mesh.") and std > 0}
    for key in (*own, *(key for key in tolerance if key.startswith("mesh.") and key not in MESH)):
        if key not in known:
            raise ValueError(f"No number named '{key}' in the model. It has: {', '.join(known)}. Correct its name.")
    sides = [
        tolerance.get(f"mesh.{name}", 0.0) / side
        for name, side in (("length_x", model.mesh.length_x), ("length_y", model.mesh.length_y))
    ]
    effects = dict(model.effects)
    prior: dict[str, tuple[float, float]] = {}
    if (relative := math.hypot(*sides)) > 0:
        plate = next(label for label, effect in effects.items() if effect.name == "plate")
        density = f"{plate}.density"
        if density in known:
            own[density] = math.hypot(own.get(density, 0.0), relative * known[density])
        if not any(effect.name == "aspect_ratio" for effect in effects.values()):
            effects[SIDES] = AspectRatio()
            prior[f"{SIDES}.ratio"] = (1.0, relative)
    prior |= {key: (known[key], std) for key, std in own.items()}
    if not prior:
        return Held(model, {})
    wanted, settings = {}, SETTINGS.searching
    for key, (mean, std) in prior.items():
        label, _, name = key.rpartition(".")
        allowed = effects[label].parameters[name].allowed
        low = allowed.low + settings.least * mean if allowed.open_low else allowed.low
        reach = settings.reach * std
        wanted[key] = Searched(max(mean - reach, low), min(mean + reach, allowed.high))
    rest = {key: value for key, value in known.items() if key not in wanted}
    # Valleys, as of E h³ and ρ h, are products of powers and as long as what is known lets them be: straight in logs.
    straight = {
        key: replace(interval, logarithmic=interval.low > 0) for key, interval in (model.searched | wanted).items()
    }
    return Held(model.replaced(effects=effects, known=rest, searched=straight), prior)


def measured(prior: Prior, tolerance: Mapping[str, float]) -> frozenset[str]:
    """Of the numbers that are held those that somebody has measured: a density in which the area alone shows is none.

    Args:
        prior: "label.parameter" → mean and standard deviation.
        tolerance: as they were told.
    """
    return frozenset(name for name in prior if tolerance.get(name, 0.0) > 0 or name == f"{SIDES}.ratio")
