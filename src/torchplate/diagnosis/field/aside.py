"""What a place of a field leaves of some FRFs: of those put aside, which choose among the kinds.

Sharp spectra alone choose badly where peaks are off by more than their width: a field that catches a few of them and
moves the others anywhere leaves less than one that brings all of them nearer. Wide spectra see each of them. So each
level has one voice.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchplate.diagnosis.field.descent import FieldDescent, Place, inflated
from torchplate.diagnosis.holdout import held_out
from torchplate.diagnosis.target import FrfTarget


@dataclass(frozen=True, eq=False)
class Aside:
    """FRFs that judge the places of a field: of kinds those that no step sees, of mirror images all of them.

    Attributes:
        target: with these alone as fitted ones.
        part: of the level around each line that counts as noise in the sharp spectra [-].
    """

    target: FrfTarget
    part: float

    def log_left(self, descent: FieldDescent, place: Place) -> float:
        """Mean over the levels of ln(mean square of what is left): at a wide one of the level around each line.

        Args:
            descent: of a kind.
            place: of it.
        """
        target, every, plain = self.target, descent.every(place), descent.model.specimen(None)
        floor = target.settings.wide.told**2
        found = [
            float(target.residual(target.predict(plain, every, level), level).square().mean()) + floor
            for level in range(target.levels - 1)
        ]
        off = descent.left(place).abs().square() / inflated(target, self.part).variance
        sharp = float(off[:, target.fitted].mean()) / 2
        return float(torch.tensor([*found, sharp], dtype=torch.float64).log().mean())


def put_aside(target: FrfTarget) -> tuple[FrfTarget, Bool[Tensor, "n_response n_reference"]]:
    """What steps are to see, and which FRFs choose: the same ones where there are too few to spare any.

    Args:
        target: with all FRFs that may be fitted.
    """
    apart = held_out(target.fitted)
    if not bool(apart.any()):
        return target, target.fitted
    return target.holding_out(target.heldout | apart), apart


def worth(target: FrfTarget, variance: Float[Tensor, "n_frequency n_response n_reference"]) -> float:
    """Independent numbers that what is left of the fitted FRFs is worth.

    All of them where it is noise, and no more than frequencies, dampings and deflections of the modes where it is not.

    Args:
        target: whose FRFs they are.
        variance: that is expected of it, noise and all else.
    """
    n = 2.0 * len(target.frequency) * int(target.fitted.sum())
    own = float((target.variance / variance)[:, target.fitted].mean())
    n = 1 / (1 / n + target.settings.comparison.misspecified)
    return 1 / (own / n + (1 - own) / min(n, target.n_modal))
