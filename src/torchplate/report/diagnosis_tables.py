"""Tables of a diagnosis: the gap, the effects, the steps, the FRFs, what was considered."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from torchplate.diagnosis import FIRST_REFIT, Diagnosis, Location, Named, Overlay, Scored, frac_by_channel
from torchplate.effects import CATALOGUE
from torchplate.notation import drop, percent
from torchplate.report.blocks.document import Block, Heading, Paragraph, Table
from torchplate.report.blocks.numbers import confidence, digits, interval, quantity, with_unit
from torchplate.report.figures.plate_map import place_found

KINDS = {
    "force": "a force at one place, free at every line",
    "place": "the best spring, dashpot and mass at one place",
    "stiffness": "a force that does not depend on frequency, as of a spring",
    "damping": "a force in proportion to frequency, as of a dashpot",
    "mass": "a force in proportion to the square of frequency, as of a mass",
    "sensor chain": "one gain and delay for all channels",
    "single channel": "a factor for one channel",
}
"""Of `Location.kind`, in words."""
N_CHANNEL = 24
"""FRFs that are listed; all are in diagnosis.json."""


def gap_table(diagnosis: Diagnosis) -> Table:
    """The gap before and after, of the FRFs that a fit saw and of the others."""
    gap = diagnosis.gap
    alone = [gap.noise_floor] if gap.expected is None else [gap.noise_floor, gap.expected]
    rows = [("fitted", percent(gap.baseline), percent(gap.final), *map(percent, alone))]
    if gap.heldout_baseline is not None or gap.heldout_final is not None:
        unseen = percent(gap.heldout_baseline), percent(gap.heldout_final)
        rows.append(("held out, seen by no fit", *unseen, *[""] * len(alone)))
    caption = "Gap: mean over the FRFs of ‖measured − model‖ / ‖measured‖."
    return Table(
        caption, ("FRFs", "before>", "after>", "noise alone>", "noise and imperfections>")[: 3 + len(alone)], rows
    )


def effects(diagnosis: Diagnosis) -> Table:
    """What was found missing."""
    rows = []
    for effect in diagnosis.effects:
        name = f"`{effect.name}`" + (f"\nas `{effect.label}`" if effect.label != effect.name else "")
        options = [f"{key} {_plain(value)}" for key, value in effect.options.items() if value not in (None, (), [])]
        found = [f"{key} {quantity(one)}" for key, one in effect.parameters.items()]
        rows.append(
            (
                "\n".join([name, *options]),
                "\n".join(f"`{twin}`" for twin in effect.equivalent) or "none",
                confidence(effect.confidence),
                "\n".join([*found, *_in_metres(effect, diagnosis)]) or "no number",
                percent(effect.gap_before),
                percent(effect.gap_after),
            )
        )
    head = ("effect", "cannot be told from", "confidence>", "found, ± standard error", "gap before>", "gap after>")
    caption = (
        "Effects that were missing, in the order in which they were found. Gaps are of the model with all effects up "
        "to there, fitted together; the last is that of the last model."
    )
    return Table(caption, head, rows)


def _in_metres(effect: Named, diagnosis: Diagnosis) -> list[str]:
    """Where a ruler finds the place."""
    if (place := place_found(effect)) is None:
        return []
    mesh = diagnosis.model.mesh
    x, y = (1e3 * side * one.value for side, one in zip((mesh.length_x, mesh.length_y), place, strict=True))
    return [f"(at {x:.4g} mm, {y:.4g} mm)"]


def steps(diagnosis: Diagnosis) -> Iterator[Block]:
    """The gap after each step."""
    if not diagnosis.steps:
        return
    heldout = any(step.heldout is not None for step in diagnosis.steps)
    rows = [
        (step.label, percent(step.gap), *([percent(step.heldout)] if heldout else []), f"{step.misfit:.4g}")
        for step in diagnosis.steps
    ]
    caption = (
        "The gap after each step, of all that is in the model by then, fitted together. Misfit: mean square of the "
        "residuals over their noise; 1 where nothing but noise is left."
    )
    yield Table(caption, ("step", "gap, fitted>", *(["gap, held out>"] if heldout else []), "misfit>"), rows)


def channels(diagnosis: Diagnosis, overlay: Overlay) -> Iterator[Block]:
    """The gap of each FRF, the worst first."""
    every = sorted(diagnosis.location.channels, key=lambda one: -one.before)
    if not every:
        return
    frac = _fracs(overlay)
    rows = [
        (f"{one.response}/{one.reference}", percent(one.before), percent(one.after), percent(one.floor),
         *frac.get((one.response, one.reference), ("", "")), "held out" if one.heldout else "fitted")
        for one in every[:N_CHANNEL]
    ]  # fmt: skip
    gaps, fracs = ("gap before>", "gap after>", "noise alone>"), ("FRAC before>", "FRAC after>")
    caption = (
        "Gap of each FRF, the worst first. FRAC: correlation of measured and modelled FRF over the lines; 1 where its "
        "course is right."
    )
    yield Table(caption, ("FRF, response/reference", *gaps, *fracs, "role in the fit"), rows)
    if len(every) > N_CHANNEL:
        yield Paragraph(f"And {len(every) - N_CHANNEL} FRFs that were nearer; `diagnosis.json` has all.")


def _fracs(overlay: Overlay) -> dict[tuple[str, str], tuple[str, str]]:
    """FRAC before and after of each measured FRF, by the labels of its channels."""
    measured = overlay.measured
    before, after = (frac_by_channel(measured, frf) for frf in (overlay.before, overlay.after))
    return {
        (measured.response[j].label, measured.reference[k].label): (f"{before[j, k]:.3f}", f"{after[j, k]:.3f}")
        for j, k in measured.pairs
    }


def considered(diagnosis: Diagnosis) -> Iterator[Block]:
    """The score table of the first step, and what was rejected in later ones."""
    if not any(diagnosis.scores):
        return
    yield Heading("What was considered, and rejected")
    if diagnosis.scores[0]:
        caption = (
            "Each effect of the catalogue at its best place, before any refit. Expected drop: the part of the squared "
            "misfit of the baseline that it would take away, less what the fitted parameters can do themselves; none "
            "where it would add to it. " + FIRST_REFIT + " Tables of later steps are in `diagnosis.json`."
        )
        table = _ranked(diagnosis.scores[0])
        yield Table(
            caption,
            ("effect", "expected drop>", "it would be", "parallel to", "gap at first refit>", "what became of it"),
            [_scored(row) for row in table],
            frozenset(index for index, row in enumerate(table) if row.remark.startswith("named")),
        )
    later = [
        (f"`{row.name}`{_of(row.options)}", str(step), drop(row.expected_drop), percent(row.gap), row.remark)
        for step, table in enumerate(diagnosis.scores[1:], start=2)
        for row in _ranked(table)
        if row.remark.startswith("rejected")
    ]
    if later:
        caption = f"Rejected in later steps, beside the effects that were in the model by then. {FIRST_REFIT}"
        yield Table(caption, ("effect", "step>", "expected drop>", "gap at first refit>", "what became of it"), later)


def parameters(diagnosis: Diagnosis) -> Table:
    """The fitted parameters of the last model."""
    caption = "Parameters of the last model. Their errors are from noise alone, not from what the model lacks."
    rows = [
        (
            f"`{name}`",
            digits(one.value, one.std),
            "not seen" if one.std is None else f"{one.std:.2g}",
            interval(one.low, one.high, one.std) or "not seen",
            one.unit,
        )
        for name, one in diagnosis.parameters.items()
    ]
    return Table(caption, ("parameter", "value>", "standard error>", "90 % interval>", "unit"), rows)


def bands(location: Location) -> Table:
    """Where in frequency the misfit sits."""
    rows = [(f"{band.low:.4g} to {band.high:.4g}", percent(band.share)) for band in location.bands]
    return Table("Bands that hold most of the squared misfit before.", ("band [Hz]", "share of misfit>"), rows)


def kinds(location: Location) -> Table:
    """What one change of each kind would explain."""
    ranked = sorted(location.kind.items(), key=lambda item: -item[1])
    rows = [(kind, KINDS.get(kind, ""), percent(part)) for kind, part in ranked]
    caption = "What one thing of each kind, at its best place, would explain of the misfit before."
    return Table(caption, ("of what kind", "what that is", "explains>"), rows)


def _ranked(table: Sequence[Scored]) -> list[Scored]:
    return sorted(table, key=lambda row: -row.expected_drop)


def _scored(row: Scored) -> tuple[str, ...]:
    found = CATALOGUE.get(row.name)
    units = {} if found is None else {name: one.unit for name, one in found.parameters.items()}
    change = [f"{name} {value:.4g}{with_unit(units.get(name, '-'))}" for name, value in row.expected_change.items()]
    twins = "\n".join(f"`{twin}`" for twin in row.twins)
    return (
        f"`{row.name}`{_of(row.options)}",
        drop(row.expected_drop),
        "\n".join(change),
        twins,
        percent(row.gap),
        row.remark,
    )


def _of(options: Mapping[str, Any]) -> str:
    parts = [f"{key} {_plain(value)}" for key, value in options.items() if value not in (None, (), [])]
    return f", {', '.join(parts)}" if parts else ""


def _plain(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "any", True: "yes", False: "no"}[value]
    return "[" + ", ".join(map(_plain, value)) + "]" if isinstance(value, list | tuple) else _told(value)


def _told(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else f"{value}"
