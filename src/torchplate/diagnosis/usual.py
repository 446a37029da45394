"""Priors of which half is narrow: what half of all cases have near the value that changes nothing.

The rest of such a prior is uniform on the unit cube, as that of all other numbers. With N(m, S) the narrow half, a
density is ½ + ½ N(u; m, S) times the uniform one, and a posterior N(û, C) beside the uniform one becomes more probable
by ½ + ½ N(û; m, S + C).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.model import PlateModel


@dataclass(frozen=True, eq=False)
class Usual:
    """The narrow halves of a hypothesis.

    Args:
        of_effects: for each effect that has some: which parameters of the model, their means and standard deviations
            on the unit cube.
    """

    of_effects: tuple[tuple[list[int], Tensor, Tensor], ...] = ()

    @classmethod
    def of(cls, model: PlateModel, added: Mapping[str, Candidate]) -> "Usual":
        """Of the candidates that were added to a model, by their labels."""
        found = []
        for label, candidate in added.items():
            if usual := candidate.usual:
                mean, std = torch.tensor(list(usual.values()), dtype=torch.float64).unbind(-1)
                found.append(([model.names.index(f"{label}.{key}") for key in usual], mean, std))
        return cls(tuple(found))

    def of_posterior(self, position: Float[Tensor, " n"], covariance: Float[Tensor, "n n"]) -> float:
        """−2 ln of what these priors hold of a posterior, over what uniform ones do.

        Args:
            position: its mean, on the unit cube.
            covariance: beside uniform priors.
        """
        total = 0.0
        for some, mean, std in self.of_effects:
            whole = covariance[some][:, some].cpu() + torch.diag(std.square())
            off = position[some].cpu() - mean
            exponent = off @ torch.linalg.solve(whole, off) + torch.linalg.slogdet(2 * math.pi * whole).logabsdet
            total -= 2 * math.log(0.5 + 0.5 * math.exp(-0.5 * float(exponent)))
        return total

    def at(self, position: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch"]:
        """−2 ln of the prior density at places on the unit cube, over a uniform one."""
        total = position.new_zeros(position.shape[:-1])
        for some, mean, std in self.of_effects:
            off = (position[..., some] - mean.to(position)) / std.to(position)
            norm = float((2 * math.pi * std.square()).log().sum())
            total = total - 2 * (0.5 + 0.5 * (-0.5 * (off.square().sum(-1) + norm)).exp()).log()
        return total
