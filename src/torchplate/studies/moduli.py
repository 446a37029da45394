"""`python -m torchplate.studies.moduli`: what air and a sensor do to the moduli of the measured spruce plates.

Each plate by its peaks alone, orthotropic along its sides: as a model that has only the plate, in a vacuum; with the
air; and with an accelerometer in the corner too, of a mass that is given or of one that nobody wrote down. That mass is
one more unknown then, between those of the lightest and the heaviest accelerometer that one glues to wood. Each variant
leaves its config in `runs/real/moduli`. The published moduli stand beside them, with how far the peaks are from the
modes of a plate of these in a vacuum.

Which mode makes which peak is found with the moduli: modes and peaks are paired in their order, so that the sum of
squared deviations is least, and the plate is fitted again until the pairs stay. Peaks above 450 Hz are left out: modes
lie there closer to each other than the model is to the plate.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from torchplate.cli.config import dump
from torchplate.cli.config.build import load_run
from torchplate.cli.config.plate_test import plate_test
from torchplate.diagnosis import PlateTest, fitted_table
from torchplate.model import PlateModel, SparseModel
from torchplate.notation import percent
from torchplate.studies.real import CASES, CONFIGS, OUT

# Published E_x, E_y, G_xy [GPa].
PUBLISHED = {"5L": (12.1, 0.999, 0.798), "1L": (9.65, 0.783, 0.513), "3R": (8.80, 0.784, 0.878)}
# √(ν_x ν_y) of spruce.
POISSON = 0.1
# The hammer's and the sensor's distance from the sides [m].
CORNER = 0.02
# Peaks up to here are compared [Hz].
HIGHEST = 450.0
# Of a mode: a thickness that scatters by 0.13 mm of 5 mm moves each mode by some 0.7 % of its own.
SCATTER = 7e-3
# From a miniature accelerometer to one of the usual kind [kg].
SENSOR = (2e-4, 6e-3)
N_TURN = 4
N_DRAW = 4000


@dataclass(frozen=True)
class Variant:
    """What is taken to be there beside the plate.

    Attributes:
        name: of its config.
        title: in the table.
        air: density of the air [kg/m³].
        sensor: mass of the sensor [kg], 0 where there is none; an interval where it is not known.
    """

    name: str
    title: str
    air: float = 0.0
    sensor: float | tuple[float, float] = 0.0


VARIANTS = (
    Variant("plate", "the plate alone"),
    Variant("air", "with air", 1.2),
    Variant("sensor_1", "with air and a sensor of 1 g", 1.2, 1e-3),
    Variant("sensor_3", "with air and a sensor of 3 g", 1.2, 3e-3),
    Variant("sensor_open", "with air and a sensor of 0.2 to 6 g", 1.2, SENSOR),
)


@dataclass(frozen=True)
class Moduli:
    """What a variant gave.

    Attributes:
        interval: quantiles 0.05, 0.5 and 0.95 of E_x, E_y, G_xy [GPa], of the sensor's mass [g] too where it is open.
        off: root mean square of the relative deviation of the peaks [-].
        modes: which mode makes each peak, counted from 1.
    """

    interval: Float[Tensor, "n_quantity 3"]
    off: float
    modes: tuple[int, ...]


def paired(model: Sequence[float], peaks: Sequence[float]) -> tuple[int, ...]:
    """Indices of the modes that make the peaks, in order: the sum of squared relative deviations is least.

    Args:
        model: natural frequencies, the lowest first [Hz]; no fewer than peaks.
        peaks: as measured, likewise.
    """
    cost: list[tuple[float, tuple[int, ...]]] = [(0.0, ()), *((math.inf, ()) for _ in peaks)]
    for index, hertz in enumerate(model):
        for count in range(len(peaks), 0, -1):
            value, taken = cost[count - 1]
            value += (hertz / peaks[count - 1] - 1) ** 2
            if value < cost[count][0]:
                cost[count] = (value, (*taken, index))
    return cost[-1][1]


def config(plate: str, variant: Variant, peaks: Sequence[float], modes: Sequence[int]) -> dict[str, Any]:
    """The config of a plate and a variant: sides, density and thickness are those of `make real`."""
    raw = load_run(CONFIGS / f"spruce_{plate}.yaml").raw
    sides = [raw["mesh"][key]["value"] for key in ("length_x", "length_y")]
    base = raw["effects"]["plate"] | {"poisson_ratio": POISSON}
    grain = {
        "effect": "orthotropy",
        "young_ratio": {"low": 0.03, "high": 0.3, "scale": "log"},
        "shear_factor": {"low": 0.2, "high": 5.0, "scale": "log"},
    }
    effects: dict[str, Any] = {"plate": base, "grain": grain}
    if variant.air:
        effects["air"] = {"effect": "air_loading", "density": variant.air}
    if variant.sensor:
        mass = variant.sensor
        low_high = {} if isinstance(mass, float) else {"low": mass[0], "high": mass[1], "scale": "log"}
        place = {key: round(1 - CORNER / side, 5) for key, side in zip("xy", sides, strict=True)}
        effects["sensor"] = {"effect": "point_mass", **place, "mass": low_high or mass}
    table = {mode: {"value": hertz, "std": round(SCATTER * hertz, 3)} for mode, hertz in zip(modes, peaks, strict=True)}
    mesh = raw["mesh"]
    return {"mesh": mesh, "measurement": {"natural_frequencies": table}, "effects": effects, "search": {"seed": 0}}


@torch.no_grad()
def moduli(plate: str, variant: Variant) -> Moduli:
    """Fit a plate by its peaks.

    Args:
        plate: "5L", say.
        variant: what is there beside it.
    """
    peaks = _peaks(plate)
    model = _given(plate, variant, peaks, range(4, 4 + len(peaks))).model
    # From the published moduli, which are near in any case.
    modes, _ = _numbered(model, _published(model, plate), peaks)
    for _ in range(N_TURN):
        test = _given(plate, variant, peaks, modes)
        assert test.natural_frequencies is not None
        found = fitted_table(test.model, test.natural_frequencies, test.tolerance)
        before, (modes, _) = modes, _numbered(found.model, found.theta, peaks)
        if modes == before:
            break
    off = (found.predicted / found.predicted.new_tensor(peaks) - 1).square().mean().sqrt()
    return Moduli(_quantiles(found.model, _draws(found.position, found.precision)), float(off), before)


def _given(plate: str, variant: Variant, peaks: Sequence[float], modes: Sequence[int]) -> PlateTest:
    """The model and the table that it is held against, by way of a config."""
    folder = OUT / "moduli"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{plate}_{variant.name}.yaml"
    path.write_text(dump(config(plate, variant, peaks, modes)), encoding="utf-8")
    return plate_test(load_run(path))


@torch.no_grad()
def off_published(plate: str) -> float:
    """Root mean square of the peaks' relative distance from the modes of the published moduli in a vacuum [-]."""
    peaks = _peaks(plate)
    model = _given(plate, VARIANTS[0], peaks, range(4, 4 + len(peaks))).model
    return _numbered(model, _published(model, plate), peaks)[1]


