"""What earlier names are once the later ones are known: kept, replaced by what fits better now, or taken out again."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from torchplate.diagnosis.candidates.supports import STRENGTHS, supports_at
from torchplate.diagnosis.fit import NOBODY, Beat, fit
from torchplate.diagnosis.judged import Fit, settled
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate, without_candidate
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.criterion import (
    Hypothesis,
    choose,
    is_explained,
    is_needed,
    is_noise,
    known_section,
)
from torchplate.diagnosis.selection.details import idle_of
from torchplate.diagnosis.selection.near import to_beat
from torchplate.diagnosis.selection.ranking import Ranking
from torchplate.diagnosis.selection.trace import Naming, State
from torchplate.diagnosis.settings import SETTINGS
from torchplate.model import PlateModel


class Exchange:
    """Judges the named effects again, in the last model.

    Args:
        builder: builds and evaluates the models.
        ranking: ranks the catalogue.
        prior: what is known of the given model's parameters beforehand.
        say: is told what is being tried.
    """

    def __init__(self, builder: ModelBuilder, ranking: Ranking, prior: Prior, say: Callable[[str], None]) -> None:
        self.builder, self.ranking, self.prior, self.say = builder, ranking, prior, say
        self.settings = builder.target.settings.selecting
        # What was judged last, which is as it was judged.
        self._last: State | None = None
        # Of each name that was doubted, by its label, the gap that the others left last without it.
        self.left_without: dict[str, float] = {}

    def judged_again(self, state: State) -> State:
        """The names that are left where each is judged beside the others, if there are several."""
        if len(state.named) < 2 or state is self._last:
            return state
        state = self._as_one_support(state)
        found = self.beside_the_others(state, len(state.named) - 1)
        found = self.without_needless(found, self.builder, found.named)
        if [one.hypothesis.name for one in found.named] != [one.hypothesis.name for one in state.named]:
            # The others are not those that they were.
            found = self.beside_the_others(found, len(found.named))
        self._last = found
        return found

    def beside_the_others(self, state: State, n_first: int) -> State:
        """The first effects beside what came near them when they were named, now that the others are in the model.

        What was missing then may have spoken for it: a wire with a dashpot for a spring, where a window was missing.
        """
        for index in range(n_first):
            state = self._one_judged_again(state, index)
        return state

    def _one_judged_again(self, state: State, index: int) -> State:
        naming = state.named[index]
        here = self._in_its_numbers(state, naming)
        changed = here.candidate is not naming.hypothesis.candidate
        elsewhere = {one.hypothesis.name for one in state.named}
        near = sorted((one for one in naming.rivals if one.name not in elsewhere), key=lambda one: one.cost)
        promised = self._promised(state, naming) if self._is_far(state.fit) else []
        others = [one for one in near if one.name not in {other.name for other in promised}]
        others = others[: max(0, self.settings.n_rival - len(promised))]
        every = [here, *promised, *(self._in_place_of(state, naming, one) for one in others)]
        every += self._simpler(state, naming, choose(every, naming.before).best, every)
        choice = choose(every, naming.before)
        if choice.best.candidate.effect.to_ground:
            best = choice.best
            priced, supports = self.ranking.grounded.as_supports(self._without(state, naming), best)
            here = priced if best is here else here
            near += supports
            every = [*(priced if one is best else one for one in every), *supports]
            choice = choose(every, naming.before)
        held = choice.holds(here)
        if held and not changed:
            choice = choose(every, naming.before, here)
            kept = (*state.named[:index], replace(naming, again=choice), *state.named[index + 1 :])
            return replace(state, named=kept)
        # A name stays where it is as good as the best, if at another place.
        same = [one for one in every if one.name == here.name and choice.holds(one)]
        better = here if held else min(same, key=lambda one: one.cost, default=choice.best)
        choice = choose(every, naming.before, better)
        other = f" with {', '.join(better.candidate.searched)}" if better.name == naming.hypothesis.name else ""
        self.say(f"{better.name}{other} in place of {naming.hypothesis.name}")
        as_then = self._as_then([naming.hypothesis, *near], better)
        renamed = replace(
            naming, hypothesis=as_then, choice=choose([naming.hypothesis, *near], naming.before, as_then), again=choice
        )
        later = list(state.named[index + 1 :])
        if later and as_then is not better:
            later[0] = replace(later[0], before=as_then.fit)
        return replace(
            state,
            model=self._exchanged(state, naming, better),
            fit=better.fit,
            named=(*state.named[:index], renamed, *later),
        )

    def _simpler(self, state: State, naming: Naming, best: Hypothesis, tried: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What the best in place of a name contains and was not tried there, as a mass where an absorber was found."""
        known = {one.name for one in tried} | {one.hypothesis.name for one in state.named}
        names = {*best.candidate.effect.contains} - known
        if not names:
            return []
        without = self._without(state, naming)
        _, everyone = self.ranking.catalogue_beside(without)
        asked = [one for one in everyone if one.name in names]
        return self.ranking.instead.simpler(without, best, asked, self._beat(best.fit))

    def _in_its_numbers(self, state: State, naming: Naming) -> Hypothesis:
        """A named effect with those numbers that did nothing when it was named, and without those that do nothing now.

        What was missing then may have kept them where they did nothing.
        """
        here = replace(naming.hypothesis, fit=state.fit)
        if not state.fit.by_noise:
            return here
        forms = [here]
        if here.candidate.idle:
            forms.append(self._in_place_of(state, naming, replace(here, candidate=here.candidate.with_idle())))
        idle = idle_of(forms[-1])
        if idle and len(idle) < len(forms[-1].candidate.searched):
            simpler = replace(forms[-1], candidate=forms[-1].candidate.without(idle))
            forms.append(self._in_place_of(state, naming, simpler))
        return min(forms, key=lambda one: one.cost)

    def beside_those_in_doubt(self, state: State, coarse: Fit, builder: ModelBuilder) -> State:
        """Names beside their rivals on a finer mesh, where what the coarser one had left may be what told them apart.

        A rival that leaves noise, too, is in doubt where it came so near on the coarser mesh as the last model has
        gained on the finer one. What may be a support, which is looked for on the coarser mesh, is left as it is.

        Args:
            state: the last model on the finer mesh.
            coarse: its fit on the other one.
            builder: of the finer mesh.
        """
        twin = Exchange(builder, self.ranking, self.prior, self.say)
        for index, naming in enumerate(state.named):
            here = replace(naming.hypothesis, fit=coarse)
            near = here.cost + max(0.0, coarse.cost - state.fit.cost)
            doubted = tuple(
                one
                for one in naming.rivals
                if one.name != here.name
                and is_noise(one.fit)
                and one.cost <= near
                and not one.candidate.effect.to_ground
            )
            if here.candidate.effect.to_ground or {one.name for one in doubted} <= {*naming.known.equivalent}:
                continue
            self.say(f"  {here.name} beside {', '.join(one.name for one in doubted)} on the finer mesh")
            one = replace(naming, rivals=doubted)
            named = (*state.named[:index], one, *state.named[index + 1 :])
            state = twin._one_judged_again(replace(state, named=named), index)
            every = replace(state.named[index], rivals=naming.rivals)
            state = replace(state, named=(*state.named[:index], every, *state.named[index + 1 :]))
        return state

    @staticmethod
    def _as_then(every: Sequence[Hypothesis], better: Hypothesis) -> Hypothesis:
        """A hypothesis as it ended where the later names were not known yet; as it is, where it was not tried then."""
        own = {f"{better.label}.{key}" for key in better.candidate.searched}
        same = [one for one in every if (one.name, one.label) == (better.name, better.label)]
        same = [one for one in same if own <= {*one.fit.model.names}]
        same.sort(key=lambda one: (one.candidate is not better.candidate, one.cost))
        return replace(same[0], candidate=better.candidate) if same else better

    def _in_place_of(self, state: State, naming: Naming, rival: Hypothesis) -> Hypothesis:
        model = self._exchanged(state, naming, rival)
        rest = {f"{rival.label}.{key}": value for key, value in rival.candidate.neutral.items()}
        then = dict(zip(rival.fit.model.names, rival.fit.theta.tolist(), strict=True))
        now = dict(zip(state.model.names, state.fit.theta.tolist(), strict=True))
        # From where the rest is now, and from where the rival had it.
        ways = (then | now,) if rival.fit is state.fit else (then | now, now | then)
        starts = [[(rest | values)[name] for name in model.names] for values in ways]
        start = model.space.to_cube(torch.tensor(starts).to(state.fit.theta)).clamp(1e-3, 1 - 1e-3)
        limit = self._hopeless(state.fit)
        about, beat = known_section(state.fit), self._beat(state.fit)
        found = fit(self.builder, model, start, self.prior, wide=False, hopeless=limit, about=about, beat=beat)
        self.say(f"  {rival.name} in place of {naming.hypothesis.name}: misfit {found.reduced_misfit:.4g}")
        return replace(rival, fit=found)

    def _promised(self, state: State, naming: Naming) -> list[Hypothesis]:
        """What promises most in place of a name, now that the others are known, refitted there.

        Beside what lacked still when it was named, what belongs there may have explained nothing.
        """
        without = self._without(state, naming)
        model, theta, about = without.model, without.fit.theta, known_section(state.fit)
        corrected = self.builder.corrected(model, theta).model
        plain = self.builder.reduced(corrected, theta[None], about=about)
        position = model.space.to_cube(theta).clamp(0.0, 1.0)
        there = settled(self.builder, corrected, plain, self.prior, position, about, fitted_on=False)
        without = replace(without, fit=there, named=tuple(one for one in state.named if one is not naming))
        limit, found = self._hopeless(state.fit), []
        for one in self.ranking.promised(without)[: self.settings.n_rival // 2]:
            self.say(f"  {one.candidate.name} promises {one.drop:.3g} in place of {naming.hypothesis.name}")
            found.append(self.ranking.refits.refit(without, one.candidate, one.label, one.starts, limit))
        return found

    def _beat(self, now: Fit) -> Beat:
        """What another model has to come near: where noise is left, to be an equivalent."""
        return to_beat(now, self.settings, beside_noise=True) if is_noise(now) else NOBODY

    def _is_far(self, now: Fit) -> bool:
        """Whether far more than noise is left."""
        return now.by_noise and now.reduced_misfit > self.settings.doubtful

    def _hopeless(self, now: Fit) -> float:
        """The sum of squares beyond which a rival is not followed to its end.

        Where far more than noise is left, a rival is one more that does not explain it: it has to come as near as a
        second best that another effect is looked for beside.
        """
        return (self.settings.beside if self._is_far(now) else self.settings.hopeless_rival) * now.square

    def _as_one_support(self, state: State) -> State:
        """A spring and a dashpot to the ground at one place are a further support there, if that is as good."""
        pair = {key: one for one in state.named if (key := one.hypothesis.candidate.effect.to_ground)}
        values = state.model.as_dict(state.fit.theta)
        places = [[values[f"{one.hypothesis.label}.{key}"] for key in ("x", "y")] for one in pair.values()]
        if len(pair) < len(STRENGTHS) or math.dist(*places) > SETTINGS.trials.near_node:
            return state
        spring, dashpot = (pair[key] for key in STRENGTHS)
        alone = self._without(self._without(state, dashpot), spring)
        strength = [values[f"{pair[key].hypothesis.label}.{key}"] for key in STRENGTHS]
        supports = [
            self.ranking.refits.from_trials(alone, candidate, alone.fit.theta)
            for candidate in supports_at(alone.model, alone.fit.theta, *places[0], *strength)
        ]
        best = min(supports, key=lambda one: one.cost)
        both = replace(spring.hypothesis, fit=state.fit, coincidence=dashpot.hypothesis.prior)
        if best.cost > both.cost:
            return state
        self.say(f"{best.name} in place of {spring.hypothesis.name} and {dashpot.hypothesis.name}")
        choice = choose([best, spring.hypothesis, *spring.rivals], spring.before, best)
        rest = [one for one in state.named if one is not dashpot]
        one = replace(spring, hypothesis=best, choice=choice, again=choice)
        named = tuple(one if other is spring else other for other in rest)
        return replace(state, model=with_candidate(alone.model, best.label, best.candidate), fit=best.fit, named=named)

    @staticmethod
    def _without(state: State, naming: Naming) -> State:
        """As if it had not been named; its fit says where the rest was."""
        model = without_candidate(state.model, naming.hypothesis.label, naming.hypothesis.candidate)
        kept = [state.model.names.index(name) for name in model.names]
        return State(model, state.fit._replace(model=model, theta=state.fit.theta[kept]))

    @staticmethod
    def _exchanged(state: State, naming: Naming, rival: Hypothesis) -> PlateModel:
        without = without_candidate(state.model, naming.hypothesis.label, naming.hypothesis.candidate)
        return with_candidate(without, rival.label, rival.candidate)

    def without_improbable(self, state: State, builder: ModelBuilder) -> State:
        """Without those names that are less probable than it was beforehand that no effect describes what is missing.

        Where more than noise is left, a name accounts for what it takes off the gap, and for no more.

        Args:
            state: the last model.
            builder: on whose mesh it was fitted.
        """
        explained = is_explained(state.fit, builder.target)
        sure = {id(one): one.confidence(state.fit, explained) for one in state.named}
        worst = min(state.named, key=lambda one: sure[id(one)], default=None)
        if worst is None or explained or sure[id(worst)] >= state.fit.comparison.beyond:
            return state
        self.say(f"{worst.hypothesis.name} takes nothing off the gap in the end: it is no name")
        return self.without_improbable(self._fitted_without(state, worst, builder), builder)

    def without_needless(self, state: State, builder: ModelBuilder, doubted: Sequence[Naming]) -> State:
        """Take out again those of the doubted effects that the other ones made needless.

        Where noise is all that is left, so are those without which the gap is narrower by more than noise makes it:
        what they explain is beside the peaks, and the peaks speak against them.
        """
        for naming in doubted:
            # What leaves so much without it needs it, wherever it ends.
            limit = builder.target.settings.searching.hopeless * state.fit.square
            without = self._fitted_without(state, naming, builder, limit)
            back = replace(naming.hypothesis, fit=state.fit)
            self.left_without[naming.hypothesis.label] = without.fit.left
            wider = state.fit.left**2 - without.fit.left**2 > builder.target.floor**2
            if not is_needed(without.fit, back, naming.by_chance) or (wider and is_noise(state.fit)):
                self.say(f"{naming.hypothesis.name} is no longer needed")
                return self.without_needless(without, builder, [one for one in doubted if one is not naming])
        return state

    def _fitted_without(self, state: State, naming: Naming, builder: ModelBuilder, hopeless: float = math.inf) -> State:
        """Fitted without one of its names, from where the rest was, and from where it was beside others in its place.

        Where many of these leave nothing but noise, what they have in common is the rest: that of one whose effect does
        nothing is where the rest alone ends, while beside the name it may have gone to where it does not do without.

        Args:
            state: with it.
            naming: it.
            builder: on whose mesh.
            hopeless: sum of squares beyond which it need not come to its end.
        """
        without = self._without(state, naming)
        rest = without.model.as_dict(without.fit.theta)
        instead = [one.fit for one, _ in naming.again.every] if naming.again and is_noise(state.fit) else []
        others = [one.model.as_dict(one.theta) for one in instead if one is not state.fit and is_noise(one)]
        places = [rest, *(rest | one for one in others)]
        theta = torch.tensor([[one[name] for name in without.model.names] for one in places]).to(state.fit.theta)
        # What an interval was widened for may lie outside of it.
        start = without.model.space.to_cube(theta).clamp(0.0, 1.0)
        about = known_section(state.fit)
        beat = NOBODY if math.isinf(hopeless) else self._beat(state.fit)
        found = fit(builder, without.model, start, self.prior, wide=False, hopeless=hopeless, about=about, beat=beat)
        return State(without.model, found, tuple(one for one in state.named if one is not naming))
