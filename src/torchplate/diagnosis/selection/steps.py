"""A step of the selection: the catalogue beside a model, the best of it, the model with that, and whether it does."""

from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.selection.criterion import Choice, choose, is_explained, is_needed, is_noise
from torchplate.diagnosis.selection.ranking import Ranking
from torchplate.diagnosis.selection.settling import Settling
from torchplate.diagnosis.selection.trace import Naming, Ranked, State


class Steps:
    """Takes them.

    Args:
        builder: makes and evaluates models, beside the evidence.
        ranking: of the catalogue beside a model.
        settling: of a last model on a finer mesh.
    """

    def __init__(self, builder: ModelBuilder, ranking: Ranking, settling: Settling) -> None:
        self.builder, self.ranking, self.settling = builder, ranking, settling

    def needed(self, state: State, rankings: list[Ranked]) -> tuple[Choice, Ranked] | None:
        """The best of the catalogue beside a state, if it is more probable than none; the ranking joins the others."""
        ranked = self.ranking.at(state)
        rankings.append(ranked)
        return judged(state, ranked)

    def explained(self, state: State, doubted: bool = False) -> State | None:
        """The state, settled, if nothing but noise is left of it; None where more is.

        Args:
            state: a model with what was named.
            doubted: whether what was named last is, whatever it closed: a finer mesh left nothing but noise without it.
        """
        if not is_noise(state.fit) and not self.settling.is_little(state):
            return None
        ended = self.settling.ended(state, doubted)
        return ended if ended is state or is_explained(ended.fit, self.builder.target) else None


def judged(state: State, ranked: Ranked) -> tuple[Choice, Ranked] | None:
    """The best of a ranking, if it is more probable than none beside a state."""
    if not ranked.hypotheses:
        return None
    choice = choose(ranked.hypotheses, state.fit)
    return (choice, ranked) if is_needed(state.fit, choice.best, ranked.chance(choice.best.name)) else None


def added(state: State, choice: Choice, ranked: Ranked) -> State:
    """The model of a state with what was chosen of a ranking."""
    hypothesis = choice.best
    model = with_candidate(state.model, hypothesis.label, hypothesis.candidate)
    naming = Naming(hypothesis, choice, state.fit, ranked.hypotheses, by_chance=ranked.chance(hypothesis.name))
    return State(model, hypothesis.fit, (*state.named, naming), state, ranked)
