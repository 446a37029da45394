"""The same plate with other effects or other numbers."""

from collections.abc import Mapping

from jaxtyping import Float
from torch import Tensor

from torchplate.effects import Effect
from torchplate.model import PlateModel, Searched


def with_numbers(model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> PlateModel:
    """The model with its searched parameters at these values: nothing is searched any more."""
    numbers = known_values(model) | dict(zip(model.names, theta.tolist(), strict=True))
    return rebuilt(model, model.effects, numbers, {})


def rebuilt(
    model: PlateModel, effects: Mapping[str, Effect], known: Mapping[str, float], wanted: Mapping[str, Searched]
) -> PlateModel:
    """A model of other effects or values on the same mesh, with the same assembly."""
    # The mesh is already what its effects have made of it.
    kept = {label: effect for label, effect in effects.items() if effect.name != "mesh_discretisation"}
    return PlateModel(
        model.mesh, kept, known, wanted, model.response, model.reference, model.kind, model.memory, model.assembly
    ).to(model.known.device)


def known_values(model: PlateModel) -> dict[str, float]:
    """Values of all that is not searched, by "label.parameter"."""
    values = iter(model.known.tolist())
    return {
        key: next(values)
        for label, effect in model.effects.items()
        for name in effect.parameters
        if (key := f"{label}.{name}") not in model.names
    }


def searched(model: PlateModel) -> dict[str, Searched]:
    """Intervals of all that is searched, by "label.parameter"."""
    space = model.space
    rows = zip(space.names, space.low.tolist(), space.high.tolist(), space.logarithmic.tolist(), strict=True)
    return {name: Searched(low, high, logarithmic) for name, low, high, logarithmic in rows}
