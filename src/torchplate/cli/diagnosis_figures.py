"""Figures of a diagnosis: the gap step by step, FRFs before and after, where in frequency, where on the plate.

That of the assurance criteria is in `assurance_figure`.
"""

import io
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch, Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter
from matplotlib.transforms import Bbox
from PIL import Image

from torchplate.cli.assurance_figure import assurance
from torchplate.cli.diagnosis_style import (
    AFTER,
    BAND,
    BEFORE,
    FOUND,
    INDEX,
    INK,
    MEASURED,
    MUTED,
    NOISE,
    curves,
    dress,
)
from torchplate.diagnosis.result import ChannelGap, Diagnosis, Estimate, Named, Overlay, Step
from torchplate.effects import SupportSpring

DPI = 150
N_PANEL = 6
"""FRFs that are drawn."""
MANY_CHANNELS = 40
"""More than these on the map stay without their labels."""
ELLIPSE_95 = math.sqrt(-2 * math.log(0.05))
"""Half axes of the ellipse that holds 95 % of a normal distribution in the plane, in standard deviations."""


def figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """The figures of a report, by file name.

    "gap"; "bands", "frf" and "assurance" where FRFs were measured; "map" where there is a place to show.
    """
    drawn = {"gap": _gap(diagnosis)}
    if (overlay := diagnosis.overlay) is not None:
        drawn["bands"] = _bands(diagnosis, overlay)
        drawn["frf"] = _frf(diagnosis, overlay, shown(diagnosis, N_PANEL))
        drawn["assurance"] = assurance(overlay)
    if diagnosis.location.map is not None or any(map(place_found, diagnosis.effects)):
        drawn["map"] = _map(diagnosis)
    return drawn


def log_figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """The figures that TensorBoard shows, by tag: one for each drawn FRF, the assurance criteria, and the map."""
    drawn = {}
    if (overlay := diagnosis.overlay) is not None:
        for j, k in shown(diagnosis, N_PANEL):
            tag = f"frf/{overlay.measured.response[j].label}_{overlay.measured.reference[k].label}"
            drawn[tag] = _frf(diagnosis, overlay, [(j, k)])
        drawn["assurance"] = assurance(overlay)
    if diagnosis.location.map is not None or any(map(place_found, diagnosis.effects)):
        drawn["map"] = _map(diagnosis)
    return drawn


def png(figure: Figure) -> bytes:
    """A figure as a PNG of few colours, a third of the size, sharp enough for paper."""
    whole, small = io.BytesIO(), io.BytesIO()
    figure.savefig(whole, format="png", dpi=DPI)
    with Image.open(whole) as image:
        image.convert("RGB").quantize(128).save(small, format="png", optimize=True)
    return small.getvalue()


def shown(diagnosis: Diagnosis, n_panel: int) -> list[tuple[int, int]]:
    """Indices of the FRFs that are drawn: those that no fit saw, then the others, the worst at the baseline first.

    A panel is kept for the worst of those that were fitted.
    """
    if (overlay := diagnosis.overlay) is None:
        return []
    gap, heldout = _channel_gaps(diagnosis, overlay), overlay.heldout
    ranked = sorted(overlay.measured.pairs, key=lambda pair: -gap[pair].before)
    unseen = [pair for pair in ranked if heldout[pair]]
    fitted = [pair for pair in ranked if not heldout[pair]]
    unseen = unseen[: n_panel - 1] if fitted and n_panel > 1 else unseen[:n_panel]
    return unseen + fitted[: n_panel - len(unseen)]


def place_found(effect: Named) -> tuple[Estimate, Estimate] | None:
    """Where on the plate an effect was found, relative; None if it has no place."""
    x, y = effect.parameters.get("x"), effect.parameters.get("y")
    return None if x is None or y is None else (x, y)


def figure_digits(value: float, std: float | None) -> str:
    """A number as far as its standard error lets it be read, to two digits of that."""
    if std is None or not (math.isfinite(value) and math.isfinite(std) and std > 0):
        return f"{value:.4g}"
    digits = 2 + math.floor(math.log10(abs(value) or std)) - math.floor(math.log10(std))
    return f"{value:.{min(max(digits, 2), 9)}g} ± {std:.2g}"


