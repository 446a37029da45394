"""The whole catalogue beside one model: score every effect, take the best ones down, refit what ends near the best."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import torch
from jaxtyping import Complex
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate, n_options
from torchplate.diagnosis.candidates.catalogue import candidates
from torchplate.diagnosis.candidates.channels import Channels, Rearrangements, rearrangements
from torchplate.diagnosis.fit import NOBODY, Beat, Begun, begin
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.lines import every_nth
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.afar import FromAfar
from torchplate.diagnosis.selection.by_frequencies import Both, ByFrequencies
from torchplate.diagnosis.selection.criterion import (
    Hypothesis,
    excessive,
    is_needed,
    is_noise,
    known_section,
    never_equivalent,
)
from torchplate.diagnosis.selection.details import Details
from torchplate.diagnosis.selection.grounded import Grounded
from torchplate.diagnosis.selection.instead import Instead
from torchplate.diagnosis.selection.near import apart
from torchplate.diagnosis.selection.null import Draws, limits, once_in_a_hundred
from torchplate.diagnosis.selection.refit import Refits
from torchplate.diagnosis.selection.screen import Scored, new_label, screen, start_of
from torchplate.diagnosis.selection.shortlist import best_of_each, contained, kept, looking_like, promising
from torchplate.diagnosis.selection.starts import beside_what_was_told, spread_out, without_rigid
from torchplate.diagnosis.selection.trace import Ranked, State, chance_of
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import UNIFORM, Found
from torchplate.model import PlateModel


class Ranking:
    """Ranks the catalogue beside a model.

    Args:
        builder: builds and evaluates the models.
        prior: what is known of the given model's parameters beforehand.
        channels: what was measured.
        say: is told what is being tried.
        finer: the catalogue beside a model that leaves noise, scored on a finer mesh, where it promises nothing.
        measured: names in the prior that somebody has measured himself; left out, all.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        prior: Prior,
        channels: Channels,
        say: Callable[[str], None],
        finer: Callable[[State], Ranked | None] = lambda _: None,
        measured: Collection[str] | None = None,
    ) -> None:
        self.builder, self.prior, self.channels, self.say, self.finer = builder, prior, channels, say, finer
        self.measured = measured
        self.settings = builder.target.settings
        self.refits, self.afar = Refits(builder, prior, say), FromAfar(builder, prior)
        self.details = Details(builder, self.refits)
        self.by_frequencies = ByFrequencies(builder, prior, self.refits)
        self.grounded, self.instead = Grounded(builder, self.refits), Instead(builder, prior, self.refits)
        self._far: set[str] = set()
        self._ways: tuple[tuple[Candidate, Tensor], ...] = ()

    def scored(self, fine: State, by_mesh: Complex[Tensor, "n_frequency n_response n_reference"] | None) -> Ranked:
        """Score the whole catalogue beside a state on a finer mesh, where little is left, and refit nothing.

        What is left is that mesh's; what candidates would change of it, a difference, is known well enough on this one.

        Args:
            fine: beside which.
            by_mesh: change of the FRFs that the finer mesh may have left; None for none.
        """
        model = self.builder.corrected(fine.fit.model, fine.fit.theta).model
        state = replace(fine, fit=fine.fit._replace(model=model))
        base, everyone = self._scoring_beside(state)
        promises, by_chance = self._nearby(state, base, everyone, by_mesh, fine.fit.expected)
        found = Ranked(tuple(promises), (), by_chance, square=fine.fit.square)
        if found.square and (most := found.most_beyond):
            self.say(
                f"  {most.candidate.name} promises {found.exceeds(most):.2g} times what chance and the mesh let it take"
            )
        return found

    def promised(self, state: State) -> list[Scored]:
        """Of each name that a state lacks what promises most, the best first; far more than noise is left of it.

        Args:
            state: beside which.
        """
        base, everyone = self._scoring_beside(state)
        if state.fit.left < self.settings.screening.overlapping:
            scored, _ = self._nearby(state, base, everyone)
        else:
            scored = screen(self.builder, base, state.fit.theta, everyone, self.prior)
        named = {one.hypothesis.name for one in state.named}
        best = {one.candidate.name: one for one in reversed(scored)}
        return sorted((one for name, one in best.items() if name not in named), key=lambda one: -one.drop)

    def at(self, state: State) -> Ranked:
        """Score the whole catalogue, and refit what promises most."""
        builder, misfit = self.builder, state.fit.reduced_misfit
        screening, selecting = self.settings.screening, self.settings.selecting
        told = beside_what_was_told(builder, self.prior, state)
        # Where little is left, peaks overlap beside a specimen that took on what is missing better than without it.
        # Dampings move no peak, and beside those that took it on what is missing promises nothing.
        still = told is not state and known_section(state.fit) is not None
        here = state if misfit <= selecting.doubtful and not still else told
        base, everyone = self._scoring_beside(here)
        self._far, self._ways = set(), ()
        promises: list[Scored] = []
        near, chosen = list[Scored](), list[tuple[Scored, Tensor]]()
        hypotheses: list[Hypothesis] = []
        by_chance, much = 0.0, False
        is_near = here.fit.left < screening.overlapping
        # Beside an error of the model that was inflated until it explains what is left, every model is nearly right.
        nearly_right = misfit <= screening.nearly_right and (state.fit.by_noise or is_near) and told is state
        if is_near or nearly_right:
            promises, by_chance = self._nearby(here, base, everyone, before=state)
            # Where nothing but noise is left, and the best promises no more than chance, it is a check and no more.
            much = bool(promises) and promises[0].drop > 1 - selecting.explains_much
            no_more = is_noise(state.fit) and not any(
                _exceeds_chance(one, state.fit.square, by_chance) for one in promises
            )
            if is_noise(state.fit) and not no_more and not state.named and (scored := self.finer(state)) is not None:
                return scored
            wanted = (0 if state.named else 1) if no_more else screening.n_sharp
            near = promising(promises, wanted, screening)
            if still:
                # A law of damping that is missing is far from linear where each mode has taken on its part.
                near += looking_like(promises, excessive(state.fit), near)
            chosen = [(one, one.starts) for one in near]
            if is_noise(state.fit):
                hypotheses, chosen = self._checked(state, chosen, by_chance), []
            else:
                # What sits at a place begins beside the specimen as it is there, which may have taken on some of it.
                placed = [one for one in near if one.candidate.has_place]
                begun = [(one, spread_out(builder, self.prior, here, base, one)) for one in placed]
                chosen = [one for one in chosen if not one[0].candidate.has_place]
                if (nearly_right or much) and known_section(state.fit) is not None:
                    # Where all of them begin beside one specimen, the nearest goes first, whatever it is.
                    begun, chosen = begun + chosen, []
                hypotheses = self._refitted(state, begun, about=here.fit.about)
        if not nearly_right:
            if much:
                hypotheses, chosen = hypotheses + self._refitted(state, chosen, hypotheses), []
            if not self._near_enough(state, told, here, promises, hypotheses):
                if told is not here:
                    base, everyone = self._scoring_beside(told)
                widely_scored, further = self._widely(told, base, everyone)
                chosen += further
                promises = promises or widely_scored
        hypotheses += self._refitted(state, chosen, hypotheses, first=next(iter(near), None))
        limit = self.settings.searching.hopeless * min((one.fit.square for one in hypotheses), default=math.inf)
        hypotheses += self.by_frequencies.of(state, hypotheses, everyone, limit, self._beat(state, hypotheses))
        hypotheses = best_of_each(hypotheses + self._again(state, hypotheses))
        # Beside noise, effects that are not needed are a check and no more.
        if is_noise(state.fit) and not any(
            is_needed(state.fit, one, chance_of(promises, one.name, by_chance)) for one in hypotheses
        ):
            return Ranked(tuple(promises), tuple(hypotheses), by_chance, frozenset(self._far))
        ended: list[Hypothesis] = []
        ends = self._run_off(state, hypotheses)
        if ends:
            first = min(ends, key=lambda one: one.cost)
            ends = best_of_each([*ends, *self.instead.at_images(state, first)])
            first = min(ends, key=lambda one: one.cost)
            ends = best_of_each([*ends, *self.instead.of(state, first, everyone, self._beat(state, [first]))])
        limit, beat = self._hopeless(ends), self._beat(state, ends, ended=True)
        ends = best_of_each([*ends, *self.details.fitted(state, ends)])
        ends = best_of_each([*ends, *self.details.left_out(state, ends)])
        for found in ends:
            far = found.fit.square > limit or (limit < math.inf and found.fit.cost > beat.cost)
            grounded = found.candidate.effect.to_ground and not far
            priced, supports = self.grounded.as_supports(state, found, limit, beat) if grounded else (found, [])
            # A support stays where it is: it is named where little else is missing, and it is there.
            ended += [priced, *(one for one in supports if one.fit.reduced_misfit <= selecting.little)]
        every = tuple(best_of_each(ended))
        return Ranked(tuple(promises), every, by_chance, frozenset(self._far), ways=self._ways)

    def _near_enough(
        self, state: State, told: State, here: State, promises: Sequence[Scored], hypotheses: Sequence[Hypothesis]
    ) -> bool:
        """Whether candidates need not be looked for where peaks do not overlap, after those where they do.

        Args:
            state: beside which they are looked for.
            told: the same beside the plate as it was told.
            here: the one of these that they were scored beside.
            promises: what they promised.
            hypotheses: what was refitted.
        """
        settings = self.settings.selecting
        least = min((one.fit.reduced_misfit for one in hypotheses), default=math.inf)
        if told is state:
            return kept(promises, hypotheses, state, self.settings.screening, settings.doubtful)
        if here is told and least <= self.settings.screening.nearly_right:
            # Of what was far off next to nothing is left, which smoothed FRFs would not show.
            return True
        return any(is_noise(one.fit) for one in hypotheses)

    def both(self, state: State, ranked: Ranked) -> Both | None:
        """Two effects that natural frequencies have together, where no one that was refitted leaves little.

        Args:
            state: without them.
            ranked: the catalogue beside it.
        """
        if self.by_frequencies.asked(state, ranked.hypotheses) is None:
            return None
        _, everyone = self.catalogue_beside(state)
        return self.by_frequencies.both(state, ranked.hypotheses, everyone)

    def from_there(self, state: State, best: Hypothesis, others: Sequence[Hypothesis], before: Fit) -> list[Hypothesis]:
        """A hypothesis with what came near it, fitted again from where that has been taken since.

        Args:
            state: without any of them.
            best: the hypothesis, where it is now.
            others: as they ended beside it, of which the better counts.
            before: where it had ended.
        """
        theta = best.beside(state.model)
        there = State(state.model, best.fit._replace(model=state.model, theta=theta))
        limit, beat = self.settings.searching.hopeless * best.fit.square, self._beat(state, [best])
        near = self.settings.selecting.beside * before.square
        found: list[Hypothesis] = []
        for one in others:
            if one.name == best.name or one.fit.square > near:
                continue
            whole = with_candidate(state.model, one.label, one.candidate)
            start = start_of(whole, theta, state.model, one.own, one.label)[None]
            again = self.refits.refit(there, one.candidate, one.label, start, limit, beat=beat)
            again = replace(again, coincidence=one.coincidence, n_option=one.n_option)
            found.append(min((one, again), key=lambda each: each.cost))
        if best.candidate.effect.to_ground:
            best, supports = self.grounded.as_supports(there, best, limit, beat)
            found += [one for one in supports if one.fit.reduced_misfit <= self.settings.selecting.little]
        return [best, *best_of_each(found)]

    def _scoring_beside(self, state: State) -> tuple[PlateModel, list[Candidate]]:
        """The same, and how many they are is said."""
        base, everyone = self.catalogue_beside(state)
        self.say(f"scoring {len(everyone)} candidates")
        return base, everyone

    def catalogue_beside(self, state: State) -> tuple[PlateModel, list[Candidate]]:
        """The plate that candidates are scored beside, in few modes, and all of them."""
        base = self.builder.reduced(state.fit.model, state.fit.theta[None], by_element=True, about=state.fit.about)
        base = self.builder.target.specimen(base, state.fit.theta, state.fit.about)
        rearranged = self._rearranged(state)
        everyone = candidates(base, state.fit.theta, self.channels, rearranged, self.prior.keys(), self.measured)
        n_option = n_options(everyone)
        n_option |= {"channel_swap": rearranged.n_swap, "channel_polarity": rearranged.n_polarity}
        self.refits.n_option = n_option
        return base, everyone

    def _hopeless(self, ends: Sequence[Hypothesis]) -> float:
        """The sum of squares beyond which a support at the same place is not asked for: the best is nearly right."""
        best = min(ends, key=lambda one: one.fit.square, default=None)
        if best is None or not best.fit.by_noise or best.fit.reduced_misfit > self.settings.screening.nearly_right:
            return math.inf
        return self.settings.searching.hopeless * best.fit.square

    def _rearranged(self, state: State) -> Rearrangements:
        """Exchanges and turns of channels that promise something."""
        target = self.builder.target
        weight = torch.where(target.measurement.measured, 1 / target.variance, 0.0)
        return rearrangements(self.channels, target.measured, state.fit.expected, weight)

    def _nearby(
        self,
        state: State,
        base: PlateModel,
        everyone: Sequence[Candidate],
        by_mesh: Tensor | None = None,
        says: Tensor | None = None,
        before: State | None = None,
    ) -> tuple[list[Scored], float]:
        """All candidates scored where peaks overlap; and what chance takes, where little is left before."""
        builder, near = self.builder, state.fit.marginal
        if says is None and (step := self._line_step(state)) > 1:
            builder = builder.against(every_nth(builder.target, step))
            near = builder.target.marginal(base, state.fit.theta, state.fit.about).rescaled(near.scale)
        draws = self._by_chance(before or state, builder.target)
        promises = screen(builder, base, state.fit.theta, everyone, self.prior, near, draws, says, by_mesh)
        if draws is None:
            return promises, 0.0
        drawn = [one for one in promises if len(one.by_chance)]
        every = torch.stack([one.by_chance for one in drawn])
        by_chance = once_in_a_hundred(every)
        limit = {id(one): at_most for one, at_most in zip(drawn, limits(every).tolist(), strict=True)}
        promises = [one._replace(by_chance_at_most=limit.get(id(one), 0.0)) for one in promises]
        self.say(f"  chance alone would let the best of them take {by_chance:.3g} from the sum of squares")
        return promises, by_chance

    def _widely(
        self, state: State, base: PlateModel, everyone: Sequence[Candidate]
    ) -> tuple[list[Scored], list[tuple[Scored, Tensor]]]:
        """All candidates scored where peaks need not overlap, and where the best end on the way down."""
        scored = screen(self.builder, base, state.fit.theta, everyone, self.prior)
        scored = self.afar.begun(state, base, scored)
        ways = promising(scored, self.settings.screening.n_wide, self.settings.screening)
        ways += [one for one in scored if one.candidate.replaces and all(one is not way for way in ways)]
        down = self.afar.down(state, ways)
        self._ways = tuple((one.candidate, starts[0]) for one, starts in down)
        self._far |= {one.candidate.name for one in ways} - {one.candidate.name for one, _ in down}
        return scored, down

    def _refitted(
        self,
        state: State,
        chosen: Sequence[tuple[Scored, Tensor]],
        before: Sequence[Hypothesis] = (),
        about: Found | None = None,
        first: Scored | None = None,
    ) -> list[Hypothesis]:
        """Candidates refitted from all their starts; hopeless ones, beside the best, not to their end.

        Args:
            state: without them.
            chosen: candidates with their starts.
            before: what was refitted already.
            about: the specimen, where it is known.
            first: the one of them that smoothed FRFs do not rule out.
        """
        about = about or known_section(state.fit)
        together: dict[str, tuple[Scored, list[Tensor]]] = {}
        for promise, starts in chosen:
            key = f"{promise.candidate.name} {promise.candidate.options}"
            together.setdefault(key, (promise, []))[1].append(starts)
        found: list[Hypothesis] = []
        every = [without_rigid(state.model, one, torch.cat(several)) for one, several in together.values()]
        for one, starts, begun in self._begun(state, every, about, first):
            simpler = contained(one.candidate, {other.name for other in found})
            if any(is_noise(other.fit) for other in found if other.name in simpler):
                # It leaves nothing for what is larger.
                continue
            least = min((other.fit.square for other in (*before, *found)), default=math.inf)
            limit = self.settings.searching.hopeless * least
            beat = self._beat(state, [*before, *found])
            found.append(self.refits.refit(state, one.candidate, one.label, starts, limit, about, begun, beat))
        return found

    def _checked(self, state: State, chosen: Sequence[tuple[Scored, Tensor]], by_chance: float) -> list[Hypothesis]:
        """Refits beside noise: what promises more than chance, or the best; and what may be its equivalent, if needed.

        Args:
            state: that leaves noise.
            chosen: candidates with their starts, the most promising first, but for simpler ones that they contain.
            by_chance: fall that chance alone exceeds once in a hundred times.
        """
        promises = [one for one, _ in chosen]
        above = [one for one in chosen if _exceeds_chance(one[0], state.fit.square, by_chance)] or list(chosen[:1])
        found = self._refitted(state, above)
        if any(is_needed(state.fit, one, chance_of(promises, one.name, by_chance)) for one in found):
            best = min((one.fit for one in found), key=lambda one: one.cost)
            # An equivalent takes nearly as much as the best, and of that a step that is linear shows half.
            least = state.fit.cost - best.cost - never_equivalent(best)
            least *= self.settings.selecting.explains_much / state.fit.square
            others = [one for one in chosen if one[0].drop >= least and all(one is not other for other in above)]
            found += self._refitted(state, others, found)
        return found

    def _beat(self, state: State, found: Sequence[Hypothesis], ended: bool = False) -> Beat:
        """What a fit has to come near in its first basis to be followed to its end.

        Those are followed that have gained a quarter of what the best has; or that are so near that they are run off
        with it, or are its equivalents.

        Args:
            state: without them.
            found: what was fitted.
            ended: whether that was run off already.
        """
        best = min((one.fit for one in found), key=lambda one: one.cost, default=None)
        if best is None or math.isinf(best.way):
            return NOBODY
        settings = self.settings.selecting
        near = apart(best, settings, ended or is_noise(state.fit))
        part = settings.explains_some
        pairs = (best.way, state.fit.way), (best.cost, state.fit.cost)
        way, cost = (
            here + max(close, part * (before - here)) for close, (here, before) in zip(near, pairs, strict=True)
        )
        return Beat(way, cost, is_noise(best))

    def _begun(
        self,
        state: State,
        every: list[tuple[Scored, Tensor]],
        about: Found | None = None,
        first: Scored | None = None,
    ) -> Sequence[tuple[Scored, Tensor, Begun | None]]:
        """Candidates in the order in which they are refitted: those that others contain first, then the nearest.

        How near they are is seen where their starts lead first: beside a specimen that is known, at the sharp level;
        where it is to be found with the parameters, at the end of the wide levels, and only those go on that stay near
        the best, and what promised most beside the specimen as it was found: smoothed FRFs say nearly nothing of a
        damping where peaks lie elsewhere, too.
        """
        every = sorted(every, key=lambda pair: len(pair[0].candidate.effect.contains))
        settings, target = self.settings, self.builder.target
        about = about or known_section(state.fit)
        if len(every) < 2 or target.wandering == UNIFORM:
            return [(one, starts, None) for one, starts in every]
        found: list[tuple[Scored, Tensor, Begun]] = []
        for one, starts in every:
            whole = with_candidate(state.model, one.label, one.candidate)
            found.append((one, starts, begin(self.builder, whole, starts, self.prior, about)))
        if about is None:
            least = sorted(begun.value for _, _, begun in found)
            most = max(settings.screening.near * least[0], least[settings.selecting.n_best - 1])
            self._far |= {one.candidate.name for one, _, begun in found if begun.value > most and one is not first}
            found = [one for one in found if one[2].value <= most or one[0] is first]
        return sorted(found, key=lambda one: (len(one[0].candidate.effect.contains), one[2].value))

    def _line_step(self, state: State) -> int:
        """Of how many lines one is looked at for the score test: where more than noise is left, few say as much."""
        target, screening = self.builder.target, self.settings.screening
        if state.fit.reduced_misfit <= screening.nearly_right:
            return 1
        n_line, n_frf = len(target.frequency), int(target.fitted.sum())
        wanted = -(-2 * n_line * n_frf // screening.most_numbers)
        return max(1, min(wanted, n_line // (screening.per_mode * target.n_mode)))

    def _by_chance(self, state: State, target: FrfTarget) -> Draws | None:
        """Residuals that chance alone makes, where what is left is not far above it; None elsewhere."""
        if not state.fit.by_noise or state.fit.reduced_misfit > self.settings.selecting.doubtful:
            return None
        n_told = int((state.fit.told > 0).sum())
        return Draws(2 * target.measured.numel(), n_told)

    def _again(self, state: State, before: Sequence[Hypothesis] = ()) -> list[Hypothesis]:
        """What came near in the ranking before, beside what was named there, from where it ended.

        Args:
            state: with what was named there.
            before: what was refitted beside it, beside the best of which the hopeless do not go to their end.
        """
        if state.ranked is None or state.previous is None or is_noise(state.fit):
            return []
        named = {one.hypothesis.name for one in state.named}
        near = [
            one
            for one in sorted(state.ranked.hypotheses, key=lambda one: one.cost)
            if one.name not in named and one.fit.left < self.settings.selecting.shows * state.previous.fit.left
        ]
        least = min((one.fit.square for one in before), default=math.inf)
        limit, beat = self.settings.searching.hopeless * least, self._beat(state, before)
        found = []
        for one in near[: self.settings.selecting.n_again]:
            label = new_label(state.model, one.name)
            whole = with_candidate(state.model, label, one.candidate)
            start = start_of(whole, state.fit.theta, state.model, one.own, label)
            found.append(self.refits.refit(state, one.candidate, label, start[None], limit, beat=beat))
        return found

    def _run_off(self, state: State, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Those close to the best once more, each with the mesh error taken off where it ended.

        Where more than noise is left and no specimen is fitted too, the best go on as long as that takes them further:
        valleys are narrow.
        """
        settings = self.settings.selecting
        found = sorted(hypotheses, key=lambda one: one.cost)
        for _ in range(settings.n_run_off if self.builder.target.trusts_the_noise and found else 0):
            least = found[0].cost
            # Beside a specimen that is fitted too, ways to one end agree to a few.
            fitted_too = self.builder.target.wandering != UNIFORM
            valley = settings.close + settings.close_part * found[0].fit.square
            within = never_equivalent(found[0].fit) if fitted_too else valley
            close = [one for one in found if one.cost - least < within]
            if not is_noise(found[0].fit) and not fitted_too:
                close = found[: max(settings.n_best, len(close))]
            if len(close) < 2:
                break
            ends = [(one, one.fit.model.space.to_cube(one.fit.theta)[None]) for one in close]
            again = [
                self.refits.refit(state, one.candidate, one.label, end, about=known_section(one.fit))
                for one, end in ends
            ]
            better = [min(pair, key=lambda one: one.cost) for pair in zip(close, again, strict=True)]
            found = sorted([*better, *found[len(close) :]], key=lambda one: one.cost)
            if least - found[0].cost < within:
                break
        return found


def _exceeds_chance(one: Scored, square: float, by_chance: float) -> bool:
    """Whether an effect promises to take more from a sum of squares than chance lets it."""
    return one.drop * square > (one.by_chance_at_most or by_chance)
