"""Whether what was added is worth going on beside it, and worth its name where more than noise is left of it."""

from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.selection.criterion import Hypothesis, is_noise, remaining
from torchplate.diagnosis.selection.trace import State
from torchplate.diagnosis.settings import Selecting


def tried_enough(state: State, n_evaluation: int, settings: Selecting) -> bool:
    """Whether two effects leave far more than noise and so much was evaluated that a third is not looked for."""
    far = state.fit.by_noise and state.fit.reduced_misfit > settings.doubtful
    return far and n_evaluation > settings.enough


def explains_some(before: Fit, hypothesis: Hypothesis, settings: Selecting, by_cost: bool = False) -> bool:
    """Whether an effect explains so much that looking for another beside it is worth the time.

    Args:
        before: the fit without it.
        hypothesis: with it.
        settings: of the selection.
        by_cost: a smaller gap alone is not enough, if the model is believed.
    """
    after = hypothesis.fit
    if after.by_noise and before.reduced_misfit <= settings.doubtful:
        # Nuisances larger than tests have them leave no more than noise does: squares say nothing of what is left.
        return True
    gaps = [one.left for one in (before, after)]
    part = settings.explains_much if hypothesis.candidate.searched else settings.explains_some
    smaller = gaps[1] <= settings.explains_some * gaps[0] and not (by_cost and after.by_noise)
    return smaller or (after.by_noise and after.square <= part * before.square)


def explains_much(state: State, builder: ModelBuilder) -> bool:
    """Whether the last effect explains much, or all that was left; else it may stand in for something else.

    It has to show in the gap, or in what nuisances had to take on without it. Beside an inflated model error, where
    squares say little, it has to halve what is left: the gap itself, or the gap where peaks overlap, since a sharp peak
    that is a width off counts as if it were not there. What is left counts per degree of freedom: p numbers that are
    fitted to what n numbers say of modes take p / n of the squares by chance.

    It does so beside each of the states before it: beside one that was only a way to it, and leaves more than there was
    at first, much is explained by any end.

    Args:
        state: with it.
        builder: what evaluates it.
    """
    if is_noise(state.fit):
        return True
    n_own, after = 0, state
    while (before := after.previous) is not None:
        n_own += len(after.named[-1].hypothesis.candidate.searched) if after.named else 0
        if not _much(before.fit, state.fit, n_own, builder):
            return False
        after = before
    return True


def _much(before: Fit, fit: Fit, n_own: int, builder: ModelBuilder) -> bool:
    """Whether a fit with so many numbers more explains much of what one left."""
    settings = builder.target.settings.selecting
    if fit.by_noise:
        return fit.square <= settings.explains_much * before.square and remaining(before, fit) <= settings.shows
    free = max(0.0, 1 - n_own / fit.n_modal)
    most = free * settings.halved**2
    if fit.left**2 <= most * before.left**2:
        return True
    overlapping, square = (where_peaks_overlap(builder, one) for one in (fit, before))
    return overlapping <= most * square


def where_peaks_overlap(builder: ModelBuilder, fit: Fit) -> float:
    """Sum of squares at the widest level."""
    prediction = builder.predict(fit.reduced, fit.theta, 0)
    return float(builder.target.residual(prediction, 0).square().sum())


def worth_their_names(state: State, builder: ModelBuilder) -> State:
    """Without the last effects, where something else is missing still and they only stand in for a little of it."""
    while state.previous is not None and not explains_much(state, builder):
        state = state.previous
    return state
