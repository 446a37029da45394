"""The test after: fits of what may have changed, all else as the reference says.

With q what the reference has told, parameters and specimen, q̂ its mean and R Rᵀ its covariance, the FRFs of the next
test are H(q̂, p) + ∂H/∂q R ξ + nuisances of that test + noise, ξ ~ N(0, I): the reference is one more group of nuisances
whose size is known, about the very model; so is what the modes' shapes leave open of what p does. p is what changed,
and what has a value of its own in each test.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.images import images
from torchplate.diagnosis.change.reference import Reference, all_columns, eigenvalues
from torchplate.diagnosis.change.specimen import ReferenceSpecimens
from torchplate.diagnosis.judged import Beside, Fit, judged_beside
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Problem, widely
from torchplate.discrepancy import Found, Marginal, OfChannels
from torchplate.model import PlateModel, on_mesh

GROUP = "reference"


class Hypothesis(NamedTuple):
    """A model with what may have changed in it, in a basis.

    Attributes:
        whole: in all dofs, mesh error taken off; what the reference has told is searched too.
        frozen: in all dofs, that as numbers.
        specimens: of the reference, in the basis.
        reduced: `frozen` in the basis, as the specimen that was found.
        told: parameters that the reference has told.
        half: R.
        changed: whether anything has.
        about: what the channels have of their own in this test, about which it is; None for nothing.
    """

    whole: PlateModel
    frozen: PlateModel
    specimens: ReferenceSpecimens
    reduced: PlateModel
    told: list[str]
    half: Float[Tensor, "n_all k"]
    changed: bool
    about: Found | None = None


@dataclass(frozen=True, eq=False)
class After:
    """The test after.

    Attributes:
        builder: of its model, against it.
        model: its model with its mesh error taken off, all parameters searched that the config searches.
        reference: what the one before has told, with the drift.
        own: parameters with a value of their own in each test.
    """

    builder: ModelBuilder
    model: PlateModel
    reference: Reference
    own: tuple[str, ...]

    def hypothesis(
        self, changes: Sequence[Change], values: Sequence[Mapping[str, float]] = (), by_element: bool | None = None
    ) -> Hypothesis:
        """A model with some changes in it.

        Args:
            changes: in the order they were found.
            values: of their parameters, members whose modes join the basis.
            by_element: whether elements will differ.
        """
        whole = self.model
        for change in changes:
            whole = change.applied(whole)
        free = [name for change in changes for name in change.frees(whole.names)]
        told, half = self.reference.half([*free, *self.own])
        numbers = {name: self.reference.values[name] for name in told if name in whole.names}
        searched = {name: one for name, one in whole.searched.items() if name not in numbers}
        frozen = whole.replaced(known=whole.known_values | numbers, searched=searched)
        start = {name: 0.5 * (one.low + one.high) for name, one in whole.searched.items()}
        start |= {name: value for name, value in self.reference.values.items() if name in start}
        members = [start | dict(one) for one in values] or [start]
        theta = torch.tensor([[one[name] for name in frozen.names] for one in members]).to(frozen.known)
        plain = self.builder.reduced(frozen, theta, by_element)
        specimens = self.reference.specimens(plain, theta[0])
        reduced = specimens.at(self.reference.shift)
        known = [name for name in told if name in whole.names]
        if len(known) < len(told):
            # A number in the config of this test.
            rows = [told.index(name) for name in known] + list(range(len(told), len(half)))
            half = half[rows]
        return Hypothesis(whole, frozen, specimens, reduced, known, half, bool(changes))

    def marginal(self, one: Hypothesis, theta: Float[Tensor, " n"]) -> Marginal:
        """Noise and nuisances of this test, and what the reference leaves open, beside a member."""
        target = self.builder.target
        plain = target.marginal(one.reduced, theta, one.about, specimen=False)
        model = as_the_specimen(one.whole, one.reduced)
        values = {**one.reduced.as_dict(theta)}
        everything = torch.tensor([values[name] for name in model.names]).to(theta)
        columns = all_columns(self.builder, model, one.specimens, everything, one.told)
        known = columns @ one.half.to(columns)
        if not one.changed:
            return plain.beside(known, GROUP)
        return plain.beside(torch.cat([known, self._shapes(one, theta, columns)], dim=-1), GROUP)

    def _shapes(
        self, one: Hypothesis, theta: Float[Tensor, " n"], columns: Complex[Tensor, "n_f n_response n_reference n_all"]
    ) -> Complex[Tensor, "n_f n_response n_reference n_mode"]:
        """What a change does to each mode is as uncertain as the mode's shape is."""
        reference = self.reference
        before, n_mode = reference.eigenvalue, len(reference.eigenvalue)
        after = eigenvalues(one.reduced, theta)[:n_mode]
        moved = 0.5 * (after.clamp(min=1.0) / before.clamp(min=1.0)).log()
        settings, first = reference.settings, len(one.told) + reference.n_section
        std = settings.shape * reference.missed * moved.abs() / settings.mode_stiffness
        return columns[..., first : first + n_mode] * std.to(columns)

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

    def moved(self, one: Hypothesis, channels: OfChannels | None) -> Hypothesis:
        """The same with sensors and hits where they were found."""
        if channels is None:
            return one
        nothing = one.frozen.known.new_zeros(0)
        about = Found(nothing, nothing[:, None], channels)
        return one._replace(reduced=one.specimens.at(self.reference.shift, channels), about=about)

    def fit(
        self,
        changes: Sequence[Change],
        starts: Sequence[Mapping[str, float]],
        channels: OfChannels | None = None,
        hopeless: float = math.inf,
    ) -> Fit:
        """The best of some starts, at the sharp level.

        Args:
            changes: in the model.
            starts: values of the parameters that have changed, the best first.
            channels: what each has of its own, as far as it is known.
            hopeless: misfit from which on a way is not followed to its end [-].
        """
        fitting = self.builder.target.settings.fitting
        one = self.hypothesis(changes, starts[:1])
        names = one.frozen.names
        places = torch.stack([_place(one.frozen, start, self.reference.values) for start in starts or [{}]])
        ends = []
        for place in places[: len(places) if names else 1]:
            ends.append(self._sharply(one, place, channels, hopeless=hopeless))
        best = min(ends, key=lambda end: end.fit.cost)
        if best.fit.reduced_misfit > hopeless:
            return best.fit
        best = self._drifting(one, best)
        if not names:
            return best.fit
        for _ in range(self.reference.settings.n_turn - 1):
            # In a basis of where it has come to.
            values = dict(zip(names, best.fit.theta.tolist(), strict=True))
            again = self._sharply(self.hypothesis(changes, [values]), best.place, best.channels, best.common)
            moved = float((again.place - best.place).abs().max())
            fallen = best.fit.cost - again.fit.cost
            best = again
            if moved < self.reference.settings.rest or abs(fallen) < fitting.little:
                break
        return best.fit

    def _drifting(self, one: Hypothesis, here: "End") -> "End":
        """The same with the drift that all records have in common put in as it is, where that is more probable.

        Beside a light damping a drift of a third of a peak's half width is nothing linear: what the reference leaves
        open does not reach there, and what it cannot explain looks like a change. It is found along a line, by
        parabolas, with what is known of it beforehand.
        """
        if here.seen is None or not here.seen.drift or "drift" not in (*here.seen.of_response, *here.seen.of_reference):
            return here
        settings, little = self.reference.settings, self.builder.target.settings.fitting.little

        def at(common: float) -> tuple[float, End]:
            assert here.seen is not None
            channels = with_drift(here.channels or here.seen.within(0.0), common - here.common)
            end = self._judged(one, here.place, channels, common)
            return end.fit.cost + (common / settings.drift_all) ** 2, end

        best, step = (here.fit.cost + (here.common / settings.drift_all) ** 2, here), settings.drift_mode
        for _ in range(settings.n_turn):
            before, middle = best[0], best[1].common
            sides = [at(middle - step), at(middle + step)]
            bend = sides[0][0] + sides[1][0] - 2 * before
            off = 0.5 * (sides[0][0] - sides[1][0]) / bend if bend > 0 else math.copysign(2, sides[0][0] - sides[1][0])
            best = min(best, *sides, at(middle + step * max(-2.0, min(2.0, off))), key=lambda one: one[0])
            if before - best[0] < little:
                break
            step = step if abs(off) > 1 else 0.5 * step
        if best[1] is here:
            return here
        return self._sharply(one, best[1].place, best[1].channels, best[1].common)

    def _sharply(
        self,
        one: Hypothesis,
        place: Float[Tensor, " n"],
        channels: OfChannels | None = None,
        common: float = 0.0,
        hopeless: float = math.inf,
    ) -> "End":
        """Least squares beside channels as they are, then the channels anew beside what has changed, in turns.

        How the reference's uncertainty shows changes with what has changed, which no part of the way knows: a part may
        end less probable than it began, and is then gone half as far, and half again. A likelihood about channels that
        are not what it says of them is not to be compared, lower or not: what counts is where they have settled.
        """
        target, fitting = self.builder.target, self.builder.target.settings.fitting
        here = self._judged(one, place, channels, common)
        for _ in range(self.reference.settings.n_turn):
            before = here.fit.cost
            if len(place):
                problem = Problem(self.builder, here.about.reduced, {}, here.marginal)
                to, _, _ = problem.descend(here.place[None], target.levels - 1, fitting.n_iteration)
                for part in fitting.parts:
                    there = self._judged(one, torch.lerp(here.place, to[0], part), here.channels, common)
                    if there.fit.cost < before:
                        here = there
                        break
            if here.fit.reduced_misfit > hopeless:
                break
            fallen = before - here.fit.cost
            for _ in range(self.reference.settings.n_turn):
                settled = self._judged(one, here.place, here.seen, common)
                moved = abs(settled.fit.cost - here.fit.cost)
                here = settled
                if moved < fitting.little:
                    break
            if fallen < fitting.little:
                break
        return here

    def _judged(
        self, one: Hypothesis, place: Float[Tensor, " n"], channels: OfChannels | None, common: float = 0.0
    ) -> "End":
        """A hypothesis at a place, about channels as they are taken to be; `common` is a part of their drifts."""
        target = self.builder.target
        about = self.moved(one, channels)
        of_fit = Beside(lambda: self.marginal(about, one.frozen.space.to_si(place)))
        found, marginal = judged_beside(self.builder, one.frozen, about.reduced, {}, place, of_fit), of_fit()
        # The specimen is the reference's in any case: what it makes expected is what is predicted.
        found = found._replace(prediction=found.expected, gap=found.left)
        seen = marginal.channels(marginal.residual(target.off(found.expected, marginal.about)))
        if seen is not None:
            seen = with_drift(from_each_other(seen.within(target.settings.fitting.farthest)), common)
        return End(found, place, channels, seen, marginal, about, common)


