"""Deflection shapes that were measured at the resonances, to be seen beside the model's mode shapes.

At a resonance the first singular vector of the FRF matrix is close to the mode's shape; its singular value, the complex
mode indication function, has a peak there (Shih, Tsuei, Allemang and Brown, Mech. Syst. Signal Process. 2, 1988, 367).
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.measurement import Measurement

N_PLACE = 9
"""Places from which a shape is drawn: three along each side, which tell a half wave from a whole one."""
NEAR = 0.08
"""A resonance further from the model's than this part of it is that of another mode: 8 % is 17 % of stiffness."""
N_SIDE = 3
"""A peak is above this many lines on either side."""


class Shape(NamedTuple):
    """What was measured at one resonance.

    Attributes:
        frequency: of the peak [Hz].
        place: of the channels, relative [-].
        value: deflection there, on any scale.
        mac: with the model's mode shape: 1 where they are alike, 0 where they have nothing in common.
    """

    frequency: float
    place: Float[Tensor, "n_place 2"]
    value: Float[Tensor, " n_place"]
    mac: float


class Roved(NamedTuple):
    """The channels that are many enough to show a shape, and the FRFs from them to all channels of the other end.

    Attributes:
        place: relative [-].
        frf: unmeasured pairs left out.
    """

    place: Float[Tensor, "n_place 2"]
    frf: Complex[Tensor, "n_frequency n_place n_other"]


def roved(
    measurement: Measurement, response: Float[Tensor, "n_response 2"], reference: Float[Tensor, "n_reference 2"]
) -> Roved | None:
    """Sensors or hits, whichever are at more places; None where both are too few, or on one line.

    Args:
        measurement: FRFs.
        response: relative places of its responses [-].
        reference: likewise; for a transmissibility none.
    """
    best: Roved | None = None
    for place, frf, kept in (
        (response, measurement.frf, measurement.measured),
        (reference, measurement.frf.mT, measurement.measured.mT),
    ):
        found = _complete(place, frf, kept)
        if found is not None and (best is None or len(found.place) > len(best.place)):
            best = found
    return best


def _complete(place: Tensor, frf: Tensor, kept: Bool[Tensor, "n_place n_other"]) -> Roved | None:
    """With the column that was measured at most places, and all others that were measured at these, too."""
    if len(place) != len(kept):
        return None
    rows = kept[:, int(kept.sum(0).argmax())]
    columns = kept[rows].all(0)
    place = place[rows]
    spread = torch.linalg.svdvals(place - place.mean(0)) if len(place) else place.new_zeros(2)
    if len(torch.unique(place, dim=0)) < N_PLACE or float(spread.min()) < 1e-3:
        return None
    return Roved(place, frf[:, rows][:, :, columns])


def measured_shapes(
    frequency: Float[Tensor, " n_frequency"],
    seen: Roved,
    hertz: Float[Tensor, " n_mode"],
    shape: Float[Tensor, "n_place n_mode"],
) -> dict[int, Shape]:
    """The measured shape beside each mode of the model, by the mode's index; a resonance is given to one mode only.

    Args:
        frequency: lines [Hz].
        seen: the channels that show a shape.
        hertz: natural frequencies of the model [Hz].
        shape: its mode shapes at these channels.
    """
    vector, size, _ = torch.linalg.svd(seen.frf, full_matrices=False)
    level = size[:, 0]
    window = torch.nn.functional.max_pool1d(level[None, None], 2 * N_SIDE + 1, 1, N_SIDE)[0, 0]
    peaks = torch.nonzero((level == window) & (level > 0)).flatten().tolist()
    peaks = [line for line in peaks if N_SIDE <= line < len(frequency) - N_SIDE]
    candidates = []
    for line in peaks:
        first = vector[line, :, 0]
        # Turned so that most of it is real.
        turned = (first * torch.exp(-0.5j * (first**2).sum().angle())).real
        for mode, (own, column) in enumerate(zip(hertz.tolist(), shape.mT, strict=True)):
            if abs(float(frequency[line]) - own) <= NEAR * own:
                common = float(turned @ column)
                mac = common**2 / float((turned @ turned) * (column @ column))
                value = turned if common >= 0 else -turned
                candidates.append((mac, mode, line, Shape(float(frequency[line]), seen.place, value, mac)))
    found: dict[int, Shape] = {}
    taken: set[int] = set()
    for _, mode, line, one in sorted(candidates, key=lambda entry: -entry[0]):
        if mode not in found and line not in taken:
            found[mode] = one
            taken.add(line)
    return found