def _channel_gaps(diagnosis: Diagnosis, overlay: Overlay) -> dict[tuple[int, int], ChannelGap]:
    """The gaps of each measured FRF by its indices; what the location leaves out is taken from the curves."""
    measured = overlay.measured
    told = {(one.response, one.reference): one for one in diagnosis.location.channels}
    gaps = {}
    for j, k in measured.pairs:
        key = measured.response[j].label, measured.reference[k].label
        level = measured.frf[:, j, k].norm().clamp(min=1e-300)
        parts = (overlay.before - measured.frf, overlay.after - measured.frf, math.sqrt(2) * overlay.noise)
        before, after, floor = (float(part[:, j, k].norm() / level) for part in parts)
        gaps[j, k] = told.get(key) or ChannelGap(*key, before, after, floor, bool(overlay.heldout[j, k]))
    return gaps


def _gap(diagnosis: Diagnosis) -> Figure:
    """The gap after each step as bars, from the baseline down to the noise floor."""
    gap = diagnosis.gap
    steps = diagnosis.steps or (
        Step("baseline", gap.baseline, gap.heldout_baseline, math.nan),
        Step("final", gap.final, gap.heldout_final, math.nan),
    )
    paired = any(step.heldout is not None for step in steps)
    figure = Figure(figsize=(9, 1.35 + (0.62 if paired else 0.46) * len(steps)), layout="constrained")
    axis = figure.subplots()
    values = [value for step in steps for value in (step.gap, step.heldout) if value is not None and value > 0]
    everything = [*values, *([gap.noise_floor] if gap.noise_floor > 0 else [])]
    low, high = min(everything, default=0.5), max(everything, default=1.0)
    logarithmic = high > 8 * low
    if logarithmic:
        axis.set_xscale("log")
        axis.set_xlim(low / 2, high * (high / low) ** 0.12 * 1.5)
    else:
        axis.set_xlim(0, 1.18 * high)
    height = 0.34 if paired else 0.56
    for row, step in enumerate(steps):
        colour = BEFORE if row == 0 else AFTER if row == len(steps) - 1 else _lighter(AFTER, 0.45)
        own = [(step.gap, "none")] + ([(step.heldout, "//////")] if step.heldout is not None else [])
        for turn, (value, hatch) in enumerate(own):
            place = row + (turn - (len(own) - 1) / 2) * (height + 0.04)
            face = colour if hatch == "none" else _lighter(colour, 0.6)
            axis.barh(place, value, height, color=face, edgecolor="white" if turn else "none", lw=0, zorder=2,
                      hatch=None if hatch == "none" else hatch, hatchcolor=colour)  # fmt: skip
            axis.annotate(f"{100 * value:.3g} %", (value, place), (4, 0), textcoords="offset points", va="center",
                          fontsize=8.5, color=INK, zorder=5,
                          bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.85})  # fmt: skip
    axis.axvline(gap.noise_floor, color=MEASURED, lw=1.2, ls=(0, (5, 3)), zorder=3)
    axis.set_yticks(range(len(steps)), [step.label.replace("- ", "− ") for step in steps])
    axis.set_ylim(len(steps) - 0.5, -0.5)
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:.3g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel(f"gap ‖measured − model‖ / ‖measured‖, mean over FRFs [%]{', log scale' if logarithmic else ''}")
    handles: list[Line2D | Patch] = [Patch(facecolor=MUTED, label="fitted FRFs")] if paired else []
    if paired:
        handles.append(
            Patch(facecolor=_lighter(MUTED, 0.6), hatch="//////", hatchcolor=MUTED, lw=0, label="held-out FRFs")
        )
    floor = f"noise floor {100 * gap.noise_floor:.3g} %"
    handles.append(Line2D([], [], color=MEASURED, lw=1.2, ls=(0, (5, 3)), label=floor))
    figure.legend(handles=handles, loc="outside upper right", ncol=len(handles), frameon=False, fontsize=8.5)
    dress(axis)
    axis.grid(False, axis="y")
    axis.tick_params(axis="y", length=0, labelcolor=INK)
    return figure


