"""What is missing still, and what is remarked beside the verdict."""

from collections.abc import Iterable

from torch import Tensor

from torchplate.diagnosis.before_and_after import gap_left, left_beside_the_specimen, location_of
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.posterior import seen_together
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.result import Verdict
from torchplate.diagnosis.selection.criterion import excessive, is_explained
from torchplate.diagnosis.selection.trace import State, Trace
from torchplate.diagnosis.settings import SETTINGS
from torchplate.measurement import Noise
from torchplate.notation import percent

# What the nuisances are called.
NUISANCES = {
    "position_std": "hits and sensors off their marks",
    "calibration_std": "errors of calibration",
    "frequency_drift": "a drift of the natural frequencies",
    "damping_scatter": "a scatter of the modes' damping",
    "thickness": "a thickness that wanders over the plate",
    "modulus": "a modulus that wanders over the plate",
    "grain": "a grain",
    "drive_point": "drive points that give way less than under a point force",
    "mesh": "an error of the mesh",
}


def missing_still(builder: ModelBuilder, noise: Noise, final: State, verdict: Verdict) -> tuple[str, ...]:
    """What is left without a name: how big, where, in which band, of which kind."""
    target = builder.target
    if verdict in ("consistent", "explained"):
        return ()
    faults = faults_of(builder, noise)
    if faults and is_explained(final.fit, target):
        return faults
    gap, left = gap_left(target, final.fit), location_of(target, final.fit, final.fit)
    expected = target.expected_gap(final.fit.reduced, final.fit.theta, final.fit.marginal)
    size = (
        f"A gap of {percent(gap)} is left, where noise alone makes {percent(noise.floor)}, and noise and the "
        f"imperfections of the test as large as was said make {percent(expected)}."
    )
    return (*faults, size, *would_take(final.fit), *left.sentences)


def faults_of(builder: ModelBuilder, noise: Noise) -> tuple[str, ...]:
    """What ails single FRFs whatever the model: what repeats in every record and is no sum of resonances, and scatter.

    Either may be fitted as noise; that does not make it explained.
    """
    said = []
    if which := _named(builder, noise.distorted):
        said.append(
            f"{_frfs(which)} over the lines more than twice as much as the records behind them differ, which is not so "
            "with the other FRFs: something repeats in every record that no resonance makes, as a clipped or rattling "
            "sensor does. Look at its time records and its range."
        )
    if which := _named(builder, noise.loud):
        said.append(
            f"{_frfs(which)} over the lines more than ten times as much as the other FRFs, as such and as a part of "
            "what is there. So does a clipped, loose or broken sensor. Look at its time records, its range and its "
            "cable, or leave it out."
        )
    return tuple(said)


def _named(builder: ModelBuilder, which: Tensor | None) -> list[str]:
    measurement = builder.target.measurement
    return [] if which is None else [measurement.pair_label(*pair) for pair in which.nonzero().tolist()]


def _frfs(labels: list[str]) -> str:
    return f"FRF {labels[0]} scatters" if len(labels) == 1 else f"FRFs {', '.join(labels)} scatter"


def would_take(fit: Fit) -> tuple[str, ...]:
    """How large noise and nuisances would have to be to explain what is left."""
    parts = sizes(fit, excessive(fit))
    if fit.judged.noise_scale**2 > fit.comparison.noise_limit:
        parts.append(f"noise {fit.judged.noise_scale:.1f} times as large as it was found to be")
    return (f"To explain it without any effect would take {', and '.join(parts)}.",) if parts else ()


def sizes(fit: Fit, groups: Iterable[str]) -> list[str]:
    """How large groups of nuisances were found to be.

    Args:
        fit: that needs them so.
        groups: of nuisances.
    """
    scale, absurd = fit.judged.scale, fit.comparison.absurd
    return [f"{NUISANCES.get(name, name)} {_times(scale[name], absurd)} times as large as was said" for name in groups]


def _times(scale: float, absurd: float) -> str:
    """How many times; where a nuisance would have to be absurdly large, how much so says nothing."""
    return f"{scale:.1f}" if scale < absurd else f"more than {absurd:g}"


