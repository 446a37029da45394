"""What a diagnosis says of two fits of one test, before and after: gaps, the place of the misfit, curves, one word."""

from collections.abc import Sequence
from itertools import pairwise

from torch import Tensor

from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.localisation.localise import localise
from torchplate.diagnosis.result import Gap, Location, Overlay, Step, Verdict
from torchplate.diagnosis.target import FrfTarget
from torchplate.measurement import Noise


def verdict_of(named: bool, explained: bool) -> Verdict:
    """The one word.

    Args:
        named: whether anything is.
        explained: whether what is left is within noise and imperfections.
    """
    if not named:
        return "consistent" if explained else "unexplained"
    return "explained" if explained else "partly_explained"


def gap_of(target: FrfTarget, before: Fit, after: Fit) -> Gap:
    """Of the FRFs that fits saw, and of the others."""
    return Gap(
        _number(target.gap(before.prediction)) or 0.0,
        _number(target.gap(after.prediction)) or 0.0,
        heldout_gap(target, before),
        heldout_gap(target, after),
        target.floor,
        target.expected_gap(after.reduced, after.theta, after.marginal),
    )


def step_of(target: FrfTarget, label: str, fit: Fit) -> Step:
    """A step as it is listed."""
    return Step(label, float(target.gap(fit.prediction)), heldout_gap(target, fit), fit.reduced_misfit)


def steps_of(target: FrfTarget, labels: Sequence[str], before: Sequence[Fit], last: Fit) -> list[Step]:
    """A step for each effect that was added.

    Args:
        target: what all were held against.
        labels: of the effects.
        before: what each was added to: with all before it, fitted together.
        last: all of them together.
    """
    after = [*before[1:], last][: len(labels)]
    return [step_of(target, label, fit) for label, fit in zip(labels, after, strict=True)]


def around(steps: Sequence[Step], n_effect: int) -> list[tuple[float, float]]:
    """The gaps before and after each of the effects that were added last."""
    gaps = [step.gap for step in steps[len(steps) - n_effect - 1 :]]
    return list(pairwise(gaps))


def heldout_gap(target: FrfTarget, fit: Fit) -> float | None:
    """The gap of the FRFs that no fit saw; None where there are none."""
    return _number(target.gap(fit.prediction, True))


def location_of(target: FrfTarget, before: Fit, after: Fit) -> Location:
    """Where the misfit sits, and what of it is left."""
    return localise(
        target.measurement,
        target.variance.sqrt(),
        before.prediction,
        before.reduced,
        before.theta,
        target.heldout,
        after=after.prediction,
        share=target.share,
    )


def overlay_of(target: FrfTarget, noise: Noise, before: Fit, after: Fit) -> Overlay:
    """The curves that are drawn over each other, and the noise of the test as it was found."""
    return Overlay(target.measurement, noise.std, before.prediction, after.prediction, target.heldout)


def _number(gap: Tensor) -> float | None:
    return None if bool(gap.isnan()) else float(gap)