def _bands(diagnosis: Diagnosis, overlay: Overlay) -> Figure:
    """The misfit of every line over its noise, before and after, and the bands that hold most of it."""
    measured = overlay.measured
    line = measured.frequency.cpu().numpy()
    figure = Figure(figsize=(9, 4.8), layout="constrained")
    top, axis = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1.9])
    keep = measured.measured
    level = measured.frf[:, keep].abs().square().mean(-1).sqrt().cpu().numpy()
    top.plot(line, _decibel(level), color=MEASURED, lw=1.2)
    unit = _decibel_unit(measured.unit).replace("re 1 ", "re 1\n")
    top.set_ylabel(f"measured,\nrms {unit}", color=INK, fontsize=8.5)
    for label, frf, colour in curves(overlay):
        noise = overlay.noise[:, keep]
        # The noise is that of the real and of the imaginary part.
        ratio = (measured.frf - frf)[:, keep].abs().square() / (2 * noise.square()).where(noise > 0, math.nan)
        misfit = ratio.nanmean(-1).cpu().numpy()
        axis.plot(line, np.where(misfit > 0, misfit, np.nan), color=colour, lw=1.3, label=label, zorder=3)
    axis.set_yscale("log")
    axis.axhline(1.0, color=MEASURED, lw=1.1, ls=(0, (5, 3)), zorder=4, label="noise alone")
    axis.set_ylabel("|measured − model|² over noise²,\nmean of the FRFs [-]", color=INK, fontsize=8.5)
    axis.set_xlabel("frequency [Hz]", color=INK)
    if len(line) > 1:
        axis.set_xlim(line[0], line[-1])
    for one in (top, axis):
        for band in diagnosis.location.bands:
            one.axvspan(band.low, band.high, color=BAND, alpha=0.25, lw=0, zorder=0)
        dress(one)
    _label_bands(top, diagnosis)
    handles = [*axis.get_legend_handles_labels()[0]]
    if diagnosis.location.bands:
        handles.append(Patch(facecolor=BAND, alpha=0.25, label="most of the misfit before"))
    figure.legend(handles=handles, loc="outside lower right", ncol=len(handles), frameon=False, fontsize=8.5)
    figure.align_ylabels()
    return figure


def _label_bands(axis: Axes, diagnosis: Diagnosis) -> None:
    """The share of each band above it; of those too close to stand beside each other the largest stays."""
    span = np.ptp(axis.get_xlim())
    named: list[float] = []
    for band in sorted(diagnosis.location.bands, key=lambda band: -band.share):
        middle = (band.low + band.high) / 2
        if all(abs(middle - other) > 0.055 * span for other in named):
            axis.annotate(f"{100 * band.share:.0f} %", (middle, 1), (0, 2), xycoords=("data", "axes fraction"),
                          textcoords="offset points", ha="center", va="bottom", fontsize=8.5, color=INK)  # fmt: skip
            named.append(middle)


