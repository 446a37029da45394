"""From what was fitted to what is said of it: verdict, names, evidence, what is missing, what to measure next."""

import math
from collections.abc import Mapping, Sequence

import torch

from torchplate.diagnosis.candidates.candidate import nameable
from torchplate.diagnosis.fit import Fit, Prior
from torchplate.diagnosis.localise import localise
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.next_measurement import next_measurements
from torchplate.diagnosis.result import Diagnosis, Estimate, Gap, Location, Named, Overlay, Scored, Step, Verdict
from torchplate.diagnosis.selection.criterion import Hypothesis, evidence, excessive, is_explained, weight_of
from torchplate.diagnosis.selection.screen import twins
from torchplate.diagnosis.selection.trace import Naming, Ranked, State, Trace
from torchplate.measurement.noise import Noise
from torchplate.model import PlateModel

# A number that ends so many standard deviations from what is known of it is remarked.
BROKEN = 3.0
# What the nuisances are called.
NUISANCES = {
    "position_std": "hits and sensors off their marks",
    "calibration_std": "errors of calibration",
    "frequency_drift": "a drift of the natural frequencies",
    "damping_scatter": "a scatter of the modes' damping",
    "thickness": "a thickness that wanders over the plate",
    "modulus": "a modulus that wanders over the plate",
    "grain": "a grain",
    "mesh": "an error of the mesh",
}
# Of the standard normal distribution, at 95 %.
QUANTILE = 1.645


def summarise(seen: Trace, seconds: float) -> Diagnosis:
    """Everything that is reported.

    Args:
        seen: what was fitted.
        seconds: that it took.
    """
    builder, noise, baseline, final = seen.builder, seen.noise, seen.baseline, seen.final
    verdict = _verdict(builder, final)
    finer = _finer_mesh(seen)
    effects = tuple(_named(builder, one, final) for one in final.named)
    sets = [(one.name, *one.equivalent) for one in effects]
    unexplained = verdict in ("unexplained", "partly_explained")
    n_frf = len(builder.target.measurement.pairs)
    symmetric = bool(effects) and _on_symmetry(builder.given)
    return Diagnosis(
        verdict=verdict,
        # Where nothing of the catalogue accounts for what is missing, a finer mesh is no name for it: it is a remark.
        effects=effects if verdict == "unexplained" else (*finer, *effects),
        gap=_gap(builder, _first(seen, bool(finer)), final.fit),
        location=_location(builder, baseline, final),
        scores=tuple(_table(one, effects, builder) for one in seen.rankings),
        steps=_steps(seen, bool(finer)),
        missing=_missing(builder, noise, final, verdict),
        remarks=(
            *(one.evidence for one in finer if verdict == "unexplained"),
            *_nothing_but_chance(seen),
            *_remarks(noise, final, seen.prior),
        ),
        next_measurements=tuple(next_measurements(sets, unexplained, 0 < n_frf < 3, symmetric)),
        parameters=_estimates(final.fit),
        model=builder.finished(final.fit.model, final.fit.theta),
        overlay=_overlay(builder, noise, _first(seen, bool(finer)), final.fit),
        n_evaluation=builder.n_evaluation,
        seconds=seconds,
    )


