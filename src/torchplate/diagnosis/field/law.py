"""What a force at one place says of what is attached there, line by line."""

from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor


class Law(NamedTuple):
    """How something pulls at one place, alike in all hits.

    Of a dynamic stiffness D there, and of nothing else, the FRFs change by α_jg y α_gk with

        y(s) = −D / (1 + D α_gg),

    α the receptances of the model without it (Sherman and Morrison, Annals of Mathematical Statistics 21, 1950, 124).

    Attributes:
        laplace: s of each line [1/s].
        pull: y, by least squares from the FRFs [N/m].
        weight: Σ |α_jg α_gk|² over the variance of each FRF, which weighs it [m²/N²].
        own: α_gg [m/N].
    """

    laplace: Complex[Tensor, " n_frequency"]
    pull: Complex[Tensor, " n_frequency"]
    weight: Float[Tensor, " n_frequency"]
    own: Complex[Tensor, " n_frequency"]

    def off(self, stiffness: Complex[Tensor, "*batch n_frequency"]) -> Float[Tensor, "*batch n_residual"]:
        """How far a dynamic stiffness is from what pulls there, real and imaginary parts, in standard deviations.

        Args:
            stiffness: D at each line [N/m].
        """
        left = self.pull + stiffness / (1 + stiffness * self.own)
        return torch.view_as_real(left * self.weight.sqrt()).flatten(-2)
