"""Rayleigh damping of the whole model."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.plate import Proportional


@dataclass(frozen=True)
class ViscousDamping(Effect):
    """C = a M + b K: modal damping ratio ζ = a / (2ω) + b ω / 2."""

    parameters = {
        "mass_coefficient": Parameter(
            "1/s", "a: viscous matrix over M", nonnegative, neutral=0.0, prior=Prior(0.0, 2.0, relative_to="plate")
        ),
        "stiffness_coefficient": Parameter(
            "s", "b: viscous matrix over K", nonnegative, neutral=0.0, prior=Prior(0.0, 1e-3, relative_to="plate")
        ),
    }
    check = Check(3, "record free decays of a low and a high mode: the decay rates part the laws of damping")
    acts_on = frozenset({"damping"})
    like = frozenset({"damping_scatter"})
    shows = "Rounds low peaks by mass_coefficient and high peaks by stiffness_coefficient."
    source = "Rayleigh, Theory of Sound (1877); Ewins, Modal Testing (2000), section 2.5"

    def proportional(self, value: Value) -> Proportional:
        """A and b of the whole model."""
        return Proportional(
            mass_coefficient=value["mass_coefficient"], stiffness_coefficient=value["stiffness_coefficient"]
        )