def _finer_mesh(seen: Trace) -> tuple[Named, ...]:
    """The mesh as a missing effect of its own, where its error shows."""
    builder, given, baseline = seen.builder, seen.given, seen.baseline.fit
    if builder.mesh.extrapolate:
        # It is mended already.
        return ()
    weight = weight_of([given, baseline])
    settings = baseline.comparison
    # As probable beforehand as any one effect.
    odds = 2 * math.log((1 - settings.missing) / (settings.missing / len(nameable())))
    if not baseline.by_noise or evidence(given, weight) - evidence(baseline, weight) < odds:
        return ()
    before, after = (float(builder.target.gap(one.prediction)) for one in (given, baseline))
    cells = " × ".join(str(cell) for cell in builder.mesh.cells)
    if after < before:
        shown = f"gap is {_percent(after)} instead of {_percent(before)}"
    else:
        shown = (
            f"misfit is {baseline.reduced_misfit:.3g} times what noise and nuisances explain, not "
            f"{given.reduced_misfit:.3g} times"
        )
    text = f"On {cells} elements, with the error of the natural frequencies extrapolated, the fitted model's {shown}."
    options = {"refine": seen.final.fit.model.mesh.refine // given.model.mesh.refine, "extrapolate": True}
    return (Named("mesh_discretisation", "mesh_discretisation", options, (), 0.99, {}, text, before, after),)


def _verdict(builder: ModelBuilder, final: State) -> Verdict:
    explained = is_explained(final.fit, builder.target)
    if not final.named:
        return "consistent" if explained else "unexplained"
    return "explained" if explained else "partly_explained"


def _named(builder: ModelBuilder, naming: Naming, last: State) -> Named:
    final = last.fit
    hypothesis = naming.hypothesis
    before, after = (float(builder.target.gap(one.prediction)) for one in (naming.before, hypothesis.fit))
    found = _estimates(final)
    prefix = f"{hypothesis.label}."
    parameters = {name.removeprefix(prefix): one for name, one in found.items() if name.startswith(prefix)}
    equivalent = naming.known.equivalent
    rival = naming.known.next_best
    against = ""
    if rival is not None:
        rest = float(builder.target.gap(rival.fit.prediction))
        against = f"; the next best{' in its place' if naming.again else ''}, {rival.name}, leaves {_percent(rest)}"
        against += " beside the other effects" if naming.again else ""
    alike = f"; these data cannot tell it from {' or '.join(equivalent)}" if equivalent else ""
    text = (
        f"{hypothesis.name} ({_values(parameters, hypothesis)}) takes the gap from {_percent(before)} to "
        f"{_percent(after)}{against}{alike}{_chance(naming)}."
    )
    return Named(
        name=hypothesis.name,
        label=hypothesis.label,
        options=hypothesis.candidate.options,
        equivalent=equivalent,
        confidence=round(_confidence(naming, final, builder), 3),
        parameters=parameters,
        evidence=text,
        gap_before=before,
        gap_after=after,
    )


def _chance(naming: Naming) -> str:
    """What it takes beside what chance takes, where that was asked."""
    if naming.by_chance <= 0:
        return ""
    fall = naming.before.cost - naming.hypothesis.fit.cost
    return (
        f"; it takes {fall:.3g} from −2 ln L, of which the best of the catalogue takes "
        f"{naming.by_chance:.3g} once in a hundred times where nothing is missing"
    )


def _confidence(naming: Naming, final: Fit, builder: ModelBuilder) -> float:
    """Posterior probability of the set; of what the last model leaves unexplained it accounts for nothing."""
    found = naming.known.confidence
    if is_explained(final, builder.target):
        return found
    return found * max(0.0, 1 - final.gap / max(naming.before.gap, 1e-300))


def _values(parameters: Mapping[str, Estimate], hypothesis: Hypothesis) -> str:
    parts = [f"{name} {one.value:.4g}{'' if one.unit == '-' else ' ' + one.unit}" for name, one in parameters.items()]
    parts += [f"{name} {value}" for name, value in hypothesis.candidate.options.items()]
    return ", ".join(parts) or "no number"


def _percent(part: float) -> str:
    return f"{100 * part:.3g} %"


def _estimates(fit: Fit) -> dict[str, Estimate]:
    found = {}
    std = fit.covariance.diagonal().clamp(min=0).sqrt().tolist()
    space = fit.model.space
    ends = zip(space.low.tolist(), space.high.tolist(), strict=True)
    rows = zip(fit.model.names, fit.model.units, fit.theta.tolist(), std, ends, space.logarithmic.tolist(), strict=True)
    for name, unit, value, one, (lowest, highest), logarithmic in rows:
        if math.isnan(one):
            found[name] = Estimate(value, None, unit)
            continue
        if logarithmic and value > 0:
            # The posterior is normal on the scale on which it was searched.
            factor = math.exp(min(700.0, QUANTILE * one / value))
            low, high = value / factor, value * factor
        else:
            low, high = value - QUANTILE * one, value + QUANTILE * one
        found[name] = Estimate(value, one, unit, max(low, lowest), min(high, highest))
    return found


def _gap(builder: ModelBuilder, before: Fit, after: Fit) -> Gap:
    def one(fit: Fit, heldout: bool) -> float | None:
        value = float(builder.target.gap(fit.prediction, heldout))
        return None if math.isnan(value) else value

    return Gap(
        one(before, False) or 0.0,
        one(after, False) or 0.0,
        one(before, True),
        one(after, True),
        builder.target.floor,
        builder.target.expected_gap(after.marginal),
    )


def _first(seen: Trace, finer: bool) -> Fit:
    """What the gap begins with."""
    return seen.given if finer else _on_fine_mesh(seen)


def _on_fine_mesh(seen: Trace) -> Fit:
    """The baseline without its mesh error; settled, if nothing was added."""
    return seen.baseline.fit if seen.final.named else seen.final.fit


def _steps(seen: Trace, finer: bool) -> tuple[Step, ...]:
    builder, final = seen.builder, seen.final

    def one(label: str, fit: Fit) -> Step:
        held = float(builder.target.gap(fit.prediction, True))
        gap = float(builder.target.gap(fit.prediction))
        return Step(label, gap, None if math.isnan(held) else held, fit.reduced_misfit)

    steps = [one("baseline", _first(seen, finer))]
    if finer:
        steps.append(one("+ mesh_discretisation", _on_fine_mesh(seen)))
    fits = [naming.hypothesis.fit for naming in final.named]
    # The last step is the last model, fitted once more where it has come to.
    fits[-1:] = [final.fit] if fits else []
    steps += [one(f"+ {naming.hypothesis.name}", found) for naming, found in zip(final.named, fits, strict=True)]
    return tuple(steps)


def _table(ranked: Ranked, effects: Sequence[Named], builder: ModelBuilder) -> tuple[Scored, ...]:
    """The score table of one ranking: of each effect the option that promises most."""
    alike = twins(ranked.promises)
    refits = {one.name: one for one in sorted(ranked.hypotheses, key=lambda one: -one.cost)}
    named = {one.name for one in effects}
    equivalent = {other for one in effects for other in one.equivalent}
    rows: dict[str, Scored] = {}
    for promise, near in zip(ranked.promises, alike, strict=True):
        name = promise.candidate.name
        if name in rows:
            continue
        refit = refits.get(name)
        gap = None if refit is None else float(builder.target.gap(refit.fit.prediction))
        if name in named:
            remark = "named"
        elif name in equivalent:
            remark = "equivalent"
        elif gap is not None:
            remark = f"rejected: a refit leaves {_percent(gap)}"
        else:
            remark = "rejected: promises too little"
        rows[name] = Scored(name, promise.candidate.options, promise.drop, promise.values, near, gap, remark)
    return tuple(rows.values())


def _location(builder: ModelBuilder, baseline: State, final: State) -> Location:
    target = builder.target
    return localise(
        target.measurement,
        target.variance.sqrt(),
        baseline.fit.prediction,
        baseline.fit.reduced,
        baseline.fit.theta,
        target.heldout,
        after=final.fit.prediction,
    )


def _missing(builder: ModelBuilder, noise: Noise, final: State, verdict: Verdict) -> tuple[str, ...]:
    """What is left without a name: how big, where, in which band, of which kind."""
    target = builder.target
    if verdict in ("consistent", "explained"):
        return ()
    gap = float(target.gap(final.fit.prediction))
    left = localise(
        target.measurement,
        target.variance.sqrt(),
        final.fit.prediction,
        final.fit.reduced,
        final.fit.theta,
        target.heldout,
    )
    expected = target.expected_gap(final.fit.marginal)
    size = (
        f"A gap of {_percent(gap)} is left, where noise alone makes {_percent(noise.floor)}, and noise and the "
        f"imperfections of the test as large as was said make {_percent(expected)}."
    )
    return (size, *_would_take(final.fit), *left.sentences)


def _would_take(fit: Fit) -> tuple[str, ...]:
    """How large noise and nuisances would have to be to explain what is left."""
    parts = [
        f"{NUISANCES.get(name, name)} {scale:.1f} times as large as was said" for name, scale in excessive(fit).items()
    ]
    if fit.judged.noise_scale**2 > fit.comparison.noise_limit:
        parts.append(f"noise {fit.judged.noise_scale:.1f} times as large as it was found to be")
    return (f"To explain it without any effect would take {', and '.join(parts)}.",) if parts else ()


def _remarks(noise: Noise, final: State, prior: Prior) -> tuple[str, ...]:
    sentences = list(noise.sentences)
    model, theta = final.fit.model, final.fit.theta
    values = dict(zip(model.names, theta.tolist(), strict=True))
    for name, (mean, std) in prior.items():
        if name in values and abs(values[name] - mean) > BROKEN * std:
            sentences.append(
                f"{name} ends at {values[name]:.4g}, {abs(values[name] - mean) / std:.1f} standard deviations from the "
                f"{mean:.4g} that is known of it: do not believe it; something else is missing."
            )
    if len(model.names):
        rigid = _still_rigid(final)
        for name, on in zip(model.names, model.space.at_bound(theta).tolist(), strict=True):
            if on and name not in rigid:
                sentences.append(f"{name} sits on the edge of its interval: widen it, or take it as a sign.")
    return tuple(sentences)


def _nothing_but_chance(seen: Trace) -> tuple[str, ...]:
    """What the best of the catalogue would take where nothing was named, beside what chance takes."""
    if seen.final.named or not seen.rankings or seen.rankings[0].by_chance <= 0 or not seen.rankings[0].hypotheses:
        return ()
    ranked = seen.rankings[0]
    best = min(ranked.hypotheses, key=lambda one: one.cost)
    fall = max(0.0, seen.baseline.fit.cost - best.fit.cost)
    return (
        f"The best of the catalogue, {best.name}, would take {fall:.3g} from −2 ln L; where nothing is "
        f"missing, the best takes {ranked.by_chance:.3g} once in a hundred times.",
    )


def _still_rigid(final: State) -> set[str]:
    """Stiffnesses of a held edge that yields otherwise: these may be as large as they can."""
    values = dict(zip(final.fit.model.names, final.fit.theta.tolist(), strict=True))
    return {
        name
        for naming in final.named
        if naming.hypothesis.candidate.replaces
        for key, neutral in naming.hypothesis.candidate.neutral.items()
        if values.get(name := f"{naming.hypothesis.label}.{key}", 0.0) > 0.1 * neutral
    }


def _overlay(builder: ModelBuilder, noise: Noise, before: Fit, after: Fit) -> Overlay:
    target = builder.target
    return Overlay(target.measurement, noise.std, before.prediction, after.prediction, target.heldout)


def _on_symmetry(model: PlateModel) -> bool:
    """Whether all responses and all references lie on one line of symmetry of the plate."""
    sides = [model.mesh.places(list(points)) for points in (model.response, model.reference) if points]
    return bool(sides) and bool(((torch.cat(sides) - 0.5).abs() < 1e-6).all(0).any())
