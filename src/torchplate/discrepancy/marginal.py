"""The likelihood of FRFs with the nuisances integrated out.

y = H(θ) + J ν + e, e ~ N(0, κ² D) with D diagonal, ν ~ N(0, S), S = diag(s_g²) for the groups g of nuisances; so

    y − H ~ N(0, κ² D + J S Jᵀ).

About levels ℓ of the FRFs that were found, y = ℓ (H + J ν) + e: residuals are those of y / ℓ, whose noise is D / ℓ².

Residuals are taken over √D first. With G = JᵀJ, c = Jᵀr and K = S^½ G S^½ / κ², the likelihood is

    −2 ln p = n ln κ² + rᵀr / κ² + ln |I + K| − (S^½c/κ²)ᵀ (I + K)⁻¹ (S^½c),

and the posterior mean of S^−½ ν is (I + K)⁻¹ S^½ c / κ². κ and the s_g are estimated with it: each has a prior, a
scaled inverse χ² about 1 whose degrees of freedom say how well it is known, and MacKay's fixed point finds where
likelihood times prior is largest.

Sources: MacKay, Bayesian interpolation, Neural Computation 4 (1992) 415, for the fixed point; Rasmussen and Williams,
Gaussian Processes for Machine Learning (2006), appendix A, for the determinant and the inverse; Pinheiro and Bates,
Mixed-Effects Models (2000), for marginal likelihoods of nuisance effects.
"""

import copy
import functools
import math
from collections.abc import Mapping

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.discrepancy.columns import Columns
from torchplate.discrepancy.judged import Judged, Knowledge
from torchplate.discrepancy.nuisance import FREE, Nuisances, real_columns
from torchplate.discrepancy.specimen import Found, OfChannels

# Fixed points are at rest where no scale changes by more than this part; and after so many turns in any case.
AT_REST, N_TURN = 1e-3, 60
# Rows that are whitened at a time.
AT_ONCE = 16
# Relative rounding of a number.
ROUNDING = torch.finfo(torch.float64).eps


