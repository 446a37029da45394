"""Forward selection: from a model that does not explain a measurement, one effect after another, to one that does.

A baseline first. Then, as long as an effect of the catalogue is more probable than none: score all of them, refit the
most promising, name the best with its equivalents, add it; where one alone does not do, pairs are tried from the best
two. In the end each name is judged again beside the others.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.basins import fit_from_the_box
from torchplate.diagnosis.candidates.catalogue import channels_of
from torchplate.diagnosis.field.law import Law
from torchplate.diagnosis.fit import Beat, fit
from torchplate.diagnosis.holdout import exchanged, outliers
from torchplate.diagnosis.judged import Fit, judged_at
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior, Problem
from torchplate.diagnosis.selection.attached import Attached
from torchplate.diagnosis.selection.criterion import (
    Choice,
    choose,
    is_explained,
    is_needed,
    is_noise,
    known_section,
    weight_of,
)
from torchplate.diagnosis.selection.exchange import Exchange
from torchplate.diagnosis.selection.grounded import is_alone
from torchplate.diagnosis.selection.pairs import Pairs
from torchplate.diagnosis.selection.ranking import Ranking
from torchplate.diagnosis.selection.settling import Settling
from torchplate.diagnosis.selection.shortlist import best_of_each
from torchplate.diagnosis.selection.steps import Steps, added, judged
from torchplate.diagnosis.selection.trace import Ranked, State
from torchplate.diagnosis.selection.worth import explains_much, tried_enough, worth_their_names
from torchplate.diagnosis.target import FrfTarget
from torchplate.diagnosis.tolerance import measured, with_tolerances
from torchplate.model import PlateModel


class ForwardSelection:
    """All of it, each part of which can be taken alone.

    Args:
        builder: makes and evaluates models, beside the evidence.
        prior: what is known of the given model's parameters beforehand.
        say: is told what is being tried.
        measured: names in the prior that somebody has measured himself; left out, all.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        prior: Prior,
        say: Callable[[str], None],
        measured: Collection[str] | None = None,
    ) -> None:
        self.builder, self.prior, self.say, self.measured = builder, prior, say, measured
        self.settings = builder.target.settings.selecting
        channels = channels_of(builder.given)
        self.ranking = Ranking(builder, prior, channels, say, self._beside_a_finer_mesh, measured)
        self.exchange = Exchange(builder, self.ranking, prior, say)
        self.settling = Settling(builder, prior, self.ranking, self.exchange, say)
        self.steps = Steps(builder, self.ranking, self.settling)
        self.pairs = Pairs(builder, prior, self.steps, self.exchange, say)
        # A baseline, and where it ended on the given mesh: asked for before effects are looked for, and in the end.
        self._on_given_mesh: tuple[Fit, Fit] | None = None

    def against(self, target: FrfTarget) -> "ForwardSelection":
        """The same beside other evidence."""
        return ForwardSelection(self.builder.against(target), self.prior, self.say, self.measured)

    @classmethod
    def of(
        cls, model: PlateModel, target: FrfTarget, tolerance: Mapping[str, float], say: Callable[[str], None]
    ) -> "ForwardSelection":
        """On a mesh whose error is taken off, with what is left of it among the nuisances.

        Args:
            model: the given one.
            target: what it is held against.
            tolerance: how well its numbers are known.
            say: is told what is being tried.
        """
        given, prior = with_tolerances(model, tolerance)
        builder = ModelBuilder(given, target)
        middle = builder.given.space.to_si(given.known.new_full((len(given.names),), 0.5))
        found = builder.corrected(builder.given, middle)
        return cls(builder.thinned(found).expecting(found), prior, say, measured(prior, tolerance))

    def baseline(self) -> State:
        """The given model, fitted on a mesh whose error is taken off."""
        builder, model = self.builder, self.builder.given
        self.say(f"baseline: fitting {', '.join(model.names) or 'nothing'}")
        found = fit_from_the_box(builder, model, self.prior)
        self.say(f"baseline: misfit {found.reduced_misfit:.3g} times what noise and nuisances explain")
        return State(model, found)

    def on_the_given_mesh(self, baseline: State) -> tuple["ForwardSelection", State] | None:
        """The given model on its own mesh, where that leaves noise alone and a mesh without error far more.

        Then the FRFs hold that mesh's error, as those that were computed on it do, and effects would stand in for it.
        """
        if baseline.fit.reduced_misfit <= self.settings.far_off:
            return None
        builder = ModelBuilder(self.builder.plain, self.builder.target, as_given=True)
        found = self.settling.as_given_from(builder, builder.given, baseline.fit, wide=True)
        self._on_given_mesh = baseline.fit, found
        self.builder.count(builder.n_evaluation)
        if not is_explained(found, builder.target):
            return None
        self.say("the given mesh, with its error, leaves nothing but noise")
        return ForwardSelection(builder, self.prior, self.say, self.measured), State(builder.given, found)

    def robust_baseline(self, baseline: State) -> tuple["ForwardSelection", State]:
        """The baseline where channels that disagree with all others do not bend it; the fits then see these.

        Channels read the other way round are turned, and FRFs far worse than the others left out, for the baseline's
        own fit alone.
        """
        target = self.builder.target
        baseline = self._beside_turned(baseline)
        odd = outliers(target.measurement.measured, self._misfit(baseline))
        if not bool(odd.any()):
            return self, baseline
        self.say(f"baseline: {int(odd.sum())} FRFs disagree with all others and are left out of its fit")
        alone = self.against(target.holding_out(target.heldout | odd)).again(baseline)
        changed = exchanged(target.heldout, target.measurement.measured, self._misfit(alone))
        twin = self.against(target.holding_out(changed))
        beside = twin.here(alone)
        if not bool(outliers(target.measurement.measured, twin._misfit(beside)).any()):
            # They disagreed with a baseline that had ended elsewhere, and agree with this one, which takes them in.
            beside = twin.again(beside)
        return twin, beside

    def _misfit(self, baseline: State) -> Float[Tensor, "n_response n_reference"]:
        """Mean square of each FRF's residuals over what noise and nuisances make expected."""
        fit, target = baseline.fit, self.builder.target
        every = target.holding_out(torch.zeros_like(target.heldout))
        power = every.marginal(fit.reduced, fit.theta, fit.about).power()
        square = (target.measured - fit.expected).abs().square()
        return torch.where(power > 0, square / power.clamp(min=1e-300), 0.0).mean(0)

    def _beside_turned(self, baseline: State) -> State:
        """The baseline as it is beside FRFs of the signs that suit it, if that takes it much nearer."""
        target, model = self.builder.target, baseline.model
        if not len(model.names):
            return baseline
        problem = Problem(self.builder, baseline.fit.reduced, {})
        n = target.settings.searching.n_spread
        spread = SobolEngine(len(model.names)).draw(n, dtype=torch.float64)
        members = torch.cat([model.space.to_cube(baseline.fit.theta)[None], spread])
        sign, part = target.signs(problem.predict(model.space.to_si(members), 0))
        if part > self.settings.explains_much or bool((sign > 0).all()):
            return baseline
        turned = self.against(target.turned(sign))
        found = turned.baseline()
        if found.fit.square > self.settings.explains_much * baseline.fit.square:
            return baseline
        self.say(f"baseline: fitted beside {int((sign < 0).sum())} FRFs turned round")
        return self.here(found)

    def here(self, state: State) -> State:
        """A fitted model as it is, judged beside this evidence."""
        position = state.model.space.to_cube(state.fit.theta)
        return State(state.model, judged_at(self.builder, state.fit, self.prior, position))

    def again(self, baseline: State) -> State:
        """The baseline beside this evidence, from where it was."""
        start = baseline.model.space.to_cube(baseline.fit.theta)[None]
        about = known_section(baseline.fit)
        return State(baseline.model, fit(self.builder, baseline.model, start, self.prior, wide=False, about=about))

    def inflated(self, baseline: State) -> tuple["ForwardSelection", State]:
        """The baseline again, where what is left is far above the noise, weighed by what the model as such leaves."""
        self.say("what is left is far above the noise: residuals are weighed by an inflated model error from here on")
        twin = self.against(self.builder.target.inflated(baseline.fit.prediction))
        start = baseline.model.space.to_cube(baseline.fit.theta)[None]
        found = fit(twin.builder, baseline.model, start, self.prior)
        return twin, State(baseline.model, found)

    def as_given(self, final: State) -> tuple[Fit, Fit | None]:
        """The fits of the given model and of the last one on the given mesh, error and all.

        Whether the mesh shows is asked of a model that lacks nothing else: of the given one only where nothing was
        named.

        Args:
            final: the last model.
        """
        builder = ModelBuilder(self.builder.plain, self.builder.target, as_given=True)
        begun, unrefined = self.begun, None

        before, given = self._on_given_mesh or (None, None)
        if given is None or before is not begun.fit:
            given = self.settling.as_given_from(builder, builder.given, begun.fit, wide=True)
        if final.named and not builder.held:
            unrefined = self.settling.as_given_from(builder, builder.adopt(final.model), final.fit, wide=False)
        self.builder.count(builder.n_evaluation)
        return given, unrefined

    def add_effects(self, state: State, most_effects: int) -> tuple[State, list[Ranked]]:
        """Add effects as long as they are needed and there are some; `begun` is what they were added to."""
        self.begun, lowered = state, False
        rankings: list[Ranked] = []
        while len(state.named) < most_effects:
            needed = self.steps.needed(state, rankings)
            if needed is None:
                break
            choice, rankings[-1] = self._restarted(state, *needed)
            ranked = rankings[-1]
            single = added(state, choice, ranked)
            # The best alone leaves nothing but noise, or others were fitted from where it does.
            alone = is_alone(choice.best, ranked) or (ranked is not needed[1] and is_noise(choice.best.fit))
            if not state.named and (lower := self._lower(state, single, ranked, alone)) is not None:
                # The ranking was beside another baseline: it holds where this was the second time, or no other did.
                holds = (lowered or alone) and is_needed(lower.fit, choice.best, ranked.chance(choice.best.name))
                self.begun, state, lowered = lower, lower, True
                if not holds:
                    rankings = []
                    continue
                single = added(state, choice, ranked)
            room = len(single.named) < most_effects
            if (settled := self.steps.explained(single)) is not None:
                return (self._one_more(single, settled, rankings) if room else None) or settled, rankings
            # One alone does not do: the best pair need not begin with the best single one.
            further, settled = self.pairs.beside_the_best(state, ranked, single, rankings) if room else (None, None)
            if settled is not None:
                return settled, rankings
            state = further or single
            if (
                further is None
                or not explains_much(state, self.builder)
                or tried_enough(state, self.builder.n_evaluation, self.settings)
            ):
                break
        state = worth_their_names(state, self.builder)
        if (pair := self.pairs.that_promise(state, rankings, most_effects)) is not None:
            state = worth_their_names(self.pairs.that_stay(pair, rankings), self.builder)
        return self.settling.last(state, self.begun), rankings

    def attached(
        self, rankings: Sequence[Ranked], theta: Tensor, place: Float[Tensor, " 2"], law: Law
    ) -> tuple[State, Ranked] | None:
        """What the catalogue has for a force at one place, if it leaves nothing but noise as the force does.

        Args:
            rankings: beside nothing, and beside what was named then, which counts no more.
            theta: parameters beside the force.
            place: of the force, relative.
            law: how it pulls there.
        """
        begun, here = self.begun, Attached(self.builder, self.prior, self.ranking).at(self.begun, theta, place, law)
        if not here or not rankings:
            return None
        ranked = replace(rankings[0], hypotheses=tuple(best_of_each([*here, *rankings[0].hypotheses])))
        needed = judged(begun, ranked)
        if needed is None or all(one is not needed[0].best for one in here):
            return None
        settled = self.steps.explained(added(begun, *needed))
        return None if settled is None else (settled, ranked)

    def _restarted(self, state: State, choice: Choice, ranked: Ranked) -> tuple[Choice, Ranked]:
        """The best hypothesis from where members spread over the box lead, if more than noise is left of it.

        A baseline that lacks an effect may have ended in a basin of its own, and its effects with it: what came near
        the best is then fitted again from there, too. It counts by what hypotheses are compared by: an end that is
        nearer, but where numbers are far from what is known of them, may be less probable than the one before.
        """
        best = choice.best
        if is_noise(best.fit) or not best.fit.by_noise:
            return choice, ranked
        whole = best.fit.model
        start = whole.space.to_cube(best.fit.theta)[None]
        free = [index for index, name in enumerate(whole.names) if name in state.model.names]
        found = fit_from_the_box(
            self.builder, with_candidate(state.model, best.label, best.candidate), self.prior, start, free, best.fit
        )
        there, weight = replace(best, fit=found), weight_of([best.fit, found])
        if found.cost >= best.fit.cost or there.against(weight) >= best.against(weight):
            return choice, ranked
        self.say(f"  {best.name}: misfit {found.reduced_misfit:.4g} from elsewhere in the box")
        every = self.ranking.from_there(state, there, ranked.hypotheses, best.fit)
        seen = {one.name for one in every}
        every += [one for one in ranked.hypotheses if one.name not in seen]
        return choose(every, state.fit), replace(ranked, hypotheses=tuple(every))

    def _lower(self, state: State, single: State, ranked: Ranked, alone: bool) -> State | None:
        """The given model fitted from where it is beside the first effect, if it ends lower there than it did.

        Where that effect alone leaves noise, a baseline counts that leaves little more: others change no name.
        """
        values = single.model.as_dict(single.fit.theta)
        start = torch.tensor([[values[name] for name in state.model.names]]).to(state.fit.theta)
        # What it begins with may be farther off than where it ended before.
        far = self.settings.beside * state.fit.square
        limit = min(far, self.builder.target.settings.searching.hopeless * single.fit.square) if alone else far
        position = state.model.space.to_cube(start)
        about = known_section(single.fit)
        beat = Beat(state.fit.way, state.fit.cost)
        found = fit(self.builder, state.model, position, self.prior, False, limit, about, beat=beat)
        fallen = found.square <= (1 - self.settings.stopped_soon) * state.fit.square
        # Far above the noise, two ends of one valley differ by more than that, and no name hangs on which it is.
        little = state.fit.reduced_misfit <= self.settings.doubtful
        likelier = little and found.cost < state.fit.cost - max(1.0, ranked.by_chance)
        if not found.by_noise or not (fallen or likelier) or (alone and found.square > limit):
            return None
        self.say(f"baseline: misfit {found.reduced_misfit:.3g} from there, without it")
        return replace(state, fit=found)

    def _one_more(self, before: State, state: State, rankings: list[Ranked]) -> State | None:
        """With one effect more, settled, where that is more probable than noise alone; None where none is.

        On the mesh that the state was settled on, something has to promise more than chance and that mesh take: on a
        coarser one, what the mesh leaves hides in the noise, too.

        Args:
            before: as it was before it was settled.
            state: settled; or the same, where it is not noise alone that a finer mesh leaves.
            rankings: the new one joins them.
        """
        self.say("nothing but noise is left: looking for what hides in it")
        if state is not before and (scored := self.settling.nothing_hides(before, state)) is not None:
            rankings.append(scored)
            return None
        needed = self.steps.needed(before, rankings)
        return None if needed is None else self.steps.explained(added(before, *needed), doubted=True)

    def _beside_a_finer_mesh(self, state: State) -> Ranked | None:
        # Settling itself asks the ranking, which is made before it.
        return self.settling.beside_a_finer_mesh(state)
