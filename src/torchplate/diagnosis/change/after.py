"""The test after: fits of what may have changed, all else as the reference says.

A drift of a part of a peak's width is not linear, and what a linear one leaves looks like a change. The drift is taken
about where it is most probable, with what the channels have of their own, beside each hypothesis and beside none.

Source: Lindstrom and Bates, Biometrics 46 (1990) 673, for linearising about the nuisances as they are found.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.hypothesis import Hypotheses, Hypothesis
from torchplate.diagnosis.change.images import images
from torchplate.diagnosis.change.reference import Reference
from torchplate.diagnosis.judged import Beside, Fit, judged_beside
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Problem, widely
from torchplate.discrepancy import Marginal, OfChannels
from torchplate.model import PlateModel


@dataclass(frozen=True, eq=False)
class After(Hypotheses):
    """The test after: hypotheses of what may have changed, fitted to it."""

    def down(
        self, changes: Sequence[Change], starts: Sequence[Mapping[str, float]]
    ) -> tuple[tuple[Mapping[str, float], ...], float]:
        """Where some starts end at the wide levels, the best first, and what that leaves.

        Args:
            changes: in the model.
            starts: values of what is searched, the best first.
        """
        one = self.hypothesis(changes, starts[:1])
        if not one.frozen.names:
            problem, empty = Problem(self.builder, one.reduced, {}), one.frozen.known.new_zeros(1, 0)
            left = problem.residual(empty, self.builder.target.levels - 2).square().sum()
            return (({},), 0.5 * float(left))
        places = torch.stack([_place(one.frozen, start, self.reference.values) for start in starts])
        settings, problem = self.builder.target.settings, Problem(self.builder, one.reduced, {})
        n_best = settings.selecting.n_best
        places, left = widely(problem, places, n_best)
        turned = images(one.frozen, places[0], changes[-1].label) if changes else places[:0]
        if len(turned):
            others, left_by_others = widely(problem, turned, n_best)
            places, left = torch.cat([places, others]), torch.cat([left, left_by_others])
        kept: list[int] = []
        for k in left.argsort().tolist():
            if all(float((places[k] - places[j]).abs().max()) > settings.searching.same for j in kept):
                kept.append(k)
        rows = one.frozen.space.to_si(places[kept[:n_best]]).tolist()
        return tuple(dict(zip(one.frozen.names, row, strict=True)) for row in rows), float(left[kept[0]])

    def fit(
        self,
        changes: Sequence[Change],
        starts: Sequence[Mapping[str, float]],
        begun: "Nuisances | None" = None,
        hopeless: float = math.inf,
    ) -> "Ended":
        """The best of some starts, at the sharp level.

        Args:
            changes: in the model.
            starts: values of the parameters that have changed, the best first.
            begun: nuisances from which it begins; None for none.
            hopeless: misfit from which on a way is not followed to its end [-].
        """
        fitting = self.builder.target.settings.fitting
        one = self.hypothesis(changes, starts[:1])
        names = one.frozen.names
        places = torch.stack([_place(one.frozen, start, self.reference.values) for start in starts or [{}]])
        channels, drift = (None, None) if begun is None else begun
        ends = []
        for place in places[: len(places) if names else 1]:
            ends.append(self._sharply(one, place, channels, drift, hopeless, drifts=begun is not None))
        best = min(ends, key=lambda end: end.fit.cost)
        if best.fit.reduced_misfit > hopeless:
            return self._ended(best)
        if begun is None:
            # A drift is put in once what has changed is nearly where it belongs: before, it would stand in for it.
            # Channels that have taken on what a drift leaves hold it where it is: it is gone on from both.
            begun_at = [best, *self._drifting(one, best)]
            ended: list[End] = []
            for end in begun_at:
                beat = min((other.held for other in ended), default=math.inf)
                ended.append(self._sharply(one, end.place, end.channels, end.drift, drifts=True, beat=beat))
            best = min(ended, key=lambda end: end.fit.cost)
        if not names:
            return self._ended(best)
        for _ in range(self.reference.settings.n_turn - 1):
            # In a basis of where it has come to.
            values = dict(zip(names, best.fit.theta.tolist(), strict=True))
            there = self.taken_off_at(changes, values)
            again = there._sharply(
                there.hypothesis(changes, [values]), best.place, best.channels, best.drift, drifts=True
            )
            moved = float((again.place - best.place).abs().max())
            fallen = best.fit.cost - again.fit.cost
            best = again
            if moved < self.reference.settings.rest or abs(fallen) < fitting.little:
                break
        return self._ended(best)

    def _drifting(self, one: Hypothesis, here: "End") -> list["End"]:
        """The same about a drift of all modes alike, where there is one that is more probable than none.

        Beside a light damping two kelvin are more than a peak is wide: no least squares reaches there from where
        nothing has drifted. It is found along a line, by parabolas, before channels have taken on what it leaves.
        """
        settings, little = self.reference.settings, self.builder.target.settings.fitting.little
        along, channels = torch.zeros_like(here.put_in), here.at_their_marks
        along[0] = 1 / settings.drift_all

        marginal = self._judged(one, here.place, channels, 0.0 * along).marginal

        def at(drift: float) -> tuple[float, float]:
            return self._by_columns(one, here.place, marginal, channels, drift * along)[0], drift

        none = best = at(0.0)
        step = settings.drift_mode
        for _ in range(settings.n_turn):
            before, middle = best
            sides = [at(middle - step), at(middle + step)]
            bend = sides[0][0] + sides[1][0] - 2 * before
            off = 0.5 * (sides[0][0] - sides[1][0]) / bend if bend > 0 else math.copysign(2, sides[0][0] - sides[1][0])
            best = min(best, *sides, at(middle + step * max(-2.0, min(2.0, off))))
            if before - best[0] < little:
                break
            step = step if abs(off) > 1 else 0.5 * step
        return [self._judged(one, here.place, channels, best[1] * along)] if none[0] - best[0] >= little else []

    def _sharply(
        self,
        one: Hypothesis,
        place: Float[Tensor, " n"],
        channels: OfChannels | None = None,
        drift: Float[Tensor, " n_drift"] | None = None,
        hopeless: float = math.inf,
        drifts: bool = False,
        beat: float = math.inf,
    ) -> "End":
        """Least squares beside nuisances as they are, then these anew beside what has changed, in turns.

        How the reference's uncertainty shows changes with what has changed, which no part of the way knows: a part may
        end less probable than it began, and is then gone half as far, and half again. A likelihood about nuisances that
        are not what it says of them is not to be compared, lower or not: what counts is where they have settled. The
        plate's drift stays as it is, and what it may be beyond that linear, unless it is to settle too.

        Args:
            one: the hypothesis.
            place: from where.
            channels: what each has of its own; None for nothing.
            drift: of the plate since the reference; None for none.
            hopeless: misfit from which on a way is not followed to its end [-].
            drifts: whether the drift is to settle.
            beat: −2 ln p of another end: a drift that settles too slowly to get there need not.
        """
        target, fitting = self.builder.target, self.builder.target.settings.fitting
        here = self._judged(one, place, channels, drift)
        for turn in range(self.reference.settings.n_turn):
            before, begun = here.fit.cost, here
            if len(place):
                problem = Problem(self.builder, here.about.reduced, {}, here.marginal)
                to, _, _ = problem.descend(here.place[None], target.levels - 1, fitting.n_iteration)
                for part in fitting.parts:
                    there = self._judged(one, torch.lerp(here.place, to[0], part), here.channels, here.drift)
                    if there.fit.cost < before:
                        here = there
                        break
            if here.fit.reduced_misfit > hopeless or (turn and here is begun):
                break
            fallen = before - here.fit.cost
            here = self._resting(one, here, beat, from_both_sides=not turn) if drifts else self._settled(one, here)
            if fallen < fitting.little:
                break
        return here

    def _settled(self, one: Hypothesis, here: "End") -> "End":
        """The same about channels that are what the residuals say of them."""
        for _ in range(self.reference.settings.n_turn):
            before, here = here, self._judged(one, here.place, here.from_each_other, here.drift)
            if abs(here.fit.cost - before.fit.cost) < self.builder.target.settings.fitting.little:
                break
        return here

    def _resting(self, one: Hypothesis, here: "End", beat: float, from_both_sides: bool) -> "End":
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
            there = self._judged(one, here.place, here.at_their_marks, here.put_in + sign * beside)
            found = min(found, self._rested(one, there, min(beat, found.held)), key=lambda end: end.held)
        return found

    def _rested(self, one: Hypothesis, here: "End", beat: float = math.inf) -> "End":
        """The same from one place, by Levenberg's steps, until it rests.

        Args:
            one: the hypothesis.
            here: where from.
            beat: −2 ln p of another end: a way that falls too slowly to get there is left.
        """
        settings, fitting = self.reference.settings, self.builder.target.settings.fitting
        here, damping = self._judged(one, here.place, here.channels or here.at_their_marks, here.put_in), 0.0
        held = here.held
        for turn in range(settings.n_settled):
            if turn >= settings.n_turn and self._is_lost(here):
                break
            before, lowest = here, held
            there = self._judged(one, before.place, *self._ahead(one, before))
            if (there_held := there.held) < lowest:
                here, held = there, there_held
            else:
                for _ in range(settings.n_damped):
                    there = self._judged(one, before.place, *self._a_step(before.marginal, before.off, damping))
                    if (there_held := there.held) < lowest:
                        here, held, damping = there, there_held, 0.1 * damping
                        break
                    damping = max(1.0, 10 * damping)
            fallen = lowest - held
            if fallen < fitting.little or held - fitting.hoped * fallen > beat:
                break
        return here

    def _is_lost(self, here: "End") -> bool:
        """Whether far more than noise is left: a drift that was right would not leave it."""
        return here.fit.reduced_misfit > self.builder.target.settings.screening.nearly_right

    def _a_step(
        self, marginal: Marginal, off: Complex[Tensor, "n_frequency n_response n_reference"], damping: float
    ) -> tuple[OfChannels | None, Float[Tensor, " n_drift"]]:
        """Channels and drift after one of Levenberg's steps."""
        drift, channels = marginal.towards(off, damping)
        return None if channels is None else channels.within(self.builder.target.settings.fitting.farthest), drift

    def _ahead(self, one: Hypothesis, here: "End") -> tuple[OfChannels | None, Float[Tensor, " n_drift"]]:
        """Channels and drift after steps by the columns of where they are, as long as these lead down.

        Columns are what costs: residuals are had in a tenth of the time, and of a part of a peak's width the columns
        hardly change.
        """
        settings, little = self.reference.settings, self.builder.target.settings.fitting.little
        marginal, off, held, damping = here.marginal, here.off, here.held, 0.0
        ahead = (here.channels, here.put_in)
        for _ in range(settings.n_ahead):
            lowest = held
            for _ in range(settings.n_damped):
                to = self._a_step(marginal, off, damping)
                there_held, there, there_off = self._by_columns(one, here.place, here.marginal, *to)
                if there_held < lowest:
                    held, ahead, damping = there_held, to, 0.1 * damping if damping > 1 else 0.0
                    marginal, off = there, there_off
                    break
                damping = max(1.0, 10 * damping)
            if lowest - held < little:
                break
        return ahead

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

    def _ended(self, end: "End") -> "Ended":
        """What others need of an end, with what the data say of each parameter; columns of nuisances are not held."""
        one, fit = end.about, end.fit
        said = judged_beside(self.builder, one.frozen, one.reduced, {}, end.place, fit.beside)
        return Ended(_as_the_specimen(said), Nuisances(end.channels, end.drift))

    def _judged(
        self,
        one: Hypothesis,
        place: Float[Tensor, " n"],
        channels: OfChannels | None,
        drift: Float[Tensor, " n_drift"] | None = None,
    ) -> "End":
        """A hypothesis at a place, about channels and a drift as they are taken to be."""
        target = self.builder.target
        about = self.moved(one, channels, drift)
        of_fit = Beside(lambda: self.marginal(about, one.frozen.space.to_si(place)))
        # What the data say of each parameter is asked for where a fit has ended: here a likelihood is enough.
        found = judged_beside(self.builder, one.frozen, about.reduced, {}, place, of_fit, said=False)
        found, marginal = _as_the_specimen(found), of_fit()
        off = target.off(found.expected, marginal.about)
        seen = marginal.channels(marginal.residual(off))
        if seen is not None:
            seen = seen.within(target.settings.fitting.farthest)
        return End(found, place, channels, seen, marginal, about, drift, off)


