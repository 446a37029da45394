"""A table of natural frequencies as evidence: residuals, their scatter, and one unknown factor on all of it.

With r = (f_model − f_measured) / std and variances κ² std², κ² ~ inverse gamma(ν/2, ν/2), the factor integrates out:
−2 ln p = (ν + n) ln(1 + r·r/ν) + 2 Σ ln std + const, a Student t in n dimensions. Its curvature at a minimum is that of
a Gaussian whose variances are κ² = (ν + r·r) / (ν + n) times as large. Source: Gelman et al., Bayesian Data Analysis
(3rd ed. 2013), section 3.2.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchplate.diagnosis.table.settings import TableSettings
from torchplate.measurement import NaturalFrequencies, assumed, with_std


@dataclass(frozen=True, eq=False)
class TableEvidence:
    """What was measured and how well.

    Attributes:
        mode: index of each mode, from 0.
        frequency: as measured [Hz].
        std: standard deviation of each, with what the mesh leaves of its error [Hz].
        scatter: the same without the mesh [Hz].
        freedom: ν of the prior of κ² [-].
        sentences: what a reader must know of the scatter.
    """

    mode: Int[Tensor, " n_mode"]
    frequency: Float[Tensor, " n_mode"]
    std: Float[Tensor, " n_mode"]
    scatter: Float[Tensor, " n_mode"]
    freedom: float
    sentences: tuple[str, ...]

    @classmethod
    def of(cls, table: NaturalFrequencies, settings: TableSettings) -> "TableEvidence":
        """A table with the standard deviations that it has, or the default ones."""
        whole, said = with_std(table), assumed(table)
        assert whole.std is not None
        freedom = settings.freedom_assumed if said else settings.freedom_told
        std = whole.std.to(torch.float64)
        return cls(table.mode - 1, table.frequency.to(std), std, std, freedom, (said,) if said else ())

    def on_mesh(self, error: Float[Tensor, " n_mode"]) -> "TableEvidence":
        """The same where a mesh leaves these errors [Hz]."""
        return replace(self, std=torch.hypot(self.scatter, error))

    @property
    def n(self) -> int:
        """Number of frequencies."""
        return len(self.mode)

    def residual(self, predicted: Float[Tensor, "*batch n_mode"]) -> Float[Tensor, "*batch n_mode"]:
        """Deviation of the model from the table over the standard deviation."""
        return (predicted - self.frequency) / self.std

    def gap(self, predicted: Float[Tensor, " n_mode"]) -> float:
        """Root mean square of the relative error [-]."""
        return float(((predicted - self.frequency) / self.frequency).square().mean().sqrt())

    @property
    def floor(self) -> float:
        """What the scatter alone makes the gap [-]."""
        return float((self.scatter / self.frequency).square().mean().sqrt())

    def minus_two_log_likelihood(self, chi_square: float) -> float:
        """−2 ln p of a sum of squares, κ integrated out, but for a constant."""
        return float(self.minus_two_log_likelihoods(torch.tensor(chi_square, dtype=torch.float64)))

    def minus_two_log_likelihoods(self, chi_square: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """The same of many."""
        return of_unknown_scale(chi_square, self.freedom, self.n) + 2 * float(self.std.log().sum())

    def kappa_square(self, chi_square: float) -> float:
        """The factor κ² on all variances that goes with a sum of squares."""
        return (self.freedom + chi_square) / (self.freedom + self.n)

    def limit(self, n_effective: float, level: float) -> float:
        """The χ² that scatter alone exceeds with probability 1 − level: (n − p) times the quantile of F(n − p, ν)."""
        rest = max(1.0, self.n - n_effective)
        import scipy.stats  # here: a third of what importing this package takes

        return rest * float(scipy.stats.f.ppf(level, rest, self.freedom))


def of_unknown_scale(chi_square: Float[Tensor, "*batch"], freedom: float, n: int) -> Float[Tensor, "*batch"]:
    """−2 ln p of a sum of squares, the factor on all variances integrated out, but for a constant and the variances.

    Args:
        chi_square: of n numbers.
        freedom: ν of the inverse gamma prior of the factor.
        n: how many.
    """
    return (freedom + n) * torch.log1p(chi_square / freedom)
