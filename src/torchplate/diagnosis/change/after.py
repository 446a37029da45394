"""The test after: fits of what may have changed, all else as the reference says."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.images import images
from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.hypothesis import Hypothesis
from torchplate.diagnosis.change.reference import Reference
from torchplate.diagnosis.change.settling import End, Settling, as_known
from torchplate.diagnosis.judged import Fit, judged_beside
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Problem, widely
from torchplate.discrepancy import OfChannels
from torchplate.model import PlateModel


@dataclass(frozen=True, eq=False)
class After(Settling):
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
        beat: float = math.inf,
    ) -> "Ended":
        """The best of some starts, at the sharp level.

        Args:
            changes: in the model.
            starts: values of the parameters that have changed, the best first.
            begun: nuisances from which it begins; None for none.
            hopeless: misfit from which on a way is not followed to its end [-].
            beat: `Nuisances.held` of another: a way whose drift settles too slowly to get there is left.
        """
        fitting = self.builder.target.settings.fitting
        one = self.hypothesis(changes, starts[:1])
        names = one.frozen.names
        places = torch.stack([_place(one.frozen, start, self.reference.values) for start in starts or [{}]])
        channels, drift = (None, None) if begun is None else (begun.channels, begun.drift)
        ends = []
        for place in places[: len(places) if names else 1]:
            ends.append(self._sharply(one, self.judged(one, place, channels, drift), hopeless, n_turn=1))
        ends = self._distinct(ends)
        if ends[0].fit.reduced_misfit > hopeless:
            return self._ended(ends[0])
        if begun is None:
            ends[0] = self._sharply(one, ends[0], hopeless)
            # A drift is put in once what has changed is nearly where it belongs: before, it would stand in for it.
            # Channels that have taken on what a drift leaves hold it where it is: it is gone on from both.
            ends = sorted([ends[0], *self._drifting(one, ends[0])], key=lambda end: end.held)
        settled: list[End] = []
        for end in ends:
            lowest = min((other.held for other in settled), default=beat)
            settled.append(self._sharply(one, end, drifts=True, beat=min(beat, lowest)))
        best = min(settled, key=lambda end: end.fit.cost)
        if not names:
            return self._ended(best)
        for _ in range(self.reference.settings.n_turn - 1):
            # In a basis of where it has come to.
            values = dict(zip(names, best.fit.theta.tolist(), strict=True))
            there = self.taken_off_at(changes, values)
            anew = there.hypothesis(changes, [values])
            begin = there.judged(anew, best.place, best.channels, best.drift)
            again = there._sharply(anew, begin, drifts=True, beat=beat)
            moved = float((again.place - best.place).abs().max())
            fallen = best.fit.cost - again.fit.cost
            best = again
            if moved < self.reference.settings.rest or abs(fallen) < fitting.little:
                break
        return self._ended(best)

    def _distinct(self, ends: Sequence[End]) -> list[End]:
        """Ends that lie apart, the most probable first."""
        same = self.builder.target.settings.searching.same
        kept: list[End] = []
        for end in sorted(ends, key=lambda end: end.fit.cost):
            if all(len(end.place) and float((end.place - other.place).abs().max()) > same for other in kept):
                kept.append(end)
        return kept

    def _drifting(self, one: Hypothesis, here: End) -> list[End]:
        """The same about a drift of all modes alike, where there is one that is more probable than none.

        Beside a light damping two kelvin are more than a peak is wide: no least squares reaches there from where
        nothing has drifted. It is found along a line, by parabolas, before channels have taken on what it leaves.
        """
        settings, little = self.reference.settings, self.builder.target.settings.fitting.little
        along, channels = torch.zeros_like(here.put_in), here.at_their_marks
        along[0] = 1 / settings.drift_all

        marginal = self.judged(one, here.place, channels, 0.0 * along).marginal

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
        return [self.judged(one, here.place, channels, best[1] * along)] if none[0] - best[0] >= little else []

    def _sharply(
        self,
        one: Hypothesis,
        here: End,
        hopeless: float = math.inf,
        drifts: bool = False,
        beat: float = math.inf,
        n_turn: int | None = None,
    ) -> End:
        """Least squares beside nuisances as they are, then these anew beside what has changed, in turns.

        How the reference's uncertainty shows changes with what has changed, which no part of the way knows: a part may
        end less probable than it began, and is then gone half as far, and half again. A likelihood about nuisances that
        are not what it says of them is not to be compared, lower or not: what counts is where they have settled. The
        plate's drift stays as it is, and what it may be beyond that linear, unless it is to settle too.

        Args:
            one: the hypothesis.
            here: from where.
            hopeless: misfit from which on a way is not followed to its end [-].
            drifts: whether the drift is to settle.
            beat: −2 ln p of another end: a drift that settles too slowly to get there need not.
            n_turn: at most; None for as many as are usual.
        """
        target, fitting = self.builder.target, self.builder.target.settings.fitting
        for turn in range(n_turn or self.reference.settings.n_turn):
            before, begun, last = here.fit.cost, here, here.held
            if len(here.place):
                problem = Problem(self.builder, here.about.reduced, {}, here.marginal)
                to, half, _ = problem.descend(here.place[None], target.levels - 1, fitting.n_iteration)
                worth_it = here.fit.square - 2 * float(half[0]) >= fitting.little
                for part in fitting.parts if worth_it else ():
                    there = self.judged(one, torch.lerp(here.place, to[0], part), here.channels, here.drift)
                    if there.fit.cost < before:
                        here = there
                        break
            if here.fit.reduced_misfit > hopeless or (turn and here is begun):
                break
            fallen = before - here.fit.cost
            here = self.resting(one, here, beat, from_both_sides=not turn) if drifts else self.settled(one, here)
            if fallen < fitting.little or (drifts and here.held - fitting.hoped * max(0.0, last - here.held) > beat):
                break
        return here

    def _ended(self, end: End) -> "Ended":
        """What others need of an end, with what the data say of each parameter; columns of nuisances are not held."""
        one = end.about
        said = judged_beside(self.builder, one.frozen, one.reduced, {}, end.place, end.beside)
        return Ended(as_known(said), Nuisances(end.channels, end.drift, end.held))


class Nuisances(NamedTuple):
    """What a fit has found of what no change is.

    Attributes:
        channels: what each has of its own in this test, as it was judged; None for nothing.
        drift: of the plate since the reference, in standard deviations; None for none.
        held: −2 ln of the probability of the residuals and of these together.
    """

    channels: OfChannels | None
    drift: Float[Tensor, " n_drift"] | None
    held: float


class Ended(NamedTuple):
    """A fit, and what it has found of what no change is.

    Attributes:
        fit: it.
        nuisances: these.
    """

    fit: Fit
    nuisances: Nuisances


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
