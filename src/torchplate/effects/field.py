"""Something that is spread over the plate and has no name: a field of stiffness, mass, loss or support."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Interval, Parameter, nonnegative
from torchplate.plate import Local, Mesh, Section

# A plate keeps a hundredth of its rigidity and mass: less is a hole, which is `cut_out`.
RELATIVE = Interval(-0.99)
MEANINGS = {
    "stiffness": ("-", "bending stiffness there, more than the plate's, relative to it", RELATIVE),
    "mass": ("-", "mass per area there, more than the plate's, relative to it", RELATIVE),
    "loss": ("-", "loss factor there beyond the plate's", nonnegative),
    "support": ("N/m", "stiffness of a spring to the ground there", Interval()),
}
KINDS = tuple(MEANINGS)
MOST_NODES = 100_000
"""Of a grid [-]: a config holds no more values, and each node is one."""


DIRECTIONS = ("along x", "along y", "in twist")
"""Of a directional stiffness, in the order of its values."""


def _parameter(kind: str, value: float = 0.0) -> Parameter:
    unit, meaning, allowed = MEANINGS[kind]
    return Parameter(unit, f"{meaning}; one value for each node of the grid", allowed, neutral=value)


@dataclass(frozen=True)
class Field(Effect):
    """f(x, y) = Σ v_ij N_i(x) N_j(y), N the hat functions of a grid of n_x × n_y nodes over the whole plate.

    Its value at an element's centre counts for the whole element. A field of `stiffness` makes D (1 + f), of `mass`
    ρh (1 + f), of `loss` an extra loss factor f; one of `support` puts a spring of v_ij to the ground at each node of
    the grid, a force from outside in proportion to the deflection. The nodes of the grid count along x first, as those
    of the mesh do: `value_1` at the corner (0, 0), `value_<n_x>` at (1, 0). What no key `value_...` gives is as the
    list `values` says, and 0 where there is none. It says where something is and not what: no candidate of a search
    for what is missing. `diagnose` writes one where nothing of the catalogue accounts for what it sees.

    A stiffness that is `directional` has three such fields, one after another: of D₁₁ along x, of D₂₂ along y and of
    the twist D₃₃; D₁₂ follows the first two as √((1 + f_x)(1 + f_y)), which keeps D definite. A hinge along a line
    yields in one direction alone.

    Args:
        kind: `stiffness`, `mass`, `loss` or `support`.
        n_x: nodes of the grid along x, two at least.
        n_y: along y.
        values: all of them; left out, 0.
        directional: whether a stiffness has values of its own along x, along y and in twist.

    Raises:
        ValueError: if there is no such kind, another one than a stiffness is directional, or the grid and the values do
            not fit.
    """

    kind: str = "stiffness"
    n_x: int = 2
    n_y: int = 2
    values: Sequence[float] = ()
    directional: bool = False

    parameters = {"value_1": _parameter("stiffness")}
    check = Check(2, "look at the place on the map, weigh and tap there, and put a sensor near it")
    acts_on = frozenset({"section"})
    shows = "Each mode as its energy in the field says: strain energy of a stiffness, kinetic energy of a mass."
    source = "Bendsøe and Sigmund, Topology Optimization (2003), section 1.1, on a plate described by what is where"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"Expected field.kind to be one of {', '.join(KINDS)}, got '{self.kind}'. Name one.")
        if self.directional and self.kind != "stiffness":
            raise ValueError(
                f"Expected field.directional of a stiffness alone, got a field of '{self.kind}'. Leave directional out."
            )
        if min(self.n_x, self.n_y) < 2:
            raise ValueError(
                f"Expected a grid of two nodes a side at least, got field.n_x {self.n_x}, n_y {self.n_y}. Raise them."
            )
        count = self.n_x * self.n_y
        if count > MOST_NODES:
            raise ValueError(
                f"Expected a grid of {MOST_NODES} nodes at most, got field.n_x {self.n_x}, n_y {self.n_y}. Lower them."
            )
        count *= self.n_part
        if len(self.values) not in (0, count):
            each = f", {', '.join(DIRECTIONS[:-1])} and {DIRECTIONS[-1]}" if self.directional else ""
            raise ValueError(
                f"Expected {count} field.values, one for each node of the {self.n_x} × {self.n_y} grid{each}, got "
                f"{len(self.values)}. Give all, or none."
            )
        values = self.values or [0.0] * count
        found = {f"value_{k + 1}": _parameter(self.kind, float(value)) for k, value in enumerate(values)}
        object.__setattr__(self, "parameters", found)

    @property
    def n_part(self) -> int:
        """Fields that it has: three of a directional stiffness."""
        return len(DIRECTIONS) if self.directional else 1

    @property
    def nodes_at(self) -> Float[Tensor, "n_node 2"]:
        """Relative places of the grid's nodes, x first."""
        x, y = (torch.linspace(0.0, 1.0, n, dtype=torch.float64) for n in (self.n_x, self.n_y))
        return torch.cartesian_prod(y, x).flip(-1)

    def hats(self, place: Float[Tensor, "n_place 2"]) -> Float[Tensor, "n_place n_node"]:
        """The hat function of each node of the grid at relative places."""
        x, y = place.unbind(-1)
        along_x, along_y = (
            (1 - (side[:, None] * (n - 1) - torch.arange(n).to(place)).abs()).clamp(min=0.0)
            for side, n in ((x, self.n_x), (y, self.n_y))
        )
        return (along_y[:, :, None] * along_x[:, None, :]).flatten(1)

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The field at the centre of each element."""
        if self.kind == "support":
            return section
        every = self._every(value)
        there = every.unflatten(-1, (self.n_part, -1)) @ self.hats(mesh.element_place.to(every)).mT
        if self.directional:
            along_x, along_y, twist = (1 + there).unbind(-2)
            factor = torch.stack([along_x, along_y, (along_x * along_y).sqrt(), twist], dim=-1)
            return section._replace(stiffness_factor=section.stiffness_factor * factor)
        there = there[..., 0, :]
        if self.kind == "stiffness":
            return section._replace(stiffness_factor=section.stiffness_factor * (1 + there[..., None]))
        if self.kind == "mass":
            return section._replace(density=section.density * (1 + there))
        return section.lossier(there[..., None])

    def local(self, mesh: Mesh, value: Value) -> Local | None:
        """The springs of a field of support."""
        if self.kind != "support":
            return None
        every = self._every(value)
        return Local(vector=mesh.deflection_at(self.nodes_at.to(every)), stiffness=every)

    def _every(self, value: Value) -> Float[Tensor, "*batch n_value"]:
        return torch.stack(torch.broadcast_tensors(*(value[name] for name in self.parameters)), dim=-1)