def _frf(diagnosis: Diagnosis, overlay: Overlay, pairs: Sequence[tuple[int, int]]) -> Figure:
    """Amplitude and phase of FRFs, measured and modelled, two side by side."""
    measured = overlay.measured
    line = measured.frequency.cpu().numpy()
    n_column = min(2, len(pairs))
    n_row = math.ceil(len(pairs) / n_column)
    size = (9.6, 0.75 + 2.75 * n_row) if n_column == 2 else (9, 4.4)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(2 * n_row, n_column, sharex=True, squeeze=False, height_ratios=[2.4, 1] * n_row)
    models = curves(overlay)
    gaps = _channel_gaps(diagnosis, overlay)
    for index, (j, k) in enumerate(pairs):
        row, column = divmod(index, n_column)
        amplitude, phase = axes[2 * row, column], axes[2 * row + 1, column]
        truth = measured.frf[:, j, k].cpu().numpy()
        levels = _decibel(np.abs(truth))
        amplitude.plot(line, levels, color=MEASURED, lw=1.8, label="measured", zorder=2)
        _phase(phase, line, truth, MEASURED, 1.8)
        for order, (label, frf, colour) in enumerate(models):
            values = frf[:, j, k].cpu().numpy()
            amplitude.plot(line, _decibel(np.abs(values)), color=colour, lw=1.1, label=label, zorder=3 + order)
            _phase(phase, line, values, colour, 1.1)
        low, high = _limits([levels, *(_decibel(np.abs(frf[:, j, k].cpu().numpy())) for _, frf, _ in models)])
        noise = _decibel(math.sqrt(2) * overlay.noise[:, j, k].cpu().numpy())
        low = max(low, float(np.nanmin(noise, initial=math.inf)) - 15) if np.isfinite(noise).any() else low
        amplitude.set_ylim(low, high)
        amplitude.fill_between(line, low, noise, color=NOISE, alpha=0.6, lw=0, zorder=1, label="noise, rms")
        heldout = bool(overlay.heldout[j, k])
        for one in (amplitude, phase):
            dress(one)
            if heldout:
                one.set_facecolor("#eef4f9")
        gap = gaps[j, k]
        change = f"gap {100 * gap.before:.3g} %"
        if len(models) > 1:
            change += f" → {100 * gap.after:.3g} %"
        amplitude.set_title(measured.pair_label(j, k), loc="left", fontsize=9.5, color=INK, fontweight="bold")
        amplitude.set_title(
            f"held out, {change}" if heldout else change, loc="right", fontsize=8.5, color=AFTER if heldout else MUTED
        )
        phase.set(ylim=(-190, 190), yticks=(-180, 0, 180))
        if column == 0:
            amplitude.set_ylabel(f"amplitude\n{_decibel_unit(measured.unit)}", color=INK, fontsize=8.5)
            phase.set_ylabel("phase [°]", color=INK, fontsize=8.5)
    for empty in range(len(pairs), n_row * n_column):
        row, column = divmod(empty, n_column)
        axes[2 * row, column].set_visible(False)
        axes[2 * row + 1, column].set_visible(False)
    for column in range(n_column):
        last = 2 * ((len(pairs) - 1 - column) // n_column) + 1
        axes[last, column].set_xlabel("frequency [Hz]", color=INK)
        axes[last, column].tick_params(labelbottom=True)
    if len(line) > 1:
        axes[0, 0].set_xlim(line[0], line[-1])
    handles = [*axes[0, 0].get_legend_handles_labels()[0]]
    if bool(overlay.heldout[tuple(zip(*pairs, strict=True))].any()):
        handles.append(Patch(facecolor="#dde9f3", label="held out: no fit saw it"))
    figure.legend(handles=handles, loc="outside upper right", ncol=len(handles), frameon=False, fontsize=8.5)
    figure.align_ylabels()
    return figure


def _phase(axis: Axes, line: np.ndarray, values: np.ndarray, colour: str, width: float) -> None:
    degrees = np.degrees(np.angle(values))
    # A wrap drawn as a line from +180 to -180 would look like a resonance.
    jump = np.abs(np.diff(degrees, prepend=degrees[0])) > 180
    axis.plot(line, np.where(jump, np.nan, degrees), color=colour, lw=width)


def _limits(levels: Sequence[np.ndarray]) -> tuple[float, float]:
    """Ends of an axis in decibels: all of the measured levels, and what the models need of peaks beyond."""
    truth = levels[0][np.isfinite(levels[0])]
    if not len(truth):
        return -1.0, 1.0
    every = np.concatenate([level[np.isfinite(level)] for level in levels])
    return float(max(every.min(), truth.min() - 10)) - 3, float(min(every.max(), truth.max() + 15)) + 4


class _Spot(NamedTuple):
    """A marker on the map with a label."""

    label: str
    x: float
    y: float


def _map(diagnosis: Diagnosis) -> Figure:
    """The plate from above: residual-force index, channels, supports, and the places that were found."""
    mesh = diagnosis.model.mesh
    sides = 1e3 * mesh.length_x, 1e3 * mesh.length_y
    ratio = sides[1] / sides[0]
    long = ratio < 0.4
    longest = 8.4 if long else 5.4 if diagnosis.location.map is not None else 4.2
    width, height = longest / max(ratio, 1), longest * min(ratio, 1)
    figure = Figure(figsize=(max(width + (0.6 if long else 2.1), 5.0), height + 1.9), layout="constrained")
    axis = figure.subplots()
    field = diagnosis.location.map
    if field is not None:
        index = 100 * np.clip(field.index.cpu().numpy(), 0, None)
        x, y = sides[0] * field.x.cpu().numpy(), sides[1] * field.y.cpu().numpy()
        top = float(np.nanmax(index)) or 1.0
        image = axis.contourf(x, y, index, levels=np.linspace(0, top, 22), cmap=INDEX, zorder=0)
        image.set_edgecolor("face")
        where: dict[str, Any] = {"location": "top", "aspect": 50} if long else {"location": "right", "aspect": 28}
        bar = figure.colorbar(image, ax=axis, shrink=0.7, pad=0.02, ticks=MaxNLocator(5), **where)
        part = "part of the misfit before that a force"
        bar.set_label(f"{part}{' ' if long else chr(10)}at this place would explain [%]", color=INK, fontsize=8.5)
        bar.outline.set_visible(False)
        bar.ax.tick_params(colors=MUTED, labelsize=8.5)
    handles = _plate(axis, diagnosis, sides)
    handles += _channels(axis, diagnosis, sides)
    handles += _found(axis, diagnosis, sides)
    margin = 0.045 * max(sides)
    axis.set(xlim=(-margin, sides[0] + margin), ylim=(-margin, sides[1] + margin), aspect="equal")
    for along, side in ((axis.xaxis, sides[0]), (axis.yaxis, sides[1])):
        ticks = MaxNLocator(6 if side > 0.4 * max(sides) else 2).tick_values(0, side)
        along.set_ticks([tick for tick in ticks if -1e-9 <= tick <= side * (1 + 1e-9)])
    axis.set_xlabel("x [mm]", color=INK)
    axis.set_ylabel("y [mm]", color=INK)
    axis.tick_params(colors=MUTED, labelsize=8.5, length=0)
    axis.spines[:].set_visible(False)
    figure.legend(handles=handles, loc="outside lower center", ncol=2, frameon=False, fontsize=8.5)
    _place_labels(figure, axis, _spots(diagnosis, sides), sides)
    return figure


def _plate(axis: Axes, diagnosis: Diagnosis, sides: tuple[float, float]) -> list[Line2D]:
    """The plate's outline, held edges and supports."""
    model = diagnosis.model
    axis.add_patch(Rectangle((0, 0), *sides, facecolor="none", edgecolor=INK, lw=1.2, zorder=2))
    handles = []
    styles = {"clamped": (4.0, "-"), "simply_supported": (3.0, (0, (1.5, 1)))}
    for condition, (width, style) in styles.items():
        held = [edge for edge, one in model.mesh.edges.items() if one == condition]
        for edge in held:
            axis.plot(*_edge(edge, sides), color=MUTED, lw=width, ls=style, zorder=2.5, solid_capstyle="butt")
        if held:
            name = condition.replace("_", " ")
            handles.append(Line2D([], [], color=MUTED, lw=width, ls=style, label=f"{name} edge"))
    supports = [
        place
        for effect in model.effects.values()
        if isinstance(effect, SupportSpring)
        for place in model.mesh.places([*effect.nodes, *effect.at]).tolist()
    ]
    if supports:
        x, y = zip(*supports, strict=True)
        square: dict[str, Any] = {"ls": "none", "marker": "s", "ms": 10, "mfc": "white", "mec": MUTED, "mew": 1.6}
        axis.plot(sides[0] * np.array(x), sides[1] * np.array(y), **square, zorder=3)
        handles.append(Line2D([], [], **square, label="support"))
    return handles


def _channels(axis: Axes, diagnosis: Diagnosis, sides: tuple[float, float]) -> list[Line2D]:
    """Where sensors and forces sit."""
    handles = []
    ends = _places(diagnosis)
    size = 8.0 if sum(map(len, ends)) <= MANY_CHANNELS else 4.5
    markers: tuple[tuple[str, list[_Spot], dict[str, Any]], ...] = (
        ("force", ends[1], {"marker": "o", "ms": size + 1, "mfc": "white", "mec": INK, "mew": 1.3}),
        ("sensor", ends[0], {"marker": "^", "ms": size, "mfc": INK, "mec": "white", "mew": 0.6}),
    )
    for name, spots, marker in markers:
        if spots:
            x, y = (np.array([getattr(spot, along) for spot in spots]) for along in ("x", "y"))
            axis.plot(sides[0] * x, sides[1] * y, ls="none", **marker, zorder=4)
            handles.append(Line2D([], [], ls="none", **marker, label=name))
    return handles[::-1]


def _found(axis: Axes, diagnosis: Diagnosis, sides: tuple[float, float]) -> list[Line2D]:
    """The places of the named effects, each with the ellipse that holds 95 % of its uncertainty, or its patch."""
    handles = []
    markers = ("P", "X", "D", "*", "v")
    uncertain = False
    for turn, effect in enumerate(diagnosis.effects):
        colour: dict[str, Any] = {"color": FOUND}
        if effect.options.get("edge") in ("x0", "x1", "y0", "y1"):
            axis.plot(*_edge(effect.options["edge"], sides), **colour, lw=3, zorder=2.6)
            handles.append(Line2D([], [], **colour, lw=3, label=f"{effect.name}, found"))
        handles += _moved(axis, effect, diagnosis, sides)
        if (place := place_found(effect)) is None:
            continue
        centre = sides[0] * place[0].value, sides[1] * place[1].value
        style: dict[str, Any] = {
            "marker": markers[turn % len(markers)],
            "ms": 9,
            "mfc": FOUND,
            "mec": "white",
            "mew": 1.0,
        }
        axis.plot(*centre, **style, ls="none", zorder=6)
        text = ", ".join(f"{name} {figure_digits(one.value, one.std)}" for name, one in zip("xy", place, strict=True))
        handles.append(Line2D([], [], ls="none", **style, label=f"{effect.name}: {text} of the sides"))
        stds = [one.std for one in place]
        if stds[0] is not None and stds[1] is not None:
            axes = [2 * ELLIPSE_95 * side * std for side, std in zip(sides, stds, strict=True)]  # type: ignore[operator]
            axis.add_patch(Ellipse(centre, *axes, facecolor="none", edgecolor=FOUND, lw=1.5, zorder=5))
            uncertain = True
        if (size := effect.parameters.get("size")) is not None:
            side = size.value * math.sqrt(sides[0] * sides[1])
            corner = centre[0] - side / 2, centre[1] - side / 2
            axis.add_patch(Rectangle(corner, side, side, fill=False, edgecolor=FOUND, lw=1.3, ls=(0, (4, 2)), zorder=5))
            handles.append(Line2D([], [], **colour, lw=1.3, ls=(0, (4, 2)), label="its patch"))
    if uncertain:
        ring: dict[str, Any] = {"marker": "o", "ms": 11, "mfc": "none", "mec": FOUND, "mew": 1.5}
        handles.append(Line2D([], [], ls="none", **ring, label="95 % of the uncertainty from noise"))
    return handles


def _moved(axis: Axes, effect: Named, diagnosis: Diagnosis, sides: tuple[float, float]) -> list[Line2D]:
    """Arrows from where sensors should sit to where they do."""
    if "dx" not in effect.parameters or "dy" not in effect.parameters:
        return []
    spots = _places(diagnosis)[0]
    if (own := effect.options.get("response")) is not None:
        x, y = diagnosis.model.mesh.places([own])[0].tolist()
        spots = [spot for spot in spots if math.hypot(spot.x - x, spot.y - y) < 1e-6]
    shift = [1e3 * effect.parameters[name].value for name in ("dx", "dy")]
    for spot in spots:
        start = sides[0] * spot.x, sides[1] * spot.y
        arrow = {"arrowstyle": "-|>", "color": FOUND, "lw": 1.8, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 12}
        axis.annotate("", (start[0] + shift[0], start[1] + shift[1]), start, arrowprops=arrow, zorder=6)
    label = f"{effect.name}: dx {shift[0]:.3g} mm, dy {shift[1]:.3g} mm"
    return [Line2D([], [], color=FOUND, lw=1.8, label=label)]


def _edge(edge: str, sides: tuple[float, float]) -> tuple[list[float], list[float]]:
    """Both ends of an edge, x and y [mm]."""
    along, end = edge[0] == "x", float(edge[1])
    held = [end * sides[0 if along else 1]] * 2
    return (held, [0.0, sides[1]]) if along else ([0.0, sides[0]], held)


def _places(diagnosis: Diagnosis) -> tuple[list[_Spot], list[_Spot]]:
    """Sensors and forces at their relative places; without a label where the measurement has other channels."""
    if diagnosis.overlay is None:
        return [], []
    model, measured = diagnosis.model, diagnosis.overlay.measured
    ends = []
    for points, channels in ((model.response, measured.response), (model.reference, measured.reference)):
        found = [] if points is None else model.mesh.places(list(points)).tolist()
        labels = [one.label for one in channels] if len(channels) == len(found) else [""] * len(found)
        ends.append([_Spot(label, *place) for label, place in zip(labels, found, strict=True)])
    return ends[0], ends[1]


def _spots(diagnosis: Diagnosis, sides: tuple[float, float]) -> list[_Spot]:
    """What is to be labelled on the map [mm]: each channel once, none where they are many."""
    every = [spot for end in _places(diagnosis) for spot in end]
    if len(every) > MANY_CHANNELS:
        return []
    return [_Spot(one.label, sides[0] * one.x, sides[1] * one.y) for one in dict.fromkeys(every) if one.label]


def _place_labels(figure: Figure, axis: Axes, spots: Sequence[_Spot], sides: tuple[float, float]) -> None:
    """Labels beside their markers, where nothing else is yet; one that finds no room is left out."""
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    scale = figure.dpi / 72
    (left, low), (right, high) = axis.transData.transform([(0.0, 0.0), sides])
    taken = [Bbox.from_extents(left, y - scale, right, y + scale) for y in (low, high)]
    taken += [Bbox.from_extents(x - scale, low, x + scale, high) for x in (left, right)]
    for drawn in axis.lines:
        if drawn.get_marker() not in ("None", None, ""):
            radius = scale * (drawn.get_markersize() / 2 + 1)
            for x, y in axis.transData.transform(np.column_stack([drawn.get_xdata(), drawn.get_ydata()])):
                taken.append(Bbox.from_extents(x - radius, y - radius, x + radius, y + radius))
    paper = {"facecolor": "white", "edgecolor": "none", "pad": 0.7, "alpha": 0.75}
    for spot in spots:
        for dx, dy, across, up in _AROUND:
            text = axis.annotate(spot.label, (spot.x, spot.y), (dx, dy), textcoords="offset points", fontsize=8,
                                 ha=across, va=up, color=INK, zorder=7, bbox=paper)  # fmt: skip
            box = text.get_window_extent(renderer)
            if not any(box.overlaps(other) for other in taken):
                taken.append(box)
                break
            text.remove()


_AROUND = (
    (7, 0, "left", "center"),
    (-7, 0, "right", "center"),
    (0, 7, "center", "bottom"),
    (0, -7, "center", "top"),
    (7, 7, "left", "bottom"),
    (-7, 7, "right", "bottom"),
    (7, -7, "left", "top"),
    (-7, -7, "right", "top"),
)


def step_tags(steps: Sequence[Step]) -> Iterator[tuple[str, Step]]:
    """A name for each step that a tag can carry: "+ point_mass" is point_mass, "- sensor_gain" removed_sensor_gain."""
    seen: Counter[str] = Counter()
    for step in steps:
        name = step.label.removeprefix("+ ").strip()
        name = f"removed_{name[2:]}" if name.startswith(("- ", "− ")) else name
        name = name.replace(" ", "_")
        seen[name] += 1
        yield name if seen[name] == 1 else f"{name}_{seen[name]}", step


def _decibel(amplitude: np.ndarray) -> np.ndarray:
    return np.asarray(20 * np.log10(np.where(amplitude > 0, amplitude, np.nan)))


def _decibel_unit(unit: str) -> str:
    return "[dB]" if unit in ("", "-") else f"[dB re 1 {unit}]"


def _lighter(colour: str, part: float) -> str:
    """A colour, mixed with this part of white."""
    channels = (int(colour[start : start + 2], 16) for start in (1, 3, 5))
    return "#" + "".join(f"{round(one + part * (255 - one)):02x}" for one in islice(channels, 3))
