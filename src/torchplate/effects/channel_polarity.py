"""Channels with the wrong sign: a sensor mounted upside down, a swapped pair of wires, a hit from below."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchplate.effects.effect import Channel, Check, Effect, SensorChain, Value
from torchplate.plate import Geometry, Mesh


@dataclass(frozen=True)
class ChannelPolarity(Effect):
    """The named channels are read as −H.

    Args:
        channels: each [response, reference] by node label or relative place, with null for all of that side; or one
            node label: the response of that label, or the reference where no response has it. One that is not among
            the FRFs asked for is passed over.

    Raises:
        ValueError: if no channel is named, or later if a label is not on the grid.
    """

    channels: Sequence[Channel] = ()

    parameters = {}
    check = Check(2, "tap beside each sensor and look at the sign of the first half wave")
    acts_on = frozenset({"sensor chain"})
    shows = (
        "Some FRFs are right but for 180° at every frequency; where they are driving points Im H has the wrong sign."
    )
    source = "Allemang, The modal assurance criterion: twenty years of use and abuse, Sound and Vibration 37 (2003) 14"

    def __post_init__(self) -> None:
        if not self.channels:
            raise ValueError(
                "Expected channel_polarity to name its channels, got none. Add `channels: [[3, 28]]`, say."
            )

    def observe(self, mesh: Mesh, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """A factor −1 on what is named, once."""
        named = torch.stack([chain.in_channel(mesh, channel) for channel in self.channels]).any(0)
        return chain._replace(factor=chain.factor * (1 - 2 * named.to(chain.factor)))
