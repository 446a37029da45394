"""How near the best a fit has to come for being followed to its end."""

from torchplate.diagnosis.fit import Beat
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.selection.criterion import never_equivalent
from torchplate.diagnosis.settings import Selecting


def apart(best: Fit, settings: Selecting, beside_noise: bool = False) -> tuple[float, float]:
    """By how much, in −2 ln L, what may be an equivalent of the best, or run off with it, may stand above it.

    A part of what is left is the same part of a sum of squares beside the noise that was told, and of as many numbers
    beside as much noise as is left.

    Args:
        best: of the fits.
        settings: of the selection.
        beside_noise: whether it began where nothing but noise was left: ways to one end agree to a few there.

    Returns:
        On the way, and once nuisances are taken as they are found.
    """
    never = never_equivalent(best)
    if beside_noise:
        return never, never
    left = best.square, min(best.square, best.judged.n)
    way, cost = (settings.close + settings.close_part * one + never for one in left)
    return way, cost


def to_beat(best: Fit, settings: Selecting, beside_noise: bool = False) -> Beat:
    """What others have to come near; see `apart`."""
    way, cost = apart(best, settings, beside_noise)
    return Beat(best.way + way, best.cost + cost)