def of_the_uniform_plate(builder: ModelBuilder, final: State) -> tuple[str, ...]:
    """What the gap says, and what it does not, where the plate was found to wander as that of the model does not."""
    beside = left_beside_the_specimen(builder.target, final.fit)
    if beside is None:
        return ()
    return (
        f"The gap of {percent(gap_left(builder.target, final.fit))} is that of a uniform plate, as the model is that "
        f"is handed over. It is {percent(beside)} beside the plate as thickness, modulus and grain were found to "
        "wander over it, within what was said of them. Names are judged beside that and what else is not perfect.",
    )


def all_remarks(noise: Noise, final: State, prior: Prior) -> tuple[str, ...]:
    """On the noise, on what is known beforehand, and on what sits on the edge of its interval."""
    sentences = list(noise.sentences)
    model, theta = final.fit.model, final.fit.theta
    values = dict(zip(model.names, theta.tolist(), strict=True))
    for name, (mean, std) in prior.items():
        if name in values and abs(values[name] - mean) > final.fit.comparison.size_limit * std:
            sentences.append(
                f"{name} ends at {values[name]:.4g}, {abs(values[name] - mean) / std:.1f} standard deviations from the "
                f"{mean:.4g} that is known of it: do not believe it; something else is missing."
            )
    for together in seen_together(final.fit.information, final.fit.told):
        names = [model.names[index] for index in together]
        sentences.append(
            f"{', '.join(names[:-1])} and {names[-1]} undo one another in these data: what they do together is known, "
            "and each by itself no better than the intervals that were given. Fix one of them."
        )
    if len(model.names):
        rigid = _still_rigid(final)
        for name, on in zip(model.names, model.space.at_bound(theta).tolist(), strict=True):
            if on and name not in rigid:
                sentences.append(f"{name} sits on the edge of its interval: widen it, or take it as a sign.")
    return tuple(sentences)


def of_the_given_mesh(builder: ModelBuilder) -> tuple[str, ...]:
    """Where the FRFs hold the error of the given mesh, nothing else was looked for."""
    if not builder.as_given:
        return ()
    cells = " × ".join(str(cell) for cell in builder.mesh.cells)
    return (
        f"The model explains the FRFs on its own mesh of {cells} elements alone, and not on a finer one: they hold the "
        "error of that mesh, as FRFs that were computed on it do and those of a plate do not. Nothing else was looked "
        "for. Where these are of a plate, set mesh.refine and diagnose again.",
    )


def nothing_but_chance(seen: Trace) -> tuple[str, ...]:
    """What the best of the catalogue would take where nothing was named, beside what chance takes."""
    if seen.final.named or not seen.rankings or seen.rankings[0].by_chance <= 0:
        return ()
    ranked = seen.rankings[0]
    if not ranked.hypotheses:
        best = ranked.most_beyond
        if best is None or not ranked.square:
            return ()
        return (
            f"On a finer mesh the best of the catalogue, {best.candidate.name}, promises to take "
            f"{best.drop * ranked.square:.3g} from the sum of squares, and chance and what that mesh leaves let it "
            f"take {ranked.allowed(best):.3g}: of a hundred tests in which nothing is missing, one has an effect that "
            "takes more.",
        )
    nearest = min(ranked.hypotheses, key=lambda one: one.cost)
    fall = max(0.0, seen.baseline.fit.cost - nearest.fit.cost)
    return (
        f"The best of the catalogue, {nearest.name}, would take {fall:.3g} from −2 ln L, and chance lets it take "
        f"{ranked.chance(nearest.name):.3g}: of a hundred tests in which nothing is missing, one has an effect that "
        "takes more.",
    )


def _still_rigid(final: State) -> set[str]:
    """Stiffnesses of a held edge that yields otherwise: these may be as large as they can."""
    values = dict(zip(final.fit.model.names, final.fit.theta.tolist(), strict=True))
    return {
        name
        for naming in final.named
        if naming.hypothesis.candidate.replaces
        for key, neutral in naming.hypothesis.candidate.neutral.items()
        if values.get(name := f"{naming.hypothesis.label}.{key}", 0.0) > SETTINGS.trials.softer * neutral
    }
