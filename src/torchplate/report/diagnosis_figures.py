"""The figures of a diagnosis: those of its files, those of its page, those of TensorBoard."""

from collections.abc import Callable
from functools import partial

from matplotlib.figure import Figure

from torchplate.diagnosis import Diagnosis
from torchplate.report.blocks.document import Panel
from torchplate.report.figures.assurance import assurance, assurance_panels
from torchplate.report.figures.bands import bands_figure, bands_told
from torchplate.report.figures.field_map import field_map, field_told
from torchplate.report.figures.frf import frf_overlay, frf_told, shown
from torchplate.report.figures.gap import gap_figure, gap_told
from torchplate.report.figures.plate_map import map_told, place_found, plate_map

N_PANEL = 6
"""FRFs that are drawn."""


def figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """The figures beside report.md, by file name.

    "gap"; "bands", "frf" and "assurance" where FRFs were measured; "map" where there is a place to show; "field" where
    one was found.
    """
    drawn = {"gap": gap_figure(diagnosis)}
    if (overlay := diagnosis.overlay) is not None:
        drawn["bands"] = bands_figure(diagnosis, overlay)
        drawn["frf"] = frf_overlay(diagnosis, overlay, shown(diagnosis, N_PANEL))
        drawn["assurance"] = assurance(overlay)
    if _has_places(diagnosis):
        drawn["map"] = plate_map(diagnosis)
    if diagnosis.field is not None:
        drawn["field"] = field_map(diagnosis, diagnosis.field)
    return drawn


def panels(diagnosis: Diagnosis, drawn: dict[str, Figure]) -> dict[str, tuple[Panel, ...]]:
    """The figures of report.html, by the same names, each in parts that a narrow screen holds.

    Args:
        diagnosis: what was found.
        drawn: `figures` of it.
    """
    found: dict[str, tuple[Panel, ...]] = {}
    told = gap_told(diagnosis)
    found["gap"] = _either(drawn["gap"], partial(gap_figure, diagnosis, narrow=True), told)
    if (overlay := diagnosis.overlay) is not None:
        told = bands_told(diagnosis, overlay)
        found["bands"] = _either(drawn["bands"], partial(bands_figure, diagnosis, overlay, narrow=True), told)
        found["frf"] = tuple(
            Panel(partial(frf_overlay, diagnosis, overlay, [pair], narrow=True), frf_told(diagnosis, overlay, pair))
            for pair in shown(diagnosis, N_PANEL)
        )
        found["assurance"] = assurance_panels(overlay)
    if _has_places(diagnosis):
        found["map"] = _either(drawn["map"], partial(plate_map, diagnosis, narrow=True), map_told(diagnosis))
    if (field := diagnosis.field) is not None:
        found["field"] = _either(drawn["field"], partial(field_map, diagnosis, field, narrow=True), field_told(field))
    return found


def _either(wide: Figure, narrow: Callable[[], Figure], told: str) -> tuple[Panel, ...]:
    return Panel(lambda: wide, told, "wide"), Panel(narrow, told, "narrow")


def log_figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """The figures that TensorBoard shows, by tag: one for each drawn FRF, the assurance criteria, and the map."""
    drawn = {}
    if (overlay := diagnosis.overlay) is not None:
        for j, k in shown(diagnosis, N_PANEL):
            tag = f"frf/{overlay.measured.response[j].label}_{overlay.measured.reference[k].label}"
            drawn[tag] = frf_overlay(diagnosis, overlay, [(j, k)])
        drawn["assurance"] = assurance(overlay)
    if _has_places(diagnosis):
        drawn["map"] = plate_map(diagnosis)
    if diagnosis.field is not None:
        drawn["field"] = field_map(diagnosis, diagnosis.field)
    return drawn


def _has_places(diagnosis: Diagnosis) -> bool:
    return diagnosis.location.map is not None or any(map(place_found, diagnosis.effects))
