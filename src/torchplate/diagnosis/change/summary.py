"""From what was compared to what is said: what has changed, by how much, and what else it may have been."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from torchplate.diagnosis.before_and_after import around, gap_of, location_of, overlay_of, step_of, steps_of, verdict_of
from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.comparison import Comparing, Promise, State
from torchplate.diagnosis.change.posterior import Choice
from torchplate.diagnosis.estimates import estimates
from torchplate.diagnosis.naming import remark_on
from torchplate.diagnosis.next_measurement import next_measurements
from torchplate.diagnosis.result import Diagnosis, Estimate, Gap, Named, Scored, Verdict
from torchplate.diagnosis.selection.criterion import is_explained
from torchplate.model import PlateModel
from torchplate.notation import percent

if TYPE_CHECKING:
    from torchplate.diagnosis.change.flow import PlateTest


def summarise(
    comparing: Comparing,
    none: State,
    last: State,
    tests: "tuple[PlateTest, PlateTest]",
    seconds: float,
) -> Diagnosis:
    """Everything that is reported.

    Args:
        comparing: what was compared, and beside what.
        none: nothing changed.
        last: what has changed.
        tests: the reference, and the test after.
        seconds: that it took.
    """
    builder = comparing.after.builder
    target = builder.target
    found = estimates(last.fit, builder.top)
    told = {change.label for change in last.changes}
    labels = [f"+ {change.name}" for change in last.changes]
    steps = [step_of(target, "nothing changed", none.fit)]
    steps += steps_of(target, labels, [before for _, _, before in last.choices], last.fit)
    effects = tuple(
        _named(change, choice, gaps, found)
        for change, (choice, _, _), gaps in zip(last.changes, last.choices, around(steps, len(labels)), strict=True)
    )
    explained = is_explained(last.fit, target)
    verdict = verdict_of(bool(effects), explained)
    numbers = comparing.after.reference.values
    parameters = {
        name: Estimate(value, None, unit_of(last.fit.model, name))
        for name, value in last.fit.model.as_dict(last.fit.theta).items()
        if name in comparing.after.reference.names or name.rpartition(".")[0] in told
    } | found
    sets = [(one.name, *one.equivalent) for one in effects]
    gap = gap_of(last.finer or target, none.fit, last.fit)
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        gap=gap,
        location=location_of(target, none.fit, last.fit),
        scores=tuple(_table(promises, effects) for promises in last.promises),
        steps=tuple(steps),
        missing=missing(verdict, gap, bool(effects)),
        remarks=(
            in_words(effects, tests, {change.label: change for change in last.changes}, numbers),
            *_of_reference(comparing),
        ),
        next_measurements=tuple(next_measurements(sets, verdict in ("unexplained", "partly_explained"), False, False)),
        parameters=parameters,
        model=builder.finished(last.fit.model, last.fit.theta),
        overlay=overlay_of(target, none.fit, last.fit),
        n_evaluation=builder.n_evaluation,
        seconds=seconds,
    )


def in_words(
    effects: Sequence[Named],
    tests: "tuple[PlateTest, PlateTest]",
    changes: Mapping[str, Change],
    before: Mapping[str, float],
    went: Collection[str] = (),
) -> str:
    """What has changed, in one sentence; `went` are labels of what is no more."""
    since = f" since {tests[0].name}" if tests[0].name else " since the reference"
    if not effects:
        return f"No change{since} is more probable than none."
    parts = [_in_words(one, changes[one.label], before, one.label in went) for one in effects]
    return f"What changed{since}: {'; '.join(parts)}."


def _in_words(one: Named, change: Change, before: Mapping[str, float], went: bool) -> str:
    values = ", ".join(f"{name} {_with_interval(value)}" for name, value in one.parameters.items())
    if change.candidate is None:
        (value,) = one.parameters.values()
        unit = "" if value.unit == "-" else f" {value.unit}"
        return f"{one.name} went from {before.get(one.name, change.before or 0.0):.4g}{unit} to {_with_interval(value)}"
    options = "".join(f", {name} {value}" for name, value in one.options.items())
    came = "went away" if went else "came in"
    return f"{one.name} {came}{f' ({values}{options})' if values or options else ''}"


def _with_interval(value: Estimate) -> str:
    unit = "" if value.unit == "-" else f" {value.unit}"
    if value.low is None or value.high is None:
        return f"{value.value:.4g}{unit}"
    return f"{value.value:.4g}{unit} ({value.low:.4g} to {value.high:.4g})"


def _named(change: Change, choice: Choice, gaps: tuple[float, float], found: Mapping[str, Estimate]) -> Named:
    """A change as it is reported."""
    prefix = f"{change.label}." if change.candidate is not None else change.name
    keys = [name for name in found if name.startswith(prefix)]
    parameters = {name.rpartition(".")[2]: found[name] for name in keys}
    values = ", ".join(f"{name} {_with_interval(value)}" for name, value in parameters.items()) or "no number"
    text = (
        f"{change.name} ({values}) takes the gap of the test after from {percent(gaps[0])} to {percent(gaps[1])}"
        f"{beside_others(choice, 'tests')}; by chance the best of all takes {choice.by_chance:.3g} from −2 ln L once "
        f"in a hundred times where nothing changed."
    )
    options = {} if change.candidate is None else change.candidate.options
    return Named(
        change.name, change.label, options, choice.equivalent, round(choice.confidence, 3), parameters, text, *gaps
    )


def beside_others(choice: Choice, data: str) -> str:
    """How far behind the next best is, and what these data cannot tell it from."""
    rival = choice.next_best
    against = (
        ""
        if rival is None or rival.change is None
        else f"; the next best, {rival.change.name}, is {rival.evidence - choice.best.evidence:.3g} worse in −2 ln Z"
    )
    alike = f"; these {data} cannot tell it from {' or '.join(choice.equivalent)}" if choice.equivalent else ""
    return f"{against}{alike}"


def unit_of(model: PlateModel, name: str) -> str:
    """Of a parameter, "label.parameter"."""
    label, _, key = name.rpartition(".")
    return model.effects[label].parameters[key].unit


def _table(promises: Sequence[Promise], effects: Sequence[Named]) -> tuple[Scored, ...]:
    """The score table of one step: of each name what promises most."""
    rows: dict[str, Scored] = {}
    for one in promises:
        change = one.change
        if change.name in rows:
            continue
        remark = remark_on(change.name, effects, "rejected")
        prefix = f"{change.label}."
        start = one.starts[0] if one.starts else {}
        values = {key.removeprefix(prefix): value for key, value in start.items() if key.startswith(prefix)}
        options = {} if change.candidate is None else change.candidate.options
        rows[change.name] = Scored(change.name, options, one.drop, values, (), None, remark)
    return tuple(rows.values())


def missing(verdict: Verdict, gap: Gap, named: bool) -> tuple[str, ...]:
    """What is left without a name."""
    if verdict in ("consistent", "explained"):
        return ()
    what = (
        "beside what is named something else changed" if named else "something changed that nothing tried accounts for"
    )
    return (f"The test after is left with a gap of {percent(gap.final)}: {what}, or it did so in a way of its own.",)


def _of_reference(comparing: Comparing) -> tuple[str, ...]:
    """What the reference leaves, which is no change."""
    reference = comparing.after.reference
    if reference.noise_scale <= 1.2:
        return ()
    return (
        f"The reference test itself is left with {reference.noise_scale:.3g} times its noise: so much is taken for no "
        "change in the test after.",
    )
