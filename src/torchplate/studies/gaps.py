"""`python -m torchplate.studies.gaps`: what effects that are known to be there take off the gap of the spruce plates.

Each plate by its one FRF, first as isotropic as `make real` has it, then with one thing more at a time that is there on
any such test: the grain, the air, an accelerometer of 0.2 to 6 g at its place, a loss for each direction, and a
thickness that scatters over the plate as its readings do. Nothing is searched for that is not known to be there, and
nothing is fitted without an interval or a prior. What the model as such leaves of the FRF is far above its noise: each
is fitted beside its noise, and from there beside the error that it leaves, a part of the level around each line.

The measurement is no part of the project: without it nothing is done, which is said.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from torchplate.cli.config import dump
from torchplate.cli.config.build import load_run
from torchplate.cli.config.plate_test import plate_test
from torchplate.diagnosis import ForwardSelection, FrfTarget, PlateTest
from torchplate.measurement import Imperfections, noise_level
from torchplate.model import PlateModel, SparseModel
from torchplate.notation import percent
from torchplate.studies.moduli import CORNER, PUBLISHED, SENSOR
from torchplate.studies.real import CASES, CONFIGS, N_MODE, OUT

# Readings of the thickness scatter within a plate by 0.1 to 0.16 mm of 5 mm; five smooth terms share that [-].
SCATTER = 0.026 / 5**0.5
TERMS = ("a10", "a01", "a11", "a20", "a02")
LOSS = {"low": 2.0e-3, "high": 5.0e-2, "scale": "log"}
# What is added, in turn.
STEPS = ("isotropic", "grain", "air", "sensor", "loss by direction", "thickness")


@dataclass(frozen=True)
class Left:
    """What a model leaves.

    Attributes:
        gap: of the FRF [-].
        peaks: greatest relative distance of a peak below 600 Hz from the model [-].
        moduli: E_x, E_y, G_xy [GPa].
    """

    gap: float
    peaks: float
    moduli: tuple[float, float, float]


def config(raw: Mapping[str, Any], n_step: int) -> dict[str, Any]:
    """The config of a plate with so many steps after the first.

    Args:
        raw: of the isotropic plate.
        n_step: 0 for that one.
    """
    sides = [raw["mesh"][key]["value"] for key in ("length_x", "length_y")]
    effects = dict(raw["effects"])
    added: tuple[tuple[str, dict[str, Any]], ...] = (
        (
            "grain",
            {
                "effect": "orthotropy",
                "young_ratio": {"low": 0.03, "high": 0.3, "scale": "log"},
                "shear_factor": {"low": 0.2, "high": 5.0, "scale": "log"},
            },
        ),
        ("air", {"effect": "air_loading", "density": 1.2}),
        (
            "sensor",
            {
                "effect": "point_mass",
                **{key: round(1 - CORNER / side, 5) for key, side in zip("xy", sides, strict=True)},
                "mass": {"low": SENSOR[0], "high": SENSOR[1], "scale": "log"},
            },
        ),
        ("loss", {"effect": "directional_damping", "loss_x": LOSS, "loss_y": LOSS, "loss_xy": LOSS}),
        (
            "calliper",
            {"effect": "thickness_field", **{name: {"value": 0.0, "std": round(SCATTER, 4)} for name in TERMS}},
        ),
    )
    effects.update(added[:n_step])
    measurement = raw["measurement"] | {"file": str((CONFIGS / raw["measurement"]["file"]).resolve())}
    return {"mesh": raw["mesh"], "measurement": measurement, "effects": effects, "search": {"seed": 0}}


@torch.no_grad()
def steps(plate: str) -> list[Left] | None:
    """What each model of a plate leaves, one step after another; None where its measurement is absent.

    Args:
        plate: "5L", say.
    """
    recipe = load_run(CONFIGS / f"spruce_{plate}.yaml")
    if not recipe.has_file:
        return None
    found: list[Left] = []
    folder = OUT / "gaps"
    folder.mkdir(parents=True, exist_ok=True)
    for n_step, step in enumerate(STEPS):
        path = folder / f"{plate}_{n_step}_{step.replace(' ', '_')}.yaml"
        path.write_text(dump(config(recipe.raw, n_step)), encoding="utf-8")
        selection = _selection(plate_test(load_run(path)))
        _, state = selection.inflated(selection.baseline())
        found.append(_left(plate, state.fit.model, state.fit.theta, state.fit.gap))
    return found


def _selection(test: PlateTest) -> ForwardSelection:
    measurement = test.measurement
    assert measurement is not None
    nothing = torch.zeros_like(measurement.measured)
    noise = noise_level(measurement, test.n_average)
    target = FrfTarget(measurement, noise, nothing, test.gain_is_unknown, test.imperfections or Imperfections())
    return ForwardSelection.of(test.model, target, dict(test.tolerance or {}), lambda _: None)


def _left(plate: str, model: PlateModel, theta: torch.Tensor, gap: float) -> Left:
    peaks = next(one for one in CASES if one.name == f"spruce_{plate}").peaks
    modes = SparseModel(model, theta).modes(N_MODE, 1.1 * max(peaks)).frequency
    off = max(float((modes / peak - 1).abs().min()) for peak in peaks)
    value = model.values(theta)
    young = float(value["plate"]["youngs_modulus"]) / 1e9
    grain = value.get("grain")
    ratio, shear = (1.0, 1.0) if grain is None else (float(grain[key]) for key in ("young_ratio", "shear_factor"))
    poisson = float(value["plate"]["poisson_ratio"])
    return Left(gap, off, (young / ratio**0.5, young * ratio**0.5, shear * young / (2 * (1 + poisson))))


def main(chosen: Sequence[str] = ()) -> None:
    """Every plate, or those chosen, and a table."""
    console = Console(width=150)
    table = Table("plate", "with", "gap", "peaks within", "E_x, E_y, G_xy, GPa")
    for plate in chosen or PUBLISHED:
        found = steps(plate)
        if found is None:
            console.print(f"left out: the measurement of {plate} is no part of the project, and none is there")
            continue
        for step, left in zip(STEPS, found, strict=True):
            title = step if step == STEPS[0] else f"+ {step}"
            moduli = ", ".join(f"{value:.3g}" for value in left.moduli)
            table.add_row(plate, title, percent(left.gap), percent(left.peaks), moduli)
        table.add_row(plate, "published", "", "", ", ".join(f"{value:g}" for value in PUBLISHED[plate]))
    console.print(table)


if __name__ == "__main__":
    main(sys.argv[1:])
