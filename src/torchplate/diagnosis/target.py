"""What the models are held against: measured FRFs, and how far off noise alone would put them.

A target is frozen: another noise, mesh or choice of held-out FRFs is another target. Residuals come at several levels.
At the sharp one they are those of `discrepancy.marginal`: each line over its noise, and the nuisances of a test, what
the mesh leaves of its error among them, integrated out. At the wide ones both are looked at beside the frequency axis
(`smoothing`), where every resonance is as broad as with more damping. So peaks that do not overlap attract each other,
and the minimum is that of the sharp level where the model is right.
"""

import functools
import math
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.diagnosis.freed_memory import hand_back
from torchplate.diagnosis.settings import SETTINGS, DiagnosisSettings
from torchplate.diagnosis.smoothing import Smoothing
from torchplate.discrepancy import (
    FREE,
    UNIFORM,
    Found,
    Marginal,
    Nuisances,
    OfChannels,
    Specimens,
    Wandering,
    as_it_is_meant,
    modes_damped,
    nuisances,
    place_std,
    real_columns,
)
from torchplate.effects import Effect
from torchplate.measurement import PERFECT, Imperfections, Measurement, Noise
from torchplate.model import PlateModel
from torchplate.plate import transformed

# Of a drift, by which what it makes of FRFs is differentiated [-]: a hundredth of a peak's width where 1e-4 is lost.
STEP = 1e-6