def _peaks(plate: str) -> list[float]:
    case = next(one for one in CASES if one.name == f"spruce_{plate}")
    return [hertz for hertz in case.peaks if hertz <= HIGHEST]


def _published(model: PlateModel, plate: str) -> Float[Tensor, " n"]:
    """A point of a model's box that has the published moduli, all else in its middle, in SI units."""
    e_x, e_y, g = (1e9 * value for value in PUBLISHED[plate])
    e = (e_x * e_y) ** 0.5
    at = {"plate.youngs_modulus": e, "grain.young_ratio": e_y / e_x, "grain.shear_factor": 2 * (1 + POISSON) * g / e}
    theta = model.space.to_si(model.known.new_full((len(model.names),), 0.5))
    for key, value in at.items():
        theta[model.names.index(key)] = value
    return theta


def _numbered(model: PlateModel, theta: Float[Tensor, " n"], peaks: Sequence[float]) -> tuple[tuple[int, ...], float]:
    """Which mode makes each peak, counted from 1 with the three of the rigid body; and how far they are, rms [-]."""
    found: list[float] = SparseModel(model, theta).modes(30, 1.2 * peaks[-1]).frequency.tolist()
    taken = paired(found[3:], peaks)
    square = [(found[3 + index] / peak - 1) ** 2 for index, peak in zip(taken, peaks, strict=True)]
    return tuple(index + 4 for index in taken), (sum(square) / len(square)) ** 0.5


def _draws(position: Float[Tensor, " n"], precision: Float[Tensor, "n n"]) -> Float[Tensor, "n_draw n"]:
    """Of the posterior on the unit cube."""
    generator = torch.Generator().manual_seed(0)
    normal = torch.randn(N_DRAW, len(position), generator=generator, dtype=torch.float64)
    lower = torch.linalg.cholesky(precision)
    return (position + torch.linalg.solve_triangular(lower.mT, normal.mT, upper=True).mT).clamp(0, 1)


def _quantiles(model: PlateModel, draws: Float[Tensor, "n_draw n"]) -> Float[Tensor, "n_quantity 3"]:
    value = dict(zip(model.names, model.space.to_si(draws).unbind(-1), strict=True))
    e, ratio = value["plate.youngs_modulus"] / 1e9, value["grain.young_ratio"]
    shear = value["grain.shear_factor"] * e / (2 * (1 + POISSON))
    stated = [e / ratio.sqrt(), e * ratio.sqrt(), shear]
    if "sensor.mass" in value:
        stated.append(1e3 * value["sensor.mass"])
    at = torch.tensor([0.05, 0.5, 0.95], dtype=torch.float64)
    return torch.stack(stated).quantile(at, dim=-1).mT


def main(chosen: Sequence[str] = ()) -> None:
    """Every plate, or those chosen, and a table."""
    console = Console(width=170)
    table = Table("plate", "taken to be there", "E_x, GPa", "E_y, GPa", "G_xy, GPa", "sensor, g", "peaks within (rms)")
    for plate in chosen or PUBLISHED:
        off = percent(off_published(plate))
        table.add_row(plate, "published", *(f"{value:g}" for value in PUBLISHED[plate]), "", off)
        for variant in VARIANTS:
            found = moduli(plate, variant)
            known = (*PUBLISHED[plate], None)
            cells = [_cell(row.tolist(), value) for row, value in zip(found.interval, known, strict=False)]
            table.add_row(plate, variant.title, *cells, *[""] * (4 - len(cells)), percent(found.off))
    console.print(table)
    console.print("90 % intervals; * covers the published value.")


def _cell(row: Sequence[float], known: float | None) -> str:
    low, middle, high = row
    covers = known is not None and low <= known <= high
    return f"{middle:.3g} ({low:.3g} to {high:.3g}){'*' if covers else ''}"


if __name__ == "__main__":
    main(sys.argv[1:])
