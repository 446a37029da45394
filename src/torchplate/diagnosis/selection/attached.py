"""What the catalogue has for something that pulls at one place, once that place is known."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.trials import spread_at
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.criterion import Hypothesis, known_section
from torchplate.diagnosis.selection.ranking import Ranking
from torchplate.diagnosis.selection.screen import new_label, start_of
from torchplate.diagnosis.selection.starts import nearest
from torchplate.diagnosis.selection.trace import State


class Attached:
    """Refits of what may be attached at a place.

    What splits a peak in two promises little to a step that is linear, and smoothed FRFs that lack it lead elsewhere. A
    force that is free at each line finds its place without knowing its law.

    Args:
        builder: builds and evaluates the models.
        prior: what is known of the given model's parameters beforehand.
        ranking: has the catalogue, and refits it.
    """

    def __init__(self, builder: ModelBuilder, prior: Prior, ranking: Ranking) -> None:
        self.builder, self.prior, self.ranking = builder, prior, ranking

    def at(self, state: State, theta: Float[Tensor, " n"], place: Float[Tensor, " 2"]) -> list[Hypothesis]:
        """What sits at a place and pulls there, of all sizes, refitted from the nearest.

        Springs, dashpots and masses alone are asked before a force is: it is none of these.

        Args:
            state: without it.
            theta: its parameters beside the force.
            place: of the force, relative.
        """
        there = replace(state, fit=state.fit._replace(theta=theta))
        about = known_section(state.fit)
        _, everyone = self.ranking.catalogue_beside(there)
        pulling = [one for one in everyone if one.has_place and not one.is_patch]
        asked = {name for one in pulling for name in one.effect.contains}
        x, y = place.tolist()
        count, found = self.builder.target.settings.searching.n_spread, list[Hypothesis]()
        for one in pulling:
            if one.name in asked:
                continue
            label = new_label(state.model, one.name)
            whole = with_candidate(state.model, label, one)
            members = [start_of(whole, theta, state.model, own, label) for own in spread_at(one, x, y, count)]
            starts = nearest(self.builder, self.prior, whole, torch.stack(members), about)
            found.append(self.ranking.refits.refit(there, one, label, starts, about=about))
        return found