@dataclass(frozen=True, eq=False)
class FrfTarget:
    """Measured FRFs that models predict.

    Attributes:
        measurement: what was measured.
        noise: its noise.
        heldout: FRFs that no fit is to see.
        gain_is_unknown: the level carries no unit: one factor for all FRFs is fitted to each prediction.
        imperfections: of the test.
        settings: what is taken for granted.
        sign: 1 or −1 of each FRF, by which it is read the other way round; None where all are read as they are.
        mesh_shift: standard deviation of ln f of the modes at each line, as the mesh leaves it [-]; None for none.
        mesh_left: of the deflections: distance by which lines of equal deflection are off [m], and part of them [-].
        model_variance: of the real and of the imaginary part, what the model as such leaves; None for none.
        n_mode: modes in the band.
        n_modal: numbers that what is left says, where it is not noise.
        trusts_the_noise: residuals are weighed by the noise, and not by what the model as such leaves.
        independent: of the numbers, the part that is independent [-].
        stands_for: lines of what was measured that each stands for [-]; None where each stands for itself.
        by_noise: the same with residuals weighed by the noise, where they are not here; None where they are.
        whole: the same at all lines that were measured, where some are left out here; None where none is.
    """

    measurement: Measurement
    noise: Noise
    heldout: Bool[Tensor, "n_response n_reference"]
    gain_is_unknown: bool = False
    imperfections: Imperfections = PERFECT
    settings: DiagnosisSettings = SETTINGS
    sign: Float[Tensor, "n_response n_reference"] | None = None
    mesh_shift: Float[Tensor, " n_frequency"] | None = None
    mesh_left: tuple[float, float] = (0.0, 0.0)
    model_variance: Float[Tensor, "n_frequency n_response n_reference"] | None = None
    n_mode: int = 1
    n_modal: float = 2.0
    trusts_the_noise: bool = True
    independent: float = 1.0
    stands_for: Float[Tensor, " n_frequency"] | None = None
    by_noise: "FrfTarget | None" = None
    whole: "FrfTarget | None" = None

    @property
    def levels(self) -> int:
        """The wide ones and the sharp one, which comes last."""
        return len(self.settings.wide.widths) + 1

    def _but(self, **changes: Any) -> "FrfTarget":
        """The same but for this."""
        twin = replace(self, **changes)
        # What smooths is of the measurement alone, and the costliest part of a target.
        vars(twin)["smoothing"] = self.smoothing
        return twin

    def holding_out(self, heldout: Bool[Tensor, "n_response n_reference"]) -> "FrfTarget":
        """The same with these FRFs held out."""
        return self._but(heldout=heldout)

    @property
    def at_all_lines(self) -> "FrfTarget":
        """The same at all lines that were measured, where what is said is said of all of them."""
        return self if self.whole is None else replace(self.whole, heldout=self.heldout, sign=self.sign)

    @property
    def share(self) -> Float[Tensor, " n_frequency"]:
        """Of what was measured, the lines that each stands for [-]."""
        return torch.ones_like(self.frequency) if self.stands_for is None else self.stands_for

    def turned(self, sign: Float[Tensor, "n_response n_reference"]) -> "FrfTarget":
        """The same with some FRFs read the other way round.

        Args:
            sign: 1 or −1 of each FRF.
        """
        return self._but(sign=sign if self.sign is None else sign * self.sign)

    def with_mesh_error(
        self, shift: Float[Tensor, " n_frequency"], shape: float, n_mode: int, place: float = 0.0
    ) -> "FrfTarget":
        """The same with what is left of the mesh error: shifts of the modes among the nuisances, the rest as noise.

        Args:
            shift: standard deviation of ln f of the modes at each line [-].
            shape: the part of `Meshes.shape` that this mesh leaves [-].
            n_mode: modes in the band.
            place: distance by which this mesh leaves the lines of equal deflection off [m].
        """
        rounding, (low, high) = self.settings.meshes.rounding, self.settings.meshes.shape
        part = low + (high - low) * (self.frequency / self.frequency[-1])[:, None, None]
        power = self.measured.abs().square()
        variance = 0.5 * ((rounding * shape) ** 2 * power + (part * shape).square() * self.smoothing.around)
        # Of each mode a frequency and a damping, and a deflection at each FRF.
        n_modal = 2.0 * max(1, n_mode) * (1 + int(self.measurement.measured.sum()))
        return self._but(
            mesh_shift=shift,
            mesh_left=(place, high * shape),
            model_variance=variance,
            n_mode=max(1, n_mode),
            n_modal=n_modal,
        )

    @property
    def frequency(self) -> Float[Tensor, " n_frequency"]:
        """Lines [Hz]."""
        return self.measurement.frequency

    @functools.cached_property
    def measured(self) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """The FRFs as they are read."""
        return self.measurement.frf if self.sign is None else self.measurement.frf * self.sign

    @functools.cached_property
    def fitted(self) -> Bool[Tensor, "n_response n_reference"]:
        """FRFs that fits see."""
        return self.measurement.measured & ~self.heldout

    @functools.cached_property
    def smoothing(self) -> Smoothing:
        """Of the wide levels."""
        return Smoothing(self.frequency, self.measurement.frf, self.noise.resonances, self.settings.wide, self.share)

    @functools.cached_property
    def _mix(self) -> Complex[Tensor, "n_fitted n_mixed"]:
        """Many FRFs are mixed to a few before they are smoothed: random signs keep what all of them say."""
        count = int(self.fitted.sum())
        most = self.settings.wide.most_mixed
        if count <= most:
            return torch.eye(count).to(self.measured)
        generator = torch.Generator().manual_seed(0)
        signs = 2.0 * torch.randint(0, 2, (count, most), generator=generator) - 1
        return (signs / most**0.5).to(self.measured)

    def inflated(self, prediction: Tensor) -> "FrfTarget":
        """The same, weighed by what no effect of the catalogue explains, where that is far above the noise.

        A real plate is never quite the model. What is left of it then is not independent from line to line: an FRF says
        about two numbers of each mode in the band, and one FRF more than there are says where they come from. The
        model's error is a part of the level around each line.
        """
        plain = 0.0 if self.model_variance is None else self.model_variance
        low, high = 1e-4, 10.0
        square = self.off(prediction).abs().square()[..., self.fitted]
        for _ in range(40):
            part = (low * high) ** 0.5
            twin = self._but(trusts_the_noise=False, model_variance=plain + 0.5 * part**2 * self.smoothing.around)
            above = float((square / twin.variance[..., self.fitted]).mean()) > 2 * self.settings.selecting.doubtful
            low, high = (part, high) if above else (low, part)
        independent = min(1.0, self.n_modal / (2 * len(self.frequency) * int(self.fitted.sum())))
        return twin._but(independent=independent, by_noise=self.by_noise or self)

    @property
    def wandering(self) -> Wandering:
        """How far the plate's section may wander."""
        # Whoever says that nothing of a test is imperfect asks for a world without nuisances, in the plate too.
        if self.imperfections == PERFECT or not self.trusts_the_noise:
            return UNIFORM
        told, wandering = self.imperfections.thickness_scatter, self.settings.wandering
        return wandering if told is None else replace(wandering, thickness=told)

    def specimens(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Specimens:
        """The specimens that a model may stand for.

        Args:
            model: in a basis.
            theta: its parameters.
        """
        n_mode = modes_damped(model, theta, self.frequency)
        damping, place = self.imperfections.std("damping_scatter"), place_std(self.imperfections, self.mesh_left)
        return Specimens(model, theta, self.wandering, damping, n_mode, place)

    def specimen(self, model: PlateModel, theta: Float[Tensor, " n_parameter"], about: Found | None) -> PlateModel:
        """The specimen that a model stands for.

        Args:
            model: in a basis.
            theta: its parameters.
            about: how far off it is; None where it is not.
        """
        return as_it_is_meant(model) if about is None else self.specimens(model, theta).of(about)

    def marginal(
        self,
        model: PlateModel,
        theta: Float[Tensor, " n_parameter"],
        about: Found | None = None,
        specimen: bool = True,
    ) -> Marginal:
        """Noise and nuisances beside a model, with the gain that it has where the level carries no unit.

        Args:
            model: in a basis.
            theta: its parameters.
            about: how far off the specimen is that it is.
            specimen: whether it may be any further off.
        """
        # Its columns are most of the memory of a diagnosis.
        hand_back(self.measured.nbytes)
        about = self.about(about)
        freedom = dict.fromkeys(("mesh",), math.inf)
        told = self.settings.knowledge.told
        freedom |= {field.name: told for field in fields(Imperfections) if self.imperfections.told(field.name)}
        # Columns of a thickness that wanders are called by what wanders.
        if "thickness_scatter" in freedom:
            freedom["thickness"] = freedom.pop("thickness_scatter")
        if not self.trusts_the_noise:
            # How much a model leaves as such is what it leaves: nothing is known of that beforehand.
            knowledge = replace(self.settings.knowledge, noise=0.0)
            return Marginal(self.variance / self.independent, None, self.fitted, freedom, knowledge)
        shift = torch.zeros_like(self.frequency) if self.mesh_shift is None else self.mesh_shift
        wandering, imperfections = self.wandering, self.imperfections
        if not specimen:
            wandering, imperfections = UNIFORM, replace(imperfections, damping_scatter=0.0)
        drifting = None if about is None or about.channels is None else self._drifting(about.channels)
        found = nuisances(
            model, theta, self.frequency, imperfections, wandering, shift, about, self.mesh_left, drifting
        )
        if self.gain_is_unknown:
            found = self._without_level(found, model.frf(theta, self.frequency))
            freedom[FREE] = math.inf
        return Marginal(self.variance, found, self.fitted, freedom, self.settings.knowledge, about=found.about)

    def about(self, found: Found | None) -> Found | None:
        """The same as far as it can be taken off what was measured: without resonances no drift can."""
        if found is None or found.channels is None or self.noise.resonances is not None:
            return found
        return found._replace(channels=found.channels.without_drift())

    def _without_level(self, found: Nuisances, plain: Tensor) -> Nuisances:
        """Nuisances at the level that is fitted to a model's FRFs, which may as well be another.

        That one is right where the model is. Where peaks are elsewhere, or higher, it is what these make of it, and all
        lines between them are off: the level is a nuisance as large as itself, for nobody knows anything of it.
        """
        gain = float(self._gain(self.measured, plain))
        level = real_columns([gain * plain], plain)
        common, own, other = (gain * part for part in found[:3])
        return found._replace(
            common=torch.cat([common, level.to(common)], dim=-1),
            by_response=own,
            by_reference=other,
            group=((*found.group[0], FREE), *found.group[1:]),
            second_order=found.second_order._replace(factor=gain**2 * found.second_order.factor),
        )

    def off(self, prediction: Tensor, about: Found | None = None) -> Tensor:
        """What was measured less a prediction, levels and drifts that were found taken off what was measured.

        Args:
            prediction: of the FRFs.
            about: what was found; None for nothing.
        """
        return (self.measured if about is None or about.channels is None else self._undone(about.channels)) - prediction

    def _undone(self, channels: OfChannels) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """What was measured as it would have been with channels of the right level, all records at once."""
        known = vars(self).setdefault("_known_undone", (None, None))
        if known[0] is channels:
            return known[1]
        found, drift = self.measured, channels.drift_of_pairs()
        if drift is not None and self.noise.resonances is not None:
            moved = self.noise.resonances.moved(self.frequency, drift.expand(found.shape[1:]))
            found = found + (moved if self.sign is None else moved * self.sign)
        found = found / channels.level_of_pairs()
        vars(self)["_known_undone"] = (channels, found)
        return found

    def _drifting(self, channels: OfChannels) -> Complex[Tensor, "n_frequency n_response n_reference"] | None:
        """What a drift more makes of FRFs whose records are read as one test; None where none was taken off.

        With it a way is judged by what it does: the model's resonances are not the measured ones before its end.
        """
        drift = channels.drift_of_pairs()
        if drift is None or self.noise.resonances is None or self.gain_is_unknown:
            return None
        whole = drift.expand(self.measured.shape[1:])
        moved = [self.noise.resonances.moved(self.frequency, whole + step) for step in (STEP, -STEP)]
        found = (moved[1] - moved[0]) / (2 * STEP)
        return (found if self.sign is None else found * self.sign) / channels.level_of_pairs()

    @property
    def variance(self) -> Float[Tensor, "n_frequency n_response n_reference"]:
        """Of the real and of the imaginary part: noise and model."""
        floor = 1e-12 * self.measured.abs().square().mean(0)
        of_model = 0.0 if self.model_variance is None else self.model_variance
        return self.noise.std.square() + of_model + floor

    def predict(self, model: PlateModel, theta: Tensor, level: int | None = None) -> Tensor:
        """FRFs of the measured channels, at the fitted level where the measurement has none.

        At a wide level they are those beside the frequency axis.
        """
        frequency, decay = self.lines(level)
        return self._at_level_of(self.seen(level), model.frf(theta, frequency, decay=decay, check=False))

    def lines(self, level: int | None = None) -> tuple[Float[Tensor, " n_line"], float | Float[Tensor, " n_line"]]:
        """Where a level looks: frequencies [Hz] and σ of s = iω + σ [1/s]."""
        if level is None or level == self.levels - 1:
            return self.frequency, 0.0
        return self.smoothing.levels[level][:2]

    def seen(self, level: int | None = None) -> Complex[Tensor, "n_line n_response n_reference"]:
        """What was measured, as a level looks at it."""
        if level is None or level == self.levels - 1:
            return self.measured
        seen = self.smoothing.levels[level].measured
        return seen if self.sign is None else seen * self.sign

    def rearranged(self, prediction: Tensor, model: PlateModel, effect: Effect, level: int) -> Tensor | None:
        """The same FRFs in other places or with other signs: nothing has to be solved."""
        found = model.rearranged(prediction, effect)
        return None if found is None else self._at_level_of(self.seen(level), found)

    def _at_level_of(self, measured: Tensor, found: Tensor) -> Tensor:
        """FRFs times one factor, where the measurement's level is unknown."""
        return found * self._gain(measured, found)[..., None, None, None] if self.gain_is_unknown else found

    def gain_of(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> float:
        """What brings a model to the level of the measurement."""
        return float(self._gain(self.measured, model.frf(theta, self.frequency)))

    def at_level(
        self,
        model: PlateModel,
        theta: Float[Tensor, " n_parameter"],
        change: Complex[Tensor, "n_change n_line n_response n_reference"],
        level: int | None = None,
    ) -> Complex[Tensor, "n_change n_line n_response n_reference"]:
        """What changes of a model's FRFs are where the measurement has no level of its own: this moves with them.

        Of g H, g = Σ w Re(H* y) / Σ w |H|², the change is g dH + dg H: a peak that moves moves the level of all others.

        Args:
            model: whose FRFs change.
            theta: its parameters.
            change: dH, each alone.
            level: of the residuals.
        """
        if not self.gain_is_unknown:
            return change
        measured, (frequency, decay) = self.seen(level), self.lines(level)
        found = model.frf(theta, frequency, decay=decay)
        gain, weight = self._gain(measured, found), self._weight_of_level(measured)
        square = (weight * found.abs().square()).sum((-3, -2, -1)).clamp(min=1e-300)
        toward = (change.conj() * (measured - 2 * gain * found)).real
        return gain * change + ((weight * toward).sum((-3, -2, -1)) / square)[:, None, None, None] * found

    def _weight_of_level(self, measured: Tensor) -> Float[Tensor, "n_response n_reference"]:
        known = self._known_weights.get(id(measured))
        if known is None or known[0] is not measured:
            weight = torch.where(self.fitted, 1 / measured.abs().square().sum(0).clamp(min=1e-300), 0.0)
            if len(self._known_weights) >= self.levels:
                self._known_weights.clear()
            known = measured, weight
            if not transformed():
                self._known_weights[id(measured)] = known
        return known[1]

    @functools.cached_property
    def _known_weights(self) -> dict[int, tuple[Tensor, Tensor]]:
        """Of what was measured, as each level sees it."""
        return {}

    def _gain(self, measured: Tensor, found: Tensor) -> Tensor:
        weight = self._weight_of_level(measured)
        above = (weight * (found.conj() * measured).real).sum((-3, -2, -1))
        below = (weight * found.abs().square()).sum((-3, -2, -1))
        return above / below.clamp(min=1e-300)

    def residual(self, prediction: Tensor, level: int) -> Tensor:
        """Deviations of the fitted FRFs at a wide level, over their size around each line."""
        off = (self.seen(level) - prediction) * self.smoothing.levels[level].scale
        return torch.view_as_real(off[..., self.fitted] @ self._mix).flatten(-3)

    def signs(
        self, prediction: Complex[Tensor, "n_member n_frequency n_response n_reference"]
    ) -> tuple[Float[Tensor, "n_response n_reference"], float]:
        """Signs of the FRFs at which the best of some predictions comes nearest, and how near: at the widest level.

        Args:
            prediction: of several members, at the lines of that level.

        Returns:
            1 or −1 of each FRF; and the sum of squares with these signs over the least one with all of them 1.
        """
        scale = self.fitted * self.smoothing.levels[0].scale
        measured, model = (self.seen(0) * scale).flatten(1), (prediction * scale).flatten(-2)
        both = measured.abs().square().sum(0) + model.abs().square().sum(-2)
        product = 2 * (measured.conj() * model).real.sum(-2)
        best = (both - product.abs()).sum(-1).argmin()
        turned = (both - product.abs()).sum(-1)[best] / (both - product).sum(-1).amin().clamp(min=1e-300)
        sign = torch.where(product[best] < 0, -1.0, 1.0).to(self.frequency)
        return sign.unflatten(0, self.measured.shape[1:]), float(turned)

    def expected_gap(self, model: PlateModel, theta: Float[Tensor, " n_parameter"], marginal: Marginal) -> float:
        """What noise and nuisances, as large as was said, together make the gap of the fitted FRFs.

        Args:
            model: in a basis.
            theta: its parameters.
            marginal: beside it. Where that holds what the model as such leaves, noise and nuisances are found anew.
        """
        if self.by_noise is not None:
            return self.by_noise.expected_gap(model, theta, self.by_noise.marginal(as_it_is_meant(model), theta))
        share = self.share[:, None, None]
        size = (share * self.measured.abs().square()).sum(0).clamp(min=1e-300)
        each = ((share * marginal.power()).sum(0) / size).sqrt()
        return float(each[self.fitted].mean())

    def gap(self, prediction: Tensor, heldout: bool = False) -> Tensor:
        """Mean over FRFs of ‖measured − model‖ / ‖measured‖."""
        each = self.gaps(prediction)
        which = (self.heldout & self.measurement.measured) if heldout else self.fitted
        return each[..., which].mean(-1)

    @property
    def floor(self) -> float:
        """What noise alone makes the gap."""
        return self.noise.floor

    def gaps(self, prediction: Tensor) -> Float[Tensor, "*batch n_response n_reference"]:
        """The gap of each FRF."""
        root = self.share.sqrt()[:, None, None]
        size = (root * self.measured).norm(dim=0).clamp(min=1e-300)
        return (root * (self.measured - prediction)).norm(dim=-3) / size
