"""What the catalogue has for something that pulls at one place, once that place is known, and how it pulls."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.trials import spread_at
from torchplate.diagnosis.field.law import Law
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.criterion import Hypothesis, known_section
from torchplate.diagnosis.selection.ranking import Ranking
from torchplate.diagnosis.selection.screen import new_label, start_of
from torchplate.diagnosis.selection.trace import State
from torchplate.model import PlateModel
from torchplate.search import least_squares


class Attached:
    """Refits of what may be attached at a place.

    What splits a peak in two promises little to a step that is linear, and smoothed FRFs that lack it lead elsewhere. A
    force that is free at each line finds its place without knowing its law, and then says what that is.

    Args:
        builder: builds and evaluates the models.
        prior: what is known of the given model's parameters beforehand.
        ranking: has the catalogue, and refits it.
    """

    def __init__(self, builder: ModelBuilder, prior: Prior, ranking: Ranking) -> None:
        self.builder, self.prior, self.ranking = builder, prior, ranking

    def at(self, state: State, theta: Float[Tensor, " n"], place: Float[Tensor, " 2"], law: Law) -> list[Hypothesis]:
        """What sits at a place and pulls there, refitted from the sizes that come nearest to how it does.

        Springs, dashpots and masses alone are asked before a force is: it is none of these.

        Args:
            state: without it.
            theta: its parameters beside the force.
            place: of the force, relative.
            law: how it pulls.
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
            starts = self._following(law, whole, label, torch.stack(members))
            found.append(self.ranking.refits.refit(there, one, label, starts, about=about))
        return found

    def _following(
        self, law: Law, model: PlateModel, label: str, members: Float[Tensor, "n_member n"]
    ) -> Float[Tensor, "n_start n"]:
        """Those that pull most nearly so, of the ends of all members where their place and the plate are held.

        Args:
            law: how something pulls.
            model: with what may be it.
            label: of that.
            members: on the unit cube.
        """
        effect, settings = model.effects[label], self.builder.target.settings
        places = {f"{label}.{key}" for key in ("x", "y")}
        own = [k for k, name in enumerate(model.names) if name.startswith(f"{label}.") and name not in places]

        def off(sizes: Float[Tensor, "*batch n_size"]) -> Float[Tensor, "*batch n_residual"]:
            position = members[0].expand(*sizes.shape[:-1], -1).clone()
            position[..., own] = sizes
            terms = effect.attached(model.mesh, [], model.values(model.space.to_si(position))[label])
            # At one place all of it pulls together.
            stiffness = [term.dynamic_stiffness(law.laplace).sum(-2) for term in terms]
            return law.off(torch.stack(stiffness).sum(0))

        found = least_squares(
            off,
            members[:, own],
            n_iteration=settings.inferring.n_force_step,
            objective_tolerance=settings.inferring.force_falls,
            jacobian_at_end=False,
        )
        nearest = found.objective.argsort()[: settings.selecting.n_best]
        starts = members[nearest].clone()
        starts[:, own] = found.position[nearest]
        return starts
