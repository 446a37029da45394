"""From a fitted model that does not explain a measurement to the field that does so best, and of which kind it is.

A fifth of the FRFs is put aside. All kinds begin with the smoothed spectra of the others. Then they take a few sharp
steps, all in the same weighing of residuals. How probable a kind is follows from how well the place where it came
nearest predicts the FRFs put aside, at each wide level and sharply:

    −2 ln p = n_eff · mean over the levels of ln(mean square of what is left of them),

n_eff the numbers that what is left is worth: all where it is noise, and no more than frequencies, dampings and
deflections of the modes where it is the model's own error. Sharply alone a field that catches a few peaks and moves all
others beats one that moves all of them nearer. The best kind begins anew with all FRFs, and goes to its end.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchplate.diagnosis.before_and_after import at_all_lines
from torchplate.diagnosis.field.aside import Aside, put_aside, worth
from torchplate.diagnosis.field.descent import FieldDescent, Place, inflated, part_left, thinned
from torchplate.diagnosis.field.field_model import FieldModel
from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.field.one_force import OneForce, one_force, with_one_force
from torchplate.diagnosis.field.told import as_found, as_one_force, no_field
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
    """One kind of field, where its descent is, and where it came nearest to the FRFs put aside.

    Attributes:
        descent: of this kind.
        place: where it is.
        nearest: where it came nearest.
        log_left: what is left there, see `Aside.log_left`.
    """

    descent: FieldDescent
    place: Place
    nearest: Place
    log_left: float

    def after(self, place: Place, aside: Aside) -> "_Kind":
        """The same, gone on to a place."""
        log_left = aside.log_left(self.descent, place)
        if log_left < self.log_left:
            return _Kind(self.descent, place, place, log_left)
        return self._replace(place=place)


def with_field(
    diagnosis: Diagnosis,
    builder: ModelBuilder,
    fit: Fit,
    prior: Prior,
    say: Callable[[str], None],
    force: OneForce | None = None,
) -> Diagnosis:
    """A diagnosis that leaves something unexplained, with the field that is missing; its verdict and names stay.

    Args:
        diagnosis: what was found so far.
        builder: makes and evaluates models beside the evidence.
        fit: of the last model.
        prior: what is known of its parameters beforehand.
        say: is told what is being tried.
        force: that is known to account for all of it.
    """
    began = time.monotonic()
    inferred = infer_field(builder, fit, prior, say, force)
    seconds, n_evaluation = diagnosis.seconds + time.monotonic() - began, builder.n_evaluation
    if inferred is None or isinstance(inferred, NoField):
        little = "No field of stiffness, mass, loss or support takes off more than a little of what is left."
        more = little if inferred is None else inferred.sentence
        return replace(diagnosis, missing=(*diagnosis.missing, more), seconds=seconds, n_evaluation=n_evaluation)
    found, model = inferred
    return replace(diagnosis, field=found, model=model, seconds=seconds, n_evaluation=n_evaluation)


@torch.no_grad()
def infer_field(
    builder: ModelBuilder, fit: Fit, prior: Prior, say: Callable[[str], None], force: OneForce | None = None
) -> Inferred | NoField | None:
    """The field that is missing in a model; None where none helps, and why where it does so only in part.

    Args:
        builder: makes and evaluates models beside the evidence.
        fit: of the model.
        prior: what is known of its parameters beforehand.
        say: is told what is being tried.
        force: that is known to account for all of it.
    """
    if force is not None:
        return _of_one_force(builder, fit, force)
    settings = builder.target.settings.inferring
    every = thinned(builder.target, settings.most_numbers, settings.least_lines)
    target, apart = put_aside(every)
    grid = Grid.of(fit.model.mesh, settings)
    say(f"a field without a name: {', '.join(KINDS)} at {grid.n_x} × {grid.n_y} nodes")

    def descent(kind: str, seen: FrfTarget) -> FieldDescent:
        return FieldDescent(FieldModel(builder.against(seen), fit, kind, grid), prior)

    descents = [descent(kind, target) for kind in KINDS]
    start = descents[0].start(fit)
    aside = Aside(every.holding_out(~apart), part_left(target, descents[0].left(start)))
    without = aside.log_left(descents[0], start)
    kinds = [_begun(one, one.start(fit), aside) for one in descents]
    for _ in range(settings.n_all):
        part = min(part_left(target, one.descent.left(one.place)) for one in kinds)
        kinds = [one.after(one.descent.sharply(one.place, part), aside) for one in kinds]
    nearest = min(kinds, key=lambda one: one.log_left)
    kind, less = nearest.descent.model.kind, 1 - math.exp(nearest.log_left - without)
    say(f"  {kind}: {percent(less)} less is left of FRFs that were put aside, smoothed and sharp")
    if less < settings.helps:
        return None
    probability = _probability(
        {one.descent.model.kind: one.log_left for one in kinds},
        worth(aside.target, inflated(aside.target, part).variance),
    )
    one, others = _among_images(*_to_its_end(descent(kind, every), fit))
    return _told(builder, fit, one, others, probability, less, (int(every.fitted.sum()), int(apart.sum())))


def force_alone(builder: ModelBuilder, fit: Fit, prior: Prior, say: Callable[[str], None]) -> OneForce | None:
    """The force at one place that accounts for all that a model leaves: then nothing else is to be named beside it.

    Args:
        builder: makes and evaluates models beside the evidence.
        fit: of the model.
        prior: what is known of its parameters beforehand.
        say: is told what is being tried.
    """
    settings = builder.target.settings.inferring
    every = thinned(builder.target, settings.most_numbers, settings.least_lines)
    say("a force at one place, of whatever law")
    force = one_force(builder.against(every), fit, prior, put_aside(every)[1], Grid.of(fit.model.mesh, settings))
    if force is not None:
        say(f"  of FRFs put aside it leaves {force.left:.2g} times the variance of noise, of {force.without:.3g} times")
    return force


def _of_one_force(builder: ModelBuilder, fit: Fit, force: OneForce) -> Inferred:
    """What is attached at one place, on all lines."""
    gaps = _gaps(builder.target, at_all_lines(builder.target, fit), with_one_force(builder, fit, force))
    grid = Grid.of(fit.model.mesh, builder.target.settings.inferring)
    return Inferred(as_one_force(force, grid, gaps), builder.finished(force.model, force.theta))


def _gaps(target: FrfTarget, before: Tensor, after: Tensor) -> list[float | None]:
    """Of the fitted FRFs before and after, and of those held out; None where there are none."""
    whole = target.at_all_lines
    gaps = [float(whole.gap(read, heldout)) for heldout in (False, True) for read in (before, after)]
    return [None if math.isnan(gap) else gap for gap in gaps]


def _begun(descent: FieldDescent, start: Place, aside: Aside) -> _Kind:
    """Where the wide levels lead, from none and from the best single values, if any comes nearer than the start."""
    from_none = start._replace(about=None)
    places = [start, *(descent.widely(one) for one in (from_none, *descent.bumps(from_none)))]
    left = []
    for place in places:
        # The modes of the plate without a field do not hold what a large value alone does.
        descent.rebased(place)
        left.append(aside.log_left(descent, place))
    there = places[left.index(min(left))]
    descent.rebased(there)
    return _Kind(descent, there, there, min(left))


def _to_its_end(descent: FieldDescent, fit: Fit) -> tuple[_Kind, Aside]:
    """A kind with all FRFs: where its sharp steps end, and what it is judged by there."""
    settings, start = descent.settings, descent.start(fit)
    parts = [part_left(descent.target, descent.left(start))]
    place = _begun(descent, start, Aside(descent.target, parts[0])).place
    for step in range(settings.n_sharp):
        parts.append(part_left(descent.target, descent.left(place)))
        place = descent.sharply(place, parts[-1])
        if step > settings.patience and parts[-1] > settings.falling * parts[-1 - settings.patience]:
            break
    aside = Aside(descent.target, parts[-1])
    return _Kind(descent, place, place, aside.log_left(descent, place)), aside


def _probability(log_left: Mapping[str, float], n_eff: float) -> dict[str, float]:
    """Of each kind, from what it leaves."""
    least = min(log_left.values())
    weight = {kind: math.exp(max(-700.0, -0.5 * n_eff * (one - least))) for kind, one in log_left.items()}
    total = sum(weight.values())
    return {kind: one / total for kind, one in weight.items()}


def _among_images(one: _Kind, aside: Aside) -> tuple[_Kind, list[Tensor]]:
    """The best of a field and its mirror images, and the centres of those that are as good."""
    descent, settings = one.descent, one.descent.settings
    near = 2 * math.log(settings.twin) / worth(aside.target, inflated(aside.target, aside.part).variance)
    found = [one]
    grid, nearest = descent.model.grid, one.nearest
    seen = [None] * 7 if nearest.seen is None else grid.images(nearest.seen)
    for values, felt in zip(grid.images(nearest.values), seen, strict=False):
        place = nearest._replace(values=values, seen=felt)
        image = _Kind(descent, place, place, aside.log_left(descent, place))
        # What is far off before it is fitted will not come back in one step.
        if image.log_left > one.log_left + math.log(4):
            continue
        found.append(image.after(descent.sharply(place, part_left(descent.target, descent.left(place))), aside))
    first = min(found, key=lambda image: image.log_left)
    middle = grid.centre(first.nearest.values, first.nearest.seen)[0]
    centres = [
        grid.centre(image.nearest.values, image.nearest.seen)[0]
        for image in found
        if image.log_left - first.log_left < near
    ]
    least = 0.5 / (max(grid.n_x, grid.n_y) - 1)
    others = [centre for centre in centres if float((centre - middle).abs().max()) > least]
    return first, others


def _told(
    builder: ModelBuilder,
    fit: Fit,
    one: _Kind,
    others: list[Tensor],
    probability: Mapping[str, float],
    less: float,
    n_frf: tuple[int, int],
) -> Inferred | NoField | None:
    """The field on all lines, if it helps there too."""
    model, place, target = one.descent.model, one.nearest, builder.target
    theta = model.base.space.to_si(place.position)
    model.rebased(theta, place.values)
    every = model.joined(theta, place.values)
    whole = target.at_all_lines
    gaps = _gaps(target, at_all_lines(target, fit), whole.predict(as_it_is_meant(model.reduced), every))
    before, after = (gaps[2], gaps[3]) if gaps[2] is not None else (gaps[0], gaps[1])
    if before is None or after is None:
        return None
    settings = target.settings.inferring
    if after > (before if before > settings.saturated else (1 - settings.helps) * before):
        return NoField(no_field(model.kind, less, before, after))
    found = as_found(model, place, others, probability, gaps, target, less, n_frf)
    known = builder.finished(model.whole, every)
    own = {name: value for name, value in known.known_values.items() if not name.startswith(f"{model.label}.")}
    return Inferred(
        found, known.replaced(effects={**known.effects, model.label: model.as_known(place.values)}, known=own)
    )
