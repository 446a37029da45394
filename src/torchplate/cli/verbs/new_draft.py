"""A config in the making: what a measurement and its owner say of a plate, and what is guessed of the rest."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from torchplate.cli.config import InputError
from torchplate.cli.verbs.new_material import Heard, heard
from torchplate.effects import find_effect
from torchplate.measurement import (
    UFF_SUFFIX,
    Measurement,
    MeasurementError,
    NodeTable,
    Proposal,
    Said,
    in_frame,
    place,
    propose,
    read_geometry,
    read_measurement,
    read_node_table,
    with_nodes,
)
from torchplate.model import PlateModel
from torchplate.plate import (
    THIN,
    Material,
    Mesh,
    bending_wavelength,
    elements_for,
    find_material,
    frequency_of_wavelength,
)

MOST_ELEMENTS = {"isotropic": 400, "orthotropic": 130}
"""Elements at most: a basis serves all members of an isotropic search; else each member takes a whole eigenproblem."""
LEAST_COHERENCE = 0.8
SAME_LEVEL = 1.3
"""A level off by more than this factor is not taken in the file's unit [-]. A plate of the right mass comes within it;
a gain that is left open costs little, and one that is wrong, or of the wrong sign, costs the answer."""
LEAST_SIDE, HEAVIEST = 5e-3, 3e4
"""Sides [m] of the smallest plates that are tested, and a density [kg/m³] that no metal has: osmium's is 22 590."""


THICKEST = 0.2
"""Of the shorter side [-]: a thicker one is no plate."""


@dataclass(frozen=True)
class Wishes:
    """What the user tells of the plate.

    Args:
        length: Sides along x and y [m].
        thickness: [m].
        mass: Of the plate [kg], instead of its material's density.
        material: Name of a material.
        nodes: Table of nodes, for a file without coordinates.
        unit: Of the coordinates.
        supports: "free", "springs", or places "x,y" of springs [m from the plate's corner].
        edges: "x0=clamped" each.
        kind: Of the FRFs, where the file does not say.
    """

    length: tuple[float, float] | None = None
    thickness: float | None = None
    mass: float | None = None
    material: str | None = None
    nodes: Path | None = None
    unit: str | None = None
    supports: tuple[str, ...] = ()
    edges: tuple[str, ...] = ()
    kind: str | None = None


@dataclass(frozen=True)
class Draft:
    """All that goes into the config, with the reasons for its comments."""

    file: Path
    wishes: Wishes
    measurement: Measurement
    proposal: Proposal
    heard: Heard
    density: float
    edges: dict[str, str]
    supports: tuple[tuple[float, float], ...] | None  # relative places; None where nobody told
    band: tuple[float, float]
    band_reasons: tuple[str, str]
    cells: tuple[int, int]
    per_wave: float
    level: float | None = None  # measured over expected [-]
    first: float | None = None  # first elastic natural frequency expected [Hz]

    @property
    def material(self) -> Material:
        """As named, or guessed."""
        return self.heard.material

    @property
    def thickness(self) -> tuple[float, float, float]:
        """Low, taken, high [m]; all alike where given."""
        return self.heard.thickness

    @property
    def orthotropic(self) -> bool:
        """Whether the plate may be stiffer along one side than along the other."""
        return self.material.young_ratio > 1

    @property
    def moduli(self) -> tuple[float, float]:
        """Young's modulus along x and along y [Pa], as usual."""
        root = math.sqrt(self.heard.young_ratio)
        return self.material.youngs_modulus[1] / root, self.material.youngs_modulus[1] * root

    @property
    def gain_is_known(self) -> bool:
        """Whether the level agrees with the file's unit."""
        if self.measurement.kind == "transmissibility":
            return True
        if self.level is None or self.wishes.material is None or self.wishes.thickness is None:
            return False
        return 1 / SAME_LEVEL <= self.level <= SAME_LEVEL


