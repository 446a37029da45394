"""Where the gap of the measured strip sits, and what is left if each peak has a frequency and a loss of its own.

`python -m torchplate.studies.real cantilever`, then `python -m tests.studies.strip_by_band`: two minutes.
"""

import numpy as np
import torch
from scipy.optimize import least_squares

from torchplate.cli.config.build import load_run
from torchplate.cli.config.plate_test import plate_test
from torchplate.model import Searched

# Of the fixture, which a second specimen shows, too [Hz].
FIXTURE = (612.0, 662.0)
BANDS = ((40, 135), (135, 145), (145, 612), FIXTURE, (662, 890), (890, 915), (915, 1200))
# About one bending mode each [Hz], and what is fitted there: a frequency, a deflection of the sensor, a loss.
PEAKS = ((40, 400), (700, 1200))
FREE = {
    "thickness_1.value": (Searched(0.0015, 0.0025), 1e-3),
    "roving_mass_1.mass": (Searched(0.0, 0.01), 1e-3),
    "loss.stiffness_loss_factor": (Searched(1e-3, 5e-2), 1e-2),
}


@torch.no_grad()
def main() -> None:
    """Print both."""
    test = plate_test(load_run("runs/real/cantilever/model.yaml"))
    assert test.measurement is not None
    frequency, measured = test.measurement.frequency, test.measurement.frf[:, 0, 0]
    free = test.model.replaced(searched={name: one for name, (one, _) in FREE.items()})
    size = torch.tensor([FREE[name][1] for name in free.names], dtype=torch.float64)
    begun = torch.tensor([test.model.known_values[name] for name in free.names], dtype=torch.float64) / size
    outside = (frequency < FIXTURE[0]) | (frequency > FIXTURE[1])

    def off(place: np.ndarray, lines: torch.Tensor) -> torch.Tensor:
        return measured[lines] - free.frf(torch.as_tensor(place) * size, frequency[lines])[:, 0, 0]

    every = torch.ones_like(outside)
    left = off(begun.numpy(), every)
    print(f"gap {float(left.norm() / measured.norm()):.1%}, outside of {FIXTURE[0]:g} to {FIXTURE[1]:g} Hz", end=" ")
    print(f"{float(left[outside].norm() / measured[outside].norm()):.1%}")
    for low, high in BANDS:
        lines = (frequency >= low) & (frequency < high)
        share = float(left[lines].norm() / left.norm()) ** 2
        print(f"{low:g} to {high:g} Hz: {share:.1%} of the residual's square")
    apart = 0.0
    for low, high in PEAKS:
        lines = (frequency >= low) & (frequency < high) & outside

        def residual(place: np.ndarray, lines: torch.Tensor = lines) -> np.ndarray:
            return torch.view_as_real(off(place, lines) / measured.norm()).flatten().numpy()

        found = least_squares(residual, begun.numpy(), x_scale="jac", diff_step=1e-5, max_nfev=25)
        own = off(found.x, lines)
        apart += float(own.norm()) ** 2
        loss = found.x[free.names.index("loss.stiffness_loss_factor")] * 1e-2
        print(f"{low} to {high} Hz alone: loss {loss:.4f}, gap {float(own.norm() / measured[lines].norm()):.1%}")
    print(f"both peaks alone: {apart**0.5 / float(measured[outside].norm()):.1%}")


if __name__ == "__main__":
    main()
