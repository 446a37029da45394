"""All hypotheses on one mesh: the given model, every effect, the pairs, each refitted and weighed."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.integral import Integral
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.hypotheses import (
    Alone,
    Fitted,
    Hypothesis,
    Tried,
    is_simpler,
    ordered,
    pairs,
    single,
    tried,
    visible,
)
from torchplate.diagnosis.table.plates import MeshKind, Plates
from torchplate.diagnosis.table.refit import Minimum, Prior, Problem, together
from torchplate.diagnosis.table.settings import TableSettings
from torchplate.diagnosis.table.whole_box import over_the_box
from torchplate.diagnosis.usual import Usual
from torchplate.model import PlateModel


@dataclass(frozen=True, eq=False)
class Weighed:
    """A hypothesis after its refit.

    Attributes:
        hypothesis: its effects; None for the given model.
        model: with them, in all dofs.
        minima: the best first.
        evidence: −2 ln Z of all of them.
        modes: that its effects bring into the basis.
        rebuilt: whether its basis holds the modes of the best minimum.
        drawn: the likelihood over the whole box, with a sample of the posterior; None where Laplace's method is enough.
        alone: one effect where its refit has ended; None for the given model and for pairs.
        table: what it was held against, where the mesh error was taken off anew with its effects; None elsewhere.
    """

    hypothesis: Hypothesis | None
    model: PlateModel
    minima: tuple[Minimum, ...]
    evidence: float
    modes: tuple[Tensor, ...] = ()
    rebuilt: bool = False
    drawn: Integral | None = None
    alone: Alone | None = None
    table: TableEvidence | None = None

    @property
    def best(self) -> Minimum:
        """The minimum that holds most."""
        return self.minima[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Of its effects."""
        return () if self.hypothesis is None else self.hypothesis.names

    @property
    def theta(self) -> Float[Tensor, " n"]:
        """The best minimum in SI units."""
        return self.model.space.to_si(self.best.position)


@dataclass(frozen=True, eq=False)
class Comparison:
    """What was weighed on one mesh.

    Attributes:
        plates: the plate on it.
        baseline: the given model.
        fitted: the same, linearised.
        seen: candidates that this table can see.
        unseen: names of effects that it cannot.
        weighed: every effect and the pairs that promise most.
        n_pair_left: pairs that were not refitted.
    """

    plates: Plates
    baseline: Weighed
    fitted: Fitted
    seen: tuple[Tried, ...]
    unseen: tuple[str, ...]
    weighed: tuple[Weighed, ...]
    n_pair_left: int

    @property
    def kind(self) -> MeshKind:
        """Of the mesh."""
        return self.plates.kind

    def counted(self, level: float) -> list[Weighed]:
        """All that count: an effect that contains a simpler one only where it takes more than that and chance.

        Its further numbers take so much from −2 ln of the likelihood by chance, of which a hundredth exceeds the
        quantile of χ² at a level of 0.99: an absorber that stays with the plate is a mass.

        Args:
            level: of that quantile [-].
        """
        import scipy.stats  # here: a third of what importing this package takes

        evidence = self.plates.evidence

        def beyond(one: Weighed, other: Weighed) -> bool:
            further = len(one.model.names) - len(other.model.names)
            left = [evidence.minus_two_log_likelihood(end.best.chi_square) for end in (other, one)]
            return left[0] - left[1] > float(scipy.stats.chi2.ppf(level, max(1, further)))

        def needed(one: Weighed) -> bool:
            simpler = (
                other
                for other in self.weighed
                if one.hypothesis and other.hypothesis and is_simpler(other.hypothesis, one.hypothesis)
            )
            return all(beyond(one, other) for other in simpler)

        return [self.baseline, *(one for one in self.weighed if needed(one))]


