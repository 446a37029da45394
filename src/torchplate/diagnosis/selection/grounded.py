"""What is grounded at a place, and the supports that it may be."""

import math
from dataclasses import replace

import torch

from torchplate.diagnosis.candidates.supports import STRENGTHS, supports_at, tighter_at
from torchplate.diagnosis.fit import NOBODY, Beat
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.selection.criterion import Hypothesis, is_noise, weight_of
from torchplate.diagnosis.selection.refit import Refits
from torchplate.diagnosis.selection.trace import Ranked, State


class Grounded:
    """Asks of what is grounded whether it is a support.

    Args:
        builder: builds and evaluates the models.
        refits: refits candidates.
    """

    def __init__(self, builder: ModelBuilder, refits: Refits) -> None:
        self.builder, self.refits = builder, refits
        self.settings = builder.target.settings.selecting

    def as_supports(
        self,
        state: State,
        found: Hypothesis,
        hopeless: float = math.inf,
        beat: Beat = NOBODY,
        taken_up: bool = False,
    ) -> tuple[Hypothesis, list[Hypothesis]]:
        """What is grounded at a place, with the penalty of ending at a support; and the supports that it may be.

        Where no support is, that is a further one, spring and dashpot at once; else the one that is there, tighter.
        Both are asked for where it may be at a support. One whose stiffness ends at the least that is looked for holds
        nothing: that is the dashpot which was found, whatever two descents of the same ended apart.

        Args:
            state: without it.
            found: with it.
            hopeless: sum of squares beyond which no fit is followed to its end.
            beat: what the supports have to come near for that.
            taken_up: whether it was fitted from where a support led already.
        """
        if found.fit.reduced_misfit > self.settings.grounded:
            return found, []
        values = dict(zip(found.fit.model.names, found.fit.theta.tolist(), strict=True))
        at = {name: values.get(f"{found.label}.{name}", 0.0) for name in ("x", "y", *STRENGTHS)}
        theta = torch.tensor([values[name] for name in state.model.names]).to(state.fit.theta)
        place = [found.fit.model.names.index(f"{found.label}.{axis}") for axis in ("x", "y")]
        spread = found.fit.covariance[place][:, place]
        tighter = tighter_at(state.model, theta, at["x"], at["y"], at["stiffness"], spread)
        if tighter is not None:
            found = replace(found, coincidence=tighter.coincidence)
        further = [] if tighter and tighter.there else supports_at(state.model, theta, *at.values())
        refit = [
            self._priced(self.refits.from_trials(state, one, theta, hopeless, beat), found)
            for one in (*further, *([tighter.candidate] if tighter else []))
        ]
        if further and not taken_up:
            best = min(refit[: len(further)], key=lambda one: one.fit.cost)
            # One number more takes 1 by chance, in the mean; else it is there, or the way without it had stopped short.
            nearer = found.fit.cost - 1 / weight_of([best.fit]).likelihood
            if best.fit.cost < nearer:
                again = self._from_support(state, found, best, hopeless, nearer)
                if again.fit.cost < nearer:
                    return self.as_supports(state, again, hopeless, beat, taken_up=True)
        return found, [one for one in refit if not _is_slack(one)]

    def _priced(self, support: Hypothesis, found: Hypothesis) -> Hypothesis:
        """A support at a place that a spring or dashpot has found, with what the choice of the place costs.

        A labelled node is one of many; any other place is known as well as the fit that found it says.
        """
        mesh = self.builder.mesh
        if "nodes" in support.candidate.options and support.name == "support_spring":
            return replace(support, n_option=mesh.n_label)
        if "at" not in support.candidate.options or support.name != "support_spring":
            return support
        index = [found.fit.model.names.index(f"{found.label}.{axis}") for axis in ("x", "y")]
        spread = found.fit.covariance[index][:, index].det().clamp(min=1e-300)
        part = 2 * math.pi * float(spread.nan_to_num(1.0)) ** 0.5
        return replace(support, coincidence=max(0.0, -2 * math.log(min(1.0, part))))

    def _from_support(
        self, state: State, found: Hypothesis, support: Hypothesis, hopeless: float, nearer: float
    ) -> Hypothesis:
        """What is grounded at a place, fitted from where a support at that place took the rest of the model.

        Args:
            state: without it.
            found: with it, where it had ended.
            support: at that place.
            hopeless: sum of squares beyond which the fit is not followed to its end.
            nearer: −2 ln of the posterior probability below which its end counts.
        """
        whole = found.fit.model
        values = dict(zip(whole.names, found.fit.theta.tolist(), strict=True))
        for name, value in zip(support.fit.model.names, support.fit.theta.tolist(), strict=True):
            own = name.replace(f"{support.label}.", f"{found.label}.", 1)
            if own in values:
                values[own] = value
        start = torch.tensor([list(values.values())]).to(found.fit.theta)
        starts, beat = whole.space.to_cube(start), Beat(found.fit.way, nearer, is_noise(found.fit))
        return self.refits.refit(state, found.candidate, found.label, starts, hopeless, beat=beat)


def is_alone(best: Hypothesis, ranked: Ranked) -> bool:
    """Whether the best of a ranking alone leaves nothing but noise.

    What is grounded and the support that it may be are one: such a support was not scored.
    """
    scored = {one.candidate.name for one in ranked.promises}
    noise = [one for one in ranked.hypotheses if is_noise(one.fit)]
    ways = [one for one in noise if one.name in scored]
    if len(ways) == 1 and len(noise) > 1:
        return ways[0].candidate.effect.to_ground is not None and any(one.name == best.name for one in noise)
    return [one.name for one in noise] == [best.name]


def _is_slack(support: Hypothesis) -> bool:
    """Whether a further support ends without stiffness."""
    model, stiffness = support.fit.model, f"{support.label}.stiffness"
    if support.name != "support_spring" or stiffness not in model.names:
        return False
    at, theta = model.names.index(stiffness), support.fit.theta
    return bool(model.space.at_bound(theta)[at]) and float(model.space.to_cube(theta)[at]) < 0.5
