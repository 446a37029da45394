"""What the models are held against: measured FRFs or natural frequencies, and how far off noise alone would put them.

Residuals come at several levels. At the sharp one each line is weighed by its noise, and by what is left of the mesh
error: a relative shift s of a mode moves H by s · dH/d ln f, which stands beside the noise in the variance. At the wide
ones the deviation is first smoothed along the frequency axis by the kernel of one mode,

    (F r)_i = Σ_j r_j Δω_j / (σ_i + i (ω_i − ω_j)),    σ_i = width · ω_i,

the same for model and measurement: what it makes small is what both would show at s = iω + σ. So peaks that do not
overlap attract each other, and the minimum is that of the sharp level where the model is right.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.effects import Effect
from torchplate.measurement import Measurement, NaturalFrequencies
from torchplate.measurement.noise import Noise
from torchplate.model import PlateModel

# Half-widths of the kernel, relative to the frequency, from the widest level to the narrowest.
WIDTHS = (0.05, 0.02, 0.007)
SHARP = len(WIDTHS)
# Lines of a smoothed spectrum for each half-width.
PER_WIDTH = 1.3
# Mean square of the baseline's residuals where the model is doubted.
DOUBTFUL = 12.0
# FRFs that are smoothed, at most; and every how many-th line is, so that there are no fewer than this.
MOST_MIXED = 10
LEAST_SMOOTHED = 350
# What the basis and the solver leave, relative to the FRF; and what the mesh leaves of the modes' deflections and of
# the static flexibility, relative to the level around a line: at the low and at the high end of the band.
ROUNDING = 5e-4
SHAPE = (4e-4, 1.8e-3)
# The level around a line is taken over this part of its frequency on either side.
AROUND = 0.08


class Misfit(NamedTuple):
    """How far a prediction is off, on what the fit saw and on what it did not.

    Attributes:
        fitted: sum of squares over the variance.
        heldout: likewise; 0 where nothing is held out.
        n_fitted: real numbers behind it.
        n_heldout: likewise.
    """

    fitted: Float[Tensor, "*batch"]
    heldout: Float[Tensor, "*batch"]
    n_fitted: float
    n_heldout: float


class Target(ABC):
    """Something measured that models predict."""

    levels: int

    # Whether residuals are weighed by the noise, and not by what the model as such leaves.
    trusts_the_noise: bool = True

    @abstractmethod
    def inflate_model_error(self, prediction: Tensor, n_mode: int) -> None:
        """Weigh residuals by what no effect of the catalogue explains, where that is far above the noise.

        Args:
            prediction: of the baseline, whose mean square becomes `DOUBTFUL`.
            n_mode: modes in the band.
        """

    @abstractmethod
    def predict(self, model: PlateModel, theta: Tensor, level: int | None = None) -> Tensor:
        """What the model says of it; at a level, of what is looked at there."""

    def rearranged(self, prediction: Tensor, model: PlateModel, effect: Effect, level: int) -> Tensor | None:  # noqa: ARG002
        """What the model says with one more effect, if that only exchanges or turns channels; else None.

        Args:
            prediction: what it says without it, at that level.
            model: the model.
            effect: one more.
            level: of the prediction.
        """
        return None

    @abstractmethod
    def residual(self, prediction: Tensor, level: int) -> Float[Tensor, "*batch n_residual"]:
        """Deviations of a prediction for this level on the fitted part, as real numbers."""

    @abstractmethod
    def misfit(self, prediction: Tensor) -> Misfit:
        """Sums of squares over the variance."""

    @abstractmethod
    def gap(self, prediction: Tensor, heldout: bool = False) -> Float[Tensor, "*batch"]:
        """The gap on the fitted or on the held-out part; NaN where there is none."""

    @abstractmethod
    def whole_gap(self, prediction: Tensor) -> float:
        """The gap on all that was measured, held out or not."""

    @property
    @abstractmethod
    def floor(self) -> float:
        """What noise alone makes the gap."""


class FrfTarget(Target):
    """Measured FRFs.

    Args:
        measurement: what was measured.
        noise: its noise.
        heldout: FRFs that no fit is to see.
        gain_is_unknown: the level carries no unit: one factor for all FRFs is fitted to each prediction.
    """

    def __init__(
        self,
        measurement: Measurement,
        noise: Noise,
        heldout: Bool[Tensor, "n_response n_reference"],
        gain_is_unknown: bool = False,
    ) -> None:
        self.measurement, self.noise = measurement, noise
        self.gain_is_unknown = gain_is_unknown
        self.frequency = measurement.frequency
        self.measured = measurement.frf
        self.levels = SHARP + 1
        self.model_variance = torch.zeros_like(noise.std)
        self.independent = 1.0
        self._around: Tensor | None = None
        self._deflection_variance = torch.zeros_like(noise.std)
        self._shift, self._mode = torch.zeros_like(self.frequency), torch.zeros(len(self.frequency), dtype=torch.int64)
        self._every = max(1, len(self.frequency) // LEAST_SMOOTHED)
        smoothed = self.frequency[:: self._every]
        # As large as with all lines: a signal that is smoothed grows by the root of their number.
        more = self._every**0.5
        self._filters = [more * _kernel(smoothed, _centres(smoothed, width), width) for width in WIDTHS]
        self.hold_out(heldout)

    def hold_out(self, heldout: Bool[Tensor, "n_response n_reference"]) -> None:
        """Hold out these FRFs from now on."""
        self.heldout = heldout & self.measurement.measured
        self.fitted = self.measurement.measured & ~heldout
        self._scales = [self._level_scale(width) for width in WIDTHS]
        # Many FRFs are mixed to a few before they are smoothed: random signs keep what all of them say.
        count = int(self.fitted.sum())
        if count > MOST_MIXED:
            generator = torch.Generator().manual_seed(0)
            signs = 2.0 * torch.randint(0, 2, (count, MOST_MIXED), generator=generator) - 1
            self._mix = (signs / MOST_MIXED**0.5).to(self.measured)
        else:
            self._mix = torch.eye(count).to(self.measured)

    def _level_scale(self, width: float) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """One over the smoothed size of each FRF at the lines that are smoothed: so that every band weighs alike."""
        kernel = _kernel(self.frequency, self.frequency, width)
        power = kernel.abs().square() @ self.measured.abs().square().flatten(1)
        power = power.unflatten(1, self.measured.shape[1:])
        floor = 1e-3 * power.mean(0)
        return (self.fitted / (power + floor).sqrt().clamp(min=1e-300))[:: self._every]

    def set_model_error(
        self,
        shift: Float[Tensor, " n_frequency"],
        shape: float = 1.0,
        modes: Float[Tensor, " n_mode"] | None = None,
    ) -> None:
        """Let what is left of the mesh error stand beside the noise.

        Args:
            shift: standard deviation of ln f at each line [-].
            shape: the part of `SHAPE` that this mesh leaves [-].
            modes: natural frequencies, each of which shifts as one [Hz]; left out, all lines shift alike.
        """
        middle = None if modes is None else 0.5 * (modes[1:] + modes[:-1]).to(self.frequency)
        self._shift = shift
        self._mode = torch.zeros(len(shift), dtype=torch.int64)
        if middle is not None:
            self._mode = torch.searchsorted(middle.contiguous(), self.frequency)
        step = self.frequency.diff()[:, None, None]
        slope = (self.measured.diff(dim=0) / step).abs()
        edge = slope.new_zeros(1, *slope.shape[1:])
        # The steeper side: a peak may stand between two lines.
        steepest = torch.maximum(torch.cat([edge, slope]), torch.cat([slope, edge])).maximum(self.noise.slope)
        moved = steepest * (self.frequency * shift)[:, None, None]
        power = self.measured.abs().square()
        away = (self.frequency[:, None] - self.frequency) / (AROUND * self.frequency[:, None] + float(step.median()))
        weight = torch.exp(-0.5 * away.square())
        around = ((weight / weight.sum(-1, keepdim=True)) @ power.flatten(1)).unflatten(1, power.shape[1:])
        part = SHAPE[0] + (SHAPE[1] - SHAPE[0]) * (self.frequency / self.frequency[-1])[:, None, None]
        rounding, part = ROUNDING * shape, part * shape
        self._deflection_variance = 0.5 * (rounding**2 * power + part.square() * around)
        self.model_variance = 0.5 * moved.square() + self._deflection_variance
        self._around = around

    def inflate_model_error(self, prediction: Tensor, n_mode: int) -> None:
        """Weigh residuals by what no effect of the catalogue explains, where that is far above the noise.

        A real plate is never quite the model. What is left of it then is not independent from line to line: an FRF says
        about two numbers of each mode in the band, and one FRF more than there are says where they come from. The
        model's error is a part of the level around each line.
        """
        assert self._around is not None
        self.trusts_the_noise = False
        known = self.model_variance
        low, high = 1e-4, 10.0
        for _ in range(40):
            part = (low * high) ** 0.5
            self.model_variance = known + 0.5 * part**2 * self._around
            square = self.misfit(prediction)
            above = float(square.fitted) > DOUBTFUL * square.n_fitted
            low, high = (part, high) if above else (low, part)
        count = 2 * len(self.frequency) * int(self.fitted.sum())
        self.independent = min(1.0, 2 * n_mode * (1 + int(self.fitted.sum())) / count)

    @property
    def variance(self) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Of the real and of the imaginary part: noise and model."""
        floor = 1e-12 * self.measured.abs().square().mean(0)
        return self.noise.std.square() + self.model_variance + floor

    def predict(self, model: PlateModel, theta: Tensor, level: int | None = None) -> Tensor:
        """FRFs of the measured channels, at the fitted level where the measurement has none.

        At a wide level they are those of the lines that are smoothed.
        """
        every = self._every if level in range(SHARP) else 1
        return self._at_level_of(self.measured[::every], model.frf(theta, self.frequency[::every]))

    def rearranged(self, prediction: Tensor, model: PlateModel, effect: Effect, level: int) -> Tensor | None:
        """The same FRFs in other places or with other signs: nothing has to be solved."""
        every = self._every if level in range(SHARP) else 1
        found = model.rearranged(prediction, effect)
        return None if found is None else self._at_level_of(self.measured[::every], found)

    def _at_level_of(self, measured: Tensor, found: Tensor) -> Tensor:
        """FRFs times one factor, where the measurement's level is unknown."""
        if self.gain_is_unknown:
            weight = torch.where(self.fitted, 1 / measured.abs().square().sum(0).clamp(min=1e-300), 0.0)
            above = (weight * (found.conj() * measured).real).sum((-3, -2, -1))
            below = (weight * found.abs().square()).sum((-3, -2, -1))
            found = found * (above / below.clamp(min=1e-300))[..., None, None, None]
        return found

    def residual(self, prediction: Tensor, level: int) -> Tensor:
        """Deviations of the fitted FRFs: smoothed, or over their standard deviation at the sharp level."""
        if level == SHARP:
            return self._weighed(self.measured - prediction)
        off = self.measured[:: self._every] - prediction
        kept = self._filters[level].to(off) @ ((off * self._scales[level])[..., self.fitted] @ self._mix)
        return torch.view_as_real(kept).flatten(-3)

    def _weighed(self, off: Tensor) -> Tensor:
        kept = (off * (self.independent / self.variance).sqrt())[..., self.fitted]
        return torch.view_as_real(kept).flatten(-3)

    def by_chance(self, prediction: Tensor, n: int, generator: torch.Generator) -> Float[Tensor, "{n} n_residual"]:
        """Residuals at the sharp level where noise and the mesh are all that is off: each mode moves as one.

        Args:
            prediction: of what is taken for the truth.
            n: how many.
            generator: of random numbers.
        """
        parts = torch.randn(n, *prediction.shape, 2, generator=generator, dtype=self.frequency.dtype)
        scatter = torch.view_as_complex(parts) * (self.noise.std.square() + self._deflection_variance).sqrt()
        slope = torch.gradient(prediction, spacing=(self.frequency,), dim=0)[0]
        moved = slope * (self.frequency * self._shift)[:, None, None]
        by_mode = torch.randn(n, int(self._mode.max()) + 1, generator=generator, dtype=self.frequency.dtype)
        return self._weighed(scatter + by_mode[:, self._mode, None, None] * moved)

    def misfit(self, prediction: Tensor) -> Misfit:
        """Sums of squares over the variance."""
        square = (self.measured - prediction).abs().square() * (self.independent / self.variance)
        count = 2 * len(self.frequency) * self.independent
        held = self.heldout & self.measurement.measured
        return Misfit(
            square[..., self.fitted].sum((-2, -1)),
            square[..., held].sum((-2, -1)),
            float(count * int(self.fitted.sum())),
            float(count * int(held.sum())),
        )

    def gap(self, prediction: Tensor, heldout: bool = False) -> Tensor:
        """Mean over FRFs of ‖measured − model‖ / ‖measured‖."""
        each = self.gaps(prediction)
        which = (self.heldout & self.measurement.measured) if heldout else self.fitted
        return each[..., which].mean(-1)

    def whole_gap(self, prediction: Tensor) -> float:
        """The same over all measured FRFs."""
        return float(self.gaps(prediction)[self.measurement.measured].mean())

    @property
    def floor(self) -> float:
        """What noise alone makes the gap."""
        return self.noise.floor

    def gaps(self, prediction: Tensor) -> Float[Tensor, "*batch n_response n_reference"]:
        """The gap of each FRF."""
        size = self.measured.norm(dim=0).clamp(min=1e-300)
        return (self.measured - prediction).norm(dim=-3) / size


