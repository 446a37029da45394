"""Where a hypothesis has come to, with the channels and the drift of the plate that are most probable there.

A drift of a part of a peak's width is not linear, and what a linear one leaves looks like a change. The drift is taken
about where it is most probable, with what the channels have of their own, beside each hypothesis and beside none.

Source: Lindstrom and Bates, Biometrics 46 (1990) 673, for linearising about the nuisances as they are found.
"""

import functools
import math
from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.change.hypothesis import Hypotheses, Hypothesis
from torchplate.diagnosis.judged import Beside, Fit, judged_beside
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.discrepancy import Marginal, OfChannels


@dataclass(frozen=True, eq=False)
class End:
    """Where a fit has come to.

    Attributes:
        builder: of the models, against the test.
        about: the hypothesis, sensors and hits off their marks.
        place: on the unit cube.
        channels: what each of them has of its own, as it is judged.
        drift: of the plate, about which it is judged; None for none.
        beside: noise and nuisances, beside which it is judged.
        marginal: these.
        off: residuals.
    """

    builder: ModelBuilder
    about: Hypothesis
    place: Float[Tensor, " n"]
    channels: OfChannels | None
    drift: Float[Tensor, " n_drift"] | None
    beside: Beside
    marginal: Marginal
    off: Complex[Tensor, "n_frequency n_response n_reference"]

    @functools.cached_property
    def fit(self) -> Fit:
        """There, without what the data say of each parameter: a likelihood is enough on the way."""
        one = self.about
        return as_known(judged_beside(self.builder, one.frozen, one.reduced, {}, self.place, self.beside, said=False))

    @functools.cached_property
    def held(self) -> float:
        """−2 ln of the probability of the residuals and of what was put in together."""
        return self.marginal.held(self.off)

    @functools.cached_property
    def seen(self) -> OfChannels | None:
        """What the residuals there say of the channels."""
        found = self.marginal.channels(self.marginal.residual(self.off))
        return None if found is None else found.within(self.builder.target.settings.fitting.farthest)

    @property
    def put_in(self) -> Float[Tensor, " n_drift"]:
        """The drift, 0 where there is none."""
        return self.about.half.new_zeros(self.about.n_drift) if self.drift is None else self.drift

    @property
    def from_each_other(self) -> OfChannels | None:
        """What the residuals say of the channels, of their drifts those from each other."""
        return None if self.seen is None else self.seen.from_each_other()

    @property
    def at_their_marks(self) -> OfChannels | None:
        """Channels put in as they are meant."""
        return None if self.seen is None else self.seen.none()


def as_known(fit: Fit) -> Fit:
    """The specimen is the reference's in any case: what it makes expected is what is predicted."""
    return fit._replace(prediction=fit.expected, gap=fit.left, as_found=True)


