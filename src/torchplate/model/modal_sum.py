"""The sum over modes, for many lines at once.

With damping in proportion to K and M, Z(s) = κ (K − z M), z = −μ/κ, and the receptance is 1/κ times

    G(z) = Σ_r φ_r φ_rᵀ / (λ_r − z),

a function of one complex number near the real axis. For a block of lines, the modes near it are summed one by one. All
others together vary slowly with z there, and each is a Chebyshev series that is known in closed form:
1 / (a − t) = 2 / √(a² − 1) · Σ' ρ⁻ᵏ T_k(t), ρ = a + √(a² − 1) (Mason and Handscomb, Chebyshev Polynomials, 2003,
section 5.2). So most modes cost nothing for each line, and none is left out.

Arrays are [n_row, n_column, *batch, n_frequency] here: every step is then one operation on long rows of lines.
"""

from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

# A mode is far from a block of lines if its ρ is at least RHO: n terms of the series then leave RHO^−n of what it adds
# to the FRF. The series is for z near the real axis: damping widens the block by WIDENED times its Im z.
RHO = 3.0
WIDENED = 8.0
# Terms that leave 6e-6, which is 1e-6 of the FRF where peaks outweigh what is far from them; and terms that leave no
# more than rounding: what a member gets then does not depend on who stands beside it in the batch.
CLOSE, EXACT = 11, 32
# Lines that go together on a CPU, and members: what is made of them stays in the cache, and is the same in any batch.
LINES_AT_ONCE = 200
MEMBERS_AT_ONCE = 64


class Disc(NamedTuple):
    """A stretch of the real axis, and so much beside it, that z is in [rad²/s²]."""

    centre: float
    half: float

    @classmethod
    def around(cls, z: Complex[Tensor, "*batch"], eigenvalue: Float[Tensor, "*more"]) -> "Disc | None":
        """The one that holds all z; None under `vmap`, where nobody may look."""
        try:
            parts = torch.view_as_real(z.detach()).flatten(0, -2)
            (low, down), (high, up) = (found.tolist() for found in (parts.amin(0), parts.amax(0)))
            highest = float(eigenvalue.detach().amax())
        except RuntimeError:
            return None
        # A single line has no width of its own.
        off = max(-down, up)
        return cls(0.5 * (low + high), max(0.5 * (high - low), WIDENED * off, 1e-3 * abs(high), 1e-9 * highest))


class Stretch(NamedTuple):
    """A disc, and what the modes are to it: those near it one by one, all others as a series."""

    disc: Disc
    first: int
    last: int  # beyond the last near one
    series: Float[Tensor, "*batch n n_term"] | None  # of each mode, zero of the near ones; None where all are near

    @classmethod
    def around(cls, disc: Disc, eigenvalue: Float[Tensor, "*batch n"], n_term: int) -> "Stretch":
        """What the modes are to a disc, for some member near to it or for none.

        Args:
            disc: where z is expected.
            eigenvalue: λ, lowest first [rad²/s²].
            n_term: terms of the series.
        """
        n, reach = eigenvalue.shape[-1], 0.5 * (RHO + 1 / RHO) * disc.half
        held = eigenvalue.detach()
        first = int((held < disc.centre - reach).sum(-1).min())
        last = int((held <= disc.centre + reach).sum(-1).max())
        if n - (last - first) <= n_term:
            return cls(disc, 0, n, None)
        near = (torch.arange(n, device=held.device) >= first) & (torch.arange(n, device=held.device) < last)
        # A pole that is near has no such series: any far one stands in its place, and counts for nothing.
        a = torch.where(near, 2.0, (eigenvalue - disc.centre) / disc.half)
        return cls(disc, first, last, torch.where(near[:, None], 0.0, chebyshev_series(a, n_term) / disc.half))


def modal_sum(
    eigenvalue: Float[Tensor, "*#batch n"],
    left: Float[Tensor, "*#batch n_left n"],
    right: Float[Tensor, "*#batch n_right n"],
    z: Complex[Tensor, "*batch n_frequency"],
    stretch: Stretch | None = None,
) -> Complex[Tensor, "n_left n_right *batch n_frequency"]:
    """Σ left right / (λ − z), one real matrix product.

    Args:
        eigenvalue: λ, lowest first [rad²/s²].
        left: modal deflections of the rows [1/√kg].
        right: of the columns.
        z: −μ/κ [rad²/s²].
        stretch: one that holds z; if none is given, that of z itself, with a series that leaves rounding only.
    """
    if stretch is None and (disc := Disc.around(z, eigenvalue)) is not None:
        stretch = Stretch.around(disc, eigenvalue, EXACT)
    # Under `vmap` every mode is summed one by one: nothing is known of z.
    first, last = (0, eigenvalue.shape[-1]) if stretch is None else stretch[1:3]
    pairs = (left[..., :, None, :] * right[..., None, :, :]).flatten(-3, -2)
    # Where all members have the same modes and rows, they are one long row of lines.
    alike = eigenvalue.ndim == 1 and pairs.ndim == 2
    row = z.reshape(-1) if alike else z
    x, y = (part.contiguous()[..., None, :] for part in (row.real, row.imag))
    apart = eigenvalue[..., first:last, None] - x
    scale = 1 / torch.addcmul(y * y, apart, apart)
    weight, features = pairs[..., first:last], [torch.complex(apart * scale, y * scale)]
    if stretch is not None and stretch.series is not None:
        series = pairs @ stretch.series
        weight = torch.cat([weight.expand(*series.shape[:-1], -1), series], dim=-1)
        t = (row - stretch.disc.centre) / stretch.disc.half
        features += [value[..., None, :] for value in chebyshev_values(t, series.shape[-1])]
    feature = features[0] if len(features) == 1 else torch.cat(features, dim=-2)
    # Complex numbers are pairs of real ones in memory: one real product serves both parts.
    found = torch.view_as_complex((weight @ torch.view_as_real(feature).flatten(-2)).unflatten(-1, (-1, 2)))
    shape = (left.shape[-2], right.shape[-2])
    return found.unflatten(-1, z.shape).unflatten(0, shape) if alike else found.movedim(-2, 0).unflatten(0, shape)


def chebyshev_series(a: Float[Tensor, "*batch n"], n_term: int) -> Float[Tensor, "*batch n n_term"]:
    """Coefficients of 1 / (a − t) in T_k(t), |a| > 1."""
    root = (a * a - 1).sqrt()
    order = torch.arange(n_term, device=a.device)
    series = (a.sign() / (a.abs() + root))[..., None] ** order * (2 * a.sign() / root)[..., None]
    return torch.where(order == 0, 0.5 * series, series)


def chebyshev_values(t: Complex[Tensor, "*batch"], n_term: int) -> list[Complex[Tensor, "*batch"]]:
    """T_0 … T_(n_term − 1) at t, by their recurrence."""
    values, twice = [torch.ones_like(t), t], 2 * t
    while len(values) < n_term:
        values.append(twice * values[-1] - values[-2])
    return values


def reciprocal(value: Complex[Tensor, "*batch"]) -> Complex[Tensor, "*batch"]:
    """1 / value in real arithmetic: several times as fast as torch's own."""
    size = value.real.square() + value.imag.square()
    return torch.complex(value.real / size, -value.imag / size)
