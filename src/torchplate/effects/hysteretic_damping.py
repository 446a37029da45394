"""Structural damping of the whole model, in phase with velocity but not growing with frequency."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.plate import Proportional


@dataclass(frozen=True)
class HystereticDamping(Effect):
    """Complex stiffness K(1 + iβ) and a mass-proportional part iηM (seed paper, Eq. 17–18)."""

    parameters = {
        "stiffness_loss_factor": Parameter(
            "-", "β: part of K in quadrature", nonnegative, neutral=0.0, prior=Prior(1e-5, 0.1, logarithmic=True)
        ),
        "mass_loss_factor": Parameter(
            "1/s²", "η: part of M in quadrature", nonnegative, neutral=0.0, prior=Prior(0.0, 100.0, relative_to="plate")
        ),
    }
    check = Check(3, "record free decays of a low and a high mode: the decay rates part the laws of damping")
    acts_on = frozenset({"damping"})
    like = frozenset({"damping_scatter"})
    shows = "Rounds every peak by the same fraction of its frequency (β), or the low ones more (η)."
    source = "seed paper, Eq. 17–18; Ewins, Modal Testing (2000), section 2.4"

    def proportional(self, value: Value) -> Proportional:
        """β and η of the whole model."""
        return Proportional(
            stiffness_loss_factor=value["stiffness_loss_factor"], mass_loss_factor=value["mass_loss_factor"]
        )
