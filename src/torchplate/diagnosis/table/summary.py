"""What is said of a table: verdict, names with their equivalents, intervals, what is left, and what was assumed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchplate.diagnosis.next_measurement import next_measurements
from torchplate.diagnosis.result import Diagnosis, Estimate, Gap, Location, Named, Scored, Step, Verdict
from torchplate.diagnosis.table.comparison import Comparison, Weighed
from torchplate.diagnosis.table.null import once_in_a_hundred
from torchplate.diagnosis.table.posterior import Entry, Posterior, draws
from torchplate.diagnosis.table.refit import Prior
from torchplate.diagnosis.table.settings import TableSettings

# A number that ends so many standard deviations from what is known of it is remarked; modes that are named where a
# table is left unexplained; ends of the intervals that are reported.
BROKEN, N_WORST, ENDS = 3.0, 4, (0.05, 0.95)
# An estimate that the data narrow by less than this part of its prior's precision has no standard deviation.
UNSEEN = 1e-3
# Probability of the corrected mesh from which it is worth a name.
SURE = 0.95


@dataclass(frozen=True, eq=False)
class Found:
    """What a diagnosis of a table has come to.

    Attributes:
        compared: on each mesh.
        posterior: of all hypotheses.
        prior: what was known beforehand.
        settings: constants.
    """

    compared: tuple[Comparison, ...]
    posterior: Posterior
    prior: Prior
    settings: TableSettings

    @property
    def chosen(self) -> Entry:
        """The hypothesis that is named, if it explains something; else that nothing is missing."""
        best = self.posterior.best()
        if not best.names or self.within_scatter(best) or self.much(best):
            return best
        return self.nothing

    @property
    def nothing(self) -> Entry:
        """That nothing is missing, on the mesh on which it is likelier."""
        return next(one for one in self.posterior.entries if not one.names)

    def within_scatter(self, one: Entry) -> bool:
        """Whether what a hypothesis leaves is within the quantile of its scatter."""
        minimum, evidence = one.weighed.best, one.comparison.plates.evidence
        return minimum.chi_square <= evidence.limit(minimum.n_effective, self.settings.level)

    def much(self, one: Entry) -> bool:
        """Whether a hypothesis takes much of χ² away."""
        before = one.comparison.baseline.best.chi_square
        return one.weighed.best.chi_square <= self.settings.least_part * before

    @property
    def verdict(self) -> Verdict:
        """By what is named and what is left."""
        within = self.within_scatter(self.chosen)
        if not self.chosen.names:
            return "consistent" if within else "unexplained"
        return "explained" if within else "partly_explained"


def summarise(found: Found, seconds: float) -> Diagnosis:
    """Everything that is reported.

    Args:
        found: what was weighed.
        seconds: that it took.
    """
    chosen, verdict = found.chosen, found.verdict
    plates, weighed = chosen.comparison.plates, chosen.weighed
    estimates = _estimates(found, chosen)
    finer = _finer_mesh(found)
    steps = _steps(found, bool(finer))
    effects = tuple(_named(found, k, estimates, steps) for k in range(len(chosen.names)))
    sets = [(one.name, *one.equivalent) for one in effects]
    return Diagnosis(
        verdict=verdict,
        effects=(*finer, *effects),
        gap=Gap(steps[0].gap, steps[-1].gap, None, None, plates.evidence.floor),
        location=Location((), (), {}, None),
        scores=(_scores(found, effects),),
        steps=steps,
        missing=_missing(found),
        remarks=tuple(_remarks(found)),
        next_measurements=tuple(next_measurements(sets, verdict in ("unexplained", "partly_explained"), False, False)),
        parameters=estimates,
        model=plates.finished(weighed.model, weighed.theta),
        overlay=None,
        n_evaluation=sum(one.plates.n_evaluation for one in found.compared),
        seconds=seconds,
    )


def _on(found: Found, kind: str) -> Comparison | None:
    return next((one for one in found.compared if one.kind == kind), None)


def _same(compared: Comparison, key: tuple[int, ...]) -> Weighed | None:
    """The hypothesis of the same candidates on one mesh."""
    if not key:
        return compared.baseline
    return next((one for one in compared.weighed if one.hypothesis is not None and one.hypothesis.key == key), None)


def _key(one: Entry) -> tuple[int, ...]:
    return () if one.weighed.hypothesis is None else one.weighed.hypothesis.key


def _finer_mesh(found: Found) -> tuple[Named, ...]:
    """The mesh as a missing effect of its own, where the corrected one is likelier and closes a gap."""
    given, corrected, chosen = _on(found, "given"), _on(found, "corrected"), found.chosen
    if given is None or corrected is None or chosen.comparison is not corrected:
        return ()
    probability = found.posterior.mesh("corrected")
    coarse = _same(given, _key(chosen)) or given.baseline
    before, after = (
        one.plates.evidence.gap(weighed.best.predicted)
        for one, weighed in ((given, coarse), (corrected, chosen.weighed))
    )
    if probability < SURE or after >= before:
        return ()
    cells = " × ".join(str(cell) for cell in given.plates.model.mesh.cells)
    fine = " × ".join(str(cell) for cell in corrected.plates.model.mesh.cells)
    text = (
        f"On {cells} elements the gap is {_percent(before)}; on {fine}, with the error of the natural frequencies "
        f"extrapolated, it is {_percent(after)}."
    )
    refine = corrected.plates.model.mesh.refine // given.plates.model.mesh.refine
    options = {"refine": refine, "extrapolate": True}
    return (
        Named(
            "mesh_discretisation", "mesh_discretisation", options, (), round(probability, 3), {}, text, before, after
        ),
    )


def _named(found: Found, index: int, estimates: dict[str, Estimate], steps: Sequence[Step]) -> Named:
    chosen, posterior = found.chosen, found.posterior
    hypothesis = chosen.weighed.hypothesis
    assert hypothesis is not None
    part, label = hypothesis.parts[index], hypothesis.labels[index]
    parameters = {
        name.removeprefix(f"{label}."): one for name, one in estimates.items() if name.startswith(f"{label}.")
    }
    equivalent = posterior.equivalent(chosen, part.name)
    confidence = posterior.has([part.name, *equivalent])
    pressed = any(name.startswith(f"{label}.") for name in _pressed(chosen))
    if not found.within_scatter(chosen) or (pressed and not equivalent):
        confidence = min(confidence, found.settings.most_doubtful)
    after = [step for step in steps if step.label != "+ mesh_discretisation"]
    before, left = after[index].gap, after[index + 1].gap
    if steps[0] is after[0] and index == 0 and len(after) != len(steps):
        before = steps[1].gap
    values = [f"{name} {one.value:.4g}{'' if one.unit == '-' else ' ' + one.unit}" for name, one in parameters.items()]
    values += [f"{name} {value}" for name, value in part.candidate.options.items()]
    rivals = [one for one in posterior.rivals(chosen, part.name) if one[0] not in equivalent]
    own = max(rivals[0][1], 1e-300)
    against = ""
    if len(rivals) > 1:
        against = f"; the next best in its place, {rivals[1][0]}, is {_odds(own, rivals[1][1])} less probable"
    alike = f"; this table cannot tell it from {' or '.join(equivalent)}" if equivalent else ""
    text = f"{part.name} ({', '.join(values) or 'no number'}) takes the gap from {_percent(before)} to {_percent(left)}"
    return Named(
        part.name,
        label,
        part.candidate.options,
        equivalent,
        round(confidence, 3),
        parameters,
        f"{text}{against}{alike}.",
        before,
        left,
    )


def _odds(own: float, other: float) -> str:
    ratio = own / max(other, 1e-300)
    return f"{ratio:.3g} times" if ratio < 1e4 else "more than 10,000 times"


def _percent(part: float) -> str:
    return f"{100 * part:.3g} %"


def _estimates(found: Found, chosen: Entry) -> dict[str, Estimate]:
    """Every parameter with its standard deviation and 90 % interval."""
    weighed = chosen.weighed
    model, place, evidence = weighed.model, weighed.best.position, chosen.comparison.plates.evidence
    if not model.names:
        return {}
    drawn = model.space.to_si(draws(weighed, evidence.freedom + evidence.n, found.settings))
    low, high = (drawn.quantile(end, dim=0).tolist() for end in ENDS)
    covariance = torch.linalg.inv(weighed.best.precision).diagonal()
    step = 1e-6
    slope = ((model.space.to_si(place + step) - model.space.to_si(place - step)) / (2 * step)).abs()
    std = (covariance.sqrt() * slope).tolist()
    told = [name in found.prior for name in model.names]
    blind = (covariance * found.settings.volume > 1 / (1 + UNSEEN)).tolist()
    return {
        name: Estimate(value, None if unseen and not known else one, unit, below, above)
        for name, unit, value, one, unseen, known, below, above in zip(
            model.names, model.units, weighed.theta.tolist(), std, blind, told, low, high, strict=True
        )
    }


def _steps(found: Found, finer: bool) -> tuple[Step, ...]:
    chosen = found.chosen

    def one(label: str, compared: Comparison, weighed: Weighed) -> Step:
        best = weighed.best
        rest = max(1.0, compared.plates.evidence.n - best.n_effective)
        return Step(label, compared.plates.evidence.gap(best.predicted), None, best.chi_square / rest)

    steps = []
    given = _on(found, "given")
    if finer and given is not None:
        steps.append(one("baseline", given, given.baseline))
        steps.append(one("+ mesh_discretisation", chosen.comparison, chosen.comparison.baseline))
    else:
        steps.append(one("baseline", chosen.comparison, chosen.comparison.baseline))
    hypothesis = chosen.weighed.hypothesis
    if hypothesis is not None:
        for k, name in enumerate(hypothesis.names[:-1]):
            # On the way to a pair: its first effect alone, refitted.
            alone = _same(chosen.comparison, hypothesis.key[: k + 1])
            steps.append(one(f"+ {name}", chosen.comparison, alone or chosen.comparison.baseline))
        steps.append(one(f"+ {hypothesis.names[-1]}", chosen.comparison, chosen.weighed))
    return tuple(steps)


def _scores(found: Found, effects: Sequence[Named]) -> tuple[Scored, ...]:
    """Every effect that the table can see, with its best option, and those that it cannot."""
    compared = found.chosen.comparison
    first = max(compared.baseline.best.chi_square, 1e-300)
    named = {one.name for one in effects}
    equivalent = {other for one in effects for other in one.equivalent}
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
        remark = f"rejected: a refit leaves {_percent(gap)}, probability {found.posterior.has([part.name]):.2g}"
        if part.name in named:
            remark = "named"
        elif part.name in equivalent:
            remark = "equivalent"
        drop = max(0.0, 1 - weighed.best.chi_square / first)
        rows[part.name] = Scored(part.name, part.candidate.options, drop, values, (), gap, remark)
    for name in compared.unseen:
        rows.setdefault(name, Scored(name, {}, 0.0, {}, (), None, "rejected: this table cannot see it"))
    return tuple(rows.values())


def _missing(found: Found) -> tuple[str, ...]:
    """What is left without a name: how big, and in which modes."""
    if found.verdict in ("consistent", "explained"):
        return ()
    chosen = found.chosen
    evidence, minimum = chosen.comparison.plates.evidence, chosen.weighed.best
    off = evidence.residual(minimum.predicted)
    worst = off.abs().argsort(descending=True)[:N_WORST].tolist()
    named = ", ".join(f"mode {int(evidence.mode[k]) + 1} by {float(off[k]):+.1f}" for k in worst)
    rest = max(1.0, evidence.n - minimum.n_effective)
    return (
        f"In standard deviations of the table, the model is off in {named}.",
        f"Scatter alone would have to be {math.sqrt(minimum.chi_square / rest):.1f} times what the table has.",
    )


def _pressed(one: Entry) -> list[str]:
    """Searched parameters that end on a bound of their interval beyond which there would be more of the same."""
    model, minimum = one.weighed.model, one.weighed.best
    found = []
    for k, name in enumerate(model.names):
        if not bool(minimum.at_bound[k]):
            continue
        label, _, key = name.rpartition(".")
        parameter = model.effects[label].parameters[key]
        low, high = float(model.space.low[k]), float(model.space.high[k])
        at_low = float(minimum.position[k]) < 0.5
        beyond = low - 1e-3 * (high - low) if at_low else high + 1e-3 * (high - low)
        towards_neutral = at_low and parameter.neutral is not None and parameter.neutral <= low
        if beyond in parameter.allowed and not towards_neutral:
            found.append(name)
    return found


def _remarks(found: Found) -> list[str]:
    chosen, posterior, settings = found.chosen, found.posterior, found.settings
    compared, weighed, evidence = chosen.comparison, chosen.weighed, chosen.comparison.plates.evidence
    sentences = list(evidence.sentences)
    if len(found.compared) > 1:
        which = "the mesh as given" if chosen.comparison.kind == "given" else "the mesh with its error taken off"
        gaps = ", ".join(
            f"{_percent(one.plates.evidence.gap(one.baseline.best.predicted))} on the {one.kind} one"
            for one in found.compared
        )
        sentences.append(
            f"Both meshes were tried: the fitted given model leaves {gaps}; {which} has the probability "
            f"{posterior.mesh(chosen.comparison.kind):.2g}."
        )
    odds = ", ".join(f"{one:g}" for one in settings.prior_number)
    sentences.append(
        f"Before the table: probability {odds} that no, one, two effects are missing, shared evenly by the effects. "
        f"After it: {posterior.number(0):.2g}, {posterior.number(1):.2g}, {posterior.number(2):.2g}."
    )
    if chosen.names and not found.within_scatter(chosen):
        sentences.append(
            "More than scatter is left, so something is missing that was no hypothesis: these probabilities compare "
            "the effects of the catalogue with one another."
        )
    minimum = weighed.best
    kappa = math.sqrt(evidence.kappa_square(minimum.chi_square))
    sentences.append(f"The scatter that goes with what is left is {kappa:.2g} times the table's.")
    singles = [one for one in compared.weighed if len(one.names) == 1]
    if singles:
        best = min(singles, key=lambda one: one.best.chi_square)
        fall = max(0.0, compared.baseline.best.chi_square - best.best.chi_square)
        sentences.append(
            f"One effect alone takes {fall:.3g} from χ² at most ({best.names[0]}); where nothing is missing, the best "
            f"takes {once_in_a_hundred(compared, settings):.3g} once in a hundred times."
        )
    if compared.n_pair_left:
        sentences.append(
            f"{compared.n_pair_left} pairs of effects that promised less than the others were not refitted."
        )
    values = dict(zip(weighed.model.names, weighed.theta.tolist(), strict=True))
    for name, (mean, std) in found.prior.items():
        if name in values and abs(values[name] - mean) > BROKEN * std:
            sentences.append(
                f"{name} ends at {values[name]:.4g}, {abs(values[name] - mean) / std:.1f} standard deviations from the "
                f"{mean:.4g} that is known of it: do not believe it; something else is missing."
            )
    sentences += [
        f"{name} sits on the edge of its interval: widen it, or take it as a sign." for name in _pressed(chosen)
    ]
    return sentences
