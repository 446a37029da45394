"""From what was fitted to what is said of it: verdict, names, evidence, what is missing, what to measure next."""

import math
from collections.abc import Sequence

import torch

from torchplate.diagnosis.before_and_after import (
    around,
    gap_left,
    gap_of,
    location_of,
    overlay_of,
    step_of,
    steps_of,
    verdict_of,
)
from torchplate.diagnosis.candidates.candidate import nameable
from torchplate.diagnosis.doubts import doubts_of
from torchplate.diagnosis.estimates import estimates
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.naming import as_named, remark_on
from torchplate.diagnosis.next_measurement import next_measurements
from torchplate.diagnosis.remarks import (
    all_remarks,
    faults_of,
    missing_still,
    nothing_but_chance,
    of_the_given_mesh,
    of_the_uniform_plate,
)
from torchplate.diagnosis.result import Diagnosis, Named, Scored, Step
from torchplate.diagnosis.selection.criterion import evidence, is_explained, weight_of
from torchplate.diagnosis.selection.screen import twins
from torchplate.diagnosis.selection.trace import Ranked, Trace
from torchplate.model import PlateModel
from torchplate.notation import percent


def summarise(seen: Trace, seconds: float) -> Diagnosis:
    """Everything that is reported.

    Args:
        seen: what was fitted.
        seconds: that it took.
    """
    builder, noise, baseline, final = seen.builder, seen.noise, seen.baseline, seen.final
    explained = is_explained(final.fit, builder.target) and not faults_of(builder, noise)
    verdict = verdict_of(bool(final.named), explained)
    finer = _finer_mesh(seen)
    first = _first(seen, bool(finer))
    steps = _steps(seen, bool(finer))
    gaps = around(steps, len(final.named))
    effects = tuple(as_named(builder, one, final, gap) for one, gap in zip(final.named, gaps, strict=True))
    sets = [(one.name, *one.equivalent) for one in effects]
    unexplained = verdict in ("unexplained", "partly_explained")
    n_frf = len(builder.target.measurement.pairs)
    few = 0 < n_frf < builder.target.settings.holding_out.few
    symmetric = bool(effects) and _on_symmetry(builder.given)
    return Diagnosis(
        verdict=verdict,
        # Where nothing of the catalogue accounts for what is missing, a finer mesh is no name for it: it is a remark.
        effects=effects if verdict == "unexplained" else (*finer, *effects),
        gap=gap_of(builder.target, first, final.fit),
        location=location_of(builder.target, baseline.fit, final.fit),
        scores=tuple(_table(one, effects, builder) for one in seen.rankings),
        steps=steps,
        missing=missing_still(builder, noise, final, verdict),
        remarks=(
            *(one.evidence for one in finer if verdict == "unexplained"),
            *of_the_given_mesh(builder),
            *of_the_uniform_plate(builder, final),
            *nothing_but_chance(seen),
            *all_remarks(noise, final, seen.prior),
        ),
        next_measurements=tuple(next_measurements(sets, unexplained, few, symmetric)),
        parameters=estimates(final.fit, builder.top),
        model=builder.finished(final.fit.model, final.fit.theta),
        overlay=overlay_of(builder.target, first, final.fit),
        n_evaluation=builder.n_evaluation,
        seconds=seconds,
        doubts=doubts_of(final),
    )


def _finer_mesh(seen: Trace) -> tuple[Named, ...]:
    """The mesh as a missing effect of its own, where its error shows."""
    builder, given, baseline = seen.builder, seen.given, seen.baseline.fit
    if builder.mesh.extrapolate:
        # It is mended already.
        return ()
    unrefined, refined = (given, baseline) if seen.unrefined is None else (seen.unrefined, seen.final.fit)
    weight = weight_of([unrefined, refined])
    settings = baseline.comparison
    # As probable beforehand as any one effect.
    odds = 2 * math.log((1 - settings.missing) / (settings.missing / len(nameable())))
    if not refined.by_noise or evidence(unrefined, weight) - evidence(refined, weight) < odds:
        return ()
    before, after = (gap_left(builder.target, one) for one in (given, baseline))
    cells = " × ".join(str(cell) for cell in builder.mesh.cells)
    which = "fitted" if seen.unrefined is None or after < before else "last"
    if after < before:
        shown = f"gap is {percent(after)} instead of {percent(before)}"
    else:
        shown = (
            f"misfit is {refined.reduced_misfit:.3g} times what noise and nuisances explain, not "
            f"{unrefined.reduced_misfit:.3g} times"
        )
    text = f"On {cells} elements, with the error of the natural frequencies extrapolated, the {which} model's {shown}."
    options = {"refine": seen.final.fit.model.mesh.refine // given.model.mesh.refine, "extrapolate": True}
    return (Named("mesh_discretisation", "mesh_discretisation", options, (), settings.finer, {}, text, before, after),)


def _first(seen: Trace, finer: bool) -> Fit:
    """What the gap begins with."""
    return seen.given if finer else _on_fine_mesh(seen)


def _on_fine_mesh(seen: Trace) -> Fit:
    """The baseline without its mesh error; settled, if nothing was added."""
    return seen.baseline.fit if seen.final.named else seen.final.fit


def _steps(seen: Trace, finer: bool) -> tuple[Step, ...]:
    target, final = seen.builder.target, seen.final
    steps = [step_of(target, "baseline", _first(seen, finer))]
    if finer:
        steps.append(step_of(target, "+ mesh_discretisation", _on_fine_mesh(seen)))
    labels = [f"+ {naming.hypothesis.name}" for naming in final.named]
    steps += steps_of(target, labels, [naming.before for naming in final.named], final.fit)
    return tuple(steps)


def _table(ranked: Ranked, effects: Sequence[Named], builder: ModelBuilder) -> tuple[Scored, ...]:
    """The score table of one ranking: of each effect the option that promises most."""
    alike = twins(ranked.promises)
    refits = {one.name: one for one in sorted(ranked.hypotheses, key=lambda one: -one.cost)}
    rows: dict[str, Scored] = {}
    for promise, near in zip(ranked.promises, alike, strict=True):
        name = promise.candidate.name
        if name in rows:
            continue
        refit = refits.get(name)
        gap = None if refit is None else gap_left(builder.target, refit.fit)
        if gap is not None:
            why = f"a refit leaves {percent(gap)}"
        elif name in ranked.far:
            why = "fitted to smoothed FRFs, it stays far above the best"
        else:
            why = "promises too little"
        remark = remark_on(name, effects, f"rejected: {why}")
        rows[name] = Scored(name, promise.candidate.options, promise.drop, promise.values, near, gap, remark)
    return tuple(rows.values())


def _on_symmetry(model: PlateModel) -> bool:
    """Whether all responses and all references lie on one line of symmetry of the plate."""
    sides = [model.mesh.places(list(points)) for points in (model.response, model.reference) if points]
    return bool(sides) and bool(((torch.cat(sides) - 0.5).abs() < 1e-6).all(0).any())
