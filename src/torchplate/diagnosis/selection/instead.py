"""What else may be there instead of the best: at its place, all over the plate, or the best at an image of that."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate, place_of
from torchplate.diagnosis.candidates.images import images
from torchplate.diagnosis.candidates.trials import spread_at
from torchplate.diagnosis.fit import Beat
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.criterion import Hypothesis, is_noise, known_section
from torchplate.diagnosis.selection.refit import Refits
from torchplate.diagnosis.selection.screen import new_label, screen, start_of
from torchplate.diagnosis.selection.starts import nearest
from torchplate.diagnosis.selection.trace import State


class Instead:
    """Refits of what may be taken for the best.

    Args:
        builder: builds and evaluates the models.
        prior: what is known of the given model's parameters beforehand.
        refits: of candidates.
    """

    def __init__(self, builder: ModelBuilder, prior: Prior, refits: Refits) -> None:
        self.builder, self.prior, self.refits = builder, prior, refits
        self.settings = builder.target.settings

    def of(self, state: State, best: Hypothesis, everyone: Sequence[Candidate], beat: Beat) -> list[Hypothesis]:
        """Others, refitted from where the best ended with the rest of the model as it is beside that.

        Args:
            state: without it.
            best: of the hypotheses; asked where it explains much of what is left, or leaves noise.
            everyone: the candidates.
            beat: what a fit has to come near for being followed to its end.
        """
        much = best.fit.square <= self.settings.selecting.explains_much * state.fit.square
        if not best.fit.by_noise or not (much or is_noise(best.fit)):
            return []
        theta = best.beside(state.model)
        place = place_of(best.own)
        ways = self._all_over(state, best, everyone, theta) if place is None else self._at(state, best, everyone, place)
        return self._refitted(state, best, ways, beat)

    def simpler(self, state: State, best: Hypothesis, everyone: Sequence[Candidate], beat: Beat) -> list[Hypothesis]:
        """What the best becomes at an end of its numbers, refitted at its place.

        Args:
            state: without it.
            best: of the hypotheses.
            everyone: the candidates that are asked, of which only those count that it contains.
            beat: what a fit has to come near for being followed to its end.
        """
        place, contained = place_of(best.own), best.candidate.effect.contains
        if place is None or not best.fit.by_noise:
            return []
        some = [one for one in everyone if one.name in contained]
        return self._refitted(state, best, self._at(state, best, some, place), beat)

    def _refitted(
        self,
        state: State,
        best: Hypothesis,
        ways: Sequence[tuple[Candidate, str, list[dict[str, float]]]],
        beat: Beat,
    ) -> list[Hypothesis]:
        theta, found, about = best.beside(state.model), [best], best.fit.about
        for one, label, members in ways:
            whole = with_candidate(state.model, label, one)
            starts = torch.stack([start_of(whole, theta, state.model, own, label) for own in members])
            # What takes the place of one all over the plate moves the others, as a thickness a modulus, by many widths.
            starts = nearest(self.builder, self.prior, whole, starts, about, down=place_of(best.own) is None)
            limit = self.settings.searching.hopeless * min(other.fit.square for other in found)
            found.append(self.refits.refit(state, one, label, starts, limit, about, beat=beat))
        return found[1:]

    def at_images(self, state: State, best: Hypothesis) -> list[Hypothesis]:
        """The best once more, from the mirror images of its place, and on a square from those turned by a right angle.

        Args:
            state: without it.
            best: of the hypotheses.
        """
        whole = with_candidate(state.model, best.label, best.candidate)
        place = start_of(whole, best.beside(state.model), state.model, best.own, best.label)
        starts = images(whole, place, best.label)
        if not len(starts):
            return []
        limit, beat = self.settings.searching.hopeless * best.fit.square, Beat(best.fit.way, best.fit.cost)
        about = known_section(best.fit)
        return [self.refits.refit(state, best.candidate, best.label, starts, limit, about, beat=beat)]

    def _at(
        self, state: State, best: Hypothesis, everyone: Sequence[Candidate], place: tuple[float, float]
    ) -> list[tuple[Candidate, str, list[dict[str, float]]]]:
        """At its place, of all sizes.

        A soft patch moves the peaks nearly as a mass at its middle does, which is found from farther away. Where the
        best leaves noise, only what is simpler is asked: an absorber that stays with the plate is a mass.
        """
        enough = is_noise(best.fit)
        found = []
        for one in everyone:
            if not one.is_placed or one.name == best.name:
                continue
            if not enough or one.name in best.candidate.effect.contains:
                some = [dict(own) for own in spread_at(one, *place, self.settings.searching.n_spread)]
                found.append((one, new_label(state.model, one.name), some))
        return found

    def _all_over(
        self, state: State, best: Hypothesis, everyone: Sequence[Candidate], theta: Tensor
    ) -> list[tuple[Candidate, str, list[dict[str, float]]]]:
        """All over the plate, where that promises there about what the best itself does.

        Beside a model that lacks it, and a specimen that has taken on some of it, its twin may promise nothing. What
        has no number to be fitted, as channels that were exchanged, has no twin.
        """
        if not best.candidate.searched:
            return []
        without = self.builder.reduced(state.fit.model, theta[None])
        without = self.builder.target.specimen(without, theta, best.fit.about)
        alike = [one for one in everyone if not one.is_placed and one.searched]
        scored = screen(self.builder, without, theta, alike, self.prior)
        own = max((one.drop for one in scored if one.candidate.name == best.name), default=0.0)
        found = []
        for one in scored:
            if one.candidate.name != best.name and one.drop >= self.settings.selecting.explains_much * own:
                starts = [one.model.as_dict(one.model.space.to_si(start)) for start in one.starts]
                some = [{key: values[f"{one.label}.{key}"] for key in one.candidate.searched} for values in starts]
                found.append((one.candidate, new_label(state.model, one.candidate.name), some))
        return found