@dataclass(frozen=True, eq=False)
class Settling(Hypotheses):
    """Hypotheses of what may have changed, and what is most probable of channels and drift beside each."""

    def judged(
        self,
        one: Hypothesis,
        place: Float[Tensor, " n"],
        channels: OfChannels | None,
        drift: Float[Tensor, " n_drift"] | None = None,
    ) -> End:
        """A hypothesis at a place, about channels and a drift as they are taken to be."""
        about = self.moved(one, channels, drift)
        theta = one.frozen.space.to_si(place)
        beside = Beside(lambda: self.marginal(about, theta))
        marginal = beside()
        off = self.builder.target.off(self.builder.predict(about.reduced, theta), marginal.about)
        return End(self.builder, about, place, channels, drift, beside, marginal, off)

    def settled(self, one: Hypothesis, here: End) -> End:
        """The same about channels that are what the residuals say of them, as long as that is more probable.

        Far off their marks they are not linear, and what is said of them anew may lead away for good.
        """
        for _ in range(self.reference.settings.n_turn):
            before, there = here, self.judged(one, here.place, here.from_each_other, here.drift)
            # What is put in and what is integrated are not to be compared.
            if before.channels is not None and there.held >= before.held:
                break
            here = there
            if abs(here.fit.cost - before.fit.cost) < self.builder.target.settings.fitting.little:
                break
        return here

    def resting(self, one: Hypothesis, here: End, beat: float, from_both_sides: bool) -> End:
        """The same about a drift and channels that are most probable together; `beat` is that of `_rested`.

        Where no step from there is taken, also from a drift of all modes that is a standard deviation less and more, if
        `from_both_sides` says so.
        """
        found = self._rested(one, here, beat)
        if found.held < here.held or not from_both_sides or not one.n_drift or self._is_lost(found):
            return found
        beside = torch.zeros_like(here.put_in)
        beside[0] = 1.0
        for sign in (-1, 1):
            there = self.judged(one, here.place, here.at_their_marks, here.put_in + sign * beside)
            found = min(found, self._rested(one, there, min(beat, found.held)), key=lambda end: end.held)
        return found

    def _rested(self, one: Hypothesis, here: End, beat: float = math.inf) -> End:
        """The same from one place, by steps with the columns of where it is, until it rests.

        Args:
            one: the hypothesis.
            here: where from.
            beat: −2 ln p of another end: a way that falls too slowly to get there is left.
        """
        settings, fitting = self.reference.settings, self.builder.target.settings.fitting
        if here.channels is None or here.drift is None:
            here = self.judged(one, here.place, here.channels or here.at_their_marks, here.put_in)
        before, damping = here, 0.0
        for turn in range(settings.n_settled):
            if turn >= settings.n_turn and self._is_lost(here, before):
                break
            before = here
            here, damping = self._a_step(one, before, damping)
            fallen = before.held - here.held
            if fallen < fitting.little or here.held - fitting.hoped * fallen > beat:
                break
        return here

    def _a_step(self, one: Hypothesis, here: End, damping: float) -> tuple[End, float]:
        """Where the columns of one end lead, or a part of the way, or a shorter step; the same where none leads down.

        They know nothing of how the uncertainty of what is left changes on the way. Of a way that does not lead down it
        is taken to change evenly: a parabola, the fall that was promised for its bend, says where it is lowest. Where
        that is nowhere, the way was too long for its columns, and damped steps are tried, then and from then on.

        Args:
            one: the hypothesis.
            here: where from.
            damping: of the last step; 0 where none was damped.
        """
        settings, little = self.reference.settings, self.builder.target.settings.fitting.little
        if not damping:
            promised, channels, drift = self._ahead(one, here)
            if promised < little:
                return here, damping
            there = self.judged(one, here.place, channels, drift)
            if there.held < here.held:
                return there, damping
            part = 0.5 * (1 - (there.held - here.held) / promised)
            if part > 0 and promised * part**2 >= little:
                if channels is not None and here.channels is not None:
                    channels = here.channels.towards(channels, part)
                there = self.judged(one, here.place, channels, torch.lerp(here.put_in, drift, part))
                if there.held < here.held:
                    return there, damping
        for _ in range(settings.n_damped):
            channels, drift = self._towards(here.marginal, here.off, damping)
            promised = here.held - self._by_columns(one, here.place, here.marginal, channels, drift)[0]
            if damping and 0 <= promised < little:
                break
            there = self.judged(one, here.place, channels, drift)
            if there.held < here.held:
                return there, 0.1 * damping
            damping = max(1.0, 10 * damping)
        return here, damping

    def _is_lost(self, here: End, before: End | None = None) -> bool:
        """Whether far more than noise is left, no longer falling: a drift that was right would not leave it.

        Args:
            here: where it has come to.
            before: the step before; None where it has ended.
        """
        settings, left = self.builder.target.settings, here.fit.reduced_misfit
        still = before is not None and left <= settings.fitting.falling * before.fit.reduced_misfit
        return left > settings.screening.nearly_right and not still

    def _towards(
        self, marginal: Marginal, off: Complex[Tensor, "n_frequency n_response n_reference"], damping: float
    ) -> tuple[OfChannels | None, Float[Tensor, " n_drift"]]:
        """Channels and drift after one of Levenberg's steps."""
        farthest = self.builder.target.settings.fitting.farthest
        drift, channels = marginal.towards(off, damping)
        return None if channels is None else channels.within(farthest), drift.clamp(-farthest, farthest)

    def _ahead(self, one: Hypothesis, here: End) -> tuple[float, OfChannels | None, Float[Tensor, " n_drift"]]:
        """What is lowest by the columns of where one is: the fall until there, channels and drift.

        By Levenberg's steps. Columns are what costs: residuals are had in a tenth of the time, and of a part of a
        peak's width the columns hardly change.
        """
        settings, little = self.reference.settings, self.builder.target.settings.fitting.little
        marginal, off, held, damping = here.marginal, here.off, here.held, 0.0
        channels, drift = here.channels, here.put_in
        for _ in range(settings.n_ahead):
            lowest = held
            for _ in range(settings.n_damped):
                to = self._towards(marginal, off, damping)
                found = self._by_columns(one, here.place, here.marginal, *to)
                if found[0] < lowest:
                    (held, marginal, off), (channels, drift) = found, to
                    damping = 0.1 * damping if damping > 1 else 0.0
                    break
                damping = max(1.0, 10 * damping)
            if lowest - held < little:
                break
        return here.held - held, channels, drift

    def _by_columns(
        self,
        one: Hypothesis,
        place: Float[Tensor, " n"],
        columns: Marginal,
        channels: OfChannels | None,
        drift: Float[Tensor, " n_drift"],
    ) -> tuple[float, Marginal, Complex[Tensor, "n_frequency n_response n_reference"]]:
        """−2 ln p about channels and a drift by the columns that were made about others; these, and residuals."""
        target, about = self.builder.target, self.moved(one, channels, drift)
        expected = self.builder.predict(about.reduced, about.reduced.space.to_si(place))
        found = columns.taken_about(target.about(about.about), drift)
        off = target.off(expected, found.about)
        return found.held(off), found, off