def drafted(file: Path, wishes: Wishes) -> Draft:
    """What is known of the plate, and what is guessed.

    Args:
        file: The measurement.
        wishes: What the user tells.
    """
    named = None
    if wishes.material is not None:
        try:
            named = find_material(wishes.material)
        except KeyError as error:
            raise InputError(f"--material: {error.args[0]}") from None
    measurement, proposal = _placed(file, wishes)
    check_sizes(wishes, proposal.length_x, proposal.length_y)
    edges = _edges(wishes, measurement)
    guess = heard(measurement, proposal, edges, named, wishes.thickness, wishes.mass)
    area = proposal.length_x * proposal.length_y
    density = guess.material.density[1]
    if wishes.mass is not None and wishes.thickness is not None:
        density = wishes.mass / (area * wishes.thickness)
    draft = Draft(
        file=file,
        wishes=wishes,
        measurement=measurement,
        proposal=proposal,
        heard=guess,
        density=float(f"{density:.5g}"),
        edges=edges,
        supports=None,
        band=(0.0, 0.0),
        band_reasons=("", ""),
        cells=(4, 4),
        per_wave=0.0,
    )
    draft = replace(draft, supports=_supports(draft))
    return _with_level(_meshed(draft))


def check_sizes(wishes: Wishes, length_x: float, length_y: float) -> None:
    """Whether thickness and mass can be those of a plate of these sides [m].

    Raises:
        InputError: if they cannot.
    """
    sides = f"{length_x:g} × {length_y:g} m"
    if wishes.unit is not None and wishes.length is None and max(length_x, length_y) < LEAST_SIDE:
        raise InputError(
            f"--unit: Expected the unit of the file's coordinates, got {wishes.unit}, in which the plate has {sides}. "
            "Leave it out, or name the right one."
        )
    if wishes.thickness is not None and wishes.thickness > THICKEST * min(length_x, length_y):
        raise InputError(
            f"--thickness: Expected less than a fifth of the shorter side of {sides}, in m, got {wishes.thickness:g}. "
            f"For mm write --thickness {wishes.thickness / 1e3:g}."
        )
    mass = wishes.mass or 0.0
    # The thickest that a plate of these sides can be, where nobody has told.
    thickness = wishes.thickness or THICKEST * min(length_x, length_y)
    density = mass / (length_x * length_y * thickness)
    if density > HEAVIEST:
        least = "" if wishes.thickness is not None else " at least"
        action = ", or correct --thickness" if wishes.thickness is not None else ""
        raise InputError(
            f"--mass: Expected the mass of a plate of {sides} in kg, got {mass:g}, a density of{least} "
            f"{density:.3g} kg/m³. For g write --mass {mass / 1e3:g}{action}."
        )


def _placed(file: Path, wishes: Wishes) -> tuple[Measurement, Proposal]:
    """The measurement in the plate's own axes, and how these were found."""
    is_uff = file.suffix.lower() in UFF_SUFFIX
    head = None if wishes.nodes is None else read_node_table(wishes.nodes)
    table, unit = (None, wishes.unit) if head is None else (head.places, _unit(wishes.unit, head))
    if not file.is_file() or not is_uff:
        measurement = read_measurement(file, wishes.kind)
        places = {c.node: c.coordinate for c in (*measurement.response, *measurement.reference) if c.coordinate}
        axis = None
    else:
        places, axis = read_geometry(file)
    places = table if table is not None else places
    if not places:
        read_measurement(file, wishes.kind, axis or 3)  # a file without FRFs lacks more than places
        raise MeasurementError(
            f"{file}: expected coordinates (dataset 15 or 2411), to see where the channels sit, got none. Give them as "
            "a table with the columns node, x, y: --nodes nodes.csv."
        )
    given = wishes.length, unit, str(file)
    try:
        proposal = propose(np.array(list(places.values()), dtype=np.float64), axis or 3, *given)
    except MeasurementError:
        # Fixtures and sensors beside the plate may be drawn too: what was measured decides alone then.
        seen = read_measurement(file, wishes.kind, axis or 3)
        nodes = {c.node for c in (*seen.response, *seen.reference)} & set(places)
        if not nodes or nodes == set(places):
            raise
        proposal = propose(np.array([places[node] for node in nodes], dtype=np.float64), axis or 3, *given)
    if head is not None:
        proposal = replace(proposal, unit=Said(head.notes[0], False) if head.notes else proposal.unit)
    measurement = read_measurement(file, wishes.kind, proposal.frame.normal)
    if table is not None:
        measurement = with_nodes(measurement, table, str(wishes.nodes))
    _check_places(file, measurement, places)
    measurement = in_frame(measurement, proposal.frame)
    place(measurement, proposal.length_x, proposal.length_y, 4, 4)
    return measurement, proposal


