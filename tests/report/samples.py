"""A diagnosis of a plate of twelve nodes, made up, and what a browser would see of its report."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path

import torch

from torchplate.cli.folder.writing import write_files
from torchplate.diagnosis.result import (
    Band,
    ChannelGap,
    Diagnosis,
    Estimate,
    ForceMap,
    Gap,
    Location,
    Named,
    Overlay,
    Scored,
    Step,
)
from torchplate.effects import HystereticDamping, Plate, PointMass, SupportSpring
from torchplate.measurement import SI_UNIT, Channel, Measurement
from torchplate.model import PlateModel
from torchplate.plate import Mesh
from torchplate.report import diagnosis_report

PNG = b"\x89PNG\r\n\x1a\n"
SIDES = 0.5, 0.32
PLATE = {
    "plate.youngs_modulus": 6.6e10,
    "plate.poisson_ratio": 0.33,
    "plate.density": 2750.0,
    "plate.thickness": 0.004,
    "wires.stiffness": 2100.0,
    "wires.viscous_damping": 0.7,
    "loss.stiffness_loss_factor": 8.0e-3,
}
MASS = {"x": Estimate(0.213, 0.011, "-"), "y": Estimate(0.64, 0.023, "-"), "mass": Estimate(0.0512, 0.00037, "kg")}
NAMED = Named(
    "point_mass",
    "point_mass_1",
    {},
    ("density",),
    0.976,
    MASS,
    "It shows from 60 to 80 Hz & grows with ω²; a ground_spring leaves <b>half</b> of it | and density a third.",
    0.4567,
    0.01234,
)
SCORES = (
    Scored("density", {}, 0.713, {"value": 2901.5}, ("point_mass",), 0.0456, "equivalent"),
    Scored("point_mass", {}, 0.934, {"x": 0.2, "mass": 0.05}, ("density",), 0.0123, "named"),
    Scored("time_delay", {}, 0.0421, {"delay": 3.1e-5}, (), None, "rejected: |H| is right, the phase too"),
    Scored("edge_spring", {"edge": "x1"}, 0.318, {"stiffness": 1.5e4}, (), 0.391, "rejected: 60 Hz stays"),
)
LATER = (
    Scored("sensor_gain", {}, 0.0213, {"gain": 1.01}, (), 0.0121, "rejected: less than the noise"),
    Scored("thickness", {}, 0.011, {"value": 0.0041}),
)


def model(response: Sequence[int], reference: Sequence[int], mass: bool) -> PlateModel:
    effects = {"plate": Plate(), "wires": SupportSpring(nodes=(2, 5, 11)), "loss": HystereticDamping()}
    known = dict(PLATE)
    if mass:
        effects["point_mass_1"] = PointMass()
        known |= {f"point_mass_1.{name}": one.value for name, one in MASS.items()}
    return PlateModel(Mesh(*SIDES, 3, 2), effects, known, {}, list(response), list(reference), "accelerance")


def diagnosis(
    response: Sequence[int] = (4, 7), reference: Sequence[int] = (1, 6), mass: bool = True, n_line: int = 60
) -> Diagnosis:
    """A mass is missing on a plate of twelve nodes; without `mass` the baseline is all there is."""
    frequency = torch.linspace(6.0, 330.0, n_line, dtype=torch.float64)
    last = model(response, reference, mass)
    before, after = (one.frf(one.known[:0], frequency) for one in (model(response, reference, False), last))
    generator = torch.Generator().manual_seed(3)
    noise = (0.01 * after.abs().square().mean(0).sqrt()).expand(after.shape).clone()
    white = torch.complex(*torch.randn(2, *after.shape, generator=generator, dtype=torch.float64))
    measured = Measurement(
        frequency=frequency,
        frf=after + noise * white,
        measured=torch.ones(after.shape[1:], dtype=torch.bool),
        response=tuple(map(Channel, response)),
        reference=tuple(map(Channel, reference)),
        kind="accelerance",
        unit=SI_UNIT["accelerance"],
    )
    heldout = torch.zeros(after.shape[1:], dtype=torch.bool)
    several = heldout.numel() > 1
    heldout[-1, 0] = several
    gaps = [(frf - measured.frf).norm(dim=0) / measured.frf.norm(dim=0) for frf in (before, after)]
    channels = [
        ChannelGap(
            measured.response[j].label,
            measured.reference[k].label,
            float(gaps[0][j, k]),
            float(gaps[1][j, k]),
            0.01,
            bool(heldout[j, k]),
        )
        for j, k in measured.pairs
    ]
    x, y = torch.linspace(0, 1, 9, dtype=torch.float64), torch.linspace(0, 1, 7, dtype=torch.float64)
    index = 0.87 * torch.exp(-((x - 0.2) ** 2 + (y[:, None] - 0.6) ** 2) / 0.05)
    steps = (Step("baseline", 0.4567, 0.4812, 2345.0),)
    if mass:
        steps += (Step("+ sensor_gain", 0.3111, 0.3222, 1111.0), Step("+ point_mass", 0.01234, 0.01345, 1.04))
        steps += (Step("- sensor_gain", 0.01256, 0.01367, 1.05),)
    final = (0.01256, 0.01367) if mass else (0.4567, 0.4812)
    return Diagnosis(
        verdict="explained" if mass else "unexplained",
        effects=(NAMED,) if mass else (),
        gap=Gap(0.4567, final[0], 0.4812 if several else None, final[1] if several else None, 0.0111),
        location=Location(
            bands=(Band(60.0, 80.0, 0.61), Band(200.0, 230.0, 0.22)),
            channels=tuple(sorted(channels, key=lambda one: -one.before)),
            kind={"stiffness": 0.317, "damping": 0.0231, "mass": 0.912},
            map=ForceMap(x, y, index) if several else None,
            sentences=("61 % of the misfit sits at 60 to 80 Hz.",),
        ),
        scores=(SCORES, LATER) if mass else (SCORES,),
        steps=steps if several else tuple(replace(step, heldout=None) for step in steps),
        missing=() if mass else ("Near x 0.2, y 0.6 at 60 to 80 Hz a force like a mass is missing.",),
        remarks=("plate.thickness is at the edge of its tolerance.",),
        next_measurements=("Weigh the plate.", "Move the sensor to node 6."),
        parameters={
            "plate.youngs_modulus": Estimate(6.6123e10, 1.4e7, "Pa"),
            "wires.viscous_damping": Estimate(0.70123, None, "N s/m"),
        },
        model=last,
        overlay=Overlay(measured, noise, before, after, heldout),
        n_evaluation=4321,
        seconds=12.5,
    )


class Page(HTMLParser):
    """What a browser would see: words, tables as rows of cells, pictures in words, and what it would fetch."""

    blocks = ("td", "th", "caption", "li", "p", "h1", "h2", "pre", "figcaption", "footer")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words, self.tables, self.captions, self.lists, self.images, self.fetched = "", [], [], [], [], []
        self.tags, self.ids, self.scopes, self.marked, self.block = [], [], [], [], None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append(tag)
        self.fetched += [found[key] for key in ("src", "href", "srcset", "data", "action") if key in found]
        if "id" in found:
            self.ids.append(found["id"])
        if tag == "svg":
            self.images.append(found["aria-label"])
        elif tag == "table":
            self.tables.append([])
            self.scopes.append([])
        elif tag == "tr":
            self.tables[-1].append([])
            self.scopes[-1].append([])
            self.marked.append(found.get("class") == "marked")
        elif tag in ("ol", "ul"):
            self.lists.append((tag, []))
        elif tag == "br":
            self.handle_data("\n")
        elif tag in self.blocks:
            self.block = tag
            if tag in ("td", "th"):
                self.tables[-1][-1].append("")
                self.scopes[-1][-1].append(found.get("scope"))
            elif tag == "caption":
                self.captions.append("")
            elif tag == "li":
                self.lists[-1][1].append("")

    def handle_endtag(self, tag):
        if tag == self.block:
            self.block = None
            self.words += "\n"

    def handle_data(self, data):
        if self.block is None:
            return
        # As it is read; where a line may break is asked elsewhere.
        data = data.replace("\u00a0", " ")
        self.words += data
        if self.block in ("td", "th"):
            self.tables[-1][-1][-1] += data
        elif self.block == "caption":
            self.captions[-1] += data
        elif self.block == "li":
            self.lists[-1][1][-1] += data

    def table(self, head: str) -> list[dict[str, str]]:
        """The rows of the one table whose first column is called so, by column."""
        (found,) = [table for table in self.tables if table[0][0] == head]
        return [dict(zip(found[0], row, strict=True)) for row in found[1:]]


@dataclass
class Written:
    found: Diagnosis
    folder: Path

    @property
    def markdown(self) -> str:
        return (self.folder / "report.md").read_text()

    @property
    def html(self) -> str:
        return (self.folder / "report.html").read_text()

    @property
    def page(self) -> Page:
        return Page(self.html)


def write_diagnosis(name: str, found: Diagnosis, folder: Path, command: str = "") -> None:
    write_files(folder, diagnosis_report(name, found, folder, command))


CASES = {
    "explained": lambda: diagnosis(),
    "consistent": lambda: replace(diagnosis(mass=False), verdict="consistent", missing=(), scores=()),
    "unexplained": lambda: diagnosis(mass=False),
    "single": lambda: replace(
        diagnosis((4,), (1,)),
        effects=(
            replace(NAMED, name="time_delay", label="time_delay", parameters={"delay": Estimate(3e-5, None, "s")}),
        ),
    ),
}
