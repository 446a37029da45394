"""The plate from above: residual-force index, channels, supports, and the places that were found."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Rectangle
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox

from torchplate.diagnosis import Diagnosis, Estimate, Named
from torchplate.effects import SupportSpring
from torchplate.notation import percent
from torchplate.report.blocks.numbers import figure_digits
from torchplate.report.figures.style import FOUND, INDEX, INK, MUTED, NARROW, PAPER, SHADED, bare, colour_bar

MANY_CHANNELS = 40
"""More than these on the map stay without their labels."""

LINE = 0.17
"""Height of a line of the legend [inch]."""
ELLIPSE_95 = math.sqrt(-2 * math.log(0.05))
"""Half axes of the ellipse that holds 95 % of a normal distribution in the plane, in standard deviations."""


class _Spot(NamedTuple):
    """A marker on the map with a label."""

    label: str
    x: float
    y: float


def place_found(effect: Named) -> tuple[Estimate, Estimate] | None:
    """Where on the plate an effect was found, relative; None if it has no place."""
    x, y = effect.parameters.get("x"), effect.parameters.get("y")
    return None if x is None or y is None else (x, y)


def plate_map(diagnosis: Diagnosis, narrow: bool = False) -> Figure:
    """The plate from above: residual-force index, channels, supports, and the places that were found.

    Args:
        diagnosis: what was found.
        narrow: for a narrow screen: scale and legend above and below the plate.
    """
    mesh = diagnosis.model.mesh
    sides = 1e3 * mesh.length_x, 1e3 * mesh.length_y
    ratio = sides[1] / sides[0]
    long = ratio < 0.4
    longest = 8.4 if long else 5.4 if diagnosis.location.map is not None else 4.2
    width, height = longest / max(ratio, 1), longest * min(ratio, 1)
    size = max(width + (0.6 if long else 2.1), 5.0), height + 1.9
    if narrow:
        size = NARROW, 4.5
    figure = Figure(figsize=size, layout="constrained")
    axis = figure.subplots()
    field = diagnosis.location.map
    if field is not None:
        index = 100 * np.clip(field.index.cpu().numpy(), 0, None)
        x, y = sides[0] * field.x.cpu().numpy(), sides[1] * field.y.cpu().numpy()
        top = float(np.nanmax(index)) or 1.0
        image = axis.contourf(x, y, index, levels=np.linspace(0, top, 22), cmap=INDEX, zorder=0)
        image.set_edgecolor("face")
        image.set_gid(SHADED)
        where: dict[str, Any] = (
            {"location": "top", "aspect": 50} if long or narrow else {"location": "right", "aspect": 28}
        )
        part = "part of the misfit before that a force"
        label = f"{part}{' ' if long and not narrow else chr(10)}at this place would explain [%]"
        colour_bar(figure, image, axis, label, shrink=0.7, pad=0.02, ticks=MaxNLocator(5), **where)
    handles = draw_plate(axis, diagnosis, sides)
    handles += draw_channels(axis, diagnosis, sides)
    handles += _found(axis, diagnosis, sides, narrow)
    margin = 0.045 * max(sides)
    axis.set(xlim=(-margin, sides[0] + margin), ylim=(-margin, sides[1] + margin), aspect="equal")
    for along, side in ((axis.xaxis, sides[0]), (axis.yaxis, sides[1])):
        share = side / max(sides)
        ticks = MaxNLocator((4 if narrow else 6) if share > 0.4 else 2 if share > 0.15 else 1).tick_values(0, side)
        along.set_ticks([tick for tick in ticks if -1e-9 <= tick <= side * (1 + 1e-9)])
    axis.set_xlabel("x [mm]", color=INK)
    axis.set_ylabel("y [mm]", color=INK)
    bare(axis)
    if narrow:
        n_line = sum(1 + str(handle.get_label()).count("\n") for handle in handles)
        figure.set_size_inches(
            NARROW, min(max(2.7 * ratio, 0.6), 4.5) + 0.7 + 0.6 * (field is not None) + LINE * n_line
        )
    _legend(figure, handles, narrow)
    _place_labels(figure, axis, _spots(diagnosis, sides), sides)
    return figure


def _legend(figure: Figure, handles: Sequence[Artist], narrow: bool) -> None:
    """Below the plate, in two columns where they fit the width."""
    told: dict[str, Any] = {"handles": handles, "loc": "outside lower center", "frameon": False, "fontsize": 8.5}
    if not narrow:
        legend = figure.legend(ncol=2, **told)
        if legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()
        width, height = figure.get_size_inches()
        figure.set_size_inches(width, height + LINE * (len(handles) // 2))
    figure.legend(ncol=1, **told)


def map_told(diagnosis: Diagnosis) -> str:
    """The same in words."""
    parts = []
    if (field := diagnosis.location.map) is not None:
        row, column = divmod(int(field.index.argmax()), len(field.x))
        parts.append(
            f"A force at x {float(field.x[column]):.2f}, y {float(field.y[row]):.2f} of the sides would explain most "
            f"of the misfit before: {percent(float(field.index[row, column]))}."
        )
    for effect in diagnosis.effects:
        if (place := place_found(effect)) is not None:
            x, y = (figure_digits(one.value, one.std) for one in place)
            parts.append(f"Found: {effect.name} at x {x}, y {y} of the sides.")
    sensors, forces = ([spot.label for spot in end if spot.label] for end in _places(diagnosis))
    if 0 < len(sensors) + len(forces) <= MANY_CHANNELS:
        named = [f"{name} at {', '.join(end)}" for name, end in (("sensors", sensors), ("forces", forces)) if end]
        parts.append(f"Marked: {'; '.join(named)}.")
    return f"The plate from above. {' '.join(parts)}".strip()


def draw_plate(axis: Axes, diagnosis: Diagnosis, sides: tuple[float, float]) -> list[Line2D]:
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
        square: dict[str, Any] = {"ls": "none", "marker": "s", "ms": 10, "mfc": PAPER, "mec": MUTED, "mew": 1.6}
        axis.plot(sides[0] * np.array(x), sides[1] * np.array(y), **square, zorder=3)
        handles.append(Line2D([], [], **square, label="support"))
    return handles


def draw_channels(axis: Axes, diagnosis: Diagnosis, sides: tuple[float, float]) -> list[Line2D]:
    """Where sensors and forces sit."""
    handles = []
    ends = _places(diagnosis)
    size = 8.0 if sum(map(len, ends)) <= MANY_CHANNELS else 4.5
    markers: tuple[tuple[str, list[_Spot], dict[str, Any]], ...] = (
        ("force", ends[1], {"marker": "o", "ms": size + 1, "mfc": PAPER, "mec": INK, "mew": 1.3}),
        ("sensor", ends[0], {"marker": "^", "ms": size, "mfc": INK, "mec": PAPER, "mew": 0.6}),
    )
    for name, spots, marker in markers:
        if spots:
            x, y = (np.array([getattr(spot, along) for spot in spots]) for along in ("x", "y"))
            axis.plot(sides[0] * x, sides[1] * y, ls="none", **marker, zorder=4)
            handles.append(Line2D([], [], ls="none", **marker, label=name))
    return handles[::-1]


def _found(axis: Axes, diagnosis: Diagnosis, sides: tuple[float, float], narrow: bool) -> list[Line2D]:
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
            "mec": PAPER,
            "mew": 1.0,
        }
        axis.plot(*centre, **style, ls="none", zorder=6)
        text = f",{chr(10) if narrow else ' '}".join(
            f"{name} {figure_digits(one.value, one.std)}" for name, one in zip("xy", place, strict=True)
        )
        handles.append(
            Line2D([], [], ls="none", **style, label=f"{effect.name}:{chr(10) if narrow else ' '}{text} of the sides")
        )
        stds = [one.std for one in place]
        if stds[0] is not None and stds[1] is not None:
            axes = [2 * ELLIPSE_95 * side * std for side, std in zip(sides, stds, strict=True)]  # type: ignore[operator]
            axis.add_patch(Ellipse(centre, *axes, facecolor="none", edgecolor=FOUND, lw=1.5, zorder=5))
            uncertain = True
        if (size := effect.parameters.get("size")) is not None:
            aspect = effect.parameters["aspect"].value if "aspect" in effect.parameters else 1.0
            root = size.value * math.sqrt(sides[0] * sides[1])
            width, height = root * math.sqrt(aspect), root / math.sqrt(aspect)
            corner = centre[0] - width / 2, centre[1] - height / 2
            axis.add_patch(
                Rectangle(corner, width, height, fill=False, edgecolor=FOUND, lw=1.3, ls=(0, (4, 2)), zorder=5)
            )
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
    ticks = [one for one in (*axis.get_xticklabels(), *axis.get_yticklabels()) if one.get_visible() and one.get_text()]
    taken += [one.get_window_extent(renderer).expanded(1.1, 1.1) for one in ticks]
    for drawn in axis.lines:
        if drawn.get_marker() not in ("None", None, ""):
            radius = scale * (drawn.get_markersize() / 2 + 1)
            for x, y in axis.transData.transform(np.column_stack([drawn.get_xdata(), drawn.get_ydata()])):
                taken.append(Bbox.from_extents(x - radius, y - radius, x + radius, y + radius))
    paper = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.7, "alpha": 0.75}
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