def _unit(told: str | None, table: NodeTable) -> str | None:
    """The unit of a table's places: as its head says, else as the user does.

    Raises:
        InputError: They say different ones.
    """
    if told is not None and table.unit not in (None, told):
        raise InputError(
            f"--unit: Expected {table.unit}, as the head of {table.source} says, got {told}. Leave --unit out, or "
            "correct the head."
        )
    return table.unit or told


def _check_places(file: Path, measurement: Measurement, places: Mapping[int, tuple[float, float, float]]) -> None:
    """Whether each channel has its place: the mesh that is to be proposed has no node numbers to go by.

    Raises:
        MeasurementError: if one has none.
    """
    references = () if measurement.kind == "transmissibility" else measurement.reference
    missing = sorted({c.node for c in (*measurement.response, *references) if c.coordinate is None})
    if missing:
        first = ", ".join(map(str, missing[:4])) + (" ..." if len(missing) > 4 else "")
        raise MeasurementError(
            f"{file}: expected the places of all nodes that were measured, got none of {first}; the geometry has the "
            f"labels {min(places)} to {max(places)}. Make the labels agree in the export, or give a table with the "
            "columns node, x, y: --nodes nodes.csv."
        )


def _edges(wishes: Wishes, measurement: Measurement) -> dict[str, str]:
    edges = {}
    for text in wishes.edges:
        edge, _, condition = text.partition("=")
        edges[edge] = condition or "clamped"
    try:
        Mesh(1.0, 1.0, 1, 1, edges=edges)
    except ValueError as error:
        raise InputError(f"--edge: {error}") from None
    if measurement.kind == "transmissibility" and not edges:
        raise InputError(
            "--edge: Expected a held edge for a transmissibility, whose reference is the motion of the held edges, got "
            "none. Say which, --edge x0=clamped for the edge at x = 0."
        )
    return edges


def _supports(draft: Draft) -> tuple[tuple[float, float], ...] | None:
    given = draft.wishes.supports
    if not given:
        return None
    if given == ("free",):
        return ()
    if given == ("springs",):
        return ((0.1, 0.0), (0.9, 0.0), (0.1, 1.0), (0.9, 1.0))
    if (alone := next((word for word in ("free", "springs") if word in given), None)) is not None:
        raise InputError(
            f"--supports: Expected {alone} alone, got {' '.join(given)}. Leave the others out, or give places x,y."
        )
    places = []
    sides = draft.proposal.length_x, draft.proposal.length_y
    for text in given:
        try:
            x, y = (float(part) for part in text.split(","))
        except ValueError:
            raise InputError(
                f"--supports: Expected free, springs or places x,y in m, got '{text}'. Write --supports 0.05,0 0.4,0."
            ) from None
        if not (0 <= x <= sides[0] and 0 <= y <= sides[1]):
            raise InputError(
                f"--supports: Expected places on the plate of {sides[0]:g} × {sides[1]:g} m, got {text}. Count in m "
                "from the corner (0, 0)."
            )
        places.append((x / sides[0], y / sides[1]))
    return tuple(places)


def _model(draft: Draft, cells: tuple[int, int]) -> PlateModel:
    """The plate as usual: nothing searched."""
    mesh = Mesh(draft.proposal.length_x, draft.proposal.length_y, *cells, edges=draft.edges)
    low, high = draft.material.loss_factor
    known = {
        "plate.youngs_modulus": draft.material.youngs_modulus[1],
        "plate.poisson_ratio": draft.material.poisson_ratio,
        "plate.density": draft.density,
        "plate.thickness": draft.thickness[1],
        "loss.stiffness_loss_factor": math.sqrt(low * high),
    }
    effects = {"plate": find_effect("plate")(), "loss": find_effect("hysteretic_damping")()}
    if draft.orthotropic:
        effects["grain"] = find_effect("orthotropy")()
        along, across = draft.moduli
        known["grain.young_ratio"] = across / along
    return PlateModel(mesh, effects, known)


