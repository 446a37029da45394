"""What is said of a table: verdict, names with their equivalents, intervals, what is left, and what was assumed."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.naming import remark_on
from torchplate.diagnosis.next_measurement import next_measurements
from torchplate.diagnosis.result import Diagnosis, Estimate, Gap, Location, Named, Scored, Step
from torchplate.diagnosis.table.comparison import Comparison, Weighed
from torchplate.diagnosis.table.found import Found, compared_on, same_on
from torchplate.diagnosis.table.naming import as_named, finer_mesh
from torchplate.diagnosis.table.posterior import Entry, pooled
from torchplate.diagnosis.table.remarks import all_remarks, missing_still
from torchplate.notation import percent

# Ends of the intervals that are reported: those of 90 %, as everywhere.
ENDS = (0.05, 0.95)


def summarise(found: Found, seconds: float) -> Diagnosis:
    """Everything that is reported.

    Args:
        found: what was weighed.
        seconds: that it took.
    """
    chosen, verdict = found.chosen, found.verdict
    plates, weighed = chosen.comparison.plates, chosen.weighed
    estimates = _estimates(found, chosen)
    finer = finer_mesh(found)
    steps = _steps(found, bool(finer))
    effects = tuple(as_named(found, k, estimates, steps) for k in range(len(chosen.names)))
    sets = [(one.name, *one.equivalent) for one in effects]
    return Diagnosis(
        verdict=verdict,
        effects=(*finer, *effects),
        gap=Gap(steps[0].gap, steps[-1].gap, None, None, plates.evidence.floor),
        location=Location((), (), {}, None),
        scores=(_scores(found, effects),),
        steps=steps,
        missing=missing_still(found),
        remarks=tuple(all_remarks(found)),
        next_measurements=tuple(next_measurements(sets, verdict in ("unexplained", "partly_explained"), False, False)),
        parameters=estimates,
        model=plates.finished(weighed.model, weighed.theta),
        overlay=None,
        n_evaluation=sum(one.plates.n_evaluation for one in found.compared),
        seconds=seconds,
    )


def _estimates(found: Found, chosen: Entry) -> dict[str, Estimate]:
    """Every parameter with its standard deviation and 90 % interval."""
    weighed = chosen.weighed
    model, place = weighed.model, weighed.best.position
    if not model.names:
        return {}
    drawn = pooled(found.posterior, chosen)
    on_low, on_high = (weighed.best.at_bound & (place < 0.5)).tolist(), (weighed.best.at_bound & (place > 0.5)).tolist()
    numbers = weighed.theta.tolist()
    intervals = [_interval(drawn[name], *at) for name, *at in zip(model.names, numbers, on_low, on_high, strict=True)]
    covariance = torch.linalg.inv(weighed.best.precision).diagonal()
    step = 1e-6
    slope = ((model.space.to_si(place + step) - model.space.to_si(place - step)) / (2 * step)).abs()
    std = (covariance.sqrt() * slope).tolist()
    told = [name in found.prior for name in model.names]
    blind = (covariance * found.settings.volume > 1 / (1 + found.settings.blind)).tolist()
    return {
        name: Estimate(value, None if unseen and not known else one, unit, *interval)
        for name, unit, value, one, unseen, known, interval in zip(
            model.names, model.units, numbers, std, blind, told, intervals, strict=True
        )
    }


def _interval(drawn: Float[Tensor, " n_draw"], value: float, on_low: bool, on_high: bool) -> tuple[float, float]:
    """The 90 % interval of a parameter: as much is left out on either side, or all of it away from a bound it sits on.

    The most probable value is on that bound then, which an interval that leaves out both ends would not hold.
    """
    both = ENDS[1] - ENDS[0]
    if on_low:
        return value, max(value, float(drawn.quantile(both)))
    if on_high:
        return min(value, float(drawn.quantile(1 - both))), value
    low, high = (float(drawn.quantile(end)) for end in ENDS)
    return low, high


def _steps(found: Found, finer: bool) -> tuple[Step, ...]:
    chosen = found.chosen

    def one(label: str, compared: Comparison, weighed: Weighed) -> Step:
        best = weighed.best
        rest = max(1.0, compared.plates.evidence.n - best.n_effective)
        return Step(label, compared.plates.evidence.gap(best.predicted), None, best.chi_square / rest)

    steps = []
    given = compared_on(found, "given")
    if finer and given is not None:
        steps.append(one("baseline", given, given.baseline))
        steps.append(one("+ mesh_discretisation", chosen.comparison, chosen.comparison.baseline))
    else:
        steps.append(one("baseline", chosen.comparison, chosen.comparison.baseline))
    hypothesis = chosen.weighed.hypothesis
    if hypothesis is not None:
        for k, name in enumerate(hypothesis.names[:-1]):
            # On the way to a pair: its first effect alone, refitted.
            alone = same_on(chosen.comparison, hypothesis.key[: k + 1])
            steps.append(one(f"+ {name}", chosen.comparison, alone or chosen.comparison.baseline))
        steps.append(one(f"+ {hypothesis.names[-1]}", chosen.comparison, chosen.weighed))
    return tuple(steps)


def _scores(found: Found, effects: Sequence[Named]) -> tuple[Scored, ...]:
    """Every effect that the table can see, with its best option, and those that it cannot."""
    compared = found.chosen.comparison
    first = max(compared.baseline.best.chi_square, 1e-300)
    rows: dict[str, Scored] = {}
    for weighed in sorted(compared.weighed, key=lambda one: one.evidence):
        hypothesis = weighed.hypothesis
        if hypothesis is None or len(hypothesis.parts) > 1 or hypothesis.names[0] in rows:
            continue
        part, label = hypothesis.parts[0], hypothesis.labels[0]
        gap = compared.plates.evidence.gap(weighed.best.predicted)
        values = {
            name.removeprefix(f"{label}."): value
            for name, value in zip(weighed.model.names, weighed.theta.tolist(), strict=True)
            if name.startswith(f"{label}.")
        }
        why = f"a refit leaves {percent(gap)}, probability {found.posterior.has([part.name]):.2g}"
        remark = remark_on(part.name, effects, f"rejected: {why}")
        drop = max(0.0, 1 - weighed.best.chi_square / first)
        rows[part.name] = Scored(part.name, part.candidate.options, drop, values, (), gap, remark)
    for name in compared.unseen:
        rows.setdefault(name, Scored(name, {}, 0.0, {}, (), None, "rejected: this table cannot see it"))
    return tuple(rows.values())
