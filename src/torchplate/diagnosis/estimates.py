"""Found numbers with their 90 % intervals: what noise and nuisances leave open, and what the mesh does."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.result import Estimate
from torchplate.diagnosis.settings import SETTINGS
from torchplate.model import PlateModel

# Of the standard normal distribution, at 95 %: nobody chose it.
QUANTILE = 1.645


def estimates(fit: Fit, top: float) -> dict[str, Estimate]:
    """The fitted numbers with their 90 % intervals.

    Args:
        fit: with its model and the covariance of what was fitted.
        top: end of the band [Hz].
    """
    found = {}
    std = (fit.covariance.diagonal().clamp(min=0) + left_by_mesh(fit.model, fit.theta, top).square()).sqrt().tolist()
    space = fit.model.space
    ends = zip(space.low.tolist(), space.high.tolist(), strict=True)
    rows = zip(fit.model.names, fit.model.units, fit.theta.tolist(), std, ends, space.logarithmic.tolist(), strict=True)
    for name, unit, value, one, (lowest, highest), logarithmic in rows:
        if math.isnan(one):
            found[name] = Estimate(value, None, unit)
            continue
        if logarithmic and value > 0:
            # The posterior is normal on the scale on which it was searched.
            factor = math.exp(min(700.0, QUANTILE * one / value))
            low, high = value / factor, value * factor
        else:
            low, high = value - QUANTILE * one, value + QUANTILE * one
        found[name] = Estimate(value, one, unit, max(low, lowest), min(high, highest))
    return found


def left_by_mesh(model: PlateModel, theta: Float[Tensor, " n_parameter"], top: float) -> Float[Tensor, " n_parameter"]:
    """What the mesh leaves of the strength and the place of what sits at a place, in their units; else zero.

    Around a force the deflection goes with r² ln r, which no polynomial of an element follows: under it the mesh gives
    more than the plate by c = `Meshes.give` side² / D. A dynamic stiffness z acts as z / (1 + z c): its strength is off
    by the part |z| c, which is largest at the band's end. As much, to the mode that is shortest there, is a step of
    |z| c / (2 k) along the plate, k its wave number: an effect acts with the square of the deflection at its place.

    Args:
        model: that was fitted.
        theta: its searched parameters.
        top: end of the band [Hz].
    """
    left, index = torch.zeros_like(theta), {name: k for k, name in enumerate(model.names)}
    plan, values, omega = model.plan(theta), model.values(theta), 2 * math.pi * top
    bending = plan.section.rigidity
    rigidity = float((bending[..., 0, 0] * bending[..., 1, 1]).sqrt().mean())
    sides = float(plan.geometry.length_x.mean()), float(plan.geometry.length_y.mean())
    side = max(length / count for length, count in zip(sides, model.mesh.cells, strict=True))
    give = SETTINGS.meshes.give * side**2 / rigidity
    wave_number = (omega**2 * float(plan.section.areal_mass.mean()) / rigidity) ** 0.25
    weights = {"mass": omega**2, "stiffness": 1.0, "viscous_damping": omega}
    for label in model.effects:
        held = {key for key in weights if f"{label}.{key}" in index}
        if not held or not {f"{label}.x", f"{label}.y"} <= index.keys():
            continue
        part = give * max(abs(weights[key] * float(values[label][key])) for key in held)
        for key in held:
            left[index[f"{label}.{key}"]] = part * abs(float(values[label][key]))
        for key, length in zip(("x", "y"), sides, strict=True):
            left[index[f"{label}.{key}"]] = part / (2 * wave_number * length)
    return left
