"""What a diagnosis says of two fits of one test, before and after: gaps, the place of the misfit, curves, one word."""

from collections.abc import Sequence
from itertools import pairwise

from jaxtyping import Complex
from torch import Tensor

from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.localisation.channels import channel_gaps
from torchplate.diagnosis.localisation.localise import localise
from torchplate.diagnosis.result import Gap, Location, Overlay, Step, Verdict
from torchplate.diagnosis.target import FrfTarget


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
    (baseline, heldout_baseline), (final, heldout_final) = _gaps(target, before), _gaps(target, after)
    return Gap(
        baseline,
        final,
        heldout_baseline,
        heldout_final,
        target.floor,
        target.expected_gap(after.reduced, after.theta, after.marginal),
    )


def step_of(target: FrfTarget, label: str, fit: Fit) -> Step:
    """A step as it is listed."""
    return Step(label, *_gaps(target, fit), fit.reduced_misfit)


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


def gap_left(target: FrfTarget, fit: Fit) -> float:
    """The gap of the FRFs that fits saw, at all lines that were measured."""
    return _gaps(target, fit)[0]


def left_beside_the_specimen(target: FrfTarget, fit: Fit) -> float | None:
    """The gap of the same FRFs from those of the plate as it was found to wander; None where it is uniform."""
    if fit.about is None:
        return None
    whole = target.at_all_lines
    expected = fit.expected if whole is target else whole.predict(fit.reduced, fit.theta)
    return _number(whole.gap(expected))


def at_all_lines(target: FrfTarget, fit: Fit) -> Complex[Tensor, "n_frequency n_response n_reference"]:
    """What a fit says of every line that was measured, whichever were looked at."""
    whole = target.at_all_lines
    # One that was held against fewer lines, on another mesh, is asked for all of them.
    known = whole is target and len(fit.prediction) == len(whole.frequency)
    return fit.prediction if known else whole.predict(fit.predicted, fit.theta)


def _gaps(target: FrfTarget, fit: Fit) -> tuple[float, float | None]:
    """Of the FRFs that fits saw, and of the others; None where there are none."""
    whole, prediction = target.at_all_lines, at_all_lines(target, fit)
    return _number(whole.gap(prediction)) or 0.0, _number(whole.gap(prediction, True))


def location_of(target: FrfTarget, before: Fit, after: Fit) -> Location:
    """Where the misfit sits, and what of it is left."""
    whole = target.at_all_lines
    predicted = (at_all_lines(target, before), at_all_lines(target, after))
    return localise(
        target.measurement,
        target.variance.sqrt(),
        before.prediction,
        before.reduced,
        before.theta,
        channel_gaps(whole.measurement, whole.noise.std, *predicted, whole.heldout),
    )


def overlay_of(target: FrfTarget, before: Fit, after: Fit) -> Overlay:
    """The curves that are drawn over each other, and the noise of the test as it was found."""
    whole = target.at_all_lines
    return Overlay(
        whole.measurement, whole.noise.std, at_all_lines(target, before), at_all_lines(target, after), whole.heldout
    )


def _number(gap: Tensor) -> float | None:
    return None if bool(gap.isnan()) else float(gap)
