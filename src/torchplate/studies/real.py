"""`make real`: plates that others have measured, and the paper's own printed table, each diagnosed.

The measurements are no part of the project: cases whose file is absent are left out, which is said. Every case leaves
its folder in `runs/real`; the table at the end says what was found beside what is known.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from torchplate.cli.config import InputError
from torchplate.cli.config.build import load_run
from torchplate.cli.verbs.diagnose import diagnose
from torchplate.diagnosis import Diagnosis
from torchplate.measurement import MeasurementError
from torchplate.model import SparseModel
from torchplate.notation import percent

CONFIGS = Path("configs/real")
OUT = Path("runs/real")
# Modes of the found model among which those of the measured peaks are looked for.
N_MODE = 40


@dataclass(frozen=True)
class Case:
    """One measured plate.

    Attributes:
        name: of its config, and of its folder.
        title: what it is.
        peaks: measured natural frequencies [Hz] that the found model is held against.
        known: what is known of the answer, in a few words.
        values: what is worth comparing with that, from a finished diagnosis.
    """

    name: str
    title: str
    peaks: tuple[float, ...]
    known: str
    values: Callable[[Diagnosis], str]


@dataclass(frozen=True)
class Found:
    """What a case gave.

    Attributes:
        case: which.
        diagnosis: what the workflow says.
        nearest: the found model's natural frequency nearest to each peak [Hz].
    """

    case: Case
    diagnosis: Diagnosis
    nearest: tuple[float, ...]

    @property
    def worst(self) -> float:
        """The largest relative distance of a peak from the model [-]."""
        pairs = zip(self.nearest, self.case.peaks, strict=True)
        return max((abs(here / peak - 1) for here, peak in pairs), default=0.0)


def value_of(found: Diagnosis, name: str) -> tuple[float, float] | None:
    """Value and standard error of the first parameter whose name ends so; None where the model has none.

    Args:
        found: a diagnosis.
        name: "youngs_modulus", say; the label before it does not matter.
    """
    for key, one in found.parameters.items():
        if key.rpartition(".")[2] == name:
            return one.value, one.std or 0.0
    return None


def moduli(found: Diagnosis) -> str:
    """E_x, E_y and G_xy in GPa, with standard errors."""
    modulus = value_of(found, "youngs_modulus")
    if modulus is None:
        return ""
    value, std = modulus
    ratio, ratio_std = value_of(found, "young_ratio") or (1.0, 0.0)
    shear, shear_std = value_of(found, "shear_factor") or (1.0, 0.0)
    poisson = next(
        float(found.model.values(torch.zeros(0, dtype=torch.float64))[label]["poisson_ratio"])
        for label, effect in found.model.effects.items()
        if effect.name == "plate"
    )
    side = (ratio_std / ratio / 2, shear_std / shear)
    stated = (
        ("E_x", value / ratio**0.5, side[0]),
        ("E_y", value * ratio**0.5, side[0]),
        ("G_xy", shear * value / (2 * (1 + poisson)), side[1]),
    )
    parts = (
        f"{name} {x / 1e9:.3g} ± {x / 1e9 * (part**2 + (std / value) ** 2) ** 0.5:.2g}" for name, x, part in stated
    )
    return ", ".join(parts) + " GPa"


def modulus(found: Diagnosis) -> str:
    """E in GPa, with its standard error."""
    value = value_of(found, "youngs_modulus")
    return "" if value is None else f"E {value[0] / 1e9:.4g} ± {value[1] / 1e9:.2g} GPa"


def wave_speed(found: Diagnosis) -> str:
    """The one number that a strip of unknown material tells: h √(E/ρ), with ρ 1000 kg/m³ and h 10 mm set."""
    value = value_of(found, "youngs_modulus")
    return "" if value is None else f"h√(E/ρ) {0.01 * (value[0] / 1000.0) ** 0.5:.4g} m²/s"


SPRUCE = "wood is stiff along the grain; published E_x, E_y, G_xy in GPa: "
CASES = (
    Case(
        "spruce_5L",
        "spruce plate 5L as isotropic",
        (56.5, 81.0, 140.0, 162.5, 196.0, 221.0, 276.0, 293.0, 426.5, 435.0, 484.5, 558.5),
        SPRUCE + "12.1, 0.999, 0.798",
        moduli,
    ),
    Case(
        "spruce_1L",
        "spruce plate 1L as isotropic",
        (47.5, 70.5, 120.5, 174.0, 200.0, 243.5, 263.5, 384.5, 419.0, 429.5, 502.0, 575.0),
        SPRUCE + "9.65, 0.783, 0.513",
        moduli,
    ),
    Case(
        "spruce_3R",
        "spruce plate 3R as isotropic",
        (60.5, 71.0, 139.5, 159.5, 200.0, 261.5, 292.5, 383.5, 421.5, 437.0, 564.5),
        SPRUCE + "8.80, 0.784, 0.878",
        moduli,
    ),
    Case(
        "cantilever",
        "steel strip clamped and shaken",
        (139.2, 903.3),
        "E 198 GPa nominal; the clamp gives, or the sensor is heavier; a feature at 663 Hz is the fixture's",
        modulus,
    ),
    Case(
        "free_strip",
        "free strip of unknown material, its FRFs",
        (),
        "the phases say nothing: no model explains these FRFs",
        wave_speed,
    ),
    Case(
        "free_strip_peaks",
        "free strip of unknown material, its peaks",
        (27.0, 45.0, 53.0, 88.0, 131.5, 184.0, 245.5),
        "h√(E/ρ) 14.85 m²/s; six bending modes and a torsion mode from one scale",
        wave_speed,
    ),
    Case(
        "wood_A",
        "wood A as isotropic, one edge clamped",
        (52.0, 98.0, 311.0, 337.0, 398.0, 637.0),
        "wood is stiff along the grain, which lies along x",
        moduli,
    ),
    Case(
        "wood_B",
        "wood B as isotropic, one edge clamped",
        (87.0, 160.0, 540.0, 616.0, 651.0, 1061.0),
        "wood is stiff along the grain, which lies along x",
        moduli,
    ),
    Case(
        "paper_table5",
        "the paper's printed Table 5, from its Table 4",
        (4.8, 6.8, 8.5, 68.4, 171.4, 178.4, 193.6, 292.8, 293.9, 327.0, 343.7, 364.7, 368.4),
        "a second assembly of the same element differs by up to 1.2 %; why is not known",
        modulus,
    ),
)


def main(names: Sequence[str] = ()) -> int:
    """Diagnose the cases of these names, or all; returns the exit status."""
    console = Console(width=150)
    began = time.monotonic()
    cases = [case for case in CASES if not names or case.name in names]
    if not cases:
        print(f"Expected names of cases ({', '.join(case.name for case in CASES)}), got none.", file=sys.stderr)
        return 2
    found = []
    try:
        for case in cases:
            console.rule(f"{case.name}: {case.title}")
            one = examine(case, console)
            if one is not None:
                found.append(one)
    except (InputError, MeasurementError) as error:
        print(error, file=sys.stderr)
        return 2
    if found:
        show(found, console)
    console.print(f"{len(found)} of {len(cases)} cases in {time.monotonic() - began:.0f} s. Results lie in {OUT}.")
    return 0


def examine(
    case: Case, console: Console, out: Path = OUT, overrides: Sequence[str] = (), report: bool = True
) -> Found | None:
    """Diagnose one case; None, with a word, where its measurement is absent.

    Args:
        case: which.
        console: where progress goes.
        out: its folder is made in this one.
        overrides: "key.key=value" each.
        report: whether to write the report, too.
    """
    path = CONFIGS / f"{case.name}.yaml"
    recipe = load_run(path, overrides)
    file = recipe.config.measurement.file
    if file is not None and not recipe.has_file:
        console.print(f"left out: the measurement is no part of the project, and none is at {path.parent / file}")
        return None
    diagnosis = diagnose(path, out / case.name, overrides, report=report, console=console, force=True)
    return Found(case, diagnosis, _nearest(case, diagnosis))


def _nearest(case: Case, found: Diagnosis) -> tuple[float, ...]:
    """The found model's natural frequency nearest to each peak."""
    if not case.peaks:
        return ()
    modes = SparseModel(found.model, torch.zeros(0, dtype=torch.float64)).modes(N_MODE, 1.1 * max(case.peaks))
    return tuple(float(modes.frequency[(modes.frequency - peak).abs().argmin()]) for peak in case.peaks)


