"""What every test has and nobody wants named: how large it is, one draw of it, and a plate and a test with it.

| nuisance | standard deviation |
|---|---|
| place of each hit and each sensor, along each side | 2 mm |
| each side | 0.3 mm |
| thickness: its mean, and its wander over the plate | 0.5 %, 0.5 % |
| density | 0.4 % |
| modulus wandering over the plate | 0.5 % |
| grain, Ey/Ex | 1 % |
| damping of each mode, log-normal | 15 % |
| each accelerometer that stays at its place | 3 ± 0.4 g |
| natural frequencies from record to record, one record for each hit's place | 2e-4 |
| level of each channel | 1 % |

The config is told all but the wander and the grain, for which it has no words.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from blind.plates import Rng, Specimen
from blind.response import Chain, Place
from blind.ritz import N_WANDER

# More of these and nobody has so many accelerometers: a laser reads the motion, and weighs nothing.
N_ACCELEROMETER = 4
# Modes whose damping scatters: more than the band holds.
N_SCATTERED = 80


@dataclass(frozen=True)
class Imperfect:
    """Standard deviations, as in the table above."""

    position: float = 2e-3  # [m]
    side: float = 3e-4  # [m]
    thickness: float = 0.005  # [-]
    wander: float = 0.005  # of thickness and of modulus, each [-]
    density: float = 0.004  # [-]
    grain: float = 0.01  # [-]
    damping: float = 0.15  # [-]
    sensor: float = 3e-3  # [kg]
    sensor_std: float = 4e-4  # [kg]
    drift: float = 2e-4  # [-]
    calibration: float = 0.01  # [-]

    def told(self) -> dict[str, float]:
        """The keys of a config's `measurement`."""
        return {
            "position_std": self.position, "frequency_drift": self.drift,
            "calibration_std": self.calibration, "damping_scatter": self.damping,
        }  # fmt: skip


WORKSHOP = Imperfect()
CLEAN = {"position_std": 0.0, "frequency_drift": 0.0, "calibration_std": 0.0, "damping_scatter": 0.0}


@dataclass(frozen=True)
class Drawn:
    """A specimen as it is, and the chain that its test goes through before anything is hidden."""

    specimen: Specimen
    chain: Chain
    # Nominal places of the accelerometers that weigh something.
    accelerometers: tuple[Place, ...]


def spoil(rng: Rng, specimen: Specimen, std: Imperfect, hidden: frozenset[str], slip: bool) -> Drawn:
    """The specimen with one draw of all nuisances.

    Args:
        rng: where the numbers come from.
        specimen: a perfect one.
        std: how large they are.
        hidden: names of what will be hidden.
        slip: whether what is hidden contradicts a number that is stated with a std (else that number has none).
    """
    kind = specimen.kind
    sheet = {
        "length_x": (kind.sides[0], std.side), "length_y": (kind.sides[1], std.side),
        "thickness": (kind.thickness, float(f"{std.thickness * kind.thickness:.4g}")),
        "density": (kind.density, float(f"{std.density * kind.density:.4g}")),
    }  # fmt: skip
    wrong = {"length_x", "length_y"} if "aspect_ratio" in hidden else hidden & {"thickness", "density"}
    stated, real = {}, {}
    for name, (value, spread) in sheet.items():
        real[name] = value + spread * float(rng.standard_normal())
        stated[name] = {"value": value, "std": spread}
        if name in wrong and not slip:
            stated[name], real[name] = {"value": value}, value
    coefficient = std.wander / np.sqrt(N_WANDER)
    plate = replace(
        specimen.plate,
        **real,
        thickness_wander=tuple((coefficient * rng.standard_normal(N_WANDER)).tolist()),
        modulus_wander=tuple((coefficient * rng.standard_normal(N_WANDER)).tolist()),
        young_ratio=float(np.exp(std.grain * rng.standard_normal())),
    )
    test = specimen.test
    shape = len(test.response), len(test.reference)
    moved = replace(
        test,
        response=_moved(rng, test.response, std.position, plate.sides),
        reference=_moved(rng, test.reference, std.position, plate.sides),
    )
    masses = std.sensor + std.sensor_std * rng.standard_normal(shape[0])
    weighs = shape[0] <= N_ACCELEROMETER
    if weighs:
        plate = replace(plate, masses=[(*at, float(m)) for at, m in zip(moved.response, masses, strict=True)])
    gains = [1 + std.calibration * rng.standard_normal(n) for n in shape]
    chain = Chain(calibration=np.outer(*gains), drift=std.drift * rng.standard_normal(shape[1]))
    scatter = tuple(np.exp(std.damping * rng.standard_normal(N_SCATTERED)).tolist())
    damping = replace(specimen.damping, scatter=scatter)
    spoilt = replace(specimen, plate=plate, damping=damping, test=moved, stated=stated)
    return Drawn(spoilt, chain, tuple((x, y) for x, y in test.response) if weighs else ())


def _moved(rng: Rng, places: Sequence[Place], std: float, sides: tuple[float, float]) -> list[Place]:
    """Each off its mark along both sides; what would miss the plate lands as far within it."""
    at = np.asarray(places, float) + std * rng.standard_normal((len(places), 2)) / sides
    folded = 1 - np.abs(1 - np.abs(at))
    return [(float(x), float(y)) for x, y in folded]