class End(NamedTuple):
    """Where a fit has come to.

    Attributes:
        fit: there.
        place: on the unit cube.
        channels: what each of them has of its own, as it was judged.
        seen: what the residuals there say of them.
        marginal: noise and nuisances, beside which it was judged.
        about: the hypothesis, sensors and hits off their marks.
        common: drift of all records alike, about which it was judged [-].
    """

    fit: Fit
    place: Float[Tensor, " n"]
    channels: OfChannels | None
    seen: OfChannels | None
    marginal: Marginal
    about: Hypothesis
    common: float = 0.0


def from_each_other(channels: OfChannels) -> OfChannels:
    """The same, its drifts those of the records from each other.

    What all records have in common is a drift of the plate, which `reference` knows the size of. Taken for the
    channels' own it is neither's: each turn finds a little more of it, and the channels never come to rest.
    """
    found = {}
    for side, names in (("response", channels.of_response), ("reference", channels.of_reference)):
        if "drift" in names:
            values, at = getattr(channels, side).clone(), names.index("drift")
            # Of a channel that no fit sees nothing is known, and it is where it was.
            seen = values[:, at] != 0
            values[seen, at] -= values[seen, at].mean()
            found[side] = values
    return channels._replace(**found)


def with_drift(channels: OfChannels, drift: float) -> OfChannels:
    """The same with a drift more that all records have in common [-]."""
    if not drift or not channels.drift:
        return channels
    side, names = ("reference", channels.of_reference)
    if "drift" not in names:
        side, names = ("response", channels.of_response)
    if "drift" not in names:
        return channels
    values = getattr(channels, side).clone()
    values[:, names.index("drift")] += drift / channels.drift
    return channels._replace(**{side: values})


def as_the_specimen(model: PlateModel, specimen: PlateModel) -> PlateModel:
    """A model in a specimen's basis, its dampings, sensors and hits as that one's are."""
    found = on_mesh(model, specimen.assembly).with_damping_factors(specimen.damping_factor)
    off = specimen.off_marks
    return found if off is None else found.with_places_off(off.response, off.reference)


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
    return builder.against(replace(target, noise=noise, mesh_shift=nothing, imperfections=imperfections))