def show(found: Sequence[Found], console: Console) -> None:
    """One table for all cases, and the peaks of each beside the model's."""
    table = Table("case", "verdict", "named (as good as it; confidence)", "gap", "peaks within", "found", "known")
    for one in found:
        diagnosis = one.diagnosis
        gap = diagnosis.gap
        table.add_row(
            one.case.name,
            diagnosis.verdict,
            "; ".join(
                f"{effect.name} ({', '.join(effect.equivalent) or 'none'}; {effect.confidence:.2f})"
                for effect in diagnosis.effects
            )
            or "nothing",
            f"{percent(gap.baseline)} to {percent(gap.final)}, noise {percent(gap.noise_floor)}",
            percent(one.worst) if one.nearest else "",
            one.case.values(diagnosis) + (", not to be believed" if diagnosis.verdict == "unexplained" else ""),
            one.case.known,
        )
    console.print(table)
    for one in found:
        pairs = zip(one.case.peaks, one.nearest, strict=True)
        beside = ", ".join(f"{peak:g} Hz {percent(here / peak - 1, decimals=1, signed=True)}" for peak, here in pairs)
        console.print(f"{one.case.name}: {beside or 'no peaks compared'}", highlight=False)
        for sentence in one.diagnosis.missing:
            console.print(f"  {sentence}", highlight=False)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
