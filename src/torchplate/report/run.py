"""The report of a run: the fit in words, what was found, how the search went, and the FRFs."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import torch
from matplotlib.figure import Figure
from torch import Tensor

from torchplate.discrepancy import Objective
from torchplate.identification import CORRELATED, Result, retaken_told
from torchplate.measurement import Placement
from torchplate.model import PlateModel
from torchplate.notation import percent
from torchplate.report.blocks.channel_names import explained
from torchplate.report.blocks.document import Block, Document, Heading, Listing, Panel, Paragraph, Picture, Table
from torchplate.report.blocks.numbers import digits
from torchplate.report.figures.drawing import png
from torchplate.report.figures.mode_shapes import mode_shapes, modes_caption, modes_of
from torchplate.report.figures.paired_shapes import shapes_of
from torchplate.report.figures.shape_agreement import agreement
from torchplate.report.forms.markdown import markdown
from torchplate.report.forms.page import page
from torchplate.report.run_figures import (
    Convergence,
    convergence,
    convergence_told,
    frf_figure,
    frf_panels,
    natural_frequencies,
    natural_frequencies_told,
    overlay,
    shown,
)

# Of the files beside report.md: they are looked at on a screen.
DPI, N_COLOUR = 90, 64


@torch.no_grad()
def frf_figures(objective: Objective, theta: Tensor, n_panel: int) -> dict[str, Figure]:
    """One overlay for each shown FRF: measured, nominal, updated; by its TensorBoard tag."""
    if objective.evidence.measurement is None:
        return {}
    drawn = overlay(objective, theta)
    return {f"frf/{one.title.replace('/', '_')}": frf_figure(drawn, [one]) for one in shown(objective, n_panel)}


@torch.no_grad()
def run_report(
    name: str,
    objective: Objective,
    result: Result,
    n_panel: int = 4,
    history: Mapping[str, Convergence] | None = None,
    placement: Placement | None = None,
    command: str = "",
) -> dict[str, bytes]:
    """`report.md` with its figures beside it, and `report.html`, which needs no other file.

    Args:
        name: of the config; the title.
        objective: what was minimised.
        result: what was found.
        n_panel: FRFs that are drawn.
        history: of the search, by its name; None where nothing was searched.
        placement: where the channels sit on the plate; None where no FRF was measured.
        command: what made the report, for its last line.

    Returns:
        The content of each file by its name.
    """
    pictures, drawn = _pictures(objective, result, n_panel, history)
    blocks = list(_blocks(objective, result, pictures, placement))
    fit = result.fit or ""
    # The page is coloured as the sentence judges.
    mood = next((word for word in ("close", "partial") if f"fit is {word}" in fit), "poor")
    foot = _foot(result, command)
    # What looks wrong with the FRFs explains the fit.
    first = " ".join([*result.misread, fit])
    told = Document(name, first, mood, _explained(objective, blocks), foot)
    shapes = list(_shapes(objective.model, result, objective))
    whole = Document(name, first, mood, _explained(objective, [*blocks, *shapes]), foot)
    files = {f"{key}.png": png(figure, DPI, N_COLOUR) for key, figure in drawn.items()}
    return files | {"report.md": markdown(told).encode(), "report.html": page(whole).encode()}


@torch.no_grad()
def model_report(name: str, model: PlateModel, result: Result, command: str = "") -> dict[str, bytes]:
    """The same of a model that was compared with nothing: its natural frequencies and mode shapes.

    Args:
        name: of the config; the title.
        model: of the plate, all numbers.
        result: of its evaluation.
        command: what made the report, for its last line.
    """
    first = _listed(result)
    told = Document(name, first, "told", [])
    whole = Document(name, first, "told", list(_shapes(model, result, None)), _foot(result, command))
    return {"report.md": markdown(told).encode(), "report.html": page(whole).encode()}


def _pictures(
    objective: Objective, result: Result, n_panel: int, history: Mapping[str, Convergence] | None
) -> tuple[dict[str, Picture], dict[str, Figure]]:
    """The pictures of the report, and the figures of its files, by name."""
    pictures, drawn = {}, {}
    if objective.evidence.measurement is not None:
        curves, pairs = overlay(objective, result.theta), shown(objective, n_panel)
        drawn["frf"] = frf_figure(curves, pairs)
        text = "FRFs: measured, nominal (the middle of every interval), updated, and what is left."
        if not objective.model.names:
            text = "FRFs: measured, the model's, and what is left."
        pictures["frf"] = Picture("frf", text, frf_panels(curves, pairs))
    if (table := objective.evidence.natural_frequencies) is not None:
        told = natural_frequencies_told(objective, table, result.theta)
        drawn["natural_frequencies"] = natural_frequencies(objective, table, result.theta)
        narrow = partial(natural_frequencies, objective, table, result.theta, narrow=True)
        panels = _either(drawn["natural_frequencies"], narrow, told)
        pictures["natural_frequencies"] = Picture("natural_frequencies", "Natural frequencies, mode by mode.", panels)
    if (modal := objective.evidence.modal_model) is not None:
        for name, (picture, figure) in agreement(shapes_of(modal, objective.model, result.theta)).items():
            pictures[name], drawn[name] = picture, figure
    if history is not None and result.objective_kind is not None:
        told = convergence_told(history, result.objective_kind)
        drawn["convergence"] = convergence(history, result.objective_kind)
        narrow = partial(convergence, history, result.objective_kind, narrow=True)
        panels = _either(drawn["convergence"], narrow, told)
        text = "Convergence: the best objective so far, over evaluations and over generations"
        text += "; of several searches the median and the quartiles." if result.repeats else "."
        pictures["convergence"] = Picture("convergence", text, panels)
    return pictures, drawn


def _either(wide: Figure, narrow: Callable[[], Figure], told: str) -> tuple[Panel, ...]:
    return Panel(lambda: wide, told, "wide"), Panel(narrow, told, "narrow")


def _explained(objective: Objective, blocks: list[Block]) -> list[Block]:
    measurement = objective.evidence.measurement
    return blocks if measurement is None else list(explained(blocks, measurement))


def _blocks(
    objective: Objective, result: Result, pictures: Mapping[str, Picture], placement: Placement | None
) -> Iterator[Block]:
    """What to know first, then every number."""
    assert result.objective is not None
    if caveats := [caveat for caveat in result.caveats if caveat not in result.misread]:
        yield Listing([f"**Note**: {caveat}" for caveat in caveats])
    reached = f"Objective `{result.objective_kind}`: **{result.objective:.6g}**, gap **{percent(result.gap)}**."
    yield Paragraph(f"{reached} {result.status}")
    if result.mesh_error_moved is not None:
        yield Paragraph(retaken_told(result.mesh_error_moved))
    if result.gain is not None:
        yield Paragraph(f"Level of the measurement, fitted: {result.gain:.6g} (reading over SI unit).")
    if result.parameters:
        yield Heading("Parameters")
        yield _parameters(objective, result)
        yield from _correlated(result)
    if "frf" in pictures:
        yield Heading("Measured and fitted FRFs" if objective.model.names else "Measured and modelled FRFs")
        yield pictures["frf"]
    yield Heading("Natural frequencies")
    yield from _frequencies(objective, result)
    if "natural_frequencies" in pictures:
        yield pictures["natural_frequencies"]
    yield Paragraph(_listed(result))
    if "mac" in pictures:
        yield Heading("Measured and modelled mode shapes")
        yield pictures["mac"]
        yield pictures["comac"]
        if "fdac" in pictures:
            yield pictures["fdac"]
    if "convergence" in pictures:
        yield Heading("Convergence")
        yield pictures["convergence"]
    if placement is not None:
        yield Heading("Where the channels sit")
        yield _channels(placement)


def _parameters(objective: Objective, result: Result) -> Table:
    space = objective.model.space
    bound = any(found.at_bound for found in result.parameters.values())
    rows = []
    for index, (name, found) in enumerate(result.parameters.items()):
        std = "not seen" if found.std is None else f"{found.std:.2g}"
        searched = f"{float(space.low[index]):g} to {float(space.high[index]):g}"
        edge = ("on its bound" if found.at_bound else "",) if bound else ()
        rows.append((name, digits(found.value, found.std), std, found.unit, searched, *edge))
    caption = (
        "What was found. Standard errors are from the noise of the measurement alone, not from what the model lacks."
    )
    return Table(
        caption,
        ("parameter", "value>", "standard error>", "unit", "searched interval", *(["remark"] if bound else [])),
        rows,
    )


def _correlated(result: Result) -> Iterator[Block]:
    """The pairs of parameters that the data can hardly tell apart, and what that means."""
    if pairs := result.correlated():
        caption = (
            f"The errors of these parameters go together (|correlation| > {CORRELATED:g}): the data fix a combination "
            "of the two better than either alone."
        )
        rows = [(one, other, f"{value:+.3f}") for one, other, value in pairs]
        yield Table(caption, ("parameter", "parameter", "correlation>"), rows)


def _frequencies(objective: Objective, result: Result) -> Iterator[Block]:
    if result.modes is not None:
        pairs = [
            (
                f"{pair.mode}",
                f"{pair.measured:.2f}",
                f"{pair.model:.2f}",
                percent(pair.model / pair.measured - 1),
                f"{pair.mac:.3f}",
            )
            for pair in result.modes
        ]
        caption = (
            "Measured modes, each beside the model's mode with the most similar shape (MAC: 1 where they are alike, 0 "
            "where they have nothing in common); modes count from 1, rigid-body modes included."
        )
        yield Table(caption, ("mode", "measured [Hz]>", "model [Hz]>", "difference>", "MAC>"), pairs)
    if (table := objective.evidence.natural_frequencies) is None:
        return
    hertzs = objective.natural_frequencies(result.theta).tolist()
    rows = [
        (f"{mode}", f"{measured:g}", f"{hertz:.2f}", percent(hertz / measured - 1))
        for mode, measured, hertz in zip(table.mode.tolist(), table.frequency.tolist(), hertzs, strict=True)
    ]
    caption = "Natural frequencies; modes count from 1, rigid-body modes included."
    yield Table(caption, ("mode", "measured [Hz]>", "model [Hz]>", "difference>"), rows)


def _listed(result: Result) -> str:
    listed = ", ".join(f"{hertz:.2f}" for hertz in result.natural_frequencies_hz)
    return f"Natural frequencies [Hz], undamped, rigid-body modes first: {listed}."


def _channels(placement: Placement) -> Table:
    rows = [
        (
            f"{role} {match.label}",
            f"{match.place[0]:.4f}",
            f"{match.place[1]:.4f}",
            f"{match.nearest_node}",
            f"{1e3 * match.distance:.2f}",
        )
        for role, matches in (("response", placement.response), ("reference", placement.reference))
        for match in matches
    ]
    head = ("channel", "x/Lx>", "y/Ly>", "nearest node>", "distance [mm]>")
    return Table(f"Channels, matched by {placement.by}.", head, rows)


def _shapes(model: PlateModel, result: Result, objective: Objective | None) -> Iterator[Block]:
    modes = modes_of(model, result.theta, None if objective is None else objective.evidence.measurement)
    if modes:
        yield Heading("Mode shapes")
        panels = mode_shapes(modes, (model.mesh.length_x, model.mesh.length_y))
        yield Picture("modes", modes_caption(modes), panels)


def _foot(result: Result, command: str) -> str:
    effort = f"{result.optimizer}, seed {result.seed}, {result.n_evaluation} evaluations in {result.n_generation} "
    made = f" Made by `{command}`." if command else ""
    return f"{effort}generations.{made}" if result.parameters else made.strip()
