"""What was found of a field, in words and numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import torch
from torch import Tensor

from torchplate.diagnosis.field.descent import Place
from torchplate.diagnosis.field.field_model import FieldModel
from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.field.one_force import OneForce
from torchplate.diagnosis.result import ONE_FORCE, FoundField
from torchplate.diagnosis.target import FrfTarget
from torchplate.effects import DIRECTIONS
from torchplate.notation import percent

WORDS: Final = {
    "stiffness": "bending stiffness",
    "mass": "mass",
    "loss": "loss",
    "support": "a force from outside, as of springs to the ground",
}


def as_found(
    model: FieldModel,
    place: Place,
    others: Sequence[Tensor],
    probability: Mapping[str, float],
    gaps: Sequence[float | None],
    target: FrfTarget,
    less: float,
    n_frf: tuple[int, int],
) -> FoundField:
    """The field as it is reported.

    Args:
        model: with it.
        place: where its descent ended.
        others: centres of mirror images that are as good.
        probability: of each kind.
        gaps: fitted before and after, held out before and after.
        target: what it was held against.
        less: part that it takes off what is left of FRFs put aside, smoothed and sharp [-].
        n_frf: that it was fitted to, and those of them that chose its kind.
    """
    grid, values = model.grid, place.values
    middle, spread = grid.centre(values, place.seen)
    total, unit = _total(model, values)
    # A place at the end of the wide levels has their prior.
    form, strength = ("smooth", model.unit) if place.chosen is None else (place.chosen.form, place.chosen.std)
    found = FoundField(
        model.kind, _pair(middle), _pair(spread), tuple(map(_pair, others)), total, unit,
        grid.n_x, grid.n_y, tuple(values.tolist()), form, strength,
        {kind: round(one, 4) for kind, one in probability.items()},
        gaps[0] or 0.0, gaps[1] or 0.0, gaps[2], gaps[3],
    )  # fmt: skip
    directions = DIRECTIONS if model.effect.directional else ()
    return replace(found, directions=directions, sentences=tuple(_sentences(found, n_frf, less, target)))


def as_one_force(force: OneForce, grid: Grid, gaps: Sequence[float | None]) -> FoundField:
    """A force at one place as it is reported: what its map shows is the part of the misfit that it would explain.

    Args:
        force: at its place.
        grid: nodes of its map.
        gaps: fitted before and after, held out before and after.
    """
    place = _pair(force.place)
    found = FoundField(
        "support", place, force.std, force.others, force.size, "N/N", grid.n_x, grid.n_y, force.map, ONE_FORCE, 0.0,
        {"support": 1.0}, gaps[0] or 0.0, gaps[1] or 0.0, gaps[2], gaps[3],
    )  # fmt: skip
    x, y = (f"{one:.3f} ± {std:.1g}" for one, std in zip(place, force.std, strict=True))
    before, after = _gaps_of(found)
    hits = "alike in all hits" if force.alike else "for each hit"
    said = [
        f"Something is attached at x {x}, y {y} of the sides that no effect of the catalogue describes: with a force "
        f"there, free at each line and {hits} ({force.size:.2g} N for each N of a hit), the gap of the "
        f"{_which(found)} goes from {percent(before)} to {percent(after)}, and of FRFs put aside noise is left: "
        f"{force.left:.2g} times its variance, and not {force.without:.3g} times. This is no name.",
        "No spring, dashpot, mass or absorber there does so. Its law is the same in all hits: it is linear, as a cord, "
        "a cable or a device with dynamics of its own. Look there, and take it off."
        if force.alike
        else "No spring, dashpot or mass there does so. Its law may depend on how far the plate moves: look for a "
        "contact that rattles, a spring that hardens or a cable that rubs, and measure again with softer and with "
        "harder hits.",
    ]
    if found.others:
        said.append(_alike(found))
    return replace(found, sentences=tuple(said))


def _which(found: FoundField) -> str:
    """FRFs whose gap is told."""
    return "fitted FRFs" if found.heldout_before is None else "FRFs that no fit saw"


def _gaps_of(found: FoundField) -> tuple[float, float]:
    """The gap that is told, before and after."""
    if found.heldout_before is None or found.heldout_after is None:
        return found.gap_before, found.gap_after
    return found.heldout_before, found.heldout_after


def _alike(found: FoundField) -> str:
    """Places that are as good."""
    places = " or ".join(f"x {x:.2f}, y {y:.2f}" for x, y in found.others)
    return f"By the symmetry of the plate it may as well sit at {places}."


def no_field(kind: str, part: float, before: float, after: float) -> str:
    """Why a field that predicts FRFs put aside is none: it does not take off their gap what it takes off their misfit.

    Args:
        kind: of the best one.
        part: that it takes off what is left of FRFs put aside, smoothed and sharp [-].
        before: the gap of FRFs that no fit saw, or of the fitted ones where there are none.
        after: likewise with it.
    """
    return (
        f"A field of {WORDS[kind]} would take {percent(part)} off what is left of FRFs put aside, smoothed and sharp, "
        f"where troughs count like peaks, and leaves the gap at {percent(after)} where it is {percent(before)}: too "
        "little to be shown."
    )


def _pair(place: Tensor) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def _total(model: FieldModel, values: Tensor) -> tuple[float, str]:
    """Of a mass and of springs their sum, else the mean over the plate."""
    if model.kind == "support":
        return float(values.sum()), "N/m"
    mean = float((model.grid.parts(values) @ model.grid.area).mean())
    if model.kind != "mass":
        return mean, "-"
    plan = model.base.plan(model.base.space.to_si(torch.full((len(model.base.names),), 0.5).to(values)))
    area = float((plan.geometry.length_x * plan.geometry.length_y).mean())
    return mean * float(plan.section.areal_mass.mean()) * area, "kg"


def _sentences(found: FoundField, n_frf: tuple[int, int], less: float, target: FrfTarget) -> list[str]:
    """Kind and place, what it takes off the gap, and what these data do not tell."""
    size = (
        f"{found.total:+.3g} {found.unit} in all"
        if found.unit != "-"
        else f"{percent(found.total, signed=True)} on the mean over the plate"
    )
    where = f"its weight sits at x {found.place[0]:.2f}, y {found.place[1]:.2f} of the sides"
    wide = [axis for axis, one in zip("xy", found.spread, strict=True) if one > target.settings.inferring.wide]
    if wide:
        where += f" and is spread along {' and '.join(wide)}: there it has no one place"
    before, after = _gaps_of(found)
    said = [
        f"What is missing acts as {WORDS[found.kind]} ({size}); {where}. It takes the gap of the {_which(found)} from "
        f"{percent(before)} to {percent(after)}, and {percent(less)} off what was left of FRFs put aside, smoothed and "
        "sharp. This is no name."
    ]
    rivals = [
        f"{WORDS[kind]} ({one:.2f})"
        for kind, one in sorted(found.probability.items(), key=lambda item: -item[1])
        if kind != found.kind and one > 1 - target.settings.comparison.credible
    ]
    if rivals:
        own = found.probability[found.kind]
        said.append(f"These data do not tell it ({own:.2f}) for sure from {' or '.join(rivals)}.")
    if found.others:
        said.append(_alike(found))
    n, n_aside = n_frf
    if n < target.settings.holding_out.few:
        said.append(
            f"{n} FRF{'s' if n > 1 else ''} cannot tell a place from its mirror images, nor a mass from a lost "
            "stiffness that moves the same modes: take the map as one of several. Measure more points."
        )
    elif n_aside < target.settings.holding_out.few:
        said.append(
            f"Its kind was chosen by {n_aside} FRF{'s' if n_aside > 1 else ''} put aside: take it as a guess, however "
            "probable. Measure more points."
        )
    return said