class FrequencyTarget(Target):
    """A table of measured natural frequencies.

    Args:
        table: the modes and their frequencies; where it has no standard deviation, `relative_std` stands in.
        relative_std: of a natural frequency [-].
    """

    def __init__(self, table: NaturalFrequencies, relative_std: float = 2e-3) -> None:
        self.table, self.levels = table, 1
        self.mode = table.mode - 1
        std = relative_std * table.frequency
        self._noise = std if table.std is None else torch.where(table.std > 0, table.std, std)
        self.std = self._noise

    def inflate_model_error(self, prediction: Tensor, n_mode: int) -> None:  # noqa: ARG002
        """All standard deviations grow alike."""
        self.trusts_the_noise = False
        square = self.misfit(prediction)
        self.std = self.std * (float(square.fitted) / square.n_fitted / DOUBTFUL) ** 0.5

    def predict(self, model: PlateModel, theta: Tensor, level: int | None = None) -> Tensor:  # noqa: ARG002
        """The natural frequencies of the same modes [Hz]."""
        return model.natural_frequencies(theta, int(self.mode.max()) + 1)[..., self.mode]

    def residual(self, prediction: Tensor, level: int) -> Tensor:  # noqa: ARG002
        """Deviations over their standard deviation."""
        return (self.table.frequency - prediction) / self.std

    def misfit(self, prediction: Tensor) -> Misfit:
        """Sum of squares; nothing is held out."""
        square = self.residual(prediction, 0).square().sum(-1)
        return Misfit(square, torch.zeros_like(square), float(len(self.mode)), 0.0)

    def gap(self, prediction: Tensor, heldout: bool = False) -> Tensor:
        """Root mean square of the relative error."""
        off = ((prediction - self.table.frequency) / self.table.frequency).square().mean(-1).sqrt()
        return torch.full_like(off, torch.nan) if heldout else off

    def whole_gap(self, prediction: Tensor) -> float:
        """The gap: nothing is held out."""
        return float(self.gap(prediction))

    @property
    def floor(self) -> float:
        """What the standard deviations alone make the gap."""
        return float((self._noise / self.table.frequency).square().mean().sqrt())


def _centres(frequency: Float[Tensor, " n_frequency"], width: float) -> Float[Tensor, " n_smooth"]:
    """Lines of a smoothed spectrum [Hz]."""
    least = float(frequency.diff().min()) if len(frequency) > 1 else 1.0
    centres, at = [], max(float(frequency[0]), least)
    while at <= float(frequency[-1]):
        centres.append(at)
        at += max(width * at / PER_WIDTH, least)
    return torch.tensor(centres).to(frequency)


def _kernel(
    frequency: Float[Tensor, " n_frequency"], centre: Float[Tensor, " n_smooth"], width: float
) -> Complex[Tensor, "n_smooth n_frequency"]:
    """The smoothing of one level."""
    step = torch.gradient(frequency)[0] if len(frequency) > 1 else torch.ones_like(frequency)
    half = torch.maximum(width * centre, step.median())
    kernel = step / torch.complex(half[:, None].expand(-1, len(frequency)), centre[:, None] - frequency)
    return kernel / kernel.abs().square().sum(-1, keepdim=True).sqrt()
