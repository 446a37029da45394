"""Inner products of many changes with the residuals, none of the changes whitened.

With W = (D + J S Jᵀ)^−½ over √D, which is symmetric, and K an orthonormal basis of what the fitted parameters can do, a
change δ over √D is W δ whitened and P W δ freed, P = I − K Kᵀ. All that the score test asks of it are

    rᵀ P W δ = (W P r)ᵀ δ,    |P W δ|² = |W δ|² − |(W K)ᵀ δ|²,

so W is applied once to the few vectors r, K and the draws of chance, not to every change; and |W δ|² follows from Jᵀ δ.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchplate.diagnosis.selection.null import PARALLEL, Draws
from torchplate.discrepancy import Marginal

# Draws of chance that are whitened together.
AT_ONCE = 16


class Product(NamedTuple):
    """What the score test asks of some changes.

    Attributes:
        along: inner product of each, freed, with what is left.
        size: square of each, freed.
        known: of each with the basis of what the fitted parameters can do.
        drawn: of each, freed, with each draw.
        mesh: of each, freed, with what a mesh may have left.
    """

    along: Float[Tensor, " n_member"]
    size: Float[Tensor, " n_member"]
    known: Float[Tensor, "n_member n_known"]
    drawn: Float[Tensor, "n_member n_draw"]
    mesh: Float[Tensor, " n_member"]

    @property
    def fall(self) -> Float[Tensor, "n_member n_draw"]:
        """What each alone would take from the sum of squares of each draw."""
        return self.drawn.square() / self.size[:, None]


class Products:
    """Inner products with residuals, with what the fitted parameters can do, and with draws of chance.

    Args:
        marginal: noise and nuisances; None where residuals are taken as they are.
        left: whitened residuals, freed of what the fitted parameters can do.
        known: basis of that, orthonormal.
        draws: whitened residuals as chance makes them; None where nobody asks.
        n: of the residuals, those of the FRFs; those of what is known beforehand come after them.
        mesh: what a mesh may have left of the FRFs, over √D; None for nothing.
    """

    def __init__(
        self,
        marginal: Marginal | None,
        left: Float[Tensor, " n_residual"],
        known: Float[Tensor, "n_residual n_known"],
        draws: Draws | None,
        n: int,
        mesh: Float[Tensor, " n"] | None = None,
    ) -> None:
        self._marginal, self._known, self._n = marginal, known, n
        by_mesh = torch.zeros_like(left[:n]) if mesh is None else self.freed(mesh)[:n]
        rows = torch.cat([left[None, :n], by_mesh[None], known.mT[:, :n]])
        n_draw = 0 if draws is None else len(draws)
        beside = left.new_empty(len(rows) + n_draw, n)
        beside[: len(rows)] = self.whitened(rows)
        if draws is not None:
            # A few at a time: whitening takes several times the memory of what it whitens, and draws are not kept.
            for here, some in zip(beside[len(rows) :].split(AT_ONCE), draws.split(AT_ONCE), strict=True):
                here[:] = self.whitened((some - (some @ known) @ known.mT)[:, :n])
        self._beside = beside.mT

    def whitened(self, change: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
        """W of changes over √D."""
        return change if self._marginal is None else self._marginal.whitened(change)

    def freed(self, change: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_residual"]:
        """P W of changes over √D, which do nothing to what is known beforehand."""
        found, known = self.whitened(change), self._known
        told = found.new_zeros(*found.shape[:-1], len(known) - self._n)
        return torch.cat([found, told], dim=-1) - (found @ known[: self._n]) @ known.mT

    def of(self, change: Float[Tensor, "n_member n"]) -> Product:
        """Those of some changes over √D."""
        beside, n_known = change @ self._beside, self._known.shape[-1]
        along, mesh, known, drawn = beside.tensor_split((1, 2, 2 + n_known), dim=-1)
        whole = change.square().sum(-1)
        if self._marginal is not None:
            whole = whole - self._marginal.hidden(change)
        size = (whole - known.square().sum(-1)).clamp(min=1e-280)
        return Product(along[:, 0], size, known, drawn, mesh[:, 0])


def best_of_places(found: Product) -> Float[Tensor, " n_draw"]:
    """What the best of some changes would take from each draw, those left out that the fitted parameters can make."""
    return found.fall[_seen(found)].amax(0)


def most_of_the_mesh(found: Product) -> float:
    """What the best of them would take from the square of what a mesh may have left, likewise."""
    return float((found.mesh.square() / found.size)[_seen(found)].amax())


def _seen(found: Product) -> Bool[Tensor, " n_member"]:
    return found.size > PARALLEL**2 * found.size.max()
