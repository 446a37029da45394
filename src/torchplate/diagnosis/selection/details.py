"""The best effects with their details, and without what does nothing of them."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.selection.criterion import Hypothesis, is_noise, known_section, never_equivalent
from torchplate.diagnosis.selection.refit import Refits
from torchplate.diagnosis.selection.screen import start_of
from torchplate.diagnosis.selection.trace import State
from torchplate.model import PlateModel


class Details:
    """Refits of the best effects with more numbers, and with fewer.

    Args:
        builder: builds and evaluates the models.
        refits: refits them.
    """

    def __init__(self, builder: ModelBuilder, refits: Refits) -> None:
        self.builder, self.refits = builder, refits

    def fitted(self, state: State, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best, and what may be its equivalent, with details fitted: from neutral and half way to their ends."""
        best = min(hypotheses, key=lambda one: one.cost, default=None)
        if best is None or not best.fit.by_noise:
            return []
        found = []
        for one in hypotheses:
            if not one.candidate.detail or one.cost - best.cost > never_equivalent(best.fit):
                continue
            detailed = one.candidate.in_detail()
            whole = with_candidate(state.model, one.label, detailed)
            own = {**detailed.neutral, **one.own}
            starts = [start_of(whole, one.beside(state.model), state.model, own, one.label)]
            for key in one.candidate.detail:
                column = whole.names.index(f"{one.label}.{key}")
                for end in (0.0, 1.0):
                    starts.append(starts[0].clone())
                    starts[-1][column] = 0.5 * (starts[0][column] + end)
            about = known_section(one.fit)
            ended = self.refits.refit(state, detailed, one.label, torch.stack(starts), about=about)
            if not is_noise(ended.fit):
                # Where edges come to lie on lines of the mesh are ends that are none: from an element beside, too.
                beside = self._an_element_beside(whole, ended)
                again = self.refits.refit(state, detailed, one.label, beside, about=known_section(ended.fit))
                ended = min(ended, again, key=lambda each: each.cost)
            found.append(ended)
        return found

    def _an_element_beside(self, whole: PlateModel, ended: Hypothesis) -> Float[Tensor, "n_start n"]:
        """Starts on the unit cube whose place is half an element's side further along each side, either way."""
        here, (n_x, n_y) = whole.space.to_cube(ended.fit.theta), self.builder.mesh.cells
        starts = []
        for axis, n in (("x", n_x), ("y", n_y)):
            for way in (-0.5, 0.5):
                starts.append(here.clone())
                starts[-1][whole.names.index(f"{ended.label}.{axis}")] += way / n
        return torch.stack(starts).clamp(0.0, 1.0)

    def left_out(self, state: State, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best, and what may be its equivalent, without those of its numbers that ended where they do nothing.

        A number that does nothing is not on the edge of its interval: there, the effect is one with fewer numbers.
        """
        best = min(hypotheses, key=lambda one: one.cost, default=None)
        if best is None or not best.fit.by_noise:
            return []
        found = []
        for one in hypotheses:
            idle = idle_of(one)
            if (
                not idle
                or len(idle) == len(one.candidate.searched)
                or one.cost - best.cost > never_equivalent(best.fit)
            ):
                continue
            simpler = one.candidate.without(idle)
            whole = with_candidate(state.model, one.label, simpler)
            own = {key: one.own[key] for key in simpler.searched}
            start = start_of(whole, one.beside(state.model), state.model, own, one.label)
            about = known_section(one.fit)
            found.append(self.refits.refit(state, simpler, one.label, start[None], about=about))
        return found


def idle_of(one: Hypothesis) -> set[str]:
    """Its numbers that ended on the edge of their interval that is next to where they do nothing."""
    names, searched = one.fit.model.names, one.candidate.searched
    edge = dict(zip(names, one.fit.model.space.at_bound(one.fit.theta).tolist(), strict=True))
    found = set()
    for key, interval in searched.items():
        neutral = one.candidate.neutral.get(key)
        if neutral is None or one.candidate.replaces or not edge[f"{one.label}.{key}"]:
            continue
        low = one.own[key] - interval.low < interval.high - one.own[key]
        if neutral <= interval.low if low else neutral >= interval.high:
            found.add(key)
    return found
