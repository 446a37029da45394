"""What the effects of a model declare, and what is known or searched of it."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from torchplate.effects import Effect, Parameter, Plate, Searched
from torchplate.model.parameter_space import ParameterSpace
from torchplate.plate import Mesh

# What a quantity of a plate is at most in SI units, and over one of them what it is at least where zero makes no plate:
# beyond them products of a few overflow.
MOST = 1e30
# Powers of the plate's length √A under its rigidity D in what springs are held against, and how many times that they
# are at most. From a hundredth of it on they are rigid; beyond it the plate's own stiffness is lost in their rounding.
# With as much an FRF is right to 1e-5.
SPRINGS = {"N/m": (2, 1e9), "N/m²": (3, 1e9), "N/rad": (1, 1e7)}


class Declared(NamedTuple):
    """The parameters of a model, in the order of its effects.

    Attributes:
        known: values of those that are not searched, in SI units.
        searched: the others.
        space: their box.
    """

    known: list[float]
    searched: list[Parameter]
    space: ParameterSpace


def declared(effects: Mapping[str, Effect], known: Mapping[str, float], searched: Mapping[str, Searched]) -> Declared:
    """Sort the parameters of some effects into known and searched ones; what is neither takes its neutral value.

    Raises:
        ValueError: if a parameter is missing, unknown or outside what makes sense.
    """
    everything = {
        f"{label}.{name}": parameter
        for label, effect in effects.items()
        for name, parameter in effect.parameters.items()
    }
    for key in [*known, *searched]:
        if key not in everything:
            raise ValueError(f"No parameter named '{key}'. The model has: {', '.join(everything)}.")
    values = []
    for key, parameter in everything.items():
        if key in searched:
            ends = (searched[key].low, searched[key].high)
        elif (value := known.get(key, parameter.neutral)) is not None:
            values.append(value)
            ends = (value, value)
        else:
            raise ValueError(f"Expected a value or an interval for '{key}' [{parameter.unit}], got none. Add it.")
        for end in ends:
            if end not in parameter.allowed:
                raise ValueError(
                    f"Expected '{key}' {parameter.allowed} [{parameter.unit}], got {end:g}. {_remedy(parameter, end)}"
                )
            # What may be zero may be nearly so.
            least = 0.0 if 0.0 in parameter.allowed else 1 / MOST
            if not least <= abs(end) <= MOST:
                raise ValueError(
                    f"Expected '{key}' to be from {least:g} to {MOST:g} [{parameter.unit}], got {end:g}. Correct it."
                )
    names = [key for key in everything if key in searched]
    space = ParameterSpace(names, [everything[key].unit for key in names], [searched[key] for key in names])
    return Declared(values, [everything[key] for key in names], space)


def check_rigid(mesh: Mesh, effects: Mapping[str, Effect], found: Declared) -> None:
    """Whether the plate is still to be seen beside its springs.

    Args:
        mesh: for the sides.
        effects: of the model.
        found: their parameters.

    Raises:
        ValueError: if a spring is so stiff that digits of the plate are lost.
    """
    ends = dict(zip(found.space.names, found.space.high.tolist(), strict=True))
    keys = [(label, name) for label, effect in effects.items() for name in effect.parameters]
    known = iter(found.known)
    highest = {key: ends[key] if key in ends else next(known) for key in (".".join(pair) for pair in keys)}
    plate = next(label for label, effect in effects.items() if isinstance(effect, Plate))
    young, poisson, thickness = (
        highest[f"{plate}.{name}"] for name in ("youngs_modulus", "poisson_ratio", "thickness")
    )
    rigidity, area = young * thickness**3 / (12 * (1 - min(poisson**2, 0.99))), mesh.length_x * mesh.length_y
    for label, name in keys:
        unit, value = effects[label].parameters[name].unit, highest[f"{label}.{name}"]
        power, times = SPRINGS.get(unit, (0, math.inf))
        most = times * rigidity / area ** (0.5 * power)
        if abs(value) > most:
            raise ValueError(
                f"Expected '{label}.{name}' to be at most {most:.2g} [{unit}], {times:g} times what the plate itself "
                f"has, got {value:g}. A hundredth of as much is rigid, and of more the plate's own stiffness is lost "
                f"in the rounding: write {0.01 * most:.0e}, or hold an edge by mesh.edges."
            )


def _remedy(parameter: Parameter, value: float) -> str:
    """What to do with a value that cannot be."""
    if (parameter.allowed.low, parameter.allowed.high) == (0.0, 1.0) and value > 1:
        return "It is a share of the side: divide a place or length by the plate's length_x or length_y."
    if parameter.unit == "-" and value > 1 and value / 100 in parameter.allowed:
        return f"If it is in per cent, write {value / 100:g}."
    return "Correct it."
