"""The window that an analyser lays over the response record, so that it has died out when the record ends."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, SensorChain, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.plate import Geometry, Mesh


@dataclass(frozen=True)
class ExponentialWindow(Effect):
    """The response record was times exp(−rate·t): its transform at iω is that of the plain record at iω + rate."""

    parameters = {
        "rate": Parameter(
            "1/s", "1/time constant of the window", nonnegative, neutral=0.0, prior=Prior(0.0, 1.0, relative_to="plate")
        )
    }
    check = Check(1, "look up the window in the analyser's set-up, or record once without it")
    acts_on = frozenset({"sensor chain"})
    like = frozenset({"damping_scatter"})
    shows = "Every peak is wider by the same number of hertz, rate/π; β widens it in proportion to its frequency."
    source = "Fladung and Rost, Application and correction of the exponential window, MSSP 11 (1997) 23"

    def observe(self, mesh: Mesh, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """The lines of the transform move by the rate."""
        return chain._replace(laplace=chain.laplace + value["rate"][..., None])
