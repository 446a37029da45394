"""A rectangular plate, cut into n_x × n_y elements, each in refine × refine again.

The mesh lies on the unit square: places are relative, x/Lx and y/Ly, and a node's dofs are w, ∂w/∂(y/Ly) and
−∂w/∂(x/Lx), all in metres. The lengths enter where the section is assembled. So a change of the sides moves no node
and no shape function, and every member of a population shares one mesh.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchplate.plate import element
from torchplate.plate.transforms import REMEMBERED, stays

EDGES = ("x0", "x1", "y0", "y1")
EDGE_CONDITIONS = ("free", "simply_supported", "clamped")
DOFS_PER_NODE = 3


@dataclass(frozen=True)
class Mesh:
    """Nodes, elements and dofs of a plate.

    Args:
        length_x: nominal side along x [m], > 0.
        length_y: nominal side along y [m], > 0.
        n_x: elements along x, ≥ 1; with n_y they also name the node labels.
        n_y: elements along y, ≥ 1.
        refine: each element is split in refine × refine; labels stay.
        edges: `free` (the default), `simply_supported` or `clamped` for x0, x1, y0, y1.
        extrapolate: whether a model on this mesh is to have its remaining mesh error taken off; see
            `model.extrapolation`.

    Raises:
        ValueError: if a side is not positive, a count is below 1, or an edge or its condition is unknown.
    """

    length_x: float
    length_y: float
    n_x: int
    n_y: int
    refine: int = 1
    edges: Mapping[str, str] = field(default_factory=dict)
    extrapolate: bool = False

    def __post_init__(self) -> None:
        for name in ("length_x", "length_y", "n_x", "n_y", "refine"):
            if getattr(self, name) <= 0:
                raise ValueError(
                    f"Expected mesh.{name} above 0, got {getattr(self, name)}. Give a positive value in SI units."
                )
        for edge, condition in self.edges.items():
            if edge not in EDGES:
                raise ValueError(f"No edge named '{edge}'. Use one of {', '.join(EDGES)}.")
            if condition not in EDGE_CONDITIONS:
                raise ValueError(
                    f"Expected mesh.edges.{edge} to be one of {', '.join(EDGE_CONDITIONS)}, got '{condition}'."
                )

    @property
    def cells(self) -> tuple[int, int]:
        """Elements along x and y, refinement included."""
        return self.n_x * self.refine, self.n_y * self.refine

    @property
    def n_element(self) -> int:
        """Number of elements."""
        return self.cells[0] * self.cells[1]

    @property
    def n_node(self) -> int:
        """Number of nodes, those between the labelled ones included."""
        return (self.cells[0] + 1) * (self.cells[1] + 1)

    @property
    def n_dof(self) -> int:
        """Number of dofs, held ones included."""
        return DOFS_PER_NODE * self.n_node

    @property
    def n_label(self) -> int:
        """Number of labelled nodes: those of the n_x × n_y grid."""
        return (self.n_x + 1) * (self.n_y + 1)

    @cached_property
    def element_dof(self) -> Int[Tensor, "n_element 12"]:
        """Dofs of each element, corner by corner; elements count along x first."""
        cells_x, cells_y = self.cells
        corner = torch.arange(cells_x) + (cells_x + 1) * torch.arange(cells_y)[:, None]
        node = corner.reshape(-1, 1) + torch.tensor([0, 1, cells_x + 2, cells_x + 1])
        return (DOFS_PER_NODE * node[..., None] + torch.arange(DOFS_PER_NODE)).reshape(self.n_element, element.N_DOF)

    @cached_property
    def node_place(self) -> Float[Tensor, "n_node 2"]:
        """Relative places (x/Lx, y/Ly) of all nodes [-], along x first."""
        x, y = (torch.linspace(0.0, 1.0, n + 1, dtype=torch.float64) for n in self.cells)
        return torch.cartesian_prod(y, x).flip(-1)

    @cached_property
    def element_place(self) -> Float[Tensor, "n_element 2"]:
        """Relative places of the elements' centres [-], along x first."""
        x, y = ((torch.arange(n, dtype=torch.float64) + 0.5) / n for n in self.cells)
        return torch.cartesian_prod(y, x).flip(-1)

    def places(
        self, points: Sequence[int | Sequence[float]] | Float[Tensor, "n_point 2"]
    ) -> Float[Tensor, "n_point 2"]:
        """Relative places (x/Lx, y/Ly) [-] of points, each a node label or already a relative place.

        A tensor of relative places passes as it is, its gradient too; whether it lies on the plate is not checked,
        because torch.func does not let its values decide anything.

        Raises:
            ValueError: if a label is not on the n_x × n_y grid, or a place is not on the plate.
        """
        if isinstance(points, Tensor):
            return points
        found = []
        for point in points:
            if isinstance(point, int):
                if not 1 <= point <= self.n_label:
                    raise ValueError(
                        f"Expected node labels from 1 to {self.n_label} on a {self.n_x} × {self.n_y} mesh, "
                        f"got {point}. Correct the label, or give a relative place [x, y] instead."
                    )
                row, column = divmod(point - 1, self.n_x + 1)
                found.append((column / self.n_x, row / self.n_y))
            elif len(point) == 2 and all(0 <= coordinate <= 1 for coordinate in point):
                found.append((float(point[0]), float(point[1])))
            else:
                raise ValueError(
                    f"Expected a node label or a relative place [x, y] with both from 0 to 1, got {list(point)}. "
                    "Divide by the sides of the plate."
                )
        return torch.tensor(found, dtype=torch.float64).reshape(-1, 2)

    @cached_property
    def free_dof(self) -> Int[Tensor, "n_free"]:
        """Dofs that no edge holds."""
        held = torch.zeros(self.cells[1] + 1, self.cells[0] + 1, DOFS_PER_NODE, dtype=torch.bool)
        line: dict[str, tuple[slice | int, slice | int]] = {
            "x0": (slice(None), 0),
            "x1": (slice(None), -1),
            "y0": (0, slice(None)),
            "y1": (-1, slice(None)),
        }
        for edge, condition in self.edges.items():
            if condition == "clamped":
                held[line[edge]] = True
            elif condition == "simply_supported":
                # Where w vanishes along an edge, so does its slope along that edge.
                held[line[edge]] |= torch.tensor([True, edge.startswith("x"), edge.startswith("y")])
        return torch.nonzero(~held.flatten()).flatten()

    @cached_property
    def rigid_translation(self) -> Float[Tensor, "n_dof"]:
        """The whole plate moved by 1 m along z."""
        return torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).repeat(self.n_node)

    def deflection_at(
        self, place: Float[Tensor, "*batch n_point 2"], order_x: int = 0, order_y: int = 0
    ) -> Float[Tensor, "*batch n_point n_dof"]:
        """Deflection at relative places as a row over the dofs, through the element's shape functions.

        Args:
            place: (x/Lx, y/Ly) [-]; outside 0 to 1 the nearest element's polynomial is continued.
            order_x: order of the derivative in x/Lx.
            order_y: order of the derivative in y/Ly.
        """
        if not stays(place):
            return self._deflection_at(place, order_x, order_y)
        # Sensors, hammers and wires mostly stay where they are.
        key = (place.dtype, place.numpy().tobytes(), order_x, order_y)
        found = self._known_deflection.get(key)
        if found is None:
            found = self._deflection_at(place, order_x, order_y)
            if len(self._known_deflection) >= REMEMBERED:
                self._known_deflection.clear()
            self._known_deflection[key] = found
        return found

    @cached_property
    def _known_deflection(self) -> dict[tuple[object, ...], Tensor]:
        return {}

    def _deflection_at(self, place: Tensor, order_x: int, order_y: int) -> Tensor:
        cells = torch.tensor(self.cells, dtype=place.dtype, device=place.device)
        position = place * cells
        # Differentiable in the place: only the number of the element is piecewise constant.
        corner = position.detach().floor().clamp(min=0).minimum(cells - 1)
        number = (corner[..., 0] + self.cells[0] * corner[..., 1]).long()
        value = element.shape_functions(position - corner, 1 / self.cells[0], 1 / self.cells[1], order_x, order_y)
        row = torch.zeros(*place.shape[:-1], self.n_dof, dtype=place.dtype, device=place.device)
        return row.scatter(-1, self.element_dof.to(place.device)[number], value)

    def coverage(
        self, x: Float[Tensor, "*#batch"], y: Float[Tensor, "*#batch"], size: Float[Tensor, "*#batch"]
    ) -> tuple[Float[Tensor, "*batch n_element"], Float[Tensor, "*batch n_element"]]:
        """Parts of each element's sides along x and y [-] that a square patch covers; times each other, of its area.

        Both are zero where it covers nothing; piecewise linear in the patch's place and size.

        Args:
            x: the patch's centre along x, relative [-].
            y: along y.
            size: its side over √(Lx Ly) [-], of the nominal sides: so it is square on a rectangle too.
        """
        overlaps = []
        stretch = math.sqrt(self.length_y / self.length_x)
        for centre, half, n in ((x, size * stretch / 2, self.cells[0]), (y, size / stretch / 2, self.cells[1])):
            low = torch.arange(n, dtype=size.dtype, device=size.device) / n
            first = torch.maximum((centre - half)[..., None], low)
            last = torch.minimum((centre + half)[..., None], low + 1 / n)
            overlaps.append(n * (last - first).clamp(min=0))
        along_x, along_y = torch.broadcast_tensors(overlaps[0][..., None, :], overlaps[1][..., :, None])
        covered = (along_x > 0) & (along_y > 0)
        return (along_x * covered).flatten(-2), (along_y * covered).flatten(-2)
