"""Two effects where one does not do: the best with one more, or two that promise much and explain little alone."""

import math
from collections.abc import Callable
from dataclasses import replace

from torchplate.diagnosis.judged import judged_at
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.by_frequencies import Both
from torchplate.diagnosis.selection.criterion import Hypothesis, choose, evidence, is_needed, is_noise, weight_of
from torchplate.diagnosis.selection.exchange import Exchange
from torchplate.diagnosis.selection.screen import twins
from torchplate.diagnosis.selection.shortlist import best_of_each
from torchplate.diagnosis.selection.steps import Steps, added, judged
from torchplate.diagnosis.selection.trace import Ranked, State
from torchplate.diagnosis.selection.worth import explains_some


class Pairs:
    """Looks for them.

    Args:
        builder: makes and evaluates models, beside the evidence.
        prior: what is known of the given model's parameters beforehand.
        steps: the catalogue beside a model, and a model with the best of it.
        exchange: judges each of two again beside the other.
        say: is told what is being tried.
    """

    def __init__(
        self, builder: ModelBuilder, prior: Prior, steps: Steps, exchange: Exchange, say: Callable[[str], None]
    ) -> None:
        self.builder, self.prior, self.steps, self.exchange, self.say = builder, prior, steps, exchange, say
        self.settings = builder.target.settings.selecting

    def beside_the_best(
        self, state: State, ranked: Ranked, single: State, rankings: list[Ranked]
    ) -> tuple[State | None, State | None]:
        """The best with one effect more, from the few that explain so much that looking beside them is worth it.

        Returns:
            It, if there is one; and the one that leaves nothing but noise, settled, if there is one.
        """
        settings = self.settings
        ordered = sorted(ranked.hypotheses, key=lambda one: one.cost)
        most = settings.beside * ordered[0].fit.reduced_misfit
        both = self.steps.ranking.both(state, ranked)
        told = None if both is None else self._with_the_first(state, ranked, both)
        beam: list[State] = [] if told is None else [told]
        if explains_some(state.fit, single.named[-1].hypothesis, settings):
            beam += [*self._where_smoothed(single, ranked), single]
        for other in ordered[1:]:
            if len(beam) >= settings.n_best or other.fit.reduced_misfit > most:
                break
            if is_needed(state.fit, other, ranked.chance(other.name)) and explains_some(
                state.fit, other, settings, by_cost=True
            ):
                beam.append(added(state, choose(ordered, state.fit, other), ranked))
        best: State | None = None
        # What frequencies say takes nobody's turn.
        for rank, start in enumerate(beam, start=0 if told is None else -1):
            if rank > 0 and self.builder.n_evaluation > settings.enough:
                break
            names = " + ".join(one.hypothesis.name for one in start.named)
            self.say(f"{names} leaves {start.fit.reduced_misfit:.3g}: looking for what else is missing")
            needed = self.steps.needed(start, rankings)
            if both is not None and start is told:
                rankings[-1] = replace(
                    rankings[-1], hypotheses=tuple(best_of_each([*rankings[-1].hypotheses, both.second]))
                )
                needed = judged(start, rankings[-1])
            if needed is not None and start.model is single.model and single.fit.cost < start.fit.cost:
                # Smoothed FRFs had taken it there, which is no end of it: what a second is worth shows beside its end.
                start, needed = single, judged(single, needed[1])
            if needed is None:
                continue
            found = added(start, *needed)
            much_less = found.fit.square <= settings.much_less * start.fit.square
            if not is_noise(found.fit) and found.fit.by_noise and much_less:
                # Two of a kind may have changed places, as two kinds of damping: which is cheaper to see so.
                found = self.exchange.judged_again(found)
            if best is None or found.fit.cost < best.fit.cost:
                best = found
                if (settled := self.steps.explained(found)) is not None:
                    return best, settled
        return best, None

    @staticmethod
    def _with_the_first(state: State, ranked: Ranked, both: Both) -> State:
        """The model with the first of two effects that natural frequencies have together, where it is beside both."""
        ranked = replace(ranked, hypotheses=(*ranked.hypotheses, both.first))
        return added(state, choose(ranked.hypotheses, state.fit, both.first), ranked)

    def _where_smoothed(self, single: State, ranked: Ranked) -> list[State]:
        """The model with its last effect where smoothed FRFs had taken it, if far more than noise is left of it.

        Sharply it went to where what lacks still let it, which may hide that; smoothed FRFs see both.
        """
        last = single.named[-1].hypothesis
        end = next((end for candidate, end in ranked.ways if candidate is last.candidate), None)
        if end is None or not single.fit.by_noise or single.fit.reduced_misfit <= self.settings.doubtful:
            return []
        return [replace(single, fit=judged_at(self.builder, last.fit, self.prior, end))]

    def that_promise(self, state: State, rankings: list[Ranked], most_effects: int) -> State | None:
        """Two effects of which neither alone explains anything, though smoothed FRFs promised much of one.

        Beside a level that is wrong no peaks overlap, and beside peaks that do not overlap no level is right.
        """
        settings = self.settings
        if state.named or most_effects < 2 or is_noise(state.fit) or not state.fit.by_noise or not rankings:
            return None
        if len(rankings) > 1 and self.builder.n_evaluation > settings.enough:
            # Two were looked for already, from the best one.
            return None
        ranked = rankings[0]
        promised = {one.candidate.name: one for one in reversed(ranked.promises)}
        alike = dict(zip((one.candidate.name for one in ranked.promises), twins(ranked.promises), strict=True))
        chosen: list[Hypothesis] = []
        # A support at a place that was found was not scored.
        scored = [one for one in ranked.hypotheses if one.name in promised]
        ends = {id(candidate): (rank, end) for rank, (candidate, end) in enumerate(ranked.ways)}

        def nearest_first(one: Hypothesis) -> tuple[int, float]:
            """Those that smoothed FRFs were followed to, the nearest first; the others by what they promised."""
            rank, _ = ends.get(id(one.candidate), (len(ends), None))
            return rank, -promised[one.name].drop

        for one in sorted(scored, key=nearest_first):
            much = promised[one.name].drop >= 1 - settings.explains_much
            if much and not any(other.name in alike[one.name] for other in chosen):
                chosen.append(one)
        best: State | None = None
        for rank, one in enumerate(chosen[: settings.n_best]):
            if rank and self.builder.n_evaluation > settings.enough:
                break
            self.say(f"{one.name} promised much and explains little: looking for what else is missing")
            start = added(state, choose(ranked.hypotheses, state.fit, one), ranked)
            _, end = ends.get(id(one.candidate), (0, None))
            if end is not None:
                # Sharply it went to where the other, which lacks, let it; smoothed FRFs see both.
                start = replace(start, fit=judged_at(self.builder, one.fit, self.prior, end))
            needed = self.steps.needed(start, rankings)
            if needed is None:
                continue
            found = added(start, *needed)
            if best is None or found.fit.cost < best.fit.cost:
                best = found
            if is_noise(found.fit):
                break
        if best is None:
            return None
        weight = weight_of([state.fit, best.fit])
        none = evidence(state.fit, weight) - 2 * math.log(1 - state.fit.comparison.missing)
        named = [one.hypothesis for one in best.named]
        both = evidence(best.fit, weight) + sum(one.prior + one.rarity(weight, best.fit) for one in named)
        return best if both < none else None

    def that_stay(self, pair: State, rankings: list[Ranked]) -> State:
        """Two effects judged again; with one more where only one of them stays, and leaves more than noise.

        What promised much beside peaks that do not overlap may only have led to the other.
        """
        state = self.exchange.judged_again(pair)
        if not 0 < len(state.named) < len(pair.named) or is_noise(state.fit):
            return state
        names = " + ".join(one.hypothesis.name for one in state.named)
        self.say(f"{names} leaves {state.fit.reduced_misfit:.3g}: looking for what else is missing")
        needed = self.steps.needed(state, rankings)
        return state if needed is None else added(state, *needed)
