"""All that may have changed beside one model: tried, the most promising refitted, and compared."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from torchplate.diagnosis.candidates.candidate import Candidate, n_options
from torchplate.diagnosis.candidates.catalogue import candidates, channels_of
from torchplate.diagnosis.candidates.channels import rearrangements
from torchplate.diagnosis.change.after import After, Ended, Nuisances
from torchplate.diagnosis.change.changes import Change, allowed, grid, n_names, parameters_that_moved
from torchplate.diagnosis.change.hypothesis import Hypothesis, as_the_specimen
from torchplate.diagnosis.change.posterior import Choice, Weighed, chance, choose
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.problem import Problem
from torchplate.diagnosis.selection.criterion import (
    evidence,
    is_explained,
    is_noise,
    never_equivalent,
    tempered,
    weight_of,
)
from torchplate.diagnosis.selection.screen import screen
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import Marginal
from torchplate.model import PlateModel

Starts = tuple[Mapping[str, float], ...]
# A change to be refitted, from where, and the misfit that a tangent promises; 0 where wide levels have led there.
Way = tuple[Change, Starts, float]
# A choice, the fits that it was made from, and the fit that it was added to.
Chosen = tuple[Choice, Mapping[tuple[str, str], Fit], Fit]


@dataclass(frozen=True)
class Promise:
    """A change that was tried.

    Attributes:
        change: it.
        drop: part of the sum of squares that it would take [-].
        starts: values of what is searched then, the best first.
        wide: whether it was tried beside the frequency axis, where peaks that do not overlap attract each other.
    """

    change: Change
    drop: float
    starts: tuple[Mapping[str, float], ...]
    wide: bool = False


@dataclass(frozen=True)
class State:
    """What has been found to have changed so far.

    Attributes:
        changes: named.
        fit: with them.
        nuisances: what it has found of what no change is.
        choices: how each was chosen, and the fits that it was chosen from.
        promises: of each step.
        finer: what its fit was held against, where that was on another mesh, which may have modes more or fewer in the
            band and so other lines.
    """

    changes: tuple[Change, ...]
    fit: Fit
    nuisances: Nuisances
    choices: tuple[Chosen, ...] = ()
    promises: tuple[tuple[Promise, ...], ...] = ()
    finer: FrfTarget | None = None

    @property
    def values(self) -> dict[str, float]:
        """Of what its fit has searched, in SI units."""
        return dict(zip(self.fit.model.names, self.fit.theta.tolist(), strict=True))


class Comparing:
    """Looks for what has changed.

    Args:
        after: the test after.
        given: its model as the config has it.
        numbers: parameters that the config gives as numbers with a standard deviation.
        say: is told what is being tried.
    """

    def __init__(self, after: After, given: PlateModel, numbers: Sequence[str], say: Callable[[str], object]) -> None:
        self.after, self.given, self.numbers, self.say = after, given, numbers, say
        self.settings = after.reference.settings

    def none(self) -> State:
        """Nothing changed, but for what has a value of its own in each test."""
        own = {name: value for name, value in self.after.reference.values.items() if name in self.after.own}
        starts: Sequence[Mapping[str, float]] = [own]
        if self.after.own:
            starts, _ = self.after.down([], starts)
        found, nuisances = self.after.fit([], starts)
        self.say(f"nothing changed: misfit {found.reduced_misfit:.4g}")
        return State((), found, nuisances)

    def further(self, state: State) -> State | None:
        """One change more, if one is more probable than none."""
        there = self.after.taken_off_at(state.changes, state.values)
        return Comparing(there, self.given, self.numbers, self.say)._one_more(state)

    def _one_more(self, state: State) -> State | None:
        """The same where the mesh error is that of the state."""
        target = self.after.builder.target
        promises = self._tried(state)
        ways = self._ways(state, promises)
        fits: dict[tuple[str, str], Fit] = {}
        ended: dict[tuple[str, str], Ended] = {}
        tried: dict[tuple[str, str], Change] = {}
        # Nuisances that are hardly in doubt are as they were found: no change is to gain by finding them once more.
        sure = state.fit.reduced_misfit <= target.settings.screening.nearly_right
        begun = state.nuisances if sure else None
        hopeless = target.settings.searching.hopeless
        # What becomes a simpler effect at an end of its parameters comes after it; where that explains all, not at all.
        for change, starts, promised in sorted(ways, key=lambda way: bool(_contained(way[0]))):
            if any(is_noise(fit) for key, fit in fits.items() if key[0] in _contained(change)):
                continue
            if fits and promised > hopeless * min(one.reduced_misfit for one in fits.values()):
                continue
            least = min((one.reduced_misfit for one in fits.values()), default=math.inf)
            limit = target.settings.selecting.hopeless_rival * least
            found = self.after.fit([*state.changes, change], starts, begun, limit, _within_reach(ended.values()))
            self.say(f"  {change.name}: misfit {found.fit.reduced_misfit:.4g}")
            fits[change.key], ended[change.key], tried[change.key] = found.fit, found, change
        if not fits:
            return None
        best = min(ended, key=lambda key: ended[key].fit.cost)
        for change, found in self._simpler(state, tried[best], ended[best], promises):
            if change.key not in fits or found.fit.cost < fits[change.key].cost:
                fits[change.key], ended[change.key], tried[change.key] = found.fit, found, change
        state = self._anew(state, min(ended.values(), key=lambda one: one.fit.cost))
        choice = self._choice(state.fit, [(tried[key], fit) for key, fit in fits.items()], promises)
        step = (choice, fits, state.fit)
        assert choice.best.change is not None
        if not choice.needed:
            return replace(state, promises=(*state.promises, tuple(promises)))
        return State(
            (*state.changes, choice.best.change),
            *ended[choice.best.change.key],
            (*state.choices, step),
            (*state.promises, tuple(promises)),
        )

    def _simpler(
        self, state: State, larger: Change, there: Ended, promises: Sequence[Promise]
    ) -> Iterator[tuple[Change, Ended]]:
        """What a change becomes at an end of its parameters, fitted from where it has ended.

        A simpler one may promise less, and its own refit may end elsewhere.
        """
        values = dict(zip(there.fit.model.names, there.fit.theta.tolist(), strict=True))
        limit = self.after.builder.target.settings.selecting.hopeless_rival * there.fit.reduced_misfit
        names = _contained(larger)
        changes = {one.change.name: one.change for one in reversed(promises) if one.change.name in names}
        for one in changes.values():
            start = dict(values)
            for key in [] if one.candidate is None else one.candidate.searched:
                if f"{larger.label}.{key}" in values:
                    start[f"{one.label}.{key}"] = values[f"{larger.label}.{key}"]
            changes_then = [*state.changes, one]
            # What is stiff and not rigid weighs more than its mass, by more than peaks are wide.
            afar, _ = self.after.down(changes_then, [start])
            found = self.after.fit(changes_then, [start, *afar], there.nuisances, limit, _within_reach([there]))
            self.say(f"  {one.name}, where {larger.name} has ended: misfit {found.fit.reduced_misfit:.4g}")
            yield one, found

    def _choice(self, before: Fit, fits: Sequence[tuple[Change, Fit]], promises: Sequence[Promise]) -> Choice:
        """Which of some changes is the most probable, and whether it is needed beside what was there before."""
        weight = weight_of([before, *(fit for _, fit in fits)])
        n_mode = self.after.builder.target.n_mode
        weighed = [
            Weighed(
                change,
                evidence(fit, weight),
                tempered(fit, weight),
                len(fit.theta) - len(before.theta),
                _n_place(change, n_mode),
            )
            for change, fit in fits
        ]
        none = Weighed(None, evidence(before, weight), tempered(before, weight))
        changes = list({promise.change.key: promise.change for promise in promises}.values())
        return choose(none, weighed, n_names(changes), len(changes), before.comparison, self.settings)

    def pruned(self, state: State) -> State:
        """The state without earlier changes that are not needed beside the last: they may have stood in for it."""
        for index, change in enumerate(state.changes[:-1]):
            others = state.changes[:index] + state.changes[index + 1 :]
            there = self.after.taken_off_at(others, state.values)
            without = there.fit(others, [state.values], state.nuisances)
            if self._choice(without.fit, [(change, state.fit)], state.promises[index]).needed:
                continue
            self.say(f"  without {change.name}: misfit {without.fit.reduced_misfit:.4g}; it is not needed")
            before = state.choices[index][2]
            choices = [step for k, step in enumerate(state.choices) if k != index]
            choices[index] = (*choices[index][:2], before)
            promises = [one for k, one in enumerate(state.promises) if k != index]
            return self.pruned(State(others, *without, tuple(choices), tuple(promises)))
        return state

    def settled(self, state: State, finer: "Comparing") -> State:
        """The state on a finer mesh; as it is, where that leaves noise alone and settling more.

        How two close modes turn into each other hangs on a patch by less than a per cent of it: what the mesh leaves
        of that is no shift of a mode. The last change has to show there again: it may have been the mesh.

        Args:
            state: at least one change.
            finer: the same on that mesh.
        """
        drift = state.nuisances.drift
        same = drift is not None and len(drift) == finer.after.reference.drift.shape[1]
        begun = state.nuisances if same else None

        def on_it(changes: tuple[Change, ...]) -> Ended:
            there = finer.after.taken_off_at(changes, state.values)
            return there.fit(changes, [state.values], begun)

        *others, last = state.changes
        ended, without = on_it(state.changes), on_it(tuple(others))
        target, builder = self.after.builder.target, self.after.builder
        builder.count(finer.after.builder.n_evaluation)
        self.say(f"  misfit {ended.fit.reduced_misfit:.4g}, without {last.name} {without.fit.reduced_misfit:.4g}")
        if not self._choice(without.fit, [(last, ended.fit)], state.promises[len(others)]).needed:
            self.say(f"  {last.name} does not show there")
            return replace(state, changes=tuple(others), fit=without.fit, nuisances=without.nuisances,
                           choices=state.choices[:-1], finer=finer.after.builder.target)  # fmt: skip
        if is_noise(state.fit) and not is_explained(ended.fit, target):
            return state
        return replace(state, fit=ended.fit, nuisances=ended.nuisances, finer=finer.after.builder.target)

    def _anew(self, state: State, best: Ended) -> State:
        """The same from the nuisances that a further change has found: it is to win by itself, not by these."""
        again = self.after.fit(state.changes, [state.values], best.nuisances)
        return replace(state, fit=again.fit, nuisances=again.nuisances) if again.fit.cost < state.fit.cost else state

    def _ways(self, state: State, promises: Sequence[Promise]) -> list[Way]:
        """What is refitted, from where: what promises most where peaks are, and beside them."""
        near, wide = (self._promising([one for one in promises if one.wide == which]) for which in (False, True))
        # Where nothing but noise is left, and the best promises no more than chance does, the best two are a check.
        by_chance = chance(Weighed(None, 0.0, 0.0, 1), len(promises), self.settings)
        idle = is_noise(state.fit) and near and near[0].drop * state.fit.square <= by_chance
        near = near[: 2 if idle else self.settings.n_refit]

        def down(one: Promise) -> tuple[Starts, float]:
            return self.after.down([*state.changes, one.change], one.starts)

        beside = self.after.builder.target.settings.screening.near
        return ways_of(near, wide, down, state.fit.reduced_misfit, self.settings.n_refit, beside)

    def _promising(self, promises: Sequence[Promise]) -> list[Promise]:
        """Those of one kind of trial that promise more than a part of the best, two options of a name at most."""
        faint = self.after.builder.target.settings.screening.faint
        best = promises[0].drop if promises else 0.0
        return [one for one in _best_options(promises) if one.drop >= faint * best]

    def _tried(self, state: State) -> list[Promise]:
        """Every change, at values spread over where it may be, the most promising first.

        A tangent at the sharp level says what a change does that moves peaks by less than their widths. More may hide
        behind a gap below one half, in resonances or between them: as long as more than noise is left, changes are
        tried beside the frequency axis too.
        """
        after, target = self.after, self.after.builder.target
        values = state.values
        plain = after.hypothesis(state.changes, [values], by_element=True)
        sure = state.fit.reduced_misfit <= target.settings.screening.nearly_right
        # Where more than noise is left, they have taken on what is missing.
        one = after.moved(plain, state.nuisances.channels, state.nuisances.drift) if sure else plain
        theta = state.fit.theta
        screening = target.settings.screening
        sharply = float(target.gap(state.fit.prediction)) < screening.overlapping
        wide = not sharply or state.fit.reduced_misfit > screening.nearly_right
        effects, n_option = self._effects(state, values)
        numbers = self._parameters(state, values)
        self.say(f"{len(effects)} effects that may have come, {len(numbers)} parameters that may have moved")
        found: list[Promise] = []
        levels: list[Marginal | None] = [after.marginal(one, theta)] if sharply else []
        for near in (*levels, *((None,) if wide else ())):
            for scored in screen(after.builder, one.reduced, theta, effects, {}, near):
                change = Change(
                    scored.candidate.name, scored.label, scored.candidate, n_option=n_option[scored.candidate.cause]
                )
                # At the wide levels more starts cost next to nothing, and one of them is near.
                most = self.settings.n_start if near is not None else None
                members = scored.model.space.to_si(scored.starts)[:most].tolist()
                starts = tuple(dict(zip(scored.model.names, row, strict=True)) for row in members)
                found.append(Promise(change, scored.drop, starts, near is None))
            found += [self._moved(one, change, values, near) for change in numbers]
        return sorted(found, key=lambda one: -one.drop)

    def _effects(self, state: State, values: Mapping[str, float]) -> tuple[list[Candidate], dict[str, int]]:
        after, target = self.after, self.after.builder.target
        model = after.model
        everything = dict(after.reference.values) | dict(values)
        middle = {name: 0.5 * (one.low + one.high) for name, one in model.searched.items()}
        theta = torch.tensor([everything.get(name, middle[name]) for name in model.names]).to(state.fit.theta)
        channels = channels_of(model)
        weight = torch.where(target.measurement.measured, 1 / target.variance, 0.0)
        turned = rearrangements(channels, target.measured, state.fit.expected, weight)
        every = candidates(model, theta, channels, turned, self.numbers)
        kept = allowed(every, self.given)
        n_option = n_options(kept)
        n_option |= {"channel_swap": turned.n_swap, "channel_polarity": turned.n_polarity}
        return kept, n_option

    def _parameters(self, state: State, values: Mapping[str, float]) -> list[Change]:
        taken = {change.name for change in state.changes}
        everything = dict(self.after.reference.values) | dict(values)
        found = parameters_that_moved(self.after.model, self.after.own, everything, self.numbers)
        return [one for one in found if one.name not in taken]

    def _moved(self, one: Hypothesis, change: Change, values: Mapping[str, float], near: Marginal | None) -> Promise:
        """One parameter at values from end to end of its interval."""
        target = self.after.builder.target
        model = as_the_specimen(change.applied(one.frozen), one.reduced)
        level = target.settings.wide.screened if near is None else target.levels - 1
        problem = Problem(self.after.builder, model, {}, near)
        before = {**values, change.name: float(change.before or 0.0)}
        members = [before, *({**values, **point} for point in grid(change, self.settings.n_grid))]
        theta = torch.tensor([[member[name] for name in model.names] for member in members]).to(one.frozen.known)
        square = problem.squares(model.space.to_cube(theta), level)
        order = square.argsort().tolist()
        drop = 1 - float(square.min() / square[0].clamp(min=1e-300))
        starts = [members[k] for k in order[: self.settings.n_start]]
        if near is not None and order[0] == 0:
            # Between the values: a step is tried as a tangent.
            drop, starts = self._tangent(problem, model, before, change, level)
        return Promise(change, drop, tuple(starts), near is None)

    def _tangent(
        self, problem: Problem, model: PlateModel, before: Mapping[str, float], change: Change, level: int
    ) -> tuple[float, list[Mapping[str, float]]]:
        """What a small step of a parameter takes, and how far it would go."""
        theta = torch.tensor([[before[name] for name in model.names]]).to(model.known)
        place = model.space.to_cube(theta)[0]
        index = model.names.index(change.name)
        step = 1e-4 if float(place[index]) < 0.5 else -1e-4
        there = place.clone()
        there[index] += step
        residual = problem.residual(torch.stack([place, there]), level)
        slope = (residual[1] - residual[0]) / step
        size = float(slope.square().sum())
        go = -float(slope @ residual[0]) / max(size, 1e-300)
        place[index] = (place[index] + go).clamp(0.0, 1.0)
        went = dict(zip(model.names, model.space.to_si(place).tolist(), strict=True))
        drop = go * go * size / max(float(residual[0].square().sum()), 1e-300)
        return drop, [went, dict(before)]


def _within_reach(ended: Iterable[Ended]) -> float:
    """`Nuisances.held` of what could still be named beside the best of some ends."""
    return min((one.nuisances.held + never_equivalent(one.fit) for one in ended), default=math.inf)


def _contained(change: Change) -> Collection[str]:
    """The simpler effects that a change becomes at an end of its parameters."""
    return () if change.candidate is None else change.candidate.effect.contains


def ways_of(
    near: Sequence[Promise],
    wide: Sequence[Promise],
    down: Callable[[Promise], tuple[Starts, float]],
    misfit: float,
    most: int,
    beside: float,
) -> list[Way]:
    """What is refitted sharply: of all that was tried beside the frequency axis what ends lowest there, then the rest.

    A few values on the way say little of where a change ends, and going there at the wide levels costs little.

    Args:
        near: what a tangent at the sharp level speaks for.
        wide: what was tried beside the frequency axis.
        down: where the starts of one of these end, the best first, and what that leaves.
        misfit: before any of them [-].
        most: that are refitted from there.
        beside: those go on that leave no more than so many times as much as the best [-].
    """
    ends = sorted(((one, *down(one)) for one in wide), key=lambda end: end[2])
    ways: dict[tuple[str, str], Way] = {
        one.change.key: (one.change, starts, 0.0) for one, starts, left in ends[:most] if left <= beside * ends[0][2]
    }
    for one in near:
        _, before, promised = ways.get(one.change.key, (one.change, (), (1 - one.drop) * misfit))
        # From both, where both promise something: the one that ends lower is right.
        ways[one.change.key] = (one.change, (*before, *one.starts[: 1 if wide else None]), promised)
    return list(ways.values())


def _best_options(promises: Sequence[Promise]) -> list[Promise]:
    """Of each name the two options that promise most."""
    count: Counter[str] = Counter()
    found = []
    for one in promises:
        count[one.change.name] += 1
        if count[one.change.name] <= 2:
            found.append(one)
    return found


def _n_place(change: Change, n_mode: int) -> int:
    """Places that a test can tell apart: about two for each mode in the band."""
    return max(1, 2 * n_mode) if change.candidate is not None and change.candidate.has_place else 1
