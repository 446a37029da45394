"""What the effects of a model declare, and what is known or searched of it."""

from collections.abc import Mapping
from typing import NamedTuple

from torchplate.effects import Effect, Parameter, Searched
from torchplate.model.parameter_space import ParameterSpace


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
    names = [key for key in everything if key in searched]
    space = ParameterSpace(names, [everything[key].unit for key in names], [searched[key] for key in names])
    return Declared(values, [everything[key] for key in names], space)


def _remedy(parameter: Parameter, value: float) -> str:
    """What to do with a value that cannot be."""
    if (parameter.allowed.low, parameter.allowed.high) == (0.0, 1.0) and value > 1:
        return "It is a share of the side: divide a place or length by the plate's length_x or length_y."
    if parameter.unit == "-" and value > 1 and value / 100 in parameter.allowed:
        return f"If it is in per cent, write {value / 100:g}."
    return "Correct it."
