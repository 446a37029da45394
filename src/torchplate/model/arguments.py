"""What a caller of the model gives, as tensors: theta, frequency lines and places; what cannot be meant is refused."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.effects import Parameter
from torchplate.model.parameter_space import ParameterSpace
from torchplate.plate import transformed

Numbers = Tensor | np.ndarray | Sequence[Any] | int | float
Point = int | Sequence[float]
# Several of them, or one.
Points = Tensor | np.ndarray | Sequence[Any] | np.generic | int | float

# A value this many times beyond its interval, or one over it below an interval of large numbers, is in other units.
FAR = 100.0


def as_theta(given: Numbers, names: Sequence[str], like: Tensor) -> Float[Tensor, "*batch n_parameter"]:
    """Theta as a tensor of the model's precision, with its gradient.

    Args:
        given: one value for each searched parameter, in the last dimension.
        names: the searched parameters.
        like: a tensor of the model's dtype and device.

    Raises:
        ValueError: if it is not real numbers, has no dimension, or is on another device.
    """
    theta = _real(given, "theta", like)
    if not theta.ndim:
        raise ValueError(
            f"Expected theta with a last dimension of {len(names)} ({', '.join(names) or 'none'}), got a single "
            "number. `model.names` gives the order."
        )
    return theta


def as_frequency(given: Numbers, like: Tensor, check: bool = True) -> Float[Tensor, " n_frequency"]:
    """Frequency lines [Hz] as a tensor like theta; a single number is one line.

    Raises:
        ValueError: if they are not real numbers in one dimension, or negative.
    """
    lines = _real(given, "frequency", like, moves=True)
    if lines.ndim == 0:
        lines = lines[None]
    if lines.ndim != 1:
        raise ValueError(
            f"Expected frequency lines in one dimension [Hz], got the shape {tuple(lines.shape)}. Flatten them."
        )
    # On another device, looking would wait for it.
    if check and lines.device.type == "cpu" and not transformed() and not bool((lines >= 0).all()):
        worst = float(lines[~(lines >= 0)][0])
        raise ValueError(f"Expected frequencies in Hz from 0 on, got {worst:g}. Leave it out; check=False takes it.")
    return lines


def as_points(given: Points, name: str) -> Sequence[Point] | Tensor:
    """Places as `Mesh.places` takes them; a single node label or place is a list of one.

    Args:
        given: node labels, relative places, or one of either.
        name: "response" or "reference".

    Raises:
        ValueError: if it is neither.
    """
    if isinstance(given, np.ndarray):
        given = torch.from_numpy(given) if given.ndim == 2 else given.tolist()
    if isinstance(given, Tensor):
        if given.ndim == 2 and given.shape[-1] == 2 and given.is_floating_point():
            return given
        if given.is_floating_point() or given.is_complex() or given.ndim > 1:
            raise _no_points(name, f"a tensor of shape {tuple(given.shape)} and {given.dtype}")
        given = given.tolist()
    if isinstance(given, int | np.integer):
        return [int(given)]
    if isinstance(given, str | Mapping) or not isinstance(given, Sequence):
        raise _no_points(name, repr(given))
    if not len(given):
        raise _no_points(name, "none")
    if len(given) == 2 and all(isinstance(value, float) for value in given):
        return [[float(value) for value in given]]
    points = [int(point) if isinstance(point, np.integer) else point for point in given]
    for point in points:
        if isinstance(point, str) or not isinstance(point, int | Sequence | np.ndarray | Tensor):
            raise _no_points(name, repr(point))
    return points


def limits(space: ParameterSpace, parameters: Sequence[Parameter]) -> Float[Tensor, "3 n_parameter"]:
    """What a value of theta must not be below, must not be above, and must not be below unless it is zero.

    The first two are what the parameter allows and, for one that every model must be given, far above its interval; the
    third tells a place in the unit cube from a value where the numbers of such an interval are large. What has a
    neutral value may come as near to it as a fit wants.
    """
    rows = []
    for low, high, parameter in zip(space.low.tolist(), space.high.tolist(), parameters, strict=True):
        slack = 1e-9 * max(abs(low), abs(high))  # what rounding makes of an end
        least, most, small = parameter.allowed.low, parameter.allowed.high, -math.inf
        if parameter.neutral is None and low > 0:
            most, small = min(most, FAR * high), low / FAR if low >= FAR else small
        rows.append((least - slack, most + slack, small))
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, 3).mT


def check_range(
    theta: Float[Tensor, "*batch n_given"],
    space: ParameterSpace,
    parameters: Sequence[Parameter],
    limit: Float[Tensor, "3 n_parameter"],
) -> None:
    """Refuse values that are not in SI units or that physics does not have; those outside an interval are fine.

    Nothing is looked at inside a transform of torch.func, which does not let values decide anything. A model of a
    subclass may take more values than those named; these are its own.

    Raises:
        ValueError: with the first such value.
    """
    if transformed() or theta.shape[-1] < len(parameters):
        return
    values = theta.detach()[..., : len(parameters)]
    if not values.numel():
        return
    sound = (values >= limit[0]) & (values <= limit[1]) & ((values >= limit[2]) | (values == 0))
    if bool(sound.all()):
        return
    place = torch.nonzero(~sound)[0].tolist()
    index, value = place[-1], float(values[tuple(place)])
    parameter, unit = parameters[index], space.units[index]
    interval = f"{float(space.low[index]):g} to {float(space.high[index]):g}"
    if value not in parameter.allowed:
        expected = f"{space.names[index]} {parameter.allowed} [{unit}]"
        action = f"Its interval is {interval}"
    else:
        expected = f"theta in SI units, {space.names[index]} near its interval of {interval} [{unit}]"
        action = "Bring a place in the unit cube to SI units by model.space.to_si"
    raise ValueError(f"Expected {expected}, got {value:g}. {action}; check=False takes any value.")


def _real(given: Numbers, name: str, like: Tensor, *, moves: bool = False) -> Tensor:
    """Real numbers of the model's precision; what is no tensor yet comes to its device, and lines follow theta."""
    if not isinstance(given, Tensor):
        try:
            if isinstance(given, Sequence) and any(isinstance(value, Tensor) for value in given):
                # Their gradients stay.
                given = torch.stack([torch.as_tensor(value) for value in given])
            else:
                given = torch.as_tensor(np.asarray(given, dtype=np.float64))
        except (TypeError, ValueError, RuntimeError):
            raise ValueError(
                f"Expected {name} as real numbers in a tensor, an array or a list, got {_short(given)}. Convert it."
            ) from None
        moves = True
    if given.is_complex() or given.dtype == torch.bool:
        raise ValueError(f"Expected {name} as real numbers, got {given.dtype}. Convert it.")
    if not moves and given.device != like.device:
        raise ValueError(
            f"Expected {name} on {like.device}, as the model, got it on {given.device}. Move it: "
            f"{name}.to('{like.device}')."
        )
    return given.to(like)


def left_out(is_theta: bool, names: Sequence[str]) -> ValueError:
    """What to tell who calls a model without theta, or without frequency lines.

    Args:
        is_theta: whether it is theta that is missing, or the lines.
        names: the searched parameters.
    """
    if is_theta:
        return ValueError(
            f"Expected theta, one value in SI units for each of {', '.join(names) or 'no parameter'}, and frequency "
            "lines [Hz], got no theta. Write model(theta, frequency)."
        )
    return ValueError(
        "Expected frequency lines [Hz] after theta, got none. Write model(theta, torch.linspace(5, 400, 80)), or "
        "model.natural_frequencies(theta) where no FRF is wanted."
    )


def _no_points(name: str, came: str) -> ValueError:
    return ValueError(
        f"Expected {name} as node labels or relative places [x, y], at least one, got {came}. Write {name}=[3] or "
        f"{name}=[(0.2, 0.0)]."
    )


def _short(given: object) -> str:
    text = repr(given)
    return f"{type(given).__name__} {text if len(text) < 60 else text[:57] + '...'}"
