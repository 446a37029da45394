"""From a fitted model that does not explain a measurement to the field that does so best, and of which kind it is.

A fifth of the FRFs is put aside. All kinds begin with the smoothed spectra of the others. Then they take sharp steps, all
in the same weighing of residuals, and the better half goes on. How probable a kind is follows from how well the place
where it came nearest predicts the FRFs put aside, at each wide level and sharply:

    −2 ln p = n_eff · mean over the levels of ln(mean square of what is left of them),

n_eff the numbers that what is left is worth: all where it is noise, and no more than frequencies, dampings and
deflections of the modes where it is the model's own error. Sharply alone a field that catches a few peaks and moves all
others beats one that moves all of them nearer. The best kind takes its last steps with all FRFs.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchplate.diagnosis.before_and_after import at_all_lines
from torchplate.diagnosis.field.descent import FieldDescent, Place, inflated, part_left, thinned
from torchplate.diagnosis.field.field_model import FieldModel
from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.field.told import as_found, no_field
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.result import Diagnosis, FoundField
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import as_it_is_meant
from torchplate.effects import KINDS
from torchplate.model import PlateModel
from torchplate.notation import percent


class Inferred(NamedTuple):
    """A field, and the model with it and with numbers fitted beside it, all of them known."""

    found: FoundField
    model: PlateModel


class NoField(NamedTuple):
    """Why a field that predicts FRFs left out is not told, in a sentence."""

    sentence: str


class _Kind(NamedTuple):
    """One kind of field, and where its descent is."""

    descent: FieldDescent
    place: Place

    @property
    def error(self) -> float:
        """Mean square of what is left of FRFs that were left out."""
        assert self.place.chosen is not None
        return self.place.chosen.error


def with_field(
    diagnosis: Diagnosis, builder: ModelBuilder, fit: Fit, prior: Prior, say: Callable[[str], None]
) -> Diagnosis:
    """A diagnosis that leaves something unexplained, with the field that is missing; its verdict and names stay.

    Args:
        diagnosis: what was found so far.
        builder: makes and evaluates models beside the evidence.
        fit: of the last model.
        prior: what is known of its parameters beforehand.
        say: is told what is being tried.
    """
    began = time.monotonic()
    inferred = infer_field(builder, fit, prior, say)
    seconds, n_evaluation = diagnosis.seconds + time.monotonic() - began, builder.n_evaluation
    if inferred is None or isinstance(inferred, NoField):
        little = "No field of stiffness, mass, loss or support takes off more than a little of what is left."
        more = little if inferred is None else inferred.sentence
        return replace(diagnosis, missing=(*diagnosis.missing, more), seconds=seconds, n_evaluation=n_evaluation)
    found, model = inferred
    return replace(diagnosis, field=found, model=model, seconds=seconds, n_evaluation=n_evaluation)


@torch.no_grad()
def infer_field(builder: ModelBuilder, fit: Fit, prior: Prior, say: Callable[[str], None]) -> Inferred | NoField | None:
    """The field that is missing in a model; None where none helps, and why where it does so only in part.

    Args:
        builder: makes and evaluates models beside the evidence.
        fit: of the model.
        prior: what is known of its parameters beforehand.
        say: is told what is being tried.
    """
    settings, whole = builder.target.settings.inferring, builder.target
    target = thinned(whole, settings.most_numbers, settings.least_lines)
    beside = builder.against(target)
    grid = Grid.of(fit.model.mesh, settings)
    say(f"a field without a name: {', '.join(KINDS)} at {grid.n_x} × {grid.n_y} nodes")
    alive = {kind: _begun(FieldDescent(FieldModel(beside, fit, kind, grid), prior), fit) for kind in KINDS}
    behind: dict[str, float] = {}
    parts: list[float] = []
    for step in range(settings.n_sharp):
        part = min(part_left(target, one.descent.left(one.place)) for one in alive.values())
        parts.append(part)
        alive = {kind: one._replace(place=one.descent.sharply(one.place, part)) for kind, one in alive.items()}
        best = min(one.error for one in alive.values())
        behind |= {kind: one.error / best for kind, one in alive.items()}
        if step + 1 == settings.n_all:
            kept = sorted(behind, key=behind.__getitem__)[: (len(KINDS) + 1) // 2]
            alive = {kind: one for kind, one in alive.items() if kind in kept}
        if step > settings.n_all + settings.patience and part > settings.falling * parts[-1 - settings.patience]:
            break
    n_eff = _worth(target, part)
    kind = min(alive, key=lambda kind: alive[kind].error)
    one, others = _among_images(alive[kind], part, n_eff)
    chosen = one.place.chosen
    assert chosen is not None
    say(f"  {kind}: {percent(1 - chosen.error / chosen.without)} less is left of FRFs that were left out")
    if chosen.error > (1 - settings.helps) * chosen.without:
        return None
    return _told(builder, fit, one, others, _probability(behind, n_eff), n_few=int(target.fitted.sum()))


def _begun(descent: FieldDescent, fit: Fit) -> _Kind:
    """Where the wide levels lead, from none and from the best single values, if any comes nearer than the start."""
    model = descent.model
    position = model.base.space.to_cube(fit.theta).clamp(0.0, 1.0)
    start = Place(position, fit.theta.new_zeros(len(model.effect.parameters)), fit.about)
    from_none = start._replace(about=None)
    places = [start, *(descent.widely(one) for one in (from_none, *descent.bumps(from_none)))]
    parts = [part_left(descent.target, descent.left(one)) for one in places]
    there = places[parts.index(min(parts))]
    if there is not start:
        model.rebased(model.base.space.to_si(there.position), there.values)
    return _Kind(descent, there)


def _worth(target: FrfTarget, part: float) -> float:
    """Independent numbers that what is left is worth."""
    twin = inflated(target, part)
    n = 2.0 * len(target.frequency) * int(target.fitted.sum())
    own = (target.variance / twin.variance)[:, target.fitted].mean()
    n = 1 / (1 / n + target.settings.comparison.misspecified)
    return 1 / (float(own) / n + (1 - float(own)) / min(n, target.n_modal))


def _probability(behind: Mapping[str, float], n_eff: float) -> dict[str, float]:
    """Of each kind, from how many times the least error it leaves."""
    weight = {kind: math.exp(max(-700.0, -0.5 * n_eff * math.log(ratio))) for kind, ratio in behind.items()}
    total = sum(weight.values())
    return {kind: one / total for kind, one in weight.items()}


def _misfit(one: _Kind, part: float) -> float:
    """Mean square of what is left, in a weighing."""
    target = one.descent.target
    square = one.descent.left(one.place).abs().square() / inflated(target, part).variance
    return float(square[:, target.fitted].mean()) / 2


def _among_images(one: _Kind, part: float, n_eff: float) -> tuple[_Kind, list[Tensor]]:
    """The best of a field and its mirror images, and the values of those that are as good."""
    descent, settings = one.descent, one.descent.settings
    near = 2 * math.log(settings.twin)
    found, misfit = [one], [_misfit(one, part)]
    for values in descent.model.grid.images(one.place.values):
        image = one._replace(place=one.place._replace(values=values))
        # What is far off before it is fitted will not come back in one step.
        if _misfit(image, part) > 4 * misfit[0]:
            continue
        image = image._replace(place=descent.sharply(image.place, part))
        found.append(image)
        misfit.append(_misfit(image, part))
    first = misfit.index(min(misfit))
    grid = descent.model.grid
    middle = grid.centre(found[first].place.values)[0]
    others = [
        image.place.values
        for image, left in zip(found, misfit, strict=True)
        if n_eff * math.log(left / misfit[first]) < near
        and float((grid.centre(image.place.values)[0] - middle).abs().max()) > 0.5 / (max(grid.n_x, grid.n_y) - 1)
    ]
    return found[first], others


def _told(
    builder: ModelBuilder, fit: Fit, one: _Kind, others: list[Tensor], probability: Mapping[str, float], n_few: int
) -> Inferred | NoField | None:
    """The field on all lines, if it helps there too."""
    model, place, target = one.descent.model, one.place, builder.target
    theta = model.base.space.to_si(place.position)
    model.rebased(theta, place.values)
    every = model.joined(theta, place.values)
    whole = target.at_all_lines
    predictions = at_all_lines(target, fit), whole.predict(as_it_is_meant(model.reduced), every)
    gaps: list[float | None] = []
    for heldout in (False, True):
        for read in predictions:
            gap = float(whole.gap(read, heldout))
            gaps.append(None if math.isnan(gap) else gap)
    before, after = (gaps[2], gaps[3]) if gaps[2] is not None else (gaps[0], gaps[1])
    if before is None or after is None:
        return None
    assert place.chosen is not None
    if after > (1 - target.settings.inferring.helps) * before:
        return NoField(no_field(model.kind, 1 - place.chosen.error / place.chosen.without, before, after))
    found = as_found(model, place, others, probability, gaps, target, n_few)
    known = builder.finished(model.whole, every)
    own = {name: value for name, value in known.known_values.items() if not name.startswith(f"{model.label}.")}
    return Inferred(
        found, known.replaced(effects={**known.effects, model.label: model.as_known(place.values)}, known=own)
    )
