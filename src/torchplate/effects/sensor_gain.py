"""A calibration factor that is wrong, or not known."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, SensorChain, Value
from torchplate.effects.parameter import Parameter, Prior, positive
from torchplate.plate import Geometry, Mesh


@dataclass(frozen=True)
class SensorGain(Effect):
    """Every reading is gain · H, all channels alike."""

    parameters = {
        "gain": Parameter(
            "-", "reading over the true FRF", positive, neutral=1.0, prior=Prior(0.3, 3.0, logarithmic=True)
        )
    }
    check = Check(3, "calibrate the chain: hit a freely hung block of known mass, where a/F must be 1/m")
    acts_on = frozenset({"sensor chain"})
    shows = "All FRFs are off by one factor at all frequencies, and resonances sit where they should."
    source = "Ewins, Modal Testing (2000), on calibration: a known mass tells the gain of the whole chain"

    def observe(self, mesh: Mesh, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """One real factor."""
        return chain._replace(factor=chain.factor * value["gain"][..., None, None, None])
