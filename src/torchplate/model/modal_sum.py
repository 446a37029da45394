"""The sum over modes, and what is attached to it.

With damping in proportion to K and M, Z(s) = κ (K − z M), z = −μ/κ, and the receptance is 1/κ times

    G(z) = Σ_r φ_r φ_rᵀ / (λ_r − z),

a function of one complex number near the real axis. For a block of lines, the modes near it are summed one by one. All
others together vary slowly with z there, and each is a Chebyshev series that is known in closed form:
1 / (a − t) = 2 / √(a² − 1) · Σ' ρ⁻ᵏ T_k(t), ρ = a + √(a² − 1) (Mason and Handscomb, Chebyshev Polynomials, 2003,
section 5.2). So most modes cost nothing for each line, and none is left out.

Springs, dashpots and masses at places, of dynamic stiffness D, are attached one after the other,

    G ← G − g D / (1 + g_uu D) gᵀ,    g = G u,

(Sherman and Morrison, Annals of Mathematical Statistics 21 (1950) 124; in dynamics the receptance coupling of Bishop
and Johnson, The Mechanics of Vibration, 1960).

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
# Terms that leave 2e-5, which is 1e-6 of the FRF where peaks outweigh what is far from them; and terms that leave no
# more than rounding: what a member gets then does not depend on who stands beside it in the batch.
CLOSE, EXACT = 10, 32
# Lines that go together on a CPU, and members: what is made of them stays in the cache, and is the same in any batch.
LINES_AT_ONCE = 160
MEMBERS_AT_ONCE = 64
# How far z may leave a disc that was made for it: the series hardly notices.
SLACK = 1.01


class Disc(NamedTuple):
    """A stretch of the real axis, and so much beside it, that z is in [rad²/s²]."""

    centre: float
    half: float

    @classmethod
    def around(cls, z: Complex[Tensor, "*batch"], eigenvalue: Float[Tensor, "*more"]) -> "Disc | None":
        """The one that holds all z; None under `vmap`, where nobody may look."""
        try:
            x, y, highest = z.detach().real, z.detach().imag, float(eigenvalue.detach().amax())
            low, high, off = float(x.amin()), float(x.amax()), float(y.abs().amax())
        except RuntimeError:
            return None
        # A single line has no width of its own.
        return cls(0.5 * (low + high), max(0.5 * (high - low), WIDENED * off, 1e-3 * abs(high), 1e-9 * highest))

    def holds(self, other: "Disc | None") -> bool:
        """Whether it holds another; one that may not be looked at it does not."""
        return other is not None and abs(other.centre - self.centre) + other.half <= SLACK * self.half


def modal_sum(
    eigenvalue: Float[Tensor, "*#batch n"],
    left: Float[Tensor, "*#batch n_left n"],
    right: Float[Tensor, "*#batch n_right n"],
    z: Complex[Tensor, "*batch n_frequency"],
    disc: Disc | None = None,
    n_term: int = EXACT,
) -> Complex[Tensor, "n_left n_right *batch n_frequency"]:
    """Σ left right / (λ − z), one real matrix product.

    Args:
        eigenvalue: λ, lowest first [rad²/s²].
        left: modal deflections of the rows [1/√kg].
        right: of the columns.
        z: −μ/κ [rad²/s²].
        disc: where z is expected; if it is not, or none is given, that of z itself.
        n_term: terms of the series.
    """
    n, own = eigenvalue.shape[-1], Disc.around(z, eigenvalue)
    # Under `vmap` every mode is summed one by one: nothing is known of z.
    disc = disc if disc is not None and disc.holds(own) else own
    first, last = (0, n) if disc is None else _near(eigenvalue.detach(), *disc)
    if n - (last - first) <= n_term:
        first, last = 0, n
    pairs = (left[..., :, None, :] * right[..., None, :, :]).flatten(-3, -2)
    # Where all members have the same modes and rows, they are one long row of lines.
    alike = eigenvalue.ndim == 1 and pairs.ndim == 2
    row = z.reshape(-1) if alike else z
    apart = eigenvalue[..., first:last, None] - row.real[..., None, :]
    y = row.imag[..., None, :]
    scale = 1 / torch.addcmul(y * y, apart, apart)
    features, weight = torch.complex(apart * scale, y * scale), pairs[..., first:last]
    if disc is not None and last - first < n:
        centre, half = disc
        far = [torch.cat([part[..., :first], part[..., last:]], dim=-1) for part in (eigenvalue, pairs)]
        series = far[1] @ chebyshev_series((far[0] - centre) / half, n_term) / half
        weight = torch.cat([weight.expand(*series.shape[:-1], -1), series], dim=-1)
        slow = torch.stack(chebyshev_values((row - centre) / half, n_term), dim=-2)
        features = torch.cat([features, slow], dim=-2)
    # Complex numbers are pairs of real ones in memory: one real product serves both parts.
    found = torch.view_as_complex((weight @ torch.view_as_real(features).flatten(-2)).unflatten(-1, (-1, 2)))
    shape = (left.shape[-2], right.shape[-2])
    return found.unflatten(-1, z.shape).unflatten(0, shape) if alike else found.movedim(-2, 0).unflatten(0, shape)


def attach(
    found: Complex[Tensor, "n_left n_right *batch n_frequency"],
    stiffness: Complex[Tensor, "n_term *#batch n_frequency"],
) -> Complex[Tensor, "n_response n_reference *batch n_frequency"]:
    """G with terms attached, their rows left out.

    Args:
        found: G between the terms, then the responses; and the terms, then the references.
        stiffness: D of each term, in the units of 1 / G.
    """
    for force in stiffness:
        # Split, not sliced: the backward of a slice fills the rest with zeros.
        top, bottom = found.split((1, len(found) - 1))
        (own, row), (column, rest) = (part.split((1, part.shape[1] - 1), dim=1) for part in (top, bottom))
        found = torch.addcmul(rest, column, row * (force / (1 + force * own)), value=-1)
    return found


def terms_first(value: Float[Tensor, "*batch n_term"], n_batch: int) -> Float[Tensor, "n_term *more 1"]:
    """Coefficients of terms as `attach` takes them, also where all members of the batch have the same ones."""
    return value.expand(*(1,) * (n_batch + 1 - value.ndim), *value.shape).movedim(-1, 0)[..., None]


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


def _near(eigenvalue: Tensor, centre: float, half: float) -> tuple[int, int]:
    """The modes, first and beyond the last, that have to be summed one by one for some member."""
    reach = 0.5 * (RHO + 1 / RHO) * half
    below, within = (eigenvalue < centre - reach).sum(-1), (eigenvalue <= centre + reach).sum(-1)
    return int(below.min()), int(within.max())
