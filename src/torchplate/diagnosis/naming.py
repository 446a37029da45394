"""An effect that is named, with its parameters, its confidence and its evidence in words."""

from collections.abc import Mapping, Sequence

from torchplate.diagnosis.before_and_after import gap_left, left_beside_the_specimen
from torchplate.diagnosis.estimates import estimates
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.remarks import sizes
from torchplate.diagnosis.result import Estimate, Named
from torchplate.diagnosis.selection.criterion import Hypothesis, is_explained, relieved
from torchplate.diagnosis.selection.trace import Naming, State
from torchplate.notation import percent


def as_named(builder: ModelBuilder, naming: Naming, last: State, gaps: tuple[float, float]) -> Named:
    """An effect as it is reported.

    Args:
        builder: what evaluated the models.
        naming: of the effect.
        last: the last model.
        gaps: of the step before it was added, and of the one after.
    """
    final = last.fit
    hypothesis = naming.hypothesis
    before, after = gaps
    first = gap_left(builder.target, hypothesis.fit)
    found = estimates(final, builder.top)
    prefix = f"{hypothesis.label}."
    parameters = {name.removeprefix(prefix): one for name, one in found.items() if name.startswith(prefix)}
    equivalent = naming.known.equivalent
    rival = naming.known.next_best
    against = ""
    if rival is not None:
        rest = gap_left(builder.target, rival.fit)
        against = f"; the next best{' in its place' if naming.again else ''}, {rival.name}, leaves {percent(rest)}"
        against += " beside the other effects" if naming.again else " at its first refit"
    # What the others are held against is what it left when they were refitted too.
    refitted = "" if percent(first) == percent(after) or naming.again else f" ({percent(first)} at its first refit)"
    alike = f"; these data cannot tell it from {' or '.join(equivalent)}" if equivalent else ""
    beside = _beside_the_specimen(builder, naming, last)
    moved = f"from {percent(before)} to {percent(after)}{refitted}"
    if beside is None:
        takes = f"takes the gap {moved}"
    elif after < before:
        takes = f"takes the gap {moved}, and {beside} beside the plate as it was found to wander"
    else:
        takes = f"takes the gap beside the plate as it was found to wander {beside}; that of a uniform one goes {moved}"
    takes += _instead_of_nuisances(naming, last)
    text = f"{hypothesis.name} ({_values(parameters, hypothesis)}) {takes}{against}{alike}{_chance(naming)}."
    return Named(
        name=hypothesis.name,
        label=hypothesis.label,
        options=hypothesis.candidate.options,
        equivalent=equivalent,
        confidence=round(naming.confidence(final, is_explained(final, builder.target)), 3),
        parameters=parameters,
        evidence=text,
        gap_before=before,
        gap_after=after,
    )


def remark_on(name: str, effects: Sequence[Named], otherwise: str) -> str:
    """What the score table says of an effect: that it is named, or equivalent to one that is, or something else."""
    if any(name == one.name for one in effects):
        return "named"
    return "equivalent" if any(name in one.equivalent for one in effects) else otherwise


def _beside_the_specimen(builder: ModelBuilder, naming: Naming, last: State) -> str | None:
    """What it takes beside the plate as it was found to wander, by which it is judged; None where that is uniform."""
    begun, left = (left_beside_the_specimen(builder.target, one) for one in (naming.before, _end(naming, last)))
    if left is None:
        return None
    before = gap_left(builder.target, naming.before) if begun is None else begun
    return f"from {percent(before)} to {percent(left)}"


def _end(naming: Naming, last: State) -> Fit:
    """The fit with it, before what was named next."""
    after = [*(one.before for one in last.named[1:]), last.fit]
    return next(fit for one, fit in zip(last.named, after, strict=True) if one is naming)


def _instead_of_nuisances(naming: Naming, last: State) -> str:
    """Which nuisances need not be larger than tests have them with it: the gap does not show what they had taken on."""
    gone = sizes(naming.before, relieved(naming.before, _end(naming, last)))
    return f"; without it there would have to be {' and '.join(gone)}" if gone else ""


def _chance(naming: Naming) -> str:
    """What it takes beside what chance takes, where that was asked."""
    if naming.by_chance <= 0:
        return ""
    fall = naming.before.cost - naming.hypothesis.fit.cost
    return (
        f"; it takes {fall:.3g} from −2 ln L, and chance lets it take {naming.by_chance:.3g}: of a hundred tests in "
        "which nothing is missing, one has an effect that takes more"
    )


def _values(parameters: Mapping[str, Estimate], hypothesis: Hypothesis) -> str:
    parts = [f"{name} {one.value:.4g}{'' if one.unit == '-' else ' ' + one.unit}" for name, one in parameters.items()]
    parts += [f"{name} {value}" for name, value in hypothesis.candidate.options.items()]
    return ", ".join(parts) or "no number"
