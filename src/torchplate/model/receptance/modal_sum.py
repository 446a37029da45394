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

from torchplate.plate import is_vmapped

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
        if is_vmapped(z, eigenvalue):
            return None
        parts = torch.view_as_real(z.detach()).flatten(0, -2)
        (low, down), (high, up) = (found.tolist() for found in (parts.amin(0), parts.amax(0)))
        highest = float(eigenvalue.detach().amax())
        # A single line has no width of its own.
        off = max(-down, up)
        return cls(0.5 * (low + high), max(0.5 * (high - low), WIDENED * off, 1e-3 * abs(high), 1e-9 * highest))


class Stretch(NamedTuple):
    """A disc, and what the modes are to it: those near it one by one, all others as a series."""

    disc: Disc | None  # None where nothing is known of z: then all modes are near
    first: int
    last: int  # beyond the last near one
    series: Float[Tensor, "*batch n n_term"] | None  # of each mode, zero of the near ones; None where all are near

    @classmethod
    def around(cls, disc: Disc | None, eigenvalue: Float[Tensor, "*batch n"], n_term: int = EXACT) -> "Stretch":
        """What the modes are to a disc, for some member near to it or for none.

        Args:
            disc: where z is expected.
            eigenvalue: λ, lowest first [rad²/s²].
            n_term: terms of the series.
        """
        n = eigenvalue.shape[-1]
        if disc is None:
            return cls(None, 0, n, None)
        held, reach = eigenvalue.detach(), 0.5 * (RHO + 1 / RHO) * disc.half
        first = int((held < disc.centre - reach).sum(-1).min())
        last = int((held <= disc.centre + reach).sum(-1).max())
        if n - (last - first) <= n_term:
            return cls(disc, 0, n, None)
        found = cls(disc, first, last, None)
        return found._replace(series=found.far(chebyshev_series(found.poles(eigenvalue), n_term) / disc.half))

    def poles(self, eigenvalue: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
        """Where far modes are, with the disc from −1 to 1; near ones have no series, and 2 stands in their place."""
        assert self.disc is not None
        a = (eigenvalue - self.disc.centre) / self.disc.half
        return torch.cat([a[..., : self.first], torch.full_like(self.near(a), 2.0), a[..., self.last :]], dim=-1)

    def near(self, of_mode: Tensor) -> Tensor:
        """Of what belongs to modes, along the last dimension, that of the near ones."""
        return of_mode[..., self.first : self.last]

    def far(self, series: Float[Tensor, "*batch n n_term"]) -> Float[Tensor, "*batch n n_term"]:
        """Series of all modes with those of near ones left out."""
        parts = series[..., : self.first, :], series[..., self.first : self.last, :], series[..., self.last :, :]
        return torch.cat([parts[0], torch.zeros_like(parts[1]), parts[2]], dim=-2)

    def slopes(self, eigenvalue: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n n_term"]:
        """The series' derivative in λ."""
        assert self.disc is not None
        assert self.series is not None
        a = self.poles(eigenvalue)[..., None]
        square, order = a * a - 1, torch.arange(self.series.shape[-1], device=a.device)
        return -self.series * (order * a.sign() / square.sqrt() + a / square) / self.disc.half

    def weights(self, pairs: Float[Tensor, "*batch n_pair n"]) -> Float[Tensor, "*batch n_pair n_feature"]:
        """What each feature counts for each pair of rows."""
        if self.series is None:
            return self.near(pairs)
        series = pairs @ self.series
        return torch.cat([self.near(pairs).expand(*series.shape[:-1], -1), series], dim=-1)

    def features(
        self, eigenvalue: Float[Tensor, "*#batch n"], z: Complex[Tensor, "*batch n_point"]
    ) -> Complex[Tensor, "*batch n_feature n_point"]:
        """1 / (λ − z) of near modes, then T_k of the series."""
        x, y = (part.contiguous()[..., None, :] for part in (z.real, z.imag))
        apart = self.near(eigenvalue)[..., None] - x
        scale = 1 / torch.addcmul(y * y, apart, apart)
        near = torch.complex(apart * scale, y * scale)
        if self.series is None or self.disc is None:
            return near
        values = chebyshev_values((z - self.disc.centre) / self.disc.half, self.series.shape[-1])
        return torch.cat([near, *(value[..., None, :] for value in values)], dim=-2)

    def sloped(self, weights: Float[Tensor, "*batch n_pair n_feature"]) -> Float[Tensor, "*batch n_pair n_feature"]:
        """Weights of features for `slope`: those of T_k times k."""
        order = torch.ones(weights.shape[-1], dtype=weights.dtype, device=weights.device)
        order[self.last - self.first :] = torch.arange(len(order) - (self.last - self.first))
        return weights * order

    def slope(
        self,
        feature: Complex[Tensor, "*batch n_feature n_point"],
        weight: Complex[Tensor, "*batch n_feature n_point"],
        z: Complex[Tensor, "*batch n_point"],
    ) -> Complex[Tensor, "*batch n_point"]:
        """The derivative in z of features, each times its weight, summed: 1 / (λ − z)² and T_k' = k U_(k−1).

        Args:
            feature: of `features`.
            weight: of each feature, from `sloped` ones: U_(k−1) already k times.
            z: where [rad²/s²].
        """
        n_near = self.last - self.first
        total = (feature[..., :n_near, :].square() * weight[..., :n_near, :]).sum(-2)
        if self.series is None or self.disc is None:
            return total
        # Clenshaw's recurrence.
        twice, last, before = (z - self.disc.centre) * (2 / self.disc.half), torch.zeros_like(z), torch.zeros_like(z)
        for own in reversed(weight[..., n_near + 1 :, :].unbind(-2)):
            last, before = torch.addcmul(own, twice, last) - before, last
        return total + last / self.disc.half


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
    stretch = stretch or Stretch.around(Disc.around(z, eigenvalue), eigenvalue)
    pairs = pairs_of(left, right)
    # Where all members have the same modes and rows, they are one long row of lines.
    alike = eigenvalue.ndim == 1 and pairs.ndim == 2
    row = z.reshape(-1) if alike else z
    found = times_complex(stretch.weights(pairs), stretch.features(eigenvalue, row))
    shape = (left.shape[-2], right.shape[-2])
    return found.unflatten(-1, z.shape).unflatten(0, shape) if alike else found.movedim(-2, 0).unflatten(0, shape)


def pairs_of(
    left: Float[Tensor, "*#batch n_left n"], right: Float[Tensor, "*#batch n_right n"]
) -> Float[Tensor, "*batch n_pair n"]:
    """Products of all rows with all columns, mode by mode."""
    return (left[..., :, None, :] * right[..., None, :, :]).flatten(-3, -2)


def as_real(value: Complex[Tensor, "*batch n"]) -> Float[Tensor, "*batch 2*n"]:
    """Complex numbers as the pairs of real ones that they are in memory: one real product then serves both parts."""
    return torch.view_as_real(value).flatten(-2)


def times_complex(
    matrix: Float[Tensor, "*#batch n_row n"], value: Complex[Tensor, "*#batch n n_point"]
) -> Complex[Tensor, "*batch n_row n_point"]:
    """A real matrix times a complex one."""
    return as_complex(matrix @ as_real(value))


def as_complex(value: Float[Tensor, "*batch n_part"]) -> Complex[Tensor, "*batch n"]:
    """Pairs of real numbers as the complex ones that they are."""
    return torch.view_as_complex(value.unflatten(-1, (-1, 2)))


def chebyshev_series(a: Float[Tensor, "*batch n"], n_term: int) -> Float[Tensor, "*batch n n_term"]:
    """Coefficients of 1 / (a − t) in T_k(t), |a| > 1."""
    root = (a * a - 1).sqrt()
    ratio, first = a.sign() / (a.abs() + root), a.sign() / root
    # Powers one from the other: several times as fast as each by itself.
    later = (2 * first)[..., None] * ratio[..., None].expand(*a.shape, n_term - 1).cumprod(-1)
    return torch.cat([first[..., None], later], dim=-1)


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