def _meshed(draft: Draft) -> Draft:
    """The band that the file, thin-plate theory and a quick search allow, and the elements that it needs."""
    lines = draft.measurement.frequency[draft.measurement.frequency > 0]
    bottom, top = float(lines[0]), float(lines[-1])
    reasons = ["the file's first line", "the file's last line"]
    material, thickness = draft.material, draft.thickness[1]
    section = material.poisson_ratio, draft.density, thickness
    heard = _coherent(draft.measurement)
    if heard is not None and heard < top:
        top, reasons[1] = heard, f"above, the coherence falls below {LEAST_COHERENCE:g}"
    thin = min(frequency_of_wavelength(THIN * thickness, modulus, *section) for modulus in draft.moduli)
    if thin < top:
        top, reasons[1] = thin, f"above, bending waves are shorter than {THIN:g} thicknesses and the plate is not thin"
    sides = draft.proposal.length_x, draft.proposal.length_y
    theta = torch.zeros(0, dtype=torch.float64)
    n_rigid = 0 if draft.edges else 3
    first = float(_model(draft, (8, 8)).natural_frequencies(theta, n_rigid + 1)[n_rigid])
    most = MOST_ELEMENTS["orthotropic" if draft.orthotropic else "isotropic"]

    def cells(frequency: float) -> tuple[int, int]:
        waves = [bending_wavelength(frequency, modulus, *section) for modulus in draft.moduli]
        return elements_for(sides[0], waves[0]), elements_for(sides[1], waves[1])

    while math.prod(cells(top)) > most and top > 4 * first:
        top *= 0.95
        reasons[1] = "above, the mesh would have to be too fine for a quick search"
    if not draft.supports and 0.5 * first > bottom and 0.5 * first < top:
        bottom, reasons[0] = 0.5 * first, f"half the first natural frequency to expect, {first:.3g} Hz"
        reasons[0] += "" if draft.edges else ": below, the plate swings on its supports"
    band = float(f"{bottom:.3g}"), float(f"{top:.4g}")
    if draft.measurement.band(*band).frequency.numel() < 10:
        band, reasons = (float(lines[0]), float(lines[-1])), ["the file's first line", "the file's last line"]
    found = cells(band[1])
    wave = [bending_wavelength(band[1], modulus, *section) for modulus in draft.moduli]
    per_wave = min(wave[i] * found[i] / sides[i] for i in (0, 1))
    return replace(draft, band=band, band_reasons=(reasons[0], reasons[1]), cells=found, per_wave=per_wave, first=first)


def _coherent(measurement: Measurement) -> float | None:
    """The last frequency up to which the FRFs are coherent [Hz]; None where the file holds no coherence."""
    if measurement.coherence is None:
        return None
    mean = torch.nanmedian(measurement.coherence.flatten(1), dim=1).values
    width = max(len(mean) // 20, 1)
    smooth = torch.nn.functional.avg_pool1d(mean[None, None].double(), width, stride=1)[0, 0]
    good = (smooth >= LEAST_COHERENCE).nonzero()[:, 0]
    return float(measurement.frequency[min(int(good[-1]) + width - 1, len(mean) - 1)]) if len(good) else None


def _with_level(draft: Draft) -> Draft:
    """With the measured level over that of the plate as usual: the median over lines and FRFs."""
    if draft.measurement.kind == "transmissibility":
        return draft
    cut = draft.measurement.band(*draft.band)
    found = place(cut, draft.proposal.length_x, draft.proposal.length_y, *draft.cells)
    model = _model(draft, draft.cells)
    model.kind = cut.kind
    expected = model.frf(
        torch.zeros(0, dtype=torch.float64),
        cut.frequency,
        response=[spot.place for spot in found.response],
        reference=[spot.place for spot in found.reference],
    ).abs()
    measured = cut.frf.abs()
    usable = cut.measured.expand_as(measured) & (measured > 0) & (expected > 0)
    if not bool(usable.any()):
        return draft
    return replace(draft, level=float((measured[usable] / expected[usable]).log().median().exp()))
