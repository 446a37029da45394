"""The refit of one candidate beside a model."""

import math
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.fit import NOBODY, Beat, Begun, fit
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.criterion import Hypothesis, known_section
from torchplate.diagnosis.selection.screen import new_label, start_of
from torchplate.diagnosis.selection.trace import State
from torchplate.discrepancy import Found


class Refits:
    """Refits candidates, and says how each ended.

    Args:
        builder: builds and evaluates the models.
        prior: what is known of the given model's parameters beforehand.
        say: is told how each ended.
        n_option: choices of fixed options that an effect has, by its cause; 1 where it is left out.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        prior: Prior,
        say: Callable[[str], None],
        n_option: Mapping[str, int] | None = None,
    ) -> None:
        self.builder, self.prior, self.say, self.n_option = builder, prior, say, dict(n_option or {})

    def refit(
        self,
        state: State,
        candidate: Candidate,
        label: str,
        starts: Tensor,
        hopeless: float = math.inf,
        about: Found | None = None,
        begun: Begun | None = None,
        beat: Beat = NOBODY,
    ) -> Hypothesis:
        """A candidate in a state's model, fitted from some starts.

        Args:
            state: without it.
            candidate: the effect with its options.
            label: that it gets.
            starts: on the unit cube of the model with it.
            hopeless: sum of squares beyond which the fit is not followed to its end.
            about: the specimen as far as it is known; left out, as the state knows it.
            begun: where these starts led beside the frequency axis.
            beat: what it has to come near for being followed to its end.
        """
        whole = with_candidate(state.model, label, candidate)
        about = about or known_section(state.fit)
        # From where nothing is known of the specimen, the first parts of a way say little of its end.
        beat = NOBODY if about is None and not beat.sure else beat
        found = fit(self.builder, whole, starts, self.prior, False, hopeless, about, begun, beat)
        self.say(f"  {candidate.name}: misfit {found.reduced_misfit:.4g}, −2 ln L {found.cost:.1f}")
        return Hypothesis(candidate, label, found, n_option=self.n_option.get(candidate.cause, 1))

    def from_trials(
        self, state: State, candidate: Candidate, theta: Tensor, hopeless: float = math.inf, beat: Beat = NOBODY
    ) -> Hypothesis:
        """A candidate in a state's model with these parameters, fitted from its trials."""
        model = state.model
        label = new_label(model, candidate.name)
        whole = with_candidate(model, label, candidate)
        starts = [start_of(whole, theta, model, trial.values, label) for trial in candidate.far]
        return self.refit(state, candidate, label, torch.stack(starts), hopeless, beat=beat)
