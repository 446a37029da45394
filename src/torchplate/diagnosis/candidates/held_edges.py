"""Held edges that may yield.

A clamp is never rigid. What is held in the given model hangs on springs along that edge here, so stiff that they hold
it as the edge condition does; then softer ones can be tried in their place like any other effect. If nobody wants them
softer, the edge is held again in the end.
"""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import torch

from torchplate.diagnosis.settings import SETTINGS
from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel
from torchplate.plate import Assembly

# With blanks, so that no config calls one of its effects so by chance.
PREFIX = "held edge "


class RigidSprings(NamedTuple):
    """What stands for a held edge.

    Attributes:
        label: of the springs.
        values: of their stiffnesses, so large that the edge does not move, or zero where it may.
    """

    label: str
    values: Mapping[str, float]


def held_edges(model: PlateModel) -> dict[str, str]:
    """The edges that are held, and how."""
    return {edge: condition for edge, condition in model.mesh.edges.items() if condition != "free"}


def on_springs(model: PlateModel) -> PlateModel:
    """The same plate with rigid springs along its edges instead of edge conditions."""
    held = held_edges(model)
    if not held:
        return model
    kind = CATALOGUE["edge_spring"]
    plan = model.plan(model.space.to_si(torch.full((len(model.names),), 0.5).to(model.known)))
    rigid = {
        name: SETTINGS.trials.rigid * parameter.prior_interval(plan.section, plan.geometry).high
        for name, parameter in kind.parameters.items()
    }
    effects, known = dict(model.effects), model.known_values
    for edge, condition in held.items():
        label = PREFIX + edge
        effects[label] = kind(edge=edge)  # type: ignore[call-arg]
        known[f"{label}.stiffness"] = rigid["stiffness"]
        known[f"{label}.rotational_stiffness"] = rigid["rotational_stiffness"] if condition == "clamped" else 0.0
    return _with_edges(model.replaced(effects=effects, known=known), {})


def standing_for(model: PlateModel, edge: str) -> RigidSprings | None:
    """The rigid springs along an edge; None where it is free."""
    label = PREFIX + edge
    if label not in model.effects:
        return None
    known = model.known_values
    return RigidSprings(label, {name: known[f"{label}.{name}"] for name in model.effects[label].parameters})


def held_again(model: PlateModel, held: Mapping[str, str]) -> PlateModel:
    """The plate with those edges held that are still on rigid springs.

    Args:
        model: on springs.
        held: the edges that were held, and how.
    """
    still = {edge: how for edge, how in held.items() if PREFIX + edge in model.effects}
    if not still:
        return model
    springs = {PREFIX + edge for edge in still}
    effects = {label: effect for label, effect in model.effects.items() if label not in springs}
    return _with_edges(model.replaced(effects=effects), still)


def _with_edges(model: PlateModel, edges: Mapping[str, str]) -> PlateModel:
    """On a mesh with these edges held, in all dofs."""
    mesh = dataclasses.replace(model.mesh, edges=dict(edges))
    twin = model.replaced()
    twin.mesh, twin.assembly = mesh, Assembly(mesh).to(model.known)
    return twin
