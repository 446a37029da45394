"""The force at one place that would explain the misfit: the map over the plate, and its best place."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.localisation.misfit import Misfit
from torchplate.diagnosis.localisation.reach import Reach
from torchplate.diagnosis.result import ForceMap
from torchplate.diagnosis.settings import SETTINGS
from torchplate.effects import ChannelSwap
from torchplate.measurement import Measurement
from torchplate.model import PlateModel


class Force(NamedTuple):
    """A force at one place that would explain the misfit.

    Attributes:
        place: relative.
        others: places that explain as much.
        free: part of the misfit explained if it is free at every line.
        parts: explained by a spring, a dashpot, a mass alone, and by all three together ("place").
        size: of each alone, in SI units.
    """

    place: tuple[float, float]
    others: tuple[tuple[float, float], ...]
    free: float
    parts: dict[str, float]
    size: dict[str, float]


def force_at(
    misfit: Misfit, measurement: Measurement, model: PlateModel, theta: Tensor
) -> tuple[ForceMap, Force] | None:
    """The map over the plate and the best place; None where it would say nothing."""
    shape = measurement.measured.shape
    if misfit.n_frf < SETTINGS.holding_out.few or measurement.kind == "transmissibility":
        return None
    if any(isinstance(effect, ChannelSwap) for effect in model.effects.values()):
        # It speaks of FRFs of these channels alone, and the map asks for those to other places.
        return None
    if model.response is None or model.reference is None or (len(model.response), len(model.reference)) != shape:
        return None
    reach = Reach(misfit, measurement, model, theta)
    n = SETTINGS.localising.n_place
    side = torch.linspace(0.0, 1.0, n, dtype=theta.dtype, device=theta.device)
    grid = torch.cartesian_prod(side, side).flip(-1)  # x runs first
    index = reach.index(*reach.best(grid)).reshape(n, n)
    places = _finer(reach, _peaks(index, side), 0.5 / (n - 1))
    kinds = reach.kinds(places)
    scores = [parts["place"] for parts, _ in kinds]
    first = max(range(len(scores)), key=scores.__getitem__)
    places[first] = reach.polished(places[first])
    kinds[first] = reach.kinds(places[first : first + 1])[0]
    rounded = [(float(one[0]), float(one[1])) for one in places]
    others = tuple(
        rounded[one]
        for one in range(len(scores))
        if scores[one] > scores[first] - SETTINGS.localising.near
        and float((places[one] - places[first]).abs().max()) > 0.1
    )
    free = float(reach.index(*reach.best(places[first : first + 1]))[0])
    return ForceMap(side, side, index), Force(rounded[first], others, free, *kinds[first])


def _peaks(index: Float[Tensor, "n_y n_x"], side: Float[Tensor, " n"]) -> Float[Tensor, "n_peak 2"]:
    """The highest places of the map that no neighbour tops."""
    top = torch.nn.functional.max_pool2d(index[None, None], 3, stride=1, padding=1)[0, 0]
    high = (index >= top) & (index >= index.max() - SETTINGS.localising.below)
    row, column = high.nonzero(as_tuple=True)
    order = index[row, column].argsort(descending=True)[: SETTINGS.localising.n_peak]
    return torch.stack([side[column[order]], side[row[order]]], dim=-1)


def _finer(reach: Reach, place: Float[Tensor, "n_place 2"], step: float) -> Float[Tensor, "n_place 2"]:
    """The best places around each, at most one step away, on a finer grid."""
    offset = torch.linspace(-step, step, 5, dtype=place.dtype, device=place.device)
    around = (place[:, None] + torch.cartesian_prod(offset, offset)).clamp(0.0, 1.0)
    index = reach.index(*reach.best(around.flatten(0, 1))).reshape(around.shape[:2])
    return around[torch.arange(len(place), device=place.device), index.argmax(1)]
