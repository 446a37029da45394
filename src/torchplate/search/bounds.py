"""What becomes of a coordinate that leaves [0, 1]. A rule acts on each coordinate by itself.

Source: Price, Storn and Lampinen (2005), section 4.3; `midpoint` is that of Zhang and Sanderson (2009),
"JADE", IEEE Trans. Evolutionary Computation 13, 945-958; `redraw` is what
`scipy.optimize.differential_evolution` does.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.search.draws import Draw

Positions = Float[Tensor, "*batch n_member n_dimension"]


def reflect(position: Positions, target: Positions, generator: torch.Generator) -> Positions:  # noqa: ARG001
    """The edges are mirrors, as often as it takes: 1.2 → 0.8, −0.3 → 0.3, 2.1 → 0.1.

    Points neither pile up on the edge nor forget where they came from, and an optimum on the edge is
    approached as fast as the population shrinks.
    """
    folded = position.remainder(2.0)
    return torch.minimum(folded, 2.0 - folded)


def redraw(position: Positions, target: Positions, generator: torch.Generator) -> Positions:  # noqa: ARG001
    """A coordinate outside is drawn anew, evenly over [0, 1]."""
    fresh = Draw(generator, position).uniform(position.shape)
    return torch.where((position < 0.0) | (position > 1.0), fresh, position)


def midpoint(position: Positions, target: Positions, generator: torch.Generator) -> Positions:  # noqa: ARG001
    """A coordinate outside goes half way from its target to the edge it crossed."""
    inside = torch.where(position < 0.0, target / 2.0, position)
    return torch.where(position > 1.0, (1.0 + target) / 2.0, inside)


def clip(position: Positions, target: Positions, generator: torch.Generator) -> Positions:  # noqa: ARG001
    """A coordinate outside goes onto the edge it crossed."""
    return position.clamp(0.0, 1.0)


BOUNDS: dict[str, Callable[[Tensor, Tensor, torch.Generator], Tensor]] = {
    "reflect": reflect,
    "redraw": redraw,
    "midpoint": midpoint,
    "clip": clip,
}
"""The bound rules by name: (position, the target it was made from, generator) → position inside [0, 1]."""
