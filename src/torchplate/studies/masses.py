"""`python -m torchplate.studies.masses`: a measured strip that loses mass, state by state.

One clamped strip with six masses, in three arrangements of four states each: a, then b, c and d with 2.96, 5.92 and
8.87 % of mass lost. Nothing else is told: not the material, the width, the level, the place of the hit, nor which mass
was lightened. Levels and phases of these records change from state to state by more than any model says, the peaks do
not: their frequencies are what is compared. Each mass is taken to be a part of the strip's mass that `MASS` says, which
the peaks of a do not tell; what they tell is the change. Every model error that is the same in all states cancels.

The measurement is no part of the project: without it nothing is done, which is said. Source: de Sousa and Machado,
Experimental vibration dataset collected of a beam reinforced with masses under different health conditions, Data in
Brief (2024).
"""

import itertools
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from torchplate.cli.config import dump
from torchplate.cli.verbs.diagnose import diagnose
from torchplate.measurement import Measurement, read_measurement
from torchplate.notation import number_of_percent

DATA = Path("../shared/data")
OUT = Path("runs/real/masses")
# Distances of the masses from the clamp [m].
ARRANGEMENTS = {
    "3": (0.068, 0.091, 0.140, 0.191, 0.255, 0.309),
    "10": (0.086, 0.117, 0.148, 0.208, 0.263, 0.288),
    "20": (0.064, 0.098, 0.165, 0.207, 0.247, 0.318),
}
STATES = ("a", "b", "c", "d")
# Parts of mass lost, as published; of which mass is not said.
KNOWN = {"b": 0.0296, "c": 0.0592, "d": 0.0887}
LENGTH, THICKNESS, DENSITY = 0.38, 0.00475, 7850.0
# So narrow that its first torsion lies above its fifth bending, whose frequencies do not depend on the width.
WIDTH = 0.01
STRIP = LENGTH * WIDTH * THICKNESS * DENSITY
# Each of the six over the strip's mass [-]: no mass can lose more than it weighs. The published steps are equal.
MASS = 0.04
# Where a peak of each bending mode is looked for [Hz]: around those of a strip, between the lines of the fixture.
BANDS = ((15.0, 28.0), (120.0, 160.0), (340.0, 450.0), (650.0, 779.0), (1080.0, 1215.0))
# Peaks are read to a line's spacing: that of a uniform distribution, of both ends of a difference.
SPACING = 0.3125


@dataclass(frozen=True)
class Lost:
    """What was found of one state.

    Attributes:
        arrangement: of the masses.
        state: which.
        share: mass lost over the strip's [-]; negative where mass came; None where no mass is named.
        std: of that.
        kind: the names, each with those that the tables cannot tell from it.
    """

    arrangement: str
    state: str
    share: float | None
    std: float
    kind: str


def peaks(measurement: Measurement) -> list[float]:
    """The frequency of the highest line in each band, between lines by a parabola through three [Hz]."""
    frequency, level = measurement.frequency, measurement.frf[:, 0, 0].abs().log()
    found = []
    for low, high in BANDS:
        inside = (frequency >= low) & (frequency <= high)
        at = int(torch.where(inside, level, -torch.inf).argmax())
        before, top, after = (float(level[at + k]) for k in (-1, 0, 1))
        bend = before - 2 * top + after
        off = 0.5 * (before - after) / bend if bend < 0 else 0.0
        found.append(float(frequency[at]) + max(-0.5, min(0.5, off)) * SPACING)
    return found