class Nuisances(NamedTuple):
    """What a fit has found of what no change is.

    Attributes:
        channels: what each has of its own in this test, as it was judged; None for nothing.
        drift: of the plate since the reference, in standard deviations; None for none.
    """

    channels: OfChannels | None
    drift: Float[Tensor, " n_drift"] | None


class Ended(NamedTuple):
    """A fit, and what it has found of what no change is.

    Attributes:
        fit: it.
        nuisances: these.
    """

    fit: Fit
    nuisances: Nuisances


class End(NamedTuple):
    """Where a fit has come to.

    Attributes:
        fit: there.
        place: on the unit cube.
        channels: what each of them has of its own, as it was judged.
        seen: what the residuals there say of them.
        marginal: noise and nuisances, beside which it was judged.
        about: the hypothesis, sensors and hits off their marks.
        drift: of the plate, about which it was judged; None for none.
        off: residuals.
    """

    fit: Fit
    place: Float[Tensor, " n"]
    channels: OfChannels | None
    seen: OfChannels | None
    marginal: Marginal
    about: Hypothesis
    drift: Float[Tensor, " n_drift"] | None
    off: Complex[Tensor, "n_frequency n_response n_reference"]

    @property
    def put_in(self) -> Float[Tensor, " n_drift"]:
        """The drift, 0 where there is none."""
        return self.about.half.new_zeros(self.about.n_drift) if self.drift is None else self.drift

    @property
    def held(self) -> float:
        """−2 ln of the probability of the residuals and of what was put in together."""
        return self.marginal.held(self.off)

    @property
    def from_each_other(self) -> OfChannels | None:
        """What the residuals say of the channels, of their drifts those from each other."""
        return None if self.seen is None else self.seen.from_each_other()

    @property
    def at_their_marks(self) -> OfChannels | None:
        """Channels put in as they are meant."""
        return None if self.seen is None else self.seen.none()


