"""What the models are held against: measured FRFs or natural frequencies, and how far off noise alone would put them.

A target is frozen: another noise, mesh or choice of held-out FRFs is another target. Residuals come at several levels.
At the sharp one they are those of `discrepancy.marginal`: each line over its noise, and the nuisances of a test, what
the mesh leaves of its error among them, integrated out. At the wide ones the deviation is first smoothed along the
frequency axis by the kernel of one mode,

    (F r)_i = Σ_j r_j Δω_j / (σ_i + i (ω_i − ω_j)),    σ_i = width · ω_i,

the same for model and measurement: what it makes small is what both would show at s = iω + σ. So peaks that do not
overlap attract each other, and the minimum is that of the sharp level where the model is right.
"""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import fields

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.diagnosis.settings import DiagnosisSettings
from torchplate.discrepancy.marginal import Judged, Marginal
from torchplate.discrepancy.nuisance import Nuisances, nuisances
from torchplate.discrepancy.wandering import UNIFORM
from torchplate.effects import Effect
from torchplate.measurement import PERFECT, Imperfections, Measurement, NaturalFrequencies
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


SETTINGS = DiagnosisSettings()


class Target(ABC):
    """Something measured that models predict."""

    levels: int

    # Whether residuals are weighed by the noise, and not by what the model as such leaves.
    trusts_the_noise: bool = True
    # Modes in the band, and numbers that what is left says, where it is not noise.
    n_mode: int = 1
    n_modal: float = 2.0
    settings: DiagnosisSettings = SETTINGS

    @abstractmethod
    def inflated(self, prediction: Tensor) -> "Target":
        """The same, weighed by what no effect of the catalogue explains, where that is far above the noise.

        Args:
            prediction: of the baseline, whose mean square becomes `DOUBTFUL`.
        """

    @abstractmethod
    def marginal(self, model: PlateModel, theta: Tensor) -> "Marginal | TableNoise":
        """Noise and nuisances beside a model, for its residuals at the sharp level."""

    @abstractmethod
    def off(self, prediction: Tensor) -> Tensor:
        """What was measured less a prediction."""

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
        """Deviations of a prediction for a wide level on the fitted part, as real numbers."""

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
        imperfections: of the test.
        settings: what is taken for granted.
    """

    def __init__(
        self,
        measurement: Measurement,
        noise: Noise,
        heldout: Bool[Tensor, "n_response n_reference"],
        gain_is_unknown: bool = False,
        imperfections: Imperfections = PERFECT,
        settings: DiagnosisSettings = SETTINGS,
    ) -> None:
        self.measurement, self.noise = measurement, noise
        self.gain_is_unknown, self.imperfections, self.settings = gain_is_unknown, imperfections, settings
        self.frequency = measurement.frequency
        self.measured = measurement.frf
        self.levels = SHARP + 1
        self.independent = 1.0
        self.model_variance = torch.zeros_like(noise.std)
        self.mesh_shift = torch.zeros_like(self.frequency)
        self._every = max(1, len(self.frequency) // LEAST_SMOOTHED)
        smoothed = self.frequency[:: self._every]
        # As large as with all lines: a signal that is smoothed grows by the root of their number.
        more = self._every**0.5
        self._filters = [more * _kernel(smoothed, _centres(smoothed, width), width) for width in WIDTHS]
        self._around = self._level_around()
        self._hold_out(heldout)

    def _copy(self) -> "FrfTarget":
        return copy.copy(self)

    def holding_out(self, heldout: Bool[Tensor, "n_response n_reference"]) -> "FrfTarget":
        """The same with these FRFs held out."""
        twin = self._copy()
        twin._hold_out(heldout)
        return twin

    def turned(self, sign: Float[Tensor, "n_response n_reference"]) -> "FrfTarget":
        """The same with some FRFs read the other way round.

        Args:
            sign: 1 or −1 of each FRF.
        """
        twin = self._copy()
        twin.measured = self.measured * sign
        return twin

    def _hold_out(self, heldout: Bool[Tensor, "n_response n_reference"]) -> None:
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

    def _level_around(self) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Mean square of each FRF around each line."""
        power = self.measured.abs().square()
        step = self.frequency.diff().median() if len(self.frequency) > 1 else self.frequency.new_ones(())
        away = (self.frequency[:, None] - self.frequency) / (AROUND * self.frequency[:, None] + float(step))
        weight = torch.exp(-0.5 * away.square())
        return ((weight / weight.sum(-1, keepdim=True)) @ power.flatten(1)).unflatten(1, power.shape[1:])

    def with_mesh_error(self, shift: Float[Tensor, " n_frequency"], shape: float, n_mode: int) -> "FrfTarget":
        """The same with what is left of the mesh error: shifts of the modes among the nuisances, the rest as noise.

        Args:
            shift: standard deviation of ln f of the modes at each line [-].
            shape: the part of `SHAPE` that this mesh leaves [-].
            n_mode: modes in the band.
        """
        twin = self._copy()
        twin.mesh_shift = shift
        part = SHAPE[0] + (SHAPE[1] - SHAPE[0]) * (self.frequency / self.frequency[-1])[:, None, None]
        power = self.measured.abs().square()
        twin.model_variance = 0.5 * ((ROUNDING * shape) ** 2 * power + (part * shape).square() * self._around)
        # Of each mode a frequency and a damping, and a deflection at each FRF.
        twin.n_mode = max(1, n_mode)
        twin.n_modal = 2.0 * twin.n_mode * (1 + int(self.measurement.measured.sum()))
        return twin

    def inflated(self, prediction: Tensor) -> "FrfTarget":
        """The same, weighed by what no effect of the catalogue explains, where that is far above the noise.

        A real plate is never quite the model. What is left of it then is not independent from line to line: an FRF says
        about two numbers of each mode in the band, and one FRF more than there are says where they come from. The
        model's error is a part of the level around each line.
        """
        twin = self._copy()
        twin.trusts_the_noise = False
        low, high = 1e-4, 10.0
        square = self.off(prediction).abs().square()[..., self.fitted]
        for _ in range(40):
            part = (low * high) ** 0.5
            twin.model_variance = self.model_variance + 0.5 * part**2 * self._around
            above = float((square / twin.variance[..., self.fitted]).mean()) > 2 * DOUBTFUL
            low, high = (part, high) if above else (low, part)
        twin.independent = min(1.0, self.n_modal / (2 * len(self.frequency) * int(self.fitted.sum())))
        return twin

    def marginal(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Marginal:
        """Noise and nuisances beside a model, with the gain that it has where the level carries no unit."""
        freedom = dict.fromkeys(("mesh",), math.inf)
        told = self.settings.knowledge.told
        freedom |= {field.name: told for field in fields(Imperfections) if self.imperfections.told(field.name)}
        if not self.trusts_the_noise:
            return Marginal(self.variance / self.independent, None, self.fitted, freedom, self.settings.knowledge)
        # Whoever says that nothing of a test is imperfect asks for a world without nuisances, in the plate too.
        wandering = UNIFORM if self.imperfections == PERFECT else self.settings.wandering
        found = nuisances(model, theta, self.frequency, self.imperfections, wandering, self.mesh_shift)
        if self.gain_is_unknown:
            gain = float(self._gain(self.measured, model.frf(theta, self.frequency)))
            common, own, other = (gain * part for part in found[:3])
            second = found.second_order._replace(factor=gain**2 * found.second_order.factor)
            found = Nuisances(common, own, other, found.group, second)
        return Marginal(self.variance, found, self.fitted, freedom, self.settings.knowledge)

    def off(self, prediction: Tensor) -> Tensor:
        """What was measured less a prediction."""
        return self.measured - prediction

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
        return found * self._gain(measured, found)[..., None, None, None] if self.gain_is_unknown else found

    def _gain(self, measured: Tensor, found: Tensor) -> Tensor:
        weight = torch.where(self.fitted, 1 / measured.abs().square().sum(0).clamp(min=1e-300), 0.0)
        above = (weight * (found.conj() * measured).real).sum((-3, -2, -1))
        below = (weight * found.abs().square()).sum((-3, -2, -1))
        return above / below.clamp(min=1e-300)

    def residual(self, prediction: Tensor, level: int) -> Tensor:
        """Deviations of the fitted FRFs, smoothed."""
        off = self.measured[:: self._every] - prediction
        kept = self._filters[level].to(off) @ ((off * self._scales[level])[..., self.fitted] @ self._mix)
        return torch.view_as_real(kept).flatten(-3)

    def signs(
        self, prediction: Complex[Tensor, "n_member n_frequency n_response n_reference"]
    ) -> tuple[Float[Tensor, "n_response n_reference"], float]:
        """Signs of the FRFs at which the best of some predictions comes nearest, and how near: at the widest level.

        Args:
            prediction: of several members, at the lines of that level.

        Returns:
            1 or −1 of each FRF; and the sum of squares with these signs over the least one with all of them 1.
        """
        kernel = self._filters[0].to(self.measured)
        scale = self._scales[0]
        measured = kernel @ (self.measured[:: self._every] * scale).flatten(1)
        model = kernel @ (prediction * scale).flatten(-2)
        both = measured.abs().square().sum(0) + model.abs().square().sum(-2)
        product = 2 * (measured.conj() * model).real.sum(-2)
        best = (both - product.abs()).sum(-1).argmin()
        turned = (both - product.abs()).sum(-1)[best] / (both - product).sum(-1).amin().clamp(min=1e-300)
        sign = torch.where(product[best] < 0, -1.0, 1.0).to(self.frequency)
        return sign.unflatten(0, self.measured.shape[1:]), float(turned)

    def expected_gap(self, marginal: "Marginal | TableNoise") -> float:
        """What noise and nuisances, as large as was said, together make the gap of the fitted FRFs."""
        assert isinstance(marginal, Marginal)
        size = self.measured.abs().square().sum(0).clamp(min=1e-300)
        each = (marginal.power().sum(0) / size).sqrt()
        return float(each[self.fitted].mean())

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

    def inflated(self, prediction: Tensor) -> "FrequencyTarget":
        """All standard deviations grow alike."""
        twin = copy.copy(self)
        twin.trusts_the_noise = False
        square = float(self.residual(prediction, 0).square().mean())
        twin.std = self.std * (square / DOUBTFUL) ** 0.5
        return twin

    def marginal(self, model: PlateModel, theta: Tensor) -> "TableNoise":  # noqa: ARG002
        """The standard deviations: a table has no nuisances of its own here."""
        return TableNoise(self.std)

    def off(self, prediction: Tensor) -> Tensor:
        """What was measured less a prediction."""
        return self.table.frequency - prediction

    def predict(self, model: PlateModel, theta: Tensor, level: int | None = None) -> Tensor:  # noqa: ARG002
        """The natural frequencies of the same modes [Hz]."""
        return model.natural_frequencies(theta, int(self.mode.max()) + 1)[..., self.mode]

    def residual(self, prediction: Tensor, level: int) -> Tensor:  # noqa: ARG002
        """Deviations over their standard deviation."""
        return (self.table.frequency - prediction) / self.std

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


class TableNoise:
    """The scatter of a table, with the words of `Marginal`."""

    def __init__(self, std: Float[Tensor, " n_mode"]) -> None:
        self.std, self.n = std, float(len(std))
        self.scale: dict[str, float] = {}

    def over_noise(self, off: Float[Tensor, "*batch n_mode"]) -> Float[Tensor, "*batch n_mode"]:
        """Residuals over their standard deviations."""
        return off / self.std

    def whitened(self, residual: Float[Tensor, "*batch n_mode"]) -> Float[Tensor, "*batch n_mode"]:
        """As they are."""
        return residual

    def rescaled(self, scale: Mapping[str, float]) -> "TableNoise":  # noqa: ARG002
        """There are no nuisances."""
        return self

    def precision(self, rows: Float[Tensor, "n n_mode"], judged: Judged) -> Float[Tensor, "n n"]:  # noqa: ARG002
        """Their products."""
        return rows @ rows.mT

    def judge(self, residual: Float[Tensor, " n_mode"]) -> Judged:
        """The sum of squares."""
        square = float(residual.square().sum())
        white = square / self.n
        return Judged(square, max(1e-9, white) ** 0.5, {}, white, self.n, residual.new_zeros(0))


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
