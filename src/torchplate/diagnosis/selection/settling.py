"""The end of a selection: the last model on a finer mesh, and beside the error of the given one."""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Complex
from torch import Tensor

from torchplate.diagnosis.fit import Beat, fit
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.criterion import is_explained, is_noise, known_section
from torchplate.diagnosis.selection.exchange import Exchange
from torchplate.diagnosis.selection.ranking import Ranking
from torchplate.diagnosis.selection.trace import Naming, Ranked, State
from torchplate.model import Extrapolated, PlateModel


class Settling:
    """Fits what a selection ended with where meshes differ from the one that effects are looked for on.

    Args:
        builder: makes and evaluates models, beside the evidence.
        prior: what is known of the given model's parameters beforehand.
        ranking: scores the catalogue.
        exchange: judges names again.
        say: is told what is being tried.
    """

    def __init__(
        self, builder: ModelBuilder, prior: Prior, ranking: Ranking, exchange: Exchange, say: Callable[[str], None]
    ) -> None:
        self.builder, self.prior, self.ranking, self.exchange, self.say = builder, prior, ranking, exchange, say
        self.settings = builder.target.settings.selecting

    def ended(self, state: State, doubted: bool = False) -> State:
        """The state, settled; as it is, where that leaves noise alone and settling more, but for a doubted name.

        Args:
            state: with everything that was named.
            doubted: whether what was named last is: where a finer mesh takes it out, it is out.
        """
        settled = self.settled(state, doubted)
        others = {one.hypothesis.label for one in state.named[:-1]}
        out = doubted and {one.hypothesis.label for one in settled.named} <= others
        if out or is_explained(settled.fit, self.builder.target) or not is_noise(state.fit):
            return settled
        return state

    def last(self, state: State, begun: State) -> State:
        """The state, settled, without names that account for nothing of what it leaves.

        Args:
            state: with everything that was named.
            begun: with nothing: what is left where no name stays.
        """
        ended = self.ended(state)
        if not ended.named:
            return ended
        builder = self.on_a_finer_mesh(ended) if self.is_little(ended) else self.builder
        kept = self.exchange.without_improbable(ended, builder)
        return kept if kept.named else self.ended(begun)

    def is_little(self, state: State) -> bool:
        """Whether so little is left that the mesh may be what that is; beside a hole it may be more."""
        little = state.fit.reduced_misfit <= self.settings.doubtful
        return state.fit.by_noise and (little or state.model.has_hole(state.fit.theta))

    def settled(self, state: State, doubted: bool = False) -> State:
        """The last model once more, with the mesh error taken off where it now is.

        Where it leaves little, on a finer mesh; there an effect that closed but a small gap, or is doubted, or ends
        where it changes nothing, has to show again: it may have been the mesh, or a way out for a fit that had stopped.
        How small a gap is says the least that the others have left without it.
        """
        builder, target = self.builder, self.builder.target
        if not state.named and is_noise(state.fit):
            return state
        state = self.exchange.judged_again(state)
        little = self.is_little(state)
        if not little and not state.named:
            return state
        if little:
            self.say("settling on a finer mesh")
            builder = self.on_a_finer_mesh(state)
        start = state.model.space.to_cube(state.fit.theta)[None]
        # It is the same model: whatever its specimen has taken on, it will again.
        fine = fit(builder, state.model, start, self.prior, wide=False, about=state.fit.about)
        settled = replace(state, fit=fine)
        if little:
            settled = self.exchange.beside_those_in_doubt(settled, state.fit, builder)
            small = self.settings.small_gap * target.floor
            last, without = settled.named[-1] if doubted else None, self.exchange.left_without
            again = tuple(
                one
                for one in settled.named
                if min(one.before.left, without.get(one.hypothesis.label, one.before.left)) < small
                or one is last
                or self._is_nothing(one, settled.fit)
            )
            settled = self.exchange.without_needless(settled, builder, again)
        return settled

    def _is_nothing(self, naming: Naming, fit: Fit) -> bool:
        """Whether all numbers of an effect may be those that leave the model as it is."""
        hypothesis, off = naming.hypothesis, []
        if hypothesis.candidate.replaces:
            return False
        for key, neutral in hypothesis.candidate.neutral.items():
            if (name := f"{hypothesis.label}.{key}") in fit.model.names:
                index = fit.model.names.index(name)
                variance = float(fit.covariance[index, index].clamp(min=1e-300))
                off.append(abs(float(fit.theta[index]) - neutral) / variance**0.5)
        # What the data do not see has no standard error.
        return bool(off) and not any(one > self.settings.nothing for one in off)

    def beside_a_finer_mesh(self, state: State) -> Ranked | None:
        """The catalogue beside a state that leaves noise, scored on a finer mesh; None where something hides there."""
        self.say("  the mesh may be what that is: the model as it is on a finer one")
        builder = self.on_a_finer_mesh(state)
        start, about = state.model.space.to_cube(state.fit.theta)[None], known_section(state.fit)
        fine = replace(state, fit=fit(builder, state.model, start, self.prior, wide=False, about=about))
        return self.nothing_hides(state, fine) if is_noise(fine.fit) else None

    def nothing_hides(self, coarse: State, fine: State) -> Ranked | None:
        """The catalogue scored on the mesh that a state was settled on; None where it promises more than chance.

        Args:
            coarse: the state on the mesh where effects are looked for.
            fine: where the last models are settled.
        """
        # Of the finer mesh its elements alone are asked for here.
        finer = self.builder.as_fine_as(self.builder.target.settings.meshes.settling)
        scored = self.ranking.scored(fine, self.left_by_mesh(coarse, fine, finer))
        return None if any(scored.exceeds(one) > 1 for one in scored.promises) else scored

    def left_by_mesh(
        self, coarse: State, fine: State, finer: ModelBuilder
    ) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """Change of the FRFs that the finer mesh may have left, from what two differ by where both are fitted.

        What is left is of the second order in a side: on meshes of n and N elements, e_N = (e_n − e_N) n / (N − n). At
        the corners of a hole moments are singular, across a rib they jump, and it is of the first at worst:
        e_N = (e_n − e_N) / (√(N/n) − 1).
        """
        return (coarse.fit.expected - fine.fit.expected) * self._left(finer, fine.model, fine.fit.theta)

    def _left(self, finer: ModelBuilder, model: PlateModel, theta: Tensor) -> float:
        """What the finer mesh leaves, in differences of the two."""
        times = finer.mesh.n_element / self.builder.mesh.n_element
        if model.has_hole(theta) or _jumps(model):
            times = times**0.5
        return 1 / (times - 1) if times > 1 else 0.0

    def on_a_finer_mesh(self, state: State) -> ModelBuilder:
        """What builds the last models, with the mesh error taken off where a state is."""
        builder = self.builder.as_fine_as(self.builder.target.settings.meshes.settling)
        found = builder.corrected(state.model, state.fit.theta)
        return builder.expecting(found, self._beside(builder, state) if _jumps(state.model) else None)

    def _beside(self, finer: ModelBuilder, state: State) -> Extrapolated:
        """What the finer mesh leaves of the natural frequencies beside that across which moments jump.

        A mesh error is taken off without what sits at places, and of what is left much hangs on where in an element
        that lies: on another mesh it may be more or less, and so it is no shape to be subtracted but a scatter.
        """
        theta = state.fit.theta
        both = [one.natural_frequencies(state.model, theta) for one in (self.builder, finer)]
        n = min(len(one) for one in both)
        coarse, fine = (one[:n] for one in both)
        # Of modes on the supports alone, as `extrapolate` parts them, nothing is left but rounding.
        bending = fine.square() > 1e-3 * fine[-1].square()
        off = torch.where(bending, (coarse - fine) / fine.clamp(min=torch.finfo(fine.dtype).tiny), 0.0)
        return Extrapolated(state.model, fine, off * self._left(finer, state.model, theta))

    def as_given_from(self, builder: ModelBuilder, model: PlateModel, before: Fit, wide: bool) -> Fit:
        """A model on the given mesh; what has no end near that of the same on a finer mesh is not followed to it."""
        start, settings = before.model.space.to_cube(before.theta)[None], builder.target.settings
        near = settings.selecting.close + settings.selecting.close_part * before.square
        limit, beat = settings.searching.hopeless * before.square, Beat(before.way + near, before.cost + near)
        return fit(builder, model, start, self.prior, wide, limit, known_section(before), beat=beat)


def _jumps(model: PlateModel) -> bool:
    """Whether moments of the plate jump across one of its effects."""
    return any(effect.jumps for effect in model.effects.values())
