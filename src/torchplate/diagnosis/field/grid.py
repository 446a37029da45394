"""The nodes of a field: where its weight sits, how far it spreads, its mirror images."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.settings.field import FieldInference
from torchplate.effects import Field
from torchplate.plate import Mesh


class Grid(NamedTuple):
    """Nodes over the whole plate, along x first.

    Attributes:
        n_x: along x.
        n_y: along y.
        square: whether a plate turned by a right angle is the same plate.
    """

    n_x: int
    n_y: int
    square: bool

    @classmethod
    def of(cls, mesh: Mesh, settings: FieldInference) -> "Grid":
        """As many on any plate as on a square one, the spacing alike along both sides; three a side at least.

        Args:
            mesh: of the plate.
            settings: of the inference.
        """
        ratio = math.sqrt(mesh.length_x / mesh.length_y)
        n_x, n_y = (max(3, 1 + round((settings.n_side - 1) * part)) for part in (ratio, 1 / ratio))
        return cls(n_x, n_y, abs(mesh.length_x / mesh.length_y - 1) < settings.square)

    @property
    def place(self) -> Float[Tensor, "n_node 2"]:
        """Relative places of the nodes."""
        return Field(n_x=self.n_x, n_y=self.n_y).nodes_at

    @property
    def area(self) -> Float[Tensor, " n_node"]:
        """Part of the plate that each node's hat function stands for; 1 in all."""
        sides = []
        for n in (self.n_x, self.n_y):
            side = torch.full((n,), 1 / (n - 1), dtype=torch.float64)
            side[0] = side[-1] = 0.5 / (n - 1)
            sides.append(side)
        return (sides[1][:, None] * sides[0]).flatten()

    def centre(
        self, values: Float[Tensor, " n_value"], seen: Float[Tensor, " n_value"] | None = None
    ) -> tuple[Float[Tensor, " 2"], Float[Tensor, " 2"]]:
        """Where the weight of a field sits, and its standard deviation about that along x and y, relative.

        The weight is the square of the value, or of what it does to the FRFs: what is large counts, and not what is
        wide and faint.

        Args:
            values: of the field.
            seen: the square of what a unit of each does; left out, the area that it stands for.
        """
        each = self.area if seen is None else self.parts(seen)
        weight = (self.parts(values).square() * each).sum(0)
        weight = weight / weight.sum().clamp(min=1e-300)
        middle = weight @ self.place
        return middle, (weight @ (self.place - middle).square()).sqrt()

    def parts(self, values: Float[Tensor, " n_value"]) -> Float[Tensor, "n_part n_node"]:
        """The fields of a directional stiffness; one of all else."""
        return values.unflatten(0, (-1, self.n_x * self.n_y))

    def images(self, values: Float[Tensor, " n_value"]) -> list[Float[Tensor, " n_value"]]:
        """The mirror images of a field, and on a square those turned by a right angle."""
        whole = self.parts(values).unflatten(-1, (self.n_y, self.n_x))
        found = [whole.flip(2), whole.flip(1), whole.flip(1, 2)]
        if self.square and self.n_x == self.n_y:
            # What was along x is along y then.
            turned = [1, 0, *range(2, len(whole))] if len(whole) > 1 else [0]
            found += [one[turned].mT for one in (whole, *found)]
        return [one.flatten() for one in found]
