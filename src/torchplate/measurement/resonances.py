"""The resonances of measured FRFs as partial fractions, which hold between the lines and beside the frequency axis."""

from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Resonances:
    """H(f) = Σ_r R_r / (q_r − f²) + Σ_k c_k T_k(x), x from −1 to 1 over the lines.

    Attributes:
        pole: q, common to all FRFs [Hz²]; the imaginary part is positive.
        residue: R [unit of the FRFs times Hz²].
        smooth: c, of Chebyshev polynomials of order 0 and on [unit of the FRFs].
        band: the first and the last line [Hz].
    """

    pole: Complex[Tensor, " n_pole"]
    residue: Complex[Tensor, "n_pole n_response n_reference"]
    smooth: Complex[Tensor, "n_smooth n_response n_reference"]
    band: tuple[float, float]

    def at(
        self, frequency: Float[Tensor, " n_frequency"], decay: Float[Tensor, " n_frequency"]
    ) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """What they are at s = iω + σ, where each resonance is as broad as with so much more damping.

        Args:
            frequency: ω / 2π, in the band [Hz].
            decay: σ ≥ 0 [1/s].
        """
        place = torch.complex(frequency, -decay / (2 * torch.pi)).to(self.pole)
        fraction = 1 / (self.pole - place.square()[:, None])
        low, high = self.band
        x = (place - 0.5 * (low + high)) / (0.5 * (high - low))
        before, this = torch.ones_like(x), x
        columns = [before, this]
        for _ in range(len(self.smooth) - 2):
            before, this = this, 2 * x * this - before
            columns.append(this)
        polynomial = torch.stack(columns[: len(self.smooth)], dim=-1)
        found = fraction @ self.residue.flatten(1) + polynomial @ self.smooth.flatten(1)
        return found.unflatten(1, self.residue.shape[1:])
