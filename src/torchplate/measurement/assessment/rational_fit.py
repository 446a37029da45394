"""FRFs as rational functions of frequency whose poles are common to all: what is signal, and what is left.

H(f) = Σ_r R_r / (q_r − f²) + a polynomial, with free complex residues R_r for each FRF. The poles follow by variable
projection, new ones are added where the residual stands out, and what a local mean still finds in the residual is taken
away. Because the poles are fitted as poles, a peak narrower than the line spacing costs two numbers and leaves no error
behind, where a polynomial through its neighbours fails.

Sources: Golub and Pereyra, "Separable nonlinear least squares", Inverse Problems 19 (2003); Kaufman, BIT 15 (1975), for
the Jacobian; McKelvey and Guérin, "Non-parametric frequency response estimation using a local rational model", IFAC
SYSID (2012).
"""

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.measurement.assessment.regression import (
    expected_square,
    likeliest,
    likelihood_cost,
    regressed,
    times_expected,
)

# The smooth part of an FRF over the band: modes outside it, a delay.
N_SMOOTH: Final = 6
# Lines of the local mean that is taken from the residual.
N_LOCAL: Final = 15
# Rounds in which poles may be added, and Gauss-Newton steps after each.
N_ROUND: Final = 8
N_STEP: Final = 12
# A line is worth a pole where its squares are above their expectation by this more than noise gets.
EXCESS: Final = 0.3
# A line of which the fit leaves less than this says nothing of the noise.
LEFT: Final = 0.02
# What another course of a sensor's floor must lower twice the negative log-likelihood by: one of three, for certain.
CERTAIN: Final = 20.0
# Lines that stand out alone by chance, at most: each round lets one do so in twenty tests.
BY_CHANCE: Final = 2
# Where a new pole goes, in line spacings from its line; and the part of its width within which one is there already.
BESIDE: Final = (0.0, 0.4, -0.4)
ALIKE: Final = 0.01
# A pole is this part of the line spacing wide at least: what is narrower is any width to the lines.
NARROWEST: Final = 1e-4
# Lines for each pole at least, where there are plenty; and where there are not: two thirds still tell the noise.
PER_POLE: Final = 6
FEWEST: Final = 3


class _Basis(NamedTuple):
    """An orthonormal basis of the weighted partial fractions, and the derivatives by the poles outside its span."""

    q: Complex[Tensor, "n_line n_basis"]
    upper: Complex[Tensor, "n_basis n_basis"]
    slope: Complex[Tensor, "n_line n_pole"]
    norm: Float[Tensor, " n_pole"]