class Marginal:
    """Noise and nuisances of some FRFs, fixed; residuals come and go.

    Args:
        variance: D, of the real and of the imaginary part.
        nuisances: J.
        fitted: FRFs that count.
        freedom: of the prior of each group's scale; infinite where it is known exactly.
        knowledge: of the noise.
        scale: what each group is times what was said of it, where residuals are whitened; 1 where it is left out.
        about: how far off the specimen is whose residuals come; None where it is not.
        beside: variance, what the second order of nuisances adds among it; None where that is as it is here.
        put_in: of the last of the nuisances that all FRFs share, the values about which residuals are taken; None
            where they are taken about 0.
    """

    def __init__(
        self,
        variance: Float[Tensor, "n_frequency n_response n_reference"],
        nuisances: Nuisances | None,
        fitted: Bool[Tensor, "n_response n_reference"],
        freedom: Mapping[str, float],
        knowledge: Knowledge,
        scale: Mapping[str, float] | None = None,
        about: Found | None = None,
        beside: Float[Tensor, "n_frequency n_response n_reference"] | None = None,
        put_in: Float[Tensor, " k"] | None = None,
    ) -> None:
        self._given, self._nuisances = (variance, nuisances, fitted), nuisances
        self.about, self._put_in = about, put_in
        self.second = None if nuisances is None else nuisances.second_order
        self._n_off = 0 if nuisances is None else nuisances.n_off
        self.scale = dict(scale or {})
        self._second_order = 0.0
        # Levels that were found are taken off what was measured, noise and all: ln p is that of what was measured.
        of_level = self._power_of_levels(variance)
        variance = variance / of_level
        plain = variance
        if beside is not None:
            variance = beside / of_level
        elif nuisances is not None:
            variance = variance + nuisances.second_order.variance(self.scale)
        if nuisances is not None:
            self._second_order = float((1 - plain / variance)[:, fitted].mean())
        self.variance = variance * of_level
        self.weight = self._weight_of_columns = torch.where(fitted, variance.rsqrt(), 0.0)
        self.n = 2.0 * len(variance) * int(fitted.sum())
        self._log_variance = 2 * float(self.variance[:, fitted].log().sum())
        self.freedom, self.knowledge = freedom, knowledge
        # 1 / √D of each number.
        self._over = self.weight[..., None].expand(*self.weight.shape, 2).flatten()
        self._columns = Columns(nuisances, self.weight)
        n_response, n_reference = self._columns.n_response, self._columns.n_reference
        names: list[str] = []
        if nuisances is not None:
            names += nuisances.group[0]
            names += list(nuisances.group[1]) * n_response
            names += list(nuisances.group[2]) * n_reference
        self.names = tuple(dict.fromkeys(names))
        self.group = torch.tensor([self.names.index(name) for name in names], dtype=torch.int64)
        k, k_own, k_other = self._columns.n_common, self._columns.n_own, self._columns.n_other
        of_own = k + torch.arange(n_response * k_own).reshape(n_response, k_own)
        of_other = k + k_own * n_response + torch.arange(n_reference * k_other).reshape(n_reference, k_other)
        carried = {} if nuisances is None else nuisances.carried
        for index, begin in carried.items():
            # A response whose mass moves with it has its place among the common ones, all of x before all of y.
            of_own[index, :2] = begin + len(carried) * torch.arange(2)
        self._channel = (of_own, of_other)
        support = () if nuisances is None else nuisances.support
        self._support = torch.tensor(support, dtype=torch.int64).reshape(len(support), 2)

    @functools.cached_property
    def gram(self) -> Float[Tensor, "n_nuisance n_nuisance"]:
        """JᵀD⁻¹J."""
        return self._columns.gram(self._weight_of_columns)

    @functools.cached_property
    def _half(self) -> Float[Tensor, "n_nuisance n_nuisance"]:
        """W of `_whitener`, nuisances as large as was said."""
        return self._whitener(self._said())

    @property
    def nbytes(self) -> int:
        """What its columns take of memory."""
        return self._columns.nbytes

    def _power_of_levels(self, like: Tensor) -> Float[Tensor, "n_response n_reference"]:
        """Squares of the levels of each FRF about which residuals are taken."""
        one = like.new_ones(like.shape[1:])
        if self.about is None or self.about.channels is None:
            return one
        return one * self.about.channels.level_of_pairs().square().clamp(min=1e-12)

    def with_variance(self, variance: Float[Tensor, "n_frequency n_response n_reference"]) -> "Marginal":
        """The same beside another variance of what was measured, what the second order of nuisances adds among it."""
        return Marginal(*self._given, self.freedom, self.knowledge, self.scale, self.about, variance, self._put_in)

    def rescaled(self, scale: Mapping[str, float]) -> "Marginal":
        """The same with nuisances of another size."""
        if dict(scale) == self.scale:
            return self
        return Marginal(*self._given, self.freedom, self.knowledge, scale, self.about, put_in=self._put_in)

    def taken_about(self, about: Found | None, put_in: Float[Tensor, " k"] | None) -> "Marginal":
        """The same columns for residuals that are taken about other values: right to first order in what these move.

        Args:
            about: how far off the specimen is whose residuals come.
            put_in: of the last of the nuisances that all FRFs share.
        """
        # The products of its columns are made once for all of these.
        assert len(self.gram) == len(self.group)
        twin = copy.copy(self)
        for name in ("_values", "_back", "_is_put_in"):
            vars(twin).pop(name, None)
        twin.about, twin._put_in = about, put_in
        # Columns stay those of the levels they were taken about, and residuals are of what was measured.
        of_level = twin._power_of_levels(self.variance).sqrt() / self._power_of_levels(self.variance).sqrt()
        twin.weight = self.weight * of_level
        return twin

    def beside(
        self,
        columns: Complex[Tensor, "n_frequency n_response n_reference k"],
        name: str,
        put_in: Float[Tensor, " n_last"] | None = None,
    ) -> "Marginal":
        """The same with further nuisances that all FRFs share, whose size is known exactly.

        Args:
            columns: changes of the FRFs by one standard deviation each, about what is put in.
            name: of their group.
            put_in: values of the last of these in the model whose residuals come; None for 0.
        """
        variance, found, fitted = self._given
        if found is None:
            return self
        more = real_columns(columns.unbind(-1), columns[..., 0]).to(found.common)
        common = torch.cat([found.common, more], dim=-1)
        group = ((*found.group[0], *(name,) * columns.shape[-1]), *found.group[1:])
        found = found._replace(common=common, group=group)
        freedom = {**self.freedom, name: math.inf}
        return Marginal(variance, found, fitted, freedom, self.knowledge, self.scale, self.about, put_in=put_in)

    def along(self, residual: Float[Tensor, "*batch n_residual"]) -> Float[Tensor, "*batch n_nuisance"]:
        """Jᵀ r."""
        return self._columns.along(residual * self._over)

    def across(self, value: Float[Tensor, "*batch n_nuisance"]) -> Float[Tensor, "*batch n_residual"]:
        """J ν."""
        return self._columns.across(value).mul_(self._over)

    def over_noise(self, off: Complex[Tensor, "*batch n_frequency n_response n_reference"]) -> Tensor:
        """Residuals over √D, as real numbers; zero where an FRF does not count."""
        return torch.view_as_real((off * self.weight).resolve_conj()).flatten(-4)

    def residual(self, off: Complex[Tensor, "*batch n_frequency n_response n_reference"]) -> Tensor:
        """Those of a specimen, as if it were none: what it was taken about is put back."""
        found = self.over_noise(off)
        return found if self.about is None and self._put_in is None else found + self._back

    @functools.cached_property
    def _back(self) -> Float[Tensor, " n_residual"]:
        """What the specimen, the channels and what was put in make of the residuals, about which these were taken."""
        return self.across(self._values)

    @functools.cached_property
    def _values(self) -> Float[Tensor, " n_nuisance"]:
        """Of each nuisance, about which the residuals were taken."""
        value = self.weight.new_zeros(len(self.group))
        if self._put_in is not None:
            n_common = self._columns.n_common
            value[n_common - len(self._put_in) : n_common] = self._put_in.to(value)
        if self.about is not None:
            value[: self._n_off] = self.about.shift
        if self.about is not None and self.about.channels is not None:
            for index, one in zip(self._channel, self.about.channels[:2], strict=True):
                value[index] = one.to(value)
            value[self._support] = self.about.channels.supports(len(self._support)).to(value)
        return value

    def channels(self, residual: Float[Tensor, " n_residual"]) -> OfChannels | None:
        """What residuals say of each channel, nuisances as large as was said.

        Where more than noise is left, channels are known no better than beside as much noise.
        """
        if self._nuisances is None:
            return None
        root = self._root(torch.tensor([self.scale.get(name, 1.0) for name in self.names], dtype=torch.float64))
        along = self.along(residual)
        inverse = torch.cholesky_inverse(self._lower(root, 1.0))
        mean = inverse @ (root * along)
        left = (float(residual.square().sum()) - float(mean @ (root * along))) / max(1.0, self.n)
        if left > 1:
            inverse = torch.cholesky_inverse(self._lower(root, left))
        return self._of_channels(root * mean, root, inverse)

    def held(self, off: Complex[Tensor, "n_frequency n_response n_reference"]) -> float:
        """−2 ln p of residuals and of what was put in, channels among it, together.

        What was put in need not be linear; all other nuisances are integrated out, as large as was said. The most
        probable is where this is lowest.

        Args:
            off: residuals about what was put in.
        """
        said, found = self._said(), self.over_noise(off)
        lower = self._lower(torch.where(self._is_put_in, 0.0, said), 1.0)
        along = torch.where(self._is_put_in, 0.0, said * self.along(found))
        half = torch.linalg.solve_triangular(lower, along[:, None], upper=False)
        told = (self._values / said)[self._is_put_in].square().sum()
        determinant = 2 * float(lower.diagonal().log().sum()) + self._log_variance
        return float(found.square().sum() + told - half.square().sum()) + determinant

    def towards(
        self, off: Complex[Tensor, "n_frequency n_response n_reference"], damping: float
    ) -> tuple[Float[Tensor, " k"], OfChannels | None]:
        """What to put in after one of Levenberg's steps towards what residuals say of it, and of the channels.

        Args:
            off: residuals about what was put in.
            damping: in units of what was known beforehand [-]; 0 for the whole step.
        """
        said, at = self._said(), self._is_put_in
        inverse = torch.cholesky_inverse(self._lower(said, 1.0))
        mean = inverse @ (said * self.along(self.residual(off)))
        precision = torch.linalg.inv(inverse[at][:, at])
        step = precision @ (mean - self._values / said)[at]
        step = torch.linalg.solve(precision + damping * torch.eye(len(step)).to(step), step)
        value = self._values.clone()
        value[at] += said[at] * step
        n_common, n_put_in = self._columns.n_common, 0 if self._put_in is None else len(self._put_in)
        return value[n_common - n_put_in : n_common], self._of_channels(value, said, inverse)

    @functools.cached_property
    def _is_put_in(self) -> Bool[Tensor, " n_nuisance"]:
        found = torch.zeros(len(self.group), dtype=torch.bool)
        if self._put_in is not None:
            n_common = self._columns.n_common
            found[n_common - len(self._put_in) : n_common] = True
        if self.about is not None and self.about.channels is not None:
            for index in self._channel:
                found[index] = True
            if self.about.channels.support is not None:
                found[self._support] = True
        return found

    def _said(self) -> Float[Tensor, " n_nuisance"]:
        """Of each nuisance, how many times what one standard deviation makes of it its group is taken for."""
        return self._root(torch.tensor([self.scale.get(name, 1.0) for name in self.names], dtype=torch.float64))

    def misfit(
        self,
        off: Complex[Tensor, "n_frequency n_response n_reference"],
        channels: OfChannels | None,
        farthest: float = math.inf,
        drift: bool = True,
    ) -> float:
        """−2 ln p of residuals and of the channels that these were taken about, but for what hangs on no residual.

        What a channel has of its own is as it was put in, and not linear; all other nuisances are integrated out, with
        drifts that cannot be taken off what was measured.

        Args:
            off: residuals about these channels, at their levels.
            channels: what each has of its own; None where they are as they are meant.
            farthest: standard deviations from which on it is linear still: it may be farther than it was put in.
            drift: whether that of the records was taken off what was measured.
        """
        level = self.weight.new_ones(1, 1) if channels is None else channels.level_of_pairs()
        if self.about is not None and self.about.channels is not None:
            level = level / self.about.channels.level_of_pairs()
        found = self.over_noise(off * level)
        if self._nuisances is None or not len(self.group):
            return float(found.square().sum())
        root = self._root(torch.tensor([self.scale.get(name, 1.0) for name in self.names], dtype=torch.float64))
        linear, at = torch.ones_like(root, dtype=torch.bool), torch.zeros_like(root)
        sides = self._nuisances.of_response, self._nuisances.of_reference
        for side, (index, names) in enumerate(zip(self._channel, sides, strict=True)):
            linear[index] = torch.tensor([name == "drift" and not drift for name in names], dtype=torch.bool)
            if channels is not None:
                low, high = channels.limits(farthest)[side]
                own = channels.reference if side else channels.response
                at[index] = own.to(at)
                linear[index] |= (own <= low) | (own >= high)
        if channels is None or channels.support is not None:
            own = at.new_zeros(len(self._support), 2) if channels is None else channels.supports(len(self._support))
            at[self._support], linear[self._support] = own.to(at), own.abs() >= farthest
        found = found + self.across(torch.where(linear, at, 0.0))
        known = (torch.where(linear, 0.0, at) / root.clamp(min=1e-12)).square().sum()
        root = torch.where(linear, root, 0.0)
        half = torch.linalg.solve_triangular(self._lower(root, 1.0), (root * self.along(found))[:, None], upper=False)
        return float(found.square().sum() + known - half.square().sum())

    def _of_channels(self, shift: Tensor, root: Tensor, inverse: Tensor) -> OfChannels | None:
        """Of nuisances and their posterior covariance."""
        j = self._nuisances
        if j is None:
            return None
        left = root * inverse.diagonal().clamp(min=0).sqrt()
        own, other = self._channel
        support = shift[self._support] if len(self._support) else None
        return OfChannels(
            shift[own], shift[other], left[own], left[other], j.of_response, j.of_reference, j.level, j.drift, support,
            j.of_support,
        )  # fmt: skip

    def whitened(self, residual: Float[Tensor, "*batch n_residual"]) -> Float[Tensor, "*batch n_residual"]:
        """(D + J S Jᵀ)^−½ of residuals over √D, with noise as large as was said."""
        if not len(self.group):
            return residual
        rows = residual.reshape(-1, residual.shape[-1])
        found = torch.empty_like(rows)
        # Some rows at a time: what is taken off need not be held beside all of them.
        for begin in range(0, len(rows), AT_ONCE):
            some = rows[begin : begin + AT_ONCE]
            found[begin : begin + AT_ONCE] = some - self.across(self.along(some) @ self._half)
        return found.reshape(residual.shape)

    def hidden(self, residual: Float[Tensor, "*batch n_residual"]) -> Float[Tensor, "*batch"]:
        """What whitening takes off the sums of squares of residuals over √D."""
        if not len(self.group):
            return torch.zeros_like(residual[..., 0])
        root = self._root(torch.tensor([self.scale.get(name, 1.0) for name in self.names], dtype=torch.float64))
        half = torch.linalg.solve_triangular(self._lower(root, 1.0), (self.along(residual) * root).mT, upper=False)
        return half.square().sum(-2)

    def precision(self, rows: Float[Tensor, "n n_residual"], judged: Judged) -> Float[Tensor, "n n"]:
        """Products of rows over √D with the inverse of the covariance between them, at the scales of a judgement."""
        noise = judged.noise_scale**2
        found = rows @ rows.mT / noise
        if not len(self.group):
            return found
        root = self._root(torch.tensor([judged.scale[name] for name in self.names], dtype=torch.float64))
        lower = self._lower(root, noise)
        half = torch.linalg.solve_triangular(lower, (self.along(rows) * root / noise).mT, upper=False)
        return found - half.mT @ half

    def power(self) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Expected |y − H|², noise and nuisances as large as was said; 0 where an FRF does not count.

        What is free is not expected to be of any size.
        """
        weight, found = self.weight.square(), self._columns.power()
        if self._nuisances is not None and FREE in self._nuisances.group[0]:
            free = torch.tensor([name == FREE for name in self._nuisances.group[0]])
            found = found - self._nuisances.common[..., free].square().sum((-2, -1))
        return torch.where(weight > 0, found.clamp(min=0) + 2 / weight.clamp(min=1e-300), 0.0)

    def _root(self, scale: Float[Tensor, " n_group"]) -> Float[Tensor, " n_nuisance"]:
        return scale[self.group] if len(self.group) else scale

    def _lower(self, root: Float[Tensor, " n_nuisance"], noise: float) -> Float[Tensor, "n_nuisance n_nuisance"]:
        """Cholesky's factor of I + K."""
        scaled = root[:, None] * self.gram * root / noise
        # Where one nuisance shows 10⁸ times as far as the noise, rounding of its square is as large as I.
        rounding = ROUNDING * float(scaled.diagonal().max()) * len(root)
        return torch.linalg.cholesky(scaled + (1 + rounding) * torch.eye(len(root)).to(scaled))

    def _whitener(self, root: Tensor) -> Tensor:
        """W with (I + J S Jᵀ)^−½ = I − J W Jᵀ."""
        if not len(root):
            return self.gram
        scaled = root[:, None] * self.gram * root
        value, vector = torch.linalg.eigh(0.5 * (scaled + scaled.mT))
        value = value.clamp(min=0.0)
        # (1 − (1 + λ)^−½) / λ without the difference of nearly equal numbers.
        lifted = (1 + value).sqrt()
        part = 1 / (lifted * (1 + lifted))
        return root[:, None] * ((vector * part) @ vector.mT) * root

    def judge(self, residual: Float[Tensor, " n_residual"]) -> Judged:
        """The likelihood at the scales at which it and their priors are largest."""
        square = float(residual.square().sum())
        white = float(self.whitened(residual).square().sum()) / max(1.0, self.n)
        n_group = len(self.names)
        scale = torch.tensor([self.scale.get(name, 1.0) for name in self.names], dtype=torch.float64)
        free = torch.tensor([self.freedom.get(name, self.knowledge.untold) for name in self.names])
        fixed = free.isinf()
        # κ can be far from 1: it starts where it would be without nuisances at the scales they have.
        noise = max(white, 1e-12)
        size = torch.zeros(n_group, dtype=torch.float64)
        mean = residual.new_zeros(len(self.group))
        inverse = torch.eye(len(mean)).to(mean)
        if n_group:
            along = self.along(residual)
            for _ in range(N_TURN):
                root = self._root(scale)
                lower = self._lower(root, noise)
                inverse = torch.cholesky_inverse(lower)
                mean = inverse @ (root * along / noise)
                # What the data say of each nuisance: 1 where they say all, 0 where only its prior does.
                known = 1 - inverse.diagonal()
                told = torch.zeros(n_group, dtype=torch.float64)
                size.zero_()
                told.index_add_(0, self.group, known)
                size.index_add_(0, self.group, mean.square())
                factor = torch.where(
                    fixed, 1.0, ((size * scale.square() + free) / (told + free)).nan_to_num(1.0).sqrt() / scale
                )
                shift = root * mean
                left = square - 2 * float(shift @ along) + float(shift @ (self.gram @ shift))
                k = self.knowledge.noise
                after = (left + k) / (max(self.n - float(known.sum()), 1.0) + k)
                change = max(float((factor - 1).abs().max()), abs(after / noise - 1))
                scale, noise = scale * factor.clamp(0.5, 2.0), after
                if change < AT_REST:
                    break
        else:
            noise = max(1e-12, (square + self.knowledge.noise) / max(1.0, self.n + self.knowledge.noise))
        cost = self._cost(square, self.along(residual) if n_group else mean, scale, noise)
        free = torch.where(fixed, 0.0, free)
        prior = float((free * (scale.square().log() + 1 / scale.square() - 1)).sum())
        prior += self.knowledge.noise * (math.log(noise) + 1 / noise - 1)
        scales = dict(zip(self.names, scale.tolist(), strict=True))
        root = self._root(scale)
        shift, k = mean * root, self._n_off
        channels = self._of_channels(shift, root, inverse)
        names = tuple(self.names[index] for index in self.group[:k].tolist())
        found = Found(shift[:k], (root[:, None] * inverse * root)[:k, :k], channels, names) if k else None
        data = self._cost_of_data(residual, shift, noise)
        complexity = cost + prior - data
        return Judged(
            cost + prior, math.sqrt(noise), scales, white, self.n, shift, self._second_order, found, complexity
        )

    def cost(self, residual: Float[Tensor, " n_residual"]) -> float:
        """−2 ln p but for n ln 2π, noise and nuisances as large as was said."""
        scale = torch.tensor([self.scale.get(name, 1.0) for name in self.names], dtype=torch.float64)
        along = self.along(residual) if len(self.names) else residual.new_zeros(0)
        return self._cost(float(residual.square().sum()), along, scale, 1.0)

    def _cost_of_data(self, residual: Tensor, shift: Tensor, noise: float) -> float:
        """The part of −2 ln p that the data have beside the nuisances as they were found, the rest being their own."""
        left = residual - self.across(shift) if len(self.group) else residual
        return self.n * math.log(noise) + float(left.square().sum()) / noise + self._log_variance

    def _cost(self, square: float, along: Tensor, scale: Tensor, noise: float) -> float:
        """−2 ln p but for n ln 2π."""
        found = self.n * math.log(noise) + square / noise + self._log_variance
        if not len(along):
            return found
        root = self._root(scale)
        lower = self._lower(root, noise)
        half = torch.linalg.solve_triangular(lower, (root * along / noise)[:, None], upper=False)
        return found + 2 * float(lower.diagonal().log().sum()) - float(half.square().sum())