def config(arrangement: str, data: Path) -> dict[str, Any]:
    """A config whose states are the four of an arrangement, each a table of its peaks."""
    std = round(SPACING / 12**0.5, 3)
    states = [
        {
            "name": state,
            "natural_frequencies": {
                mode: {"value": round(hertz, 3), "std": std}
                for mode, hertz in enumerate(peaks(read_measurement(data / f"masses_{arrangement}{state}.uff")), 1)
            },
        }
        for state in STATES
    ]
    effects: dict[str, Any] = {
        "plate": {
            "effect": "plate",
            "youngs_modulus": [1.0e11, 4.0e11],
            "poisson_ratio": 0.3,
            "density": DENSITY,
            "thickness": THICKNESS,
        }
    }
    for number, place in enumerate(ARRANGEMENTS[arrangement], 1):
        mass = {"effect": "point_mass", "x": round(place / LENGTH, 5), "y": 0.5, "mass": round(MASS * STRIP, 6)}
        effects[f"m{number}"] = mass
    mesh = {"length_x": LENGTH, "length_y": WIDTH, "n_x": 19, "n_y": 1, "edges": {"x0": "clamped"}}
    return {"mesh": mesh, "measurement": states, "effects": effects, "search": {"seed": 0}}


def lost(arrangement: str, state: str, found: Mapping[str, Any]) -> Lost:
    """What a diagnosis.json says of the mass: the sum of all masses that changed."""
    share, variance, kinds, massless = 0.0, 0.0, [], True
    for one in found["effects"]:
        kinds.append(str(one["name"]) + "".join(f" or {name}" for name in one["equivalent"]))
        mass = one["parameters"].get("mass")
        if mass is None:
            continue
        massless = False
        before = MASS * STRIP if one["name"].endswith(".mass") else 0.0
        share += (before - mass["value"]) / STRIP
        variance += ((mass["std"] or 0.0) / STRIP) ** 2
    kind = "; ".join(kinds) or str(found["verdict"])
    return Lost(arrangement, state, None if massless else share, variance**0.5, kind)


def order(rows: Sequence[Lost]) -> str:
    """Whether an arrangement's states lost more mass one after another, in a sentence.

    Args:
        rows: of b, c and d.
    """
    unnamed = [row.state for row in rows if row.share is None]
    shares = [0.0, *(row.share for row in rows if row.share is not None)]
    grows = all(one < other for one, other in itertools.pairwise(shares))
    said = f"no mass is named in {', '.join(unnamed)}; the others are" if unnamed else "a < b < c < d:"
    return f"arrangement {rows[0].arrangement}: {said} {'in' if grows else 'out of'} order"


def main(chosen: Sequence[str] = ()) -> None:
    """Every arrangement, or those chosen, and a table of what was lost."""
    console = Console(width=150)
    if not (DATA / "masses_3a.uff").exists():
        console.print(f"{DATA}: Expected the measured strips, found none. Left out.", markup=False)
        return
    rows: list[Lost] = []
    for arrangement in chosen or ARRANGEMENTS:
        folder = OUT / arrangement
        folder.mkdir(parents=True, exist_ok=True)
        path = folder.parent / f"masses_{arrangement}.yaml"
        path.write_text(dump(config(arrangement, DATA)), encoding="utf-8")
        diagnose(path, folder, console=console, force=True)
        for state in STATES[1:]:
            content = json.loads((folder / state / "diagnosis.json").read_text())
            rows.append(lost(arrangement, state, content))
    console.print(_table(rows))
    for arrangement in chosen or ARRANGEMENTS:
        console.print(order([row for row in rows if row.arrangement == arrangement]))


def _table(rows: Sequence[Lost]) -> Table:
    table = Table("arrangement", "state", "what changed", "mass lost, % of the strip", "90 %", "known, %")
    for row in rows:
        known, amount, interval = number_of_percent(KNOWN[row.state], decimals=2), "none named", ""
        if row.share is not None:
            low, high = (number_of_percent(row.share + k * 1.645 * row.std, decimals=2) for k in (-1, 1))
            amount, interval = number_of_percent(row.share, decimals=2), f"{low} to {high}"
        table.add_row(row.arrangement, row.state, row.kind, amount, interval, known)
    return table


if __name__ == "__main__":
    main(sys.argv[1:])