class RationalFit:
    """Poles common to all FRFs, free residues, and the noise that is left; FRFs come with a root mean square of 1."""

    def __init__(self, frequency: Tensor, frf: Tensor, flat: Tensor | None = None, per_pole: int = PER_POLE) -> None:
        self.frequency, self.frf, self.per_pole = frequency, frf, per_pole
        self.flat = (torch.ones_like(frequency) if flat is None else flat)[:, None]
        self.step = float((frequency[-1] - frequency[0]) / (len(frequency) - 1))
        middle = 0.5 * (frequency[0] + frequency[-1])
        scaled = (frequency - middle) / (0.5 * (frequency[-1] - frequency[0]))
        angle = scaled.clamp(-1.0, 1.0).arccos()
        # Chebyshev polynomials: cos(k arccos x).
        self.polynomial = (torch.arange(N_SMOOTH).to(frequency) * angle[:, None]).cos().to(frf)
        self.power = frf.abs().square()
        self.level = self._first_level()
        self.pole = frf.new_zeros(0)
        self.n_own = 0

    @classmethod
    def of(
        cls,
        frequency: Float[Tensor, " n_line"],
        frf: Complex[Tensor, "n_line n_frf"],
        flat: Float[Tensor, " n_line"] | None = None,
        per_pole: int = PER_POLE,
    ) -> "RationalFit":
        """The fit with all poles that the lines show, beside a sensor's floor of this course; flat where left out."""
        fit = cls(frequency, frf, flat, per_pole)
        fit.weigh()
        fit.add(fit._first_lines())
        for _ in range(N_ROUND):
            fit.settle(N_STEP)
            fit.estimate()
            if not fit.add(fit.outstanding()):
                break
        fit.settle(N_STEP)
        fit.estimate()
        fit.weigh()
        fit.settle(N_STEP)
        fit.estimate(final=True)
        if per_pole > FEWEST and not fit._room():
            # More resonances than there is room for: what they leave is no noise.
            return cls.of(frequency, frf, flat, FEWEST)
        return fit

    @classmethod
    def likeliest(
        cls,
        frequency: Float[Tensor, " n_line"],
        frf: Complex[Tensor, "n_line n_frf"],
        floors: Mapping[str, Float[Tensor, " n_line"]],
    ) -> tuple["RationalFit", str]:
        """The fit beside the course of a sensor's floor that is likeliest, and the motion in which that is flat.

        Beside a wrong course poles take on the noise where there is more of it than expected, and what is left has the
        course that was expected: where lines stand out alone all courses are tried, and each pole has its price.

        Args:
            frequency: lines [Hz].
            frf: of root mean square 1.
            floors: courses beside a flat one that it may have, by motion.
        """
        fit = cls.of(frequency, frf)
        alone = int((~fit.has_width).sum()) > BY_CHANCE
        best = fit, ""
        for motion in floors if alone else {fit.flattest(floors)} - {""}:
            other = cls.of(frequency, frf, floors[motion])
            if other.price() + CERTAIN < best[0].price():
                best = other, motion
        return best

    def price(self) -> float:
        """−2 ln of the likelihood beside the noise found, and its numbers' cost (Bayesian information criterion)."""
        sensor, signal = self.level.unbind(-1)
        smooth = self.smooth
        variance = (sensor * self.flat + signal * smooth.abs().square()).clamp(min=1e-300)
        left = (self.frf - smooth).abs().square()
        n_line, n_frf = self.frf.shape
        n_number = 2 * len(self.pole) + 2 * n_frf * (len(self.pole) + N_SMOOTH)
        return float(2 * (variance.log() + left / variance).sum()) + n_number * math.log(2 * n_line * n_frf)

    @property
    def smooth(self) -> Complex[Tensor, "n_line n_frf"]:
        """The FRFs as fitted."""
        return self.frf - self.residual / self.weight[:, None]

    @property
    def fractions(self) -> tuple[Tensor, Tensor, Tensor]:
        """Poles, residues of each FRF, and coefficients of the smooth part."""
        basis, n_pole = self.final, len(self.pole)
        amplitude = torch.linalg.solve_triangular(basis.upper, basis.q.mH @ self.target, upper=True)
        return self.pole, amplitude[:n_pole] / basis.norm[:, None], amplitude[n_pole:]

    @property
    def has_width(self) -> Bool[Tensor, " n_pole"]:
        """Whether a pole is wider than a pole has to be, or no line's: below or above all of them."""
        place = self.pole.real.clamp(min=0.0).sqrt()
        # One below 0 Hz² is below every first line, however near that is to 0.
        below = (self.pole.real < 0) | (place < self.frequency[0] - self.step)
        outside = below | (place > self.frequency[-1] + self.step)
        return outside | (self.pole.imag > 4 * NARROWEST * place.clamp(min=self.step) * self.step)

    @property
    def slope(self) -> Float[Tensor, "n_line n_frf"]:
        """|dH/df| of the fit: of the poles, of whatever width, Σ R_r 2f / (q_r − f²)², and of the smooth part."""
        basis, n_pole = self.final, len(self.pole)
        amplitude = torch.linalg.solve_triangular(basis.upper, basis.q.mH @ self.target, upper=True)
        distance = self.pole - self.frequency.square()[:, None]
        change = (2 * self.frequency[:, None] / distance.square()) @ (amplitude[:n_pole] / basis.norm[:, None])
        half = 0.5 * (self.frequency[-1] - self.frequency[0])
        angle = ((self.frequency - self.frequency[0]) / half - 1).clamp(-1.0, 1.0).arccos().clamp(1e-4, math.pi - 1e-4)
        order = torch.arange(N_SMOOTH).to(self.frequency)
        # d cos(k θ) / dx = k sin(k θ) / sin θ.
        smooth = order * (order * angle[:, None]).sin() / angle.sin()[:, None] / half
        return (change + smooth.to(change) @ amplitude[n_pole:]).abs()

    def _first_level(self) -> Tensor:
        """First guess: a from second differences in the valleys, an upper bound; b of one per cent."""
        third = (self.frf[1:-1] - 0.5 * (self.frf[:-2] + self.frf[2:])).abs().square() / 1.5
        low = self.power[1:-1] <= self.power[1:-1].quantile(0.4, dim=0)
        sensor = torch.where(low, third / self.flat[1:-1], torch.nan).nanmedian(dim=0).values / math.log(2)
        return torch.stack([sensor.median().expand(len(sensor)), torch.full_like(sensor, 1e-4)], dim=-1)

    def weigh(self) -> None:
        """Weigh each line by one over its mean noise over the FRFs."""
        sensor, signal = self.level.mean(0)
        mean = (sensor * self.flat[:, 0] + signal * self.power.mean(-1)).clamp(min=1e-24)
        self.weight = (mean / mean.log().mean().exp()).rsqrt()
        self.target = self.frf * self.weight[:, None]

    def _first_lines(self) -> Tensor:
        """Peaks of the mean amplitude that stand 3 dB over their flanks, where these are above the noise."""
        from scipy.signal import find_peaks  # here: half of what importing this package takes

        decibel = 10 * (self.power + 20 * self.level[:, 0] * self.flat).mean(-1).clamp(min=1e-20).log10()
        lines, found = find_peaks(decibel.cpu().numpy(), prominence=3.0)
        most = self._room()
        order = torch.as_tensor(found["prominences"].copy()).argsort(descending=True)[:most]
        return torch.as_tensor(lines.copy())[order].to(self.frequency.device)

    def _room(self) -> int:
        return max(0, (len(self.frequency) - N_SMOOTH) // self.per_pole - len(self.pole))

    def add(self, lines: Tensor) -> bool:
        """A pole at each of these lines, narrower than the line spacing, or beside one that is there already.

        Returns:
            Whether there was room for any.
        """
        added = False
        for line in lines.tolist():
            for beside in BESIDE:
                place = (self.frequency[line] + beside * self.step).clamp(min=0.5 * self.step)
                new = torch.complex(place.square(), place.clamp(min=self.step) * self.step)[None]
                # Two poles at one place are one, and a basis that has both is singular.
                if bool(((self.pole - new).abs() > ALIKE * new.imag).all()):
                    self.pole, added = torch.cat([self.pole, new]), True
                    break
        return added

    def basis(self, pole: Tensor) -> _Basis:
        """The weighted columns 1 / (q − f²) and polynomials, orthonormal, and their derivatives by q."""
        distance = pole - self.frequency.square()[:, None]
        fraction = self.weight[:, None] / distance
        norm = fraction.norm(dim=0)
        columns = torch.cat([fraction / norm, self.weight[:, None] * self.polynomial], dim=1)
        q, upper = torch.linalg.qr(columns)
        slope = -fraction / distance / norm
        return _Basis(q, upper, slope - q @ (q.mH @ slope), norm)

    def settle(self, n_step: int) -> None:
        """Gauss-Newton on the poles with the residues projected out, damped so that the misfit never grows."""
        damping = 1e-3
        basis = self.basis(self.pole)
        coefficient = basis.q.mH @ self.target
        residual = self.target - basis.q @ coefficient
        share = self.level @ self.level.new_tensor([1.0, 1.0])
        scale = share.clamp(min=1e-24).rsqrt()
        for _ in range(n_step if len(self.pole) else 0):
            cost = float((residual * scale).abs().square().sum())
            amplitude = torch.linalg.solve_triangular(basis.upper, coefficient, upper=True)[: len(self.pole)] * scale
            # Σ over the FRFs of J^H J and J^H r, J_k = −slope_k · amplitude_k.
            normal = (basis.slope.mH @ basis.slope) * (amplitude.conj() @ amplitude.mT)
            right = (amplitude.conj() * (basis.slope.mH @ (residual * scale))).sum(-1)
            diagonal = normal.diagonal().real.clamp(min=1e-300)
            scaled = normal / (diagonal[:, None] * diagonal).sqrt()
            for _ in range(4):
                damped = scaled + damping * torch.eye(len(diagonal)).to(scaled)
                change = torch.linalg.solve(damped, right / diagonal.sqrt()) / diagonal.sqrt()
                pole = self._bounded(self.pole, change)
                tried = self.basis(pole)
                new = tried.q.mH @ self.target
                left = self.target - tried.q @ new
                after = float((left * scale).abs().square().sum())
                if after <= cost:
                    break
                damping *= 10
            else:
                break
            self.pole, basis, coefficient, residual = pole, tried, new, left
            damping = max(damping / 10, 1e-9)
            if cost - after <= 1e-4 * cost:
                break
        self.final, self.residual = basis, residual

    def _bounded(self, pole: Tensor, change: Tensor) -> Tensor:
        """A step of a few widths at most, to a pole that is no line's."""
        place = pole.real.clamp(min=0.0).sqrt().clamp(min=self.step)
        most = 4 * place * self.step + 2 * pole.imag
        size = change.abs().clamp(min=1e-300)
        new = pole + change * (most / size).clamp(max=1.0)
        return torch.complex(new.real, new.imag.clamp(min=2 * NARROWEST * place * self.step))

    def _reach(
        self, variance: Float[Tensor, "n_line n_column"]
    ) -> tuple[Float[Tensor, "n_line n_column"], Float[Tensor, " n_line"]]:
        """E|residual|² where the lines have such variances, roughly; and the part of each line's own that is left."""
        own = (1 - self.final.q.abs().square().sum(-1)).clamp(min=0.0)[:, None]
        around = variance - self._detrended(variance)
        # What the fit takes from a line it takes from its neighbours too: |P|² sums to 1 − leverage along a row of P.
        return own.square() * variance + own * (1 - own) * around, own[:, 0]

    def _reach_exactly(
        self, variance: Float[Tensor, "n_line n_column"]
    ) -> tuple[Float[Tensor, "n_line n_column"], Float[Tensor, " n_line"]]:
        """The same from |∂ residual / ∂ target|², the poles' freedom and the local mean accounted for."""
        q = self.final.q
        one = torch.eye(len(q), dtype=q.dtype, device=q.device)
        pull = self._detrended(one - q @ q.mH).abs().square()
        if len(self.pole):
            # A pole is one number for all FRFs, so each FRF pays for its share of it.
            slope = self.final.slope / self.final.slope.norm(dim=0).clamp(min=1e-300)
            both = torch.linalg.qr(torch.cat([q, slope], dim=1)).Q
            share = 1 / self.frf.shape[1]
            pull = (1 - share) * pull + share * self._detrended(one - both @ both.mH).abs().square()
        return pull @ variance, pull.diagonal()

    def _detrended(self, residual: Tensor) -> Tensor:
        """Less the mean over the lines around each."""
        total = torch.cat([residual.new_zeros(1, residual.shape[1]), residual.cumsum(0)])
        line = torch.arange(len(residual), device=residual.device)
        low, high = (line - N_LOCAL // 2).clamp(min=0), (line + N_LOCAL // 2 + 1).clamp(max=len(residual))
        return residual - (total[high] - total[low]) / (high - low)[:, None]

    def estimate(self, final: bool = False) -> None:
        """Estimate a and b from the squared residuals: common to all FRFs, but for those that differ for certain."""
        square = (self._detrended(self.residual) if final else self.residual).abs().square()
        squared_weight = self.weight.square()[:, None]
        signal = squared_weight * self.smooth.abs().square()
        parts = torch.cat([squared_weight * self.flat, signal], dim=1)
        reached, left = (self._reach_exactly if final else self._reach)(parts)
        self.design = torch.stack([reached[:, :1].expand_as(square), reached[:, 1:]], dim=-1)
        self.square = square
        y, x = square[left > LEFT], self.design[left > LEFT]
        pooled = likeliest(y.reshape(-1, 1), x.reshape(-1, 1, 2), (True, True))
        times = times_expected(y, expected_square(x, pooled))
        if not final:
            # Each FRF with its own factor, so that a noisy one calls for no poles.
            self.level = pooled * times[:, None]
            return
        n_frf = y.shape[1]
        own, cost = regressed(y, x)
        common = (times / times.median().clamp(min=1e-300)).clamp(min=1e-300).log().abs() < math.log(2)
        for _ in range(3):
            pooled, _ = regressed(y[:, common].reshape(-1, 1), x[:, common].reshape(-1, 1, 2))
            alike = likelihood_cost(y, x, pooled.expand(n_frf, 2))
            # Two numbers more, at the price of the Bayesian information criterion, on each of n_frf occasions.
            before, common = common, alike - cost <= 2 * math.log(len(y)) + 2 * math.log(n_frf)
            if bool((common == before).all()) or not bool(common.any()):
                break
        self.n_own = int((~common).sum())
        self.level = torch.where(common[:, None], pooled, own)

    def flattest(self, floors: Mapping[str, Float[Tensor, " n_line"]]) -> str:
        """In which motion a sensor's floor is flat, as the squares of the residual make likeliest; empty for the FRF's.

        Args:
            floors: courses that it may have, beside a flat one.
        """
        best, found = math.inf, ""
        for motion, flat in {"": torch.ones_like(self.frequency), **floors}.items():
            reached, left = self._reach(self.weight.square()[:, None] * flat[:, None])
            design = torch.stack([reached.expand_as(self.square), self.design[..., 1]], dim=-1)
            y, x = self.square[left > LEFT], design[left > LEFT]
            cost = float(regressed(y, x)[1].sum()) + (CERTAIN if motion else 0.0)
            if cost < best:
                best, found = cost, motion
        return found

    def times(self, variance: Float[Tensor, "n_line n_frf"]) -> Float[Tensor, " n_frf"]:
        """How many times the squares of the residual are what this variance of both parts together makes expected."""
        expected, left = self._reach_exactly(self.weight.square()[:, None] * variance)
        return times_expected(self.square[left > LEFT], expected[left > LEFT].clamp(min=1e-300))

    def cost(self, variance: Float[Tensor, "n_line n_frf"]) -> Float[Tensor, " n_frf"]:
        """−2 ln of the likelihood of this variance of both parts together, but for a constant of each FRF."""
        expected, left = self._reach_exactly(self.weight.square()[:, None] * variance)
        square, expected = self.square[left > LEFT], expected[left > LEFT].clamp(min=1e-300)
        return 2 * (expected.log() + square / expected).sum(0)

    def outstanding(self) -> Tensor:
        """Lines at which the FRFs together are further off than noise gets: a pole is missing there."""
        from scipy.signal import find_peaks

        ratio = (self.square / expected_square(self.design, self.level)).mean(-1)
        n = self.frf.shape[1]
        # Upper tail of the mean of n exponentials: Chernoff, x − 1 − ln x = ln(20 n_line) / n.
        bound = math.log(20 * len(ratio)) / n
        high = 1 + math.sqrt(2 * bound) + bound + EXCESS
        lines, _ = find_peaks(
            torch.cat([ratio.new_zeros(1), ratio, ratio.new_zeros(1)]).cpu().numpy(), height=high, distance=3
        )
        index = torch.as_tensor(lines.copy(), device=ratio.device) - 1
        return index[ratio[index].argsort(descending=True)][: min(10, self._room())]