class Comparing:
    """Weighs hypotheses on one mesh.

    Args:
        plates: the plate on it.
        prior: what is known beforehand.
        settings: constants.
        say: is told what is being tried.
    """

    def __init__(self, plates: Plates, prior: Prior, settings: TableSettings, say: Callable[[str], None]) -> None:
        self.plates, self.prior, self.settings, self.say = plates, prior, settings, say

    def baseline(self) -> tuple[Weighed, Fitted]:
        """The given model, fitted; on the corrected mesh once more where it has come to."""
        plates = self.plates
        n = len(plates.model.names)
        place = plates.model.known.new_full((1, n), 0.5)
        starts = (
            place if not n else torch.cat([place, SobolEngine(n).draw(self.settings.n_spread, dtype=torch.float64)[1:]])
        )
        for turn in range(2):
            plates.at(plates.model.space.to_si(place[0]))
            problem = Problem(plates.reduced(plates.model), plates.evidence, self.prior, self.settings)
            if turn == 0 and n:
                off = plates.evidence.residual(problem.natural.frequency(starts)).square().sum(-1)
                starts = starts[(off + problem.deviations(starts).square().sum(-1)).argsort()[: self.settings.n_best]]
            minima = problem.minima(starts)
            place = starts = minima[0].position[None]
            plates.n_evaluation += len(starts)
            if not n:
                break
        # The box may have several minima; those of the last turn are one, found from the best.
        baseline = Weighed(None, plates.model, tuple(minima), together(minima), rebuilt=True)
        return baseline, Fitted.of(problem, minima[0])

    def _each(self, hypotheses: Sequence[Hypothesis], least: float, other: Comparison | None) -> list[Weighed]:
        """All refitted, those that promise most first: they tell which of the others are hopeless.

        Args:
            hypotheses: in any order.
            least: χ² that is left by what was refitted before.
            other: what was weighed on the other mesh; None where this is the first.
        """
        before = [] if other is None else sorted(other.weighed, key=lambda one: -one.evidence)
        known = {one.hypothesis.key: one for one in before if one.hypothesis}
        found = []
        for one in sorted(hypotheses, key=lambda one: one.promise):
            found.append(self.refitted(one, self.settings.hopeless * least, known.get(one.key)))
            least = min(least, found[-1].best.chi_square)
        return found

    def refitted(
        self,
        hypothesis: Hypothesis,
        hopeless: float = math.inf,
        elsewhere: Weighed | None = None,
        begun: Weighed | None = None,
    ) -> Weighed:
        """A hypothesis from all its starts, in the shared modes and those of its effects.

        Args:
            hypothesis: its effects.
            hopeless: χ² beyond which, after a few steps, it is not followed to its end.
            elsewhere: the same on another mesh, of which the minima are near: begun there, and at the best start.
            begun: what contains it, where that has ended: likewise.
        """
        model = self.plates.with_effects([part.candidate for part in hypothesis.parts], hypothesis.labels)
        column = ordered(hypothesis, model.names, self.plates.model.names)
        extra = _distinct([mode for part in hypothesis.parts for mode in part.modes])
        starts = hypothesis.starts[:, column]
        if any(part.candidate.is_hole for part in hypothesis.parts) and elsewhere is None and begun is None:
            starts, modes = self._about_holes(model, hypothesis, starts)
            extra = (*extra, *modes)
        problem = self._problem(model, extra, hypothesis)
        if elsewhere is not None:
            ends = [one.position for one in elsewhere.minima[: self.settings.n_onward]]
            starts = torch.stack([*ends, starts[0]])
        if begun is not None and begun.hypothesis is not None:
            starts = torch.stack([_at_the_end(hypothesis, model, begun.hypothesis, begun), starts[0]])
        minima = problem.minima(starts, hopeless=hopeless)
        self.plates.n_evaluation += len(starts) * self.settings.n_iteration
        alone = self._alone(hypothesis, problem, minima[0])
        return Weighed(hypothesis, model, tuple(minima), together(minima), extra, alone=alone)

    def _about_holes(
        self, model: PlateModel, hypothesis: Hypothesis, starts: Float[Tensor, "n_start n"]
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Where starts lead first, each in the modes of its own plate, the nearest first; and the modes of that.

        At the edge of a hole nothing bends, and no sum of modes of the whole plate does that: in these a hole takes
        less stiffness off than it should, and ends elsewhere. Two effects begin where each of them has ended.

        Args:
            model: with the hole.
            hypothesis: its effects.
            starts: on the unit cube.
        """
        settings, found = self.settings, list[tuple[float, Tensor, Tensor]]()
        if len(hypothesis.parts) > 1:
            return starts, (self.plates.solved(model, model.space.to_si(starts[0])).shape,)
        for _ in range(settings.n_anew):
            found = []
            for place in starts:
                modes = self.plates.solved(model, model.space.to_si(place)).shape
                position, left = self._problem(model, [modes], hypothesis).followed(place[None], settings.n_first)
                found.append((float(left.nan_to_num(nan=math.inf)), position[0], modes))
            found.sort(key=lambda one: one[0])
            starts = torch.stack([position for _, position, _ in found[: settings.n_onward]])
        return starts, (found[0][2],)

    def _problem(
        self, model: PlateModel, extra: Sequence[Tensor], one: Hypothesis | None, table: TableEvidence | None = None
    ) -> Problem:
        """A model in the shared modes and some more. As large as all its elements in that basis: it is not kept."""
        parts = () if one is None else zip(one.labels, one.parts, strict=True)
        usual = Usual.of(model, {label: part.candidate for label, part in parts})
        evidence = table or self.plates.evidence
        return Problem(self.plates.reduced(model, extra), evidence, self.prior, self.settings, usual)

    def _alone(self, hypothesis: Hypothesis, problem: Problem, minimum: Minimum) -> Alone | None:
        """One effect where its refit has ended, for pairs to begin there."""
        if len(hypothesis.parts) > 1:
            return None
        names, label = problem.natural.model.names, hypothesis.labels[0]
        own = tuple(k for k, name in enumerate(names) if name.startswith(f"{label}."))
        given = tuple(names.index(name) if name in names else None for name in self.plates.model.names)
        return Alone(hypothesis.parts[0], Fitted.of(problem, minimum), own, given)

    def rebuilt(self, found: Weighed) -> Weighed:
        """The same with the modes of the plate that was found in the basis: right in all dofs there.

        With a patch, which bends where it is cut out, the mesh error is another, and is taken off anew.
        """
        assert found.hypothesis is not None
        plates, model, table = self.plates, found.model, None
        if plates.kind == "corrected" and any(part.candidate.is_patch for part in found.hypothesis.parts):
            model, table = plates.anew(model, found.theta)
        own = [mode for part in found.hypothesis.parts for mode in part.modes]
        extra = _distinct([*own, plates.solved(model, found.theta).shape])
        problem = self._problem(model, extra, found.hypothesis, table)
        turned = {one.turns for one in found.minima}
        kept = [one for one in found.minima if one.evidence < found.best.evidence + self.settings.near]
        # The basis is right at the best minimum and not at its images, which were told before.
        minima = problem.minima(
            torch.stack([one.position for one in kept]), self.settings.n_first, max(turned, key=len)
        )
        alone = self._alone(found.hypothesis, problem, minima[0])
        return Weighed(found.hypothesis, model, tuple(minima), together(minima), extra, True, alone=alone, table=table)

    def rebuilt_each(self, found: Weighed) -> list[Weighed]:
        """The same; with a patch, whose mesh error is another at each of its minima, one for each that may be it."""
        if self.plates.kind == "given" or not any(part.candidate.is_patch for part in _parts(found)):
            return [self.rebuilt(found)]
        near = [one for one in found.minima if one.evidence < found.best.evidence + self.settings.near]
        kept: list[Weighed] = []
        for one in (self.rebuilt(replace(found, minima=(minimum,))) for minimum in near):
            if not any(other.best.is_near(one.best.position, self.settings.same) for other in kept):
                kept.append(one)
        return kept

    def integrated(self, found: Weighed, others: Sequence[Weighed] = ()) -> Weighed:
        """The same, its likelihood integrated over all its values.

        Args:
            found: what was weighed.
            others: the same hypothesis about other minima, which hold what is nearest to them.
        """
        problem = self._problem(found.model, found.modes, found.hypothesis, found.table)
        if not problem.free:
            return found
        drawn = over_the_box(problem, found.minima, [one.best for one in others])
        self.plates.n_evaluation += len(drawn.places)
        return replace(found, evidence=drawn.evidence, drawn=drawn)

    def tries(self, baseline: Weighed, fitted: Fitted) -> list[Tried]:
        """Every candidate that natural frequencies can see, over its intervals."""
        found = visible(self.plates, baseline.theta)
        return [tried(self.plates, fitted, k, one, self.settings) for k, one in enumerate(found)]

    def singles(self, baseline: Weighed, fitted: Fitted, other: Comparison | None = None) -> Comparison:
        """The given model and every effect alone.

        Args:
            baseline: the given model.
            fitted: the same, linearised.
            other: what was weighed on the other mesh; None where this is the first.
        """
        every = self.tries(baseline, fitted)
        seen = [one for one in every if one.seen(self.settings)]
        blind = {one.name for one in every} - {one.name for one in seen}
        self.say(f"{self.plates.kind} mesh: {len(seen)} effects and options")
        alone = [single(fitted, one, self.settings) for one in seen]
        alone, left = [one for one in alone if self._may_fail(one)], baseline.best.chi_square
        weighed = self._best_rebuilt(self._with_simpler(self._each(alone, left, other), alone, left))
        return Comparison(self.plates, baseline, fitted, tuple(seen), tuple(sorted(blind)), tuple(weighed), 0)

    def with_pairs(self, found: Comparison, other: Comparison | None = None) -> Comparison:
        """The pairs that promise most beside what was weighed.

        Args:
            found: the given model and every effect alone.
            other: what was weighed on the other mesh; None where this is the first.
        """
        ranked = sorted(found.weighed, key=lambda one: -one.evidence)
        alone = [one.alone for one in ranked if one.alone is not None]
        every = [one for one in pairs(found.fitted, found.seen, self.settings, alone) if self._may_fail(one)]
        evidence, level = self.plates.evidence, self.settings.level
        does = any(
            one.best.chi_square <= evidence.limit(one.best.n_effective, level)
            for one in (found.baseline, *found.weighed)
        )
        count = min(len(every), self.settings.n_pair_beside if does else self.settings.n_pair)
        self.say(f"{self.plates.kind} mesh: {count} of {len(every)} pairs")
        least = min(one.best.chi_square for one in (found.baseline, *found.weighed))
        refitted = self._each(every[:count], least, other)
        weighed = self._best_rebuilt(refitted := self._with_simpler(refitted, every, least))
        left = len(every) - len(refitted)
        return Comparison(
            found.plates, found.baseline, found.fitted, found.seen, found.unseen, (*found.weighed, *weighed), left
        )

    def _with_simpler(self, refitted: Sequence[Weighed], every: Sequence[Hypothesis], least: float) -> list[Weighed]:
        """What was refitted, and what the best of it become at an end of their parameters, from where they have ended.

        A simpler effect may promise less than one that contains it, and its own refit may end elsewhere.

        Args:
            refitted: those that promised most.
            every: all of as many effects.
            least: χ² that is left by what was refitted before.
        """
        found = {one.hypothesis.key: one for one in refitted if one.hypothesis}
        least = min([least, *(one.best.chi_square for one in refitted)])
        evidence = min((one.evidence for one in refitted), default=math.inf) + self.settings.far
        for larger in [one for one in refitted if one.evidence < evidence]:
            for one in every:
                if larger.hypothesis is None or not is_simpler(one, larger.hypothesis):
                    continue
                again = self.refitted(one, self.settings.hopeless * least, begun=larger)
                if one.key not in found or again.evidence < found[one.key].evidence:
                    found[one.key] = again
        return list(found.values())

    def _may_fail(self, one: Hypothesis) -> bool:
        """Whether a table can speak against a hypothesis: what has as many free numbers as it has fits any table."""
        told = self.prior.keys()
        n_free = sum(name not in told for name in self.plates.model.names)
        return n_free + sum(len(part.candidate.searched) for part in one.parts) < self.plates.evidence.n

    def _best_rebuilt(self, found: Sequence[Weighed]) -> list[Weighed]:
        """The best few ended in modes of their own."""
        ranked = sorted(found, key=lambda one: one.evidence)
        least = ranked[0].evidence if ranked else 0.0
        some = [one for one in ranked[: self.settings.n_rebuilt] if one.evidence < least + self.settings.far]
        each = [self.rebuilt_each(one) if one in some else [one] for one in ranked]
        return [one for ends in each for one in ends]


def _at_the_end(one: Hypothesis, model: PlateModel, larger: Hypothesis, found: Weighed) -> Tensor:
    """A simpler hypothesis where one that contains it has ended, on the unit cube of its model."""
    known = dict(zip(found.model.names, found.theta.tolist(), strict=True))
    left, there = list(zip(larger.key, larger.labels, strict=True)), dict[str, str]()
    for index, label in zip(one.key, one.labels, strict=True):
        same = next((pair for pair in left if pair[0] == index), None)
        if same is not None:
            left.remove(same)
            there[label] = same[1]
    middle = model.space.to_si(model.known.new_full((len(model.names),), 0.5)).tolist()
    values = []
    for name, value in zip(model.names, middle, strict=True):
        label, _, key = name.rpartition(".")
        # What has no counterpart is the simpler effect, and the one that is left contains it.
        label = there.get(label, left[0][1] if label in one.labels else label)
        values.append(known.get(f"{label}.{key}", value))
    return model.space.to_cube(torch.tensor(values).to(found.theta)).clamp(0.0, 1.0)


def _parts(found: Weighed) -> tuple[Tried, ...]:
    return () if found.hypothesis is None else found.hypothesis.parts


def _distinct(modes: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """Each once: two effects of a kind bring the same."""
    kept: list[Tensor] = []
    for mode in modes:
        if not any(mode is one for one in kept):
            kept.append(mode)
    return tuple(kept)
