"""An edge that is held elastically: neither free nor pinned nor clamped."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.plate import EDGES, Local, Mesh, transformed

# Gauss points and weights on 0 to 1; three integrate the square of the deflection but for its sixth power.
POINT = torch.tensor([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)], dtype=torch.float64)
WEIGHT = torch.tensor([5 / 18, 8 / 18, 5 / 18], dtype=torch.float64)
# Rows along edges of one mesh are remembered up to this size [bytes]: one edge of a mesh that models are settled on.
KEPT = 40 * 2**20


@dataclass(frozen=True)
class EdgeSpring(Effect):
    """Energy ½ ∫ (k w² + κ (∂w/∂n)²) ds along an edge: K gains ∫ (k N Nᵀ + κ N,n N,nᵀ) ds.

    k → ∞ is a simply supported edge, κ → ∞ too a clamped one. The slope is linear between the nodes of the edge: the
    element's own is cubic, jumps from element to element and locks. Lengths are those of the nominal plate. Several
    edges are several effects.

    Args:
        edge: x0, x1, y0 or y1.

    Raises:
        ValueError: if there is no such edge.
    """

    edge: str = ""

    parameters = {
        "stiffness": Parameter(
            "N/m²",
            "k: force per deflection and length of edge",
            nonnegative,
            neutral=0.0,
            prior=Prior(0.03, 1e5, logarithmic=True, relative_to="plate"),
        ),
        "rotational_stiffness": Parameter(
            "N/rad",
            "κ: moment per slope and length of edge",
            nonnegative,
            neutral=0.0,
            prior=Prior(0.01, 1e3, logarithmic=True, relative_to="plate"),
        ),
    }
    check = Check(2, "free the edge, or clamp it tighter, and test again")
    acts_on = frozenset({"stiffness"})
    shows = "Lifts every mode that moves or turns at the edge, towards those of a pinned or clamped edge."
    source = "Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells (1959), article 22"

    def __post_init__(self) -> None:
        if self.edge not in EDGES:
            raise ValueError(f"Expected edge_spring.edge to be one of {', '.join(EDGES)}, got '{self.edge}'. Name one.")

    def attached(self, mesh: Mesh, terms: Sequence[Local], value: Value) -> Sequence[Local]:
        """The terms before it, then deflection and slope across the edge at the Gauss points of every element there."""
        spring, rotational = torch.broadcast_tensors(value["stiffness"], value["rotational_stiffness"])
        along = 1 if self.edge.startswith("x") else 0
        n = mesh.cells[along]
        deflection, slope = self._rows(mesh, spring)
        weight = (WEIGHT.repeat(n) * (mesh.length_x, mesh.length_y)[along] / n).to(spring)
        own = [Local(row, stiffness=k[..., None] * weight) for row, k in ((deflection, spring), (slope, rotational))]
        return [*terms, *own]

    def _rows(self, mesh: Mesh, like: Tensor) -> tuple[Tensor, Tensor]:
        """Deflection and slope across the edge: they hang on the mesh alone, which remembers some of them."""
        key = (self.edge, like.dtype, like.device)
        found = mesh.known_along_edges.get(key)
        if found is None:
            found = self._rows_anew(mesh, like)
            every = [row for pair in (*mesh.known_along_edges.values(), found) for row in pair]
            few = sum(row.numel() * row.element_size() for row in every) <= KEPT
            if few and not transformed() and not torch.is_inference_mode_enabled():
                mesh.known_along_edges[key] = found
        return found

    def _rows_anew(self, mesh: Mesh, like: Tensor) -> tuple[Tensor, Tensor]:
        along = 1 if self.edge.startswith("x") else 0
        sides, n = (mesh.length_x, mesh.length_y), mesh.cells[along]

        def rows(position: Tensor, *order: int) -> Tensor:
            end = torch.full_like(position, float(self.edge[1]))
            place = torch.stack([end, position] if along else [position, end], dim=-1)
            return mesh.deflection_at(place.to(like), *order)

        part = POINT.repeat(n).to(like)[:, None]
        at_node = rows(torch.linspace(0, 1, n + 1, dtype=torch.float64), along, 1 - along) / sides[1 - along]
        slope = (1 - part) * at_node[:-1].repeat_interleave(3, 0) + part * at_node[1:].repeat_interleave(3, 0)
        deflection = rows(((torch.arange(n)[:, None] + POINT) / n).flatten())
        # Where the edge is cut out there is nothing to hold.
        return deflection, slope * (deflection != 0).any(-1, keepdim=True)
