"""What is said of two tables: what has changed, by how much, and what else it may have been."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from torch import Tensor

from torchplate.diagnosis.before_and_after import verdict_of
from torchplate.diagnosis.change.posterior import Choice
from torchplate.diagnosis.change.summary import beside_others, in_words, missing, unit_of
from torchplate.diagnosis.estimates import QUANTILE
from torchplate.diagnosis.next_measurement import next_measurements
from torchplate.diagnosis.result import Diagnosis, Estimate, Gap, Location, Named, Scored, Step
from torchplate.diagnosis.table.settings import SETTINGS as TABLE
from torchplate.notation import percent

if TYPE_CHECKING:
    from torchplate.diagnosis.change.flow import PlateTest
    from torchplate.diagnosis.change.table_fit import TableFit, Tables


def summarise_tables(
    tables: "Tables",
    first: "TableFit",
    last: "TableFit",
    named: "Sequence[tuple[TableFit, Choice]]",
    tried: "Sequence[Sequence[TableFit]]",
    tests: "tuple[PlateTest, PlateTest]",
    seconds: float,
) -> Diagnosis:
    """Everything that is reported.

    Args:
        tables: what was compared, beside what was named.
        first: nothing changed.
        last: what was named, and nothing more.
        named: the changes, and how each was chosen.
        tried: all that was fitted, step by step.
        tests: the reference, and the test after.
        seconds: that it took.
    """
    n = len(tables.mode)
    import scipy.stats  # here: a third of what importing this package takes

    explained = last.chi_square <= n * float(scipy.stats.f.ppf(TABLE.level, n, tables.freedom))
    verdict = verdict_of(bool(named), explained)
    gaps = [tables.gap(first.predicted), *(tables.gap(fit.predicted) for fit, _ in named)]
    gap = Gap(gaps[0], gaps[-1], None, None, tables.floor)
    effects = tuple(_named(fit, choice, (gaps[k], gaps[k + 1])) for k, (fit, choice) in enumerate(named))
    changes = {one.label: fit.change for one, (fit, _) in zip(effects, named, strict=True) if fit.change is not None}
    whole = {
        name: Estimate(value, None, unit_of(tables.model, name))
        for name, value in tables.before.items()
        if name in tables.model.names
    }
    for one, (fit, _) in zip(effects, named, strict=True):
        # What went away was never in the model.
        if not fit.gone:
            whole |= {f"{one.label}.{key}": value for key, value in one.parameters.items()}
    steps = [Step("nothing changed", gaps[0], None, first.chi_square / n)]
    for k, (one, (fit, _)) in enumerate(zip(effects, named, strict=True)):
        steps.append(Step(f"{'-' if fit.gone else '+'} {one.name}", gaps[k + 1], None, fit.chi_square / n))
    went = {one.label for one, (fit, _) in zip(effects, named, strict=True) if fit.gone}
    words = in_words(effects, tests, changes, tables.before, went)
    sets = [(one.name, *one.equivalent) for one in effects]
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        gap=gap,
        location=Location((), (), {}, None),
        scores=tuple(_scores(tables, first.predicted, fits, named[k : k + 1]) for k, fits in enumerate(tried)),
        steps=tuple(steps),
        missing=missing(verdict, gap, bool(named)),
        remarks=(words,),
        next_measurements=tuple(next_measurements(sets, verdict in ("unexplained", "partly_explained"), False, False)),
        parameters=whole,
        model=last.model,
        overlay=None,
        seconds=seconds,
    )


def estimates_of(fit: "TableFit") -> dict[str, Estimate]:
    """What has changed, with 90 % intervals; a strength that went is negative."""
    model, found = fit.model, {}
    std = fit.covariance.diagonal().sqrt()
    ends = [model.space.to_si((fit.place + k * QUANTILE * std).clamp(0.0, 1.0)).tolist() for k in (-1, 1)]
    step = 1e-6
    slope = (model.space.to_si(fit.place + step) - model.space.to_si(fit.place - step)) / (2 * step)
    values = model.space.to_si(fit.place).tolist()
    spread = (slope.abs() * std).tolist()
    for k, name in enumerate(model.names):
        key = name.rpartition(".")[2]
        value, low, high = values[k], ends[0][k], ends[1][k]
        if fit.gone and fit.change is not None and _is_strength(fit, key):
            value, low, high = -value, -high, -low
        found[key] = Estimate(value, spread[k], model.units[k], low, high)
    return found


def _is_strength(fit: "TableFit", key: str) -> bool:
    assert fit.change is not None
    assert fit.change.candidate is not None
    return fit.change.candidate.neutral.get(key) == 0.0


def _named(fit: "TableFit", choice: Choice, gaps: tuple[float, float]) -> Named:
    assert fit.change is not None
    change, parameters = fit.change, estimates_of(fit)
    values = ", ".join(f"{name} {one.value:.4g}" for name, one in parameters.items())
    text = (
        f"{change.name}{' gone' if fit.gone else ''} ({values}) takes the difference of the natural frequencies from "
        f"{percent(gaps[0])} to {percent(gaps[1])}{beside_others(choice, 'tables')}."
    )
    options = {} if change.candidate is None else change.candidate.options
    return Named(
        change.name, change.label, options, choice.equivalent, round(choice.confidence, 3), parameters, text, *gaps,
    )  # fmt: skip


def _scores(
    tables: "Tables",
    none: Tensor,
    fits: "Sequence[TableFit]",
    named: "Sequence[tuple[TableFit, Choice]]",
) -> tuple[Scored, ...]:
    """The score table of one step."""
    names = {} if not named else dict.fromkeys(named[0][1].equivalent, "equivalent")
    names |= {fit.change.name: "named" for fit, _ in named if fit.change is not None}
    rows: dict[str, Scored] = {}
    for fit in sorted(fits, key=lambda one: one.evidence):
        assert fit.change is not None
        name = fit.change.name
        if name in rows:
            continue
        left = tables.gap(fit.predicted)
        drop = max(0.0, 1 - left / max(1e-300, tables.gap(none)))
        values = {key: one.value for key, one in estimates_of(fit).items()}
        options = {} if fit.change.candidate is None else fit.change.candidate.options
        remark = names.get(name, f"rejected: leaves {percent(left)}")
        rows[name] = Scored(name, options, drop, values, (), left, remark)
    return tuple(rows.values())
