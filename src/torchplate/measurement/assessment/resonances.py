"""The resonances of measured FRFs as partial fractions, which hold between the lines and beside the frequency axis."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.model import reciprocal


@dataclass(frozen=True, eq=False)
class Resonances:
    """H(f) = Σ_r R_r / (q_r − f²) + Σ_k c_k T_k(x), x from −1 to 1 over the lines.

    Attributes:
        pole: q, common to all FRFs [Hz²]; the imaginary part is positive.
        residue: R [unit of the FRFs times Hz²].
        smooth: c, of Chebyshev polynomials of order 0 and on [unit of the FRFs].
        band: the first and the last line [Hz].
        resonates: whether a fraction is a resonance, which a drift moves; else a line or two that stand out alone.
    """

    pole: Complex[Tensor, " n_pole"]
    residue: Complex[Tensor, "n_pole n_response n_reference"]
    smooth: Complex[Tensor, "n_smooth n_response n_reference"]
    band: tuple[float, float]
    resonates: Bool[Tensor, " n_pole"]

    def at(
        self, frequency: Float[Tensor, " n_frequency"], decay: Float[Tensor, " n_frequency"]
    ) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """What they are at s = iω + σ, where each resonance is as broad as with so much more damping.

        Args:
            frequency: ω / 2π, in the band [Hz].
            decay: σ ≥ 0 [1/s].
        """
        rows = torch.cat([self.residue, self.smooth]).flatten(1)
        found = self._columns(torch.complex(frequency, -decay / (2 * torch.pi)), self.pole) @ rows
        return found.unflatten(1, self.residue.shape[1:])

    def moved(
        self, frequency: Float[Tensor, " n_frequency"], drift: Float[Tensor, "n_response n_reference"]
    ) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """What it takes to undo a drift of each FRF's record: H(f (1 + δ)) − H(f).

        Args:
            frequency: lines [Hz].
            drift: δ, relative rise of all natural frequencies in that record [-].
        """
        found, pole = self.residue.new_zeros(len(frequency), *drift.shape), self.pole[self.resonates]
        here, rows = self._columns(frequency, pole), torch.cat([self.residue[self.resonates], self.smooth])
        for one in drift.unique().tolist():
            which = drift == one
            found[:, which] = (self._columns(frequency * (1 + one), pole) - here) @ rows[:, which]
        return found

    def _columns(self, frequency: Tensor, pole: Tensor) -> Complex[Tensor, "n_frequency n_part"]:
        """The fractions 1 / (q − f²) and the polynomials, at complex frequencies too."""
        place = frequency.to(self.pole)
        low, high = self.band
        x = (place - 0.5 * (low + high)) / (0.5 * (high - low))
        columns = [torch.ones_like(x), x]
        while len(columns) < len(self.smooth):
            columns.append(2 * x * columns[-1] - columns[-2])
        return torch.cat([reciprocal(pole - place.square()[:, None]), torch.stack(columns, dim=-1)], dim=1)
