"""The resonances of measured FRFs as partial fractions, which hold between the lines and beside the frequency axis."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor

from torchplate.model import reciprocal

# Fractions that are made together: 8 MiB of them.
AT_ONCE = 2**19


@dataclass(frozen=True, eq=False)
class Resonances:
    """H(f) = Σ_r R_r / (q_r − f²) + Σ_k c_k T_k(x), x from −1 to 1 over the lines.

    Attributes:
        pole: q, common to all FRFs [Hz²]; the imaginary part is positive.
        residue: R [unit of the FRFs times Hz²].
        smooth: c, of Chebyshev polynomials of order 0 and on [unit of the FRFs].
        band: the first and the last line [Hz].
        resonates: whether a fraction is a resonance, which a drift moves; else it is narrower than lines can tell.
        whole: with what stands out at a line or two alone; None where that is nothing.
    """

    pole: Complex[Tensor, " n_pole"]
    residue: Complex[Tensor, "n_pole n_response n_reference"]
    smooth: Complex[Tensor, "n_smooth n_response n_reference"]
    band: tuple[float, float]
    resonates: Bool[Tensor, " n_pole"]
    whole: "Resonances | None" = None

    def at(
        self, frequency: Float[Tensor, " n_frequency"], decay: Float[Tensor, " n_frequency"]
    ) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """What they are at s = iω + σ, where each resonance is as broad as with so much more damping.

        Args:
            frequency: ω / 2π, in the band [Hz].
            decay: σ ≥ 0 [1/s].
        """
        if self.whole is not None:
            return self.whole.at(frequency, decay)
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
        every = drift.unique()
        # Some records at once: their lines are one long row.
        for some in every.split(max(1, AT_ONCE // here.numel())):
            lines = frequency * (1 + some[:, None])
            there = self._columns(lines.flatten(), pole).unflatten(0, lines.shape)
            for one, change in zip(some, there - here, strict=True):
                which = drift == one
                found[:, which] = change @ rows[:, which]
        return found

    def spread(self, frequency: Float[Tensor, " n_frequency"], wanted: int) -> Int[Tensor, " n_kept"]:
        """Lines that say most of the resonances: a quarter of them evenly over the band, the others about the peaks.

        Every resonance has as many, as dense as its |H|² is high, the nearest line to it and its neighbours among them.
        Squares of FRFs and of what models leave of them add up to nearly what all lines make, each times the lines that
        it stands for.

        Args:
            frequency: lines, rising [Hz].
            wanted: lines, at least; all where there are no more [-].

        Returns:
            Their indices, rising, the first and the last line among them.
        """
        n = len(frequency)
        pole = self.pole[self.resonates]
        place = pole.real.clamp(min=0).sqrt()
        inside = (place >= frequency[0]) & (place <= frequency[-1])
        place, width = place[inside], pole.imag[inside] / place[inside].clamp(min=1e-300)
        density = torch.full_like(frequency, 1 / n)
        if len(place):
            step = float((frequency[-1] - frequency[0]) / max(1, n - 1))
            near = 1 / (1 + ((frequency[:, None] - place) / (0.5 * width).clamp(min=step)).square())
            density = 0.25 * density + 0.75 * (near / near.sum(0)).mean(-1)
        # Middles of the lines' parts of the whole.
        passed = density.cumsum(0) - 0.5 * density
        nearest = (frequency[:, None] - place).abs().argmin(0)
        kept = torch.cat([nearest - 1, nearest, nearest + 1, torch.tensor([0, n - 1]).to(nearest)]).clamp(0, n - 1)
        tried = max(1, wanted - len(kept))
        while True:
            at = torch.linspace(float(passed[0]), float(passed[-1]), tried).to(passed)
            found = torch.cat([torch.searchsorted(passed, at).clamp(max=n - 1), kept]).unique()
            if len(found) >= min(wanted, n):
                return found
            tried += 1 + tried // 32

    def _columns(self, frequency: Tensor, pole: Tensor) -> Complex[Tensor, "n_frequency n_part"]:
        """The fractions 1 / (q − f²) and the polynomials, at complex frequencies too."""
        place = frequency.to(self.pole)
        low, high = self.band
        x = (place - 0.5 * (low + high)) / (0.5 * (high - low))
        columns = [torch.ones_like(x), x]
        while len(columns) < len(self.smooth):
            columns.append(2 * x * columns[-1] - columns[-2])
        return torch.cat([reciprocal(pole - place.square()[:, None]), torch.stack(columns, dim=-1)], dim=1)
