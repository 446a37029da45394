"""Where the gap of the measured strip sits, and what is left if each peak has a frequency and a loss of its own.

`python -m tests.studies.strip_by_band` diagnoses the strip as `make real` does, and goes on from what that names. A
field without a name, and the numbers that are fitted beside it, are left out.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Complex, Float
from rich.console import Console
from scipy.optimize import least_squares
from torch import Tensor

from torchplate.cli.config.build import load_run
from torchplate.cli.config.plate_test import plate_test
from torchplate.diagnosis import Diagnosis
from torchplate.model import PlateModel, Searched
from torchplate.studies import real

STRIP = "cantilever"
# Of the fixture, which a second specimen shows, too [Hz].
FIXTURE = (612.0, 662.0)
BANDS = ((40, 135), (135, 145), (145, 612), FIXTURE, (662, 890), (890, 915), (915, 1200))
# About one bending mode each [Hz], and what is fitted there: a frequency, a deflection of the sensor, a loss. All three
# are numbers of the config, so that they are there whatever is named; beside each, what makes it about one.
PEAKS = ((40, 400), (700, 1200))
FREE = {
    "plate.thickness": (Searched(0.0015, 0.0025), 1e-3),
    "sensor.mass": (Searched(0.0, 0.01), 1e-3),
    "loss.stiffness_loss_factor": (Searched(1e-3, 5e-2), 1e-2),
}


def named(found: Diagnosis) -> PlateModel:
    """The model with what is named, and with the numbers that are told of it."""
    whole = found.model
    effects = {label: effect for label, effect in whole.effects.items() if effect.name != "field"}
    known = {name: value for name, value in whole.known_values.items() if name.rpartition(".")[0] in effects}
    return whole.replaced(effects=effects, known=known | {name: one.value for name, one in found.parameters.items()})


def alone(
    model: PlateModel, measured: Complex[Tensor, " n_line"], frequency: Float[Tensor, " n_line"]
) -> tuple[dict[str, float], Complex[Tensor, " n_line"]]:
    """What of `FREE` fits these lines best, beginning with the model's own, and what it leaves of them."""
    free = model.replaced(searched={name: one for name, (one, _) in FREE.items()})
    unit = torch.tensor([FREE[name][1] for name in free.names], dtype=torch.float64)
    begun = torch.tensor([model.known_values[name] for name in free.names], dtype=torch.float64) / unit
    ends = [[getattr(FREE[name][0], end) / FREE[name][1] for name in free.names] for end in ("low", "high")]

    def off(place: np.ndarray) -> Tensor:
        return measured - free.frf(torch.as_tensor(place) * unit, frequency)[:, 0, 0]

    def residual(place: np.ndarray) -> np.ndarray:
        return torch.view_as_real(off(place) / measured.norm()).flatten().numpy()

    # A search by values alone: a step of 1e-5 is far above their rounding, and far below the width of a peak.
    place = least_squares(residual, begun.numpy(), bounds=ends, x_scale="jac", diff_step=1e-5, max_nfev=50).x
    return dict(zip(free.names, (torch.as_tensor(place) * unit).tolist(), strict=True)), off(place)


def main() -> int:
    """Print both."""
    strip = next(one for one in real.CASES if one.name == STRIP)
    with tempfile.TemporaryDirectory() as folder:
        found = real.examine(strip, Console(), Path(folder), report=False)
    if found is None:
        return 1
    test = plate_test(load_run(real.CONFIGS / f"{STRIP}.yaml"))
    assert test.measurement is not None
    with torch.no_grad():
        show(named(found.diagnosis), test.measurement.frequency, test.measurement.frf[:, 0, 0])
    return 0


def show(model: PlateModel, frequency: Float[Tensor, " n_line"], measured: Complex[Tensor, " n_line"]) -> None:
    """Print where this model's gap sits, and what each peak alone leaves."""
    outside = (frequency < FIXTURE[0]) | (frequency > FIXTURE[1])
    left = measured - model.frf(model.known.new_zeros(0), frequency)[:, 0, 0]
    print(f"gap {float(left.norm() / measured.norm()):.1%}, outside of {FIXTURE[0]:g} to {FIXTURE[1]:g} Hz", end=" ")
    print(f"{float(left[outside].norm() / measured[outside].norm()):.1%}")
    for low, high in BANDS:
        lines = (frequency >= low) & (frequency < high)
        share = float(left[lines].norm() / left.norm()) ** 2
        print(f"{low:g} to {high:g} Hz: {share:.1%} of the residual's square")
    apart = 0.0
    for low, high in PEAKS:
        lines = (frequency >= low) & (frequency < high) & outside
        own, rest = alone(model, measured[lines], frequency[lines])
        apart += float(rest.norm()) ** 2
        print(f"{low} to {high} Hz alone: gap {float(rest.norm() / measured[lines].norm()):.1%}", end="")
        print("".join(f", {name} {value:.4g}" for name, value in own.items()))
    print(f"both peaks alone: {apart**0.5 / float(measured[outside].norm()):.1%}")


if __name__ == "__main__":
    sys.exit(main())
