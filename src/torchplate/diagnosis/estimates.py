"""Found numbers with their 90 % intervals: what noise and nuisances leave open, and what the mesh does."""

import math
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import CORNERS
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.result import Estimate
from torchplate.diagnosis.settings import SETTINGS
from torchplate.effects import Effect
from torchplate.model import PlateModel
from torchplate.plate import Correction, bending_wavelength

# What says how strongly something acts at its place.
STRENGTHS = ("mass", "stiffness", "viscous_damping")
# What a patch that loses is made of.
LOSSY = frozenset({"x", "y", "size", "loss_factor"})
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
    """What the mesh leaves of the strength and the place of what sits at a place, and of holes, in their units.

    Around a force the deflection goes with r² ln r, which no polynomial of an element follows: under it the mesh gives
    more than the plate by c = `Meshes.give` side² / D. A dynamic stiffness z acts as z / (1 + z c): its strength is off
    by the part |z| c, which is largest at the band's end. As much, to the mode that is shortest there, is a step of
    |z| c / (2 k) along the plate, k its wave number: an effect acts with the square of the deflection at its place. A
    mass that moves with the sensor sits at each response in turn. A hole is not quite as large as the one that gives a
    mesh the modes of the plate: moments are singular at its corners, so that what is left there falls with the side of
    an element, whatever is extrapolated, and not with its square (Williams, J. Applied Mechanics 19 (1952) 526); see
    `Meshes.corner`. Nor is a patch that loses: its curvatures jump by η at its edge, inside of elements, and what that
    couples beyond the modes in the band no extrapolation has, see `Meshes.lossy`. The pieces of a rib end with the
    elements, see `Meshes.rib`. Of all else nothing is known to be left, which is a zero.

    Args:
        model: that was fitted.
        theta: its searched parameters.
        top: end of the band [Hz].
    """
    left, index = torch.zeros_like(theta), {name: k for k, name in enumerate(model.names)}
    plan, values = model.plan(theta), model.values(theta)
    section, geometry = plan.section, plan.geometry
    sides = {"x": float(geometry.length_x.mean()), "y": float(geometry.length_y.mean())}
    side = max(length / count for length, count in zip(sides.values(), model.mesh.cells, strict=True))
    rigidity = float(Correction.measure(section.rigidity, geometry)) * math.prod(sides.values())
    give = SETTINGS.meshes.give * side**2 / rigidity
    metal = section.youngs_modulus, section.poisson_ratio, section.density, section.thickness
    wave = bending_wavelength(top, *(float(own.mean()) for own in metal))
    for label, effect in model.effects.items():
        if effect.parameters.keys() == CORNERS:
            for axis, length in sides.items():
                held = [index[name] for end in "01" if (name := f"{label}.{axis}{end}") in index]
                left[held] = SETTINGS.meshes.corner * side / length
            continue
        if effect.parameters.keys() >= LOSSY or effect.parameters.keys() > CORNERS:
            own, is_rib = values[label], effect.parameters.keys() > CORNERS
            every = _of_rib(own, sides, side, rigidity) if is_rib else _of_lossy(own, sides, side)
            for name, off in every.items():
                if (key := f"{label}.{name}") in index:
                    left[index[key]] = off
            continue
        held = [index[name] for key in STRENGTHS if (name := f"{label}.{key}") in index]
        force = _force(model, effect, values[label], top) if held else None
        if force is None:
            continue
        part = give * float(force.abs())
        left[held] = part * theta[held].abs()
        for axis, length in sides.items():
            if (name := f"{label}.{axis}") in index:
                left[index[name]] = part * wave / (4 * math.pi * length)
    return left


def _of_lossy(value: Mapping[str, Tensor], sides: Mapping[str, float], side: float) -> dict[str, float]:
    """What the mesh leaves of a patch that loses: of its middle, size, shape and loss factor, in their units.

    What all of it loses is right: η goes with the inverse of its area.

    Args:
        value: its parameters.
        sides: of the plate [m].
        side: of an element [m].
    """
    place, size, ratio = (one * side * float(value["loss_factor"]) for one in SETTINGS.meshes.lossy)
    whole = math.prod(sides.values()) ** 0.5
    root = max(whole * float(value["size"]), 1e-300)
    parts = {"loss_factor": 2 * size / root, "aspect": ratio / root}
    off = {axis: place / length for axis, length in sides.items()} | {"size": size / whole}
    return off | {name: part * float(value[name]) for name, part in parts.items() if name in value}


def _of_rib(value: Mapping[str, Tensor], sides: Mapping[str, float], side: float, rigidity: float) -> dict[str, float]:
    """What the mesh leaves of a rib: of its ends, along it and across, and of what it is made of, in their units.

    Args:
        value: its parameters.
        sides: of the plate [m].
        side: of an element [m].
        rigidity: D of the plate [N m].
    """
    along, across, strength = SETTINGS.meshes.rib
    way = {axis: length * float(value[f"{axis}1"] - value[f"{axis}0"]) for axis, length in sides.items()}
    whole = max(math.hypot(*way.values()), 1e-300)
    off: dict[str, float] = {}
    for axis, other in (("x", "y"), ("y", "x")):
        apart = side * math.hypot(along * way[axis], across * way[other]) / whole
        off |= {f"{axis}{end}": apart / sides[axis] for end in "01"}
    part = strength * float(value["bending"]) / (rigidity * side)
    return off | {name: part * float(value[name]) for name in value.keys() - off.keys()}


def _force(model: PlateModel, effect: Effect, value: Mapping[str, Tensor], frequency: float) -> Tensor | None:
    """Dynamic stiffness of what an effect puts at one place, or at each response in turn [N/m]; None if nothing."""
    s = torch.tensor([2j * math.pi * frequency], dtype=torch.complex128)
    if {"mass", "sensor chain"} <= effect.acts_on:
        # It moves with the sensor: for the plate as such it is not there.
        return (value["mass"] * s**2).squeeze()
    term = effect.local(model.mesh, value) if "x" in effect.parameters else None
    if term is None:
        return None
    parts = ((term.mass, s**2), (term.stiffness, 1), (term.viscous, s))
    total = sum((own * factor for own, factor in parts if own is not None), torch.zeros_like(s))
    return (total if term.sprung is None else total + term.sprung.force(s)[..., 0]).squeeze()