def _as_the_specimen(fit: Fit) -> Fit:
    """The specimen is the reference's in any case: what it makes expected is what is predicted."""
    return fit._replace(prediction=fit.expected, gap=fit.left, as_found=True)


def _place(model: PlateModel, start: Mapping[str, float], values: Mapping[str, float]) -> Float[Tensor, " n"]:
    middle = model.space.to_si(torch.full((len(model.names),), 0.5).to(model.known)).tolist()
    here = dict(zip(model.names, middle, strict=True)) | {k: v for k, v in values.items() if k in model.names}
    theta = torch.tensor([(here | dict(start))[name] for name in model.names]).to(model.known)
    return model.space.to_cube(theta).clamp(1e-3, 1 - 1e-3)


def against_the_next(builder: ModelBuilder, reference: Reference) -> ModelBuilder:
    """A builder whose test is weighed by what the model leaves of the reference too.

    What no section and no mode explains there, it does not explain here either. The mesh error is in both. So is what
    the channels were taken to be off their marks and levels beyond what was said.
    """
    target = builder.target
    scale = max(1.0, reference.noise_scale)
    noise = replace(target.noise, std=scale * target.noise.std, floor=target.noise.floor)
    nothing = torch.zeros_like(target.frequency)
    given = target.imperfections
    names = {field.name for field in fields(given)}
    larger = {name: size * given.std(name) for name, size in reference.sizes.items() if name in names and size > 1.0}
    imperfections = replace(given, **larger)
    plain = target.at_all_lines
    return builder.against(replace(target, noise=noise, mesh_shift=nothing, imperfections=imperfections, whole=plain))
