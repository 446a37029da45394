"""A response channel that lags behind the force: filters that do not match, a converter that samples in turn."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, SensorChain, Value
from torchplate.effects.parameter import Parameter, Prior
from torchplate.plate import Geometry, Mesh


@dataclass(frozen=True)
class TimeDelay(Effect):
    """The record is y(t − τ): H times exp(−sτ), s = iω, or iω + σ where the delayed record was windowed by exp(−σt)."""

    parameters = {
        "delay": Parameter(
            "s", "τ: how late the response is recorded", neutral=0.0, prior=Prior(-0.01, 0.01, relative_to="plate")
        )
    }
    check = Check(3, "send one signal to both channels of the analyser and read the phase between them")
    acts_on = frozenset({"sensor chain"})
    shows = "The phase falls by 360° · delay per hertz on all FRFs alike; amplitudes stay."
    source = "Oppenheim and Schafer, Discrete-Time Signal Processing (1989), the shift theorem"
    # The analyser lays its window over what comes out of the channel.
    stage = 3

    def observe(self, mesh: Mesh, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """A factor of amplitude one."""
        turn = (-chain.laplace * value["delay"][..., None]).exp()
        return chain._replace(factor=chain.factor * turn[..., None, None])
