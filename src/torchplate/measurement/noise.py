"""How noisy a measurement is, from the measurement alone: no model of the plate is asked.

What is smooth in frequency, but for resonances, is signal; what is not is noise. The resonances are common to all FRFs,
so one set of poles serves them all: H(f) = Σ_r R_r / (q_r − f²) + a polynomial, with free complex residues R_r for each
FRF. The poles follow by variable projection, new ones are added where the residual stands out, and what a local mean
still finds in the residual is taken away. Because the poles are fitted as poles, a peak narrower than the line spacing
costs two numbers and leaves no error behind, where a polynomial through its neighbours fails.

The residual's squares, whose expectation is known exactly for a given noise, are regressed on the two-component model
σ² = a g(f) + b |H|², a ≥ 0 of the sensor and b ≥ 0 in proportion to the signal. g is flat in what the sensor reads,
which need not be what the FRF says: an accelerometer's floor falls with f⁻⁴ in the power of a receptance. Displacement,
velocity and acceleration are tried, and the likelihood decides. The coherence, with the number of averages, is a second
opinion.

Sources: Golub and Pereyra, "Separable nonlinear least squares", Inverse Problems 19 (2003); Kaufman, BIT 15 (1975), for
the Jacobian; McKelvey and Guérin, "Non-parametric frequency response estimation using a local rational model", IFAC
SYSID (2012), and Pintelon and Schoukens, System Identification (2012), ch. 7, for noise from smoothness; Rocke and
Lorenzato, Technometrics 37 (1995), for the two components; Bendat and Piersol, Random Data (2010), Table 9.6, for the
coherence.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.measurement import Measurement
from torchplate.measurement.quality import line_noise, reciprocity
from torchplate.measurement.resonances import Resonances

# Fewer lines than this cannot part poles from noise; neighbours then have to do.
LEAST_LINE: Final = 24
# The smooth part of an FRF over the band: modes outside it, a delay.
N_SMOOTH: Final = 6
# Lines of the local mean that is taken from the residual.
N_LOCAL: Final = 15
# Rounds in which poles may be added, and Gauss-Newton steps after each.
N_ROUND: Final = 8
N_STEP: Final = 12
# Squares above this many times their expectation count as this: a line that no pole explains is no noise.
CLIP: Final = 6.0
# What a second number must lower twice the negative log-likelihood by to weigh as much as the first alone.
PRICE: Final = 2.0
# Power of the frequency by which a sensor's floor goes in the FRF's own kind, where it is flat in one of three motions;
# and what it must lower twice the negative log-likelihood by, beside the flat one: a choice of three, for certain.
MOTIONS: Final = ("displacement", "velocity", "acceleration")
ORDER: Final = {"receptance": 0, "mobility": 1, "accelerance": 2}
CERTAIN: Final = 20.0
# Scoring steps of a noise level.
N_SCORE: Final = 12
# A line is worth a pole where its squares are above their expectation by this more than noise gets.
EXCESS: Final = 0.3
# A line of which the fit leaves less than this says nothing of the noise.
LEFT: Final = 0.02
# Where a new pole goes, in line spacings from its line; and the part of its width within which one is there already.
BESIDE: Final = (0.0, 0.4, -0.4)
ALIKE: Final = 0.01
# A coherence-based noise is not believed if it is below the scatter over the lines by more than this factor.
DISAGREEMENT: Final = 2.0


@dataclass(frozen=True)
class Noise:
    """The noise of a measurement.

    Attributes:
        std: standard deviation of the real and of the imaginary part, in the unit of the FRFs; 0 where not measured.
        floor: mean over FRFs of √(Σ 2 std²) / ‖H‖ [-]: what noise alone makes the gap.
        sentences: where the numbers come from.
        slope: |dH/df| of the resonances found, between lines too [unit of the FRFs per Hz]; 0 where none were sought.
        resonances: these; None where none were sought.
    """

    std: Float[Tensor, "n_frequency n_response n_reference"]
    floor: float
    sentences: tuple[str, ...]
    slope: Float[Tensor, "n_frequency n_response n_reference"]
    resonances: Resonances | None = None

    def every(self, step: int) -> "Noise":
        """Of every `step`-th line."""
        said = f"Of the lines one in {step} is looked at: this many FRFs say no more with all of them."
        return replace(self, std=self.std[::step], slope=self.slope[::step], sentences=(*self.sentences, said))


def noise_level(measurement: Measurement, n_average: int | None = None) -> Noise:
    """Estimate the noise of every FRF at every line.

    Args:
        measurement: at least 24 lines, or the estimate is only what the neighbours of each line say.
        n_average: records that each FRF is averaged over, ≥ 2, where known; it gives the coherence its level.

    Raises:
        ValueError: if `n_average` is below 2.
    """
    if n_average is not None and n_average < 2:
        raise ValueError(f"Expected n_average of 2 or more, got {n_average}. Leave it out where it is not known.")
    kept = measurement.measured
    frf = measurement.frf[:, kept]
    frf = frf.to(torch.complex128)
    norm = frf.norm(dim=0)
    alive = norm > 0
    variance, steep = torch.zeros_like(frf.real), torch.zeros_like(frf.real)
    sentences: list[str] = []
    resonances: Resonances | None = None
    if bool(alive.any()):
        scatter = _from_smoothness(measurement, frf[:, alive], alive)
        variance[:, alive], steep[:, alive] = scatter.variance, scatter.slope
        sentences.append(scatter.sentence)
        if scatter.fractions is not None:
            resonances = _of_all(measurement, scatter.fractions, alive)
        if measurement.coherence is not None:
            coherence = measurement.coherence[:, kept][:, alive].to(variance)
            variance[:, alive], said = _from_coherence(scatter, coherence, n_average)
            sentences.append(said)
    else:
        sentences.append("Every FRF is zero at every line: there is nothing to tell noise from.")
    floors = (2 * variance.sum(0)).sqrt() / torch.where(alive, norm, 1.0)
    floor = float(floors[alive].mean()) if bool(alive.any()) else 0.0
    sentences.append(_of_reciprocity(measurement, floor))
    std = torch.zeros_like(measurement.frf.real)
    slope = torch.zeros_like(std)
    std[:, kept], slope[:, kept] = variance.sqrt().to(std), steep.to(std)
    return Noise(std, floor, tuple(sentence for sentence in sentences if sentence), slope, resonances)


class _Scatter(NamedTuple):
    """The noise as the lines show it.

    Attributes:
        variance: of each part.
        smooth: the FRFs without their noise.
        slope: |dH/df| of their resonances.
        sentence: where the numbers come from.
        times: how many times a variance's expectation the scatter is.
        fractions: poles, residues and coefficients of the smooth part; None where none were sought.
    """

    variance: Float[Tensor, "n_line n_frf"]
    smooth: Complex[Tensor, "n_line n_frf"]
    slope: Float[Tensor, "n_line n_frf"]
    sentence: str
    times: Callable[[Tensor], Tensor]
    fractions: tuple[Tensor, Tensor, Tensor] | None = None


def _from_smoothness(
    measurement: Measurement, frf: Complex[Tensor, "n_line n_frf"], alive: Bool[Tensor, " n_measured"]
) -> _Scatter:
    if len(frf) < LEAST_LINE:
        share = line_noise(measurement)[measurement.measured][alive].to(frf.real)
        level = share * frf.abs().median(dim=0).values
        said = f"The noise is an upper bound from the neighbours of each line: {len(frf)} lines are too few for more."
        crude = (0.5 * level.square()).expand(len(frf), -1)
        return _Scatter(
            crude, frf, torch.zeros_like(crude), said, lambda other: (crude / other.clamp(min=1e-300)).mean(0)
        )
    scale = frf.abs().square().mean(0).sqrt()
    line = measurement.frequency.to(frf.real)
    fit = _Fit.of(line, frf / scale)
    motion, flat = fit.flattest(_floors(measurement.kind, line))
    if motion:
        fit = _Fit.of(line, frf / scale, flat)
    sensor, signal = fit.level.unbind(-1)
    smooth = fit.smooth
    variance = 0.5 * (sensor * flat[:, None] + signal * smooth.abs().square()) * scale.square()
    kinds = (
        f"{math.sqrt(float(sensor.mean())):.2%} of each FRF's root mean square at every line{motion} and "
        f"{math.sqrt(float(signal.mean())):.2%} of |H| itself"
    )
    own = "" if not fit.n_own else f"; {fit.n_own} of {frf.shape[1]} FRFs have a noise of their own"
    said = (
        f"The noise is what {len(fit.pole)} resonances common to all FRFs and a smooth rest leave of {len(frf)} lines: "
        f"{kinds}{own}."
    )
    pole, residue, polynomial = fit.fractions
    return _Scatter(
        variance,
        smooth * scale,
        fit.slope * scale,
        said,
        lambda other: fit.times(2 * other / scale.square()),
        (pole, residue * scale, polynomial * scale),
    )


def _floors(kind: str, line: Float[Tensor, " n_line"]) -> dict[str, Float[Tensor, " n_line"]]:
    """Course over the lines, of mean 1, of a sensor's floor of power that is flat in another motion than the FRF's."""
    if kind not in ORDER:
        return {}
    place = line.clamp(min=float(line[min(1, len(line) - 1)]))
    powers = {motion: 2.0 * (ORDER[kind] - order) for order, motion in enumerate(MOTIONS) if order != ORDER[kind]}
    courses = {motion: (place / place[-1]) ** power for motion, power in powers.items()}
    return {motion: course / course.mean() for motion, course in courses.items()}


def _of_all(
    measurement: Measurement, fractions: tuple[Tensor, Tensor, Tensor], alive: Bool[Tensor, " n_measured"]
) -> Resonances:
    """The partial fractions of those FRFs that say something, in their places; zero elsewhere."""
    pole, *parts = fractions
    kept = measurement.measured.clone()
    kept[measurement.measured] = alive
    wholes = []
    for part in parts:
        whole = part.new_zeros(len(part), *kept.shape)
        whole[:, kept] = part
        wholes.append(whole)
    line = measurement.frequency
    return Resonances(pole, wholes[0], wholes[1], (float(line[0]), float(line[-1])))


class _Basis(NamedTuple):
    """An orthonormal basis of the weighted partial fractions, and the derivatives by the poles outside its span."""

    q: Complex[Tensor, "n_line n_basis"]
    upper: Complex[Tensor, "n_basis n_basis"]
    slope: Complex[Tensor, "n_line n_pole"]
    norm: Float[Tensor, " n_pole"]


class _Fit:
    """Poles common to all FRFs, free residues, and the noise that is left; FRFs come with a root mean square of 1."""

    def __init__(self, frequency: Tensor, frf: Tensor, flat: Tensor | None = None) -> None:
        self.frequency, self.frf = frequency, frf
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
    ) -> "_Fit":
        """The fit with all poles that the lines show, beside a sensor's floor of this course; flat where left out."""
        fit = cls(frequency, frf, flat)
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
        return fit

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
        return max(0, (len(self.frequency) - N_SMOOTH) // 6 - len(self.pole))

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
        return torch.complex(new.real, new.imag.clamp(min=2e-4 * place * self.step))

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
        pooled = _likeliest(y.reshape(-1, 1), x.reshape(-1, 1, 2), (True, True))
        times = _times(y, _expected(x, pooled))
        if not final:
            # Each FRF with its own factor, so that a noisy one calls for no poles.
            self.level = pooled * times[:, None]
            return
        n_frf = y.shape[1]
        own, cost = _regressed(y, x)
        common = (times / times.median().clamp(min=1e-300)).clamp(min=1e-300).log().abs() < math.log(2)
        for _ in range(3):
            pooled, _ = _regressed(y[:, common].reshape(-1, 1), x[:, common].reshape(-1, 1, 2))
            alike = _cost(y, x, pooled.expand(n_frf, 2))
            # Two numbers more, at the price of the Bayesian information criterion, on each of n_frf occasions.
            before, common = common, alike - cost <= 2 * math.log(len(y)) + 2 * math.log(n_frf)
            if bool((common == before).all()) or not bool(common.any()):
                break
        self.n_own = int((~common).sum())
        self.level = torch.where(common[:, None], pooled, own)

    def flattest(self, floors: Mapping[str, Float[Tensor, " n_line"]]) -> tuple[str, Float[Tensor, " n_line"]]:
        """The course of a sensor's floor that the squares of the residual make likeliest, and of which motion it is.

        Args:
            floors: courses that it may have, beside a flat one.
        """
        best, found = math.inf, ("", torch.ones_like(self.frequency))
        for motion, flat in {"": found[1], **floors}.items():
            reached, left = self._reach(self.weight.square()[:, None] * flat[:, None])
            design = torch.stack([reached.expand_as(self.square), self.design[..., 1]], dim=-1)
            y, x = self.square[left > LEFT], design[left > LEFT]
            cost = float(_regressed(y, x)[1].sum()) + (CERTAIN if motion else 0.0)
            if cost < best:
                best, found = cost, (f", flat in {motion}," if motion else "", flat)
        return found

    def times(self, variance: Float[Tensor, "n_line n_frf"]) -> Float[Tensor, " n_frf"]:
        """How many times the squares of the residual are what this variance of both parts together makes expected."""
        expected, left = self._reach_exactly(self.weight.square()[:, None] * variance)
        return _times(self.square[left > LEFT], expected[left > LEFT].clamp(min=1e-300))

    def outstanding(self) -> Tensor:
        """Lines at which the FRFs together are further off than noise gets: a pole is missing there."""
        from scipy.signal import find_peaks

        ratio = (self.square / _expected(self.design, self.level)).mean(-1)
        n = self.frf.shape[1]
        # Upper tail of the mean of n exponentials: Chernoff, x − 1 − ln x = ln(20 n_line) / n.
        bound = math.log(20 * len(ratio)) / n
        high = 1 + math.sqrt(2 * bound) + bound + EXCESS
        lines, _ = find_peaks(
            torch.cat([ratio.new_zeros(1), ratio, ratio.new_zeros(1)]).cpu().numpy(), height=high, distance=3
        )
        index = torch.as_tensor(lines.copy(), device=ratio.device) - 1
        return index[ratio[index].argsort(descending=True)][: min(10, self._room())]


def _cost(
    square: Float[Tensor, "n_line n_frf"], design: Float[Tensor, "n_line n_frf 2"], level: Float[Tensor, "n_frf 2"]
) -> Float[Tensor, " n_frf"]:
    """Twice the negative log-likelihood of exponential squares, far ones clipped."""
    expected = _expected(design, level)
    return 2 * (expected.log() + (square / expected).clamp(max=CLIP)).sum(0)


def _regressed(
    square: Float[Tensor, "n_line n_frf"], design: Float[Tensor, "n_line n_frf 2"]
) -> tuple[Float[Tensor, "n_frf 2"], Float[Tensor, " n_frf"]]:
    """a, b ≥ 0 of each FRF, by the likelihood of exponential squares, and its cost.

    a alone, b alone and both are averaged, each with the weight exp(−cost / 2), where both pay for the second number
    (Akaike), because what is not negative is biased upward: to choose would be to claim that there is no b where a few
    lines on a peak cannot tell (Buckland, Burnham and Augustin, Biometrics 53, 1997).
    """
    levels, costs = [], []
    for parts, price in (((True, False), 0.0), ((False, True), 0.0), ((True, True), PRICE)):
        levels.append(_likeliest(square, design, parts))
        costs.append(_cost(square, design, levels[-1]) + price)
    weight = (-0.5 * torch.stack(costs)).softmax(0)
    level = (weight[..., None] * torch.stack(levels)).sum(0)
    return level, _cost(square, design, level)


def _likeliest(square: Tensor, design: Tensor, parts: tuple[bool, bool]) -> Tensor:
    """Σ level · design = E[square], level ≥ 0: the scoring steps of the exponential likelihood, regressions over μ²."""
    first, second = design[..., 0], design[..., 1]
    start = square.median(0).values / math.log(2)
    level = torch.stack([start / first.median(0).values.clamp(min=1e-30), torch.zeros_like(start)], dim=-1)
    if not parts[0]:
        ratio = (square / second.clamp(min=1e-30)).median(0).values / math.log(2)
        level = torch.stack([torch.zeros_like(ratio), ratio], dim=-1)
    for _ in range(N_SCORE):
        expected = _expected(design, level)
        clipped = torch.minimum(square, CLIP * expected) / ((1 - math.exp(-CLIP)) * expected)
        one, two = first / expected, second / expected
        both, left, right = (one * two).sum(0), one.square().sum(0), two.square().sum(0)
        to_one, to_two = (one * clipped).sum(0), (two * clipped).sum(0)
        alone = torch.stack([to_one / left.clamp(min=1e-300), to_two / right.clamp(min=1e-300)], dim=-1)
        if parts[0] and parts[1]:
            determinant = (left * right - both.square()).clamp(min=1e-12 * left * right)
            joint = torch.stack([right * to_one - both * to_two, left * to_two - both * to_one], dim=-1)
            better = alone[:, 0] * to_one >= alone[:, 1] * to_two
            single = alone * torch.stack([better, ~better], dim=-1)
            level = torch.where((joint >= 0).all(-1, keepdim=True), joint / determinant[:, None], single)
        else:
            level = alone * alone.new_tensor(parts)
    return level


def _times(square: Float[Tensor, "n_line n_frf"], expected: Float[Tensor, "n_line n_frf"]) -> Float[Tensor, " n_frf"]:
    """The factor on the expectation that is the likeliest, far squares clipped."""
    ratio = square / expected
    factor = ratio.median(0).values / math.log(2)
    for _ in range(N_SCORE):
        factor = torch.minimum(ratio, CLIP * factor).mean(0) / (1 - math.exp(-CLIP))
    return factor


def _expected(design: Tensor, level: Tensor) -> Tensor:
    return (design[..., 0] * level[:, 0] + design[..., 1] * level[:, 1]).clamp(min=1e-30)


def _from_coherence(
    scatter: _Scatter, coherence: Float[Tensor, "n_line n_frf"], n_average: int | None
) -> tuple[Float[Tensor, "n_line n_frf"], str]:
    """Variance of each part where the coherence has a say, σ² = |H|² (1 − γ²) / (2 (n_average − 1) γ²), and a sentence.

    Over the scatter's own curve it is smoothed along the lines, because the coherence of few averages scatters itself.
    """
    known = (coherence > 0) & (coherence < 1)  # NaN is neither
    safe = torch.where(known, coherence, 0.5)
    said = scatter.smooth.abs().square() * (1 - safe) / (2 * safe * ((n_average or 2) - 1))
    own = scatter.variance.clamp(min=1e-300)
    ratio = torch.where(known, said / own, 0.0)
    count = _moving_sum(known.to(own))
    # Where no line near has a coherence, as on the whole.
    local = torch.where(
        count > 0.5, _moving_sum(ratio) / count.clamp(min=1.0), ratio.sum(0) / known.sum(0).clamp(min=1)
    )
    variance = own * local
    usable = (known.to(own).mean(0) > 0.9) & (variance > 0).all(0)
    times = scatter.times(torch.where(usable, variance, own))
    if n_average is None:
        if not bool(usable.any()):
            return scatter.variance, "The coherence is 1 or missing at many lines and was not used."
        shaped = torch.where(usable, variance * times, scatter.variance)
        return shaped, (
            "The coherence gives the noise its course over the lines, the scatter its level: the number of averages is "
            "not known."
        )
    believed = usable & (times <= DISAGREEMENT**2)
    n = int(believed.sum())
    if n == 0:
        return scatter.variance, (
            "The coherence claims less than half of the scatter that the lines show, or is 1: the scatter counts."
        )
    over = 1 / math.sqrt(float(times[believed].mean()))
    return torch.where(believed, variance, scatter.variance), (
        f"The noise of {n} of {len(believed)} FRFs is that of their coherence over {n_average} averages, {over:.2f} "
        "times what the scatter over the lines says."
    )


def _moving_sum(values: Float[Tensor, "n_line n_frf"]) -> Float[Tensor, "n_line n_frf"]:
    """Over N_LOCAL lines around each."""
    window = values.new_ones(1, 1, N_LOCAL)
    return torch.nn.functional.conv1d(values.mT[:, None].contiguous(), window, padding=N_LOCAL // 2)[:, 0].mT


def _of_reciprocity(measurement: Measurement, floor: float) -> str:
    """A sentence where FRFs exist both ways round: two of them differ by √2 times their noise at least."""
    exchanged = reciprocity(measurement)
    if not exchanged:
        return ""
    usual = sorted(pair.difference for pair in exchanged)[len(exchanged) // 2] / math.sqrt(2)
    if usual < 0.7 * floor:
        return (
            f"FRFs measured both ways round differ by {usual:.2%} each, less than the noise of {floor:.2%} found: "
            "the noise may be common to both, or overestimated."
        )
    beyond = " That is more than noise: places, mounting or non-linearity." if usual > 2 * floor else ""
    return f"FRFs measured both ways round differ by {usual:.2%} each, the noise found is {floor:.2%}.{beyond}"
