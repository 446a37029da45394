"""A rectangular plate, cut into n_x × n_y elements, each in refine × refine again.

Elements may be cut out, in rectangles of the n_x × n_y grid; their places in the numbering of the nodes stay.

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
# In elements: what rounding may make of a place on a line of the mesh.
ON_LINE = 1e-6


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
        cut: rectangles (x0, y0, x1, y1) without plate, in relative places on lines of the n_x × n_y grid: holes, a
            corner that is missing. Their elements are left out, and the nodes that then belong to none; labels stay.

    Raises:
        ValueError: if a side is not positive, a count is below 1, an edge or its condition is unknown, a cut is no
            rectangle of elements, or no element is left.
    """

    length_x: float
    length_y: float
    n_x: int
    n_y: int
    refine: int = 1
    edges: Mapping[str, str] = field(default_factory=dict)
    extrapolate: bool = False
    cut: Sequence[Sequence[float]] = ()

    def __post_init__(self) -> None:
        for name in ("length_x", "length_y", "n_x", "n_y", "refine"):
            if getattr(self, name) <= 0:
                raise ValueError(
                    f"Expected mesh.{name} above 0, got {getattr(self, name)}. Give a positive value in SI units."
                )
        for edge, condition in self.edges.items():
            if edge not in EDGES:
                raise ValueError(
                    f"No edge named '{edge}'. Use one of {', '.join(EDGES)}: x0 is the edge at x = 0, y1 the edge at "
                    "y = length_y."
                )
            if condition not in EDGE_CONDITIONS:
                raise ValueError(
                    f"Expected mesh.edges.{edge} to be one of {', '.join(EDGE_CONDITIONS)}, got '{condition}'."
                )
        for index, corners in enumerate(self.cut):
            self._check_cut(index, corners)
        if not self.n_element:
            raise ValueError("Expected mesh.cut to leave some of the plate, got none left. Make a cut smaller.")

    def _check_cut(self, index: int, corners: Sequence[float]) -> None:
        if len(corners) != 4 or not (0 <= corners[0] < corners[2] <= 1 and 0 <= corners[1] < corners[3] <= 1):
            raise ValueError(
                f"Expected mesh.cut[{index}] as [x0, y0, x1, y1] with 0 ≤ x0 < x1 ≤ 1 and 0 ≤ y0 < y1 ≤ 1, got "
                f"{list(corners)}. Give two opposite corners, divided by the sides of the plate."
            )
        for name, place, n in zip(("x0", "y0", "x1", "y1"), corners, 2 * (self.n_x, self.n_y), strict=True):
            if abs(place * n - round(place * n)) > ON_LINE:
                low = math.floor(place * n) / n
                raise ValueError(
                    f"Expected {name} of mesh.cut[{index}] on a line of the {self.n_x} × {self.n_y} mesh, such as "
                    f"{low:g} or {low + 1 / n:g}, got {place:g}. Move it there, or choose mesh.n_{name[0]} so that it "
                    "is on one."
                )

    @property
    def cells(self) -> tuple[int, int]:
        """Elements along x and y, refinement included."""
        return self.n_x * self.refine, self.n_y * self.refine

    @property
    def n_element(self) -> int:
        """Number of elements, those that are cut out left out."""
        return self.cells[0] * self.cells[1] if self.kept is None else len(self.kept)

    @cached_property
    def kept(self) -> Int[Tensor, " n_element"] | None:
        """Numbers of the elements among all of the rectangle; None where nothing is cut out."""
        if not self.cut:
            return None
        centre = self._centres
        inside = torch.zeros(len(centre), dtype=torch.bool)
        for x0, y0, x1, y1 in self.cut:
            low, high = centre.new_tensor([x0, y0]), centre.new_tensor([x1, y1])
            inside |= ((centre > low) & (centre < high)).all(-1)
        return torch.nonzero(~inside).flatten()

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
        return self.of_kept_elements(self._dof_of_all)

    def of_kept_elements(self, value: Tensor, dim: int = 0) -> Tensor:
        """Of all elements of the rectangle, along a dimension: those that are not cut out."""
        return value if self.kept is None else value.index_select(dim, self.kept.to(value.device))

    @cached_property
    def _dof_of_all(self) -> Int[Tensor, "n_all 12"]:
        cells_x, cells_y = self.cells
        corner = torch.arange(cells_x) + (cells_x + 1) * torch.arange(cells_y)[:, None]
        node = corner.reshape(-1, 1) + torch.tensor([0, 1, cells_x + 2, cells_x + 1])
        return (DOFS_PER_NODE * node[..., None] + torch.arange(DOFS_PER_NODE)).reshape(-1, element.N_DOF)

    @cached_property
    def node_place(self) -> Float[Tensor, "n_node 2"]:
        """Relative places (x/Lx, y/Ly) of all nodes [-], along x first."""
        x, y = (torch.linspace(0.0, 1.0, n + 1, dtype=torch.float64) for n in self.cells)
        return torch.cartesian_prod(y, x).flip(-1)

    @cached_property
    def element_place(self) -> Float[Tensor, "n_element 2"]:
        """Relative places of the elements' centres [-], along x first."""
        return self.of_kept_elements(self._centres)

    @cached_property
    def _centres(self) -> Float[Tensor, "n_all 2"]:
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

    def check_on_plate(self, points: Sequence[int | Sequence[float]]) -> None:
        """Whether there is plate at points.

        Raises:
            ValueError: if one is inside a hole.
        """
        if self.kept is None:
            return
        gone = ~(self.deflection_at(self.places(points)) != 0).any(-1)
        if bool(gone.any()):
            missing = [point for point, none in zip(points, gone.tolist(), strict=True) if none]
            raise ValueError(
                f"Expected points on the plate, got {', '.join(map(str, missing))} inside a hole of mesh.cut. Correct "
                "the point or the hole."
            )

    @cached_property
    def free_dof(self) -> Int[Tensor, "n_free"]:
        """Dofs that no edge holds, of nodes that belong to an element."""
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
        if self.kept is not None:
            there = torch.zeros(self.n_dof, dtype=torch.bool)
            there[self.element_dof.flatten()] = True
            held |= ~there.view_as(held)
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
            place: (x/Lx, y/Ly) [-]; outside 0 to 1 the nearest element's polynomial is continued, and inside a hole
                there is nothing: its row is zero.
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
    def known_along_edges(self) -> dict[tuple[object, ...], tuple[Tensor, Tensor]]:
        """Rows of deflection and slope along edges, as what holds an edge remembers them."""
        return {}

    @cached_property
    def _known_deflection(self) -> dict[tuple[object, ...], Tensor]:
        return {}

    def _deflection_at(self, place: Tensor, order_x: int, order_y: int) -> Tensor:
        dof, (value,) = self.shapes_at(place, (order_x, order_y))
        row = torch.zeros(*place.shape[:-1], self.n_dof, dtype=place.dtype, device=place.device)
        return row.scatter(-1, dof, value)

    def shapes_at(
        self, place: Float[Tensor, "*batch n_point 2"], *orders: tuple[int, int]
    ) -> tuple[Int[Tensor, "*batch n_point 12"], list[Float[Tensor, "*batch n_point 12"]]]:
        """The dofs that move relative to places, and what each of them does there; see `deflection_at`.

        Args:
            place: (x/Lx, y/Ly) [-].
            orders: of derivatives in x/Lx and y/Ly, one or more.

        Returns:
            The twelve dofs of each place's element; for each order the deflection there, or its derivative, of a unit
            of each dof: zeros inside a hole.
        """
        position, corner, present = self._located(place)
        return self._shapes_in(corner, position, orders, present)

    def shapes_about(
        self, place: Float[Tensor, "*batch n_point 2"], *orders: tuple[int, int]
    ) -> tuple[Int[Tensor, "*batch n_point 48"], list[Float[Tensor, "*batch n_point 48"]]]:
        """As `shapes_at`, but slopes go over from element to element, at whose edges those of each jump, but at nodes.

        Between the middles of two elements the motion is taken from both, half of each at their edge: what both have
        right to the third order stays so. A plate and its mirror image have the same slopes by this.

        Args:
            place: (x/Lx, y/Ly) [-].
            orders: of derivatives in x/Lx and y/Ly, one or more.

        Returns:
            The dofs of the four elements whose middles are around each place, some twice where it is near an edge of
            the plate; for each order what a unit of each does there, times the part that its element has.
        """
        position, own, present = self._located(place)
        within = position - own
        away = torch.where(within.detach() < 0.5, -1.0, 1.0)
        beside = (own + away).clamp(min=0).minimum(own.new_tensor(self.cells) - 1)
        # Half at the edge, and nothing at the middle, where it goes over to the element on the other side.
        part = 2 * (0.5 - torch.minimum(within, 1 - within)).clamp(0.0, 0.5).square()
        over = torch.tensor([[False, False], [True, False], [False, True], [True, True]], device=place.device)
        four, there = torch.where(over, beside[..., None, :], own[..., None, :]), self._there(place.device)
        if there is not None:
            four = torch.where(there[self._number(four)][..., None], four, own[..., None, :])
        dof, every = self._shapes_in(
            four, position[..., None, :], orders, None if present is None else present[..., None]
        )
        weight = torch.where(over, part[..., None, :], 1 - part[..., None, :]).prod(-1, keepdim=True)
        return dof.flatten(-2), [(weight * value).flatten(-2) for value in every]

    def _located(self, place: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        """Places in elements' sides, the corner of the element each lies in, and whether that one is there."""
        cells = torch.tensor(self.cells, dtype=place.dtype, device=place.device)
        position = place * cells
        # Differentiable in the place: only the number of the element is piecewise constant.
        corner = position.detach().floor().clamp(min=0).minimum(cells - 1)
        there = self._there(place.device)
        return (position, corner, None) if there is None else (position, *self._beside_holes(there, position, corner))

    def _shapes_in(
        self, corner: Tensor, position: Tensor, orders: Sequence[tuple[int, int]], present: Tensor | None
    ) -> tuple[Tensor, list[Tensor]]:
        """Dofs of elements, and what a unit of each does at positions in them or beside; zero where none is there."""
        sides = (1 / self.cells[0], 1 / self.cells[1])
        every = [element.shape_functions(position - corner, *sides, *order) for order in orders]
        if present is not None:
            every = [torch.where(present[..., None], value, 0.0) for value in every]
        return self._dof_of_all.to(corner.device)[self._number(corner)], every

    def _number(self, corner: Tensor) -> Tensor:
        """Of elements, by their corners, those that a hole takes away too."""
        return (corner[..., 0] + self.cells[0] * corner[..., 1]).long()

    def _there(self, device: torch.device) -> Tensor | None:
        """Whether elements are there, by their numbers; None where all are."""
        if self.kept is None:
            return None
        there = torch.zeros(self.cells[0] * self.cells[1], dtype=torch.bool, device=device)
        there[self.kept.to(device)] = True
        return there

    def _beside_holes(self, there: Tensor, position: Tensor, corner: Tensor) -> tuple[Tensor, Tensor]:
        """An element that is there for each place, that on the other side of its edge where need be; and whether."""
        position, cells = position.detach(), corner.new_tensor(self.cells)
        found, present = corner, torch.zeros_like(corner[..., 0], dtype=torch.bool)
        for back_x, back_y in ((0, 0), (1, 0), (0, 1), (1, 1)):
            back = corner.new_tensor([back_x, back_y])
            on_edge = ((back == 0) | ((position - corner).abs() <= ON_LINE)).all(-1)
            tried = (corner - back).clamp(min=0)
            also = there[self._number(tried)] & on_edge & ~present
            # A place a rounding below a line belongs to the element beyond it, too.
            found, present = torch.where(also[..., None], tried, found), present | also
            forward = (corner + back).minimum(cells - 1)
            on_far = ((back == 0) | ((position - corner - 1).abs() <= ON_LINE)).all(-1)
            also = there[self._number(forward)] & on_far & ~present
            found, present = torch.where(also[..., None], forward, found), present | also
        return found, present

    def coverage(
        self,
        x: Float[Tensor, "*#batch"],
        y: Float[Tensor, "*#batch"],
        size: Float[Tensor, "*#batch"],
        aspect: Float[Tensor, "*#batch"] | float = 1.0,
    ) -> tuple[Float[Tensor, "*batch n_element"], Float[Tensor, "*batch n_element"]]:
        """Parts of each element's sides along x and y [-] under a rectangular patch; times each other, of its area.

        Both are zero where it covers nothing; piecewise linear in the patch's place and sides.

        Args:
            x: the patch's centre along x, relative [-].
            y: along y.
            size: root of its area over √(Lx Ly) [-], of the nominal sides: so it is square on a rectangle too.
            aspect: its side along x over that along y, in metres [-].
        """
        return self.overlap(*self.outline(x, y, size, aspect))

    def outline(
        self,
        x: Float[Tensor, "*#batch"],
        y: Float[Tensor, "*#batch"],
        size: Float[Tensor, "*#batch"],
        aspect: Float[Tensor, "*#batch"] | float,
    ) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """From where to where a rectangular patch goes along x and along y, relative [-]; see `coverage`."""
        stretch = math.sqrt(self.length_y / self.length_x) * aspect**0.5
        half_x, half_y = size * stretch / 2, size / stretch / 2
        return (x - half_x, x + half_x), (y - half_y, y + half_y)

    def overlap(
        self,
        over_x: tuple[Float[Tensor, "*#batch"], Float[Tensor, "*#batch"]],
        over_y: tuple[Float[Tensor, "*#batch"], Float[Tensor, "*#batch"]],
    ) -> tuple[Float[Tensor, "*batch n_element"], Float[Tensor, "*batch n_element"]]:
        """The same of any rectangle.

        Args:
            over_x: from where to where along x, relative [-].
            over_y: along y.
        """
        overlaps = []
        for (start, end), n in zip((over_x, over_y), self.cells, strict=True):
            low = torch.arange(n, dtype=start.dtype, device=start.device) / n
            first = torch.maximum(start[..., None], low)
            last = torch.minimum(end[..., None], low + 1 / n)
            overlaps.append(n * (last - first).clamp(min=0))
        along_x, along_y = torch.broadcast_tensors(overlaps[0][..., None, :], overlaps[1][..., :, None])
        covered = (along_x > 0) & (along_y > 0)
        parts = ((along * covered).flatten(-2) for along in (along_x, along_y))
        of_x, of_y = (self.of_kept_elements(part, -1) for part in parts)
        return of_x, of_y
