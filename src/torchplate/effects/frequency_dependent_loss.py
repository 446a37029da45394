"""A loss factor that is not the same at all frequencies: wood, polymers, glue."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Interval, Parameter, Prior
from torchplate.plate import Proportional


@dataclass(frozen=True)
class FrequencyDependentLoss(Effect):
    """β (f / 100 Hz)ⁿ in place of β, with the modulus of one fractional term: 1 + β cot(nπ/2) ((f / 100 Hz)ⁿ − 1).

    β is the model's stiffness loss factor, and E its modulus, both at 100 Hz; a model without a loss factor has nothing
    to change. Causality ties the modulus to the loss. A constant loss, too, asks for a modulus that grows by 2β/π with
    ln f, which the plain loss factor leaves out: it fades in over exponents of 0.01. n = 1 is a viscous loss and has
    the modulus that it had. Undamped natural frequencies are those of the modulus at 100 Hz.
    """

    parameters = {
        "exponent": Parameter(
            "-",
            "n: of the loss factor over the frequency, with the modulus that goes with it",
            Interval(-1.0, 1.0),
            neutral=0.0,
            prior=Prior(-0.8, 0.8),
        )
    }
    check = Check(3, "record free decays of a low and a high mode: the decay rates part the laws of damping")
    acts_on = frozenset({"damping", "section"})
    like = frozenset({"damping_scatter"})
    shows = "Peaks are rounder the higher they are, or the lower, and stand a little higher than one modulus lets them."
    source = "Bagley and Torvik, J. Rheol. 27 (1983) 201; Pritz, J. Sound Vib. 195 (1996) 103"

    def proportional(self, value: Value) -> Proportional:
        """The exponent of β."""
        return Proportional(loss_exponent=value["exponent"])
